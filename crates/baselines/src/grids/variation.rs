//! The variation of a volume's opacity: the smoothness prior of Neural Volumes (Lombardi et al. 2019, section 6.1).

use candle_core::backend::BackendStorage;
use candle_core::{CpuStorage, CustomOp1, DType, Device, Layout, Result, Shape, Tensor, WithDType};

use crate::base::place::is_ours;
use rayon::prelude::*;

use super::values::{Values, each_kind, slice};

/// Keeps the logarithm of opacity, and the derivative of the root, finite.
const EPSILON: f64 = 1e-5;

/// Returns the mean over cells of `sqrt(1e-5 + |d|^2)`, where `d` are the forward differences of `ln(1e-5 + opacity)`.
/// Only cells with a next one along each axis count. Opacity is the last channel of `template [z, y, x, channels]`,
/// with all sides at least 2.
pub fn log_variation(template: &Tensor) -> Result<Tensor> {
    let (z, y, x, channels) = template.dims4()?;
    if z < 2 || y < 2 || x < 2 || channels == 0 {
        candle_core::bail!("variation of {:?}: a lattice has at least two cells along each axis", template.shape());
    }
    if !is_ours(template) {
        return plain(template);
    }
    template.contiguous()?.apply_op1(Variation { sides: [z, y, x], channels })
}

/// The same in candle's own operations.
pub fn plain(template: &Tensor) -> Result<Tensor> {
    let (z, y, x, channels) = template.dims4()?;
    let logarithm = (template.narrow(3, channels - 1, 1)?.squeeze(3)? + EPSILON)?.log()?;
    let part = |from: [usize; 3]| {
        let along = logarithm.narrow(0, from[0], z - 1)?.narrow(1, from[1], y - 1)?;
        along.narrow(2, from[2], x - 1)
    };
    let here = part([0, 0, 0])?;
    let squares = [[0, 0, 1], [0, 1, 0], [1, 0, 0]].map(|next| (part(next)? - &here)?.sqr());
    let [a, b, c] = squares;
    (((a? + b?)? + c?)? + EPSILON)?.sqrt()?.mean_all()
}

struct Variation {
    sides: [usize; 3],
    channels: usize,
}

impl Variation {
    fn logarithms<T: WithDType>(&self, template: &[T]) -> Vec<f64> {
        let opacity = template.par_chunks_exact(self.channels).map(|cell| cell[self.channels - 1].to_f64());
        opacity.map(|opacity| (EPSILON + opacity).ln()).collect()
    }

    /// Returns the distance in cells to the next one along z, y, x.
    fn strides(&self) -> [usize; 3] {
        [self.sides[1] * self.sides[2], self.sides[2], 1]
    }

    /// Returns whether the cell has a next one along each axis.
    fn counts(&self, cell: usize) -> bool {
        let [depth, height, width] = self.sides;
        cell / (height * width) + 1 < depth && cell / width % height + 1 < height && cell % width + 1 < width
    }

    fn cells(&self) -> f64 {
        self.sides.iter().map(|side| (side - 1) as f64).product()
    }

    /// Returns the root at a cell, or 0 if the cell does not count.
    fn root(&self, logarithms: &[f64], cell: usize) -> f64 {
        if !self.counts(cell) {
            return 0.0;
        }
        let squares = self.strides().map(|next| (logarithms[cell + next] - logarithms[cell]).powi(2));
        (EPSILON + squares.iter().sum::<f64>()).sqrt()
    }

    /// Returns all roots and their sum. Sums of planes are added in order.
    fn roots(&self, logarithms: &[f64]) -> (Vec<f64>, f64) {
        let plane = self.strides()[0];
        let mut roots = vec![0f64; logarithms.len()];
        let sums = roots.par_chunks_mut(plane).enumerate().map(|(z, roots)| {
            roots.iter_mut().enumerate().for_each(|(i, root)| *root = self.root(logarithms, z * plane + i));
            roots.iter().sum::<f64>()
        });
        let sums: Vec<f64> = sums.collect();
        (roots, sums.into_iter().sum::<f64>() / self.cells())
    }

    fn gradient<T: WithDType>(&self, template: &[T], cotangent: f64) -> Vec<T> {
        let logarithms = self.logarithms(template);
        let (roots, _) = self.roots(&logarithms);
        let slope = |cell: usize| {
            let mut sum = 0.0;
            for next in self.strides() {
                if roots[cell] > 0.0 {
                    sum -= (logarithms[cell + next] - logarithms[cell]) / roots[cell];
                }
                // A cell that counts has its next one along this axis.
                if let Some(before) = cell.checked_sub(next).filter(|before| roots[*before] > 0.0) {
                    sum += (logarithms[cell] - logarithms[before]) / roots[before];
                }
            }
            sum
        };
        let mut out = vec![T::zero(); template.len()];
        out.par_chunks_mut(self.channels).enumerate().with_min_len(1 << 12).for_each(|(cell, out)| {
            let opacity = template[(cell + 1) * self.channels - 1].to_f64();
            out[self.channels - 1] = T::from_f64(cotangent * slope(cell) / ((EPSILON + opacity) * self.cells()));
        });
        out
    }
}

impl CustomOp1 for Variation {
    fn name(&self) -> &'static str {
        "log-variation"
    }

    fn cpu_fwd(&self, template: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let out = each_kind!(template.dtype(), T => {
            let (_, mean) = self.roots(&self.logarithms(slice::<T>(template, layout)?));
            T::to_cpu_storage_owned(vec![T::from_f64(mean)])
        });
        Ok((out, Shape::from(())))
    }

    fn bwd(&self, template: &Tensor, _out: &Tensor, gradient: &Tensor) -> Result<Option<Tensor>> {
        let cotangent = gradient.to_dtype(DType::F64)?.to_scalar::<f64>()?;
        each_kind!(template.dtype(), T => {
            let values = Values::of(template);
            let out = self.gradient(values.slice::<T>()?, cotangent);
            Ok(Some(Tensor::from_vec(out, template.shape(), &Device::Cpu)?))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grids::reference::{check_differences, error, on_any_threads, ramp};
    use candle_core::Var;

    #[test]
    fn values_and_gradients_are_the_plain_ones_and_those_of_differences() {
        let template = Var::from_tensor(&(ramp(&[3, 4, 2, 4], 0.3) + 1.5).unwrap()).unwrap();
        let both = |variation: fn(&Tensor) -> Result<Tensor>, template: &Var| {
            let out = variation(template).unwrap();
            let gradient = (out.sqr().unwrap()).backward().unwrap().get(template).unwrap().clone();
            vec![out, gradient]
        };
        let plain = both(plain, &template);
        for (found, expected) in both(log_variation, &template).iter().zip(&plain) {
            assert!(error(found, expected) < 1e-12, "{}", error(found, expected));
        }
        check_differences(std::slice::from_ref(&template), 1e-8, || log_variation(&template).unwrap());
        let single = Var::from_tensor(&template.to_dtype(DType::F32).unwrap()).unwrap();
        for (found, expected) in on_any_threads(|| both(log_variation, &single)).iter().zip(&plain) {
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
