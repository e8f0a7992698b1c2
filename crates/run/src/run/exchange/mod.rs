//! Exchange of weights with other programs: self-describing safetensors, and nerf-pytorch's checkpoints (`.tar`, `.pth`,
//! `.pt` of `torch.save`), which are read only.

mod export;
mod import;
mod nerf_pytorch;

pub use export::export;
pub use import::{Foreign, Networks};

use std::path::Path;

use crate::base::{Error, Result};

/// File format by extension.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    /// A checkpoint in nerf-pytorch's format.
    Torch,
    /// Our parameters, with [`METADATA`].
    Safetensors,
}

/// Key of the metadata of a safetensors file. It is one text, since a map of several has no fixed order.
const METADATA: &str = "augnerf";

impl Format {
    fn of(file: &Path) -> Result<Format> {
        let ending = file.extension().map(|ending| ending.to_string_lossy().to_lowercase()).unwrap_or_default();
        match ending.as_str() {
            "tar" | "pth" | "pt" => Ok(Format::Torch),
            "safetensors" => Ok(Format::Safetensors),
            _ => Err(Error::Config(format!(
                "{}: unknown file type; weights are in .tar, .pth or .pt (nerf-pytorch) or .safetensors",
                file.display()
            ))),
        }
    }
}
