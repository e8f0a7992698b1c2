//! Checks that reject a table.

use super::Group;
use crate::base::columns::disagree;
use crate::base::{Error, Result};
use crate::report::{Record, RowSpec, TableSpec};

/// Returns an error for rows that refer to nothing, and points without a position in the table.
pub(super) fn check_definition(spec: &TableSpec, records: &[Record]) -> Result<()> {
    spec.rows.iter().try_for_each(|row| check_row(spec, row))?;
    for (index, record) in records.iter().enumerate() {
        if !spec.rows.iter().any(|row| row.name == record.row) {
            return Err(Error::Config(format!(
                "point {} is of row `{}`, which {} does not have; {}",
                record.id,
                record.row,
                spec.name,
                row_names(spec)
            )));
        }
        let same =
            |other: &&Record| (place(other), other.seed, &other.axes) == (place(record), record.seed, &record.axes);
        if let Some(other) = records[..index].iter().find(same) {
            return Err(Error::Config(format!(
                "points {} and {} are both {} with {} on scene {}; a row may have each seed once",
                other.id,
                record.id,
                record.label(),
                record.seed_text(),
                record.scene
            )));
        }
    }
    Ok(())
}

fn place(record: &Record) -> (&str, &str) {
    (&record.scene, &record.row)
}

fn check_row(spec: &TableSpec, row: &RowSpec) -> Result<()> {
    if let Some(baseline) = row.baseline.as_ref().filter(|name| !spec.rows.iter().any(|other| other.name == **name)) {
        return Err(Error::Config(format!(
            "row `{}`: the baseline `{baseline}` is not a row of {}; {}",
            row.name,
            spec.name,
            row_names(spec)
        )));
    }
    let published = row.published.as_ref().map_or(Ok(()), |key| key.check());
    published.map_err(|message| Error::Config(format!("row `{}`: {message}", row.name)))
}

fn row_names(spec: &TableSpec) -> String {
    let names: Vec<&str> = spec.rows.iter().map(|row| row.name.as_str()).collect();
    format!("its rows are {}", names.join(", "))
}

/// Returns an error if measured points of one scene differ in a field of `must_match`.
pub(super) fn check_controlled(spec: &TableSpec, groups: &[Group]) -> Result<()> {
    let pairs = groups
        .iter()
        .flat_map(Group::done)
        .flat_map(|point| firsts(spec, groups, point).map(move |first| (point, first)));
    for (point, first) in pairs {
        let differing = disagreements(spec, point, first);
        if let Some((field, others)) = differing.split_first() {
            let value_in = |record: &Record| {
                format!("`{}` in {} ({})", record.protocol(field), record.label(), record.seed_text())
            };
            let others = match others.is_empty() {
                true => String::new(),
                false => format!("; they differ in {} as well", others.join(", ")),
            };
            return Err(Error::NotComparable(format!(
                "the rows of scene {} are not comparable: {field} is {} and {}{others}; run them under one setting, or \
                 build the table anyway with --force, which marks the rows that differ",
                point.scene,
                value_in(first),
                value_in(point)
            )));
        }
    }
    Ok(())
}

/// Returns the fields of `must_match` in which a point differs from another of its scene. Fields that depend on the
/// seed may differ between seeds.
pub fn disagreements(spec: &TableSpec, point: &Record, first: &Record) -> Vec<String> {
    let differs = |field: &&String| {
        let own = point.protocol(field);
        let goes_with_seed = point.seed != first.seed && spec.by_seed.contains(field);
        let goes_with_row = *field == DEVICE && names_device(spec, point) != names_device(spec, first);
        !goes_with_seed && !goes_with_row && disagree(field, own, first.protocol(field))
    };
    spec.must_match.iter().filter(differs).cloned().collect()
}

/// Returns the fields of `must_match` in which a point of the group differs from the scene's first.
pub(super) fn mixed_fields(spec: &TableSpec, group: &Group, groups: &[Group]) -> Vec<String> {
    let of_point = |point| firsts(spec, groups, point).flat_map(|first| disagreements(spec, point, first));
    let differing: Vec<String> = group.done().flat_map(of_point).collect();
    spec.must_match.iter().filter(|field| differing.contains(field)).cloned().collect()
}

/// The field of the device.
const DEVICE: &str = "device";

fn names_device(spec: &TableSpec, point: &Record) -> bool {
    spec.rows.iter().any(|row| row.name == point.row && row.names_device)
}

/// Returns the first points, in the table's order: of the point's scene, of its scene with its seed, and of those rows of its scene
/// that name their device as its own does.
fn firsts<'a>(spec: &TableSpec, groups: &[Group<'a>], point: &Record) -> impl Iterator<Item = &'a Record> {
    let of_scene = || groups.iter().filter(|group| group.scene == point.scene).flat_map(Group::done);
    let of_seed = of_scene().find(|other| other.seed == point.seed);
    let of_device = of_scene().find(|other| names_device(spec, other) == names_device(spec, point));
    of_scene().next().into_iter().chain(of_seed).chain(of_device)
}
