//! What tables and plots are made of: the points of a sweep as read back from files.

use serde::{Deserialize, Serialize};

/// One point of a sweep: a configuration with its seed, and what came of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Record {
    /// Content hash: the name of the point's folder.
    pub id: String,
    /// The scene's name.
    pub scene: String,
    /// The row as the table prints it, without axis values.
    pub row: String,
    /// Values of the axes that the point lies on, in the definition's order; empty for a plain row.
    pub axes: Vec<AxisValue>,
    /// Seed of every random stream; none of pictures that were scored without one.
    pub seed: Option<u64>,
    /// How far the point has come.
    pub status: Status,
    /// First line of why it failed or has no data; empty otherwise.
    pub reason: String,
    /// Name and value of each metric; a missing one is absent or none.
    pub metrics: Vec<(String, Option<f64>)>,
    /// Name and text of each field of the protocol; empty until the point is done.
    pub protocol: Vec<(String, String)>,
    /// Sites that were inactive, by what the protocol's `inactive_by` says.
    pub inactive_levels: Vec<String>,
}

/// A point's place on one axis.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct AxisValue {
    /// What is varied, as the plot's x axis names it: `steps`, `step size`, `injection layer`.
    pub axis: String,
    /// What it is varied of: `input coordinates`, `features`, `output`; empty where there is one panel.
    pub panel: String,
    /// The value as the definition wrote it.
    pub value: String,
}

impl std::fmt::Display for AxisValue {
    /// `features steps = 3`.
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let space = if self.panel.is_empty() { "" } else { " " };
        write!(f, "{}{space}{} = {}", self.panel, self.axis, self.value)
    }
}

/// A row with the values of its axes: `Aug-NeRF, features steps = 3`.
pub fn label(row: &str, axes: &[AxisValue]) -> String {
    std::iter::once(row.to_string()).chain(axes.iter().map(|value| format!(", {value}"))).collect()
}

/// How far a point has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Status {
    /// Measured; has metrics.
    Done,
    /// Being trained right now.
    Running,
    /// Not begun, or stopped with a checkpoint.
    Waiting,
    /// Ended with an error.
    Failed,
    /// Its scene is not on this machine.
    NoData,
}

impl Status {
    /// All of them.
    pub const ALL: [Status; 5] = [Status::Done, Status::Running, Status::Waiting, Status::Failed, Status::NoData];

    /// The word in files and tables.
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
    /// The row with its axis values: `Aug-NeRF, features steps = 3`.
    pub fn label(&self) -> String {
        label(&self.row, &self.axes)
    }

    /// For a person: row, scene, seed.
    pub fn point_label(&self) -> String {
        format!("{} · {} · {}", self.label(), self.scene, self.seed_text())
    }

    /// `seed 3`, or `no seed`.
    pub fn seed_text(&self) -> String {
        self.seed.map_or("no seed".into(), |seed| format!("seed {seed}"))
    }

    /// A metric's value, where there is one.
    pub fn metric(&self, name: &str) -> Option<f64> {
        self.metrics.iter().find(|(known, _)| known == name).and_then(|(_, value)| *value)
    }

    /// A protocol field's text; empty where there is none.
    pub fn protocol(&self, name: &str) -> &str {
        self.protocol.iter().find(|(known, _)| known == name).map_or("", |(_, text)| text)
    }
}

/// What a definition says about its table.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TableSpec {
    /// The sweep's name.
    pub name: String,
    /// What the table answers, one line.
    pub title: String,
    /// Metrics to print, best first: `psnr`, `ssim`, `lpips_squeeze`, ...
    pub metrics: Vec<String>,
    /// The rows in printing order.
    pub rows: Vec<RowSpec>,
    /// Protocol fields that must be equal in all rows of a scene.
    pub must_match: Vec<String>,
    /// Those of them that go with the seed: they must be equal in all rows of a scene with one seed.
    pub by_seed: Vec<String>,
    /// Metrics with the margin within which a row counts as equivalent to its baseline, in the metric's unit. Without one
    /// no equivalence is claimed.
    pub equivalence: Vec<(String, f64)>,
    /// All rows are varied along axes, but for single ones to compare with: figures are drawn against the axes.
    pub varied: bool,
    /// What stands below the table besides: what was chosen of a sweep, and of which sweeps.
    pub notes: Vec<String>,
}

impl TableSpec {
    /// The margin of equivalence of a metric; none where the definition states none.
    pub fn margin(&self, metric: &str) -> Option<f64> {
        self.equivalence.iter().find(|(known, _)| known == metric).map(|(_, margin)| *margin)
    }

    /// A row that was not trained here: pictures of another program.
    pub fn is_scored(&self, row: &str) -> bool {
        self.rows.iter().any(|known| known.scored && known.name == row)
    }

    /// The table has a metric whose key begins so.
    pub(super) fn has_any(&self, prefix: &str) -> bool {
        self.metrics.iter().any(|metric| metric.starts_with(prefix))
    }
}

/// One row of the definition.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RowSpec {
    /// As the table prints it.
    pub name: String,
    /// The row that it is compared with, seed by seed; none for a baseline.
    pub baseline: Option<String>,
    /// A row of ours that the paper does not have.
    pub ours: bool,
    /// Not run here: the paper's numbers alone.
    pub quoted: bool,
    /// Not trained here: pictures that another program rendered, measured under our protocol.
    pub scored: bool,
    /// Where the paper's numbers are: table, condition and method of `published.csv`; the scene is the record's.
    pub published: Option<PublishedKey>,
}

/// Finds rows of `published.csv`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PublishedKey {
    /// `tab1`, ...
    pub table: String,
    /// `clean`, `gaussian_noise`, ...
    pub condition: String,
    /// The method as the paper names it.
    pub method: String,
}

/// Each item once, in the order of first appearance.
pub fn distinct<T: PartialEq>(items: impl Iterator<Item = T>) -> Vec<T> {
    let mut seen = Vec::new();
    for item in items {
        if !seen.contains(&item) {
            seen.push(item);
        }
    }
    seen
}
