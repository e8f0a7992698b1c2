//! Section `field`: the networks.

use serde::{Deserialize, Serialize};

use super::hash::{HashConfig, Interpolation};
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

/// In which numbers the networks compute.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Precision {
    /// 32 bits.
    #[default]
    F32,
    /// Layers and their gradients in bf16 (8 bits of mantissa), sums and weights in f32.
    Bf16,
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
    /// exp(min(raw - 1, 11)): hash grids. The bound keeps a product with a length finite; beyond it there is no gradient.
    Exp,
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
    /// Features of a multiresolution hash grid, which are learned (Instant-NGP).
    Hash,
}

choice!(Core, Precision, Init, DensityActivation, Encoding);

section! {
    /// The coarse and the fine network; both have this shape.
    pub struct FieldConfig {
        /// Neurons of a trunk layer (D).
        pub width: usize = 256, numbers().whole(4, 4096, "4 to 4096 neurons").column("field_width");
        /// Trunk layers.
        pub depth: usize = 8, numbers().whole(1, 64, "1 to 64 layers").column("field_depth");
        /// The encoding is concatenated to the output of these layers (1-based).
        pub skips: Vec<usize> = vec![5], numbers().column("skips");
        /// How positions are encoded: `positional` for NeRF, `integrated` for MipNeRF, `hash` for NeRF on a hash grid (section
        /// `field.hash`), which is one field that places its samples by its own density.
        pub encoding: Encoding = Encoding::Positional, numbers().column("encoding").later();
        /// Octaves of the position's encoding (10: 63 channels; integrated, 16: 96; hash grids have none).
        pub position_octaves: usize = 10, numbers().whole(0, 20, "0 to 20").column("position_octaves");
        /// Octaves of the view direction's encoding (4: 27 channels).
        pub view_octaves: usize = 4, numbers().whole(0, 20, "0 to 20").column("view_octaves");
        /// Layers between the trunk and colour, which read the view direction.
        pub view_depth: usize = 1, numbers().whole(1, 8, "1 to 8 layers").column("view_depth").later();
        /// Neurons of each of them. Empty = half of `field.width`.
        pub view_width: Option<usize> = None, numbers().whole(2, 4096, "2 to 4096 neurons").column("view_width").later();
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
        /// In which numbers the fused core computes. `f32`, or `bf16`: what passes between layers, and the weights that it
        /// is multiplied with, are rounded to bf16; sums, the encoding with its products, heads and all else are f32.
        /// The layers' products have the same bits on every processor; with AVX-512 BF16 they are twice as fast as in `f32`.
        pub precision: Precision = Precision::F32, numbers().columns(&["precision"]).later();
    }
    sections {
        /// The hash grid of a field with `encoding = "hash"`; read by no other.
        pub hash: HashConfig, true;
    }
}

impl FieldConfig {
    /// Neurons of a layer between trunk and colour.
    pub fn view_neurons(&self) -> usize {
        self.view_width.unwrap_or(self.width / 2)
    }

    /// Density has a Laplacian at points: a grid that is interpolated linearly has no second derivative along an axis
    /// within its cells, and its bends lie on their faces, where no point is.
    pub fn has_laplacian(&self) -> bool {
        self.encoding != Encoding::Hash || self.hash.interpolation == Interpolation::Smoothstep
    }
}
