//! The contribution of a chunk to a step: gradients, and sums over its rays.

use std::ops::Range;

use candle_core::{DType, Device, Tensor};
use rayon::prelude::*;

use crate::base::Result;
use crate::data::{RayBuffer, Rays};
use crate::methods::{Extremes, Gradients};

use super::fast::{Lines, Network};
use super::network::{Srn, SrnMarch};

/// The inputs of a step.
pub(super) struct StepWork {
    pub(super) rays: RayBuffer,
    /// Colours from -1 to 1, `[rays, 3]`.
    pub(super) target: Vec<f32>,
    /// Initial depths of rays, in scene units times `srn.scale`, `[rays]`.
    pub(super) z_0: Vec<f32>,
}

/// Weights of a ray's squared errors in the loss, including its fraction of the step.
#[derive(Clone, Copy)]
pub(super) struct Weights {
    /// Of each channel.
    pub(super) image: f64,
    /// Of min(z, 0).
    pub(super) depth: f64,
}

/// Some rays of a step.
pub(super) struct Chunk<'a> {
    pub(super) work: &'a StepWork,
    pub(super) rays: Range<usize>,
    pub(super) weights: Weights,
}

/// The sum of gradients.
enum GradientSum {
    /// Flat, in the order of parameters.
    Flat(Vec<f32>),
    Tensors(Gradients),
}

/// Sums over rays, and gradients of the loss.
pub(super) struct Sums {
    gradients: GradientSum,
    /// Squared errors of colours from -1 to 1.
    pub(super) image: f64,
    /// Squared errors of colours as they are shown, from 0 to 1.
    pub(super) error: f64,
    /// Squares of depths behind the camera.
    pub(super) behind: f64,
    /// Depths, and their squares.
    pub(super) z: f64,
    pub(super) z_squared: f64,
    /// Extremes of the colours as they are shown. Marches accumulate no weight, so that no ray counts as empty.
    pub(super) extremes: Extremes,
}

/// Gradients of the loss at the ends of rays: in colours `[rays, 3]` and depths `[rays]`.
struct RayGradients {
    colour: Vec<f64>,
    z: Vec<f64>,
}

impl Chunk<'_> {
    fn lines(&self) -> Lines<'_> {
        let (StepWork { rays, z_0, .. }, of) = (self.work, 3 * self.rays.start..3 * self.rays.end);
        Lines {
            origins: &rays.origins[of.clone()],
            directions: &rays.directions[of.clone()],
            viewdirs: &rays.viewdirs[of],
            z_0: &z_0[self.rays.clone()],
        }
    }

    fn target(&self) -> &[f32] {
        &self.work.target[3 * self.rays.start..3 * self.rays.end]
    }

    /// Runs the chunk on packed weights.
    pub(super) fn step_fast(&self, network: &Network, sums: &mut Sums) {
        sums.add_packed(network, self.lines(), self.target(), self.weights);
    }

    /// Runs the chunk in candle's operations.
    pub(super) fn step_plain(&self, srn: &Srn, (dtype, device): (DType, &Device), sums: &mut Sums) -> Result<()> {
        let Lines { origins, directions, viewdirs, z_0 } = self.lines();
        let tensor = |values: &[f32]| Tensor::from_slice(values, (self.rays.len(), ()), device)?.to_dtype(dtype);
        let rays = Rays::new(tensor(origins)?, tensor(directions)?, tensor(viewdirs)?)?;
        sums.add_plain(srn, &srn.march(&rays, &tensor(z_0)?)?, self.target(), self.weights)
    }
}

impl Sums {
    /// Creates empty sums. On packed weights gradients are flat.
    pub(super) fn new(network: Option<&Network>, srn: &Srn) -> Sums {
        let gradients = match network {
            Some(network) => GradientSum::Flat(vec![0.0; network.gradient_size]),
            None => GradientSum::Tensors(Gradients::none(srn.parameters.variables.len())),
        };
        Sums { gradients, image: 0.0, error: 0.0, behind: 0.0, z: 0.0, z_squared: 0.0, extremes: Extremes::none(1.0) }
    }

    /// Adds marches that ended with these colours and depths, and returns the loss's gradients in them.
    fn add<T: Into<f64>>(
        &mut self,
        colour: impl Iterator<Item = T>,
        z: impl Iterator<Item = T>,
        target: &[f32],
        weights: Weights,
    ) -> RayGradients {
        let of_channel = |(place, (colour, target)): (usize, (T, &f32))| {
            let (colour, target) = (colour.into(), f64::from(*target));
            let shown = |value: f64| (value.clamp(-1.0, 1.0) + 1.0) / 2.0;
            self.extremes.add(place % 3, shown(colour), shown(target));
            let difference = colour - target;
            self.image += difference * difference;
            self.error += ((colour.clamp(-1.0, 1.0) - target) / 2.0).powi(2);
            2.0 * weights.image * difference
        };
        let colour = colour.zip(target).enumerate().map(of_channel).collect();
        let of_ray = |z: T| {
            let z = z.into();
            self.z += z;
            self.z_squared += z * z;
            // Not `min`: NaN must stay, to be found and reported.
            let behind = if z > 0.0 { 0.0 } else { z };
            self.behind += behind * behind;
            2.0 * weights.depth * behind
        };
        RayGradients { colour, z: z.map(of_ray).collect() }
    }

