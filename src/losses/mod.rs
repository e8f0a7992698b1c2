//! Explicit smoothness terms on density in space (paper, appendix "Implementation of explicit
//! regularization"), and the measurement of the same on trained fields.
//!
//! Each is an integral over a box, R = volume / n * sum over n points of
//!
//! | term | at a point | derivative |
//! |---|---|---|
//! | `l1` | abs(density) | 1 where density is positive, 0 where it is 0 |
//! | `tv` | length of the gradient | gradient / its length, 0 where the gradient is 0 |
//! | `laplacian` | abs(Laplacian) | its sign, 0 where it is 0 |
//!
//! The full lattice asks every cell's midpoint, so that volume / n is the paper's delta^3.

use candle_core::{DType, Device, Tensor};
use serde::Serialize;

use crate::base::{Error, Result};
use crate::field::{Cotangents, Field, Spatial};
use crate::settings::{REGULARIZERS, Regularizer};
use crate::space::{CHUNKS_AT_ONCE, Lattice, Points, chunk_size, over_chunks};

/// Terms and the gradients of their weighted sum.
pub struct Regularized {
    /// Value of each term, unweighted: f64 `[terms]`, on the field's device until someone reads it.
    pub values: Tensor,
    /// In the order of [`Field::parameter_names`].
    pub gradients: Vec<Option<Tensor>>,
}

/// Values and weight gradients of weighted terms of one field.
pub fn regularize(
    field: &Field,
    lattice: &Lattice,
    points: &Points,
    terms: &[(Regularizer, f64)],
    (dtype, device): (DType, &Device),
) -> Result<Regularized> {
    let count = points.count(lattice);
    let scale = lattice.volume() / count as f64;
    let field = &field.prepared()?;
    let mut sum: Option<Regularized> = None;
    over_chunks(
        (lattice, points),
        (dtype, device),
        |points| regularize_at(field, points, terms, scale),
        |chunk| {
            match &mut sum {
                None => sum = Some(chunk),
                Some(sum) => sum.add(chunk)?,
            }
            Ok(())
        },
    )?;
    Ok(sum.expect("there are points"))
}

/// The same at `points [n, 3]`, each of which stands for `volume`.
pub fn regularize_at(field: &Field, points: &Tensor, terms: &[(Regularizer, f64)], volume: f64) -> Result<Regularized> {
    let spatial = field.spatial(points)?;
    let values: Vec<Tensor> = terms.iter().map(|(term, _)| term_sum(*term, &spatial)).collect::<Result<_>>()?;
    let values = (Tensor::stack(&values, 0)? * volume)?;
    let gradients = spatial.weight_gradients(&cotangents(&spatial, terms, volume)?)?;
    Ok(Regularized { values, gradients })
}

impl Regularized {
    fn add(&mut self, other: Regularized) -> Result<()> {
        self.values = (&self.values + other.values)?;
        for (sum, gradient) in self.gradients.iter_mut().zip(other.gradients) {
            *sum = match (sum.take(), gradient) {
                (Some(sum), Some(gradient)) => Some((sum + gradient)?),
                (sum, gradient) => sum.or(gradient),
            };
        }
        Ok(())
    }
}

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

/// Measures a field on every cell's midpoint. `advance` is called after each of [`chunk_count`] chunks.
pub fn measure(
    field: &Field,
    lattice: &Lattice,
    (dtype, device): (DType, &Device),
    mut advance: impl FnMut(),
) -> Result<Smoothness> {
    let scale = lattice.volume() / lattice.cells() as f64;
    let field = &field.prepared()?;
    let mut sum = Smoothness::default();
    over_chunks(
        (lattice, &Points::Full),
        (dtype, device),
        |points| {
            let spatial = field.spatial(points)?;
            let [l1, tv, laplacian] = REGULARIZERS.map(|term| Ok::<f64, Error>(term_sum(term, &spatial)?.to_scalar()?));
            let positive = spatial.density.gt(0f64)?.to_dtype(DType::F64)?.sum_all()?.to_scalar::<f64>()?;
            let largest_density = spatial.density.max(0)?.to_dtype(DType::F64)?.to_scalar()?;
            Ok(Smoothness { l1: l1?, tv: tv?, laplacian: laplacian?, largest_density, occupied: positive })
        },
        |chunk: Smoothness| {
            sum.l1 += scale * chunk.l1;
            sum.tv += scale * chunk.tv;
            sum.laplacian += scale * chunk.laplacian;
            sum.largest_density = sum.largest_density.max(chunk.largest_density);
            sum.occupied += chunk.occupied;
            advance();
            Ok(())
        },
    )?;
    sum.occupied /= lattice.cells() as f64;
    Ok(sum)
}

/// Seconds that one pass over `count` points takes here, judged by a chunk: with weight gradients,
/// or values alone.
pub fn estimate_seconds(
    field: &Field,
    lattice: &Lattice,
    count: usize,
    with_gradients: bool,
    (dtype, device): (DType, &Device),
) -> Result<f64> {
    let field = &field.prepared()?;
    let chunk = chunk_size(device).min(lattice.cells());
    let points = Points::Full.tensor(lattice, 0, chunk, dtype, device)?;
    let work = || -> Result<f64> {
        let started = std::time::Instant::now();
        let spatial = field.spatial(&points)?;
        if with_gradients {
            spatial.weight_gradients(&cotangents(&spatial, &REGULARIZERS.map(|term| (term, 1.0)), 1.0)?)?;
        }
        device.synchronize()?;
        Ok(started.elapsed().as_secs_f64())
    };
    // The first pays for fresh memory.
    work()?;
    let threads = if device.is_cpu() { rayon::current_num_threads().min(CHUNKS_AT_ONCE) } else { 1 };
    Ok(work()? * count as f64 / chunk as f64 / threads as f64)
}

/// Sum over points of what a term measures there. In f64: Laplacians reach 4^9 and more.
fn term_sum(term: Regularizer, spatial: &Spatial) -> Result<Tensor> {
    let at_points = match term {
        Regularizer::L1 => spatial.density.abs()?,
        Regularizer::Tv => spatial.gradient.sqr()?.sum(1)?.sqrt()?,
        Regularizer::Laplacian => spatial.laplacian.abs()?,
    };
    Ok(at_points.to_dtype(DType::F64)?.sum_all()?)
}

/// Derivatives of the sum of `volume * weight * term` over points; each term is named once.
fn cotangents(spatial: &Spatial, terms: &[(Regularizer, f64)], volume: f64) -> Result<Cotangents> {
    let mut cotangents = Cotangents::default();
    for &(term, weight) in terms {
        let scale = volume * weight;
        match term {
            Regularizer::L1 => cotangents.density = Some((spatial.density.sign()? * scale)?),
            Regularizer::Tv => {
                let length = spatial.gradient.sqr()?.sum_keepdim(1)?.sqrt()?;
                // 0 / 1 where the gradient is 0: the subgradient of least length.
                let divisor = (&length + length.eq(0f64)?.to_dtype(length.dtype())?)?;
                cotangents.gradient = Some((spatial.gradient.broadcast_div(&divisor)? * scale)?);
            }
            Regularizer::Laplacian => cotangents.laplacian = Some((spatial.laplacian.sign()? * scale)?),
        }
    }
    Ok(cotangents)
}
