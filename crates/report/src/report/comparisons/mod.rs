//! Rows compared with a baseline over several scenes or sweeps: one line each, corrected over all of them. Tables have
//! paired the seeds.

mod files;
#[cfg(test)]
mod tests;

use super::distinct;
use super::over_units::{Components, Seeds, SignTest, components, hodges_lehmann, prediction, sign_test, to_best};
use super::tables::{Comparison, Judgement, Line, Table, correct, firsts, joint};
use crate::metrics::{Direction, Metric};

/// What a comparison's lines are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// One row in each sweep, with seeds as observations.
    Sweep,
    /// All rows over scenes, of which each is one observation: the mean over its seeds.
    Scene,
}

/// The comparisons of one metric.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparisons {
    /// What the lines are.
    pub unit: Unit,
    /// The row that is compared in each sweep; empty over scenes.
    pub row: String,
    /// The row that all lines are compared with.
    pub baseline: String,
    /// Key of the metric.
    pub metric: String,
    /// The scenes, in the order of [`OverScenes::units`].
    pub scenes: Vec<String>,
    /// Lowest and highest of how often a training pixel was seen; `None` if it is unknown.
    pub epochs: Option<(f64, f64)>,
    /// The comparisons.
    pub lines: Vec<Compared>,
    /// As [`OverScenes::to_best`], of the baseline.
    pub baseline_to_best: Option<(f64, f64)>,
    /// As [`OverScenes::no_better_than_one_colour`], of the baseline.
    pub baseline_of_one_colour: Vec<Option<(usize, usize)>>,
}

/// One comparison.
#[derive(Clone, Debug, PartialEq)]
pub struct Compared {
    /// What readers call it: the row with its axis values, or an experiment such as `fern, 8 views`.
    pub name: String,
    /// Its first cells in a CSV file, each with its column.
    pub place: Vec<(&'static str, String)>,
    /// The difference, corrected over the lines. `None` if nothing has both rows.
    pub comparison: Option<Comparison>,
    /// What it lacks, for readers.
    pub unfinished: Option<String>,
    /// What only scenes have.
    pub over: Option<OverScenes>,
}

/// Statistics of a row's differences over scenes.
#[derive(Clone, Debug, PartialEq)]
pub struct OverScenes {
    /// The differences of each scene over its seeds; `None` where no seed has both rows.
    pub units: Vec<Option<Seeds>>,
    /// Scenes above and below the baseline.
    pub signs: Option<SignTest>,
    /// Hodges-Lehmann estimate and its 95 % interval.
    pub median: Option<(f64, Option<(f64, f64)>)>,
    /// Ends of the 95 % prediction interval of the same mean on one more scene.
    pub prediction: Option<(f64, f64)>,
    /// Standard deviations between scenes and, in them, between seeds.
    pub components: Option<Components>,
    /// Ends of the interval of the row's mean minus the best other row's, in the better direction, the baseline among them
    /// (Hsu's). `None` if a row lacks a point.
    pub to_best: Option<(f64, f64)>,
    /// How many of each scene's seeds are no better than one colour, of how many; `None` where that was not measured.
    pub no_better_than_one_colour: Vec<Option<(usize, usize)>>,
}

impl Comparisons {
    /// Compares `row` with `baseline` in each of several tables, whose first metric is the compared one and in which `row` has that
    /// baseline. `labels` are what some tables are called instead of scene and number of views.
    pub fn over_sweeps(row: &str, baseline: &str, tables: &[Table], labels: &[(String, String)]) -> Comparisons {
        let of_row = |table| -> Vec<(&Table, &Line)> {
            let table: &Table = table;
            table.lines.iter().filter(|line| line.row == row).map(|line| (table, line)).collect()
        };
        let all: Vec<(&Table, &Line)> = tables.iter().flat_map(of_row).collect();
        let with_axes = |name: String, line: &Line| match line.axes.as_str() {
            "" => name,
            axes => format!("{name}, {axes}"),
        };
        let plain: Vec<String> = all.iter().map(|(_, line)| with_axes(scene_and_views(line), line)).collect();
        let name = |(table, line): (&Table, &Line), plain_name: &String| {
            let several = all.iter().any(|(other, its)| other.name == table.name && its.scene != line.scene);
            let name = match labels.iter().find(|(sweep, _)| *sweep == table.name) {
                Some((_, label)) if several => format!("{label}, {}", line.scene),
                Some((_, label)) => label.clone(),
                None if plain.iter().filter(|other| *other == plain_name).count() > 1 => {
                    format!("{}, {}", scene_and_views(line), table.name)
                }
                None => scene_and_views(line),
            };
            with_axes(name, line)
        };
        let lines = all.iter().zip(&plain).map(|(own, plain)| in_sweep(name(*own, plain), baseline, *own)).collect();
        Comparisons::new((Unit::Sweep, row, baseline), vec![], lines, tables)
    }

