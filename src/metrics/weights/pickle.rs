//! Unpickling as far as `torch.save` needs it: builds plain values and runs no code.

use std::collections::HashMap;
use std::io::{BufRead, Read};

use super::{Parsed, text};

/// Longest string a pickle may hold; names of tensors are far shorter.
const MAX_STRING: u64 = 1 << 16;

#[derive(Clone)]
pub(super) struct Storage {
    pub(super) class: String,
    pub(super) key: String,
}

/// A tensor as its pickle describes it; offset, shape and strides in elements.
#[derive(Clone)]
pub(super) struct Described {
    pub(super) storage: Storage,
    pub(super) offset: u64,
    pub(super) shape: Vec<u64>,
    pub(super) strides: Vec<u64>,
}

/// What a pickle can build here.
#[derive(Clone)]
pub(super) enum Value {
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

pub(super) fn unpickle(input: &mut impl BufRead) -> Parsed<Value> {
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
