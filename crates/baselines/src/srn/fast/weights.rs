//! Weights in the order of products, and the positions of their gradients in a flat sum.

use std::ops::Range;

use crate::settings::SrnConfig;
use crate::srn::network::{HIDDEN, OF_BLOCK, Srn};
use augnerf_fast::fused::kernels::Head;
use augnerf_fast::fused::kernels::panels::{Packed, filled_up};

/// Number of gate values of the cell.
pub(super) const GATES: usize = 4 * HIDDEN;

/// A linear layer with its normalization.
pub(super) struct Block {
    pub(super) inputs: usize,
    pub(super) weight: Packed,
    /// The transpose, for the gradient of the layer below. `None` for the layer that reads points.
    pub(super) back: Option<Packed>,
    /// Padded to a panel.
    pub(super) bias: Vec<f32>,
    pub(super) scale: Vec<f32>,
    pub(super) shift: Vec<f32>,
    /// Start of its gradients: weight, bias, scale and shift, one after the other.
    at: usize,
}

/// The recurrent cell, and the head that computes a step's length from it.
pub(super) struct Cell {
    /// For the feature, and for the state.
    pub(super) input: Packed,
    pub(super) recurrent: Packed,
    pub(super) input_back: Packed,
    pub(super) recurrent_back: Packed,
    /// The sum of both.
    pub(super) bias: Vec<f32>,
    /// `[HIDDEN]`.
    pub(super) head: Vec<f32>,
    pub(super) head_bias: f32,
    /// The range of each gradient: both weights, both biases, the head's weight and bias.
    pub(super) at: [Range<usize>; 6],
}

/// A copy of an SRN's weights, made once per step.
pub(crate) struct Network {
    pub(super) config: SrnConfig,
    pub(super) phi: Vec<Block>,
    /// From the first layer of Phi back to points: its weights' transpose `[3, width]`.
    pub(super) to_points: Head,
    pub(super) cell: Cell,
    pub(super) pixel: Vec<Block>,
    pub(super) rgb: Head,
    pub(super) of_rgb: [Range<usize>; 2],
    /// Length of the flat gradient: all parameters in their order.
    pub(crate) gradient_size: usize,
}

/// The given parameters, and the positions of their gradients.
struct Given<'a> {
    values: std::slice::Iter<'a, Vec<f32>>,
    at: usize,
}

impl<'a> Given<'a> {
    fn next(&mut self) -> (&'a [f32], Range<usize>) {
        let values = self.values.next().expect("all parameters are there");
        let start = self.at;
        self.at += values.len();
        (values, start..self.at)
    }

    fn block(&mut self, inputs: usize, reads_points: bool) -> Block {
        let at = self.at;
        let [(weight, _), (bias, _), (scale, _), (shift, _)] = [(); OF_BLOCK].map(|()| self.next());
        let outputs = bias.len();
        Block {
            inputs,
            weight: packed(weight, outputs, inputs),
            back: (!reads_points).then(|| packed_back(weight, outputs, inputs)),
            bias: filled_up(bias),
            scale: scale.to_vec(),
            shift: shift.to_vec(),
            at,
        }
    }

    fn cell(&mut self, width: usize) -> Cell {
        let all = [(); 6].map(|()| self.next());
        let [input, recurrent, bias_ih, bias_hh, head, head_bias] = all.each_ref().map(|(values, _)| *values);
        let bias: Vec<f32> = bias_ih.iter().zip(bias_hh).map(|(a, b)| a + b).collect();
        Cell {
            input: packed(input, GATES, width),
            recurrent: packed(recurrent, GATES, HIDDEN),
            input_back: packed_back(input, GATES, width),
            recurrent_back: packed_back(recurrent, GATES, HIDDEN),
            bias: filled_up(&bias),
            head: head.to_vec(),
            head_bias: head_bias[0],
            at: all.map(|(_, at)| at),
        }
    }
}

/// Packs weights `[outputs, inputs]` for `x W^T`.
fn packed(weight: &[f32], outputs: usize, inputs: usize) -> Packed {
    Packed::new(false, (outputs, inputs), (inputs, 1), weight)
}

/// Packs weights for `dz W`.
fn packed_back(weight: &[f32], outputs: usize, inputs: usize) -> Packed {
    Packed::new(false, (inputs, 1), (outputs, inputs), weight)
}

impl Block {
    /// Returns its part of a flat gradient: weight, bias, scale and shift.
    pub(super) fn gradients<'a>(&self, sum: &'a mut [f32]) -> [&'a mut [f32]; OF_BLOCK] {
        let outputs = self.scale.len();
        let (weight, rest) = sum[self.at..].split_at_mut(outputs * self.inputs);
        let (bias, rest) = rest.split_at_mut(outputs);
        let (scale, rest) = rest.split_at_mut(outputs);
        [weight, bias, scale, &mut rest[..outputs]]
    }
}

impl Network {
    /// Lays out `values`, in the order of [`Srn::parameter_names`].
    pub(crate) fn new(config: &SrnConfig, values: &[Vec<f32>]) -> Network {
        let (width, mut given) = (config.width, Given { values: values.iter(), at: 0 });
        let phi = (0..config.phi_layers).map(|k| given.block(if k == 0 { 3 } else { width }, k == 0)).collect();
        let of_points = &values[0];
        let transposed: Vec<f32> = (0..3).flat_map(|axis| of_points.iter().skip(axis).step_by(3).copied()).collect();
        let cell = given.cell(width);
        let pixel = (0..config.pixel_layers).map(|_| given.block(width, false)).collect();
        let [(rgb, of_weight), (rgb_bias, of_bias)] = [(); 2].map(|()| given.next());
        Network {
            phi,
            to_points: Head::new(&transposed, &[0.0; 3]),
            cell,
            pixel,
            rgb: Head::new(rgb, rgb_bias),
            of_rgb: [of_weight, of_bias],
            gradient_size: given.at,
            config: config.clone(),
        }
    }

    /// Lays out the weights of an SRN on the CPU, in f32.
    pub(crate) fn of(srn: &Srn) -> candle_core::Result<Network> {
        let values = srn.tensors().iter().map(|tensor| tensor.flatten_all()?.to_vec1::<f32>());
        Ok(Network::new(srn.config(), &values.collect::<candle_core::Result<Vec<_>>>()?))
    }
}
