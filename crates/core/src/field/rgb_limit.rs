//! The limit of raw colours, as a differentiable operation.

use candle_core::{CpuStorage, CustomOp1, Layout, Result, Shape, Tensor, WithDType};

use super::contiguous;

/// Returns raw colours, of any shape, clamped to `-limit..=limit`. Beyond the limit a gradient passes if a step against it
/// leads back. Without that part, a colour beyond its limit would be stuck. With the rest, a colour would run off as long as
/// its pixel is not exactly black or white.
pub(super) fn limited(raw: &Tensor, limit: f64) -> Result<Tensor> {
    raw.contiguous()?.apply_op1(Clamp { limit })
}

/// Returns whether a step against a gradient leads a raw colour away from `-limit..=limit`.
pub(crate) fn leads_away(raw: f32, gradient: f32, limit: f32) -> bool {
    raw > limit && gradient < 0.0 || raw < -limit && gradient > 0.0
}

struct Clamp {
    limit: f64,
}

impl Clamp {
    fn clamped<T: WithDType>(&self, values: &[T]) -> Vec<T> {
        let [low, high] = [-self.limit, self.limit].map(T::from_f64);
        // NaN stays.
        let clamped = |value: &T| match *value {
            value if value > high => high,
            value if value < low => low,
            value => value,
        };
        values.iter().map(clamped).collect()
    }
}

impl CustomOp1 for Clamp {
    fn name(&self) -> &'static str {
        "limit-raw-colours"
    }

    fn cpu_fwd(&self, values: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let clamped = match values {
            CpuStorage::F32(values) => CpuStorage::F32(self.clamped(contiguous(values, layout)?)),
            CpuStorage::F64(values) => CpuStorage::F64(self.clamped(contiguous(values, layout)?)),
            _ => candle_core::bail!("raw colours are f32 or f64"),
        };
        Ok((clamped, layout.shape().clone()))
    }

    fn bwd(&self, raw: &Tensor, _clamped: &Tensor, gradient: &Tensor) -> Result<Option<Tensor>> {
        let above = (raw.gt(self.limit)? * gradient.lt(0.0)?)?;
        let below = (raw.lt(-self.limit)? * gradient.gt(0.0)?)?;
        let kept = (above + below)?.eq(0u8)?.to_dtype(gradient.dtype())?;
        Ok(Some((gradient * kept)?))
    }
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
        let raw = raw.to_vec1::<f32>().unwrap();
        for ((raw, slope), found) in raw.iter().zip(slopes).zip(found) {
            assert_eq!(leads_away(*raw, slope, 8.0), found == 0.0);
        }
    }
}
