//! What an evaluation leaves: `metrics.json` and `metrics.csv`.

use std::path::Path;

use serde::Serialize;

use super::Protocol;
use crate::base::Result;
use crate::base::csv::csv_of_named;
use crate::base::files::{write_atomic, write_json};
use crate::methods::SiteSummary;
use crate::metrics::{MeanMetrics, ViewMetrics};
use crate::space::Chamfer;

/// `metrics.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Means over the views.
    pub mean: MeanMetrics,
    /// Every view.
    pub views: Vec<ViewMetrics>,
    /// Where the numbers come from.
    pub protocol: Protocol,
    /// What the deltas did over the logged steps, one entry a site; empty without a perturbed pass.
    pub attack: Vec<SiteSummary>,
}

impl Report {
    /// Of measured views, and of a surface where one was measured.
    pub fn new(
        views: Vec<ViewMetrics>,
        surface: Option<Chamfer>,
        protocol: Protocol,
        attack: Vec<SiteSummary>,
    ) -> Report {
        let mut mean = MeanMetrics::from_views(&views);
        mean.set("chamfer", surface.as_ref().map(|surface| surface.chamfer));
        mean.set("f_score", surface.and_then(|surface| surface.scores.first().map(|score| score.f_score)));
        Report { mean, views, protocol, attack }
    }

    /// Writes `metrics.json` and `metrics.csv`.
    pub fn write(&self, json: &Path, csv: &Path) -> Result<()> {
        write_json(json, self)?;
        write_atomic(csv, self.csv().as_bytes())
    }

    /// Sites whose deltas had no effect on the loss.
    pub fn inactive_levels(&self) -> Vec<&'static str> {
        self.attack.iter().filter(|site| site.inactive).map(|site| site.site).collect()
    }

    /// One row a view, each with the whole protocol; a missing metric is an empty cell.
    fn csv(&self) -> String {
        let inactive = self.inactive_levels();
        let rows = self.views.iter().map(|view| {
            let mut row = columns(view);
            row.extend(columns(&self.protocol));
            row.push(("inactive_levels".into(), inactive.join(" ")));
            row
        });
        csv_of_named(rows)
    }
}

/// The fields of a flat struct as text, in their order; null is an empty cell.
pub fn columns(row: &impl Serialize) -> Vec<(String, String)> {
    let serde_json::Value::Object(fields) = serde_json::to_value(row).expect("plain data") else {
        unreachable!("rows are structs")
    };
    let text = |value: serde_json::Value| match value {
        serde_json::Value::Null => String::new(),
        serde_json::Value::String(text) => text,
        other => other.to_string(),
    };
    fields.into_iter().map(|(name, value)| (name, text(value))).collect()
}
