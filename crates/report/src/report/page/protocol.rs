//! Settings that all rows share, differences of each row, and costs.

use crate::base::columns::is_per_seed;
use crate::report::distinct;
use crate::report::statistics::mean;
use crate::report::tables::{Line, PointTiming, Table};

/// Names, as words, and texts of fields.
type Fields<'a> = Vec<(String, &'a str)>;

/// The protocol of a scene's rows.
pub struct Scene<'a> {
    pub scene: &'a str,
    pub shared: Fields<'a>,
    /// A row's label, with the fields in which rows differ.
    pub different: Vec<(&'a str, Fields<'a>)>,
}

pub fn scenes(table: &Table) -> Vec<Scene<'_>> {
    let scenes = table.scenes().into_iter().filter_map(|(scene, lines)| {
        let measured: Vec<&Line> = lines.into_iter().filter(|line| !line.ids.is_empty()).collect();
        let names = measured.iter().flat_map(|line| line.protocol.iter().map(|(name, _)| name.as_str()));
        let names = distinct(names.filter(|name| !is_per_seed(name)));
        let is_shared = |name: &&str| measured.iter().all(|line| line.protocol(name) == measured[0].protocol(name));
        let (shared, different): (Vec<&str>, Vec<&str>) = names.into_iter().partition(is_shared);
        let first = *measured.first()?;
        Some(Scene {
            scene,
            shared: fields(first, &shared),
            different: match different.is_empty() {
                true => Vec::new(),
                false => measured.iter().map(|line| (line.label.as_str(), fields(line, &different))).collect(),
            },
        })
    });
    scenes.collect()
}

/// Returns the named fields of a line that are not empty.
fn fields<'a>(line: &'a Line, names: &[&'a str]) -> Fields<'a> {
    names
        .iter()
        .map(|name| (name.replace('_', " "), line.protocol(name)))
        .filter(|(_, text)| !text.is_empty())
        .collect()
}

/// A row's label, its scene, and sort key and text of each clock.
pub type Cost<'a> = (&'a str, &'a str, Vec<(String, String)>);

fn names(timing: &[PointTiming]) -> Vec<&str> {
    distinct(timing.iter().flat_map(|(_, clocks)| clocks.iter().map(|(name, _)| name.as_str())))
}

/// Returns the clocks' names in words.
pub fn clocks(timing: &[PointTiming]) -> Vec<String> {
    names(timing).into_iter().map(|name| name.replace('_', " ")).collect()
}

/// Returns means over the seeds of each line; empty without clocks.
pub fn costs<'a>(table: &'a Table, timing: &[PointTiming]) -> Vec<Cost<'a>> {
    let names = names(timing);
    if names.is_empty() {
        return Vec::new();
    }
    let number = |line: &Line, name: &str| {
        let clocks = timing.iter().filter(|(id, _)| line.ids.contains(id)).flat_map(|(_, clocks)| clocks);
        let values: Vec<f64> = clocks.filter(|(known, _)| known == name).filter_map(|(_, value)| *value).collect();
        mean(&values).map_or_else(Default::default, |value| (value.to_string(), rounded(value)))
    };
    let measured = table.lines.iter().filter(|line| !line.ids.is_empty());
    let cost = |line: &'a Line| {
        (line.label.as_str(), line.scene.as_str(), names.iter().map(|name| number(line, name)).collect())
    };
    measured.map(cost).collect()
}

fn rounded(value: f64) -> String {
    if value < 10.0 { format!("{value:.1}") } else { format!("{value:.0}") }
}
