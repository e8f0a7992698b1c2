//! The sets that deltas live in: radius, norm and bounds; random points, steps, projection.

use candle_core::{D, DType, Result as TensorResult, Tensor};

use crate::augment::Deltas;
use crate::base::Result;
use crate::base::rng::Random;
use crate::data::Scene;
use crate::settings::{LEVELS, Level, Norm, Passes, Radius, ResolvedPerturb};

/// How random points of a set are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Draw {
    /// Uniform in the set.
    Uniform,
    /// Normal with standard deviation radius / sqrt(3) (that of the uniform), then projected.
    Gaussian,
}

/// Angular and spatial size of a pixel, for the `xyz` and `view` sets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelScale {
    /// Image width in pixels.
    pub width: f64,
    /// Image height in pixels.
    pub height: f64,
    /// Focal length in pixels.
    pub focal: f64,
    /// Rays are in normalised device coordinates.
    pub ndc: bool,
}

impl PixelScale {
    /// That of a scene; the first training camera stands for all.
    pub fn of(scene: &Scene) -> PixelScale {
        let camera = &scene.train[0].camera;
        PixelScale {
            width: camera.width as f64,
            height: camera.height as f64,
            focal: camera.focal[0],
            ndc: scene.ndc.is_some(),
        }
    }

    /// One epsilon of `xyz` before the cap, scene units: 2/W in NDC, 1/f otherwise; the released
    /// code's 2 / max(H, W).
    fn radius(&self, choice: Radius) -> f64 {
        match choice {
            Radius::Released => 2.0 / self.width.max(self.height),
            Radius::Pixel if self.ndc => 2.0 / self.width,
            Radius::Pixel => 1.0 / self.focal,
        }
    }
}

/// What the sets of a pass depend on besides the configuration.
#[derive(Clone, Copy)]
pub struct PassGeometry<'a> {
    /// The coarse pass, otherwise the fine one.
    pub is_coarse: bool,
    /// Unperturbed sample positions, `[rays, samples]`, or edges of intervals, `[rays, samples + 1]`.
    pub t_vals: &'a Tensor,
    /// Samples of the pass.
    pub samples: usize,
    /// Lengths of the ray directions, `[rays, 1]`.
    pub direction_norm: &'a Tensor,
    /// Near and far, in the units of `t_vals`.
    pub bounds: (f64, f64),
    /// N of the cap (far - near) |d| / (2 (N - 1)) on the radius of `xyz`: columns of the coarse pass's `t_vals`.
    pub coarse_samples: usize,
    /// The field's width.
    pub width: usize,
    /// A pixel's size.
    pub pixel: PixelScale,
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

/// The sets of one pass; a level that is off, or whose epsilon is 0, has none.
#[derive(Clone, Default)]
pub struct Sets([Option<DeltaSet>; 6]);

impl Sets {
    /// The sets that `config` describes for a pass.
    pub fn new(config: &ResolvedPerturb, pass: &PassGeometry) -> Result<Sets> {
        let PassGeometry { is_coarse, t_vals, samples, direction_norm, bounds: (near, far), .. } = *pass;
        let rays = t_vals.dim(0)?;
        let scalar = |value: f64| Tensor::new(value, t_vals.device())?.to_dtype(t_vals.dtype());
        let mut sets = Sets::default();
        for level in LEVELS {
            let delta = config.delta(level);
            let epsilon = delta.epsilon;
            let takes_part = match delta.passes {
                Passes::Both => true,
                Passes::Coarse => is_coarse,
                Passes::Fine => !is_coarse,
                Passes::Off => false,
            };
            if !takes_part || epsilon == 0.0 {
                continue;
            }
            let norm = delta.norm;
            let set = match level {
                Level::T => along_ray(t_vals, epsilon, near, far)?,
                Level::Xyz => {
                    let cap = (direction_norm * ((far - near) / (2.0 * (pass.coarse_samples as f64 - 1.0))))?;
                    let pixel = scalar(pass.pixel.radius(config.xyz_radius))?;
                    let radius = match config.xyz_radius {
                        Radius::Pixel => cap.broadcast_minimum(&pixel)?,
                        // The released code's cap knows no length of the direction.
                        Radius::Released => cap.broadcast_div(direction_norm)?.broadcast_minimum(&pixel)?,
                    };
                    let radius = (radius * epsilon)?.unsqueeze(2)?; // [rays, 1, 1]
                    DeltaSet::new(norm, radius, &[rays, samples, 3])
                }
                Level::View => {
                    let radius = scalar(epsilon / (2.0 * pass.pixel.focal))?.reshape((1, 1))?;
                    DeltaSet::new(norm, radius, &[rays, 2])
                }
                Level::Feature => {
                    DeltaSet::new(norm, scalar(epsilon)?.reshape((1, 1, 1))?, &[rays, samples, pass.width])
                }
                Level::Rgb => DeltaSet::new(norm, scalar(epsilon)?.reshape((1, 1, 1))?, &[rays, samples, 3]),
                Level::Density => {
                    let mut set = DeltaSet::new(norm, scalar(epsilon)?.reshape((1, 1))?, &[rays, samples]);
                    // Edges end the last interval, too: nothing is opaque by definition.
                    if !config.perturb_last && t_vals.dim(1)? == samples {
                        set.mask = Some(all_but_last(samples, t_vals)?);
                    }
                    set
                }
            };
            sets.set(level, set);
        }
        Ok(sets)
    }

