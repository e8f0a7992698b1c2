//! The header of a safetensors file.

use std::collections::HashMap;
use std::fs::File;
use std::io::{BufReader, Read};

use candle_core::DType;
use serde::Deserialize;
use serde_json::Value;

use super::{Contents, Parsed, Stored, dims, elements, length, text};

/// Longest header: names, shapes and places of some ten thousand tensors.
const MAX_HEADER: u64 = 1 << 22;

/// A tensor as the header describes it; bytes from the header's end.
#[derive(Deserialize)]
struct Described {
    dtype: String,
    shape: Vec<u64>,
    data_offsets: [u64; 2],
}

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
    let Described { dtype, shape, data_offsets: [start, end] } = Described::deserialize(entry).map_err(text)?;
    let dtype = match dtype.as_str() {
        "F64" => DType::F64,
        "F32" => DType::F32,
        "F16" => DType::F16,
        "BF16" => DType::BF16,
        "I64" => DType::I64,
        "I32" => DType::I32,
        "I16" => DType::I16,
        "U32" => DType::U32,
        "U8" => DType::U8,
        other => return Err(format!("its numbers are {other}, which are not read")),
    };
    let bytes = end.checked_sub(start).filter(|_| end <= whole - data).ok_or("it reaches past the file")?;
    if elements(&shape, dtype, bytes).is_none_or(|count| count * dtype.size_in_bytes() as u64 != bytes) {
        return Err(format!("the header gives it {bytes} bytes and the shape {shape:?}"));
    }
    Ok(Stored { dtype, shape: dims(&shape), offset: data + start })
}
