//! Rows against a baseline over scenes: one line a row, the best first, with each scene's difference.

use super::differences::{Differences, MARKS, NOT_SHOWN, Scale};
use super::{Figure, metric_label};
use crate::base::Result;
use crate::draw::canvas::{Canvas, GREY, Width};
use crate::report::statistics::mean;
use crate::report::{OverScenes, RowOverScenes};

/// Draws the differences of all rows, or returns `None` without rows.
pub fn over_scenes_figure(over: &OverScenes, width: Width) -> Result<Option<Figure>> {
    if over.rows.is_empty() {
        return Ok(None);
    }
    let rows = over.best_first();
    let figure = Differences {
        title: format!("Rows against {} over {} scenes", over.baseline, over.scenes.len()),
        metric: &over.metric,
        head: format!("difference in {} to {}", metric_label(&over.metric), over.baseline),
        lines: rows.iter().map(|row| (row.row.clone(), over.judged(row))).collect(),
        values: rows.iter().copied().flat_map(shown).collect(),
        margin: over.margin,
        caption: caption(over),
    };
    figure.figure(width, |drawing, scale, y, index| draw_row(drawing, scale, y, over, rows[index]))
}

fn draw_row(drawing: &mut Canvas, scale: &Scale, y: f64, over: &OverScenes, row: &RowOverScenes) {
    for value in row.seeds.iter().filter_map(|seeds| mean(seeds)) {
        drawing.dot((scale.x(value), y), 2.5, GREY, 0.4);
    }
    if let Some(ends) = row.prediction {
        scale.whiskers(drawing, y, ends, GREY);
    }
    if let Some(comparison) = &row.comparison {
        scale.difference(drawing, y, &over.metric, comparison);
    }
}

/// Returns all that a row draws.
fn shown(row: &RowOverScenes) -> impl Iterator<Item = f64> {
    let ends = row.prediction.into_iter().chain(row.comparison.and_then(|comparison| comparison.interval));
    row.seeds.iter().filter_map(|seeds| mean(seeds)).chain(ends.flat_map(|(low, high)| [low, high]))
}

fn caption(over: &OverScenes) -> String {
    let mut text = format!(
        "Faint dots are scenes, each the mean difference over its seeds. Marks are means over scenes with their 95 % Student t \
         intervals. Thin lines are 95 % prediction intervals of one more scene. {MARKS} the rows. {NOT_SHOWN}"
    );
    if let Some(margin) = over.margin {
        text += &format!(" Dashed: the margin of {margin} that the sweep states.");
    }
    text
}
