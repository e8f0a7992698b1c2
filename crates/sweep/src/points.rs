//! Points of a sweep: positions in its table, each with a configuration that several rows may share.

use std::collections::{HashMap, HashSet};
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::base::{Error, Result};
use crate::report::label;
use crate::settings::Config;

use super::budget::steps_within;
use super::definition::{BudgetKind, Definition, is_false};
use super::layout::{Layout, PlannedRun, Refused, TablePosition, missing, scene_folder};
use super::step_seconds::{MeasureSteps, StepSeconds};

/// Suffix of the name of a point whose budget is unknown.
const WITHOUT_BUDGET: &str = "-without-budget";

/// One training: a configuration with its seed. Rows with equal configurations share it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Point {
    /// Content hash of the configuration; names the point's folder.
    pub id: String,
    /// The scene's name.
    pub scene: String,
    /// The scene as the definition names it.
    pub source: String,
    /// The configuration before the scene's values fill it.
    pub config: Config,
    /// Its positions in the table; at least one.
    pub places: Vec<TablePosition>,
    /// It runs on the processor, whatever device others run on.
    #[serde(default, skip_serializing_if = "is_false")]
    pub on_cpu: bool,
    /// The budget needs the scene, which is missing; the steps are the row's own.
    pub without_budget: bool,
    /// Why its scene cannot be read, or `None` if it can.
    #[serde(skip)]
    pub no_data: Option<String>,
}

impl Point {
    /// Returns a label for people: row, scene, seed.
    pub fn label(&self) -> String {
        format!("{} · seed {}", self.cell(), self.config.seed)
    }

    /// Returns the same without the seed.
    pub fn cell(&self) -> String {
        let place = &self.places[0];
        format!("{} · {}", label(&place.row, &place.axes), self.scene)
    }

    /// Locates the scene below `data_root`.
    pub(super) fn locate(&mut self, data_root: Option<&Path>) {
        self.config.data.dir = scene_folder(&self.source, data_root).to_string_lossy().into_owned();
        self.no_data = missing(&self.config);
    }
}

/// Expands a definition to its points, with the steps of their budgets. `measure` gives the seconds of steps for budgets
/// in seconds.
///
/// ```
/// # mod augnerf { pub use augnerf_base as base; pub use augnerf_sweep as sweep; }
/// use augnerf::sweep::{Definition, expand};
///
/// let text = r#"
/// title = "Does worst-case augmentation help?"
/// preset = "smoke"
/// scenes = ["builtin"]
/// seeds = [0, 1, 2]
/// baseline = "NeRF"
/// [[row]]
/// name = "NeRF"
/// [[row]]
/// name = "Aug-NeRF"
/// set = { method = "aug-nerf" }
/// "#;
/// let definition = Definition::parse(text, "sweep.toml")?;
/// let points = expand(&definition, None, &|configs| Ok(configs.iter().map(|config| (*config, 1.0)).collect()))?;
/// assert_eq!(points.len(), 2 * 3);
/// assert_eq!(points[0].label(), "NeRF · builtin · seed 0");
/// # Ok::<(), augnerf::base::Error>(())
/// ```
///
/// # Errors
/// Rows have wrong settings; the error names all of these rows.
pub fn expand(definition: &Definition, data_root: Option<&Path>, measure: &MeasureSteps) -> Result<Vec<Point>> {
    Layout::of(definition, data_root)?.points(measure)
}

impl Layout {
    /// Applies the budgets. Runs with equal configurations share a point.
    ///
    /// # Errors
    /// Rows are refused, two rows are the same configuration, or the steps of rows do not suit their settings.
    pub fn points(&self, measure: &MeasureSteps) -> Result<Vec<Point>> {
        self.refused.clone().check()?;
        let (points, refused) = self.other_points(measure)?;
        refused.check().map(|()| points)
    }

