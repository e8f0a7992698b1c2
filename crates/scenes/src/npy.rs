//! NumPy's `.npy` files: reads arrays of floating-point numbers, and writes the header of any array.

use std::path::Path;

use augnerf_base::input::read_bytes;
use augnerf_base::{Error, Result};

/// Largest size of an array in bytes. LLFF's has 136 per view.
const MOST_BYTES: u64 = 16 << 20;

/// An array of any dimensions, row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    /// Numbers along each dimension.
    pub shape: Vec<usize>,
    /// As many values as their product.
    pub values: Vec<f64>,
}

/// Reads a C-ordered array of little-endian float64 or float32.
pub fn read_array(path: &Path) -> Result<Array> {
    let bytes = read_bytes(path, MOST_BYTES).map_err(|e| Error::unreadable(path, &e))?;
    parse(&bytes).map_err(|what| Error::Data(format!("{}: {what}", path.display())))
}

/// Returns what precedes the values of a C-ordered array of `kind`, such as little-endian float32 (`<f4`): format
/// version 1.0.
pub fn header(kind: &str, shape: &[usize]) -> Vec<u8> {
    const PREFIX: usize = 10;
    let shape: Vec<String> = shape.iter().map(usize::to_string).collect();
    let mut header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({}), }}", shape.join(", "));
    // Data starts at a multiple of 64 bytes. The header ends with a newline.
    let padded = (PREFIX + header.len() + 1).next_multiple_of(64) - PREFIX;
    header.extend(std::iter::repeat_n(' ', padded - 1 - header.len()));
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((padded as u16).to_le_bytes());
    bytes.extend(header.into_bytes());
    bytes
}

fn parse(bytes: &[u8]) -> std::result::Result<Array, String> {
    let (header, data) = split_header(bytes)?;
    let width = match field(header, "descr")?.trim_matches(['\'', '"']) {
        "<f8" => 8,
        "<f4" => 4,
        other => {
            return Err(format!(
                "the array's type is {other}, but it must be float64 ('<f8') or float32 ('<f4'); \
                 save it again with .astype('float64')"
            ));
        }
    };
    if field(header, "fortran_order")? != "False" {
        return Err("the array is in Fortran order; save it again with numpy.ascontiguousarray".into());
    }
    let shape = shape(header)?;
    let expected = shape.iter().try_fold(width, |bytes: usize, side| bytes.checked_mul(*side));
    if expected != Some(data.len()) {
        let announced = shape.iter().map(usize::to_string).collect::<Vec<String>>().join(" x ");
        return Err(format!(
            "the header announces {announced} numbers of {width} bytes, but {} bytes follow it: \
             the file is truncated or damaged",
            data.len()
        ));
    }
    let values = match width {
        8 => data.as_chunks::<8>().0.iter().map(|b| f64::from_le_bytes(*b)).collect(),
        _ => data.as_chunks::<4>().0.iter().map(|b| f64::from(f32::from_le_bytes(*b))).collect(),
    };
    Ok(Array { shape, values })
}

/// Returns the header's text and the bytes after it.
fn split_header(bytes: &[u8]) -> std::result::Result<(&str, &[u8]), String> {
    if !bytes.starts_with(b"\x93NUMPY") {
        return Err("this is no .npy file: it does not start with \\x93NUMPY".into());
    }
    let truncated = || format!("the file ends inside its header, after {} bytes: it is truncated", bytes.len());
    let (start, length) = match bytes.get(6).copied() {
        Some(1) => {
            let length: [u8; 2] = bytes.get(8..10).and_then(|b| b.try_into().ok()).ok_or_else(truncated)?;
            (10, usize::from(u16::from_le_bytes(length)))
        }
        Some(2 | 3) => {
            let length: [u8; 4] = bytes.get(8..12).and_then(|b| b.try_into().ok()).ok_or_else(truncated)?;
            (12, u32::from_le_bytes(length) as usize)
        }
        Some(version) => return Err(format!("its format version is {version}; versions 1 to 3 are read")),
        None => return Err(truncated()),
    };
    let rest = &bytes[start..];
    if rest.len() < length {
        return Err(truncated());
    }
    let header = std::str::from_utf8(&rest[..length]).map_err(|_| "its header is not text: it is damaged")?;
    Ok((header, &rest[length..]))
}

/// Returns the text of one entry of the header's Python dictionary.
fn field<'a>(header: &'a str, key: &str) -> std::result::Result<&'a str, String> {
    let value = header.split_once(&format!("'{key}':")).map(|(_, rest)| rest.trim_start());
    let value = value.ok_or_else(|| format!("its header has no '{key}': {}", header.trim()))?;
    let end = if value.starts_with('(') { value.find(')').map(|i| i + 1) } else { value.find([',', '}']) };
    end.map(|end| value[..end].trim()).ok_or_else(|| format!("its header is damaged: {}", header.trim()))
}

fn shape(header: &str) -> std::result::Result<Vec<usize>, String> {
    let text = field(header, "shape")?;
    let sides = text.trim_matches(['(', ')']).split(',').map(str::trim).filter(|side| !side.is_empty());
    let sides: Option<Vec<usize>> = sides.map(|side| side.parse().ok()).collect();
    sides.ok_or_else(|| format!("the array's shape is {text}, but whole numbers are needed"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn file(descr: &str, order: &str, shape: &str, data: &[u8]) -> Vec<u8> {
        let header = format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}\n");
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.extend(data);
        bytes
    }

    #[test]
    fn both_widths_are_read() {
        let wide: Vec<u8> = [1.5f64, -2.0].iter().flat_map(|v| v.to_le_bytes()).collect();
        let narrow: Vec<u8> = [1.5f32, -2.0].iter().flat_map(|v| v.to_le_bytes()).collect();
        let expected = Array { shape: vec![1, 2], values: vec![1.5, -2.0] };
        assert_eq!(parse(&file("<f8", "False", "(1, 2)", &wide)), Ok(expected.clone()));
        assert_eq!(parse(&file("<f4", "False", "(1, 2)", &narrow)), Ok(expected));
    }

    #[test]
    fn messages_say_what_was_found() {
        for (bytes, word) in [
            (b"PK\x03\x04".to_vec(), "NUMPY"),
            (file("<i8", "False", "(1, 2)", &[0; 16]), "<i8"),
            (file("<f8", "True", "(1, 2)", &[0; 16]), "Fortran"),
            (file("<f8", "False", "(-2, 1)", &[0; 16]), "(-2, 1)"),
            (file("<f8", "False", "(1, 2)", &[0; 15]), "15 bytes"),
            (file("<f8", "False", "(18446744073709551615, 2)", &[0; 15]), "15 bytes"),
        ] {
            let message = parse(&bytes).unwrap_err();
            assert!(message.contains(word), "{message}");
        }
    }

    proptest! {
        #[test]
        fn no_bytes_panic(tail in proptest::collection::vec(any::<u8>(), 0..200), version in 0u8..5) {
            let mut bytes = b"\x93NUMPY".to_vec();
            bytes.push(version);
            bytes.extend(tail);
            let _ = parse(&bytes);
        }
    }
}
