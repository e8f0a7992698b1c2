//! The parameters of a neural volume: names, sizes, initial values.

use std::slice::Iter;

use candle_core::{DType, Device, Tensor};

use crate::base::Result;
use crate::base::rng::{Random, Stream};
use crate::grids::conv3d::Conv3d;
use crate::parameters::Parameters;
use crate::settings::{Config, VolumeCode, VolumeConfig};

use super::cube::Cube;

/// Slope of the leaky ReLU below 0.
pub(super) const SLOPE: f64 = 0.2;
/// Taps of a transposed convolution.
const TAPS: usize = 64;

/// Sizes of all layers.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Sizes {
    pub(super) code: usize,
    /// Channels before and after each transposed convolution; the last 4 are red, green, blue and opacity.
    pub(super) channels: Vec<usize>,
    pub(super) warp: Option<WarpSizes>,
}

/// Sizes of the warp's layers.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct WarpSizes {
    /// Number of affine maps.
    pub(super) maps: usize,
    /// Hidden channels of the heads for the maps, and of the head for their weights.
    pub(super) hidden: [usize; 2],
    /// Points along a side.
    pub(super) side: usize,
}

impl Sizes {
    /// Returns the original's sizes, divided.
    pub(super) fn of(config: &VolumeConfig) -> Sizes {
        let warp = config.warp.then_some(WarpSizes { maps: 16, hidden: [128, 64], side: config.warp_resolution });
        Sizes { code: 256, channels: channels(config.resolution, config.divide), warp }
    }

    /// Returns the warp's heads: name, hidden channels, outputs.
    pub(super) fn heads(&self) -> Vec<(&'static str, usize, usize)> {
        let heads = |WarpSizes { maps, hidden: [small, few], side }: &WarpSizes| {
            let outputs = [("scale", *small, 3), ("quaternion", *small, 4), ("translation", *small, 3)];
            let maps_of = outputs.map(|(name, hidden, numbers)| (name, hidden, numbers * maps));
            maps_of.into_iter().chain([("weights", *few, maps * side.pow(3))]).collect()
        };
        self.warp.as_ref().map(heads).unwrap_or_default()
    }

    /// Returns all layers in the order of parameters.
    fn layers(&self) -> Vec<Layer> {
        let leaky = (2.0 / (1.0 + SLOPE * SLOPE)).sqrt();
        let linear = |name: String, inputs, outputs, gain| Layer { name, inputs, outputs, taps: None, gain };
        let mut layers = vec![linear("template.0".into(), self.code, self.channels[0], leaky)];
        let count = self.channels.len() - 1;
        for (index, pair) in self.channels.windows(2).enumerate() {
            let gain = if index + 1 == count { 1.0 } else { leaky };
            let name = format!("template.{}", index + 1);
            layers.push(Layer { name, inputs: pair[0], outputs: pair[1], taps: Some(TAPS), gain });
        }
        for (name, hidden, outputs) in self.heads() {
            layers.push(linear(format!("warp.{name}.0"), self.code, hidden, leaky));
            layers.push(linear(format!("warp.{name}.1"), hidden, outputs, 1.0));
        }
        layers
    }
}

/// Returns the channels of the transposed convolutions from one voxel to `resolution` voxels per side, halved at every
/// other one.
pub(super) fn channels(resolution: usize, divide: usize) -> Vec<usize> {
    let (mut inputs, mut outputs) = (1024, 512);
    let mut channels = vec![inputs / divide];
    for _ in 1..resolution.ilog2() {
        channels.push(outputs / divide);
        if inputs == outputs {
            outputs = inputs / 2;
        } else {
            inputs = outputs;
        }
    }
    channels.push(4);
    channels
}

/// A layer's parameters.
struct Layer {
    name: String,
    inputs: usize,
    outputs: usize,
    /// Taps of a transposed convolution.
    taps: Option<usize>,
    gain: f64,
}

impl Layer {
    fn weight_shape(&self) -> Vec<usize> {
        match self.taps {
            Some(taps) => vec![taps, self.inputs, self.outputs],
            None => vec![self.outputs, self.inputs],
        }
    }

    /// Returns uniform numbers of Xavier's deviation (Glorot and Bengio 2010). The 4 x 4 x 4 kernels are equal in
    /// blocks of 2, so that a volume starts without a pattern of its own.
    fn weight(&self, random: &mut Random) -> Vec<f32> {
        // Eight taps meet in each output of a transposed convolution.
        let meeting = if self.taps.is_some() { 8.0 } else { 1.0 };
        let deviation = self.gain * (2.0 / ((self.inputs + self.outputs) as f64 * meeting)).sqrt();
        let bound = (3f64.sqrt() * deviation) as f32;
        let mut draw = |count: usize| random.uniform_map(count, |unit| (2.0 * unit - 1.0) * bound);
        if self.taps.is_none() {
            return draw(self.inputs * self.outputs);
        }
        let matrix = self.inputs * self.outputs;
        let blocks = draw(8 * matrix);
        let product = Conv3d::transposed([1, 1, 1]);
        let block = |at: &[usize; 3]| (at[0] / 2 * 2 + at[1] / 2) * 2 + at[2] / 2;
        product.kernel().iter().flat_map(|at| blocks[block(at) * matrix..][..matrix].iter().copied()).collect()
    }
}

