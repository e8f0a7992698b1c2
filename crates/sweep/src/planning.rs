//! The points of a sweep, decided once when its folder is created and read from there afterwards.

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::path::Path;
use std::time::{Duration, Instant};

use crate::base::{Error, Result};
use crate::settings::Config;

use super::budget::evaluations_per_step;
use super::definition::Definition;
use super::differences::differences;
use super::folder::{Change, SweepFolder};
use super::layout::{Layout, Refused};
use super::points::Point;
use super::step_seconds::{MeasureSteps, StepSeconds};
use super::training::{Cost, Trainings};

/// Returns the points of `folder`. A new folder is created with those of `definition`. A folder of another definition
/// is an error, unless `extend` is set or its points are the same. `measure` gives the seconds of steps for budgets in
/// seconds. `check` is called with new points and the rows that are refused so far, before anything is written. It names
/// these rows with those that it refuses.
pub fn begin(
    folder: &SweepFolder,
    definition: &Definition,
    data_root: Option<&Path>,
    extend: bool,
    measure: &MeasureSteps,
    check: &dyn Fn(&[Point], Refused) -> Result<()>,
) -> Result<Vec<Point>> {
    let layout = Layout::of(definition, data_root)?;
    let (tried, refused) = layout.other_points(&arbitrary)?;
    // A wrong definition must leave no folder.
    match folder.compare(definition)? {
        Change::New => check(&tried, refused.clone())?,
        Change::Changed if extend && !refused.is_empty() => check(&tried, refused.clone())?,
        _ => {}
    }
    refused.check()?;
    let _lock = folder.lock()?;
    let change = folder.compare(definition)?;
    let begun = folder.points(data_root)?;
    match (change, begun) {
        (Change::None, Some(points)) if !budgets_can_be_applied(&points) => return Ok(points),
        (Change::Changed, begun) => match reworded(folder, definition, &layout, &begun.unwrap_or_default())? {
            Ok(points) => {
                folder.begin(definition, &points, data_root)?;
                return Ok(points);
            }
            Err(refusal) if !extend => return Err(refusal),
            Err(_) => check(&tried, Refused::default())?,
        },
        _ => {}
    }
    let points = layout.points(&|configs| StepSeconds::kept(&folder.step_seconds(), configs, measure))?;
    folder.begin(definition, &points, data_root)?;
    Ok(points)
}

/// Returns the points that a definition's folder would get. `check` is called as by [`begin`], before anything is measured.
///
/// # Errors
/// Those of the definition and of `check`.
pub fn plan(
    definition: &Definition,
    data_root: Option<&Path>,
    measure: &MeasureSteps,
    check: &dyn Fn(&[Point], Refused) -> Result<()>,
) -> Result<Vec<Point>> {
    let layout = Layout::of(definition, data_root)?;
    let (tried, refused) = layout.other_points(&arbitrary)?;
    check(&tried, refused.clone())?;
    refused.check()?;
    layout.points(measure)
}

/// Points of equal cost: the same number of steps and the same shape.
pub struct CostGroup<'a> {
    /// The points.
    pub points: &'a [&'a Point],
    /// Cost of their shape on this machine.
    pub cost: Cost,
    /// The cost was measured; otherwise it follows from a measured one by the evaluations of the networks.
    pub measured: bool,
    /// Seconds of one point.
    pub seconds: f64,
}

/// Measures the cost of points on this machine, each shape once. `each` receives a group as soon as its cost is known. When
/// the first shape is measured and `limit` is over, the costs of the others are estimated. Shapes of which no scene can be
/// read are left out.
pub fn plan_costs(
    points: &[&Point],
    trainings: &Trainings,
    limit: Duration,
    mut each: impl FnMut(CostGroup) -> Result<()>,
) -> Result<()> {
    let begun = Instant::now();
    let mut groups: BTreeMap<(bool, String, u64), Vec<&Point>> = BTreeMap::new();
    for point in points {
        groups.entry((point.on_cpu, point.config.step_shape(), point.config.train.steps)).or_default().push(point);
    }
    let mut known: Option<(&str, &Config, Cost)> = None;
    let mut estimated: Option<&str> = None;
    // Groups of one shape are adjacent. Nothing that is known of one device tells of the other.
    let mut device = None;
    for ((on_cpu, shape, steps), points) in &groups {
        if device.replace(on_cpu) != Some(on_cpu) {
            (known, estimated) = (None, None);
        }
        let mut config = &points[0].config;
        let cost = match known {
            Some((same, _, cost)) if same == shape => cost,
            Some((_, other, cost)) if estimated == Some(shape) || begun.elapsed() > limit => {
                estimated = Some(shape);
                cost.scaled(evaluations_per_step(config) / evaluations_per_step(other))
            }
            _ => match first_cost(points, trainings)? {
                Some((measured, cost)) => {
                    config = measured;
                    cost
                }
                None => continue,
            },
        };
        let measured = estimated != Some(shape);
        if measured {
            known = Some((shape, config, cost));
        }
        each(CostGroup { points, cost, measured, seconds: cost.seconds(*steps) })?;
    }
    Ok(())
}

