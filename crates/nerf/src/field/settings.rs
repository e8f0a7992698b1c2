//! Section `field`: the networks.

use serde::{Deserialize, Serialize};

mod hash;

use crate::base::Result;
use crate::base::settings::{numbers, section};
use crate::base::settings::{refuse, require};
pub use augnerf_fast::hash::{Contraction, Interpolation};
pub use hash::HashConfig;

/// The implementation that computes the networks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Core {
    /// Fused kernels if the device has them, candle's operations otherwise.
    #[default]
    Fused,
    /// candle's operations; the reference.
    Plain,
}

/// The number format in which the networks compute.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Precision {
    /// f32.
    #[default]
    F32,
    /// Layers and their gradients in bf16 (8 bits of mantissa); sums and weights in f32.
    Bf16,
    /// Values between layers, their gradients and the weights that products read in f16 (11 bits of mantissa); sums and the
    /// weights that Adam updates in f32. For `--device gpu`.
    F16,
}

/// How weights are initialized.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Init {
    /// Glorot uniform weights, zero biases (original NeRF).
    #[default]
    Glorot,
    /// Uniform within +-1/sqrt(inputs) for weights and biases (PyTorch's linear layer, nerf-pytorch).
    Torch,
}

/// The function from raw density to density.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DensityActivation {
    /// max(raw, 0) (NeRF).
    #[default]
    Relu,
    /// ln(1 + exp(raw - 1)) (MipNeRF).
    Softplus,
    /// exp(min(raw - 1, 11)), for hash grids. The bound keeps a product with a length finite; beyond it the gradient is
    /// 0.
    Exp,
}

/// How positions are encoded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Encoding {
    /// Sines and cosines of a point, with the point itself (NeRF).
    #[default]
    Positional,
    /// Their expectation over a Gaussian, without the point itself (MipNeRF).
    Integrated,
    /// Learned features of a multiresolution hash grid (Instant-NGP).
    Hash,
}

section! {
    /// The coarse and the fine network, which have the same shape.
    pub struct FieldConfig {
        /// Width of the trunk's layers (D).
        pub width: usize = 256, numbers().whole(4, 4096, "4 to 4096 neurons").column("field_width");
        /// Number of trunk layers.
        pub depth: usize = 8, numbers().whole(1, 64, "1 to 64 layers").column("field_depth");
        /// The encoding is concatenated to the output of these layers (1-based).
        pub skips: Vec<usize> = vec![5], numbers().column("skips");
        /// How positions are encoded: `positional` (NeRF), `integrated` (MipNeRF) or `hash` (NeRF on a hash grid,
        /// section `field.hash`: one field, which places its samples by its own density).
        pub encoding: Encoding = Encoding::Positional, numbers().column("encoding");
        /// Octaves of the position's encoding (10: 63 channels; integrated, 16: 96 channels). Hash grids have none.
        pub position_octaves: usize = 10, numbers().whole(0, 20, "0 to 20").column("position_octaves");
        /// Octaves of the view direction's encoding (4: 27 channels).
        pub view_octaves: usize = 4, numbers().whole(0, 20, "0 to 20").column("view_octaves");
        /// Number of layers between the trunk and colour, which read the view direction.
        pub view_depth: usize = 1, numbers().whole(1, 8, "1 to 8 layers").column("view_depth");
        /// Width of these layers. Empty = half of `field.width`.
        pub view_width: Option<usize> = None, numbers().whole(2, 4096, "2 to 4096 neurons").column("view_width");
        /// Number of first steps in which the encodings open from low to high frequencies (FreeNeRF): octave by octave, of a
        /// hash grid level by level (0 = all open from the start).
        pub frequency_steps: u64 = 0, numbers().column("frequency_steps").same_time();
        /// How weights are initialized.
        pub init: Init = Init::Glorot, numbers().column("init");
        /// The function from raw density to density.
        pub density_activation: DensityActivation = DensityActivation::Relu,
            numbers().column("density_activation");
        /// Colours reach from minus this to 1 plus this, so that 0 and 1 do not need an infinite raw colour (MipNeRF:
        /// 0.001).
        pub rgb_padding: f64 = 0.0,
            numbers().real(|padding| (0.0..=0.5).contains(&padding), "0 to 0.5").column("rgb_padding");
        /// Raw colours count as at most this, and at least minus this (0 = as they are). Beyond it they keep the gradient by
        /// which they come back, and no other: colours that ran off to black or white return, and none runs off. 8 changes a
        /// colour by less than a tenth of an 8-bit step.
        pub rgb_limit: f64 = 0.0,
            numbers().real(|limit| limit == 0.0 || (1.0..=80.0).contains(&limit), "0, or 1 to 80").column("rgb_limit");
        /// Implementation of the networks: `fused` (if there is one for the device) or `plain` (the reference). They
        /// differ by rounding.
        pub core: Core = Core::Fused, numbers().columns(&["core"]);
        /// Number format of the fused core: `f32`, `bf16` or `f16`. `f16` is for `--device gpu` alone: it rounds the values
        /// between layers, their gradients, and the weights that multiply them. `bf16` rounds the values between layers, and
        /// the weights that multiply them, to bf16. Sums, the encoding with its products, heads and everything else stay f32. The
        /// layers' products have the same bits on every CPU; with AVX-512 BF16 they are twice as fast as in `f32`.
        pub precision: Precision = Precision::F32, numbers().columns(&["precision"]);
    }
    sections {
        /// The hash grid of a field with `encoding = "hash"`. Other encodings ignore it.
        pub hash: HashConfig;
    }
}

impl FieldConfig {
    /// Returns the width of a layer between trunk and colour.
    pub fn view_neurons(&self) -> usize {
        self.view_width.unwrap_or(self.width / 2)
    }

    /// Returns whether density has a Laplacian at points. A linearly interpolated grid has no second derivative along
    /// an axis within its cells, and its bends are on cell faces, where no point is.
    pub fn has_laplacian(&self) -> bool {
        self.encoding != Encoding::Hash || self.hash.interpolation == Interpolation::Smoothstep
    }

    /// Checks the settings against one another.
    pub(crate) fn validate(&self) -> Result<()> {
        let FieldConfig { width, depth, position_octaves, .. } = *self;
        let halves = self.view_width.is_some() || width.is_multiple_of(2);
        let allowed = "even (the view layer has half of it, unless field.view_width says otherwise)";
        require(halves, "field.width", width, allowed)?;
        let is_encoded = self.encoding != Encoding::Integrated || position_octaves >= 1;
        require(is_encoded, "field.position_octaves", position_octaves, "1 to 20")?;
        self.hash.validate()?;
        let why = "field.precision = \"bf16\" is for field.core = \"fused\": the plain one is the reference and computes in f32";
        refuse(self.precision == Precision::Bf16 && self.core == Core::Plain, why)?;
        for (i, &skip) in self.skips.iter().enumerate() {
            let allowed = format!("a layer from 1 to {} (field.depth - 1)", depth - 1);
            require(skip >= 1 && skip < depth, "field.skips", skip, &allowed)?;
            let twice = format!("field.skips names layer {skip} twice; name each layer once");
            refuse(self.skips[..i].contains(&skip), twice)?;
        }
        Ok(())
    }
}
