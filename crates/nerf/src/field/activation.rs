//! The function from raw density to density, and its derivatives.

use candle_core::{Result, Tensor};

use crate::base::tensors::relu;
use crate::field::settings::DensityActivation;

/// Derivatives of a loss in density, its gradient and its Laplacian. An absent one is 0.
#[derive(Default)]
pub struct Cotangents {
    /// `[n]`.
    pub density: Option<Tensor>,
    /// `[n, 3]`.
    pub gradient: Option<Tensor>,
    /// `[n]`.
    pub laplacian: Option<Tensor>,
}

/// Returns density from raw density, elementwise.
pub(super) fn activate_density(activation: DensityActivation, raw: &Tensor) -> Result<Tensor> {
    match activation {
        // max(NaN, 0) is 0. Adding 0 * raw, which is 0 or NaN, keeps NaN.
        DensityActivation::Relu => raw.relu()? + (raw * 0.0)?.detach(),
        DensityActivation::Softplus => softplus(&shifted(raw)?),
        // min(NaN, 11) is 11; NaN is kept as above.
        DensityActivation::Exp => bounded(&shifted(raw)?)?.exp()? + (raw * 0.0)?.detach(),
    }
}

/// MipNeRF starts from thin air: softplus(raw - 1).
fn shifted(raw: &Tensor) -> Result<Tensor> {
    raw.affine(1.0, -1.0)
}

/// Largest exponent of [`DensityActivation::Exp`].
const LARGEST_EXPONENT: f64 = 11.0;

/// Returns x, or the largest exponent, which has no gradient.
fn bounded(x: &Tensor) -> Result<Tensor> {
    let is_below = x.detach().lt(LARGEST_EXPONENT)?;
    is_below.where_cond(x, &(x.zeros_like()? + LARGEST_EXPONENT)?)
}

/// Returns ln(1 + exp(x)) without overflow.
fn softplus(x: &Tensor) -> Result<Tensor> {
    x.relu()? + (x.abs()?.neg()?.exp()? + 1.0)?.log()?
}

/// An activation at `n` points, with its first three derivatives in raw density, each `[n]`.
pub(super) struct Activated {
    pub(super) value: Tensor,
    first: Tensor,
    /// Second and third derivative. `None` if they are 0.
    curved: Option<(Tensor, Tensor)>,
}

impl Activated {
    pub(super) fn new(activation: DensityActivation, raw: &Tensor) -> Result<Activated> {
        let value = match activation {
            // With slope 0 at 0, as the first derivative below.
            DensityActivation::Relu => relu(raw)?,
            _ => activate_density(activation, raw)?,
        };
        match activation {
            DensityActivation::Relu => {
                let first = raw.detach().gt(0f64)?.to_dtype(raw.dtype())?;
                Ok(Activated { value, first, curved: None })
            }
            DensityActivation::Softplus => {
                let first = candle_nn::ops::sigmoid(&shifted(raw)?)?;
                let second = (&first * first.affine(-1.0, 1.0)?)?;
                let third = (&second * first.affine(-2.0, 1.0)?)?;
                Ok(Activated { value, first, curved: Some((second, third)) })
            }
            // All derivatives of exp are exp itself, and 0 beyond the bound.
            DensityActivation::Exp => {
                let is_below = shifted(raw)?.detach().lt(LARGEST_EXPONENT)?.to_dtype(raw.dtype())?;
                let first = (&value * is_below)?;
                Ok(Activated { value, curved: Some((first.clone(), first.clone())), first })
            }
        }
    }

    /// Returns gradient `[n, 3]` and Laplacian `[n]` of density a(raw) from those of raw density: a' grad, and a'
    /// Laplacian + a'' |grad|^2.
    pub(super) fn chain(&self, gradient: &Tensor, laplacian: &Tensor) -> Result<(Tensor, Tensor)> {
        let chained = gradient.broadcast_mul(&self.first.unsqueeze(1)?)?;
        let mut curved = (laplacian * &self.first)?;
        if let Some((second, _)) = &self.curved {
            curved = (curved + (second * gradient.sqr()?.sum(1)?)?)?;
        }
        Ok((chained, curved))
    }

    /// Returns the derivatives of a loss in raw density, its gradient and its Laplacian, from those in density, its
    /// gradient and its Laplacian.
    pub(super) fn backward(&self, loss: &Cotangents, gradient: &Tensor, laplacian: &Tensor) -> Result<Cotangents> {
        let scaled = |tensor: &Option<Tensor>| tensor.as_ref().map(|tensor| tensor * &self.first).transpose();
        let columns = self.first.unsqueeze(1)?;
        let mut raw = Cotangents {
            density: scaled(&loss.density)?,
            gradient: loss.gradient.as_ref().map(|d| d.broadcast_mul(&columns)).transpose()?,
            laplacian: scaled(&loss.laplacian)?,
        };
        let Some((second, third)) = &self.curved else { return Ok(raw) };
        if let Some(d) = &loss.gradient {
            // a' scales the gradient: d/d raw = a'' grad . d
            add(&mut raw.density, (second * (d * gradient)?.sum(1)?)?)?;
        }
        if let Some(d) = &loss.laplacian {
            let curvature = ((second * laplacian)? + (third * gradient.sqr()?.sum(1)?)?)?;
            add(&mut raw.density, (curvature * d)?)?;
            // d/d grad of a'' |grad|^2
            let along = gradient.broadcast_mul(&((second * d)? * 2.0)?.unsqueeze(1)?)?;
            add(&mut raw.gradient, along)?;
        }
        Ok(raw)
    }
}

fn add(sum: &mut Option<Tensor>, term: Tensor) -> Result<()> {
    *sum = Some(match sum.take() {
        Some(sum) => (sum + term)?,
        None => term,
    });
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;

    #[test]
    fn nan_is_not_taken_for_empty_space() {
        for activation in [DensityActivation::Relu, DensityActivation::Softplus, DensityActivation::Exp] {
            let raw = Tensor::new(&[f32::NAN, -1.0, 2.0], &Device::Cpu).unwrap();
            let density = activate_density(activation, &raw).unwrap().to_vec1::<f32>().unwrap();
            assert!(density[0].is_nan() && density[1] >= 0.0 && density[2] > 0.0, "{activation:?}: {density:?}");
        }
    }
}
