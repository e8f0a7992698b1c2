//! Ray marching through a volume of colour and opacity, with accumulation up to 1 (Lombardi et al. 2019, section 5).
//!
//! The volume fills [-1, 1]^3. A ray's sample k, a step of length `s_k`, adds `o_k s_k` to its accumulation until that
//! is 1, where `o_k` is opacity per length: `A_k = min(1, A_{k-1} + o_k s_k)`. Its colour is the sum of
//! `c_k (A_k - A_{k-1})`. Let `s` be the first sample at which the sum exceeds 1. The gradient of the colour in
//! `o_j s_j` is `c_j - c_s` before `s`, and 0 from there on. For a ray whose sum stays below 1 it is `c_j`.

use std::sync::Arc;

use candle_core::backend::BackendStorage;
use candle_core::{CpuStorage, CustomOp2, Device, Layout, Result, Shape, Tensor, WithDType};
use rayon::prelude::*;

use crate::base::rng::{Random, Stream};

use super::values::{Values, each_kind, slice, summed};
use lattice::{Corner, Lattice, Location};

/// Channels of a volume: red, green, blue, opacity per length.
const CHANNELS: usize = 4;
/// Numbers per ray: red, green, blue, accumulation, distance.
const OUT: usize = 5;
/// Rays per thread and iteration.
const RAYS: usize = 64;
/// Parts of the gradients, each with grids of its own, which are summed in order.
const PARTS: usize = 4;

/// A ray in the volume's coordinates.
#[derive(Clone, Copy, Debug)]
pub struct Line {
    /// Its start.
    pub origin: [f64; 3],
    /// Its unit direction.
    pub direction: [f64; 3],
}

/// The spacing of samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pace {
    /// The first sample is half a step before the volume, and the others are a step apart.
    Even,
    /// The first is up to a step before the volume, and steps are `exp(jitter * normal)` times as long, with the random
    /// numbers of a training step.
    Drawn {
        /// Standard deviation of the logarithm of a step.
        jitter: f64,
        /// Seed of the run.
        seed: u64,
        /// Number of finished steps.
        step: u64,
    },
}

/// Rays to march along.
#[derive(Clone)]
pub struct March {
    /// The rays.
    pub lines: Arc<[Line]>,
    /// Length of a step.
    pub step: f64,
    /// The spacing of samples.
    pub pace: Pace,
}

/// A ray's samples within the volume's box: distance and length of the step, until it leaves.
struct Strides {
    t: f64,
    end: f64,
    step: f64,
    jitter: f64,
    random: Option<Random>,
    spare: Option<f64>,
}

impl Strides {
    fn new(line: &Line, index: usize, march: &March) -> Strides {
        let (mut start, mut end) = (0f64, f64::INFINITY);
        for axis in 0..3 {
            let at = |face: f64| (face - line.origin[axis]) / line.direction[axis];
            let (a, b) = (at(-1.0), at(1.0));
            start = start.max(a.min(b));
            end = end.min(a.max(b));
        }
        // A ray that misses the box has no samples.
        let end = if start < end { end } else { f64::NEG_INFINITY };
        let (random, jitter, before) = match march.pace {
            Pace::Even => (None, 0.0, 0.5),
            Pace::Drawn { jitter, seed, step } => {
                let mut random = Random::part(seed, Stream::March, step, index as u64);
                let before = random.uniform();
                (Some(random), jitter, before)
            }
        };
        Strides { t: start - march.step * before, end, step: march.step, jitter, random, spare: None }
    }

    fn factor(&mut self) -> f64 {
        let Some(random) = self.random.as_mut().filter(|_| self.jitter > 0.0) else { return 1.0 };
        let normal = self.spare.take().unwrap_or_else(|| {
            let (now, later) = random.normal_pair();
            self.spare = Some(later);
            now
        });
        (self.jitter * normal).exp()
    }
}

impl Iterator for Strides {
    type Item = (f64, f64);

    fn next(&mut self) -> Option<(f64, f64)> {
        let t = self.t;
        if t >= self.end || t.is_nan() {
            return None;
        }
        let step = self.step * self.factor();
        self.t += step;
        Some((t, step))
    }
}

impl Line {
    fn at(&self, t: f64) -> [f64; 3] {
        std::array::from_fn(|axis| self.origin[axis] + t * self.direction[axis])
    }
}

