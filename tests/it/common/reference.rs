//! Tensors that other programs wrote: `tests/fixtures/*.safetensors`.

use std::collections::HashMap;

use candle_core::{Device, Tensor, safetensors};

use super::flat;

/// One file of them, by name.
pub struct Reference(HashMap<String, Tensor>);

impl Reference {
    /// Reads `tests/fixtures/NAME.safetensors`.
    pub fn load(name: &str) -> Reference {
        let path = format!("{}/tests/fixtures/{name}.safetensors", env!("CARGO_MANIFEST_DIR"));
        Reference(safetensors::load(path, &Device::Cpu).unwrap())
    }

    /// A tensor in the precision it was written in.
    pub fn get(&self, name: &str) -> Tensor {
        self.find(name).unwrap_or_else(|| panic!("{name} is not in the reference"))
    }

    /// The same where there is one.
    pub fn find(&self, name: &str) -> Option<Tensor> {
        self.0.get(name).cloned()
    }

    /// A tensor's numbers, row by row.
    pub fn values(&self, name: &str) -> Vec<f64> {
        flat(&self.get(name))
    }
}
