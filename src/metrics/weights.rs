//! Reads named tensors from safetensors files and from both formats of PyTorch's `torch.save`.
//!
//! Files before PyTorch 1.6 are a row of pickles followed by raw storages; candle reads only
//! the zip format that came after. Unpickling here builds plain values and runs no code.

use std::collections::HashMap;
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use candle_core::pickle::PthTensors;
use candle_core::{DType, Device, Tensor};

use crate::base::{Error, Result};

/// `torch.save`'s magic number 0x1950a86a20f9469cfc6c as a complete pickle.
const LEGACY_MAGIC: [u8; 15] = [0x80, 2, 0x8a, 10, 0x6c, 0xfc, 0x9c, 0x46, 0xf9, 0x20, 0x6a, 0xa8, 0x50, 0x19, b'.'];

/// Longest string a pickle may hold; names of tensors are far shorter.
const MAX_STRING: u64 = 1 << 16;

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

/// Where a tensor's contiguous values lie in a legacy file.
struct LegacyTensor {
    class: String,
    shape: Vec<usize>,
    /// Bytes from the start of the file.
    offset: u64,
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
            return read_legacy(&mut file).map(Source::Legacy);
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

impl LegacyTensor {
    fn read(&self, path: &Path) -> Parsed<Tensor> {
        if self.class != "torch FloatStorage" {
            return Err(format!("stored as {}, expected torch FloatStorage", self.class));
        }
        let mut file = File::open(path).map_err(text)?;
        file.seek(SeekFrom::Start(self.offset)).map_err(text)?;
        let count = self.shape.iter().product::<usize>();
        let mut bytes = vec![0; count * 4];
        file.read_exact(&mut bytes).map_err(text)?;
        let values: Vec<f32> = bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
        Tensor::from_vec(values, self.shape.as_slice(), &Device::Cpu).map_err(text)
    }
}

/// Reads all that follows the magic number: the protocol version, facts about the machine, the
/// state dictionary, the storages' keys, then per key its length and values.
fn read_legacy(file: &mut BufReader<File>) -> Parsed<HashMap<String, LegacyTensor>> {
    let length = file.get_ref().metadata().map_err(text)?.len();
    for _ in 0..2 {
        unpickle(file)?;
    }
    let Value::Dict(state) = unpickle(file)? else { return Err("no state dictionary".into()) };
    let Value::List(keys) = unpickle(file)? else { return Err("no list of storages".into()) };
    let tensors: Vec<(String, Described)> = state.into_iter().filter_map(named_tensor).collect();
    let classes: HashMap<&str, &Storage> = tensors.iter().map(|(_, t)| (t.storage.key.as_str(), &t.storage)).collect();
    let mut starts = HashMap::new();
    for key in keys {
        let Value::Str(key) = key else { return Err("a storage key is not a string".into()) };
        let count = read_u64(file)?;
        let start = file.stream_position().map_err(text)?;
        let storage = classes.get(key.as_str()).ok_or("a storage belongs to no tensor")?;
        let bytes = count.checked_mul(element_size(&storage.class)?).filter(|bytes| *bytes <= length - start);
        let bytes = bytes.ok_or("the file ends early")?;
        file.seek_relative(bytes as i64).map_err(text)?;
        starts.insert(key, (start, count));
    }
    tensors.into_iter().map(|(name, tensor)| Ok((name, tensor.locate(&starts)?))).collect()
}

fn read_u64(file: &mut BufReader<File>) -> Parsed<u64> {
    let mut bytes = [0; 8];
    file.read_exact(&mut bytes).map_err(text)?;
    Ok(u64::from_le_bytes(bytes))
}

fn element_size(class: &str) -> Parsed<u64> {
    match class.strip_prefix("torch ").unwrap_or(class) {
        "DoubleStorage" | "LongStorage" => Ok(8),
        "FloatStorage" | "IntStorage" => Ok(4),
        "HalfStorage" | "BFloat16Storage" | "ShortStorage" => Ok(2),
        "ByteStorage" | "CharStorage" | "BoolStorage" => Ok(1),
        other => Err(format!("unknown storage class {other}")),
    }
}

fn named_tensor((name, value): (Value, Value)) -> Option<(String, Described)> {
    match (name, value) {
        (Value::Str(name), Value::Tensor(tensor)) => Some((name, tensor)),
        _ => None,
    }
}

#[derive(Clone)]
struct Storage {
    class: String,
    key: String,
}

/// A tensor as its pickle describes it; offset, shape and strides in elements.
#[derive(Clone)]
struct Described {
    storage: Storage,
    offset: u64,
    shape: Vec<u64>,
    strides: Vec<u64>,
}

impl Described {
    fn locate(&self, starts: &HashMap<String, (u64, u64)>) -> Parsed<LegacyTensor> {
        let (start, count) = *starts.get(&self.storage.key).ok_or("a tensor has no storage")?;
        let mut expected = 1u64;
        for (size, stride) in self.shape.iter().zip(&self.strides).rev() {
            if *size > 1 && *stride != expected {
                return Err("a tensor is not contiguous".into());
            }
            expected = expected.checked_mul(*size).ok_or("a tensor is too large")?;
        }
        if self.offset.checked_add(expected).is_none_or(|end| end > count) {
            return Err("a tensor reaches past its storage".into());
        }
        let offset = start + self.offset * element_size(&self.storage.class)?;
        let shape = self.shape.iter().map(|s| *s as usize).collect();
        Ok(LegacyTensor { class: self.storage.class.clone(), shape, offset })
    }
}

/// What a pickle can build here.
#[derive(Clone)]
enum Value {
    /// A value that tensors do not depend on.
    Other,
    Int(i64),
    Str(String),
    /// "module name" of a class or function.
    Global(String),
    Tuple(Vec<Value>),
    List(Vec<Value>),
    Dict(Vec<(Value, Value)>),
    Storage(Storage),
    Tensor(Described),
}

/// The machine of one pickle (protocol 2, the operations that `torch.save` writes).
#[derive(Default)]
struct Machine {
    stack: Vec<Value>,
    /// Heights of the stack at the marks.
    marks: Vec<usize>,
    memo: HashMap<u32, Value>,
}

fn unpickle(input: &mut impl BufRead) -> Parsed<Value> {
    let mut machine = Machine::default();
    loop {
        let code = read_bytes::<1>(input)?[0];
        match code {
            b'.' => return machine.pop(),
            b'c' | b'X' | b'U' | b'T' | b'J' | b'K' | b'M' | b'G' | 0x80 | 0x8a => machine.literal(code, input)?,
            b'q' | b'r' | b'h' | b'j' => machine.memo(code, input)?,
            _ => machine.combine(code)?,
        }
    }
}

fn read_bytes<const N: usize>(input: &mut impl Read) -> Parsed<[u8; N]> {
    let mut bytes = [0; N];
    input.read_exact(&mut bytes).map_err(text)?;
    Ok(bytes)
}

fn read_string(input: &mut impl Read, length: u64) -> Parsed<String> {
    if length > MAX_STRING {
        return Err(format!("a string of {length} bytes"));
    }
    let mut bytes = vec![0; length as usize];
    input.read_exact(&mut bytes).map_err(text)?;
    String::from_utf8(bytes).map_err(text)
}

fn read_line(input: &mut impl BufRead) -> Parsed<String> {
    let mut line = String::new();
    input.take(MAX_STRING).read_line(&mut line).map_err(text)?;
    Ok(line.trim_end().to_string())
}

/// A little-endian two's complement integer of up to 8 bytes.
fn read_long(input: &mut impl Read) -> Parsed<i64> {
    let length = read_bytes::<1>(input)?[0] as usize;
    let mut bytes = [0; 8];
    let used = bytes.get_mut(..length).ok_or("an integer of more than 8 bytes")?;
    input.read_exact(used).map_err(text)?;
    let shift = 64 - 8 * length as u32;
    Ok(i64::from_le_bytes(bytes).checked_shl(shift).unwrap_or(0).checked_shr(shift).unwrap_or(0))
}

impl Machine {
    fn pop(&mut self) -> Parsed<Value> {
        self.stack.pop().ok_or_else(|| "the stack is empty".to_string())
    }

