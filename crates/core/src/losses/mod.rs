//! Terms of the loss next to the photometric one: on the rays of a step, or in space.
//!
//! | term | where | at a ray or point | source |
//! |---|---|---|---|
//! | `l1` | space | abs(density) | Aug-NeRF, appendix "Implementation of explicit regularization" |
//! | `tv` | space | length of density's gradient | the same |
//! | `laplacian` | space | abs(Laplacian of density) | the same |
//! | `distortion` | rays | spread of the weights along the ray | mip-NeRF 360, equation 15 |
//!
//! A term on rays is the mean over the rays of a step. A term in space is an integral over a box: volume / n * sum over
//! n points. If the points are the midpoints of all cells, volume / n is the paper's delta^3. A term of your own
//! implements [`RayTerm`] or [`SpaceTerm`], and is passed to the trainer ([`crate::methods::Learner::add_term`]).

use std::sync::Arc;

use candle_core::{Tensor, Var};

use crate::base::Result;
use crate::field::{Cotangents, DensityAt, Order};
use crate::render::PassOutput;
use crate::settings::{Regularizer, RegularizerConfig};

mod distortion;
mod l1;
mod laplacian;
mod smoothness;
mod spatial;
mod tv;

pub use distortion::Distortion;
pub use l1::L1;
pub use laplacian::Laplacian;
pub use smoothness::{Smoothness, measure, measure_density};
pub use spatial::{Regularized, WeightedSpaceTerm, estimate_seconds, regularize, regularize_at, regularize_unless};
pub use tv::Tv;

/// A rendered pass, as a term on rays reads it.
pub struct RayPass<'a> {
    /// Colour, depth, accumulation and weights of the rays, with their graph.
    pub output: &'a PassOutput,
    /// Near and far, in the units of `t_vals`.
    pub bounds: (f64, f64),
}

/// A term with a value per ray.
pub trait RayTerm: Send + Sync {
    /// Returns its name in logs (`regularizer.NAME`) and tables.
    fn name(&self) -> &str;
    /// Returns the term of each ray of a clean pass, `[rays]`, differentiable.
    fn per_ray(&self, pass: &RayPass) -> Result<Tensor>;
}

/// A term that is integrated over a box.
pub trait SpaceTerm: Send + Sync {
    /// Returns its name in logs (`regularizer.NAME`) and tables.
    fn name(&self) -> &str;
    /// Returns the highest derivative of density that it reads. Higher ones are NaN.
    fn order(&self) -> Order {
        Order::Laplacian
    }
    /// Returns the integrand, `[n]`.
    fn at_points(&self, at: &DensityAt) -> Result<Tensor>;
    /// Returns the derivatives of the sum over points. By default candle differentiates [`SpaceTerm::at_points`].
    fn cotangents(&self, at: &DensityAt) -> Result<Cotangents> {
        let [density, gradient, laplacian] =
            [&at.density, &at.gradient, &at.laplacian].map(|tensor| Var::from_tensor(&tensor.detach()));
        let (density, gradient, laplacian) = (density?, gradient?, laplacian?);
        let moved = DensityAt {
            density: density.as_tensor().clone(),
            gradient: gradient.as_tensor().clone(),
            laplacian: laplacian.as_tensor().clone(),
        };
        let slopes = self.at_points(&moved)?.sum_all()?.backward()?;
        let slope = |var: &Var| slopes.get(var).cloned();
        Ok(Cotangents { density: slope(&density), gradient: slope(&gradient), laplacian: slope(&laplacian) })
    }
}

/// A term of the loss.
#[derive(Clone)]
pub enum LossTerm {
    /// The mean over the rays of a step.
    OnRays(Arc<dyn RayTerm>),
    /// An integral over a box.
    InSpace(Arc<dyn SpaceTerm>),
}

/// A term and its weight in the loss.
#[derive(Clone)]
pub struct WeightedTerm {
    /// What is added to the loss.
    pub term: LossTerm,
    /// Its factor.
    pub weight: f64,
}

impl LossTerm {
    /// Creates a term on rays.
    pub fn on_rays(term: impl RayTerm + 'static) -> LossTerm {
        LossTerm::OnRays(Arc::new(term))
    }

    /// Creates a term in space.
    pub fn in_space(term: impl SpaceTerm + 'static) -> LossTerm {
        LossTerm::InSpace(Arc::new(term))
    }

    /// Returns the term of a configuration.
    pub fn of(regularizer: Regularizer) -> LossTerm {
        match regularizer {
            Regularizer::L1 => LossTerm::in_space(L1),
            Regularizer::Tv => LossTerm::in_space(Tv),
            Regularizer::Laplacian => LossTerm::in_space(Laplacian),
            Regularizer::Distortion => LossTerm::on_rays(Distortion),
        }
    }

    /// Returns the name in logs and tables.
    pub fn name(&self) -> &str {
        match self {
            LossTerm::OnRays(term) => term.name(),
            LossTerm::InSpace(term) => term.name(),
        }
    }
}

impl WeightedTerm {
    /// Returns the terms of a configuration with their weights, in its order.
    pub fn all(config: &RegularizerConfig) -> Vec<WeightedTerm> {
        config.terms().map(|(term, weight)| WeightedTerm { term: LossTerm::of(term), weight }).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::REGULARIZERS;

    #[test]
    fn the_settings_know_each_term_by_its_name_and_place() {
        for regularizer in REGULARIZERS {
            let term = LossTerm::of(regularizer);
            assert_eq!(term.name(), regularizer.name());
            assert_eq!(matches!(term, LossTerm::InSpace(_)), regularizer.in_space(), "{}", term.name());
        }
    }
}
