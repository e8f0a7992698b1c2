//! The limit of raw colours, as a differentiable operation on any device.

use candle_core::{Result, Tensor};

use crate::base::tensors::with_gradient;

/// Returns raw colours, of any shape, clamped to `-limit..=limit`. Beyond the limit a gradient passes if a step against it
/// leads back. Without that part, a colour beyond its limit would be stuck. With the rest, a colour would run off as long as
/// its pixel is not exactly black or white.
pub(super) fn limited(raw: &Tensor, limit: f64) -> Result<Tensor> {
    let raw = raw.contiguous()?;
    let free = raw.detach();
    let bound = |bound: f64| free.zeros_like()? + bound;
    // NaN is on neither side, and stays.
    let clamped = free.gt(limit)?.where_cond(&bound(limit)?, &free)?;
    let clamped = free.lt(-limit)?.where_cond(&bound(-limit)?, &clamped)?;
    with_gradient(&raw, &clamped, move |raw, gradient| {
        let above = (raw.gt(limit)? * gradient.lt(0.0)?)?;
        let below = (raw.lt(-limit)? * gradient.gt(0.0)?)?;
        gradient * (above + below)?.eq(0u8)?.to_dtype(gradient.dtype())?
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{Device, Var};

    #[test]
    fn beyond_the_limit_a_gradient_leads_back_alone() {
        let raw = Var::new(&[-9f32, -9.0, -3.0, 3.0, 9.0, 9.0], &Device::Cpu).unwrap();
        let slopes = [1f32, -1.0, 1.0, -1.0, 1.0, -1.0];
        let limited = limited(&raw, 8.0).unwrap();
        assert_eq!(limited.to_vec1::<f32>().unwrap(), [-8.0, -8.0, -3.0, 3.0, 8.0, 8.0]);
        let loss = (limited * Tensor::new(&slopes, &Device::Cpu).unwrap()).unwrap().sum_all().unwrap();
        let found = loss.backward().unwrap().get(&raw).unwrap().to_vec1::<f32>().unwrap();
        assert_eq!(found, [0.0, -1.0, 1.0, -1.0, 1.0, 0.0]);
    }
}