/// Measures the first point whose scene can be read, or returns `None` if there is none: such points fail when they run.
fn first_cost<'a>(points: &[&'a Point], trainings: &Trainings) -> Result<Option<(&'a Config, Cost)>> {
    let mut unreadable = BTreeSet::new();
    for point in points {
        if unreadable.contains(&point.scene) {
            continue;
        }
        match trainings.cost(point) {
            Ok(cost) => return Ok(Some((&point.config, cost))),
            Err(Error::Data(_)) => _ = unreadable.insert(&point.scene),
            Err(error) => return Err(error),
        }
    }
    Ok(None)
}

/// Returns whether a missing scene has arrived, so that budgets that depend on it are known.
fn budgets_can_be_applied(points: &[Point]) -> bool {
    points.iter().any(|point| point.without_budget && point.no_data.is_none())
}

/// Returns the points if a changed definition has the same points and nothing else differs, otherwise the error that says what
/// differs. Examples are `perturb.levels` in place of the passes of sites, and a new `train.eval_every`, which no hash includes.
fn reworded(
    folder: &SweepFolder,
    definition: &Definition,
    layout: &Layout,
    points: &[Point],
) -> Result<Result<Vec<Point>>> {
    let before = folder.definition()?;
    // Budgets in seconds must be measured first.
    let now = layout.points(&|_| Err(Error::Config("not measured".into()))).ok();
    let without_settings = |definition: &Definition| {
        let mut bare = definition.clone();
        bare.set.clear();
        bare.by_seed.clear();
        bare.by_scene.clear();
        bare.changed.clear();
        bare.row.iter_mut().for_each(|row| row.set.clear());
        bare
    };
    let same = |now: &[Point]| {
        now.len() == points.len() && now.iter().zip(points).all(|(a, b)| (&a.id, &a.places) == (&b.id, &b.places))
    };
    let without_changes = |definition: &Definition| Definition { changed: BTreeMap::new(), ..definition.clone() };
    if without_changes(&before) == without_changes(definition) {
        return Ok(Ok(points.to_vec()));
    }
    if let Some(now) = now.as_ref().filter(|now| same(now))
        && without_settings(&before) == without_settings(definition)
    {
        return Ok(Ok(now.clone()));
    }
    let counted = now.map_or(String::new(), |now| {
        let missing = |from: &[Point], other: &[Point]| {
            let known: HashSet<&str> = other.iter().map(|point| point.id.as_str()).collect();
            from.iter().filter(|point| !known.contains(point.id.as_str())).count()
        };
        match (missing(&now, points), missing(points, &now)) {
            (0, 0) => "; no point is new, so that --extend costs no training".to_string(),
            (new, gone) => format!("; {new} points are new, and {gone} of the old ones are gone"),
        }
    });
    Ok(Err(Error::Config(format!(
        "{} was created with another definition, which differs in {}{counted}. --extend accepts this definition (nothing is \
         deleted); another --name or --out starts a new sweep",
        folder.path().display(),
        differences(&before, definition)
    ))))
}

/// Returns arbitrary seconds that differ between shapes; enough to check a definition.
fn arbitrary(configs: &[&Config]) -> Result<StepSeconds> {
    let seconds = |config: &Config| {
        let digits = u32::from_str_radix(&config.step_shape()[..6], 16).expect("a hexadecimal hash");
        1.0 + f64::from(digits) / f64::from(1 << 24)
    };
    Ok(configs.iter().map(|config| (*config, seconds(config))).collect())
}
