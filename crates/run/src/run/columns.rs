//! Flat records as text cells.

use serde::Serialize;
use serde_json::Value;

/// Returns the fields of a flat struct as text, in order; null gives an empty cell.
pub fn columns(row: &impl Serialize) -> Vec<(String, String)> {
    let Value::Object(fields) = serde_json::to_value(row).expect("plain data") else {
        unreachable!("rows are structs")
    };
    fields.iter().map(|(name, value)| (name.clone(), cell(value))).collect()
}

/// Returns a value as the text of a cell.
pub fn cell(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}
