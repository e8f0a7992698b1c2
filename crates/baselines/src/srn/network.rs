//! An SRN's parameters, and its march.

use candle_core::{DType, Device, Tensor};

use crate::base::Result;
use crate::base::rng::{Random, Stream};
use crate::data::Rays;
use crate::grids::norm::{LayerNorm, NormGroup};
use crate::parameters::{self, Parameters};
use crate::settings::SrnConfig;

use super::cell::{Lstm, clamp_gradient};

/// Size of the recurrent cell's state.
const HIDDEN: usize = 16;
/// Bound of the gradient at each of its outputs.
const GRADIENT_LIMIT: f64 = 10.0;
/// Added to a layer's variance.
const EPSILON: f64 = 1e-5;
/// Parameters of a layer: weight, bias, and the normalization's scale and shift.
const OF_BLOCK: usize = 4;

/// How a parameter is initialized.
enum Init {
    /// Normal with variance 2 / inputs (He et al. 2015).
    Kaiming,
    /// Uniform within 1 / sqrt(inputs), PyTorch's own.
    Uniform,
    /// The same, with 1 for the forget gates.
    Gates,
    All(f64),
}

/// A parameter, its shape, the inputs of its layer, and how it is initialized.
struct Parameter {
    name: String,
    shape: Vec<usize>,
    inputs: usize,
    init: Init,
}

fn linear(name: &str, outputs: usize, inputs: usize, weight: Init) -> Vec<Parameter> {
    let parameter = |part, shape, init| Parameter { name: format!("{name}.{part}"), shape, inputs, init };
    vec![parameter("weight", vec![outputs, inputs], weight), parameter("bias", vec![outputs], Init::Uniform)]
}

fn block(name: &str, outputs: usize, inputs: usize) -> Vec<Parameter> {
    let mut parameters = linear(name, outputs, inputs, Init::Kaiming);
    let of_norm = [("scale", 1.0), ("shift", 0.0)];
    parameters.extend(of_norm.map(|(part, value)| Parameter {
        name: format!("{name}.{part}"),
        shape: vec![outputs],
        inputs,
        init: Init::All(value),
    }));
    parameters
}

/// Returns all parameters in their fixed order: of Phi, the LSTM, the step's head, and G.
fn parameters(config: &SrnConfig) -> Vec<Parameter> {
    let width = config.width;
    let mut all: Vec<Parameter> = Vec::new();
    for k in 0..config.phi_layers {
        all.extend(block(&format!("phi.{k}"), width, if k == 0 { 3 } else { width }));
    }
    let gates = 4 * HIDDEN;
    let of_cell = [
        ("weight_ih", vec![gates, width], Init::Uniform),
        ("weight_hh", vec![gates, HIDDEN], Init::Uniform),
        ("bias_ih", vec![gates], Init::Gates),
        ("bias_hh", vec![gates], Init::Gates),
    ];
    all.extend(of_cell.map(|(part, shape, init)| Parameter {
        name: format!("lstm.{part}"),
        shape,
        // PyTorch bounds all of a cell's weights by the size of its state.
        inputs: HIDDEN,
        init,
    }));
    all.extend(linear("head", 1, HIDDEN, Init::Uniform));
    for k in 0..config.pixel_layers {
        all.extend(block(&format!("pixel.{k}"), width, width));
    }
    all.extend(linear(&format!("pixel.{}", config.pixel_layers), 3, width, Init::Kaiming));
    all
}

impl Parameter {
    fn draw(&self, random: &mut Random, dtype: DType, device: &Device) -> Result<Tensor> {
        let bound = (self.inputs as f64).recip().sqrt();
        let uniform = |random: &mut Random| -> Result<Tensor> {
            Ok(random.uniform_tensor(&self.shape, dtype, device)?.affine(2.0 * bound, -bound)?)
        };
        Ok(match self.init {
            Init::Kaiming => (random.normal_tensor(&self.shape, dtype, device)? * (2f64.sqrt() * bound))?,
            Init::Uniform => uniform(random)?,
            Init::Gates => {
                let drawn = uniform(random)?;
                let ones = Tensor::ones(HIDDEN, dtype, device)?;
                let rest = drawn.narrow(0, 2 * HIDDEN, 2 * HIDDEN)?;
                Tensor::cat(&[&drawn.narrow(0, 0, HIDDEN)?, &ones, &rest], 0)?
            }
            Init::All(value) => Tensor::full(value, self.shape.as_slice(), device)?.to_dtype(dtype)?,
        })
    }
}

/// The parameters of one scene's SRN.
#[derive(Clone)]
pub struct Srn {
    config: SrnConfig,
    pub(crate) parameters: Parameters,
    /// The same, with gradients if it is trainable.
    tensors: Vec<Tensor>,
}