    /// Compares each other row with `baseline` over all scenes of tables, whose first metric is the compared one and in which rows
    /// have that baseline.
    pub fn over_scenes(baseline: &str, tables: &[Table]) -> Comparisons {
        let all: Vec<&Line> = tables.iter().flat_map(|table| &table.lines).filter(|line| !line.quoted).collect();
        let scenes = distinct(all.iter().map(|line| line.scene.clone()));
        let (own, others): (Vec<&Line>, Vec<&Line>) = all.into_iter().partition(|line| line.row == baseline);
        let is_compared =
            |line: &&&Line| line.baseline.as_ref().is_none_or(|label| own.iter().any(|own| own.label == *label));
        let rows = distinct(others.iter().filter(is_compared).map(|line| line.label.as_str()));
        let metric = tables.first().map_or("", |table| table.metrics[0].as_str());
        // Of all points that any row has.
        let most = |scene: &String| {
            let lines = own.iter().chain(&others).filter(|line| line.scene == *scene);
            lines.map(|line| line.points).max().unwrap_or(0)
        };
        let expected = scenes.iter().map(most).sum();
        let line = |label| {
            let find = |scene: &String| others.iter().find(|line| line.scene == *scene && line.label == label).copied();
            let lines: Vec<Option<&Line>> = scenes.iter().map(find).collect();
            over_scenes(label, (baseline, metric), &lines, expected)
        };
        let lines = rows.into_iter().map(line).collect();
        let of_one_colour = |scene: &String| of_one_colour(own.iter().filter(|line| line.scene == *scene).copied());
        let baseline_of_one_colour = scenes.iter().map(of_one_colour).collect();
        let mut found = Comparisons::new((Unit::Scene, "", baseline), scenes, lines, tables);
        found.baseline_of_one_colour = baseline_of_one_colour;
        found.find_best();
        found
    }

    fn new(
        (unit, row, baseline): (Unit, &str, &str),
        scenes: Vec<String>,
        mut lines: Vec<Compared>,
        tables: &[Table],
    ) -> Comparisons {
        // Rows with the same numbers are one training under several names, and one test; sweeps are tests of their own.
        let units = |line: &Compared| line.over.as_ref().map(|over| over.units.clone());
        let same = |a: &Compared, b: &Compared| unit == Unit::Scene && units(a) == units(b);
        let firsts = firsts(&lines, same);
        correct(&mut lines.iter_mut().map(|line| line.comparison.as_mut()).collect::<Vec<_>>(), &firsts);
        Comparisons {
            unit,
            row: row.into(),
            baseline: baseline.into(),
            metric: tables.first().and_then(|table| table.metrics.first()).cloned().unwrap_or_default(),
            scenes,
            epochs: joint(tables.iter().flat_map(|table| &table.lines).filter_map(|line| line.epochs)),
            lines,
            baseline_to_best: None,
            baseline_of_one_colour: Vec::new(),
        }
    }

    /// Returns what is compared, for readers.
    pub fn title(&self) -> String {
        match self.unit {
            Unit::Sweep => format!("{} against {}", self.row, self.baseline),
            Unit::Scene => format!("Rows against {} over {} scenes", self.baseline, self.scenes.len()),
        }
    }

    fn direction(&self) -> Option<Direction> {
        Some(Metric::find(&self.metric)?.direction)
    }

