//! The smoothness of a trained field: the integrals that the regularizers lower, on the full sampling grid.

use candle_core::{DType, Tensor};
use serde::Serialize;

use crate::base::{Error, Result};
use crate::field::{Density, Field};
use crate::space::{Lattice, Quadrature, over_cells, over_chunks};

use super::spatial::term_sum;
use super::{L1, Laplacian, SpaceTerm, Tv};

/// The smoothness of a field on the full sampling grid.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Smoothness {
    /// Integral of abs(density), length^2.
    pub l1: f64,
    /// Integral of the gradient's length, length.
    pub tv: f64,
    /// Integral of abs(Laplacian), 1. `None` if density has no Laplacian
    /// ([`crate::field::settings::FieldConfig::has_laplacian`]).
    pub laplacian: Option<f64>,
    /// Largest density, 1 / length.
    pub largest_density: f64,
    /// Fraction of points with positive density. It is 1 if density is a softplus.
    pub occupied: f64,
}

/// Measures a field at every cell's midpoint. `advance` is called after each chunk of cells.
pub fn measure(field: &Field, lattice: &Lattice, mut advance: impl FnMut()) -> Result<Smoothness> {
    let points = Quadrature::full(*lattice);
    let volume = points.volume_each();
    let field = &field.prepared()?;
    let bent = field.config().has_laplacian();
    let mut sum = Smoothness { laplacian: bent.then_some(0.0), ..Smoothness::default() };
    over_chunks(
        &points,
        field.dtype(),
        field.device(),
        |points| {
            let at = field.spatial(points)?.at;
            let integral = |term: &dyn SpaceTerm| Ok::<f64, Error>(term_sum(term, &at)?.to_scalar()?);
            let (l1, tv) = (integral(&L1)?, integral(&Tv)?);
            let laplacian = bent.then(|| integral(&Laplacian)).transpose()?;
            let positive = at.density.gt(0f64)?.to_dtype(DType::F64)?.sum_all()?.to_scalar::<f64>()?;
            let largest_density = at.density.max(0)?.to_dtype(DType::F64)?.to_scalar()?;
            Ok(Smoothness { l1, tv, laplacian, largest_density, occupied: positive })
        },
        |chunk: Smoothness| {
            sum.add(&chunk, volume);
            advance();
            Ok(())
        },
    )?;
    sum.occupied /= lattice.cells() as f64;
    Ok(sum)
}

/// Measures density and its gradient alone, wherever they are computed: without the Laplacian. `advance` is called with
/// the number of cells of each part.
pub fn measure_density(density: &dyn Density, lattice: &Lattice, mut advance: impl FnMut(usize)) -> Result<Smoothness> {
    let (variance, volume) = (lattice.cell_variance(), Quadrature::full(*lattice).volume_each());
    let query = |points: &Tensor| -> Result<(usize, Smoothness)> {
        let values = density.density(points, variance)?.to_dtype(DType::F64)?.to_vec1::<f64>()?;
        let slopes = density.gradient(points, variance)?.to_dtype(DType::F64)?;
        let part = Smoothness {
            l1: values.iter().map(|value| value.abs()).sum(),
            tv: slopes.sqr()?.sum(1)?.sqrt()?.sum_all()?.to_scalar()?,
            laplacian: None,
            largest_density: values.iter().copied().fold(0.0, f64::max),
            occupied: values.iter().filter(|value| **value > 0.0).count() as f64,
        };
        Ok((values.len(), part))
    };
    let mut sum = Smoothness::default();
    over_cells(density, lattice, query, |(cells, part)| {
        sum.add(&part, volume);
        advance(cells);
        Ok(())
    })?;
    sum.occupied /= lattice.cells() as f64;
    Ok(sum)
}

impl Smoothness {
    /// Adds the sums over some points of this volume each.
    fn add(&mut self, chunk: &Smoothness, volume: f64) {
        self.l1 += volume * chunk.l1;
        self.tv += volume * chunk.tv;
        self.laplacian = self.laplacian.zip(chunk.laplacian).map(|(sum, chunk)| sum + volume * chunk);
        self.largest_density = self.largest_density.max(chunk.largest_density);
        self.occupied += chunk.occupied;
    }
}
