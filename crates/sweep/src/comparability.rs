//! What the rows of a sweep must share to be in one table.

use std::collections::{BTreeSet, HashMap};
use std::hash::Hash;

use toml::Table;

use super::axes::Axis;
use super::definition::Definition;
use super::points::Point;
use crate::metrics::{Metric, Needs};
use crate::report::TableSpec;
use crate::settings::columns::{Agreement, COLUMNS, Column};
use crate::settings::registry::REGISTRY;
use crate::settings::value_at;

impl Definition {
    /// Returns what tables and plots of these points need to know.
    pub fn table(&self, name: &str, points: &[Point]) -> TableSpec {
        let must_match = must_match(&self.metrics, points);
        TableSpec {
            name: name.to_string(),
            title: self.full_title(),
            metrics: self.metrics.clone(),
            rows: self.rows(),
            by_seed: by_seed(&must_match, points),
            must_match,
            equivalence: self.equivalence.clone().into_iter().collect(),
            varied: !self.axis.is_empty(),
            notes: Vec::new(),
            changed: self.changed_text(),
            parts: self.all_axes().filter_map(Axis::parts).collect(),
        }
    }
}

/// Returns the protocol columns that must be equal in all rows of a scene: all columns of the evaluation, except those
/// that the definition varies within a seed.
pub(super) fn must_match(metrics: &[String], points: &[Point]) -> Vec<String> {
    let varied = varied(points, |point| (point.scene.as_str(), point.config.seed));
    let must_agree = COLUMNS.iter().filter(|column| match column.agreement {
        Agreement::Always => true,
        Agreement::UnlessVaried => !varied.contains(column.name),
        Agreement::ForLpips => metrics.iter().any(|key| needs_lpips(key)),
        Agreement::Free => false,
    });
    must_agree.map(|column| column.name.to_string()).collect()
}

/// Returns those of the columns in which points of a scene differ by definition, seed by seed.
pub(super) fn by_seed(must_match: &[String], points: &[Point]) -> Vec<String> {
    let varied = varied(points, |point| point.scene.as_str());
    must_match.iter().filter(|column| varied.contains(column.as_str())).cloned().collect()
}

/// Returns the columns of settings that differ between points of one group.
fn varied<'p, K: Hash + Eq>(points: &'p [Point], group: impl Fn(&'p Point) -> K) -> BTreeSet<&'static str> {
    let tables: Vec<Table> = points.iter().map(|point| point.config.to_table()).collect();
    let mut firsts: HashMap<K, &Table> = HashMap::new();
    for (point, table) in points.iter().zip(&tables) {
        firsts.entry(group(point)).or_insert(table);
    }
    let varies = |path: &str| {
        let differs =
            |(point, table): (&'p Point, &Table)| value_at(table, path) != value_at(firsts[&group(point)], path);
        points.iter().zip(&tables).any(differs)
    };
    let follows = |column: &&Column| REGISTRY.settings.iter().any(|s| column.follows(s) && varies(&s.path));
    COLUMNS.iter().filter(follows).map(|column| column.name).collect()
}

fn needs_lpips(metric: &str) -> bool {
    Metric::find(metric).is_some_and(|metric| matches!(metric.needs, Needs::Lpips(_)))
}