/// Returns whether a point is within the box, without its faces.
fn is_inside(point: [f64; 3]) -> bool {
    point.iter().all(|at| -1.0 < *at && *at < 1.0)
}

impl March {
    /// Returns colour, accumulation and mean distance times accumulation of each ray, `[rays, 5]`, without a
    /// background. `template [z, y, x, 4]` has red, green, blue and opacity per length. It is looked up at the
    /// positions that `warp [z, y, x, 3]` has at the ray's points, or at the points themselves without a warp. It marches on
    /// the CPU, and returns a tensor on the template's device.
    pub fn forward(&self, template: &Tensor, warp: Option<&Tensor>) -> Result<Tensor> {
        let sides = |tensor: &Tensor| Ok::<_, candle_core::Error>([tensor.dim(0)?, tensor.dim(1)?, tensor.dim(2)?]);
        let lattice = |sides| Lattice { sides };
        let operation = Marched {
            march: self.clone(),
            template: lattice(sides(template)?),
            warp: warp.map(sides).transpose()?.map(lattice),
        };
        let on_host = |tensor: &Tensor| tensor.to_device(&Device::Cpu)?.contiguous();
        let nothing = Tensor::zeros(0, template.dtype(), &Device::Cpu)?;
        let warp = warp.map_or(Ok(nothing), on_host)?;
        on_host(template)?.apply_op2(&warp, operation)?.to_device(template.device())
    }
}

/// A sample within the box, with what the backward pass needs.
struct Sample<T> {
    t: T,
    step: T,
    /// Its location among the warp's cells.
    warped: Option<Location<T>>,
    /// Its location among the template's cells.
    place: Location<T>,
    value: [T; CHANNELS],
    /// Accumulation before and after.
    before: T,
    after: T,
    /// Whether the sum exceeds 1 here.
    fills: bool,
}

struct Marched {
    march: March,
    template: Lattice,
    warp: Option<Lattice>,
}

impl Marched {
    /// Follows a ray until it leaves the box or is full.
    #[inline(always)]
    fn follow<T: WithDType>(&self, ray: usize, template: &[T], warp: &[T], mut visit: impl FnMut(Sample<T>)) {
        let line = &self.march.lines[ray];
        let mut sum = T::zero();
        for (t, step) in Strides::new(line, ray, &self.march) {
            let point = line.at(t);
            if !is_inside(point) {
                continue;
            }
            let mut at = point.map(T::from_f64);
            let warped = self.warp.map(|lattice| {
                let place = lattice.place(at);
                at = mixed(&place, warp);
                place
            });
            let place = self.template.place(at);
            let value: [T; CHANNELS] = mixed(&place, template);
            let step = T::from_f64(step);
            let (before, full) = (sum, sum + value[3] * step);
            let fills = full > T::one();
            sum = if fills { T::one() } else { full };
            visit(Sample { t: T::from_f64(t), step, warped, place, value, before, after: sum, fills });
            if fills {
                return;
            }
        }
    }

    fn values<T: WithDType>(&self, template: &[T], warp: &[T]) -> Vec<T> {
        let mut out = vec![T::zero(); self.march.lines.len() * OUT];
        out.par_chunks_mut(RAYS * OUT).enumerate().for_each(|(block, out)| {
            for (index, out) in out.chunks_exact_mut(OUT).enumerate() {
                self.follow(block * RAYS + index, template, warp, |sample| {
                    let weight = sample.after - sample.before;
                    (0..3).for_each(|channel| out[channel] += sample.value[channel] * weight);
                    out[3] = sample.after;
                    out[4] += sample.t * weight;
                });
            }
        });
        out
    }

    /// Returns the gradients of template and warp, one after the other.
    fn gradients<T: WithDType>(&self, template: &[T], warp: &[T], gradient: &[T]) -> Vec<T> {
        let rays = self.march.lines.len();
        let of_part = |part: usize| {
            let mut sum = vec![T::zero(); template.len() + warp.len()];
            let (d_template, d_warp) = sum.split_at_mut(template.len());
            let mut samples = Vec::new();
            for ray in part * rays / PARTS..(part + 1) * rays / PARTS {
                samples.clear();
                self.follow(ray, template, warp, |sample| samples.push(sample));
                back(&samples, &gradient[ray * OUT..(ray + 1) * OUT], template, d_template, d_warp);
            }
            sum
        };
        summed((0..PARTS).into_par_iter().map(of_part).collect(), template.len() + warp.len())
    }
}

