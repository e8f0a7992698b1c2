//! Reads named tensors from safetensors files and from both formats of PyTorch's `torch.save`.

mod legacy;
mod pickle;

use std::collections::HashMap;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

use candle_core::pickle::PthTensors;
use candle_core::{DType, Device, Tensor};

use crate::base::{Error, Result};

use legacy::{LEGACY_MAGIC, LegacyTensor};

/// An opened weight file.
pub struct Weights {
    path: PathBuf,
    source: Source,
}

enum Source {
    Safetensors(HashMap<String, Tensor>),
    Zip(PthTensors),
    Legacy(HashMap<String, LegacyTensor>),
}

impl Weights {
    /// Opens a `.safetensors` file or, under any other extension, a PyTorch file.
    pub fn open(path: &Path) -> Result<Weights> {
        let source = Source::open(path).map_err(|reason| broken(path, &reason))?;
        Ok(Weights { path: path.to_path_buf(), source })
    }

    /// The first of `names` in the file, as `f32` on `device`; its shape must be `shape`.
    pub fn get(&self, names: &[String], shape: &[usize], device: &Device) -> Result<Tensor> {
        for name in names {
            let tensor = self.source.get(&self.path, name).map_err(|e| broken(&self.path, &format!("{name}: {e}")))?;
            if let Some(tensor) = tensor {
                self.check_shape(name, tensor.dims(), shape)?;
                return Ok(tensor.to_dtype(DType::F32)?.to_device(device)?.contiguous()?);
            }
        }
        let (path, names) = (self.path.display(), names.join(" nor "));
        Err(Error::Data(format!("{path} lacks the tensor {names} of shape {shape:?}; get the complete file")))
    }

    fn check_shape(&self, name: &str, found: &[usize], expected: &[usize]) -> Result<()> {
        if found == expected {
            return Ok(());
        }
        let path = self.path.display();
        Err(Error::Data(format!("{path}: tensor {name} has shape {found:?}, expected {expected:?}")))
    }
}

fn broken(path: &Path, reason: &str) -> Error {
    Error::Data(format!("{} is not a readable weight file ({reason}); get it again", path.display()))
}

/// The reason why a file is not readable; the caller adds which file.
type Parsed<T> = std::result::Result<T, String>;

fn text(error: impl std::fmt::Display) -> String {
    error.to_string()
}

impl Source {
    fn open(path: &Path) -> Parsed<Source> {
        if path.extension().is_some_and(|e| e == "safetensors") {
            return candle_core::safetensors::load(path, &Device::Cpu).map(Source::Safetensors).map_err(text);
        }
        let mut file = BufReader::new(File::open(path).map_err(text)?);
        let mut magic = [0; LEGACY_MAGIC.len()];
        file.read_exact(&mut magic).map_err(text)?;
        if magic == LEGACY_MAGIC {
            return legacy::read(&mut file).map(Source::Legacy);
        }
        PthTensors::new(path, None).map(Source::Zip).map_err(text)
    }

    fn get(&self, path: &Path, name: &str) -> Parsed<Option<Tensor>> {
        match self {
            Source::Safetensors(tensors) => Ok(tensors.get(name).cloned()),
            Source::Zip(tensors) => tensors.get(name).map_err(text),
            Source::Legacy(tensors) => tensors.get(name).map(|tensor| tensor.read(path)).transpose(),
        }
    }
}
