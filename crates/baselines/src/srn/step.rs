//! The contribution of a chunk to a step: gradients, and sums over its rays.

use std::ops::Range;

use candle_core::{DType, Device, Tensor};

use crate::base::Result;
use crate::data::{RayBuffer, Rays};
use crate::methods::{Extremes, Gradients};

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

/// Sums over rays, and gradients of the loss.
pub(super) struct Sums {
    /// In the order of the variables.
    pub(super) gradients: Gradients,
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

impl StepWork {
    /// Marches some rays, and adds their loss and its gradients to `sums`.
    pub(super) fn march(
        &self,
        srn: &Srn,
        rays: Range<usize>,
        weights: Weights,
        (dtype, device): (DType, &Device),
        sums: &mut Sums,
    ) -> Result<()> {
        let of = 3 * rays.start..3 * rays.end;
        let tensor = |values: &[f32]| Tensor::from_slice(values, (rays.len(), ()), device)?.to_dtype(dtype);
        let given = &self.rays;
        let vectors = [&given.origins, &given.directions, &given.viewdirs].map(|values| tensor(&values[of.clone()]));
        let [origins, directions, viewdirs] = vectors;
        let march = srn.march(&Rays::new(origins?, directions?, viewdirs?)?, &tensor(&self.z_0[rays.clone()])?)?;
        sums.add(srn, &march, &self.target[of], weights)
    }
}

impl Sums {
    /// Creates empty sums.
    pub(super) fn new(srn: &Srn) -> Sums {
        let gradients = Gradients::none(srn.parameters.variables.len());
        Sums { gradients, image: 0.0, error: 0.0, behind: 0.0, z: 0.0, z_squared: 0.0, extremes: Extremes::none(1.0) }
    }

    /// Adds a march, and the gradients of its loss.
    pub(super) fn add(&mut self, srn: &Srn, march: &SrnMarch, target: &[f32], weights: Weights) -> Result<()> {
        let values = |tensor: &Tensor| tensor.to_dtype(DType::F64)?.flatten_all()?.to_vec1::<f64>();
        let of_channel = |(place, (colour, target)): (usize, (f64, &f32))| {
            let target = f64::from(*target);
            let shown = |value: f64| (value.clamp(-1.0, 1.0) + 1.0) / 2.0;
            self.extremes.add(place % 3, shown(colour), shown(target));
            let difference = colour - target;
            self.image += difference * difference;
            self.error += ((colour.clamp(-1.0, 1.0) - target) / 2.0).powi(2);
            2.0 * weights.image * difference
        };
        let of_colour = values(&march.colour)?.into_iter().zip(target).enumerate().map(of_channel).collect();
        let of_ray = |z: f64| {
            self.z += z;
            self.z_squared += z * z;
            // Not `min`: NaN must stay, to be found and reported.
            let behind = if z > 0.0 { 0.0 } else { z };
            self.behind += behind * behind;
            2.0 * weights.depth * behind
        };
        let of_z = values(&march.z)?.into_iter().map(of_ray).collect();
        // The gradient of this sum is the loss's.
        let dot = |tensor: &Tensor, cotangent: Vec<f64>| -> candle_core::Result<Tensor> {
            let cotangent = Tensor::from_vec(cotangent, tensor.shape(), tensor.device())?.to_dtype(tensor.dtype())?;
            (tensor * cotangent)?.sum_all()
        };
        let sum = (dot(&march.colour, of_colour)? + dot(&march.z, of_z)?)?;
        self.gradients.add(&srn.parameters.variables, &sum.backward()?)
    }

    /// Sums the parts of a step in order. The bits do not depend on the number of threads.
    pub(super) fn sum(parts: Vec<Sums>) -> Result<Sums> {
        let of = |value: fn(&Sums) -> f64| parts.iter().map(value).sum::<f64>();
        let [image, error, behind] = [of(|part| part.image), of(|part| part.error), of(|part| part.behind)];
        let [z, z_squared] = [of(|part| part.z), of(|part| part.z_squared)];
        let extremes = parts.iter().fold(Extremes::none(1.0), |all, part| all.join(part.extremes));
        let gradients = Gradients::sum(parts.into_iter().map(|part| part.gradients).collect())?;
        Ok(Sums { gradients, image, error, behind, z, z_squared, extremes })
    }
}
