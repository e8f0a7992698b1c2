//! Files from elsewhere, read with bounds.
//!
//! A name may refer to a device that never ends, a pipe that nobody writes to, or a file far larger than expected. Only
//! regular files are read, up to a size. A file that the user names may also be a pipe (`--config <(...)`).

use std::fs::File;
use std::io::{self, Read, Seek};
use std::path::Path;

/// Largest size of settings and of sweep files in bytes: a hundred times a usual one.
pub const TEXT_BYTES: u64 = 4 << 20;
/// Largest size of a table of this program in bytes: a log of 200,000 steps with every step logged.
pub const TABLE_BYTES: u64 = 256 << 20;
/// Largest size of a JSON file of this program in bytes: ten times a report on a thousand views.
pub const JSON_BYTES: u64 = 8 << 20;
/// Largest size of a checkpoint's tensors in bytes.
pub const TENSORS_BYTES: u64 = 16 << 30;

/// Begin of the text that a clone without Git LFS has in the place of a large file.
const LFS_POINTER: &[u8] = b"version https://git-lfs";
/// Largest size of such a text in bytes.
const MOST_POINTER: u64 = 1024;
const BYTE_ORDER_MARK: char = '\u{feff}';

/// Opens a regular file.
///
/// # Errors
/// Those of the system. If the path is not a regular file; it does not wait for pipes or devices. If the file is a pointer
/// of Git LFS.
pub fn open_regular(path: &Path) -> io::Result<File> {
    let found = std::fs::metadata(path)?;
    if found.is_dir() {
        return Err(io::Error::other("it is a folder"));
    }
    if !found.is_file() {
        return Err(io::Error::other("it is a device or a pipe, where a file is needed"));
    }
    let mut file = File::open(path)?;
    if found.len() <= MOST_POINTER {
        let mut begin = [0; LFS_POINTER.len()];
        if file.read_exact(&mut begin).is_ok() && begin == LFS_POINTER {
            return Err(io::Error::other(
                "it is a Git LFS pointer, not the file: run `git lfs pull` in its repository",
            ));
        }
        file.rewind()?;
    }
    Ok(file)
}

/// Reads a regular file of at most `most` bytes.
///
/// # Errors
/// Those of [`open_regular`], and if the file is larger.
pub fn read_bytes(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let file = open_regular(path)?;
    let length = file.metadata()?.len();
    if length > most {
        return Err(too_large(most));
    }
    let mut bytes = Vec::new();
    // An error if memory is missing, instead of an abort.
    bytes.try_reserve_exact(length as usize).map_err(io::Error::other)?;
    read_into(file, most, bytes)
}

/// Reads text with [`read_bytes`]: UTF-8, or UTF-16 as programs on Windows write it. A byte order mark is left out.
pub fn read_text(path: &Path, most: u64) -> io::Result<String> {
    text(read_bytes(path, most)?)
}

/// Reads text like [`read_text`], from a path that the user named, which may be a pipe. At most `most` bytes are read,
/// also from a device.
pub fn read_named(path: &Path, most: u64) -> io::Result<String> {
    if std::fs::metadata(path)?.is_file() {
        read_text(path, most)
    } else {
        text(read_into(File::open(path)?, most, Vec::new())?)
    }
}

fn read_into(file: File, most: u64, mut bytes: Vec<u8>) -> io::Result<Vec<u8>> {
    file.take(most.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most { Err(too_large(most)) } else { Ok(bytes) }
}

fn too_large(most: u64) -> io::Error {
    let most = if most < 1 << 20 { format!("{} KiB", most >> 10) } else { format!("{} MiB", most >> 20) };
    io::Error::other(format!("it holds more than {most}, which is more than such a file has"))
}

fn text(bytes: Vec<u8>) -> io::Result<String> {
    // Without a mark, UTF-16 shows by the zero byte of its first letter.
    let order: fn([u8; 2]) -> u16 = match bytes[..] {
        [0xff, 0xfe, ..] | [1..=0xff, 0, ..] => u16::from_le_bytes,
        [0xfe, 0xff, ..] | [0, 1..=0xff, ..] => u16::from_be_bytes,
        _ => {
            let mut text = String::from_utf8(bytes).map_err(|_| io::Error::other("it is not a text in UTF-8"))?;
            if text.starts_with(BYTE_ORDER_MARK) {
                text.remove(0);
            }
            return Ok(text);
        }
    };
    let units: Vec<u16> = bytes.chunks(2).map(|pair| order([pair[0], pair.get(1).copied().unwrap_or(0)])).collect();
    let text = String::from_utf16(&units).map_err(|_| io::Error::other("it is not a text in UTF-16"))?;
    Ok(text.trim_start_matches(BYTE_ORDER_MARK).into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_read_up_to_their_size() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a");
        std::fs::write(&path, [b'a'; 4096]).unwrap();
        assert_eq!(read_text(&path, 4096).unwrap().len(), 4096);
        assert!(read_text(&path, 4095).unwrap_err().to_string().contains("more than 3 KiB"));
        assert!(read_bytes(dir.path(), 10).unwrap_err().to_string().contains("folder"));
        std::fs::write(&path, [0xff]).unwrap();
        assert!(read_named(&path, 10).unwrap_err().to_string().contains("UTF-8"));
        assert_eq!(read_bytes(&dir.path().join("b"), 10).unwrap_err().kind(), io::ErrorKind::NotFound);
        std::fs::write(&path, b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 8\n").unwrap();
        assert!(open_regular(&path).unwrap_err().to_string().contains("git lfs pull"));
    }

    #[test]
    fn texts_of_windows_are_read() {
        let utf16 = |order: fn(u16) -> [u8; 2], words: &str| words.encode_utf16().flat_map(order).collect::<Vec<u8>>();
        let words = "{\"k\": \"Küche\"}";
        let marked = format!("\u{feff}{words}");
        for bytes in [
            words.as_bytes().to_vec(),
            marked.as_bytes().to_vec(),
            utf16(u16::to_le_bytes, words),
            utf16(u16::to_le_bytes, &marked),
            utf16(u16::to_be_bytes, words),
            utf16(u16::to_be_bytes, &marked),
        ] {
            assert_eq!(text(bytes).unwrap(), words);
        }
        assert!(text(vec![0xff, 0xfe, 0, 0xd8]).is_err() && text(vec![b'a', 0xff]).is_err());
    }

    #[cfg(unix)]
    #[test]
    fn devices_and_pipes_do_not_hold_anything_up() {
        let endless = Path::new("/dev/zero");
        assert!(read_bytes(endless, 10).unwrap_err().to_string().contains("device"));
        assert!(read_named(endless, 1 << 20).unwrap_err().to_string().contains("more than 1 MiB"));
    }
}