/// A volume's decoder, with its code.
#[derive(Clone)]
pub struct NeuralVolume {
    pub(super) sizes: Sizes,
    /// The part of the scene that it fills.
    pub(super) cube: Cube,
    code: VolumeCode,
    pub(crate) parameters: Parameters,
}

/// A layer's weight and bias.
pub(super) type Pair = [Tensor; 2];

impl NeuralVolume {
    /// Returns names and shapes of all parameters (`volume.code`, `volume.template.3.weight`, ...), in their fixed
    /// order.
    pub fn parameter_names(config: &Config) -> Vec<(String, Vec<usize>)> {
        names(&Sizes::of(&config.nv), config.nv.code)
    }

    /// Initializes a volume with a standard normal code, or with a distribution of codes whose mean has a tenth of its
    /// deviation.
    ///
    /// # Errors
    /// [`crate::base::Error::Config`] if the box of the volume is not known.
    pub fn init(config: &Config, dtype: DType, device: &Device) -> Result<NeuralVolume> {
        let sizes = Sizes::of(&config.nv);
        let mut index = 0..;
        let mut random = || Random::new(config.seed, Stream::Init, index.next().expect("without end"));
        let tensor = |values: Vec<f32>, shape: &[usize]| -> Result<Tensor> {
            Ok(Tensor::from_vec(values, shape, device)?.to_dtype(dtype)?)
        };
        let mut values = Vec::new();
        let mut mean = random().normal_values(sizes.code);
        if config.nv.code == VolumeCode::Variational {
            mean.iter_mut().for_each(|value| *value *= 0.1);
            values.push(tensor(mean, &[sizes.code])?);
            values.push(tensor(vec![0.0; sizes.code], &[sizes.code])?);
        } else {
            values.push(tensor(mean, &[sizes.code])?);
        }
        for layer in sizes.layers() {
            values.push(tensor(layer.weight(&mut random()), &layer.weight_shape())?);
            values.push(tensor(vec![0.0; layer.outputs], &[layer.outputs])?);
        }
        NeuralVolume::over(sizes, config.nv.code, Cube::of(config)?, values)
    }

    /// Creates a volume with given values, in the order of [`NeuralVolume::parameter_names`].
    ///
    /// # Errors
    /// Those of [`NeuralVolume::init`] and of [`Parameters::new`].
    pub fn from_parameters(config: &Config, values: Vec<Tensor>) -> Result<NeuralVolume> {
        NeuralVolume::over(Sizes::of(&config.nv), config.nv.code, Cube::of(config)?, values)
    }

    pub(super) fn over(sizes: Sizes, code: VolumeCode, cube: Cube, values: Vec<Tensor>) -> Result<NeuralVolume> {
        Ok(NeuralVolume { parameters: Parameters::new(names(&sizes, code), values)?, sizes, cube, code })
    }

    /// Returns the mean of the code, and the logarithm of its deviation if it has one.
    pub(super) fn code(&self) -> (Tensor, Option<Tensor>) {
        let tensor = |index: usize| self.parameters.variables[index].1.as_tensor().clone();
        (tensor(0), (self.code == VolumeCode::Variational).then(|| tensor(1)))
    }

    /// Returns weight and bias of all layers in their order, without gradients if they are `frozen`.
    pub(super) fn layers(&self, frozen: bool) -> Vec<Pair> {
        let first = if self.code == VolumeCode::Variational { 2 } else { 1 };
        let tensors = self.parameters.tensors(!frozen);
        tensors[first..].chunks(2).map(|pair| [pair[0].clone(), pair[1].clone()]).collect()
    }
}

/// Returns the next layer.
pub(super) fn next<'a>(layers: &mut Iter<'a, Pair>) -> &'a Pair {
    layers.next().expect("as many layers as sizes say")
}

fn names(sizes: &Sizes, code: VolumeCode) -> Vec<(String, Vec<usize>)> {
    let mut names = vec![("volume.code".to_string(), vec![sizes.code])];
    if code == VolumeCode::Variational {
        names.push(("volume.code_log_deviation".into(), vec![sizes.code]));
    }
    for layer in sizes.layers() {
        names.push((format!("volume.{}.weight", layer.name), layer.weight_shape()));
        names.push((format!("volume.{}.bias", layer.name), vec![layer.outputs]));
    }
    names
}
