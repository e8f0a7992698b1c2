//! What a chunk of a step adds to it: gradients, and sums over its rays.

use std::ops::Range;

use candle_core::{DType, Device, Tensor};
use rayon::prelude::*;

use crate::base::Result;
use crate::data::{RayBuffer, Rays};
use crate::methods::Gradients;

use super::fast::{Lines, Network};
use super::network::{March, Srn};

/// The work of a step.
pub(super) struct Drawn {
    pub(super) rays: RayBuffer,
    /// Colours from -1 to 1, `[rays, 3]`.
    pub(super) target: Vec<f32>,
    /// Depths that rays start at, scene units times `srn.scale`, `[rays]`.
    pub(super) z_0: Vec<f32>,
}

/// What a ray's squared errors count in the loss, its share of the step included.
#[derive(Clone, Copy)]
pub(super) struct Weights {
    /// Of each channel.
    pub(super) image: f64,
    /// Of min(z, 0).
    pub(super) depth: f64,
}

/// Some rays of a step.
pub(super) struct Chunk<'a> {
    pub(super) drawn: &'a Drawn,
    pub(super) rays: Range<usize>,
    pub(super) weights: Weights,
}

/// Where gradients add up.
enum Pull {
    /// Flat, in the order of parameters.
    Flat(Vec<f32>),
    Tensors(Gradients),
}

/// Sums over rays, and gradients of the loss.
pub(super) struct Sums {
    pull: Pull,
    /// Squared errors of colours from -1 to 1.
    pub(super) image: f64,
    /// Of colours as they are shown, from 0 to 1.
    pub(super) error: f64,
    /// Squares of depths behind the camera.
    pub(super) behind: f64,
    /// Depths, and their squares.
    pub(super) z: f64,
    pub(super) z_squared: f64,
}

/// Gradients of the loss where rays ended: in colours `[rays, 3]` and depths `[rays]`.
struct Pulls {
    colour: Vec<f64>,
    z: Vec<f64>,
}

impl Chunk<'_> {
    fn lines(&self) -> Lines<'_> {
        let (Drawn { rays, z_0, .. }, of) = (self.drawn, 3 * self.rays.start..3 * self.rays.end);
        Lines {
            origins: &rays.origins[of.clone()],
            directions: &rays.directions[of.clone()],
            viewdirs: &rays.viewdirs[of],
            z_0: &z_0[self.rays.clone()],
        }
    }

    fn target(&self) -> &[f32] {
        &self.drawn.target[3 * self.rays.start..3 * self.rays.end]
    }

    /// On packed weights.
    pub(super) fn learn_fast(&self, network: &Network, sums: &mut Sums) {
        sums.learn(network, self.lines(), self.target(), self.weights);
    }

    /// In candle's operations.
    pub(super) fn learn_plain(&self, srn: &Srn, (dtype, device): (DType, &Device), sums: &mut Sums) -> Result<()> {
        let Lines { origins, directions, viewdirs, z_0 } = self.lines();
        let tensor = |values: &[f32]| Tensor::from_slice(values, (self.rays.len(), ()), device)?.to_dtype(dtype);
        let rays = Rays::new(tensor(origins)?, tensor(directions)?, tensor(viewdirs)?)?;
        sums.descend(srn, &srn.march(&rays, &tensor(z_0)?)?, self.target(), self.weights)
    }
}

impl Sums {
    /// Nothing yet; on packed weights gradients are flat.
    pub(super) fn new(network: Option<&Network>, srn: &Srn) -> Sums {
        let pull = match network {
            Some(network) => Pull::Flat(vec![0.0; network.gradient_size]),
            None => Pull::Tensors(Gradients::none(srn.variables().len())),
        };
        Sums { pull, image: 0.0, error: 0.0, behind: 0.0, z: 0.0, z_squared: 0.0 }
    }

