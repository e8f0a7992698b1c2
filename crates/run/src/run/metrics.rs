//! Output of an evaluation: `metrics.json` and `metrics.csv`.

use std::path::Path;

use serde::Serialize;

use super::Protocol;
use super::columns::{cell, columns};
use crate::base::columns::file_field;
use crate::base::csv::csv_of_named;
use crate::base::files::{write_atomic, write_json};
use crate::base::{Error, Result};
use crate::mesh::Chamfer;
use crate::methods::SiteSummary;
use crate::metrics::{CHAMFER, F_SCORE, MeanMetrics, Scope, ViewMetrics, no_better_than_one_colour};

/// Steps before which a picture of one colour says nothing.
const FEW_STEPS: u64 = 100;

/// `metrics.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Means over the views.
    pub mean: MeanMetrics,
    /// Every view.
    pub views: Vec<ViewMetrics>,
    /// Provenance of the numbers.
    pub protocol: Protocol,
    /// Effect of the deltas over the logged steps, one entry a site; empty without a perturbed pass.
    pub attack: Vec<SiteSummary>,
    /// Every measured training view, as the training saw it; not part of `views` and their means.
    pub training_views: Vec<ViewMetrics>,
    /// Whether every rendered view is of a single colour, and the photos are not.
    #[serde(skip)]
    pub is_one_colour: bool,
}

impl Report {
    /// Makes a report of held-out views, training views and, if measured, a surface.
    pub fn new(
        views: Vec<ViewMetrics>,
        training_views: Vec<ViewMetrics>,
        surface: Option<Chamfer>,
        mut protocol: Protocol,
        attack: Vec<SiteSummary>,
    ) -> Report {
        protocol.set("inactive_by", attack.first().map(|site| site.inactive_by().name()).into());
        let mut mean = MeanMetrics::from_views(&views);
        mean.set_train(&training_views);
        mean.set(&CHAMFER, surface.as_ref().map(|surface| surface.chamfer));
        mean.set(&F_SCORE, surface.map(|surface| surface.f_score));
        Report { mean, views, protocol, attack, training_views, is_one_colour: false }
    }

    /// Says it if the views are no better than the best single colour of the training views.
    pub fn no_better_than_one_colour(&self) -> Option<String> {
        no_better_than_one_colour(&self.mean)
    }

    /// Returns an error if every rendered view is of a single colour, and the photos are not.
    ///
    /// # Errors
    /// [`Error::Diverged`].
    pub fn check_learned(&self, folder: &Path) -> Result<()> {
        // A run of few steps has learned nothing yet.
        let is_short = self.protocol.text("steps").parse().is_ok_and(|steps: u64| steps < FEW_STEPS);
        if !self.is_one_colour || is_short {
            return Ok(());
        }
        let numbers = self.no_better_than_one_colour().map_or(String::new(), |text| format!(" ({text})"));
        Err(Error::Diverged(format!(
            "{}: nothing was learned: every rendered view is of a single colour, and the photos are not{numbers}; \
             train with another seed, a lower train.learning_rate or field.rgb_limit = 8",
            folder.display()
        )))
    }

    /// Writes `metrics.json` and `metrics.csv`.
    pub fn write(&self, json: &Path, csv: &Path) -> Result<()> {
        write_json(json, self)?;
        write_atomic(csv, self.csv().as_bytes())
    }

    /// Returns the sites that were [inactive](SiteSummary::inactive).
    pub fn inactive_levels(&self) -> Vec<&str> {
        self.attack.iter().filter(|site| site.inactive).map(|site| site.site.as_str()).collect()
    }

    /// Returns one row for each held-out view, each with the complete protocol and the numbers of training views. A
    /// missing metric is an empty cell.
    fn csv(&self) -> String {
        let inactive = self.inactive_levels();
        let seen = self.mean.iter().filter(|(metric, _)| matches!(metric.scope, Scope::TrainViews | Scope::Gap));
        let seen: Vec<(String, String)> =
            seen.map(|(metric, value)| (metric.key.into(), cell(&value.into()))).collect();
        let rows = self.views.iter().map(|view| {
            let mut row = columns(view);
            row.extend(columns(&self.protocol).into_iter().map(file_field));
            row.push(("inactive_levels".into(), inactive.join(" ")));
            row.extend(seen.iter().cloned());
            row
        });
        csv_of_named(rows)
    }
}
