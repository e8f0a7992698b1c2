//! Messages of event files: field numbers, and the encoding of fields.

/// Field numbers of `Event`.
pub(super) mod event {
    pub const WALL_TIME: u64 = 1;
    pub const STEP: u64 = 2;
    pub const FILE_VERSION: u64 = 3;
    pub const SUMMARY: u64 = 5;
    pub const SESSION_LOG: u64 = 7;
}

/// Field numbers of `SessionLog`, and the status that marks a restart.
pub(super) mod session_log {
    pub const STATUS: u64 = 1;
    pub const START: u64 = 1;
}

/// Field numbers of `Summary`.
pub(super) mod summary {
    pub const VALUE: u64 = 1;
}

/// Field numbers of `Summary.Value`.
pub(super) mod value {
    pub const TAG: u64 = 1;
    pub const SIMPLE_VALUE: u64 = 2;
    pub const IMAGE: u64 = 4;
    pub const TENSOR: u64 = 8;
    pub const METADATA: u64 = 9;
}

/// Field number of `SummaryMetadata`.
pub(super) mod metadata {
    pub const PLUGIN: u64 = 1;
}

/// Field numbers of `SummaryMetadata.PluginData`.
pub(super) mod plugin {
    pub const NAME: u64 = 1;
    pub const CONTENT: u64 = 2;
}

/// Field numbers of `TensorProto` and its shape, and the number of the type.
pub(super) mod tensor {
    pub const DTYPE: u64 = 1;
    pub const SHAPE: u64 = 2;
    pub const FLOATS: u64 = 5;
    pub const DIM: u64 = 2;
    pub const SIZE: u64 = 1;
    pub const FLOAT: u64 = 1;
}

/// Field numbers of `HParamsPluginData`.
pub(super) mod hparams {
    pub const SESSION_START: u64 = 3;
    pub const SESSION_END: u64 = 4;
}

/// Field numbers of `SessionStartInfo`.
pub(super) mod session_start {
    pub const HPARAMS: u64 = 1;
    pub const GROUP_NAME: u64 = 4;
    pub const TIME: u64 = 5;
}

/// Field numbers of `SessionEndInfo`, and the status of a finished run.
pub(super) mod session_end {
    pub const STATUS: u64 = 1;
    pub const TIME: u64 = 2;
    pub const SUCCESS: u64 = 1;
}

/// Field numbers of an entry of a map.
pub(super) mod map {
    pub const KEY: u64 = 1;
    pub const VALUE: u64 = 2;
}

/// Field numbers of `google.protobuf.Value`.
pub(super) mod any {
    pub const NUMBER: u64 = 2;
    pub const TEXT: u64 = 3;
    pub const FLAG: u64 = 4;
}

pub(super) fn any_value(setting: &toml::Value) -> Vec<u8> {
    match setting {
        toml::Value::Integer(number) => fixed64_field(any::NUMBER, *number as f64),
        toml::Value::Float(number) => fixed64_field(any::NUMBER, *number),
        toml::Value::Boolean(flag) => varint_field(any::FLAG, u64::from(*flag)),
        toml::Value::String(text) => bytes_field(any::TEXT, text.as_bytes()),
        other => bytes_field(any::TEXT, other.to_string().as_bytes()),
    }
}

/// Field numbers of `Summary.Image`.
pub(super) mod image {
    pub const HEIGHT: u64 = 1;
    pub const WIDTH: u64 = 2;
    pub const COLORSPACE: u64 = 3;
    pub const ENCODED: u64 = 4;
}

/// Encodes a number in base 128, lowest group first, with the top bit set on all but the last byte.
fn varint(mut number: u64) -> Vec<u8> {
    let mut bytes = Vec::new();
    while number >= 0x80 {
        bytes.push(number as u8 | 0x80);
        number >>= 7;
    }
    bytes.push(number as u8);
    bytes
}

pub(super) fn varint_field(field: u64, number: u64) -> Vec<u8> {
    [varint(field << 3), varint(number)].concat()
}

pub(super) fn fixed64_field(field: u64, number: f64) -> Vec<u8> {
    [varint(field << 3 | 1), number.to_le_bytes().to_vec()].concat()
}

pub(super) fn bytes_field(field: u64, bytes: &[u8]) -> Vec<u8> {
    [&varint(field << 3 | 2), &varint(bytes.len() as u64), bytes].concat()
}

pub(super) fn fixed32_field(field: u64, number: f32) -> Vec<u8> {
    [varint(field << 3 | 5), number.to_le_bytes().to_vec()].concat()
}