    fn find_best(&mut self) {
        let Some(sign) = self.direction().and_then(Direction::sign) else { return };
        // Rows that lack points would be ranked by other scenes or seeds than the rest.
        if self.lines.iter().any(|line| line.unfinished.is_some()) {
            return;
        }
        let means = |line: &Compared| line.units().iter().map(|unit| Some(sign * unit.as_ref()?.mean)).collect();
        let Some(mut rows) = self.lines.iter().map(means).collect::<Option<Vec<Vec<f64>>>>() else { return };
        rows.push(vec![0.0; self.scenes.len()]);
        let Some(mut ends) = to_best(&rows) else { return };
        self.baseline_to_best = ends.pop();
        for (over, ends) in self.lines.iter_mut().filter_map(|line| line.over.as_mut()).zip(ends) {
            over.to_best = Some(ends);
        }
    }

    /// Returns rows over scenes with the best mean first, and those without a difference last. Sweeps stay in their order.
    pub fn best_first(&self) -> Vec<&Compared> {
        let sign = self.direction().and_then(Direction::sign).unwrap_or(1.0);
        let gain = |line: &Compared| line.comparison.map_or(f64::NEG_INFINITY, |found| sign * found.difference);
        let mut lines: Vec<&Compared> = self.lines.iter().collect();
        if self.unit == Unit::Scene {
            lines.sort_by(|a, b| gain(b).total_cmp(&gain(a)));
        }
        lines
    }

    /// Returns whether all of a line's simultaneous interval is a gain above the margin. `None` without a margin or an interval,
    /// or if the metric has no better direction.
    pub fn matters(&self, line: &Compared) -> Option<bool> {
        let (low, _) = self.direction()?.gains(line.comparison?.simultaneous?)?;
        Some(low > line.margin()?)
    }

    /// Returns whether all of a line's simultaneous interval is worse than a gain of the margin. `None` as for
    /// [`Comparisons::matters`].
    pub fn is_ruled_out(&self, line: &Compared) -> Option<bool> {
        let (_, high) = self.direction()?.gains(line.comparison?.simultaneous?)?;
        Some(high < line.margin()?)
    }

    /// Returns what a figure says of a line, whose mark shows where no difference is shown.
    pub(super) fn judged(&self, line: &Compared) -> String {
        let judged = |comparison| self.said(line, Judgement::of(&self.metric, comparison).name());
        line.comparison.as_ref().map_or_else(|| self.nothing().into(), judged)
    }

    /// Returns what a table says of a line.
    pub(super) fn verdict(&self, line: &Compared) -> String {
        let Some(comparison) = &line.comparison else {
            return [self.nothing()].into_iter().chain(line.unfinished.as_deref()).collect::<Vec<&str>>().join("; ");
        };
        // The line's own interval excludes 0, and its p is not significant after the correction.
        let unsure = if comparison.p_holm.is_some() { "not significant" } else { "" };
        self.said(line, comparison.verdict().map_or(unsure, |verdict| verdict.name()))
    }

    /// Returns why a line has no difference.
    fn nothing(&self) -> &'static str {
        match self.unit {
            Unit::Sweep => "no seed has both rows",
            Unit::Scene => "no scene has both rows",
        }
    }

    /// Returns what is said of a line whose difference has a verdict of this name.
    fn said(&self, line: &Compared, verdict: &str) -> String {
        let margin = line.margin().unwrap_or_default();
        let is_equivalent = line.comparison.is_some_and(|comparison| comparison.is_equivalent());
        let words = [
            (!verdict.is_empty()).then(|| verdict.to_string()),
            (self.unit == Unit::Scene && self.matters(line) == Some(true)).then(|| "matters".into()),
            is_equivalent.then(|| format!("equivalent within {margin}")),
            (self.is_ruled_out(line) == Some(true)).then(|| format!("a gain of {margin} is ruled out")),
            line.unfinished.as_ref().map(|lacking| format!("UNFINISHED: {lacking}")),
        ];
        words.into_iter().flatten().collect::<Vec<String>>().join(", ")
    }
}

