//! Raw density of points that may be outside a hash grid's box, or that are not queried.

use std::sync::Arc;

use candle_core::{Result, Shape, Tensor};

use super::RawOutput;

/// Raw density of empty space, for which every activation gives 0.
pub(super) const NOTHING: f32 = -1e4;

/// Which of `n` points are where density can be.
#[derive(Clone)]
pub(super) struct Inside(pub(super) Arc<[bool]>);

impl Inside {
    pub(super) fn new(inside: Vec<bool>) -> Inside {
        Inside(inside.into())
    }

    /// Returns 1 inside and 0 outside, `[n]`, in the type of `like`.
    pub(super) fn mask(&self, like: &Tensor) -> Result<Tensor> {
        let mask: Vec<u8> = self.0.iter().map(|inside| u8::from(*inside)).collect();
        Tensor::new(mask, like.device())?.to_dtype(like.dtype())
    }

    /// Returns raw density `[n]` with [`NOTHING`] at points outside, where it has no gradient. NaN stays NaN.
    pub(super) fn only(&self, raw: &Tensor) -> Result<Tensor> {
        let mask = self.mask(raw)?;
        (raw * &mask)? + mask.affine(f64::from(-NOTHING), f64::from(NOTHING))?
    }
}

/// The points of a query that are queried. The others are empty, and have no gradient.
#[derive(Clone, Debug)]
pub struct Queried {
    /// Their numbers, ascending.
    rows: Arc<[u32]>,
    /// The number of all points.
    of: usize,
}

impl Queried {
    /// Creates them from their ascending numbers among `of` points.
    pub fn new(rows: Vec<u32>, of: usize) -> Queried {
        Queried { rows: rows.into(), of }
    }

    /// Returns how many are queried.
    pub fn count(&self) -> usize {
        self.rows.len()
    }

    /// Returns 1 at points that are queried and 0 at others, `[n]`, in the type of `like`.
    pub fn mask(&self, like: &Tensor) -> Result<Tensor> {
        let mut mask = vec![0u8; self.of];
        self.rows.iter().for_each(|row| mask[*row as usize] = 1);
        Tensor::new(mask, like.device())?.to_dtype(like.dtype())
    }

    /// Returns their rows of `[n, width]`.
    pub(super) fn rows(&self, of_all: &Tensor) -> Result<Tensor> {
        of_all.contiguous()?.index_select(&Tensor::new(&*self.rows, of_all.device())?, 0)
    }

    /// Returns the rows of their rays, of `[rays, width]`.
    pub(super) fn rows_of_rays(&self, of_rays: &Tensor) -> Result<Tensor> {
        let samples = (self.of / of_rays.dim(0)?.max(1)).max(1) as u32;
        let rays: Vec<u32> = self.rows.iter().map(|row| row / samples).collect();
        of_rays.contiguous()?.index_select(&Tensor::new(rays, of_rays.device())?, 0)
    }

    /// Returns the raw output of all points from theirs. The others have [`NOTHING`] as density.
    pub(super) fn over_all(&self, RawOutput { rgb, density }: RawOutput) -> Result<RawOutput> {
        let nothing = self.mask(&density)?.affine(f64::from(-NOTHING), f64::from(NOTHING))?;
        if self.count() == 0 {
            let rgb = Tensor::zeros((self.of, 3), rgb.dtype(), rgb.device())?;
            return Ok(RawOutput { rgb, density: nothing });
        }
        let rows = Tensor::new(&*self.rows, rgb.device())?;
        let zeros = |shape: Shape| Tensor::zeros(shape, rgb.dtype(), rgb.device());
        Ok(RawOutput {
            rgb: zeros((self.of, 3).into())?.index_add(&rows, &rgb, 0)?,
            density: (zeros(self.of.into())?.index_add(&rows, &density, 0)? + nothing)?,
        })
    }
}
