//! The constraint set of one delta: radius, norm and bounds; random points, directions, projection.

use std::sync::Arc;

use candle_core::{D, DType, Result as TensorResult, Tensor};
use serde::{Deserialize, Serialize};

use crate::base::Result;
use crate::base::rng::Random;
use crate::perturb::site::{Pgd, StepUnit};

/// The norm of a constraint set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Norm {
    /// A box. PGD steps follow the gradient's sign.
    Linf,
    /// A ball per sample. PGD steps follow the normalized gradient.
    L2,
}

impl Norm {
    /// Returns the name in files and tables.
    pub fn name(self) -> &'static str {
        match self {
            Norm::Linf => "linf",
            Norm::L2 => "l2",
        }
    }
}

/// The distribution of random points of a set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Distribution {
    /// Uniform in the set.
    Uniform,
    /// Normal with the uniform's standard deviation, radius / sqrt(3), then projected.
    Gaussian,
}

/// Maps a delta to what it adds, differentiably.
type Spread = Arc<dyn Fn(&Tensor) -> Result<Tensor> + Send + Sync>;

/// The constraint set of one delta.
#[derive(Clone)]
pub struct DeltaSet {
    /// Box or ball. A ball is over the delta's last axis.
    pub norm: Norm,
    /// At least 0. It broadcasts to the delta's shape; for a ball its last axis has length 1.
    pub radius: Tensor,
    /// Smallest and largest allowed values, if the set has bounds in addition to its radius.
    pub bounds: Option<(Tensor, Tensor)>,
    /// Multiplied in last: 0 where the delta must be 0.
    pub mask: Option<Tensor>,
    /// The delta's shape.
    pub shape: Vec<usize>,
    /// What a delta adds, if not itself.
    spread: Option<Spread>,
}

impl DeltaSet {
    /// Creates a set without bounds or mask, of deltas that are added as they are.
    pub fn new(norm: Norm, radius: Tensor, shape: &[usize]) -> DeltaSet {
        DeltaSet { norm, radius, bounds: None, mask: None, shape: shape.to_vec(), spread: None }
    }

    /// Returns the same set. The pass then adds `spread(delta)` in place of a delta. Its shape is that of the site:
    /// `t_vals`' at `t`, `[rays, samples, 3]` at `xyz` and `rgb`, `[rays, 2]` at `view`, `[rays, samples, width]` at
    /// `feature`, `[rays, samples]` at `density`. At the output level the sum is clipped to its range; a delta without
    /// `spread` is projected so that the sum stays in it.
    pub fn spread_by(self, spread: impl Fn(&Tensor) -> Result<Tensor> + Send + Sync + 'static) -> DeltaSet {
        DeltaSet { spread: Some(Arc::new(spread)), ..self }
    }

    /// Returns whether its deltas are spread.
    pub fn spreads(&self) -> bool {
        self.spread.is_some()
    }

    /// Returns what a delta adds.
    ///
    /// # Errors
    /// Those of the function of [`DeltaSet::spread_by`].
    pub fn spread(&self, delta: &Tensor) -> Result<Tensor> {
        self.spread.as_ref().map_or_else(|| Ok(delta.clone()), |spread| spread(delta))
    }

    /// Projects a delta: onto the ball or the box, then onto the bounds, then times the mask. The result is in the
    /// set. With bounds it need not be the set's nearest point.
    pub fn project(&self, delta: &Tensor) -> TensorResult<Tensor> {
        let mut delta = match self.norm {
            Norm::Linf => delta.broadcast_minimum(&self.radius)?.broadcast_maximum(&self.radius.neg()?)?,
            Norm::L2 => {
                let norm = l2_norm(delta)?;
                // If the norm is 0, the quotient is infinite and the scale 1.
                let scale = self.radius.broadcast_div(&norm)?.minimum(&norm.ones_like()?)?;
                let inside = norm.broadcast_le(&self.radius)?;
                inside.where_cond(&norm.ones_like()?, &scale)?.broadcast_mul(delta)?
            }
        };
        if let Some((lower, upper)) = &self.bounds {
            delta = delta.broadcast_minimum(upper)?.broadcast_maximum(lower)?;
        }
        match &self.mask {
            Some(mask) => delta.broadcast_mul(mask),
            None => Ok(delta),
        }
    }

    /// Returns the set with these bounds in place of its own.
    pub fn within(&self, lower: Tensor, upper: Tensor) -> DeltaSet {
        DeltaSet { bounds: Some((lower, upper)), ..self.clone() }
    }

