//! Gradients of a model's parameters.

use candle_core::backprop::GradStore;
use candle_core::{DType, Tensor, Var};

use crate::base::Result;
use crate::base::tensors::sum;

/// Gradients (or other tensors of the parameters' shapes) in the order of the model's variables; none where a parameter
/// has none.
pub struct Gradients(pub Vec<Option<Tensor>>);

impl Gradients {
    /// No gradients of so many parameters.
    pub fn none(parameters: usize) -> Gradients {
        Gradients(vec![None; parameters])
    }

    /// Adds those that a backward pass left for `variables`.
    pub fn add(&mut self, variables: &[(String, Var)], store: &GradStore) -> Result<()> {
        for ((_, var), total) in variables.iter().zip(&mut self.0) {
            if let Some(gradient) = store.get(var) {
                *total = sum(total.take(), Some(gradient.detach()))?;
            }
        }
        Ok(())
    }

    /// Adds others of the same model.
    pub fn merge(&mut self, other: Gradients) -> Result<()> {
        for (total, gradient) in self.0.iter_mut().zip(other.0) {
            *total = sum(total.take(), gradient)?;
        }
        Ok(())
    }

    /// Euclidean norm over all parameters.
    pub fn norm(&self) -> Result<f64> {
        let square = |gradient: &Tensor| -> Result<f64> {
            Ok(gradient.to_dtype(DType::F64)?.sqr()?.sum_all()?.to_scalar::<f64>()?)
        };
        Ok(self.0.iter().flatten().map(square).sum::<Result<f64>>()?.sqrt())
    }
}