/// Returns the weighted mean of the corners' channels.
#[inline(always)]
fn mixed<T: WithDType, const C: usize>(place: &Location<T>, grid: &[T]) -> [T; C] {
    let mut sum = [T::zero(); C];
    for Corner { cell, weight } in place.corners() {
        let values = &grid[cell * C..][..C];
        (0..C).for_each(|channel| sum[channel] += weight * values[channel]);
    }
    sum
}

/// Returns the gradients in colour and opacity of each sample of a ray with this gradient, in closed form.
fn cotangents<T: WithDType>(samples: &[Sample<T>], gradient: &[T]) -> impl Iterator<Item = [T; CHANNELS]> {
    let [red, green, blue, acc, depth] = [0, 1, 2, 3, 4].map(|channel| gradient[channel]);
    // The derivative of the loss if the ray takes all of its colour from a sample.
    let worth = move |sample: &Sample<T>| {
        let [r, g, b, _] = sample.value;
        red * r + green * g + blue * b + depth * sample.t
    };
    // It replaces a full ray's last sample, or adds accumulation.
    let instead = match samples.last() {
        Some(last) if last.fills => worth(last),
        _ => T::zero() - acc,
    };
    samples.iter().map(move |sample| {
        let weight = sample.after - sample.before;
        let opacity = if sample.fills { T::zero() } else { sample.step * (worth(sample) - instead) };
        [red * weight, green * weight, blue * weight, opacity]
    })
}

/// Adds the contributions of a ray with this gradient to the gradients of template and warp.
fn back<T: WithDType>(samples: &[Sample<T>], gradient: &[T], template: &[T], d_template: &mut [T], d_warp: &mut [T]) {
    for (sample, cotangent) in samples.iter().zip(cotangents(samples, gradient)) {
        if cotangent.iter().all(|cotangent| *cotangent == T::zero()) {
            continue;
        }
        for Corner { cell, weight } in sample.place.corners() {
            let sums = &mut d_template[cell * CHANNELS..][..CHANNELS];
            (0..CHANNELS).for_each(|channel| sums[channel] += weight * cotangent[channel]);
        }
        let Some(warped) = &sample.warped else { continue };
        let d_point = sample.place.slope(|cell| {
            let values = &template[cell * CHANNELS..][..CHANNELS];
            (0..CHANNELS).fold(T::zero(), |sum, channel| sum + cotangent[channel] * values[channel])
        });
        for Corner { cell, weight } in warped.corners() {
            let sums = &mut d_warp[cell * 3..][..3];
            (0..3).for_each(|axis| sums[axis] += weight * d_point[axis]);
        }
    }
}

impl CustomOp2 for Marched {
    fn name(&self) -> &'static str {
        "saturating-march"
    }

    fn cpu_fwd(
        &self,
        template: &CpuStorage,
        template_layout: &Layout,
        warp: &CpuStorage,
        warp_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let out = each_kind!(template.dtype(), T => {
            let (template, warp) = (slice::<T>(template, template_layout)?, slice::<T>(warp, warp_layout)?);
            T::to_cpu_storage_owned(self.values(template, warp))
        });
        Ok((out, Shape::from((self.march.lines.len(), OUT))))
    }

    fn bwd(
        &self,
        template: &Tensor,
        warp: &Tensor,
        _out: &Tensor,
        gradient: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>)> {
        let gradient = gradient.contiguous()?;
        each_kind!(template.dtype(), T => {
            let (of_template, of_warp, of_gradient) = (Values::of(template), Values::of(warp), Values::of(&gradient));
            let (values, positions) = (of_template.slice::<T>()?, of_warp.slice::<T>()?);
            let mut d_template = self.gradients(values, positions, of_gradient.slice::<T>()?);
            let d_warp = d_template.split_off(values.len());
            let like = |values: Vec<T>, tensor: &Tensor| Tensor::from_vec(values, tensor.shape(), &Device::Cpu);
            let d_warp = self.warp.map(|_| like(d_warp, warp)).transpose()?;
            Ok((Some(like(d_template, template)?), d_warp))
        })
    }
}

mod lattice;
#[cfg(test)]
pub(crate) mod tests;
