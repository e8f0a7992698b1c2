//! Comparisons over sweeps or scenes: differences with their intervals, one line each.

use super::differences::{Differences, MARKS, NOT_SHOWN, colour};
use super::{Figure, metric_label};
use crate::draw::canvas::{Anchor, Colour, GREY, TEXT};
use crate::report::tables::Judgement;
use crate::report::{Compared, Comparisons, Unit, distinct};

/// Draws the differences of all lines, with each scene's, or returns `None` without lines.
pub fn comparisons_figure(all: &Comparisons) -> Option<Figure> {
    if all.lines.is_empty() {
        return None;
    }
    let lines = all.best_first();
    let stated = distinct(lines.iter().filter(|line| line.comparison.is_some()).map(|line| line.margin()));
    let margin = if let [all] = stated[..] { all } else { None };
    let metric = metric_label(&all.metric);
    let figure = Differences {
        title: all.title(),
        metric: &all.metric,
        head: match all.unit {
            Unit::Sweep => format!("{} minus {}: difference in {metric}", all.row, all.baseline),
            Unit::Scene => format!("difference in {metric} to {}", all.baseline),
        },
        lines: lines.iter().map(|line| (line.name.clone(), all.judged(line))).collect(),
        values: lines.iter().flat_map(|line| shown(all, line)).collect(),
        margin,
        caption: caption(all, margin),
    };
    Some(figure.figure(|drawing, scale, y, index| {
        let line = lines[index];
        for unit in line.units().iter().flatten() {
            drawing.dot((scale.x(unit.mean), y), 2.5, GREY, 0.4);
        }
        if let Some((ends, colour)) = thin(all, line) {
            scale.whiskers(drawing, y, ends, colour);
        }
        match &line.comparison {
            Some(comparison) => scale.difference(drawing, y, &all.metric, comparison),
            None => drawing.text((scale.left + 6.0, y), &all.judged(line), TEXT, Anchor::Left, GREY),
        }
    }))
}

/// Returns the second interval of a line and its colour: that of all sweeps at once, or that of one more scene.
fn thin(all: &Comparisons, line: &Compared) -> Option<((f64, f64), Colour)> {
    match &line.over {
        Some(over) => Some((over.prediction?, GREY)),
        None => Some((line.comparison?.simultaneous?, colour(Judgement::of(&all.metric, line.comparison.as_ref()?)))),
    }
}

/// Returns all that a line draws.
fn shown(all: &Comparisons, line: &Compared) -> Vec<f64> {
    let own = line.comparison.map(|found| found.interval.unwrap_or((found.difference, found.difference)));
    let ends = own.into_iter().chain(thin(all, line).map(|(ends, _)| ends));
    ends.flat_map(|(low, high)| [low, high]).chain(line.units().iter().flatten().map(|unit| unit.mean)).collect()
}

fn caption(all: &Comparisons, margin: Option<f64>) -> String {
    let (marks, family, states) = match all.unit {
        Unit::Sweep => (
            "Marks are mean differences, paired by seed, with their 95 % Student t intervals; thin lines are intervals that \
             hold with 95 % for all experiments at once (Bonferroni).",
            "these experiments",
            "all experiments state",
        ),
        Unit::Scene => (
            "Faint dots are scenes, each the mean difference over its seeds. Marks are means over scenes with their 95 % Student \
             t intervals. Thin lines are 95 % prediction intervals of one more scene.",
            "the rows",
            "the sweep states",
        ),
    };
    let mut text = format!("{marks} {MARKS} {family}. {NOT_SHOWN}");
    if all.unit == Unit::Sweep && all.lines.iter().any(|line| line.margin().is_some()) {
        text += " Equivalent: within a margin that the sweep states (two one-sided tests, Holm); a gain of it is ruled out \
                 where all of the thin line is worse.";
    }
    if let Some(margin) = margin {
        text += &format!(" Dashed: the margin of {margin} that {states}.");
    }
    text
}
