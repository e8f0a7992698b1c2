//! Inputs of tables and plots: the points of a sweep as read from files.

use serde::{Deserialize, Serialize};

use crate::base::columns::field_order;
use crate::metrics::{FLOOR_PSNR, PSNR};

/// The column that says how often a training pixel was seen.
pub(super) const EPOCHS: &str = "epochs";

/// One point of a sweep at one position of its table: a configuration with its seed, and its results.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Record {
    /// Content hash: the name of the point's folder.
    pub id: String,
    /// The scene's name.
    pub scene: String,
    /// The row's name in the table, without axis values.
    pub row: String,
    /// Axis values of the point, in the definition's order; empty for a plain row.
    pub axes: Vec<AxisValue>,
    /// Seed of every random stream; `None` before the point is laid out.
    pub seed: Option<u64>,
    /// The point's progress.
    pub status: Status,
    /// First line of why it failed or has no data; empty otherwise.
    pub reason: String,
    /// What it left; empty until the point is done.
    pub result: PointResult,
}

/// What a finished point leaves: the content of its `result.json`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PointResult {
    /// Name and value of each metric; a missing one is absent or `None`.
    pub metrics: Vec<(String, Option<f64>)>,
    /// Name and text of each field of the protocol.
    pub protocol: Vec<(String, String)>,
    /// Sites that were inactive by the measure in the protocol's `inactive_by`.
    pub inactive_levels: Vec<String>,
}

impl PointResult {
    /// Returns a metric's value, if there is one.
    pub fn metric(&self, name: &str) -> Option<f64> {
        self.metrics.iter().find(|(known, _)| known == name).and_then(|(_, value)| *value)
    }
}

/// A point's position on one axis.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct AxisValue {
    /// Name of the varied quantity, used as the x axis of the plot: `steps`, `step size`, `injection layer`.
    pub axis: String,
    /// The part that is varied: `input coordinates`, `features`, `output`; empty if there is one panel.
    pub panel: String,
    /// The value as in the definition.
    pub value: String,
}

impl std::fmt::Display for AxisValue {
    /// Writes `features steps = 3`.
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let space = if self.panel.is_empty() { "" } else { " " };
        write!(f, "{}{space}{} = {}", self.panel, self.axis, self.value)
    }
}

/// Returns a row's name with its axis values: `Aug-NeRF, features steps = 3`.
pub fn label(row: &str, axes: &[AxisValue]) -> String {
    std::iter::once(row.to_string()).chain(axes.iter().map(|value| format!(", {value}"))).collect()
}

/// Progress of a point.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Status {
    /// Measured; has metrics.
    Done,
    /// Training is in progress.
    Running,
    /// Not started, or stopped with a checkpoint.
    #[default]
    Waiting,
    /// Ended with an error.
    Failed,
    /// Its scene is missing on this machine.
    NoData,
}

impl Status {
    /// All states.
    pub const ALL: [Status; 5] = [Status::Done, Status::Running, Status::Waiting, Status::Failed, Status::NoData];

    /// Returns the word in files and tables.
    pub fn name(self) -> &'static str {
        match self {
            Status::Done => "done",
            Status::Running => "running",
            Status::Waiting => "waiting",
            Status::Failed => "failed",
            Status::NoData => "no data",
        }
    }
}

impl Record {
    /// Returns the row with its axis values: `Aug-NeRF, features steps = 3`.
    pub fn label(&self) -> String {
        label(&self.row, &self.axes)
    }

    /// Returns a label for people: row, scene, seed.
    pub fn point_label(&self) -> String {
        format!("{} · {} · {}", self.label(), self.scene, self.seed_text())
    }

    /// Returns `seed 3`, or `no seed`.
    pub fn seed_text(&self) -> String {
        self.seed.map_or("no seed".into(), |seed| format!("seed {seed}"))
    }

    /// Returns a metric's value, if there is one.
    pub fn metric(&self, name: &str) -> Option<f64> {
        self.result.metric(name)
    }