/// The end of a march.
pub struct SrnMarch {
    /// Depth, in scene units times `srn.scale`, `[rays, 1]`.
    pub z: Tensor,
    /// Colour from -1 to 1, unless it overshoots, `[rays, 3]`.
    pub colour: Tensor,
}

impl Srn {
    /// Returns names and shapes of all parameters, in their fixed order.
    pub fn parameter_names(config: &SrnConfig) -> Vec<(String, Vec<usize>)> {
        parameters(config).into_iter().map(|parameter| (parameter.name, parameter.shape)).collect()
    }

    /// Initializes a new SRN from `seed`'s stream `Init`.
    pub fn init(config: &SrnConfig, seed: u64, dtype: DType, device: &Device) -> Result<Srn> {
        let mut random = Random::new(seed, Stream::Init, 0);
        let tensors = parameters(config).into_iter().map(|parameter| parameter.draw(&mut random, dtype, device));
        Srn::from_parameters(config, tensors.collect::<Result<_>>()?)
    }

    /// Creates an SRN with a copy of given values, in the order of [`Srn::parameter_names`].
    ///
    /// # Errors
    /// Those of [`Parameters::new`].
    pub fn from_parameters(config: &SrnConfig, values: Vec<Tensor>) -> Result<Srn> {
        let parameters = Parameters::new(Srn::parameter_names(config), values)?;
        Ok(Srn { config: config.clone(), tensors: parameters.tensors(true), parameters })
    }

    /// Returns the same parameters (shared, not copied), without gradients.
    pub fn frozen(&self) -> Srn {
        Srn { tensors: self.parameters.tensors(false), ..self.clone() }
    }

    /// Returns the configuration of the section.
    pub fn config(&self) -> &SrnConfig {
        &self.config
    }

    /// Marches rays from depths `z_0 [rays, 1]`, in scene units times `srn.scale`.
    pub fn march(&self, rays: &Rays, z_0: &Tensor) -> Result<SrnMarch> {
        let scale = self.config.scale;
        let mut position = ((&rays.origins * scale)? + rays.directions.broadcast_mul(z_0)?)?;
        let state = Tensor::zeros((rays.len(), HIDDEN), z_0.dtype(), z_0.device())?;
        let (mut z, mut hidden, mut memory) = (z_0.clone(), state.clone(), state);
        for _ in 0..self.config.steps {
            let feature = self.phi(&position)?;
            let (output, next) = self.lstm().apply(&feature, (&hidden, &memory))?;
            (hidden, memory) = (clamp_gradient(&output, GRADIENT_LIMIT)?, next);
            let length = self.step(&hidden)?;
            position = (position + rays.viewdirs.broadcast_mul(&length)?)?;
            z = (z + length.div(&rays.direction_norm)?)?;
        }
        Ok(SrnMarch { z, colour: self.pixel(&self.phi(&position)?)? })
    }

    /// Returns the index of the cell's first parameter.
    fn of_lstm(&self) -> usize {
        OF_BLOCK * self.config.phi_layers
    }

    /// Returns the index of G's first parameter, after the step's head.
    fn of_pixel(&self) -> usize {
        self.of_lstm() + 4 + 2
    }

    fn lstm(&self) -> Lstm<'_> {
        let [weight_ih, weight_hh, bias_ih, bias_hh] = [0, 1, 2, 3].map(|part| &self.tensors[self.of_lstm() + part]);
        Lstm { weight_ih, weight_hh, bias_ih, bias_hh }
    }

    /// Returns features of points `[n, 3]`, `[n, width]`.
    fn phi(&self, points: &Tensor) -> Result<Tensor> {
        (0..self.config.phi_layers).try_fold(points.clone(), |x, k| self.block(OF_BLOCK * k, &x))
    }

    /// Returns the length of a step, `[n, 1]`.
    fn step(&self, hidden: &Tensor) -> Result<Tensor> {
        self.linear(self.of_lstm() + 4, hidden)
    }

    /// Returns colours of features.
    fn pixel(&self, features: &Tensor) -> Result<Tensor> {
        let (first, layers) = (self.of_pixel(), self.config.pixel_layers);
        let hidden = (0..layers).try_fold(features.clone(), |x, k| self.block(first + OF_BLOCK * k, &x))?;
        self.linear(first + OF_BLOCK * layers, &hidden)
    }

    fn linear(&self, at: usize, x: &Tensor) -> Result<Tensor> {
        Ok(parameters::linear(x, &self.tensors[at], &self.tensors[at + 1])?)
    }

    /// Applies a linear layer, layer normalization and ReLU.
    fn block(&self, at: usize, x: &Tensor) -> Result<Tensor> {
        let norm = LayerNorm { group: NormGroup::Channels, epsilon: EPSILON, relu: true };
        Ok(norm.apply(&self.linear(at, x)?, &self.tensors[at + 2], &self.tensors[at + 3])?)
    }
}