    /// Does the same for the rows that are not refused, and returns all refused rows.
    pub fn other_points(&self, measure: &MeasureSteps) -> Result<(Vec<Point>, Refused)> {
        let timed = self.timed();
        let seconds = if timed.is_empty() { StepSeconds::default() } else { measure(&timed)? };
        let (mut points, mut refused) = (Vec::<Point>::new(), self.refused.clone());
        let mut known: HashMap<String, (usize, Vec<&PlannedRun>)> = HashMap::new();
        for planned in &self.planned {
            let valid = |point: Point| {
                point.config.validate()?;
                let others = || known.get(&point.id).into_iter().flat_map(|(_, others)| others);
                if let Some(other) = others().find(|other| other.point.on_cpu != point.on_cpu) {
                    return Err(Error::Config(format!(
                        "rows '{}' and '{}' have the same configuration, so they share one training on one device; name the device in both \
                         or in none",
                        other.place().row,
                        planned.place().row
                    )));
                }
                match others().find(|other| is_same_row(other, planned)) {
                    Some(same) => Err(Error::Config(format!(
                        "rows '{}' and '{}' have the same configuration; change or remove one",
                        same.place().row,
                        planned.place().row
                    ))),
                    None => Ok(point),
                }
            };
            let TablePosition { row, axes } = planned.place();
            let point = planned.within_budget(&seconds).and_then(valid);
            let Some(point) = refused.unless(point, &[&label(row, axes)], &planned.point.scene)? else { continue };
            match known.get_mut(&point.id) {
                Some((index, others)) => {
                    others.push(planned);
                    points[*index].places.extend(point.places);
                }
                None => {
                    known.insert(point.id.clone(), (points.len(), vec![planned]));
                    points.push(point);
                }
            }
        }
        // What does not need the device comes last.
        points.sort_by_key(|point| point.on_cpu);
        Ok((points, refused))
    }

    /// Returns one configuration of each shape whose seconds a budget needs.
    fn timed(&self) -> Vec<&Config> {
        let mut known = HashSet::new();
        let in_seconds = self.planned.iter().filter_map(|planned| match (&planned.budget, planned.decay_steps) {
            (Some((BudgetKind::Seconds, like)), Some(_)) => Some([&planned.point.config, like]),
            _ => None,
        });
        in_seconds.flatten().filter(|config| known.insert(config.step_shape())).collect()
    }
}

/// Returns whether two rows with the same configuration are a mistake. Budgets of two kinds may give the same steps.
fn is_same_row(a: &PlannedRun, b: &PlannedRun) -> bool {
    let kind = |planned: &PlannedRun| planned.budget.as_ref().map(|(kind, _)| *kind);
    let budgets_differ = kind(a).is_some() && kind(b).is_some() && kind(a) != kind(b);
    a.place().row != b.place().row && a.place().axes == b.place().axes && !budgets_differ
}

impl PlannedRun {
    fn place(&self) -> &TablePosition {
        &self.point.places[0]
    }

    /// Returns the point with the steps of its budget.
    fn within_budget(&self, seconds: &StepSeconds) -> Result<Point> {
        let mut point = self.point.clone();
        if let (Some((kind, like)), Some(decay_steps)) = (&self.budget, self.decay_steps) {
            let config = &mut point.config;
            let steps = steps_within(*kind, config, like, seconds)?;
            // The decay of the learning rate is stretched with the steps. Without it a longer run would not learn at its
            // end, as a shorter one would not with encodings that open after it.
            let stretch = steps as f64 / config.train.steps as f64;
            let stretched = |of: u64| (of as f64 * stretch).round() as u64;
            config.train.decay_steps = Some(stretched(decay_steps).max(1));
            config.field.frequency_steps = stretched(config.field.frequency_steps).min(steps);
            config.sampling.anneal_steps = stretched(config.sampling.anneal_steps).min(steps);
            config.train.steps = steps;
        }
        // The name differs from that of the row without a budget.
        point.id = point.config.hash() + if point.without_budget { WITHOUT_BUDGET } else { "" };
        Ok(point)
    }
}
