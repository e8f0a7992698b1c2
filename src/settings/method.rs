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
    /// One field on a hash grid (Mueller et al. 2022), queried at the middles of intervals, that places its samples by its own
    /// density.
    HashNerf,
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

    /// What holds the scene with positions in this encoding; none where the method has no such field.
    pub fn representation(self, encoding: Encoding) -> Option<Representation> {
        match (self, encoding) {
            (Method::Nerf | Method::AugNerf, Encoding::Positional) => Some(Representation::Nerf),
            (Method::Nerf | Method::AugNerf, Encoding::Hash) => Some(Representation::HashNerf),
            (Method::MipNerf | Method::AugMipNerf, Encoding::Integrated) => Some(Representation::MipNerf),
            _ => None,
        }
    }

    /// The encoding where none is named.
    pub fn encoding(self) -> Encoding {
        match self {
            Method::Nerf | Method::AugNerf => Encoding::Positional,
            Method::MipNerf | Method::AugMipNerf => Encoding::Integrated,
        }
    }

    /// There is a perturbed pass.
    pub fn is_augmented(self) -> bool {
        matches!(self, Method::AugNerf | Method::AugMipNerf)
    }
}

impl Representation {
    /// The fine pass has a field of its own; otherwise one field serves both.
    pub fn has_fine_field(self) -> bool {
        self == Representation::Nerf
    }

    /// The coarse pass learns from its colours; otherwise it only places samples, by density.
    pub fn has_coarse_loss(self) -> bool {
        self != Representation::HashNerf
    }

    /// Density has a gradient and a Laplacian at points, of which terms in space and measures of smoothness are made.
    pub fn has_derivatives_at_points(self) -> bool {
        self != Representation::MipNerf
    }

    /// Settings that lie between preset and file, as TOML.
    pub(super) fn layer(self) -> Option<&'static str> {
        match self {
            Representation::Nerf => None,
            Representation::MipNerf => Some(include_str!("presets/mip-nerf.toml")),
            Representation::HashNerf => Some(include_str!("presets/hash-nerf.toml")),
        }
    }
}

impl Encoding {
    /// Passes sample the intervals between neighbouring `t_vals`, not `t_vals` themselves: the one place that tells edges
    /// from samples.
    pub fn at_intervals(self) -> bool {
        self != Encoding::Positional
    }

    /// The field is queried at Gaussians that stand for conical frustums, not at points.
    pub fn queries_gaussians(self) -> bool {
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