    /// The set of a level, where it is on.
    pub fn get(&self, level: Level) -> Option<&DeltaSet> {
        self.0[level as usize].as_ref()
    }

    /// Puts a level's set in place.
    pub fn set(&mut self, level: Level, set: DeltaSet) {
        self.0[level as usize] = Some(set);
    }

    /// The levels that are on, in order.
    pub fn levels(&self) -> impl Iterator<Item = Level> + '_ {
        LEVELS.into_iter().filter(|&level| self.get(level).is_some())
    }

    /// A random point of every set. Each level has numbers of its own, so that switching one on or
    /// off leaves the others' as they were.
    pub fn draw(&self, draw: Draw, random: impl Fn(Level) -> Random) -> Result<Deltas> {
        let mut deltas = Deltas::default();
        for level in self.levels() {
            deltas.set(level, self.get(level).expect("is on").draw(draw, &mut random(level))?);
        }
        Ok(deltas)
    }
}

/// The set of `t`: at most `epsilon` of the gap to the nearer neighbour (the ends: to their one
/// neighbour), within near..far.
///
/// The radius is two roundings short of its name: with epsilon 1/2 two neighbours may meet, and a
/// gap that was rounded up would let them pass each other.
fn along_ray(t_vals: &Tensor, epsilon: f64, near: f64, far: f64) -> Result<DeltaSet> {
    let (rays, samples) = t_vals.dims2()?;
    let gaps = (t_vals.narrow(1, 1, samples - 1)? - t_vals.narrow(1, 0, samples - 1)?)?;
    let before = Tensor::cat(&[&gaps.narrow(1, 0, 1)?, &gaps], 1)?;
    let after = Tensor::cat(&[&gaps, &gaps.narrow(1, samples - 2, 1)?], 1)?;
    let short = match t_vals.dtype() {
        DType::F64 => 1.0 - 2.0 * f64::EPSILON,
        _ => 1.0 - 2.0 * f64::from(f32::EPSILON),
    };
    let radius = (before.minimum(&after)? * (epsilon * short))?;
    let zero = t_vals.zeros_like()?;
    // A sample outside near..far (rounding) must not be pushed by its own bound.
    let lower = t_vals.affine(-1.0, near)?.minimum(&zero)?;
    let upper = t_vals.affine(-1.0, far)?.maximum(&zero)?;
    let mut set = DeltaSet::new(Norm::Linf, radius, &[rays, samples]);
    set.bounds = Some((lower, upper));
    Ok(set)
}

/// `[1, samples]`, 1 but for the last, which is 0.
fn all_but_last(samples: usize, like: &Tensor) -> Result<Tensor> {
    let mut mask = vec![1f32; samples];
    mask[samples - 1] = 0.0;
    Ok(Tensor::from_vec(mask, (1, samples), like.device())?.to_dtype(like.dtype())?)
}