impl Compared {
    /// Returns the margin that the sweep states: smaller differences do not matter.
    pub fn margin(&self) -> Option<f64> {
        Some(self.comparison?.equivalence?.margin)
    }

    /// Returns the differences of each scene; empty for a sweep.
    pub(super) fn units(&self) -> &[Option<Seeds>] {
        self.over.as_ref().map_or(&[], |over| &over.units)
    }
}

fn in_sweep(name: String, baseline: &str, (table, line): (&Table, &Line)) -> Compared {
    let is_baseline = |other: &&Line| other.scene == line.scene && Some(&other.label) == line.baseline.as_ref();
    let lacking = table.lines.iter().find(is_baseline).filter(|other| other.unfinished());
    let status = match lacking {
        Some(other) => format!("{}; {baseline}: {}", line.status, other.status),
        None => line.status.clone(),
    };
    let pairs = line.cells[0].comparison.map_or(0, |comparison| comparison.pairs).to_string();
    let place = [
        ("sweep", table.name.clone()),
        ("scene", line.scene.clone()),
        ("axes", line.axes.clone()),
        ("status", status.clone()),
        ("compared", line.row.clone()),
        ("baseline", baseline.into()),
        ("metric", line.cells[0].metric.clone()),
        ("pairs", pairs),
    ];
    Compared {
        name,
        place: place.to_vec(),
        comparison: line.cells[0].comparison,
        unfinished: (line.unfinished() || lacking.is_some()).then_some(status),
        over: None,
    }
}

/// Returns `fern, 8 views`.
fn scene_and_views(line: &Line) -> String {
    match line.protocol("views_trained") {
        "" => line.scene.clone(),
        "1" => format!("{}, 1 view", line.scene),
        views => format!("{}, {views} views", line.scene),
    }
}

/// Compares a row on each scene on which it has a line; `expected` pairs of scene and seed are to come in all.
fn over_scenes(label: &str, (baseline, metric): (&str, &str), lines: &[Option<&Line>], expected: usize) -> Compared {
    let found = |line: &Option<&Line>| line.and_then(|line| line.cells[0].comparison);
    let seeds = |comparison: Comparison| {
        let Comparison { pairs: count, difference: mean, deviation, .. } = comparison;
        Some(Seeds { count, mean, deviation }).filter(|seeds| seeds.mean.is_finite())
    };
    let units: Vec<Option<Seeds>> = lines.iter().map(|line| found(line).and_then(seeds)).collect();
    let known: Vec<Seeds> = units.iter().flatten().copied().collect();
    let means: Vec<f64> = known.iter().map(|unit| unit.mean).collect();
    let margin = lines.iter().find_map(|line| Some(found(line)?.equivalence?.margin));
    let pairs = known.iter().map(|unit| unit.count).sum::<usize>();
    let lacking = expected.saturating_sub(pairs);
    let place = [
        ("row", label.to_string()),
        ("baseline", baseline.into()),
        ("metric", metric.into()),
        ("scenes", means.len().to_string()),
        ("seeds", pairs.to_string()),
        ("lacking", lacking.to_string()),
    ];
    Compared {
        name: label.into(),
        place: place.to_vec(),
        comparison: Comparison::new(&means, margin),
        unfinished: (lacking > 0).then(|| format!("{lacking} pairs of scene and seed lack a number")),
        over: Some(OverScenes {
            units,
            signs: sign_test(&means),
            median: hodges_lehmann(&means),
            prediction: prediction(&means),
            components: components(&known),
            to_best: None,
            no_better_than_one_colour: lines.iter().map(|line| of_one_colour(line.iter().copied())).collect(),
        }),
    }
}

/// Returns how many of the seeds of lines are no better than one colour, and of how many; `None` where that was measured of none.
fn of_one_colour<'a>(lines: impl Iterator<Item = &'a Line>) -> Option<(usize, usize)> {
    let measured = lines.filter(|line| line.floor_psnr.is_some());
    let counts = measured.map(|line| (line.no_better_than_one_colour.len(), line.ids.len()));
    counts.reduce(|a, b| (a.0 + b.0, a.1 + b.1))
}
