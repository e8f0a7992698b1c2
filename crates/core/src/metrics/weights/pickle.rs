//! Unpickling as far as `torch.save` needs it: builds plain values and runs no code.
//!
//! A pickle of a few bytes can ask for any amount of memory: it copies what it has built from its memo, again and again.
//! What is built and copied is counted, and so is how deep it is nested.

use std::collections::HashMap;
use std::io::{BufRead, Read};

use candle_core::DType;

use super::{Parsed, Stored, dims, elements, text};

/// Longest string a pickle may hold; names of tensors are far shorter.
const MAX_STRING: u64 = 1 << 16;
/// Most bytes that all values of a pickle may take, copies included. A network of a thousand tensors takes about a
/// hundredth.
const MAX_BYTES: usize = 1 << 26;
/// Deepest nesting of values. An OrderedDict of parameters has five levels.
const MAX_DEPTH: usize = 16;

#[derive(Clone)]
pub(super) struct Storage {
    pub(super) class: String,
    pub(super) key: String,
}

impl Storage {
    /// Bytes of one number, and its type where it is read.
    fn element(&self) -> Parsed<(u64, Option<DType>)> {
        Ok(match self.class.strip_prefix("torch ").unwrap_or(&self.class) {
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

    /// About what it takes beside itself.
    fn bytes(&self) -> usize {
        self.class.len() + self.key.len()
    }

    pub(super) fn element_size(&self) -> Parsed<u64> {
        self.element().map(|(size, _)| size)
    }
}

/// A tensor as its pickle describes it; offset, shape and strides in elements.
#[derive(Clone)]
pub(super) struct Described {
    pub(super) storage: Storage,
    pub(super) offset: u64,
    pub(super) shape: Vec<u64>,
    pub(super) strides: Vec<u64>,
}

impl Described {
    /// The tensor's place in a file whose bytes from `start` on are its storage.
    pub(super) fn within(&self, start: u64, bytes: u64) -> Parsed<Stored> {
        let (size, dtype) = self.storage.element()?;
        let dtype = dtype.ok_or_else(|| format!("its numbers are of a {}, which is not read", self.storage.class))?;
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

impl Value {
    /// How many levels of values are in it, and about how many bytes it takes.
    fn extent(&self) -> (usize, usize) {
        let over = |values: &mut dyn Iterator<Item = &Value>| {
            let add =
                |(deep, bytes): (usize, usize), (depth, more): (usize, usize)| (deep.max(depth + 1), bytes + more);
            values.map(Value::extent).fold((1, 0), add)
        };
        let (depth, bytes) = match self {
            Value::Other | Value::Int(_) => (0, 0),
            Value::Str(text) | Value::Global(text) => (0, text.len()),
            Value::Tuple(values) | Value::List(values) => over(&mut values.iter()),
            Value::Dict(entries) => over(&mut entries.iter().flat_map(|(key, value)| [key, value])),
            Value::Storage(storage) => (0, storage.bytes()),
            Value::Tensor(tensor) => (0, tensor.storage.bytes() + 8 * (tensor.shape.len() + tensor.strides.len())),
        };
        (depth, bytes + size_of::<Value>())
    }
}

/// What a state dictionary holds by name; of dictionaries in it, as checkpoints have them, by `outer.inner`.
#[derive(Default)]
pub(super) struct Named {
    pub(super) tensors: Vec<(String, Described)>,
    pub(super) integers: HashMap<String, i64>,
}

/// The tensors and integers of a state dictionary.
pub(super) fn named(state: Value) -> Parsed<Named> {
    let Value::Dict(entries) = state else { return Err("no state dictionary".into()) };
    let mut named = Named::default();
    gather("", entries, &mut named);
    Ok(named)
}

fn gather(prefix: &str, entries: Vec<(Value, Value)>, named: &mut Named) {
    for (key, value) in entries {
        let Value::Str(name) = key else { continue };
        let name = format!("{prefix}{name}");
        match value {
            Value::Tensor(tensor) => named.tensors.push((name, tensor)),
            Value::Int(value) => drop(named.integers.insert(name, value)),
            Value::Dict(inner) => gather(&format!("{name}."), inner, named),
            _ => {}
        }
    }
}

/// The machine of one pickle (protocol 2, the operations that `torch.save` writes).
#[derive(Default)]
struct Machine {
    stack: Vec<Value>,
    /// Heights of the stack at the marks.
    marks: Vec<usize>,
    memo: HashMap<u32, Value>,
    /// Of [`MAX_BYTES`], so far.
    bytes: usize,
}

pub(super) fn unpickle(input: &mut impl BufRead) -> Parsed<Value> {
    let mut machine = Machine::default();
    loop {
        let code = read_bytes::<1>(input)?[0];
        machine.spend(size_of::<usize>())?;
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
    fn spend(&mut self, bytes: usize) -> Parsed<()> {
        self.bytes = self.bytes.saturating_add(bytes);
        if self.bytes > MAX_BYTES {
            return Err(format!("its description takes more than {} MiB", MAX_BYTES >> 20));
        }
        Ok(())
    }

    fn push(&mut self, value: Value) -> Parsed<()> {
        let (depth, bytes) = value.extent();
        check_depth(depth)?;
        self.spend(bytes)?;
        self.stack.push(value);
        Ok(())
    }

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
        self.push(value)
    }

    fn memo(&mut self, code: u8, input: &mut impl BufRead) -> Parsed<()> {
        let key = match code {
            b'q' | b'h' => read_bytes::<1>(input)?[0].into(),
            _ => u32::from_le_bytes(read_bytes(input)?),
        };
        let from = if matches!(code, b'q' | b'r') { self.stack.last() } else { self.memo.get(&key) };
        let (_, bytes) = from.ok_or("an unknown memo entry")?.extent();
        self.spend(bytes)?;
        match code {
            b'q' | b'r' => drop(self.memo.insert(key, self.stack[self.stack.len() - 1].clone())),
            _ => self.stack.push(self.memo[&key].clone()),
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
            b'd' => Value::Dict(pairs(self.pop_to_mark()?)),
            b'N' | 0x88 | 0x89 => Value::Other,
            b'Q' => storage(self.pop()?)?,
            b'R' | 0x81 => {
                let arguments = self.pop()?;
                reduce(self.pop()?, arguments)?
            }
            other => return Err(format!("unknown pickle operation {other:#04x}")),
        };
        self.push(value)
    }

    fn extend(&mut self, values: Vec<Value>) -> Parsed<()> {
        values.iter().try_for_each(|value| check_depth(value.extent().0 + 1))?;
        let Some(Value::List(list)) = self.stack.last_mut() else { return Err("no list to append to".into()) };
        list.extend(values);
        Ok(())
    }

    fn insert(&mut self, values: Vec<Value>) -> Parsed<()> {
        values.iter().try_for_each(|value| check_depth(value.extent().0 + 1))?;
        match self.stack.last_mut() {
            Some(Value::Dict(entries)) => entries.extend(pairs(values)),
            Some(Value::Other) => {}
            _ => return Err("no dictionary to insert into".into()),
        }
        Ok(())
    }
}

fn check_depth(depth: usize) -> Parsed<()> {
    let deep = || format!("values more than {MAX_DEPTH} deep in each other");
    (depth <= MAX_DEPTH).then_some(()).ok_or_else(deep)
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
        // A tensor of a type of its own: (the call that makes it, its type, that call's arguments, its state).
        "torch._tensor _rebuild_from_type_v2" if arguments.len() >= 3 => {
            let inner = arguments.swap_remove(2);
            reduce(arguments.swap_remove(0), inner)
        }
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
    if shape.len() != strides.len() {
        return Err(format!("a tensor of {} sizes and {} strides", shape.len(), strides.len()));
    }
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
