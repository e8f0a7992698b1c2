//! The methods. Each is a representation of the scene, trained with or without a perturbed pass. Other code asks for a
//! representation's capabilities, not for its name.

use serde::{Deserialize, Serialize};

use super::Encoding;
use crate::base::settings::name_of;

/// What is trained.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// The clean pass only.
    #[default]
    Nerf,
    /// The clean pass and the second pass of section `perturb`.
    AugNerf,
    /// One network, queried at Gaussians that stand for conical frustums (Barron et al. 2021).
    MipNerf,
    /// The same with a second pass.
    AugMipNerf,
    /// Scene Representation Networks (Sitzmann et al. 2019).
    Srn,
    /// Neural Volumes (Lombardi et al. 2019).
    Nv,
    /// Local Light Field Fusion (Mildenhall et al. 2019), trained on the scene.
    Llff,
}

/// The representation of the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Representation {
    /// A coarse and a fine network, queried at points (Mildenhall et al. 2020).
    Nerf,
    /// One network, queried at Gaussians that stand for conical frustums (Barron et al. 2021).
    MipNerf,
    /// One network on a hash grid (Mueller et al. 2022), queried at the middles of intervals. It places its samples by
    /// its own density.
    HashNerf,
    /// Features in space, and the end of each ray (Sitzmann et al. 2019).
    Srn,
    /// A volume of voxels from a network, behind a warp (Lombardi et al. 2019).
    Volume,
    /// A stack of planes per training view, predicted from it and its neighbours (Mildenhall et al. 2019).
    Planes,
}

/// An operation that only some representations support.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Capability {
    /// Density in space: surfaces.
    Density,
    /// Density with its derivatives at points: smoothness, and regularizers on it.
    Derivatives,
    /// Weights of samples along a ray.
    Samples,
}

impl Method {
    /// All methods.
    pub const ALL: [Method; 7] =
        [Method::Nerf, Method::AugNerf, Method::MipNerf, Method::AugMipNerf, Method::Srn, Method::Nv, Method::Llff];

    /// Returns the name in files and tables.
    pub fn name(self) -> &'static str {
        name_of::<Method>(self as usize)
    }

    /// Returns the representation with positions in this encoding, or `None` if the method has no such field. A method
    /// without fields ignores the encoding.
    pub fn representation(self, encoding: Encoding) -> Option<Representation> {
        match (self, encoding) {
            (Method::Nerf | Method::AugNerf, Encoding::Positional) => Some(Representation::Nerf),
            (Method::Nerf | Method::AugNerf, Encoding::Hash) => Some(Representation::HashNerf),
            (Method::MipNerf | Method::AugMipNerf, Encoding::Integrated) => Some(Representation::MipNerf),
            (Method::Srn, _) => Some(Representation::Srn),
            (Method::Nv, _) => Some(Representation::Volume),
            (Method::Llff, _) => Some(Representation::Planes),
            (Method::Nerf | Method::AugNerf | Method::MipNerf | Method::AugMipNerf, _) => None,
        }
    }

    /// Returns whether the method trains radiance fields, as sections `field` and `sampling` say.
    pub fn has_fields(self) -> bool {
        match self {
            Method::Nerf | Method::AugNerf | Method::MipNerf | Method::AugMipNerf => true,
            Method::Srn | Method::Nv | Method::Llff => false,
        }
    }

    /// Returns whether a step uses rays, as section `train` says. Otherwise it uses windows of views.
    pub fn learns_from_rays(self) -> bool {
        self != Method::Llff
    }

    /// Returns the default encoding.
    pub fn encoding(self) -> Encoding {
        match self {
            Method::MipNerf | Method::AugMipNerf => Encoding::Integrated,
            Method::Nerf | Method::AugNerf | Method::Srn | Method::Nv | Method::Llff => Encoding::Positional,
        }
    }

    /// Returns whether there is a second pass.
    pub fn is_augmented(self) -> bool {
        matches!(self, Method::AugNerf | Method::AugMipNerf)
    }
}

impl Representation {
    /// Returns whether the fine pass has a network of its own. Otherwise one network serves both passes.
    pub fn has_fine_field(self) -> bool {
        self == Representation::Nerf
    }

    /// Returns whether the coarse pass has a loss on its colours. Otherwise it only places samples, by density.
    pub fn has_coarse_loss(self) -> bool {
        self != Representation::HashNerf
    }

    /// Returns whether density has a gradient and a Laplacian at points. Terms in space and measures of smoothness need
    /// them.
    pub fn has_derivatives_at_points(self) -> bool {
        self.lacks(Capability::Derivatives).is_none()
    }

    /// Returns why the capability is missing, in words that end a sentence, or `None` if it is supported.
    pub fn lacks(self, capability: Capability) -> Option<&'static str> {
        use Representation::{HashNerf, MipNerf, Nerf, Planes, Srn, Volume};
        match (self, capability) {
            (Nerf | HashNerf, _)
            | (MipNerf, Capability::Density | Capability::Samples)
            | (Volume, Capability::Density) => None,
            (MipNerf, Capability::Derivatives) => Some("its field is queried at Gaussians, not at points"),
            (Srn, Capability::Density | Capability::Derivatives) => {
                Some("an SRN knows where a ray ends, not where space is full")
            }
            (Srn, Capability::Samples) => Some("an SRN steps to one point of each ray, and has no weights along it"),
            (Volume, Capability::Derivatives) => Some(
                "opacity is trilinear between voxels, so that its gradient jumps at their faces, and a warp lies before it",
            ),
            (Volume, Capability::Samples) => {
                Some("its volume is one lookup a step, not a field that is queried at samples")
            }
            (Planes, Capability::Density | Capability::Derivatives) => {
                Some("LLFF has a stack of planes for each training view, and no density in space")
            }
            (Planes, Capability::Samples) => {
                Some("LLFF blends planes of several views, and has no samples along a ray")
            }
        }
    }

    /// Returns the settings between preset and file, as TOML. Tables named by sizes hold the settings that suit a
    /// preset.
    pub(super) fn layer(self) -> Option<&'static str> {
        match self {
            Representation::Nerf => None,
            Representation::MipNerf => Some(include_str!("presets/mip-nerf.toml")),
            Representation::HashNerf => Some(include_str!("presets/hash-nerf.toml")),
            Representation::Srn => Some(include_str!("presets/srn.toml")),
            Representation::Volume => Some(include_str!("presets/nv.toml")),
            Representation::Planes => Some(include_str!("presets/llff.toml")),
        }
    }
}

impl Encoding {
    /// Returns whether passes sample the intervals between neighbouring `t_vals`, not `t_vals` themselves. Only this
    /// function tells edges from samples.
    pub fn at_intervals(self) -> bool {
        match self {
            Encoding::Positional => false,
            Encoding::Integrated | Encoding::Hash => true,
        }
    }

    /// Returns whether the network is queried at Gaussians that stand for conical frustums, not at points.
    pub fn queries_gaussians(self) -> bool {
        self == Encoding::Integrated
    }

    /// Returns the number of `t_vals` of a pass with this many samples.
    pub fn t_vals(self, samples: usize) -> usize {
        samples + usize::from(self.at_intervals())
    }

    /// Returns the number of samples of a pass with this many `t_vals`.
    pub fn samples(self, t_vals: usize) -> usize {
        t_vals - usize::from(self.at_intervals())
    }
}
