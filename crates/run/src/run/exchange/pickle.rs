//! Writes files of `torch.save`: a zip archive with one pickle and a file for each tensor's numbers.

use std::io::{Cursor, Write};

use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// A value in a pickle.
pub enum Value {
    None,
    Bool(bool),
    Int(i64),
    Float(f64),
    List(Vec<Value>),
    Pair(Box<[Value; 2]>),
    Dict(Vec<(Key, Value)>),
    Tensor { shape: Vec<usize>, values: Vec<f32> },
}

/// A key of a dictionary.
pub enum Key {
    Name(String),
    Index(i64),
}

/// Returns a dictionary of named values.
pub fn dict<const N: usize>(entries: [(&str, Value); N]) -> Value {
    Value::Dict(entries.into_iter().map(|(name, value)| (Key::Name(name.into()), value)).collect())
}

/// Returns the bytes of a file for `torch.load`, also with `weights_only=True`.
pub fn torch_file(value: &Value) -> zip::result::ZipResult<Vec<u8>> {
    // Alignment of a tensor's numbers, so that they can be mapped into memory.
    const ALIGNMENT: u16 = 64;
    let mut pickle = Pickle { bytes: vec![0x80, 2], storages: Vec::new() };
    pickle.write(value);
    pickle.bytes.push(b'.');
    let options = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Stored)
        .with_alignment(ALIGNMENT)
        .large_file(false);
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    let mut add = |name: &str, bytes: &[u8]| {
        archive.start_file(format!("archive/{name}"), options)?;
        Ok::<(), zip::result::ZipError>(archive.write_all(bytes)?)
    };
    add("data.pkl", &pickle.bytes)?;
    add("byteorder", b"little")?;
    for (key, values) in pickle.storages.iter().enumerate() {
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        add(&format!("data/{key}"), &bytes)?;
    }
    add("version", b"3\n")?;
    Ok(archive.finish()?.into_inner())
}

/// A growing pickle of protocol 2, and the numbers that it refers to.
struct Pickle<'a> {
    bytes: Vec<u8>,
    storages: Vec<&'a [f32]>,
}

impl<'a> Pickle<'a> {
    fn write(&mut self, value: &'a Value) {
        match value {
            Value::None => self.bytes.push(b'N'),
            Value::Bool(value) => self.bytes.push(if *value { 0x88 } else { 0x89 }),
            Value::Int(value) => self.int(*value),
            Value::Float(value) => {
                self.bytes.push(b'G');
                self.bytes.extend(value.to_be_bytes());
            }
            Value::List(values) => {
                self.bytes.extend(b"](");
                values.iter().for_each(|value| self.write(value));
                self.bytes.push(b'e');
            }
            Value::Pair(values) => {
                values.iter().for_each(|value| self.write(value));
                self.bytes.push(0x86);
            }
            Value::Dict(entries) => {
                self.bytes.extend(b"}(");
                for (key, value) in entries {
                    match key {
                        Key::Name(name) => self.text(name),
                        Key::Index(index) => self.int(*index),
                    }
                    self.write(value);
                }
                self.bytes.push(b'u');
            }
            Value::Tensor { shape, values } => self.tensor(shape, values),
        }
    }

    /// Eight bytes, so that every step fits.
    fn int(&mut self, value: i64) {
        self.bytes.extend([0x8a, 8]);
        self.bytes.extend(value.to_le_bytes());
    }

    fn text(&mut self, text: &str) {
        self.bytes.push(b'X');
        self.bytes.extend((text.len() as u32).to_le_bytes());
        self.bytes.extend(text.bytes());
    }

    fn ints(&mut self, values: impl Iterator<Item = usize>) {
        self.bytes.push(b'(');
        values.for_each(|value| self.int(value as i64));
        self.bytes.push(b't');
    }

    /// Writes a call that makes a tensor of its storage, offset, shape and strides, without gradient and hooks.
    fn tensor(&mut self, shape: &[usize], values: &'a [f32]) {
        self.bytes.extend(b"ctorch._utils\n_rebuild_tensor_v2\n((");
        self.text("storage");
        self.bytes.extend(b"ctorch\nFloatStorage\n");
        self.text(&self.storages.len().to_string());
        self.text("cpu");
        self.int(values.len() as i64);
        self.bytes.extend(b"tQ");
        self.int(0);
        self.ints(shape.iter().copied());
        self.ints((0..shape.len()).map(|axis| shape[axis + 1..].iter().product()));
        self.bytes.extend(b"\x89ccollections\nOrderedDict\n)RtR");
        self.storages.push(values);
    }
}
