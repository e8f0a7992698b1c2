//! Weights of other programs, and ours for them: nerf-pytorch's checkpoints (`.tar`, `.pth`, `.pt` of `torch.save`), and
//! safetensors that say of themselves what they are.

mod export;
mod import;
mod nerf_pytorch;
mod pickle;

pub use export::export;
pub use import::{Foreign, Networks};

use std::path::Path;

use crate::base::{Error, Result};

/// What a file's ending says that it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    /// A checkpoint as nerf-pytorch writes it.
    Torch,
    /// Our parameters, with [`METADATA`].
    Safetensors,
}

/// The key of what a safetensors file says of itself: one text, for a map of several has no fixed order.
const METADATA: &str = "augnerf";

impl Format {
    fn of(file: &Path) -> Result<Format> {
        let ending = file.extension().map(|ending| ending.to_string_lossy().to_lowercase()).unwrap_or_default();
        match ending.as_str() {
            "tar" | "pth" | "pt" => Ok(Format::Torch),
            "safetensors" => Ok(Format::Safetensors),
            _ => Err(Error::Config(format!(
                "{}: a file of weights ends in .tar, .pth or .pt (nerf-pytorch) or in .safetensors",
                file.display()
            ))),
        }
    }
}
