//! Files of PyTorch's `torch.save`: zip archives since PyTorch 1.6, before that a row of pickles followed by storages.
//!
//! candle's unpickler builds plain values and runs no code. But a pickle of a few bytes can ask for any amount of memory:
//! it copies what it has built from its memo, again and again. So candle gets one operation at a time, and what each
//! leaves is counted.

use std::collections::HashMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};

use candle_core::DType;
use candle_core::pickle::{Object, Stack};
use zip::{CompressionMethod, ZipArchive};

use super::{Contents, Parsed, Stored, dims, elements, length, text};

/// `torch.save`'s magic number 0x1950a86a20f9469cfc6c as a complete pickle, the start of files before PyTorch 1.6.
const LEGACY_MAGIC: [u8; 15] = [0x80, 2, 0x8a, 10, 0x6c, 0xfc, 0x9c, 0x46, 0xf9, 0x20, 0x6a, 0xa8, 0x50, 0x19, b'.'];
/// The pickle's name below an archive's one folder.
const PICKLE: &str = "/data.pkl";
/// Longest pickles of a file. A tensor takes about 300 bytes.
const MAX_PICKLE: u64 = 1 << 22;
/// Most bytes that all values of a pickle may take, copies included. A network of a thousand tensors takes about a third.
const MAX_BYTES: usize = 1 << 26;
/// Deepest nesting of values. A checkpoint's Adam state has about ten levels.
const MAX_DEPTH: usize = 16;

/// A tensor as its pickle describes it; offset, shape and strides in elements.
struct Described {
    /// Class of the storage, such as `FloatStorage`.
    class: String,
    key: String,
    offset: u64,
    shape: Vec<u64>,
    strides: Vec<u64>,
}

type Archive<'a, 'b> = ZipArchive<&'a mut BufReader<&'b File>>;
/// First byte and length of a storage in a file.
type Place = (u64, u64);

pub(super) fn read(file: &mut BufReader<&File>) -> Parsed<Contents> {
    let mut magic = [0; LEGACY_MAGIC.len()];
    file.read_exact(&mut magic).map_err(text)?;
    if magic == LEGACY_MAGIC { legacy(file) } else { archive(file) }
}

fn archive(file: &mut BufReader<&File>) -> Parsed<Contents> {
    let mut archive = ZipArchive::new(file).map_err(text)?;
    let pickle = archive.file_names().flatten().find(|name| name.ends_with(PICKLE)).map(String::from);
    let pickle = pickle.ok_or("it has no data.pkl")?;
    let (_, size) = place(&mut archive, &pickle)?;
    if size > MAX_PICKLE {
        return Err(format!("its description has {size} bytes, more than {} MiB", MAX_PICKLE >> 20));
    }
    let mut bytes = Vec::new();
    archive.by_name(&pickle).map_err(text)?.read_to_end(&mut bytes).map_err(text)?;
    let (tensors, integers) = named(unpickle(&mut &bytes[..])?)?;
    let folder = pickle.strip_suffix(PICKLE).unwrap_or_default();
    let locate = |tensor: Described| {
        let found = place(&mut archive, &format!("{folder}/data/{}", tensor.key))?;
        tensor.within(found)
    };
    Ok(contents(tensors, integers, locate))
}

fn place(archive: &mut Archive, name: &str) -> Parsed<Place> {
    let file = archive.by_name(name).map_err(|e| format!("{name}: {e}"))?;
    if file.compression() != CompressionMethod::Stored {
        return Err(format!("{name} is packed, which torch.save never does"));
    }
    let start = file.data_start().ok_or_else(|| format!("{name} has no data"))?;
    Ok((start, file.size()))
}

/// Reads what follows the magic number: protocol version, facts about the machine, state dictionary, keys of the storages;
/// then each storage's count and numbers.
fn legacy(file: &mut BufReader<&File>) -> Parsed<Contents> {
    let whole = length(file)?;
    let mut bytes = Vec::new();
    file.take(MAX_PICKLE).read_to_end(&mut bytes).map_err(text)?;
    let mut pickles = &bytes[..];
    unpickle(&mut pickles)?;
    unpickle(&mut pickles)?;
    let (tensors, integers) = named(unpickle(&mut pickles)?)?;
    let Object::List(keys) = unpickle(&mut pickles)? else { return Err("no list of storages".into()) };
    let mut start = (LEGACY_MAGIC.len() + bytes.len() - pickles.len()) as u64;
    let class = |(_, tensor): &(String, Parsed<Described>)| {
        tensor.as_ref().map(|tensor| (tensor.key.clone(), tensor.class.clone())).map_err(Clone::clone)
    };
    let classes: HashMap<String, String> = tensors.iter().map(class).collect::<Parsed<_>>()?;
    let mut places: HashMap<String, Place> = HashMap::new();
    for key in keys {
        let Object::Unicode(key) = key else { return Err("a storage key is not a string".into()) };
        let mut count = [0; 8];
        file.seek(SeekFrom::Start(start)).and_then(|_| file.read_exact(&mut count)).map_err(text)?;
        start += 8;
        let (size, _) = element(classes.get(&key).ok_or("a storage belongs to no tensor")?)?;
        let bytes = u64::from_le_bytes(count).checked_mul(size).filter(|bytes| *bytes <= whole.saturating_sub(start));
        let bytes = bytes.ok_or("the file ends early")?;
        places.insert(key, (start, bytes));
        start += bytes;
    }
    let locate = |tensor: Described| tensor.within(*places.get(&tensor.key).ok_or("a tensor has no storage")?);
    Ok(contents(tensors, integers, locate))
}

