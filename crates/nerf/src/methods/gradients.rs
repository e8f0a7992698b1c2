//! Gradients of a model's parameters.

use candle_core::backprop::GradStore;
use candle_core::{DType, Tensor, Var};
use rayon::prelude::*;

use crate::base::Result;
use crate::base::tensors::{sum, with_values};

/// Gradients (or other tensors of the parameters' shapes) in the order of the model's variables. An entry is `None` if
/// a parameter has no gradient.
pub struct Gradients(pub Vec<Option<Tensor>>);

impl Gradients {
    /// Returns empty gradients of this many parameters.
    pub fn none(parameters: usize) -> Gradients {
        Gradients(vec![None; parameters])
    }

    /// Adds the gradients of `variables` from a backward pass.
    pub fn add(&mut self, variables: &[(String, Var)], store: &GradStore) -> Result<()> {
        for ((_, var), total) in variables.iter().zip(&mut self.0) {
            if let Some(gradient) = store.get(var) {
                *total = sum(total.take(), Some(gradient.detach()))?;
            }
        }
        Ok(())
    }

    /// Sums the gradients of parts of a step, in their order. The bits do not depend on the number of threads, which
    /// share the parameters.
    pub fn sum(parts: Vec<Gradients>) -> Result<Gradients> {
        let parameters = parts.first().map_or(0, |part| part.0.len());
        let sum_of_parameter = |index: usize| {
            let summands: Vec<&Tensor> = parts.iter().filter_map(|part| part.0[index].as_ref()).collect();
            sum_of(&summands)
        };
        Ok(Gradients((0..parameters).into_par_iter().map(sum_of_parameter).collect::<Result<_>>()?))
    }

    /// Adds other gradients of the same model.
    pub fn merge(&mut self, other: Gradients) -> Result<()> {
        for (total, gradient) in self.0.iter_mut().zip(other.0) {
            *total = sum(total.take(), gradient)?;
        }
        Ok(())
    }

    /// Returns the Euclidean norm over all parameters.
    pub fn norm(&self) -> Result<f64> {
        let square = |gradient: &Tensor| -> Result<f64> {
            Ok(gradient.to_dtype(DType::F64)?.sqr()?.sum_all()?.to_scalar::<f64>()?)
        };
        Ok(self.0.iter().flatten().map(square).sum::<Result<f64>>()?.sqrt())
    }
}

/// Sums tensors of one shape in their order. Returns `None` without tensors.
fn sum_of(tensors: &[&Tensor]) -> Result<Option<Tensor>> {
    let Some((&first, rest)) = tensors.split_first() else { return Ok(None) };
    let Some(mut total) = with_values(first, <[f32]>::to_vec) else {
        return rest.iter().try_fold(Some(first.clone()), |total, &other| sum(total, Some(other.clone())));
    };
    for other in rest {
        let other = other.contiguous()?;
        with_values(&other, |values| total.iter_mut().zip(values).for_each(|(total, value)| *total += value))
            .expect("all are of one kind");
    }
    Ok(Some(Tensor::from_vec(total, first.shape(), first.device())?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;

    /// Parts that have a gradient or not, one of them seen through a transposition: candle's sums, to the bit.
    #[test]
    fn parts_add_up_in_their_order() {
        let values = |part: usize| -> Vec<f32> { (0..6).map(|i| ((i * 7 + part * 13) as f32).sin() * 1e3).collect() };
        for dtype in [DType::F32, DType::F64] {
            let tensor = |part: usize| {
                let tensor = Tensor::from_vec(values(part), (2, 3), &Device::Cpu).unwrap().to_dtype(dtype).unwrap();
                if part == 2 { tensor.t().unwrap().contiguous().unwrap().t().unwrap() } else { tensor }
            };
            let part = |part: usize| Gradients(vec![(part != 1).then(|| tensor(part)), None]);
            let sum = Gradients::sum((0..4).map(part).collect()).unwrap();
            let expected = (((tensor(0) + tensor(2)).unwrap()) + tensor(3)).unwrap();
            let bits = |tensor: &Tensor| tensor.to_dtype(DType::F64).unwrap().to_vec2::<f64>().unwrap();
            assert_eq!(bits(sum.0[0].as_ref().unwrap()), bits(&expected), "{dtype:?}");
            assert!(sum.0[1].is_none());
        }
    }
}
