//! The network of LLFF (Mildenhall et al. 2019): a 3D U-Net from a plane-sweep volume to a multiplane image.
//!
//! Convolutions of 3 x 3 x 3 without bias, layer normalization over a complete sample and ReLU, in TensorFlow slim's
//! order. The last one has a bias and nothing after it. There are three levels of half the side each, also along the
//! planes. The layers are those that third parties reported of the authors' network; the authors published none.

use std::sync::{Arc, Mutex};

use candle_core::{DType, Device, Tensor};

use crate::base::Result;
use crate::base::rng::{Random, Stream};
use crate::grids::conv3d::Conv3d;
use crate::grids::norm::{LayerNorm, NormGroup};
use crate::grids::upsample;
use crate::parameters::Parameters;
use crate::settings::Config;

use super::mpi::CachedMpis;

/// Taps of a convolution.
const TAPS: usize = 27;

/// slim's own normalization.
const NORM: LayerNorm = LayerNorm { group: NormGroup::Sample, epsilon: 1e-12, relu: true };

/// Sides of a layer's grid relative to those of its input.
enum Sides {
    Same,
    /// The same, with taps two cells apart.
    Dilated,
    Halved,
    /// Twice: it reads the nearest cells.
    Doubled,
}

use Sides::{Dilated, Doubled, Halved, Same};

/// A convolution: its name, and channels in and out.
struct Layer {
    name: &'static str,
    inputs: usize,
    outputs: usize,
    sides: Sides,
}

const fn layer(name: &'static str, inputs: usize, outputs: usize, sides: Sides) -> Layer {
    Layer { name, inputs, outputs, sides }
}

/// All convolutions with a normalization, in their order. Channels that depend on the number of input views are 0 here.
const LAYERS: [Layer; 17] = [
    layer("conv1_1", 0, 8, Same),
    layer("conv1_2", 8, 16, Halved),
    layer("conv2_1", 16, 16, Same),
    layer("conv2_2", 16, 32, Halved),
    layer("conv3_1", 32, 32, Same),
    layer("conv3_2", 32, 32, Same),
    layer("conv3_3", 32, 64, Halved),
    layer("conv4_1", 64, 64, Dilated),
    layer("conv4_2", 64, 64, Dilated),
    layer("conv4_3", 64, 64, Dilated),
    layer("conv5_1", 128, 32, Doubled),
    layer("conv5_2", 32, 32, Same),
    layer("conv5_3", 32, 32, Same),
    layer("conv6_1", 64, 16, Doubled),
    layer("conv6_2", 16, 16, Same),
    layer("conv7_1", 32, 8, Doubled),
    layer("conv7_2", 8, 8, Same),
];

/// The last convolution.
const LAST: Layer = layer("conv7_3", 8, 0, Same);

/// The network's parameters in their fixed order, with the images that the last renderer made.
#[derive(Clone)]
pub struct MpiNetwork {
    pub(crate) parameters: Parameters,
    /// Number of input views.
    inputs: usize,
    /// Multiplane images of these weights.
    pub(super) kept: Arc<Mutex<Option<CachedMpis>>>,
}

impl MpiNetwork {
    /// Initializes the weights: uniform by Xavier's rule, as in slim; scales 1, shifts and the bias 0.
    pub fn init(config: &Config, dtype: DType, device: &Device) -> Result<MpiNetwork> {
        let mut layer = 0..;
        let value = |(name, shape): (String, Vec<usize>)| -> Result<Tensor> {
            let [taps, from, to] = shape[..] else {
                let value = if name.ends_with("scale") { 1f32 } else { 0.0 };
                return Ok(Tensor::full(value, shape, device)?.to_dtype(dtype)?);
            };
            let mut random = Random::part(config.seed, Stream::Init, 0, layer.next().expect("without end"));
            let limit = (6.0 / (taps * (from + to)) as f64).sqrt() as f32;
            let drawn = random.uniform_map(taps * from * to, |unit| limit * (2.0 * unit - 1.0));
            Ok(Tensor::from_vec(drawn, shape, device)?.to_dtype(dtype)?)
        };
        let values = MpiNetwork::parameter_names(config).into_iter().map(value).collect::<Result<_>>()?;
        MpiNetwork::from_parameters(config, values)
    }

    /// Returns names and shapes of all parameters, in their fixed order. Kernels are `[taps, in, out]`, taps along z,
    /// y, x.
    pub fn parameter_names(config: &Config) -> Vec<(String, Vec<usize>)> {
        let views = config.llff.inputs;
        let of_layer = |layer: &Layer| {
            let from = if layer.inputs == 0 { 3 * views } else { layer.inputs };
            let (to, others) = match layer.outputs {
                0 => (views, &["bias"][..]),
                outputs => (outputs, &["scale", "shift"][..]),
            };
            let named = |part: &str, shape| (format!("planes.{}.{part}", layer.name), shape);
            let others = others.iter().map(|part| named(part, vec![to]));
            std::iter::once(named("weight", vec![TAPS, from, to])).chain(others).collect::<Vec<_>>()
        };
        LAYERS.iter().chain([&LAST]).flat_map(of_layer).collect()
    }

