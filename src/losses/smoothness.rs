//! How smooth a trained field is: the integrals that the regularizers lower, on the full lattice.

use candle_core::DType;
use serde::Serialize;

use crate::base::{Error, Result};
use crate::field::Field;
use crate::space::{Lattice, Quadrature, over_chunks};

use super::spatial::term_sum;
use super::{L1, Laplacian, SpaceTerm, Tv};

/// How smooth a field is on the full lattice.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Smoothness {
    /// Integral of abs(density), length^2.
    pub l1: f64,
    /// Integral of the gradient's length, length.
    pub tv: f64,
    /// Integral of abs(Laplacian), 1.
    pub laplacian: f64,
    /// Largest density, 1 / length.
    pub largest_density: f64,
    /// Share of points with positive density: all of them where density is a softplus.
    pub occupied: f64,
}

/// Measures a field on every cell's midpoint. `advance` is called after each chunk of cells.
pub fn measure(field: &Field, lattice: &Lattice, mut advance: impl FnMut()) -> Result<Smoothness> {
    let terms: [&dyn SpaceTerm; 3] = [&L1, &Tv, &Laplacian];
    let points = Quadrature::full(*lattice);
    let volume = points.volume_each();
    let field = &field.prepared()?;
    let mut sum = Smoothness::default();
    over_chunks(
        &points,
        field.dtype(),
        field.device(),
        |points| {
            let at = field.spatial(points)?.at;
            let [l1, tv, laplacian] = terms.map(|term| Ok::<f64, Error>(term_sum(term, &at)?.to_scalar()?));
            let positive = at.density.gt(0f64)?.to_dtype(DType::F64)?.sum_all()?.to_scalar::<f64>()?;
            let largest_density = at.density.max(0)?.to_dtype(DType::F64)?.to_scalar()?;
            Ok(Smoothness { l1: l1?, tv: tv?, laplacian: laplacian?, largest_density, occupied: positive })
        },
        |chunk: Smoothness| {
            sum.l1 += volume * chunk.l1;
            sum.tv += volume * chunk.tv;
            sum.laplacian += volume * chunk.laplacian;
            sum.largest_density = sum.largest_density.max(chunk.largest_density);
            sum.occupied += chunk.occupied;
            advance();
            Ok(())
        },
    )?;
    sum.occupied /= lattice.cells() as f64;
    Ok(sum)
}