    fn pop_to_mark(&mut self) -> Parsed<Vec<Value>> {
        let mark = self.marks.pop().filter(|mark| *mark <= self.stack.len()).ok_or("a mark is missing")?;
        Ok(self.stack.split_off(mark))
    }

    fn pop_many(&mut self, count: usize) -> Parsed<Vec<Value>> {
        let start = self.stack.len().checked_sub(count).ok_or("the stack is too short")?;
        Ok(self.stack.split_off(start))
    }

    fn literal(&mut self, code: u8, input: &mut impl BufRead) -> Parsed<()> {
        let value = match code {
            b'c' => Value::Global(format!("{} {}", read_line(input)?, read_line(input)?)),
            b'X' | b'T' => {
                let length = u32::from_le_bytes(read_bytes(input)?);
                Value::Str(read_string(input, length.into())?)
            }
            b'U' => {
                let length = read_bytes::<1>(input)?[0];
                Value::Str(read_string(input, length.into())?)
            }
            b'J' => Value::Int(i32::from_le_bytes(read_bytes(input)?).into()),
            b'K' => Value::Int(read_bytes::<1>(input)?[0].into()),
            b'M' => Value::Int(u16::from_le_bytes(read_bytes(input)?).into()),
            b'G' => read_bytes::<8>(input).map(|_| Value::Other)?,
            0x8a => Value::Int(read_long(input)?),
            _ => return read_bytes::<1>(input).map(|_| ()), // the protocol's version
        };
        self.stack.push(value);
        Ok(())
    }

