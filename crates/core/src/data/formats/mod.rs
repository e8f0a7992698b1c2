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

use crate::base::{Listener, Result};
use crate::data::{Photos, Scene};
use crate::settings::{DataConfig, DataKind, Preset};

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

/// A format of scenes.
pub struct Format {
    /// Its name in settings.
    pub kind: DataKind,
    /// The file that identifies a scene folder, and its origin. `None` if no folder is needed.
    pub marker: Option<&'static str>,
    /// Returns whether a folder is such a scene.
    pub detect: fn(&Path) -> bool,
    /// Reads the scene, and as much of its photos as is asked for. `downscale` is filled.
    pub read: fn(&DataConfig, Photos, &dyn Listener) -> Result<Scene>,
    /// The default preset.
    pub preset: Preset,
    /// The reference depth that views may have.
    pub depth: ReferenceDepth,
    /// Whether the scene's own surface is known.
    pub has_mesh: bool,
}

/// All formats. A folder has the first format that detects it.
pub static FORMATS: [Format; 6] = [
    Format {
        kind: DataKind::Llff,
        marker: Some("poses_bounds.npy (LLFF)"),
        detect: |dir| dir.join(llff::POSES_FILE).is_file(),
        read: llff::load,
        preset: Preset::PaperLlff,
        depth: ReferenceDepth::None,
        has_mesh: false,
    },
    Format {
        kind: DataKind::Blender,
        marker: Some("transforms_train.json (Blender)"),
        detect: |dir| dir.join(transforms::transforms_file("train")).is_file(),
        read: blender::load,
        preset: Preset::PaperBlender,
        depth: ReferenceDepth::EightBit,
        has_mesh: false,
    },
    Format {
        kind: DataKind::Transforms,
        marker: Some("transforms.json (instant-ngp, nerfstudio)"),
        detect: |dir| dir.join(transforms::TRANSFORMS_FILE).is_file(),
        read: transforms::load,
        preset: Preset::PaperBlender,
        depth: ReferenceDepth::None,
        has_mesh: false,
    },
    Format {
        kind: DataKind::Colmap,
        marker: Some("sparse/0/cameras.bin or .txt (COLMAP)"),
        detect: colmap::is_scene,
        read: colmap::load,
        preset: Preset::PaperBlender,
        depth: ReferenceDepth::None,
        has_mesh: false,
    },
    Format {
        kind: DataKind::BuiltinBlender,
        marker: None,
        detect: |_| false,
        read: |config, _, _| builtin::load_blender(config),
        preset: Preset::Fast,
        depth: ReferenceDepth::Exact,
        has_mesh: true,
    },
    Format {
        kind: DataKind::BuiltinForward,
        marker: None,
        detect: |_| false,
        read: |config, _, _| builtin::load_forward(config),
        preset: Preset::Fast,
        depth: ReferenceDepth::Exact,
        has_mesh: false,
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
        for kind in DataKind::ALL {
            let formats = FORMATS.iter().filter(|format| format.kind == kind).count();
            assert_eq!(formats, usize::from(kind != DataKind::Auto), "{}", kind.name());
        }
    }
}
