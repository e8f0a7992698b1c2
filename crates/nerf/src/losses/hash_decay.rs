//! Decay of hash grids (Zip-NeRF: Barron et al. 2023).

use candle_core::{DType, Tensor};

use crate::base::Result;
use augnerf_fast::hash::{HashGrid, Level};

/// Half the mean square of a level's numbers, summed over levels. A mean over all levels would be that of the finest ones,
/// which have most entries.
///
/// Its gradient counts for entries that another gradient of the step reaches: Adam makes any gradient, however small, into
/// a full step, so that entries that no ray reads would run to 0 at the speed of training.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HashDecay;

impl HashDecay {
    /// Returns its name in logs and tables.
    pub fn name(self) -> &'static str {
        "hash-decay"
    }

    /// Returns the value of `table [entries, features]`, and its gradient in the entries that `reached`, a gradient of the
    /// table, is not 0 at.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn value_and_gradient(self, grid: &HashGrid, table: &Tensor, reached: &Tensor) -> Result<(f64, Tensor)> {
        let read = reached.abs()?.sum_keepdim(1)?.gt(0f64)?.to_dtype(table.dtype())?;
        let (mut value, mut gradients) = (0.0, Vec::new());
        for &Level { offset, entries, .. } in grid.levels() {
            let level = table.narrow(0, offset, entries)?;
            let numbers = level.elem_count() as f64;
            value += level.to_dtype(DType::F64)?.sqr()?.sum_all()?.to_scalar::<f64>()? / (2.0 * numbers);
            gradients.push((level.broadcast_mul(&read.narrow(0, offset, entries)?)? / numbers)?);
        }
        Ok((value, Tensor::cat(&gradients, 0)?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::settings::Interpolation;
    use candle_core::Device;

    #[test]
    fn a_level_counts_whatever_its_size() {
        let grid = HashGrid::new(4, 2, 9, (2, 30), Interpolation::Linear);
        let sizes: Vec<usize> = grid.levels().iter().map(|level| level.entries).collect();
        assert!(sizes[0] < sizes[3], "{sizes:?}");
        let constant = Tensor::full(0.3, (grid.entries(), 2), &Device::Cpu).unwrap();
        let (value, gradient) = HashDecay.value_and_gradient(&grid, &constant, &constant).unwrap();
        assert!((value - 4.0 * 0.3 * 0.3 / 2.0).abs() < 1e-12);
        let gradient = gradient.to_vec2::<f64>().unwrap();
        assert!((gradient[0][1] - 0.3 / (2 * sizes[0]) as f64).abs() < 1e-15);
        assert!((gradient.last().unwrap()[0] - 0.3 / (2 * sizes[3]) as f64).abs() < 1e-15);
    }

    #[test]
    fn entries_that_no_gradient_reaches_stay() {
        let grid = HashGrid::new(2, 1, 9, (2, 4), Interpolation::Linear);
        let table = Tensor::arange(1.0, 1.0 + grid.entries() as f64, &Device::Cpu).unwrap().unsqueeze(1).unwrap();
        let reached: Vec<f64> = (0..grid.entries()).map(|entry| if entry == 3 { -1e-9 } else { 0.0 }).collect();
        let reached = Tensor::from_vec(reached, (grid.entries(), 1), &Device::Cpu).unwrap();
        let gradient = HashDecay.value_and_gradient(&grid, &table, &reached).unwrap().1;
        let gradient = gradient.flatten_all().unwrap().to_vec1::<f64>().unwrap();
        let numbers = grid.levels()[0].entries as f64;
        assert!((gradient[3] - 4.0 / numbers).abs() < 1e-15);
        assert_eq!(gradient.iter().filter(|d| **d != 0.0).count(), 1);
    }
}
