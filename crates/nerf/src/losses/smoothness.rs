//! The smoothness of a trained field: the integrals that the regularizers lower, on the full sampling grid.

use candle_core::{DType, Tensor};
use serde::Serialize;

use crate::base::{Error, Result};
use crate::field::{Density, DensityAt, Field};
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

/// Measures a field at every cell's midpoint. `advance` is called with the number of cells of each part.
pub fn measure(field: &Field, lattice: &Lattice, advance: impl FnMut(usize)) -> Result<Smoothness> {
    let field = &field.prepared()?;
    let has_laplacian = field.config().has_laplacian();
    let query = |points: &Tensor| sums_at(&field.spatial(points)?.at, has_laplacian);
    let mut sum = Smoothness::default();
    let take = sum.adding(lattice, advance);
    over_chunks(&Quadrature::full(*lattice), field.dtype(), field.device(), query, take)?;
    Ok(Smoothness { occupied: sum.occupied / lattice.cells() as f64, ..sum })
}

/// Measures density and its gradient alone, wherever they are computed: without the Laplacian.
pub fn measure_density(density: &dyn Density, lattice: &Lattice, advance: impl FnMut(usize)) -> Result<Smoothness> {
    let variance = lattice.cell_variance();
    let query = |points: &Tensor| {
        let gradient = density.gradient(points, variance)?.to_dtype(DType::F64)?;
        let density = density.density(points, variance)?.to_dtype(DType::F64)?;
        sums_at(&DensityAt { laplacian: density.clone(), density, gradient }, false)
    };
    let mut sum = Smoothness::default();
    over_cells(density, lattice, query, sum.adding(lattice, advance))?;
    Ok(Smoothness { occupied: sum.occupied / lattice.cells() as f64, ..sum })
}

/// Returns the number of points, and sums over them.
fn sums_at(at: &DensityAt, has_laplacian: bool) -> Result<(usize, Smoothness)> {
    let sum = |term: &dyn SpaceTerm| Ok::<f64, Error>(term_sum(term, at)?.to_scalar()?);
    let sums = Smoothness {
        l1: sum(&L1)?,
        tv: sum(&Tv)?,
        laplacian: has_laplacian.then(|| sum(&Laplacian)).transpose()?,
        largest_density: at.density.max(0)?.to_dtype(DType::F64)?.to_scalar()?,
        occupied: at.density.gt(0f64)?.to_dtype(DType::F64)?.sum_all()?.to_scalar()?,
    };
    Ok((at.density.elem_count(), sums))
}

impl Smoothness {
    /// Returns a function that adds the sums over some cells.
    fn adding(
        &mut self,
        lattice: &Lattice,
        mut advance: impl FnMut(usize),
    ) -> impl FnMut((usize, Smoothness)) -> Result<()> {
        let volume = lattice.volume() / lattice.cells() as f64;
        move |(cells, part)| {
            self.l1 += volume * part.l1;
            self.tv += volume * part.tv;
            self.laplacian = part.laplacian.map(|more| self.laplacian.unwrap_or(0.0) + volume * more);
            self.largest_density = self.largest_density.max(part.largest_density);
            self.occupied += part.occupied;
            advance(cells);
            Ok(())
        }
    }
}
