//! The variation of a volume's opacity: the smoothness prior of Neural Volumes (Lombardi et al. 2019, section 6.1).

use candle_core::{DType, Result, Tensor};

/// Keeps the logarithm of opacity, and the derivative of the root, finite.
const EPSILON: f64 = 1e-5;

/// Returns the mean over cells of `sqrt(1e-5 + |d|^2)`, where `d` are the forward differences of `ln(1e-5 + opacity)`.
/// Only cells with a next one along each axis count. Opacity is the last channel of `template [z, y, x, channels]`,
/// with all sides at least 2.
pub fn log_variation(template: &Tensor) -> Result<Tensor> {
    let (z, y, x, channels) = template.dims4()?;
    let logarithm = (template.narrow(3, channels - 1, 1)?.squeeze(3)? + EPSILON)?.log()?;
    let part = |from: [usize; 3]| {
        let along = logarithm.narrow(0, from[0], z - 1)?.narrow(1, from[1], y - 1)?;
        along.narrow(2, from[2], x - 1)
    };
    let here = part([0, 0, 0])?;
    let squares = [[0, 0, 1], [0, 1, 0], [1, 0, 0]].map(|next| (part(next)? - &here)?.sqr());
    let [a, b, c] = squares;
    let roots = (((a? + b?)? + c?)? + EPSILON)?.sqrt()?;
    // In f64: f32 loses digits in a sum over two million cells.
    roots.to_dtype(DType::F64)?.mean_all()?.to_dtype(template.dtype())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grids::reference::{check_differences, error, ramp};
    use candle_core::{Device, Var};

    #[test]
    fn gradients_are_those_of_differences_and_f32_follows() {
        let template = Var::from_tensor(&(ramp(&[3, 4, 2, 4], 0.3) + 1.5).unwrap()).unwrap();
        let both = |template: &Var| {
            let out = log_variation(template).unwrap();
            let gradient = out.sqr().unwrap().backward().unwrap().get(template).unwrap().clone();
            [out, gradient]
        };
        check_differences(std::slice::from_ref(&template), 1e-8, || log_variation(&template).unwrap());
        let single = Var::from_tensor(&template.to_dtype(DType::F32).unwrap()).unwrap();
        for (found, expected) in both(&single).iter().zip(&both(&template)) {
            assert!(error(found, expected) < 1e-5, "{}", error(found, expected));
        }
    }

    /// Opacity that grows by a factor of e along x: every difference is 1.
    #[test]
    fn a_slope_of_one_is_one() {
        let cells = (0..60).flat_map(|cell| [0.0, (cell as f64 % 5.0).exp() - EPSILON]);
        let template = Tensor::from_vec(cells.collect::<Vec<f64>>(), (3, 4, 5, 2), &Device::Cpu).unwrap();
        let found = log_variation(&template).unwrap().to_scalar::<f64>().unwrap();
        assert!((found - (1.0 + EPSILON).sqrt()).abs() < 1e-12, "{found}");
    }
}
