//! Flat records as cells of text.

use serde::Serialize;
use serde_json::Value;

/// The fields of a flat struct as text, in their order; null is an empty cell.
pub fn columns(row: &impl Serialize) -> Vec<(String, String)> {
    let Value::Object(fields) = serde_json::to_value(row).expect("plain data") else {
        unreachable!("rows are structs")
    };
    fields.iter().map(|(name, value)| (name.clone(), cell(value))).collect()
}

/// A value as a cell's text.
pub(super) fn cell(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}
