//! The header of a safetensors file.

use std::collections::HashMap;
use std::fs::File;
use std::io::{BufReader, Read};

use candle_core::DType;
use safetensors::tensor::TensorInfo;
use serde::Deserialize;
use serde_json::Value;

use super::{Contents, Parsed, Stored, elements, length, text};

/// Longest header: names, shapes and places of some ten thousand tensors.
const MAX_HEADER: u64 = 1 << 22;

/// Reads the length of the header and the header.
pub(super) fn read(file: &mut BufReader<&File>) -> Parsed<Contents> {
    let whole = length(file)?;
    let mut bytes = [0; 8];
    file.read_exact(&mut bytes).map_err(text)?;
    let header = u64::from_le_bytes(bytes);
    let Some(data) = header.checked_add(8).filter(|data| *data <= whole && header <= MAX_HEADER) else {
        return Err(format!("a header of {header} bytes in a file of {whole}"));
    };
    let mut entries: HashMap<String, Value> = serde_json::from_reader(file.take(header)).map_err(text)?;
    entries.remove("__metadata__");
    let tensors = entries.into_iter().map(|(name, entry)| (name, place(entry, data, whole))).collect();
    Ok(Contents { tensors, ..Contents::default() })
}

fn place(entry: Value, data: u64, whole: u64) -> Parsed<Stored> {
    let TensorInfo { dtype, shape, data_offsets: (start, end) } = TensorInfo::deserialize(entry).map_err(text)?;
    let dtype = DType::try_from(dtype).map_err(text)?;
    let (start, end) = (start as u64, end as u64);
    let sizes: Vec<u64> = shape.iter().map(|&size| size as u64).collect();
    let bytes = end.checked_sub(start).filter(|_| end <= whole - data).ok_or("it reaches past the file")?;
    if elements(&sizes, dtype, bytes).is_none_or(|count| count * dtype.size_in_bytes() as u64 != bytes) {
        return Err(format!("the header gives it {bytes} bytes and the shape {shape:?}"));
    }
    Ok(Stored { dtype, shape, offset: data + start })
}
