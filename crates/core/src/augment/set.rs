//! The set of one delta: radius, norm and bounds; random points, directions, projection.

use candle_core::{D, DType, Result as TensorResult, Tensor};
use serde::{Deserialize, Serialize};

use crate::base::Result;
use crate::base::rng::Random;

/// The norm of a delta's set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Norm {
    /// Box; steps by the gradient's sign.
    Linf,
    /// Ball per sample; steps along the normalised gradient.
    L2,
}

impl Norm {
    /// The name in files and tables.
    pub fn name(self) -> &'static str {
        match self {
            Norm::Linf => "linf",
            Norm::L2 => "l2",
        }
    }
}

/// How random points of a set are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Draw {
    /// Uniform in the set.
    Uniform,
    /// Normal with standard deviation radius / sqrt(3) (that of the uniform), then projected.
    Gaussian,
}

/// One delta's set.
#[derive(Clone)]
pub struct DeltaSet {
    /// Box or ball; a ball is over the delta's last axis.
    pub norm: Norm,
    /// Not negative; broadcasts to the delta's shape. For a ball its last axis has length 1.
    pub radius: Tensor,
    /// Smallest and largest allowed values, where the set is cut by more than its radius.
    pub bounds: Option<(Tensor, Tensor)>,
    /// Multiplied in last: 0 where the delta must be 0.
    pub mask: Option<Tensor>,
    /// The delta's shape.
    pub shape: Vec<usize>,
}

impl DeltaSet {
    /// A set with a radius alone.
    pub fn new(norm: Norm, radius: Tensor, shape: &[usize]) -> DeltaSet {
        DeltaSet { norm, radius, bounds: None, mask: None, shape: shape.to_vec() }
    }

    /// The nearest point of the set (for a ball cut by bounds: of the ball, then of the box).
    pub fn project(&self, delta: &Tensor) -> TensorResult<Tensor> {
        let mut delta = match self.norm {
            Norm::Linf => delta.broadcast_minimum(&self.radius)?.broadcast_maximum(&self.radius.neg()?)?,
            Norm::L2 => {
                let norm = l2_norm(delta)?;
                // Where the norm is 0 the quotient is infinite and the scale 1.
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

    /// The same set cut by further bounds.
    pub fn within(&self, lower: Tensor, upper: Tensor) -> DeltaSet {
        DeltaSet { bounds: Some((lower, upper)), ..self.clone() }
    }

    /// The ascent direction of `gradient`: its sign, or its unit vector per sample; 0 at 0.
    pub fn direction(&self, gradient: &Tensor) -> TensorResult<Tensor> {
        match self.norm {
            Norm::Linf => gradient.sign(),
            Norm::L2 => {
                // Scaled by the largest entry first, so that tiny gradients do not underflow.
                let largest = gradient.abs()?.max_keepdim(D::Minus1)?;
                let safe = largest.gt(0f64)?.where_cond(&largest, &largest.ones_like()?)?;
                let scaled = gradient.broadcast_div(&safe)?;
                let norm = l2_norm(&scaled)?;
                let safe = norm.gt(0f64)?.where_cond(&norm, &norm.ones_like()?)?;
                scaled.broadcast_div(&safe)
            }
        }
    }

    /// A random point of the set.
    pub fn draw(&self, draw: Draw, random: &mut Random) -> Result<Tensor> {
        let (dtype, device) = (self.radius.dtype(), self.radius.device());
        if draw == Draw::Gaussian {
            let normal = random.normal_tensor(&self.shape, dtype, device)?;
            let delta = normal.broadcast_mul(&(&self.radius / 3f64.sqrt())?)?;
            return Ok(self.project(&delta)?);
        }
        let delta = match self.norm {
            Norm::Linf => {
                let unit = random.uniform_tensor(&self.shape, dtype, device)?;
                match &self.bounds {
                    // Uniform between the cut ends, not piled up at them.
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
                let mut outer = self.shape.clone();
                *outer.last_mut().expect("not empty") = 1;
                let distance = random.uniform_tensor(&outer, dtype, device)?.powf(1.0 / dimensions as f64)?;
                self.direction(&normal)?.broadcast_mul(&distance)?.broadcast_mul(&self.radius)?
            }
        };
        Ok(self.project(&delta)?)
    }

    /// Share of entries (of samples, for a ball) within 0.1 % of the radius or on a bound, among
    /// those that may move at all; none if none may.
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
            let cut = (delta.broadcast_le(lower)? + delta.broadcast_ge(upper)?)?.gt(0u8)?.to_dtype(DType::F64)?;
            at_bound = at_bound.maximum(&cut)?;
        }
        let mut movable = radius.gt(0f64)?.to_dtype(DType::F64)?;
        if let Some(mask) = &self.mask {
            movable = movable.broadcast_mul(&mask.to_dtype(DType::F64)?)?;
        }
        let total = movable.sum_all()?.to_scalar::<f64>()?;
        let share = (at_bound * movable)?.sum_all()?.to_scalar::<f64>()?;
        Ok((total > 0.0).then(|| share / total))
    }
}

/// Euclidean norm over the last axis, kept as length 1. Values only; not differentiable at 0.
fn l2_norm(delta: &Tensor) -> TensorResult<Tensor> {
    delta.sqr()?.sum_keepdim(D::Minus1)?.sqrt()
}