    /// Returns the ascent direction of `gradient`: its sign, or its unit vector per sample. It is 0 at 0.
    pub fn direction(&self, gradient: &Tensor) -> TensorResult<Tensor> {
        match self.norm {
            Norm::Linf => gradient.sign(),
            Norm::L2 => {
                // Scaled by the largest entry first, so that tiny gradients do not underflow.
                let largest = gradient.abs()?.max_keepdim(D::Minus1)?;
                let divisor = largest.gt(0f64)?.where_cond(&largest, &largest.ones_like()?)?;
                let scaled = gradient.broadcast_div(&divisor)?;
                let norm = l2_norm(&scaled)?;
                let divisor = norm.gt(0f64)?.where_cond(&norm, &norm.ones_like()?)?;
                scaled.broadcast_div(&divisor)
            }
        }
    }

    /// Returns `delta` after a step up the gradient, projected onto the set.
    ///
    /// # Errors
    /// Those of candle, if shapes do not fit.
    pub fn ascend(&self, delta: &Tensor, gradient: &Tensor, pgd: Pgd) -> Result<Tensor> {
        let direction = self.direction(gradient)?;
        let step = match pgd.unit {
            StepUnit::Absolute => (direction * pgd.step_size)?,
            StepUnit::Relative => direction.broadcast_mul(&(&self.radius * pgd.step_size)?)?,
        };
        Ok(self.project(&(delta + step)?)?)
    }

    /// Returns a random point of the set.
    pub fn draw(&self, distribution: Distribution, random: &mut Random) -> Result<Tensor> {
        let (dtype, device) = (self.radius.dtype(), self.radius.device());
        if distribution == Distribution::Gaussian {
            let normal = random.normal_tensor(&self.shape, dtype, device)?;
            let delta = normal.broadcast_mul(&(&self.radius / 3f64.sqrt())?)?;
            return Ok(self.project(&delta)?);
        }
        let delta = match self.norm {
            Norm::Linf => {
                let unit = random.uniform_tensor(&self.shape, dtype, device)?;
                match &self.bounds {
                    // Uniform between the bounds, without mass at them.
                    Some((lower, upper)) => {
                        let low = lower.broadcast_maximum(&self.radius.neg()?)?;
                        let high = upper.broadcast_minimum(&self.radius)?;
                        unit.broadcast_mul(&(high - &low)?)?.broadcast_add(&low)?
                    }
                    None => unit.affine(2.0, -1.0)?.broadcast_mul(&self.radius)?,
                }
            }
            Norm::L2 => {
                let dimensions = *self.shape.last().expect("a ball has a last axis");
                let normal = random.normal_tensor(&self.shape, dtype, device)?;
                let mut balls = self.shape.clone();
                *balls.last_mut().expect("not empty") = 1;
                let distance = random.uniform_tensor(&balls, dtype, device)?.powf(1.0 / dimensions as f64)?;
                self.direction(&normal)?.broadcast_mul(&distance)?.broadcast_mul(&self.radius)?
            }
        };
        Ok(self.project(&delta)?)
    }

    /// Returns the fraction of entries (of samples, for a ball) within 0.1 % of the radius or on a bound, among those
    /// that may move. `None` if none may.
    pub fn share_at_bound(&self, delta: &Tensor) -> Result<Option<f64>> {
        let size = match self.norm {
            Norm::Linf => delta.abs()?,
            Norm::L2 => l2_norm(delta)?,
        };
        let radius = self.radius.broadcast_as(size.shape())?;
        let mut at_bound = size.ge(&(&radius * 0.999)?)?.to_dtype(DType::F64)?;
        if let Some((lower, upper)) = &self.bounds
            && self.norm == Norm::Linf
        {
            let on_bounds = (delta.broadcast_le(lower)? + delta.broadcast_ge(upper)?)?.gt(0u8)?.to_dtype(DType::F64)?;
            at_bound = at_bound.maximum(&on_bounds)?;
        }
        let mut movable = radius.gt(0f64)?.to_dtype(DType::F64)?;
        if let Some(mask) = &self.mask {
            movable = movable.broadcast_mul(&mask.to_dtype(DType::F64)?)?;
        }
        let total = movable.sum_all()?.to_scalar::<f64>()?;
        let movable_at_bound = (at_bound * movable)?.sum_all()?.to_scalar::<f64>()?;
        Ok((total > 0.0).then(|| movable_at_bound / total))
    }
}

/// Returns the Euclidean norm over the last axis, kept with length 1. Values only; it is not differentiable at 0.
fn l2_norm(delta: &Tensor) -> TensorResult<Tensor> {
    delta.sqr()?.sum_keepdim(D::Minus1)?.sqrt()
}
