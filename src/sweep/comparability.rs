//! What rows of a sweep must share to stand in one table.

use std::collections::HashMap;

use toml::Table;

use super::definition::Definition;
use super::points::Point;
use crate::metrics::{Metric, Needs};
use crate::report::TableSpec;
use crate::settings::columns::{Agreement, COLUMNS};
use crate::settings::registry::REGISTRY;
use crate::settings::value_at;

impl Definition {
    /// What tables and plots of these points need to know.
    pub fn table(&self, name: &str, points: &[Point]) -> TableSpec {
        TableSpec {
            name: name.to_string(),
            title: self.full_title(),
            metrics: self.metrics.clone(),
            rows: self.rows(),
            must_match: must_match(&self.metrics, points),
            equivalence: self.equivalence.clone().into_iter().collect(),
            varied: !self.axis.is_empty(),
            notes: Vec::new(),
        }
    }
}

/// Columns of the protocol that must be equal in all rows of a scene: all of the evaluation, but for those that the points
/// differ in by definition.
pub(super) fn must_match(metrics: &[String], points: &[Point]) -> Vec<String> {
    let tables: Vec<Table> = points.iter().map(|point| point.config.to_table()).collect();
    let mut first_of_scene: HashMap<&str, &Table> = HashMap::new();
    for (point, table) in points.iter().zip(&tables) {
        first_of_scene.entry(&point.scene).or_insert(table);
    }
    let varies = |path: &str| {
        let differs = |(point, table): (&Point, &Table)| {
            value_at(table, path) != value_at(first_of_scene[point.scene.as_str()], path)
        };
        points.iter().zip(&tables).any(differs)
    };
    let must_agree = COLUMNS.iter().filter(|column| match column.agreement {
        Agreement::Always => true,
        Agreement::UnlessVaried => {
            !REGISTRY.settings.iter().any(|setting| column.follows(setting) && varies(&setting.path))
        }
        Agreement::ForLpips => metrics.iter().any(|key| needs_lpips(key)),
        Agreement::Free => false,
    });
    must_agree.map(|column| column.name.to_string()).collect()
}

fn needs_lpips(metric: &str) -> bool {
    Metric::find(metric).is_some_and(|metric| matches!(metric.needs, Needs::Lpips(_)))
}
