//! The methods. Each is a representation of the scene, trained with a perturbed pass or without, and other code asks what a
//! representation can do, not which it is.

use serde::{Deserialize, Serialize};

use super::Encoding;
use super::registry::choice;

/// What is trained.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// The clean pass alone.
    #[default]
    Nerf,
    /// Clean pass and perturbed pass, as section `perturb` says.
    AugNerf,
    /// One field queried at Gaussians that stand for conical frustums (Barron et al. 2021).
    MipNerf,
    /// The same with the perturbed pass.
    AugMipNerf,
}

choice!(Method);

/// What holds the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Representation {
    /// A coarse and a fine field that are queried at points (Mildenhall et al. 2020).
    Nerf,
    /// One field that is queried at Gaussians, which stand for conical frustums (Barron et al. 2021).
    MipNerf,
}

impl Method {
    /// All methods.
    pub const ALL: [Method; 4] = [Method::Nerf, Method::AugNerf, Method::MipNerf, Method::AugMipNerf];

    /// The name in files and tables.
    pub fn name(self) -> &'static str {
        match self {
            Method::Nerf => "nerf",
            Method::AugNerf => "aug-nerf",
            Method::MipNerf => "mip-nerf",
            Method::AugMipNerf => "aug-mip-nerf",
        }
    }

    /// What holds the scene.
    pub fn representation(self) -> Representation {
        match self {
            Method::Nerf | Method::AugNerf => Representation::Nerf,
            Method::MipNerf | Method::AugMipNerf => Representation::MipNerf,
        }
    }

    /// There is a perturbed pass.
    pub fn is_augmented(self) -> bool {
        matches!(self, Method::AugNerf | Method::AugMipNerf)
    }
}

impl Representation {
    /// How its fields encode positions. It decides what a ray's `t_vals` are: see [`Encoding::at_intervals`].
    pub fn encoding(self) -> Encoding {
        match self {
            Representation::Nerf => Encoding::Positional,
            Representation::MipNerf => Encoding::Integrated,
        }
    }

    /// The fine pass has a field of its own; otherwise one field serves both.
    pub fn has_fine_field(self) -> bool {
        self == Representation::Nerf
    }

    /// Density has a gradient and a Laplacian at points, of which terms in space and measures of smoothness are made.
    pub fn has_derivatives_at_points(self) -> bool {
        !self.encoding().at_intervals()
    }

    /// Settings that lie between preset and file, as TOML.
    pub(super) fn layer(self) -> Option<&'static str> {
        match self {
            Representation::Nerf => None,
            Representation::MipNerf => Some(include_str!("presets/mip-nerf.toml")),
        }
    }
}

impl Encoding {
    /// Fields are queried at the intervals between neighbouring `t_vals`, not at `t_vals`: the one place that tells edges
    /// from samples.
    pub fn at_intervals(self) -> bool {
        self == Encoding::Integrated
    }

    /// `t_vals` of a pass with so many samples.
    pub fn t_vals(self, samples: usize) -> usize {
        samples + usize::from(self.at_intervals())
    }

    /// Samples of a pass with so many `t_vals`.
    pub fn samples(self, t_vals: usize) -> usize {
        t_vals - usize::from(self.at_intervals())
    }
}
