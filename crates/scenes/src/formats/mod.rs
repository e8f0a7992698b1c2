//! The formats of scenes: one module each, and one table of them.
//!
//! To read another format, write its module, add its line to [`FORMATS`] and its name to [`DataKind`]. A format of your
//! own needs none of that: a [`Capture`] becomes a [`Scene`] anywhere ([`Capture::hold_out`]).

pub mod blender;
pub mod builtin;
mod capture;
pub mod colmap;
pub mod llff;
pub mod transforms;

use std::path::Path;

use crate::settings::{DataConfig, DataKind, PixelOrigin};
use crate::{Photos, Scene};
use augnerf_base::{Error, Listener, Result};

pub use capture::Capture;

/// The reference depth that a format's views may have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReferenceDepth {
    /// None.
    None,
    /// Maps in steps of 8 bits.
    EightBit,
    /// Exact.
    Exact,
}

/// A format of scenes: all that is known of its scenes before one is read.
pub struct Format {
    /// Its name in settings.
    pub kind: DataKind,
    /// The file that identifies a scene folder, and its origin. `None` if no folder is needed.
    pub marker: Option<&'static str>,
    /// Returns whether a folder is such a scene.
    pub detect: fn(&Path) -> bool,
    /// Reads the scene, and as much of its photos as is asked for. `downscale` is filled.
    pub read: fn(&DataConfig, Photos, &dyn Listener) -> Result<Scene>,
    /// Names of the settings in section `data` that it reads, of those that not all formats do.
    pub reads: &'static [&'static str],
    /// The name of the default preset.
    pub preset: &'static str,
    /// The paper's `data.downscale`.
    pub downscale: u32,
    /// The default pixel origin: `centre` for the poses of COLMAP, `corner` for those of published numbers.
    pub pixel_origin: PixelOrigin,
    /// Whether the cameras are forward-facing. LLFF's defaults (noise, batches, decay) apply to such scenes.
    pub forward_facing: bool,
    /// Half the side of the cube around the origin that holds the objects, in scene units. `None` if only the training
    /// rays tell the extent.
    pub object_half: Option<f64>,
    /// Whether scenes come with training, validation and test views. Otherwise every N-th view is held out.
    pub has_splits: bool,
    /// The reference depth that views may have.
    pub depth: ReferenceDepth,
    /// Whether the scene's own surface is known.
    pub has_mesh: bool,
}

/// A capture of photos of unknown extent, without anything special. Entries of [`FORMATS`] say what differs.
const CAPTURE: Format = Format {
    kind: DataKind::Auto,
    marker: None,
    detect: |_| false,
    read: |_, _, _| Err(Error::Config("data.kind = \"auto\" has to be settled before the scene is loaded".into())),
    reads: &[],
    preset: "paper-blender",
    downscale: 1,
    pixel_origin: PixelOrigin::Corner,
    forward_facing: false,
    object_half: None,
    has_splits: false,
    depth: ReferenceDepth::None,
    has_mesh: false,
};

/// All formats. A folder has the first format that detects it.
pub static FORMATS: [Format; 6] = [
    Format {
        kind: DataKind::Llff,
        marker: Some("poses_bounds.npy (LLFF)"),
        detect: |dir| dir.join(llff::POSES_FILE).is_file(),
        read: llff::load,
        reads: &["ndc", "recentre", "rescale", "bound_factor", "spherify", "recognise_orbits", "masks", "background"],
        preset: "paper-llff",
        downscale: 8,
        forward_facing: true,
        ..CAPTURE
    },
    Format {
        kind: DataKind::Blender,
        marker: Some("transforms_train.json (Blender)"),
        detect: |dir| dir.join(transforms::transforms_file("train")).is_file(),
        read: blender::load,
        reads: &["masks", "background"],
        downscale: 2,
        object_half: Some(1.5),
        has_splits: true,
        depth: ReferenceDepth::EightBit,
        ..CAPTURE
    },
    Format {
        kind: DataKind::Transforms,
        marker: Some("transforms.json (instant-ngp, nerfstudio)"),
        detect: |dir| dir.join(transforms::TRANSFORMS_FILE).is_file(),
        read: transforms::load,
        reads: &["split", "recentre", "rescale", "masks", "background"],
        pixel_origin: PixelOrigin::Centre,
        ..CAPTURE
    },
    Format {
        kind: DataKind::Colmap,
        marker: Some("sparse/0/cameras.bin or .txt (COLMAP)"),
        detect: colmap::is_scene,
        read: colmap::load,
        reads: &["colmap_model", "recentre", "rescale", "masks", "background"],
        pixel_origin: PixelOrigin::Centre,
        ..CAPTURE
    },
    Format {
        kind: DataKind::BuiltinBlender,
        read: |config, _, _| builtin::load_blender(config),
        reads: &["background"],
        preset: "fast",
        object_half: Some(1.2),
        has_splits: true,
        depth: ReferenceDepth::Exact,
        has_mesh: true,
        ..CAPTURE
    },
    Format {
        kind: DataKind::BuiltinForward,
        read: |config, _, _| builtin::load_forward(config),
        reads: &["ndc"],
        preset: "fast",
        forward_facing: true,
        depth: ReferenceDepth::Exact,
        ..CAPTURE
    },
];

impl Format {
    /// Returns the format of a settled kind, or `None` for `auto`.
    pub fn of(kind: DataKind) -> Option<&'static Format> {
        FORMATS.iter().find(|format| format.kind == kind)
    }

    /// Returns the format of a folder.
    pub fn of_folder(dir: &Path) -> Option<&'static Format> {
        FORMATS.iter().find(|format| (format.detect)(dir))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_but_auto_has_one_format() {
        for (number, format) in FORMATS.iter().enumerate() {
            assert_eq!(format.kind as usize, DataKind::Auto as usize + 1 + number, "{}", format.kind.name());
        }
        assert_eq!(DataKind::BuiltinForward as usize, FORMATS.len(), "the last kind");
    }
}