    fn memo(&mut self, code: u8, input: &mut impl BufRead) -> Parsed<()> {
        let key = match code {
            b'q' | b'h' => read_bytes::<1>(input)?[0].into(),
            _ => u32::from_le_bytes(read_bytes(input)?),
        };
        if matches!(code, b'q' | b'r') {
            let value = self.stack.last().ok_or("the stack is empty")?.clone();
            self.memo.insert(key, value);
        } else {
            let value = self.memo.get(&key).ok_or("an unknown memo entry")?.clone();
            self.stack.push(value);
        }
        Ok(())
    }

    fn combine(&mut self, code: u8) -> Parsed<()> {
        let value = match code {
            b'(' => {
                self.marks.push(self.stack.len());
                return Ok(());
            }
            b'a' => return self.pop_many(1).and_then(|values| self.extend(values)),
            b'e' => return self.pop_to_mark().and_then(|values| self.extend(values)),
            b's' => return self.pop_many(2).and_then(|values| self.insert(values)),
            b'u' => return self.pop_to_mark().and_then(|values| self.insert(values)),
            b'b' => return self.pop().map(|_| ()), // state beside the entries, as `_metadata`
            b')' => Value::Tuple(Vec::new()),
            b't' => Value::Tuple(self.pop_to_mark()?),
            0x85..=0x87 => Value::Tuple(self.pop_many(usize::from(code - 0x84))?),
            b']' => Value::List(Vec::new()),
            b'}' => Value::Dict(Vec::new()),
            b'N' | 0x88 | 0x89 => Value::Other,
            b'Q' => storage(self.pop()?)?,
            b'R' | 0x81 => {
                let arguments = self.pop()?;
                reduce(self.pop()?, arguments)?
            }
            other => return Err(format!("unknown pickle operation {other:#04x}")),
        };
        self.stack.push(value);
        Ok(())
    }

    fn extend(&mut self, values: Vec<Value>) -> Parsed<()> {
        let Some(Value::List(list)) = self.stack.last_mut() else { return Err("no list to append to".into()) };
        list.extend(values);
        Ok(())
    }

