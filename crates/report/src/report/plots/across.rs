//! One comparison of several sweeps: differences with their intervals, one line a block.

use super::differences::{PANEL, ROW, Scale, TOP, colour, widest};
use super::{Figure, metric_label};
use crate::base::Result;
use crate::draw::canvas::{Anchor, BLACK, Canvas, GREY, TEXT, range};
use crate::report::{Across, Block, distinct};

/// Height of the ends of an interval that holds for all blocks at once.
const WHISKER: f64 = 5.0;

/// Draws the differences of all blocks, or returns `None` without blocks.
pub fn across_figure(across: &Across) -> Result<Option<Figure>> {
    if across.blocks.is_empty() {
        return Ok(None);
    }
    let places: Vec<String> = across.blocks.iter().map(Block::place).collect();
    let words: Vec<String> = across.blocks.iter().map(|block| words(across, block)).collect();
    let margins = margins(across);
    let scale = Scale {
        left: 20.0 + widest(places.iter().map(String::as_str), 80.0) + 16.0,
        range: range(shown(across).chain(margins.iter().flat_map(|margin| [-margin, *margin]))).unwrap_or((-1.0, 1.0)),
    };
    let bottom = TOP + ROW * across.blocks.len() as f64;
    let width = scale.left + PANEL + widest(words.iter().map(String::as_str), 120.0) + 30.0;
    let metric = metric_label(&across.metric);
    let title = format!("{} against {}", across.row, across.baseline);
    let mut drawing = Canvas::titled(width, bottom + 30.0, &title);
    scale.frame(&mut drawing, &format!("difference in {metric}"), bottom);
    scale.zero(&mut drawing, bottom);
    for end in margins.iter().flat_map(|margin| [-margin, *margin]) {
        drawing.dashed(&[(scale.x(end), TOP), (scale.x(end), bottom)], GREY, 1.0);
    }
    for (index, ((block, place), words)) in across.blocks.iter().zip(&places).zip(&words).enumerate() {
        let y = TOP + ROW * (index as f64 + 0.5);
        drawing.text((scale.left - 10.0, y), place, TEXT, Anchor::Right, BLACK);
        draw_block(&mut drawing, &scale, y, block, words);
    }
    drawing.caption(&caption(across, &margins));
    drawing.finish().map(Some)
}

fn draw_block(drawing: &mut Canvas, scale: &Scale, y: f64, block: &Block, words: &str) {
    let Some(comparison) = &block.comparison else {
        drawing.text((scale.left + 6.0, y), "no data", TEXT, Anchor::Left, GREY);
        return;
    };
    if let Some((low, high)) = block.simultaneous {
        let colour = colour(comparison);
        drawing.line(&[(scale.x(low), y), (scale.x(high), y)], colour, 0.8);
        for end in [low, high] {
            drawing.line(&[(scale.x(end), y - WHISKER), (scale.x(end), y + WHISKER)], colour, 0.8);
        }
    }
    scale.difference(drawing, y, comparison, words);
}

fn words(across: &Across, block: &Block) -> String {
    block.comparison.as_ref().map_or(String::new(), |comparison| across.words(block, comparison))
}

/// Returns all ends of intervals, and 0.
fn shown(across: &Across) -> impl Iterator<Item = f64> {
    let ends = across.blocks.iter().flat_map(|block| {
        let own = block.comparison.as_ref().and_then(|comparison| comparison.interval);
        own.into_iter().chain(block.simultaneous).flat_map(|(low, high)| [low, high])
    });
    ends.chain([0.0])
}

/// Returns the margin that all blocks state; empty if blocks differ or state none.
fn margins(across: &Across) -> Vec<f64> {
    let stated = distinct(across.blocks.iter().map(Block::margin));
    if stated.len() == 1 { stated.into_iter().flatten().collect() } else { Vec::new() }
}

fn caption(across: &Across, margins: &[f64]) -> String {
    let mut text = "Dots are mean differences, paired by seed, with their 95 % Student t intervals; thin lines are intervals that hold with \
                    95 % for all blocks at once (Bonferroni). Higher and lower (red) by Holm's p below 0.05 over the blocks, not \
                    distinguishable where the block's own interval holds 0, no word between the two."
        .to_string();
    if across.blocks.iter().any(|block| block.margin().is_some()) {
        text += " Equivalent (blue where no difference is shown) within a margin that the sweep states: two one-sided tests, Holm; a \
                 gain of it is ruled out where all of the thin line is worse.";
    }
    if let [margin] = margins {
        text += &format!(" Dashed: the margin of {margin} that all blocks state.");
    }
    text
}
