//! `depth_errors.gz`: a run's depth error at every pixel with known depth. Tables use it to compare rows over the
//! pixels that all of them render.
//!
//! ```text
//! gzip of, for each held-out view:
//!   u32    number of pixels whose reference depth is known
//!   f32    rendered minus reference depth of each, row-major; NaN where the rendering is not solid
//! ```
//!
//! All numbers are little-endian. The file takes 4 bytes for each pixel of the scene's surface, less a tenth by
//! packing: 0.2 MB for the built-in scene, 1 MB for 25 views of 200 x 200, 30 MB for NeRF-Synthetic's 200 views of 400
//! x 400.

use std::io::{self, BufRead, BufReader, Read, Write};
use std::path::Path;

use flate2::{Compression, GzBuilder, read::GzDecoder};

use crate::base::files::write_atomic;
use crate::base::input::open_regular;
use crate::base::{Error, Result};

/// Numbers that are unpacked at once.
const BLOCK: usize = 4096;

/// Depth errors of each held-out view.
#[derive(Clone, Debug, Default)]
pub struct DepthErrors {
    /// By view, then by pixel of known depth; NaN if the rendering is not solid there.
    pub views: Vec<Vec<f32>>,
}

impl DepthErrors {
    /// Writes the file, unless there are no views.
    pub fn write(&self, path: &Path) -> Result<()> {
        if self.views.is_empty() {
            return Ok(());
        }
        let mut writer = GzBuilder::new().write(Vec::new(), Compression::fast());
        let mut put = |bytes: &[u8]| writer.write_all(bytes).expect("memory takes everything");
        for view in &self.views {
            put(&u32::try_from(view.len()).expect("a view has fewer pixels").to_le_bytes());
            put(&view.iter().flat_map(|error| error.to_le_bytes()).collect::<Vec<u8>>());
        }
        write_atomic(path, &writer.finish().expect("memory takes everything"))
    }

    /// Reads the file, or returns `None` if it does not exist.
    pub fn read(path: &Path) -> Result<Option<DepthErrors>> {
        let file = match open_regular(path) {
            Ok(file) => file,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(Error::unreadable(path, &error)),
        };
        let damaged = |what: &str| {
            Error::Checkpoint(format!(
                "{} is damaged: {what}; delete it, or measure the run again with `augnerf eval`",
                path.display()
            ))
        };
        let cannot = |error: io::Error| match error.kind() {
            io::ErrorKind::UnexpectedEof => damaged("it ends early"),
            _ => damaged(&error.to_string()),
        };
        let mut unpacked = BufReader::new(GzDecoder::new(file));
        let mut views = Vec::new();
        while !unpacked.fill_buf().map_err(cannot)?.is_empty() {
            let mut count = [0; 4];
            unpacked.read_exact(&mut count).map_err(cannot)?;
            let count = u32::from_le_bytes(count) as usize;
            views.push(read_view(&mut unpacked, count).map_err(cannot)?);
        }
        Ok(Some(DepthErrors { views }))
    }
}

/// Reads `count` numbers. Allocates memory only for numbers that exist.
fn read_view(unpacked: &mut impl Read, count: usize) -> io::Result<Vec<f32>> {
    let (mut view, mut block) = (Vec::new(), [0; 4 * BLOCK]);
    while view.len() < count {
        let block = &mut block[..4 * BLOCK.min(count - view.len())];
        unpacked.read_exact(block)?;
        view.extend(block.chunks_exact(4).map(|bytes| f32::from_le_bytes(bytes.try_into().expect("four bytes"))));
    }
    Ok(view)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_reads_back_and_damage_is_said() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("depth_errors.gz");
        assert!(DepthErrors::read(&path).unwrap().is_none());
        DepthErrors::default().write(&path).unwrap();
        assert!(!path.exists(), "no view, no file");
        let views = vec![vec![0.5, f32::NAN, -1.25e-7], vec![], vec![3.0]];
        DepthErrors { views: views.clone() }.write(&path).unwrap();
        let bits = |views: &[Vec<f32>]| -> Vec<Vec<u32>> {
            views.iter().map(|view| view.iter().map(|error| error.to_bits()).collect()).collect()
        };
        assert_eq!(bits(&DepthErrors::read(&path).unwrap().unwrap().views), bits(&views));
        let whole = std::fs::read(&path).unwrap();
        for length in [0, 5, whole.len() / 2, whole.len() - 1] {
            std::fs::write(&path, &whole[..length]).unwrap();
            let error = DepthErrors::read(&path).unwrap_err().to_string();
            assert!(error.contains("depth_errors.gz is damaged"), "{error}");
        }
        for content in [&[2, 0, 0, 0, 0, 0][..], &[9, 0], &[255; 6]] {
            let mut writer = GzBuilder::new().write(Vec::new(), Compression::fast());
            writer.write_all(content).unwrap();
            std::fs::write(&path, writer.finish().unwrap()).unwrap();
            let error = DepthErrors::read(&path).unwrap_err().to_string();
            assert!(error.contains("ends early"), "{error}");
        }
    }
}
