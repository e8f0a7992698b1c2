//! The parameters of a network, by name.

use candle_core::{Error, Result, Tensor, Var};

use crate::methods::Gradients;

/// Variables with their names, in the network's fixed order. Clones share the variables, so that a learner's updates
/// show in all of them.
#[derive(Clone)]
pub(crate) struct Parameters {
    pub(crate) variables: Vec<(String, Var)>,
}

impl Parameters {
    /// Creates variables with copies of `values`, for these names and shapes.
    ///
    /// # Errors
    /// If the number of values or a shape is wrong.
    pub(crate) fn new(expected: Vec<(String, Vec<usize>)>, values: Vec<Tensor>) -> Result<Parameters> {
        if values.len() != expected.len() {
            return Err(Error::Msg(format!("{} parameters given, {} expected", values.len(), expected.len())));
        }
        let variable = |((name, shape), value): ((String, Vec<usize>), Tensor)| match value.dims() == shape {
            // A variable itself would be shared, not copied.
            true => Ok((name, Var::from_tensor(&value.detach())?)),
            false => Err(Error::Msg(format!("{name} has shape {:?}, expected {shape:?}", value.dims()))),
        };
        let variables = expected.into_iter().zip(values).map(variable).collect::<Result<_>>()?;
        Ok(Parameters { variables })
    }

    /// Returns variables with the current values, which stay the same when these are trained.
    pub(crate) fn copy(&self) -> Result<Parameters> {
        let copy = |(name, var): &(String, Var)| Ok((name.clone(), Var::from_tensor(&var.as_detached_tensor())?));
        Ok(Parameters { variables: self.variables.iter().map(copy).collect::<Result<_>>()? })
    }

    /// Returns the gradients of a loss.
    pub(crate) fn gradients(&self, loss: &Tensor) -> crate::base::Result<Gradients> {
        let mut gradients = Gradients::none(self.variables.len());
        gradients.add(&self.variables, &loss.backward()?)?;
        Ok(gradients)
    }

    /// Returns the parameters as tensors, with gradients or without.
    pub(crate) fn tensors(&self, trainable: bool) -> Vec<Tensor> {
        let vars = self.variables.iter().map(|(_, var)| var);
        vars.map(|var| if trainable { var.as_tensor().clone() } else { var.as_detached_tensor() }).collect()
    }
}

/// Returns `x weight^T + bias`: x `[n, inputs]`, weight `[outputs, inputs]`, bias `[outputs]`. The bias is multiplied by ones,
/// because candle adds up a broadcast bias's gradient over rows number by number.
pub(crate) fn linear(x: &Tensor, weight: &Tensor, bias: &Tensor) -> candle_core::Result<Tensor> {
    let ones = Tensor::ones((x.dim(0)?, 1), x.dtype(), x.device())?;
    x.matmul(&weight.t()?)? + ones.matmul(&bias.unsqueeze(0)?)?
}

#[cfg(test)]
mod tests {
    use candle_core::{DType, Device};

    use super::*;

    #[test]
    fn values_that_do_not_fit_are_named() {
        let names = || vec![("a".to_string(), vec![2, 3]), ("b".into(), vec![4])];
        let zeros = |shape: &[usize]| Tensor::zeros(shape, DType::F32, &Device::Cpu).unwrap();
        let said = |values| Parameters::new(names(), values).err().unwrap().to_string();
        assert!(said(vec![zeros(&[2, 3])]).contains("1 parameters given, 2 expected"));
        assert!(said(vec![zeros(&[2, 3]), zeros(&[2, 2])]).contains("b has shape [2, 2], expected [4]"));
    }
}
