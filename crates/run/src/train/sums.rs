//! `SHA256SUMS`: checksums of a checkpoint's files, readable by `sha256sum -c`.

use std::io;
use std::path::Path;

use sha2::{Digest, Sha256};

use crate::base::Result;
use crate::base::files::write_atomic;
use crate::base::input::{TENSORS_BYTES, TEXT_BYTES, read_bytes};

const SUMS: &str = "SHA256SUMS";

/// Writes files into a folder, with their checksums.
pub(super) fn write(folder: &Path, files: &[(&str, &[u8])]) -> Result<()> {
    let mut lines = String::new();
    for (name, bytes) in files {
        write_atomic(&folder.join(name), bytes)?;
        lines += &format!("{}  {name}\n", sha256(bytes));
    }
    write_atomic(&folder.join(SUMS), lines.as_bytes())
}

/// Returns the bytes of a file as they were written, or what is wrong with it.
///
/// # Errors
/// An existing file cannot be read.
pub(super) fn read(folder: &Path, name: &str) -> io::Result<std::result::Result<Vec<u8>, String>> {
    let Some(bytes) = absent_is_none(read_bytes(&folder.join(name), TENSORS_BYTES))? else {
        return Ok(Err("it is missing".into()));
    };
    let Some(sums) = absent_is_none(read_bytes(&folder.join(SUMS), TEXT_BYTES))? else {
        return Ok(Err(format!("{SUMS} is missing")));
    };
    let expected = format!("{}  {name}", sha256(&bytes));
    let known = sums.split(|byte| *byte == b'\n').any(|line| line == expected.as_bytes());
    Ok(if known { Ok(bytes) } else { Err(format!("its bytes do not match {SUMS}")) })
}

fn absent_is_none(read: io::Result<Vec<u8>>) -> io::Result<Option<Vec<u8>>> {
    match read {
        Ok(bytes) => Ok(Some(bytes)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

/// Returns a file's SHA-256 in hexadecimal digits.
pub fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}
