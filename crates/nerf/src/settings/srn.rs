//! Section `srn`: Scene Representation Networks (Sitzmann et al. 2019), one network per scene.

use crate::base::settings::{numbers, section};

/// The protocol's column for all settings of the section.
const COLUMN: &[&str] = &["srn"];

section! {
    /// Scene Representation Networks: a network of features in space, an LSTM that steps along each ray to its end, and
    /// a network that turns the feature there into a colour. Defaults are those of the original code.
    pub struct SrnConfig {
        /// Width of the layers, and size of a feature.
        pub width: usize = 256, numbers().whole(4, 4096, "4 to 4096 neurons").columns(COLUMN);
        /// Layers from a point in space to its feature.
        pub phi_layers: usize = 4, numbers().whole(1, 64, "1 to 64 layers").columns(COLUMN);
        /// Hidden layers from a feature to its colour.
        pub pixel_layers: usize = 5, numbers().whole(1, 64, "1 to 64 layers").columns(COLUMN);
        /// Steps along a ray.
        pub steps: usize = 10, numbers().whole(1, 1000, "1 to 1000 steps").columns(COLUMN);
        /// Initial depth of rays along the camera's axis, in scene units times `scale`.
        pub start_depth: f64 = 0.05,
            numbers().zero_or_positive().columns(COLUMN).same_time();
        /// Standard deviation of the initial depth between rays in training; views are rendered without it.
        pub start_noise: f64 = 5e-4, numbers().real(|noise| noise >= 0.0, "0 (none) or positive").columns(COLUMN).same_time();
        /// Factor on positions before the network reads them.
        pub scale: f64 = 1.0, numbers().positive().columns(COLUMN).same_time();
        /// Weight of the mean squared error of colours, which are from -1 to 1.
        pub image_weight: f64 = 200.0, numbers().positive().columns(COLUMN).same_time();
        /// Weight of the mean of min(depth, 0)^2, which keeps rays from ending behind their camera.
        pub depth_weight: f64 = 10.0, numbers().off_or_positive().columns(COLUMN).same_time();
    }
    sections {}
}

impl SrnConfig {
    /// Returns all settings in one line, for tables.
    pub fn text(&self) -> String {
        let SrnConfig { width, phi_layers, pixel_layers, steps, start_depth, start_noise, scale, .. } = self;
        format!(
            "width {width}, {phi_layers} + {pixel_layers} layers, {steps} steps from {start_depth} (noise {start_noise}), scale \
             {scale}, weights {} (colour) and {} (depth)",
            self.image_weight, self.depth_weight
        )
    }
}
