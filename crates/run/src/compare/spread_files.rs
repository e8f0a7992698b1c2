//! The files of a spread over seeds.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;

use super::comparison_files::write_picture;
use super::differences::{Difference, differences};
use super::run_view::RunView;
use super::spread::{NUMBERS, QUANTITIES, SpreadNumbers, ViewSpread};
use super::spread_figure;
use crate::base::Result;
use crate::base::csv::csv_text;
use crate::base::files::{write_atomic, write_json};
use crate::data::View;
use crate::report::calibration::CalibrationBin;
use crate::run::{Protocol, columns};

/// Mean and standard deviation of renderings over the seeds of one row, on their common held-out views.
pub struct Spread {
    /// The row's name.
    pub row: String,
    /// The seeds.
    pub seeds: Vec<u64>,
    /// Each seed with the first common view.
    pub(super) runs: Vec<RunView>,
    /// Held-out views of some seeds that are not common to all.
    pub skipped_views: Vec<String>,
    /// Each common view.
    pub views: Vec<ViewLine>,
    /// Means over the views.
    pub mean: SpreadNumbers,
    /// Error against spread over all views.
    pub curve: Vec<CalibrationBin>,
    /// The view with its images.
    pub shown: Shown,
}

/// A view's numbers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ViewLine {
    /// The view's name.
    pub view: String,
    /// Number of pixels that count.
    pub pixels: usize,
    /// The numbers.
    #[serde(flatten)]
    pub numbers: SpreadNumbers,
}

/// The view that the image shows.
pub struct Shown {
    /// The view.
    pub view: View,
    /// Its number among the common views, from 0.
    pub index: usize,
    /// Its images.
    pub found: ViewSpread,
}

/// `spread.json`.
#[derive(Serialize)]
struct SpreadFile<'a> {
    scene: String,
    row: &'a str,
    seeds: &'a [u64],
    /// Means over views.
    mean: &'a SpreadNumbers,
    views: &'a [ViewLine],
    skipped_views: &'a [String],
    calibration: &'a [CalibrationBin],
    shown: ShownLine<'a>,
    /// Settings in which the seeds differ, whose effect the spread includes.
    differences: Vec<Difference>,
    definitions: BTreeMap<&'static str, &'static str>,
    runs: Vec<RunLine<'a>>,
}

#[derive(Serialize)]
struct ShownLine<'a> {
    view: &'a str,
    index: usize,
    /// Ends of the colour scale of spread and error.
    colours: [f64; 2],
    depth_colours: [f64; 2],
    depth_spread_colours: [f64; 2],
    depth_unit: &'static str,
}

#[derive(Serialize)]
struct RunLine<'a> {
    seed: u64,
    /// Completed steps.
    step: u64,
    protocol: &'a Protocol,
}

impl Spread {
    /// Returns in what the seeds differ, apart from the seed.
    pub fn differences(&self) -> Vec<Difference> {
        let runs: Vec<&RunView> = self.runs.iter().collect();
        differences(&runs).into_iter().filter(|difference| difference.name != "seed").collect()
    }

    /// Returns the names of these differences as text, if there are any. The data's hash follows from others.
    pub fn difference_names(&self) -> Option<String> {
        let differences = self.differences();
        let names = differences.iter().map(|difference| difference.name.as_str());
        let telling: Vec<&str> = names.clone().filter(|name| *name != "data_hash").collect();
        let names = if telling.is_empty() { names.collect() } else { telling };
        (!names.is_empty()).then(|| names.join(", "))
    }

    /// Writes `spread.png` (`spread.svg` without the feature `png-figures`), `calibration.svg`, `calibration.png`,
    /// `spread.csv` and `spread.json` into a folder.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<()> {
        write_picture(&spread_figure::draw(self)?, folder, "spread")?;
        for (name, content) in spread_figure::draw_calibration(self)?.files("calibration") {
            write_atomic(&folder.join(name), &content.bytes()?)?;
        }
        write_atomic(&folder.join("spread.csv"), self.csv().as_bytes())?;
        write_json(&folder.join("spread.json"), &self.file())
    }

    /// Returns the content of `spread.json`.
    pub fn json(&self) -> serde_json::Value {
        serde_json::to_value(self.file()).expect("plain data")
    }

    /// Returns the calibration curve, one line a bin.
    fn csv(&self) -> String {
        let bins: Vec<Vec<(String, String)>> = self.curve.iter().map(columns).collect();
        let head = bins.iter().take(1).map(|bin| bin.iter().map(|(name, _)| name.clone()).collect());
        let cells = bins.iter().map(|bin| bin.iter().map(|(_, cell)| cell.clone()).collect());
        csv_text(head.chain(cells))
    }

    fn file(&self) -> SpreadFile<'_> {
        let scales = spread_figure::Scales::new(self);
        let runs = self.runs.iter().zip(&self.seeds);
        SpreadFile {
            scene: self.runs[0].protocol.text("scene"),
            row: &self.row,
            seeds: &self.seeds,
            mean: &self.mean,
            views: &self.views,
            skipped_views: &self.skipped_views,
            calibration: &self.curve,
            shown: ShownLine {
                view: &self.shown.view.name,
                index: self.shown.index,
                colours: [0.0, scales.colour.into()],
                depth_colours: [scales.depth.0.into(), scales.depth.1.into()],
                depth_spread_colours: [0.0, scales.depth_spread.into()],
                depth_unit: self.runs[0].depth_unit(),
            },
            differences: self.differences(),
            definitions: QUANTITIES.into_iter().chain(NUMBERS).collect(),
            runs: runs.map(|(run, seed)| RunLine { seed: *seed, step: run.steps.0, protocol: &run.protocol }).collect(),
        }
    }
}
