//! Section `llff`: Local Light Field Fusion (Mildenhall et al. 2019), with the network trained on the scene's own
//! views.

use serde::{Deserialize, Serialize};

use crate::base::Result;
use crate::base::settings::require;
use crate::base::settings::{numbers, section};

/// The loss between a rendered view and the view that was left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PlanesLoss {
    /// Mean squared error.
    #[default]
    Mse,
    /// Mean absolute error.
    L1,
}

/// The protocol's column for all settings of the section.
const COLUMN: &[&str] = &["llff"];
/// The network halves sides and planes three times.
const HALVINGS: usize = 8;

section! {
    /// Local Light Field Fusion. A network turns a view and its neighbours into a stack of planes of colour and opacity
    /// (a multiplane image). The multiplane images of the nearest views are blended.
    pub struct PlanesConfig {
        /// Planes per view, evenly spaced in disparity: a multiple of 8.
        pub planes: usize = 32, numbers().whole(8, 256, "8 to 256 planes, a multiple of 8").columns(COLUMN);
        /// Input views of the network for each view: the view itself and its nearest neighbours.
        pub inputs: usize = 5, numbers().whole(2, 16, "2 to 16 views").columns(COLUMN);
        /// Number of nearest views whose planes are blended into an image.
        pub blend: usize = 5, numbers().whole(1, 16, "1 to 16 views").columns(COLUMN).same_time();
        /// Side in pixels of the window of a view that a step uses: a multiple of 8.
        pub window: usize = 96, numbers().whole(16, 1024, "16 to 1024 pixels, a multiple of 8").columns(COLUMN);
        /// Side in pixels of the part of the left-out view that a step renders.
        pub crop: usize = 64, numbers().whole(8, 1024, "8 to llff.window pixels").columns(COLUMN);
        /// Views of a step whose planes are blended into the left-out view.
        pub references: usize = 2, numbers().whole(1, 8, "1 to 8 views").columns(COLUMN);
        /// Depth of the nearest plane in scene units. Empty = the start of the scene's rays.
        pub near: Option<f64> = None, numbers().positive().columns(COLUMN).same_time();
        /// Depth of the farthest plane. Empty = the end of the scene's rays for scenes of known extent, and twice that
        /// otherwise.
        pub far: Option<f64> = None, numbers().positive().columns(COLUMN).same_time();
        /// Loss between a rendered view and the view that was left out: `mse` or `l1`.
        pub loss: PlanesLoss = PlanesLoss::Mse, numbers().columns(COLUMN).same_time();
    }
    sections {}
}

impl PlanesConfig {
    /// Fills the settings that depend on the scene.
    pub(super) fn resolve(&mut self, bounded: bool, (near, far): (f64, f64)) {
        self.near.get_or_insert(near);
        self.far.get_or_insert(if bounded { far } else { 2.0 * far });
    }

    /// Checks the settings against one another.
    pub(super) fn validate(&self) -> Result<()> {
        let PlanesConfig { planes, window, crop, near, far, .. } = *self;
        for (path, side) in [("llff.planes", planes), ("llff.window", window)] {
            let allowed = format!("a multiple of {HALVINGS}: the network halves it three times");
            require(side.is_multiple_of(HALVINGS), path, side, &allowed)?;
        }
        require(crop <= window, "llff.crop", crop, &format!("8 to {window} (llff.window)"))?;
        let Some((near, far)) = near.zip(far) else { return Ok(()) };
        require(near < far, "llff.far", far, &format!("beyond llff.near = {near}"))
    }

    /// Returns all settings in one line, for tables.
    pub fn text(&self) -> String {
        let PlanesConfig { planes, inputs, blend, window, crop, references, near, far, loss } = self;
        let depths = near.zip(*far).map_or_else(String::new, |(near, far)| format!(" from {near} to {far}"));
        let loss = super::word(loss);
        format!(
            "{planes} planes{depths} of {inputs} views, {blend} blended; trained on the scene: {references} blended in windows of \
             {window}, {loss} of {crop}"
        )
    }
}