fn contents(
    tensors: Vec<(String, Parsed<Described>)>,
    integers: HashMap<String, i64>,
    mut locate: impl FnMut(Described) -> Parsed<Stored>,
) -> Contents {
    let tensors = tensors.into_iter().map(|(name, tensor)| (name, tensor.and_then(&mut locate))).collect();
    Contents { tensors, integers }
}

/// Builds the value of the next pickle.
fn unpickle(pickle: &mut &[u8]) -> Parsed<Object> {
    const ENDS: &str = "its description ends early";
    // candle's errors may quote all that it has built.
    let brief = |error: candle_core::Error| error.to_string().chars().take(200).collect::<String>();
    let (mut stack, mut spent) = (Stack::empty(), 0);
    loop {
        let code = *pickle.first().ok_or(ENDS)?;
        match code {
            b'.' => {
                *pickle = &pickle[1..];
                return stack.finalize().map_err(brief);
            }
            // candle would take memory for any length, and does not know the short strings of Python 2.
            b'X' | b'U' => {
                let head = if code == b'X' { 5 } else { 2 };
                let length =
                    pickle.get(1..head).ok_or(ENDS)?.iter().rev().fold(0, |sum, byte| sum << 8 | usize::from(*byte));
                let string = pickle.get(head..head + length).ok_or(ENDS)?;
                let long = [b"X", &(length as u32).to_le_bytes()[..], string].concat();
                stack.read(&mut &long[..]).map_err(brief)?;
                *pickle = &pickle[head + length..];
            }
            0x8a if pickle.get(1).is_none_or(|bytes| *bytes > 8) => {
                return Err("an integer of more than 8 bytes".into());
            }
            // An OrderedDict of Python 2 is called with its entries, which candle leaves out; NEWOBJ keeps them.
            b'R' if !matches!(stack.stack().last(), Some(Object::Tuple(args)) if args.is_empty()) => {
                stack.read(&mut &[0x81][..]).map_err(brief)?;
                *pickle = &pickle[1..];
            }
            _ => drop(stack.read(pickle).map_err(brief)?),
        }
        let (depth, bytes) = stack.stack().last().map_or((0, 0), extent);
        if depth > MAX_DEPTH {
            return Err(format!("values more than {MAX_DEPTH} deep in each other"));
        }
        spent += bytes + size_of::<Object>();
        if spent > MAX_BYTES {
            return Err(format!("its description takes more than {} MiB", MAX_BYTES >> 20));
        }
    }
}

/// Returns how many levels of values are in a value, and about how many bytes it takes.
fn extent(value: &Object) -> (usize, usize) {
    let over = |values: &mut dyn Iterator<Item = &Object>| {
        let add = |(deep, sum): (usize, usize), (depth, bytes): (usize, usize)| (deep.max(depth + 1), sum + bytes);
        values.map(extent).fold((1, 0), add)
    };
    let (depth, bytes) = match value {
        Object::Unicode(text) => (0, text.len()),
        Object::Class { module_name, class_name } => (0, module_name.len() + class_name.len()),
        Object::Tuple(values) | Object::List(values) => over(&mut values.iter()),
        Object::Dict(entries) => over(&mut entries.iter().flat_map(|(key, value)| [key, value])),
        Object::Reduce { callable, args } | Object::Build { callable, args } => {
            over(&mut [&**callable, args].into_iter())
        }
        Object::PersistentLoad(id) => over(&mut [&**id].into_iter()),
        _ => (0, 0),
    };
    (depth, bytes + size_of::<Object>())
}

/// Tensors and integers by name.
type Named = (Vec<(String, Parsed<Described>)>, HashMap<String, i64>);

/// Returns what a state dictionary holds; of dictionaries in it, as checkpoints have them, by `outer.inner`.
fn named(state: Object) -> Parsed<Named> {
    let mut named = Named::default();
    gather("", entries(state).ok_or("no state dictionary")?, &mut named);
    Ok(named)
}

fn gather(prefix: &str, entries_here: Vec<(Object, Object)>, named: &mut Named) {
    for (key, value) in entries_here {
        let Object::Unicode(name) = key else { continue };
        let name = format!("{prefix}{name}");
        match value {
            Object::Int(value) => drop(named.1.insert(name, value.into())),
            Object::Long(value) => drop(named.1.insert(name, value)),
            value => match described(&value) {
                Some(tensor) => named.0.push((name, tensor)),
                None => gather(&format!("{name}."), entries(value).unwrap_or_default(), named),
            },
        }
    }
}