    /// Adds a march on packed weights, and the gradients of its loss.
    pub(super) fn add_packed(&mut self, network: &Network, lines: Lines, target: &[f32], weights: Weights) {
        let tape = network.march(lines, true);
        let rays = self.add(tape.colour.iter().copied(), tape.z.iter().copied(), target, weights);
        let single = |values: Vec<f64>| values.into_iter().map(|value| value as f32).collect::<Vec<f32>>();
        let (colour, z) = (single(rays.colour), single(rays.z));
        if let GradientSum::Flat(sum) = &mut self.gradients {
            network.backward(lines, &tape, (&colour, &z), sum);
        }
    }

    /// Adds a march in candle's operations, and the gradients of its loss.
    pub(super) fn add_plain(&mut self, srn: &Srn, march: &SrnMarch, target: &[f32], weights: Weights) -> Result<()> {
        let values = |tensor: &Tensor| tensor.to_dtype(DType::F64)?.flatten_all()?.to_vec1::<f64>();
        let rays = self.add(values(&march.colour)?.into_iter(), values(&march.z)?.into_iter(), target, weights);
        // The gradient of this sum is the loss's.
        let dot = |tensor: &Tensor, cotangent: Vec<f64>| -> candle_core::Result<Tensor> {
            let cotangent = Tensor::from_vec(cotangent, tensor.shape(), tensor.device())?.to_dtype(tensor.dtype())?;
            (tensor * cotangent)?.sum_all()
        };
        let sum = (dot(&march.colour, rays.colour)? + dot(&march.z, rays.z)?)?;
        match &mut self.gradients {
            GradientSum::Tensors(gradients) => gradients.add(&srn.parameters.variables, &sum.backward()?),
            GradientSum::Flat(_) => Ok(()),
        }
    }

    /// Sums the parts of a step in order. The bits do not depend on the number of threads.
    pub(super) fn sum(parts: Vec<Sums>) -> Result<Sums> {
        let of = |value: fn(&Sums) -> f64| parts.iter().map(value).sum::<f64>();
        let [image, error, behind] = [of(|part| part.image), of(|part| part.error), of(|part| part.behind)];
        let [z, z_squared] = [of(|part| part.z), of(|part| part.z_squared)];
        let extremes = parts.iter().fold(Extremes::none(1.0), |all, part| all.join(part.extremes));
        let (mut flat, mut tensors) = (Vec::new(), Vec::new());
        for part in parts {
            match part.gradients {
                GradientSum::Flat(values) => flat.push(values),
                GradientSum::Tensors(gradients) => tensors.push(gradients),
            }
        }
        let gradients = if flat.is_empty() {
            GradientSum::Tensors(Gradients::sum(tensors)?)
        } else {
            GradientSum::Flat(total(flat))
        };
        Ok(Sums { gradients, image, error, behind, z, z_squared, extremes })
    }

    /// Returns the gradients, in the order of the variables.
    pub(super) fn gradients(self, srn: &Srn) -> Result<Gradients> {
        let flat = match self.gradients {
            GradientSum::Flat(flat) => flat,
            GradientSum::Tensors(gradients) => return Ok(gradients),
        };
        let mut rest = &flat[..];
        let tensors = srn.parameters.variables.iter().map(|(_, var)| {
            let (values, others) = rest.split_at(var.elem_count());
            rest = others;
            Ok(Some(Tensor::from_slice(values, var.shape(), var.device())?))
        });
        Ok(Gradients(tensors.collect::<Result<_>>()?))
    }
}

/// Sums vectors in order. Threads share their numbers.
fn total(parts: Vec<Vec<f32>>) -> Vec<f32> {
    const BLOCK: usize = 1 << 14;
    let mut parts = parts.into_iter();
    let mut total = parts.next().unwrap_or_default();
    let rest: Vec<Vec<f32>> = parts.collect();
    total.par_chunks_mut(BLOCK).enumerate().for_each(|(block, total)| {
        for part in &rest {
            total.iter_mut().zip(&part[block * BLOCK..]).for_each(|(sum, value)| *sum += value);
        }
    });
    total
}
