//! The network of a radiance field: a trunk with skips, a density head and a view-dependent colour head (NeRF paper,
//! figure 7).

use candle_core::{Result, Tensor};
use candle_nn::{Init, Linear, Module, VarBuilder};

use crate::base::tensors::relu;
use crate::field::settings::FieldConfig;

use super::settings;
use super::{encoded_channels, position_channels};

/// A network (encoded position, encoded view direction) -> (raw colour, raw density).
#[derive(Clone)]
pub struct Nerf {
    /// Layers with ReLUs, `[width, inputs]`.
    pub(super) trunk: Vec<Linear>,
    /// Trunk layers, from 0, that read the encoded position beside the layer below.
    skips: Vec<usize>,
    pub(super) density: Linear,
    feature: Linear,
    /// Layers with ReLUs. The first reads the encoded view direction beside the trunk's feature.
    view: Vec<Linear>,
    rgb: Linear,
}

/// The output of a field before its activations.
pub struct RawOutput {
    /// Colour before the sigmoid, `[n, 3]`.
    pub rgb: Tensor,
    /// Density before its activation, `[n]`, 1 / length.
    pub density: Tensor,
}

/// A delta that is added to the output of one trunk layer: Aug-NeRF's perturbation of intermediate features.
#[derive(Clone, Copy)]
pub struct FeatureDelta<'a> {
    /// 1-based trunk layer. The delta is added after its ReLU, before a skip's concatenation.
    pub layer: usize,
    /// `[n, width]`.
    pub delta: &'a Tensor,
}

impl Nerf {
    /// Creates the network with the builder's parameters: `trunk.0.weight`, `trunk.0.bias`, ..., `density.*`, `feature.*`,
    /// `view.*`, `view.1.*`, ..., `rgb.*`. It asks for them in the order of layers.
    ///
    /// # Errors
    /// Those of the builder.
    pub fn new(config: &FieldConfig, vb: VarBuilder) -> Result<Nerf> {
        let (position, direction) = (position_channels(config), encoded_channels(config.view_octaves));
        let (width, neurons) = (config.width, config.view_neurons());
        let linear = |inputs, outputs, name: String| linear(config.init, inputs, outputs, vb.pp(name));
        let trunk_layer = |i| {
            let inputs = match i {
                0 => position,
                i if config.skips.contains(&i) => position + width,
                _ => width,
            };
            linear(inputs, width, format!("trunk.{i}"))
        };
        let view_layer = |i| match i {
            0 => linear(width + direction, neurons, "view".into()),
            i => linear(neurons, neurons, format!("view.{i}")),
        };
        Ok(Nerf {
            trunk: (0..config.depth).map(trunk_layer).collect::<Result<_>>()?,
            skips: config.skips.clone(),
            density: linear(width, 1, "density".into())?,
            feature: linear(width, width, "feature".into())?,
            view: (0..config.view_depth).map(view_layer).collect::<Result<_>>()?,
            rgb: linear(neurons, 3, "rgb".into())?,
        })
    }

    /// Returns raw colour and raw density of `n` points: encoded positions `[n, channels]` and view directions
    /// `[n, channels]`.
    ///
    /// # Errors
    /// Those of candle, if shapes do not fit.
    pub fn forward(&self, position: &Tensor, direction: &Tensor, delta: Option<FeatureDelta>) -> Result<RawOutput> {
        let hidden = self.trunk(position, delta)?;
        let density = self.raw_density(&hidden)?;
        let feature = self.feature.forward(&hidden)?;
        let mut view = Tensor::cat(&[&feature, direction], 1)?;
        for layer in &self.view {
            view = relu(&layer.forward(&view)?)?;
        }
        Ok(RawOutput { rgb: self.rgb.forward(&view)?, density })
    }

    /// Returns the trunk's last output, `[n, width]`.
    pub fn trunk(&self, position: &Tensor, delta: Option<FeatureDelta>) -> Result<Tensor> {
        let mut hidden = position.clone();
        for (i, layer) in self.trunk.iter().enumerate() {
            if self.skips.contains(&i) {
                hidden = Tensor::cat(&[position, &hidden], 1)?;
            }
            hidden = relu(&layer.forward(&hidden)?)?;
            if let Some(delta) = delta.filter(|delta| delta.layer == i + 1) {
                hidden = (hidden + delta.delta)?;
            }
        }
        Ok(hidden)
    }

    /// Returns raw density `[n]` from the trunk's last output.
    pub fn raw_density(&self, hidden: &Tensor) -> Result<Tensor> {
        self.density.forward(hidden)?.squeeze(1)
    }

    /// Iterates over all layers in the order of parameters.
    pub(super) fn layers(&self) -> impl Iterator<Item = &Linear> {
        self.trunk.iter().chain([&self.density, &self.feature]).chain(&self.view).chain([&self.rgb])
    }

    /// Returns the network with other parameters, of the layers in order.
    pub(super) fn map(&self, mut change: impl FnMut(&Linear) -> Result<Linear>) -> Result<Nerf> {
        let trunk = self.trunk.iter().map(&mut change).collect::<Result<_>>()?;
        let (density, feature) = (change(&self.density)?, change(&self.feature)?);
        let view = self.view.iter().map(&mut change).collect::<Result<_>>()?;
        Ok(Nerf { trunk, skips: self.skips.clone(), density, feature, view, rgb: change(&self.rgb)? })
    }
}

/// Returns a layer with the builder's `weight` and `bias`, and says how they are drawn.
fn linear(init: settings::Init, inputs: usize, outputs: usize, vb: VarBuilder) -> Result<Linear> {
    let within = |bound: f64| Init::Uniform { lo: -bound, up: bound };
    let (weight, bias) = match init {
        // Glorot and Bengio 2010, equation 16.
        settings::Init::Glorot => (within((6.0 / (inputs + outputs) as f64).sqrt()), Init::Const(0.0)),
        settings::Init::Torch => (within(1.0 / (inputs as f64).sqrt()), within(1.0 / (inputs as f64).sqrt())),
    };
    let weight = vb.get_with_hints((outputs, inputs), "weight", weight)?;
    Ok(Linear::new(weight, Some(vb.get_with_hints(outputs, "bias", bias)?)))
}

/// Returns the bias of a layer of [`Nerf`], `[outputs]`.
pub(super) fn bias(layer: &Linear) -> &Tensor {
    layer.bias().expect("all layers have biases")
}
