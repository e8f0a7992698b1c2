//! Whether points are those of the definition: their names are hashes of their configurations.

use std::path::Path;

use super::Verifier;
use super::archive::Archive;
use super::files::Collected;
use super::findings::Findings;
use crate::base::Result;
use crate::budget::{PlacingCountedAsTrained, StepCosts};
use crate::definition::BudgetKind;
use crate::folder::SweepFolder;
use crate::layout::{PlannedRun, lay_out};
use crate::points::{Point, WITHOUT_BUDGET, point};
use crate::report::label;
use crate::settings::Config;
use crate::step_seconds::kept_step_seconds;

/// Compares `points.csv`, `points.json` and `sweep.toml`.
pub fn check(verifier: &Verifier, sweep: &Collected, findings: &mut Findings) -> Result<()> {
    let archive = &sweep.archive;
    let mut wrong = Vec::new();
    for point in &archive.points {
        let id = id(archive, point);
        if point.id != id {
            wrong.push(format!(
                "points.json: {} has the name {}, its configuration makes {id}",
                point.label(),
                point.id
            ));
        }
    }
    let (records, mut placed) = (&archive.outputs.records, 0);
    for point in &archive.points {
        for place in &point.places {
            placed += 1;
            let same = |record: &&crate::report::Record| {
                (&record.id, &record.row, &record.axes) == (&point.id, &place.row, &place.axes)
            };
            match records.iter().find(same) {
                None => wrong.push(format!("points.csv lacks {}", point.label())),
                Some(record) if (record.seed, &record.scene) != (Some(point.config.seed), &point.scene) => {
                    wrong.push(format!("points.csv: {} stands there as {}", point.label(), record.point_label()));
                }
                Some(_) => {}
            }
        }
    }
    if records.len() > placed {
        wrong.push(format!("points.csv has {} lines, points.json {placed} places", records.len()));
    }
    findings.of(format!("{} points are named by the hashes of their configurations", archive.points.len()), wrong);
    of_definition(archive, verifier.data_root, findings)
}

/// The name that the points' revision gave a point of this configuration.
fn id(archive: &Archive, point: &Point) -> String {
    let suffix = if point.without_budget { WITHOUT_BUDGET } else { "" };
    point.config.hash_without(&archive.provenance.settings_since) + suffix
}

/// Lays the definition out again and compares.
fn of_definition(archive: &Archive, data_root: Option<&Path>, findings: &mut Findings) -> Result<()> {
    let mut definition = archive.definition.clone();
    for (path, value) in &archive.provenance.defaults_then {
        if !definition.set.contains_key(path) {
            definition.set.insert(path.clone(), value.clone());
        }
    }
    let planned = lay_out(&definition, data_root)?;
    let folder = SweepFolder::new(&archive.path);
    let kept = kept_step_seconds(&folder)?;
    let (mut wrong, mut unchecked, mut counted_before, mut without_scene) = (Vec::new(), Vec::new(), Vec::new(), 0);
    for planned in &planned {
        let what = format!(
            "{} · {} · seed {}",
            label(&planned.place.row, &planned.place.axes),
            planned.scene,
            planned.config.seed
        );
        let same = |known: &&Point| {
            known.scene == planned.scene
                && known.config.seed == planned.config.seed
                && known.places.contains(&planned.place)
        };
        let Some(known) = archive.points.iter().find(same) else {
            wrong.push(format!("sweep.toml asks for {what}, points.json has no such point"));
            continue;
        };
        if planned.budget.is_some() && planned.decay_steps.is_none() && !known.without_budget {
            without_scene += 1;
            continue;
        }
        let expected = match point(planned, &kept) {
            Ok(expected) => expected,
            Err(_) => {
                let steps =
                    format!("{} of {}", known.config.train.steps, label(&planned.place.row, &planned.place.axes));
                if !unchecked.contains(&steps) {
                    unchecked.push(steps);
                }
                point(planned, &as_known(planned, known))?
            }
        };
        let steps_now = expected.config.train.steps;
        let expected = id(archive, &expected);
        if expected == known.id {
            continue;
        }
        if as_counted_before(planned)?.is_some_and(|before| id(archive, &before) == known.id) {
            let (row, steps) = (label(&planned.place.row, &planned.place.axes), known.config.train.steps);
            let steps = format!("{steps} of {row}, now {steps_now}");
            if !counted_before.contains(&steps) {
                counted_before.push(steps);
            }
        } else {
            wrong.push(format!("sweep.toml makes {expected} of {what}, points.json has {}", known.id));
        }
    }
    let places: usize = archive.points.iter().map(|point| point.places.len()).sum();
    if places > planned.len() {
        wrong.push(format!("points.json has {places} places, sweep.toml asks for {}", planned.len()));
    }
    findings.of(format!("sweep.toml asks for these {} places", planned.len()), wrong);
    if without_scene > 0 {
        findings.not_checked(format!(
            "{without_scene} places whose budget hangs on a scene that is not below --data-root (AUGNERF_DATA)"
        ));
    }
    if !counted_before.is_empty() {
        findings.holds(format!(
            "steps from a budget in evaluations, by a revision that counted a pass that only places samples as a trained one: {}",
            counted_before.join(", ")
        ));
    }
    if !unchecked.is_empty() {
        findings.not_checked(format!(
            "steps from a budget in seconds, whose step times are not kept: {}",
            unchecked.join(", ")
        ));
    }
    Ok(())
}

/// The point with a budget of evaluations as earlier revisions counted them; none without such a budget.
fn as_counted_before(planned: &PlannedRun) -> Result<Option<Point>> {
    let Some((BudgetKind::Evaluations, like)) = &planned.budget else { return Ok(None) };
    let budget = Some((BudgetKind::Seconds, like.clone()));
    point(&PlannedRun { budget, ..planned.clone() }, &PlacingCountedAsTrained).map(Some)
}

/// Step times at which a point has the steps that it is known by.
struct AsKnown {
    own: String,
    other_over_own: f64,
}

fn as_known(planned: &PlannedRun, known: &Point) -> AsKnown {
    let like = planned.budget.as_ref().map_or(1, |(_, like)| like.train.steps);
    AsKnown { own: planned.config.step_shape(), other_over_own: known.config.train.steps as f64 / like as f64 }
}

impl StepCosts for AsKnown {
    fn seconds_per_step(&self, config: &Config) -> Result<f64> {
        Ok(if config.step_shape() == self.own { 1.0 } else { self.other_over_own })
    }
}