    /// Creates a network with given values, in the order of [`MpiNetwork::parameter_names`].
    ///
    /// # Errors
    /// Those of [`Parameters::new`].
    pub fn from_parameters(config: &Config, values: Vec<Tensor>) -> Result<MpiNetwork> {
        let parameters = Parameters::new(MpiNetwork::parameter_names(config), values)?;
        Ok(MpiNetwork { parameters, inputs: config.llff.inputs, kept: Arc::default() })
    }

    /// Returns a copy of the weights, which stays the same when these are trained.
    pub(super) fn copy(&self) -> Result<MpiNetwork> {
        Ok(MpiNetwork { parameters: self.parameters.copy()?, inputs: self.inputs, kept: Arc::default() })
    }

    /// Returns the number of input views.
    pub fn inputs(&self) -> usize {
        self.inputs
    }

    /// Returns the device of the parameters.
    pub fn device(&self) -> &Device {
        self.parameters.variables[0].1.device()
    }

    /// Returns the type of the parameters.
    pub fn dtype(&self) -> DType {
        self.parameters.variables[0].1.dtype()
    }

    /// Returns the current parameters, with gradients or without.
    pub fn weights(&self, trainable: bool) -> Weights {
        Weights { tensors: self.parameters.tensors(trainable) }
    }
}

/// A network's parameters as tensors, in their order.
pub struct Weights {
    tensors: Vec<Tensor>,
}

impl Weights {
    /// Maps a plane-sweep volume `[planes, height, width, 3 views]` to numbers of every cell,
    /// `[planes, height, width, views]`. Channel 0 is alpha's, the others are the views' (see
    /// [`crate::grids::blend_views::blend_views`]). Sides are multiples of 8.
    ///
    /// # Errors
    /// If the sides are wrong; those of candle.
    pub fn forward(&self, sweep: &Tensor) -> Result<Tensor> {
        let one_2 = self.all(&["conv1_1", "conv1_2"], sweep)?;
        let two_2 = self.all(&["conv2_1", "conv2_2"], &one_2)?;
        let three_3 = self.all(&["conv3_1", "conv3_2", "conv3_3"], &two_2)?;
        let four_3 = self.all(&["conv4_1", "conv4_2", "conv4_3"], &three_3)?;
        let five_3 = self.all(&["conv5_1", "conv5_2", "conv5_3"], &joined(&four_3, &three_3)?)?;
        let six_2 = self.all(&["conv6_1", "conv6_2"], &joined(&five_3, &two_2)?)?;
        let seven_2 = self.all(&["conv7_1", "conv7_2"], &joined(&six_2, &one_2)?)?;
        let [weight, bias] = [0, 1].map(|i| &self.tensors[3 * LAYERS.len() + i]);
        convolution(&LAST, &seven_2, weight, bias)
    }

    /// Applies some convolutions one after another.
    fn all(&self, names: &[&str], x: &Tensor) -> Result<Tensor> {
        names.iter().try_fold(x.clone(), |x, name| self.one(name, &x))
    }

    fn one(&self, name: &str, x: &Tensor) -> Result<Tensor> {
        let index = LAYERS.iter().position(|layer| layer.name == name).expect("the network has it");
        let [weight, scale, shift] = [0, 1, 2].map(|i| &self.tensors[3 * index + i]);
        let no_bias = shift.detach().zeros_like()?;
        let y = convolution(&LAYERS[index], x, weight, &no_bias)?;
        Ok(NORM.apply(&y.unsqueeze(0)?, scale, shift)?.squeeze(0)?)
    }
}

fn convolution(layer: &Layer, x: &Tensor, weight: &Tensor, bias: &Tensor) -> Result<Tensor> {
    let (depth, height, width, _) = x.dims4()?;
    let product = |stride, dilation| Conv3d::convolution([depth, height, width], stride, dilation);
    Ok(match layer.sides {
        Same => product(1, 1).forward(x, weight, bias)?,
        Dilated => product(1, 2).forward(x, weight, bias)?,
        Halved => product(2, 1).forward(x, weight, bias)?,
        Doubled => upsample::convolution(x, weight, bias)?,
    })
}

/// Concatenates the channels of two grids.
fn joined(a: &Tensor, b: &Tensor) -> Result<Tensor> {
    Ok(Tensor::cat(&[a, b], 3)?)
}
