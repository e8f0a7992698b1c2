//! Files of `torch.save` before PyTorch 1.6: a row of pickles followed by raw storages.

use std::collections::HashMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek};

use super::pickle::{Described, Storage, Value, named, unpickle};
use super::{Contents, Parsed, Stored, length, text};

/// `torch.save`'s magic number 0x1950a86a20f9469cfc6c as a complete pickle.
pub(super) const LEGACY_MAGIC: [u8; 15] =
    [0x80, 2, 0x8a, 10, 0x6c, 0xfc, 0x9c, 0x46, 0xf9, 0x20, 0x6a, 0xa8, 0x50, 0x19, b'.'];

/// Reads all that follows the magic number: the protocol version, facts about the machine, the
/// state dictionary, the storages' keys, then per key its length and values.
pub(super) fn read(file: &mut BufReader<&File>) -> Parsed<Contents> {
    let whole = length(file)?;
    for _ in 0..2 {
        unpickle(file)?;
    }
    let named = named(unpickle(file)?)?;
    let tensors = named.tensors;
    let Value::List(keys) = unpickle(file)? else { return Err("no list of storages".into()) };
    let storages: HashMap<&str, &Storage> =
        tensors.iter().map(|(_, tensor)| (tensor.storage.key.as_str(), &tensor.storage)).collect();
    let mut places = HashMap::new();
    for key in keys {
        let Value::Str(key) = key else { return Err("a storage key is not a string".into()) };
        let count = read_u64(file)?;
        let start = file.stream_position().map_err(text)?;
        let storage = storages.get(key.as_str()).ok_or("a storage belongs to no tensor")?;
        let bytes = count.checked_mul(storage.element_size()?).filter(|bytes| *bytes <= whole.saturating_sub(start));
        let bytes = bytes.ok_or("the file ends early")?;
        file.seek_relative(bytes as i64).map_err(text)?;
        places.insert(key, (start, bytes));
    }
    let tensors = tensors.into_iter().map(|(name, tensor)| (name, locate(&places, &tensor))).collect();
    Ok(Contents { tensors, integers: named.integers, ..Contents::default() })
}

fn read_u64(file: &mut BufReader<&File>) -> Parsed<u64> {
    let mut bytes = [0; 8];
    file.read_exact(&mut bytes).map_err(text)?;
    Ok(u64::from_le_bytes(bytes))
}

fn locate(places: &HashMap<String, (u64, u64)>, tensor: &Described) -> Parsed<Stored> {
    let (start, bytes) = *places.get(&tensor.storage.key).ok_or("a tensor has no storage")?;
    tensor.within(start, bytes)
}

#[cfg(test)]
mod tests {
    use super::LEGACY_MAGIC;
    use crate::base::Result;
    use crate::metrics::weights::Weights;
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
