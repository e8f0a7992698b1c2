//! One comparison of several sweeps: differences with their intervals, one line a block.

use super::differences::{Differences, MARKS, NOT_SHOWN, Scale, colour};
use super::{Figure, metric_label};
use crate::base::Result;
use crate::draw::canvas::{Anchor, Canvas, GREY, TEXT, Width};
use crate::report::tables::Judgement;
use crate::report::{Across, Block, distinct};

/// Draws the differences of all blocks, or returns `None` without blocks.
pub fn across_figure(across: &Across, width: Width) -> Result<Option<Figure>> {
    if across.blocks.is_empty() {
        return Ok(None);
    }
    let margin = margin(across);
    let figure = Differences {
        title: format!("{} against {}", across.row, across.baseline),
        metric: &across.metric,
        head: format!("{} minus {}: difference in {}", across.row, across.baseline, metric_label(&across.metric)),
        lines: across.blocks.iter().map(|block| (block.place(), words(across, block))).collect(),
        values: shown(across).collect(),
        margin,
        caption: caption(across, margin),
    };
    figure.figure(width, |drawing, scale, y, index| draw_block(drawing, scale, y, across, &across.blocks[index]))
}

fn draw_block(drawing: &mut Canvas, scale: &Scale, y: f64, across: &Across, block: &Block) {
    let Some(comparison) = &block.comparison else {
        drawing.text((scale.left + 6.0, y), "no seed has both rows", TEXT, Anchor::Left, GREY);
        return;
    };
    if let Some(ends) = block.simultaneous {
        scale.whiskers(drawing, y, ends, colour(Judgement::of(&across.metric, comparison)));
    }
    scale.difference(drawing, y, &across.metric, comparison);
}

fn words(across: &Across, block: &Block) -> String {
    block.comparison.as_ref().map_or(String::new(), |comparison| across.judged(block, comparison))
}

/// Returns all ends of intervals.
fn shown(across: &Across) -> impl Iterator<Item = f64> {
    across.blocks.iter().flat_map(|block| {
        let own = block.comparison.as_ref().map(|c| c.interval.unwrap_or((c.difference, c.difference)));
        own.into_iter().chain(block.simultaneous).flat_map(|(low, high)| [low, high])
    })
}

/// Returns the margin that all blocks state; `None` if blocks differ or state none.
fn margin(across: &Across) -> Option<f64> {
    let stated = distinct(across.blocks.iter().map(Block::margin));
    if let [only] = stated[..] { only } else { None }
}

fn caption(across: &Across, margin: Option<f64>) -> String {
    let mut text = format!(
        "Marks are mean differences, paired by seed, with their 95 % Student t intervals; thin lines are intervals that hold \
         with 95 % for all experiments at once (Bonferroni). {MARKS} these experiments. {NOT_SHOWN}"
    );
    if across.blocks.iter().any(|block| block.margin().is_some()) {
        text += " Equivalent: within a margin that the sweep states (two one-sided tests, Holm); a gain of it is ruled out \
                 where all of the thin line is worse.";
    }
    if let Some(margin) = margin {
        text += &format!(" Dashed: the margin of {margin} that all experiments state.");
    }
    text
}