    /// Adds marches that ended with these colours and depths, and returns the loss's gradients in them.
    fn add<T: Into<f64>>(
        &mut self,
        colour: impl Iterator<Item = T>,
        z: impl Iterator<Item = T>,
        target: &[f32],
        weights: Weights,
    ) -> Pulls {
        let of_channel = |(colour, target): (T, &f32)| {
            let (colour, target) = (colour.into(), f64::from(*target));
            let difference = colour - target;
            self.image += difference * difference;
            self.error += ((colour.clamp(-1.0, 1.0) - target) / 2.0).powi(2);
            2.0 * weights.image * difference
        };
        let colour = colour.zip(target).map(of_channel).collect();
        let of_ray = |z: T| {
            let z = z.into();
            self.z += z;
            self.z_squared += z * z;
            // Not `min`: a NaN must stay one, to be found and reported.
            let behind = if z > 0.0 { 0.0 } else { z };
            self.behind += behind * behind;
            2.0 * weights.depth * behind
        };
        Pulls { colour, z: z.map(of_ray).collect() }
    }

    /// Adds a march on packed weights, and the gradients of its loss.
    pub(super) fn learn(&mut self, network: &Network, lines: Lines, target: &[f32], weights: Weights) {
        let tape = network.march(lines, true);
        let pulls = self.add(tape.colour.iter().copied(), tape.z.iter().copied(), target, weights);
        let single = |values: Vec<f64>| values.into_iter().map(|value| value as f32).collect::<Vec<f32>>();
        let (colour, z) = (single(pulls.colour), single(pulls.z));
        if let Pull::Flat(sum) = &mut self.pull {
            network.backward(lines, &tape, (&colour, &z), sum);
        }
    }

    /// Adds a march in candle's operations, and the gradients of its loss.
    pub(super) fn descend(&mut self, srn: &Srn, march: &March, target: &[f32], weights: Weights) -> Result<()> {
        let values = |tensor: &Tensor| tensor.to_dtype(DType::F64)?.flatten_all()?.to_vec1::<f64>();
        let pulls = self.add(values(&march.colour)?.into_iter(), values(&march.z)?.into_iter(), target, weights);
        // The gradient of this sum is the loss's.
        let pulled = |tensor: &Tensor, pull: Vec<f64>| -> candle_core::Result<Tensor> {
            let pull = Tensor::from_vec(pull, tensor.shape(), tensor.device())?.to_dtype(tensor.dtype())?;
            (tensor * pull)?.sum_all()
        };
        let sum = (pulled(&march.colour, pulls.colour)? + pulled(&march.z, pulls.z)?)?;
        match &mut self.pull {
            Pull::Tensors(gradients) => gradients.add(srn.variables(), &sum.backward()?),
            Pull::Flat(_) => Ok(()),
        }
    }

    /// Those of the parts of a step, in their order: the same bits whatever the number of threads.
    pub(super) fn sum(parts: Vec<Sums>) -> Result<Sums> {
        let of = |value: fn(&Sums) -> f64| parts.iter().map(value).sum::<f64>();
        let [image, error, behind] = [of(|part| part.image), of(|part| part.error), of(|part| part.behind)];
        let [z, z_squared] = [of(|part| part.z), of(|part| part.z_squared)];
        let (mut flat, mut tensors) = (Vec::new(), Vec::new());
        for part in parts {
            match part.pull {
                Pull::Flat(values) => flat.push(values),
                Pull::Tensors(gradients) => tensors.push(gradients),
            }
        }
        let pull = if flat.is_empty() { Pull::Tensors(Gradients::sum(tensors)?) } else { Pull::Flat(total(flat)) };
        Ok(Sums { pull, image, error, behind, z, z_squared })
    }

    /// The gradients, in the order of the variables.
    pub(super) fn gradients(self, srn: &Srn) -> Result<Gradients> {
        let flat = match self.pull {
            Pull::Flat(flat) => flat,
            Pull::Tensors(gradients) => return Ok(gradients),
        };
        let mut rest = &flat[..];
        let tensors = srn.variables().iter().map(|(_, var)| {
            let (values, others) = rest.split_at(var.elem_count());
            rest = others;
            Ok(Some(Tensor::from_slice(values, var.shape(), var.device())?))
        });
        Ok(Gradients(tensors.collect::<Result<_>>()?))
    }
}

/// The sum of vectors in their order; threads share their numbers.
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