/// Returns the entries of a dictionary, also of one that was called with them as lists of key and value.
fn entries(value: Object) -> Option<Vec<(Object, Object)>> {
    match value {
        Object::Dict(entries) => Some(entries),
        Object::Build { callable, .. } => entries(*callable),
        Object::Reduce { callable, args } if matches!(&*callable, Object::Class { class_name, .. } if class_name == "OrderedDict") =>
        {
            let Object::List(items) = args.tuple().ok()?.pop()? else { return None };
            let pair = |item| match item {
                Object::List(mut pair) | Object::Tuple(mut pair) => {
                    pair.pop().zip(pair.pop()).map(|(value, key)| (key, value))
                }
                _ => None,
            };
            Some(items.into_iter().filter_map(pair).collect())
        }
        _ => None,
    }
}

/// Returns the tensor that a value describes as a call, or why it cannot be read.
fn described(value: &Object) -> Option<Parsed<Described>> {
    let Object::Reduce { callable, args } = value else { return None };
    rebuilt(callable, args)
}

fn rebuilt(callable: &Object, args: &Object) -> Option<Parsed<Described>> {
    let (Object::Class { module_name, class_name }, Object::Tuple(args)) = (callable, args) else { return None };
    match (&**module_name, &**class_name, &args[..]) {
        ("torch._utils", "_rebuild_tensor" | "_rebuild_tensor_v2", args) => Some(tensor(args)),
        // A tensor of a type of its own: (the call that makes it, its type, that call's arguments, its state).
        ("torch._tensor", "_rebuild_from_type_v2", [call, _, args, ..]) => rebuilt(call, args),
        ("torch._utils", "_rebuild_parameter", [tensor, ..]) => described(tensor),
        ("torch.nn.parameter", "Parameter", [tensor, ..]) => described(tensor),
        _ => None,
    }
}

/// Arguments: a storage as ("storage", class, key, location, length), offset, shape, strides, and others.
fn tensor(args: &[Object]) -> Parsed<Described> {
    let [Object::PersistentLoad(storage), offset, Object::Tuple(shape), Object::Tuple(strides), ..] = args else {
        return Err("a tensor of an unknown kind".into());
    };
    let Object::Tuple(storage) = &**storage else { return Err("an unknown kind of storage".into()) };
    let [_, Object::Class { class_name, .. }, Object::Unicode(key), ..] = &storage[..] else {
        return Err("an unknown kind of storage".into());
    };
    if shape.len() != strides.len() {
        return Err(format!("a tensor of {} sizes and {} strides", shape.len(), strides.len()));
    }
    let size = |value: &Object| {
        let size = value.clone().int_or_long().ok().and_then(|size| u64::try_from(size).ok());
        size.ok_or_else(|| "a size is not a positive integer".to_string())
    };
    let sizes = |values: &[Object]| values.iter().map(size).collect::<Parsed<Vec<u64>>>();
    let (class, key, offset) = (class_name.clone(), key.clone(), size(offset)?);
    Ok(Described { class, key, offset, shape: sizes(shape)?, strides: sizes(strides)? })
}

/// Bytes of one number of a storage, and its type where it is read.
fn element(class: &str) -> Parsed<(u64, Option<DType>)> {
    Ok(match class {
        "DoubleStorage" => (8, Some(DType::F64)),
        "FloatStorage" => (4, Some(DType::F32)),
        "HalfStorage" => (2, Some(DType::F16)),
        "BFloat16Storage" => (2, Some(DType::BF16)),
        "LongStorage" => (8, Some(DType::I64)),
        "IntStorage" => (4, Some(DType::I32)),
        "ShortStorage" => (2, Some(DType::I16)),
        "ByteStorage" => (1, Some(DType::U8)),
        "CharStorage" | "BoolStorage" => (1, None),
        other => return Err(format!("unknown storage class {other}")),
    })
}

impl Described {
    /// Returns the tensor's place in a file from that of its storage.
    fn within(&self, (start, bytes): Place) -> Parsed<Stored> {
        let (size, dtype) = element(&self.class)?;
        let dtype = dtype.ok_or_else(|| format!("its numbers are of a {}, which is not read", self.class))?;
        let count = elements(&self.shape, dtype, bytes).ok_or("it reaches past its storage")?;
        if self.offset.checked_add(count).is_none_or(|end| end > bytes / size) {
            return Err("it reaches past its storage".into());
        }
        let mut expected = 1u64;
        for (size, stride) in self.shape.iter().zip(&self.strides).rev() {
            if *size > 1 && *stride != expected {
                return Err("it is not contiguous".into());
            }
            expected = expected.saturating_mul((*size).max(1));
        }
        Ok(Stored { dtype, shape: dims(&self.shape), offset: start + self.offset * size })
    }
}

#[cfg(test)]
mod tests {
    use super::LEGACY_MAGIC;
    use crate::metrics::weights::Weights;
    use augnerf_base::Result;
    use candle_core::{Device, Tensor};

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
