//! Section `llff`: Local Light Field Fusion (Mildenhall et al. 2019), its network trained on the scene's own views.

use serde::{Deserialize, Serialize};

use super::registry::{choice, numbers, section};

/// How a rendered view differs from the one that was left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PlanesLoss {
    /// Mean squared error.
    #[default]
    Mse,
    /// Mean absolute error.
    L1,
}

choice!(PlanesLoss);

/// The protocol's column for all of it.
const COLUMN: &[&str] = &["llff"];
/// The network halves sides and planes three times.
const HALVINGS: usize = 8;

fn is_distance(value: f64) -> bool {
    value > 0.0
}

section! {
    /// Local Light Field Fusion: a network turns a view and its neighbours into a stack of planes of colour and opacity (a
    /// multiplane image), and those of the nearest views are blended.
    pub struct PlanesConfig {
        /// Planes of a view, even in disparity: a multiple of 8.
        pub planes: usize = 32, numbers().whole(8, 256, "8 to 256 planes, a multiple of 8").columns(COLUMN);
        /// Views that the network sees of each: itself and the nearest others.
        pub inputs: usize = 5, numbers().whole(2, 16, "2 to 16 views").columns(COLUMN);
        /// Views whose planes are blended into a picture, the nearest.
        pub blend: usize = 5, numbers().whole(1, 16, "1 to 16 views").columns(COLUMN).same_time();
        /// Pixels along a side of the window of a view that a step works on: a multiple of 8.
        pub window: usize = 96, numbers().whole(16, 1024, "16 to 1024 pixels, a multiple of 8").columns(COLUMN);
        /// Pixels along a side of what a step asks for of the view that is left out.
        pub crop: usize = 64, numbers().whole(8, 1024, "8 to llff.window pixels").columns(COLUMN);
        /// Views of a step whose planes are blended into the one that is left out.
        pub references: usize = 2, numbers().whole(1, 8, "1 to 8 views").columns(COLUMN);
        /// Depth of the nearest plane, scene units. Empty = where the scene's rays start.
        pub near: Option<f64> = None, numbers().real(is_distance, "positive").columns(COLUMN).same_time();
        /// Depth of the farthest plane. Empty = twice as far as the scene's rays go, and as far for scenes of known extent.
        pub far: Option<f64> = None, numbers().real(is_distance, "positive").columns(COLUMN).same_time();
        /// How a rendered view differs from the one that was left out: `mse` or `l1`.
        pub loss: PlanesLoss = PlanesLoss::Mse, numbers().columns(COLUMN).same_time();
    }
    sections {}
}

impl PlanesConfig {
    /// Fills what depends on the scene.
    pub(super) fn resolve(&mut self, bounded: bool, (near, far): (f64, f64)) {
        self.near.get_or_insert(near);
        self.far.get_or_insert(if bounded { far } else { 2.0 * far });
    }

    /// The first setting that cannot be computed with beside the others: its name in the section, its value, and what is
    /// allowed.
    pub(super) fn wrong(&self) -> Option<(&'static str, String, String)> {
        let PlanesConfig { planes, window, crop, near, far, .. } = *self;
        let even =
            [("planes", planes), ("window", window)].into_iter().find(|(_, side)| !side.is_multiple_of(HALVINGS));
        if let Some((name, side)) = even {
            return Some((
                name,
                side.to_string(),
                format!("a multiple of {HALVINGS}: the network halves it three times"),
            ));
        }
        if crop > window {
            return Some(("crop", crop.to_string(), format!("8 to {window} (llff.window)")));
        }
        let (near, far) = near.zip(far)?;
        (near >= far).then(|| ("far", far.to_string(), format!("beyond llff.near = {near}")))
    }

    /// All of it in a line, for tables.
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
