//! Section `field`: the networks.

use serde::{Deserialize, Serialize};

use super::registry::{choice, numbers, section};

/// Which implementation of the networks computes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Core {
    /// Fused where there is one for the device, plain elsewhere.
    #[default]
    Fused,
    /// candle's operations: the reference.
    Plain,
}

/// How weights are drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Init {
    /// Glorot uniform weights, zero biases (original NeRF).
    #[default]
    Glorot,
    /// Uniform in +-1/sqrt(inputs) for weights and biases (PyTorch's linear layer, nerf-pytorch).
    Torch,
}

/// What turns a network's raw density into density.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DensityActivation {
    /// max(raw, 0) (NeRF).
    #[default]
    Relu,
    /// ln(1 + exp(raw - 1)) (MipNeRF).
    Softplus,
}

/// How positions are encoded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Encoding {
    /// Of a point, with the identity (NeRF).
    #[default]
    Positional,
    /// The expectation over a Gaussian, without the identity (MipNeRF).
    Integrated,
}

choice!(Core, Init, DensityActivation, Encoding);

section! {
    /// The coarse and the fine network; both have this shape.
    pub struct FieldConfig {
        /// Neurons of a trunk layer (D).
        pub width: usize = 256, numbers().whole(4, 4096, "4 to 4096 neurons").column("field_width");
        /// Trunk layers.
        pub depth: usize = 8, numbers().whole(1, 64, "1 to 64 layers").column("field_depth");
        /// The encoding is concatenated to the output of these layers (1-based).
        pub skips: Vec<usize> = vec![5], numbers().column("skips");
        /// How positions are encoded: `positional` for NeRF, `integrated` for MipNeRF.
        pub encoding: Encoding = Encoding::Positional, numbers().column("encoding").later();
        /// Octaves of the position's encoding (10: 63 channels; integrated, 16: 96).
        pub position_octaves: usize = 10, numbers().whole(0, 20, "0 to 20").column("position_octaves");
        /// Octaves of the view direction's encoding (4: 27 channels).
        pub view_octaves: usize = 4, numbers().whole(0, 20, "0 to 20").column("view_octaves");
        /// How weights are drawn.
        pub init: Init = Init::Glorot, numbers().column("init");
        /// What turns raw density into density.
        pub density_activation: DensityActivation = DensityActivation::Relu,
            numbers().column("density_activation");
        /// Colours reach from minus this to 1 plus this, so that 0 and 1 need no infinite raw colour (MipNeRF: 0.001).
        pub rgb_padding: f64 = 0.0,
            numbers().real(|padding| (0.0..=0.5).contains(&padding), "0 to 0.5").column("rgb_padding").later();
        /// What computes the networks: `fused` (where there is one for the device) or `plain`, the reference. They differ
        /// by roundings.
        pub core: Core = Core::Fused, numbers().columns(&["core"]);
    }
    sections {}
}
