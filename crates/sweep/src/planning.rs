//! The points of a sweep: decided once, when its folder is begun, and read from there afterwards.

use std::collections::{BTreeMap, HashSet};
use std::path::Path;

use crate::base::{Error, Result};
use crate::settings::Config;

use super::budget::StepCosts;
use super::definition::Definition;
use super::folder::{Change, SweepFolder};
use super::layout::{PlannedRun, lay_out};
use super::points::{Point, apply_budgets};
use super::step_seconds::{KeptCosts, Unknown};
use super::training::{Cost, Trainings};

/// The points that `folder` was begun with; a new folder is begun with those of `definition`. A
/// folder of another definition is refused, or with `extend` goes on with this one. `measure` gives
/// seconds of steps, where budgets ask for them.
pub fn begin(
    folder: &SweepFolder,
    definition: &Definition,
    data_root: Option<&Path>,
    extend: bool,
    measure: &dyn StepCosts,
) -> Result<Vec<Point>> {
    // A wrong definition leaves no folder.
    let planned = lay_out(definition, data_root)?;
    apply_budgets(&planned, &Unmeasured)?;
    let _lock = folder.lock()?;
    let change = folder.compare(definition)?;
    let begun = folder.points(data_root)?;
    match (change, begun) {
        (Change::None, Some(points)) if !budgets_can_be_applied(&points) => return Ok(points),
        (Change::Changed, begun) => {
            let before = begun.unwrap_or_default();
            if let Some(points) = reworded(&folder.definition()?, definition, &planned, &before) {
                folder.begin(definition, &points, data_root)?;
                return Ok(points);
            }
            if !extend {
                return Err(refusal(folder, &planned, &before));
            }
        }
        _ => {}
    }
    let costs = KeptCosts::new(folder, measure)?;
    let points = apply_budgets(&planned, &costs)?;
    folder.begin(definition, &points, data_root)?;
    Ok(points)
}

/// Refuses a folder that was begun with another definition, as [`begin`] does without `extend`.
pub fn check_unchanged(folder: &SweepFolder, definition: &Definition, data_root: Option<&Path>) -> Result<()> {
    if folder.compare(definition)? != Change::Changed {
        return Ok(());
    }
    let planned = lay_out(definition, data_root)?;
    let before = folder.points(data_root)?.unwrap_or_default();
    if reworded(&folder.definition()?, definition, &planned, &before).is_some() {
        return Ok(());
    }
    Err(refusal(folder, &planned, &before))
}

/// Points that cost the same: of equal steps and shape.
pub struct CostGroup<'a> {
    /// Points of one shape and number of steps, which cost the same.
    pub points: &'a [&'a Point],
    /// What their shape costs here.
    pub cost: Cost,
    /// Seconds of one of them.
    pub seconds: f64,
}

/// Measures what points cost on this machine, each shape once, and hands each group over as soon as it is known.
pub fn plan_costs(
    points: &[&Point],
    trainings: &Trainings,
    mut each: impl FnMut(CostGroup) -> Result<()>,
) -> Result<()> {
    let mut groups: BTreeMap<(String, u64), Vec<&Point>> = BTreeMap::new();
    for point in points {
        groups.entry((point.config.step_shape(), point.config.train.steps)).or_default().push(point);
    }
    let mut known: Option<(&str, Cost)> = None;
    // Groups of one shape follow one another.
    for ((shape, steps), points) in &groups {
        let cost = match known {
            Some((same, cost)) if same == shape => cost,
            _ => trainings.cost(&points[0].config)?,
        };
        known = Some((shape, cost));
        each(CostGroup { points, cost, seconds: cost.seconds(*steps) })?;
    }
    Ok(())
}

/// A scene has come since, so that budgets which hang on it are known.
fn budgets_can_be_applied(points: &[Point]) -> bool {
    points.iter().any(|point| point.without_budget && point.no_data.is_none())
}

/// The points of a definition that says in other words what `before` said, such as `perturb.levels` in place of sites' passes,
/// or changes what makes no other experiment, such as `train.eval_every`: they are the same points, and nothing else differs.
fn reworded(
    before: &Definition,
    definition: &Definition,
    planned: &[PlannedRun],
    points: &[Point],
) -> Option<Vec<Point>> {
    let without_settings = |definition: &Definition| {
        let mut bare = definition.clone();
        bare.set.clear();
        bare.by_seed.clear();
        bare.changed.clear();
        bare.row.iter_mut().for_each(|row| row.set.clear());
        bare
    };
    let same = |now: &[Point]| {
        now.len() == points.len() && now.iter().zip(points).all(|(a, b)| (&a.id, &a.places) == (&b.id, &b.places))
    };
    if without_settings(before) != without_settings(definition) {
        return None;
    }
    apply_budgets(planned, &Unknown).ok().filter(|now| same(now))
}

fn refusal(folder: &SweepFolder, planned: &[PlannedRun], before: &[Point]) -> Error {
    let counted = match apply_budgets(planned, &Unknown) {
        Ok(now) => {
            let missing = |from: &[Point], other: &[Point]| {
                let known: HashSet<&str> = other.iter().map(|point| point.id.as_str()).collect();
                from.iter().filter(|point| !known.contains(point.id.as_str())).count()
            };
            format!(
                ": this one has {} points that it had not, and lacks {} that it had",
                missing(&now, before),
                missing(before, &now)
            )
        }
        // Budgets in seconds would have to be measured first.
        Err(_) => String::new(),
    };
    Error::Config(format!(
        "{} was begun with another definition{counted}; --extend goes on with this definition (nothing is deleted), \
         another --name or --out starts a new sweep",
        folder.path().display()
    ))
}

/// Any numbers, other ones for other shapes: enough to see whether a definition is right.
struct Unmeasured;

impl StepCosts for Unmeasured {
    fn seconds_per_step(&self, config: &Config) -> Result<f64> {
        let digits = u32::from_str_radix(&config.step_shape()[..6], 16).expect("a hexadecimal hash");
        Ok(1.0 + f64::from(digits) / f64::from(1 << 24))
    }
}
