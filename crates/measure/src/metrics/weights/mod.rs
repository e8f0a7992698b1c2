//! Reads named tensors from safetensors files and from both formats of PyTorch's `torch.save`.
//!
//! Nothing that a file announces is believed: names, kinds of numbers, shapes and places are read first, each checked
//! against the file's own length, and memory is taken for a tensor only when it is asked for and has the shape that is
//! expected.

mod safetensors;
mod torch;

use std::collections::HashMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use candle_core::{DType, Device, Tensor};

use augnerf_base::input::open_regular;
use augnerf_base::{Error, Result};

/// An opened weight file.
pub struct Weights {
    path: PathBuf,
    file: File,
    contents: Contents,
}

/// What a file holds by name.
#[derive(Default)]
struct Contents {
    /// Where a tensor is, or why it cannot be read.
    tensors: HashMap<String, Parsed<Stored>>,
    /// Numbers beside them, such as the step of a checkpoint.
    integers: HashMap<String, i64>,
}

/// A tensor's contiguous values in a file.
struct Stored {
    dtype: DType,
    shape: Vec<usize>,
    /// Bytes from the start of the file.
    offset: u64,
}

impl Weights {
    /// Opens a `.safetensors` file or, under any other extension, a PyTorch file.
    pub fn open(path: &Path) -> Result<Weights> {
        let file = open_regular(path).map_err(|e| Error::unreadable(path, &e))?;
        let contents = contents(&file, path).map_err(|reason| broken(path, &reason))?;
        Ok(Weights { path: path.to_path_buf(), file, contents })
    }

    /// Names of all tensors, in no order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.contents.tensors.keys().map(String::as_str)
    }

    /// The shape of a tensor; none where there is no such tensor, or none that can be read.
    pub fn shape(&self, name: &str) -> Option<&[usize]> {
        self.contents.tensors.get(name)?.as_ref().ok().map(|stored| stored.shape.as_slice())
    }

    /// Tensors that cannot be read, with the reasons, in the order of their names.
    pub fn unreadable(&self) -> Vec<(&str, &str)> {
        let mut all: Vec<(&str, &str)> = (self.contents.tensors.iter())
            .filter_map(|(name, found)| Some((name.as_str(), found.as_ref().err()?.as_str())))
            .collect();
        all.sort_unstable();
        all
    }

    /// An integer that stands beside the tensors.
    pub fn integer(&self, name: &str) -> Option<i64> {
        self.contents.integers.get(name).copied()
    }

    /// The first of `names` in the file, as `f32` on `device`; its shape must be `shape`.
    pub fn get(&self, names: &[String], shape: &[usize], device: &Device) -> Result<Tensor> {
        let Some((name, stored)) = names.iter().find_map(|name| Some((name, self.contents.tensors.get(name)?))) else {
            let (path, names) = (self.path.display(), names.join(" nor "));
            let what = format!("{path} lacks the tensor {names} of shape {shape:?}; get the complete file");
            return Err(Error::Data(what));
        };
        let unreadable = |reason: String| broken(&self.path, &format!("{name}: {reason}"));
        let stored = stored.as_ref().map_err(|reason| unreadable(reason.clone()))?;
        if stored.shape != shape {
            let (path, found) = (self.path.display(), &stored.shape);
            return Err(Error::Data(format!("{path}: tensor {name} has shape {found:?}, expected {shape:?}")));
        }
        let tensor = stored.read(&self.file).map_err(unreadable)?;
        Ok(tensor.to_dtype(DType::F32)?.to_device(device)?.contiguous()?)
    }
}

fn broken(path: &Path, reason: &str) -> Error {
    let is_ours = path.extension().is_some_and(|ending| ending == "safetensors");
    let or = if is_ours { "" } else { ", or save it anew in Python: torch.save(torch.load(FILE), FILE)" };
    Error::Data(format!("{} is not a readable weight file ({reason}); get it again{or}", path.display()))
}

/// The reason why a file is not readable; the caller adds which file.
type Parsed<T> = std::result::Result<T, String>;

fn text(error: impl std::fmt::Display) -> String {
    error.to_string()
}

fn contents(file: &File, path: &Path) -> Parsed<Contents> {
    let mut reader = BufReader::new(file);
    if path.extension().is_some_and(|e| e == "safetensors") {
        return safetensors::read(&mut reader);
    }
    torch::read(&mut reader)
}

fn length(file: &BufReader<&File>) -> Parsed<u64> {
    Ok(file.get_ref().metadata().map_err(text)?.len())
}

/// The number of elements of a tensor, unless they take more than `most` bytes.
fn elements(shape: &[u64], dtype: DType, most: u64) -> Option<u64> {
    let count = shape.iter().try_fold(1u64, |count, size| count.checked_mul(*size))?;
    count.checked_mul(dtype.size_in_bytes() as u64).filter(|bytes| *bytes <= most).map(|_| count)
}

/// A size that fits a tensor within the file is no larger than the file.
fn dims(shape: &[u64]) -> Vec<usize> {
    shape.iter().map(|size| *size as usize).collect()
}

impl Stored {
    /// Its length was checked when the file was opened.
    fn read(&self, mut file: &File) -> Parsed<Tensor> {
        let mut bytes = vec![0; self.shape.iter().product::<usize>() * self.dtype.size_in_bytes()];
        file.seek(SeekFrom::Start(self.offset)).map_err(text)?;
        file.read_exact(&mut bytes).map_err(text)?;
        Tensor::from_raw_buffer(&bytes, self.dtype, &self.shape, &Device::Cpu).map_err(text)
    }
}