    /// Returns whether the PSNR is no higher than that of the training views' best single colour. `None` if one of both is
    /// missing.
    pub fn is_no_better_than_one_colour(&self) -> Option<bool> {
        Some(self.metric(PSNR.key)? <= self.metric(FLOOR_PSNR.key)?)
    }

    /// Returns how often its training pixels were seen, or `None` for points of earlier programs, which do not say it.
    pub fn epochs(&self) -> Option<f64> {
        self.protocol(EPOCHS).parse().ok().filter(|epochs: &f64| epochs.is_finite())
    }

    /// Returns the record with its protocol in one order, whichever program measured it.
    pub fn ordered(mut self) -> Record {
        self.result.protocol.sort_by_key(|(name, _)| field_order(name));
        self
    }

    /// Returns a protocol field's text; empty if there is none.
    pub fn protocol(&self, name: &str) -> &str {
        self.result.protocol.iter().find(|(known, _)| known == name).map_or("", |(_, text)| text)
    }
}

/// A definition's description of its table.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TableSpec {
    /// The sweep's name.
    pub name: String,
    /// The question that the table answers, in one line.
    pub title: String,
    /// Metrics to print, the most important first: `psnr`, `ssim`, `lpips_squeeze`, ...
    pub metrics: Vec<String>,
    /// The rows in printing order.
    pub rows: Vec<RowSpec>,
    /// Protocol fields that must be equal in all rows of a scene.
    pub must_match: Vec<String>,
    /// The fields among them that depend on the seed: they must be equal in all rows of a scene with one seed.
    pub by_seed: Vec<String>,
    /// Metrics with the margin within which a row counts as equivalent to its baseline, in the metric's unit. Without
    /// a margin, equivalence is not tested.
    pub equivalence: Vec<(String, f64)>,
    /// All rows are varied along axes, except reference lines: figures are drawn against the axes.
    pub varied: bool,
    /// Further notes below the table: the sweeps and the selection that it shows.
    pub notes: Vec<String>,
    /// Settings that were changed for all rows, as the end of the title has them: `data.width = 24, ...`.
    pub changed: String,
    /// The settings of axes that vary several of them together.
    pub parts: Vec<AxisParts>,
}

/// The settings that an axis varies together.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AxisParts {
    /// The axis's name.
    pub axis: String,
    /// Its panel.
    pub panel: String,
    /// What tells each setting from the others, in the order of a value's parts: `t`, `xyz`, `view`.
    pub names: Vec<String>,
}

impl TableSpec {
    /// Returns the names of the settings that an axis varies together; empty if it varies one.
    pub fn parts_of(&self, axis: &str, panel: &str) -> &[String] {
        let own = self.parts.iter().find(|parts| (parts.axis.as_str(), parts.panel.as_str()) == (axis, panel));
        own.map_or(&[], |parts| &parts.names)
    }

    /// Returns the margin of equivalence of a metric, or `None` if the definition has none.
    pub fn margin(&self, metric: &str) -> Option<f64> {
        self.equivalence.iter().find(|(known, _)| known == metric).map(|(_, margin)| *margin)
    }

    /// Returns whether a metric's key has this prefix.
    pub(super) fn has_any(&self, prefix: &str) -> bool {
        self.metrics.iter().any(|metric| metric.starts_with(prefix))
    }
}

/// One row of the definition.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RowSpec {
    /// The name in the table.
    pub name: String,
    /// The row that it is compared with, seed by seed, or `None` for a baseline.
    pub baseline: Option<String>,
    /// The paper does not have this row.
    pub ours: bool,
    /// Not run here: only the paper's numbers.
    pub quoted: bool,
    /// It names its device. Other rows may have another.
    pub names_device: bool,
    /// Key of the paper's numbers: table, condition and method of `published.csv`; the scene is the record's.
    pub published: Option<PublishedKey>,
}

/// Key of rows in `published.csv`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PublishedKey {
    /// `tab1`, ...
    pub table: String,
    /// `clean`, `gaussian_noise`, ...
    pub condition: String,
    /// The paper's name of the method.
    pub method: String,
}
