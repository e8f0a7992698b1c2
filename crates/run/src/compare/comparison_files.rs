//! The files of a comparison.

use std::path::Path;

use serde::Serialize;

use super::comparison::Comparison;
use super::comparison_figure;
use super::differences::Difference;
use super::fade::write_fade;
use super::window::Window;
use crate::base::Result;
use crate::base::files::{write_atomic, write_json};
use crate::draw::Figure;
use crate::metrics::ViewMetrics;
use crate::run::Protocol;

/// `compare.json`.
#[derive(Serialize)]
struct ComparisonFile<'a> {
    scene: String,
    view: &'a str,
    index: usize,
    #[serde(rename = "box")]
    window: Window,
    box_chosen_by: &'static str,
    /// Ends of the errors' colour scale, in colour values of 0..=1.
    error_colours: (f32, f32),
    /// Nearest and farthest depth of the colour scale.
    depth_colours: (f32, f32),
    depth_unit: &'static str,
    differences: &'a [Difference],
    runs: Vec<RunLine<'a>>,
}

#[derive(Serialize)]
struct RunLine<'a> {
    run: &'a str,
    view: &'a ViewMetrics,
    #[serde(rename = "box")]
    in_box: &'a ViewMetrics,
    protocol: &'a Protocol,
}

/// Writes `NAME.png`, or `NAME.svg` without the feature `png-figures`. Either holds the pixels of images.
pub(super) fn write_picture(figure: &Figure, folder: &Path, name: &str) -> Result<()> {
    match figure.png()? {
        Some(png) => write_atomic(&folder.join(format!("{name}.png")), &png),
        None => write_atomic(&folder.join(format!("{name}.svg")), figure.svg.as_bytes()),
    }
}

impl Comparison {
    /// Writes `compare.png` (`compare.svg` without the feature `png-figures`) and `compare.json` into a folder; with
    /// `fade`, also `fade.gif`.
    pub fn write(&self, folder: &Path, fade: bool) -> Result<()> {
        write_picture(&comparison_figure::draw(self)?, folder, "compare")?;
        write_json(&folder.join("compare.json"), &self.file())?;
        if fade {
            write_fade(self, &folder.join("fade.gif"))?;
        }
        Ok(())
    }

    /// Returns the content of `compare.json`.
    pub fn json(&self) -> serde_json::Value {
        serde_json::to_value(self.file()).expect("plain data")
    }

    fn file(&self) -> ComparisonFile<'_> {
        let first = self.first();
        let runs = self.sides.iter().map(|side| RunLine {
            run: &side.run.label,
            view: &side.metrics,
            in_box: &side.metrics_in_box,
            protocol: &side.run.protocol,
        });
        ComparisonFile {
            scene: first.protocol.text("scene"),
            view: &first.view.name,
            index: first.index,
            window: self.window,
            box_chosen_by: self.chosen_by(),
            error_colours: (0.0, self.error_top),
            depth_colours: self.depths,
            depth_unit: first.depth_unit(),
            differences: &self.differences,
            runs: runs.collect(),
        }
    }
}