    fn insert(&mut self, values: Vec<Value>) -> Parsed<()> {
        match self.stack.last_mut() {
            Some(Value::Dict(entries)) => entries.extend(pairs(values)),
            Some(Value::Other) => {}
            _ => return Err("no dictionary to insert into".into()),
        }
        Ok(())
    }
}

fn pairs(values: Vec<Value>) -> Vec<(Value, Value)> {
    let mut values = values.into_iter();
    std::iter::from_fn(|| Some((values.next()?, values.next()?))).collect()
}

/// A persistent id: ("storage", class, key, location, length, view).
fn storage(id: Value) -> Parsed<Value> {
    let Value::Tuple(id) = id else { return Err("a persistent id is not a tuple".into()) };
    match id.as_slice() {
        [Value::Str(_), Value::Global(class), Value::Str(key), ..] => {
            Ok(Value::Storage(Storage { class: class.clone(), key: key.clone() }))
        }
        _ => Err("an unknown kind of storage".into()),
    }
}

/// Calls that matter are done; every other one gives [`Value::Other`].
fn reduce(callable: Value, arguments: Value) -> Parsed<Value> {
    let (Value::Global(name), Value::Tuple(mut arguments)) = (callable, arguments) else { return Ok(Value::Other) };
    match name.as_str() {
        "collections OrderedDict" => Ok(Value::Dict(arguments.pop().map_or(Vec::new(), entries))),
        "torch._utils _rebuild_tensor" | "torch._utils _rebuild_tensor_v2" => rebuild(&arguments),
        "torch._utils _rebuild_parameter" | "torch.nn.parameter Parameter" if !arguments.is_empty() => {
            Ok(arguments.swap_remove(0))
        }
        _ => Ok(Value::Other),
    }
}

/// The entries of a list of (key, value) lists.
fn entries(list: Value) -> Vec<(Value, Value)> {
    let Value::List(items) = list else { return Vec::new() };
    let entry = |item| match item {
        Value::List(pair) | Value::Tuple(pair) => pairs(pair).pop(),
        _ => None,
    };
    items.into_iter().filter_map(entry).collect()
}

fn rebuild(arguments: &[Value]) -> Parsed<Value> {
    let [Value::Storage(storage), Value::Int(offset), Value::Tuple(shape), Value::Tuple(strides), ..] = arguments
    else {
        return Err("a tensor of an unknown kind".into());
    };
    let (storage, shape, strides) = (storage.clone(), sizes(shape)?, sizes(strides)?);
    let offset = u64::try_from(*offset).map_err(text)?;
    Ok(Value::Tensor(Described { storage, offset, shape, strides }))
}

fn sizes(values: &[Value]) -> Parsed<Vec<u64>> {
    let size = |value: &Value| match value {
        Value::Int(size) => u64::try_from(*size).map_err(text),
        _ => Err("a size is not an integer".to_string()),
    };
    values.iter().map(size).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file as `torch.save` wrote it before version 1.6: an OrderedDict with one tensor "w" of
    /// 2x2 values from the second of its storage's five values on, with the given strides.
    fn legacy_file(strides: [u8; 2], values: usize) -> Vec<u8> {
        let mut file = LEGACY_MAGIC.to_vec();
        file.extend(b"\x80\x02M\xe9\x03."); // protocol 1001
        file.extend(b"\x80\x02}q\x01U\x0dlittle_endianq\x02\x88s.");
        file.extend(b"\x80\x02ccollections\nOrderedDict\nq\x00)Rq\x01(X\x01\x00\x00\x00wq\x02");
        file.extend(
            b"ctorch._utils\n_rebuild_tensor_v2\nq\x03((X\x07\x00\x00\x00storageq\x04ctorch\nFloatStorage\nq\x05",
        );
        file.extend(b"X\x02\x00\x00\x0042q\x06U\x03cpuq\x07\x8a\x01\x05NtQK\x01K\x02K\x02\x86");
        file.extend([b'K', strides[0], b'K', strides[1], 0x86]);
        file.extend(b"\x89NtRq\x08u}q\x09b.");
        file.extend(b"\x80\x02]q\x01X\x02\x00\x00\x0042q\x02a.");
        file.extend(5u64.to_le_bytes());
        file.extend((0..values).flat_map(|v| (v as f32).to_le_bytes()));
        file
    }

    fn read(bytes: &[u8], shape: &[usize]) -> Result<Tensor> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("file.pth");
        std::fs::write(&path, bytes).unwrap();
        Weights::open(&path)?.get(&["v".to_string(), "w".to_string()], shape, &Device::Cpu)
    }

    #[test]
    fn legacy_files_give_their_tensors() {
        let tensor = read(&legacy_file([2, 1], 5), &[2, 2]).unwrap();
        assert_eq!(tensor.to_vec2::<f32>().unwrap(), [[1.0, 2.0], [3.0, 4.0]]);
    }

    #[test]
    fn broken_legacy_files_are_errors() {
        let whole = legacy_file([2, 1], 5);
        for keep in 0..whole.len() {
            let error = read(&whole[..keep], &[2, 2]).unwrap_err();
            assert!(error.exit_code() == 3 && error.to_string().contains("file.pth"), "{keep}: {error}");
        }
        for i in LEGACY_MAGIC.len()..whole.len() {
            let mut file = whole.clone();
            file[i] ^= 0xff;
            let _ = read(&file, &[2, 2]); // an error or other values, never a panic
        }
        assert!(read(&legacy_file([1, 2], 5), &[2, 2]).unwrap_err().to_string().contains("not contiguous"));
        assert!(read(&whole, &[4]).unwrap_err().to_string().contains("w has shape [2, 2], expected [4]"));
    }
}
