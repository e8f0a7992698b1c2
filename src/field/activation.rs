//! What turns raw density into density, and how derivatives pass through it.

use candle_core::{Result, Tensor};

use crate::settings::DensityActivation;

/// Derivatives of a loss in density, its gradient and its Laplacian; what is absent is 0.
#[derive(Default)]
pub struct Cotangents {
    /// `[n]`.
    pub density: Option<Tensor>,
    /// `[n, 3]`.
    pub gradient: Option<Tensor>,
    /// `[n]`.
    pub laplacian: Option<Tensor>,
}

/// Density from raw density, elementwise.
pub(super) fn activate_density(activation: DensityActivation, raw: &Tensor) -> Result<Tensor> {
    match activation {
        // max(NaN, 0) is 0: adding 0 * raw, which is 0 or NaN, keeps what went wrong in sight.
        DensityActivation::Relu => raw.relu()? + (raw * 0.0)?.detach(),
        DensityActivation::Softplus => softplus(&shifted(raw)?),
    }
}

/// MipNeRF starts from thin air: softplus(raw - 1).
fn shifted(raw: &Tensor) -> Result<Tensor> {
    raw.affine(1.0, -1.0)
}

/// ln(1 + exp(x)) without overflow.
fn softplus(x: &Tensor) -> Result<Tensor> {
    x.relu()? + (x.abs()?.neg()?.exp()? + 1.0)?.log()?
}

/// An activation at `n` points with its first three derivatives in raw density, each `[n]`.
pub(super) struct Activated {
    pub(super) value: Tensor,
    first: Tensor,
    /// Second and third; none where they are 0.
    curved: Option<(Tensor, Tensor)>,
}

impl Activated {
    pub(super) fn new(activation: DensityActivation, raw: &Tensor) -> Result<Activated> {
        let value = activate_density(activation, raw)?;
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
        }
    }

    /// Gradient `[n, 3]` and Laplacian `[n]` of density a(raw) from those of raw density:
    /// a' grad, a' Laplacian + a'' |grad|^2.
    pub(super) fn chain(&self, gradient: &Tensor, laplacian: &Tensor) -> Result<(Tensor, Tensor)> {
        let chained = gradient.broadcast_mul(&self.first.unsqueeze(1)?)?;
        let mut curved = (laplacian * &self.first)?;
        if let Some((second, _)) = &self.curved {
            curved = (curved + (second * gradient.sqr()?.sum(1)?)?)?;
        }
        Ok((chained, curved))
    }

    /// The derivatives of a loss in raw density, its gradient and its Laplacian from those in
    /// density, its gradient and its Laplacian.
    pub(super) fn pull_back(&self, loss: &Cotangents, gradient: &Tensor, laplacian: &Tensor) -> Result<Cotangents> {
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
        for activation in [DensityActivation::Relu, DensityActivation::Softplus] {
            let raw = Tensor::new(&[f32::NAN, -1.0, 2.0], &Device::Cpu).unwrap();
            let density = activate_density(activation, &raw).unwrap().to_vec1::<f32>().unwrap();
            assert!(density[0].is_nan() && density[1] >= 0.0 && density[2] > 0.0, "{activation:?}: {density:?}");
        }
    }
}
