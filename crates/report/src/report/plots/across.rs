//! One comparison of several sweeps: differences with their intervals, one line a block.

use super::differences::{FOOT, MARKS, NOT_SHOWN, Scale, colour, heights, middles};
use super::{Figure, metric_label};
use crate::base::Result;
use crate::draw::canvas::{Anchor, Canvas, GREY, LINE_HEIGHT, SIDE, TEXT, Width, range, text_width, wrapped};
use crate::report::tables::Judgement;
use crate::report::{Across, Block, distinct};

/// Height of the ends of an interval that holds for all blocks at once.
const WHISKER: f64 = 5.0;
/// Room of the verdicts at the right: of a page, and of a column, which has none.
const WORDS: (f64, f64) = (190.0, 0.0);
/// Most room of the names.
const NAMES: (f64, f64) = (250.0, 150.0);

/// Draws the differences of all blocks, or returns `None` without blocks.
pub fn across_figure(across: &Across, width: Width) -> Result<Option<Figure>> {
    if across.blocks.is_empty() {
        return Ok(None);
    }
    let places: Vec<String> = across.blocks.iter().map(Block::place).collect();
    let margins = margins(across);
    let mut drawing = Canvas::titled(width, &format!("{} against {}", across.row, across.baseline));
    let room = places.iter().map(|place| text_width(place, TEXT)).fold(60.0, f64::max);
    let room = room.min(width.pick(NAMES.0, NAMES.1));
    let words_room = width.pick(WORDS.0, WORDS.1);
    let left = SIDE + room + 10.0;
    let mut scale = Scale {
        left,
        width: width.units() - left - words_room - SIDE - 10.0,
        top: 0.0,
        range: range(shown(across).chain(margins.iter().flat_map(|margin| [-margin, *margin]))).unwrap_or((-1.0, 1.0)),
    };
    let head = scale.head(&format!("difference in {}", metric_label(&across.metric)));
    scale.top = drawing.height + head.len() as f64 * LINE_HEIGHT + 8.0;
    let words: Vec<Vec<String>> =
        across.blocks.iter().map(|block| wrapped(&words(across, block), words_room, TEXT)).collect();
    let mut heights = heights(&places, room);
    if words_room > 0.0 {
        let rooms = words.iter().map(|lines| lines.len() as f64 * LINE_HEIGHT + 6.0);
        heights = heights.into_iter().zip(rooms).map(|(a, b)| a.max(b)).collect();
    }
    let (middles, bottom) = middles(&heights, scale.top);
    scale.frame(&mut drawing, &head, bottom);
    scale.zero(&mut drawing, bottom);
    for end in margins.iter().flat_map(|margin| [-margin, *margin]) {
        drawing.dashed(&[(scale.x(end), scale.top), (scale.x(end), bottom)], GREY, 1.0);
    }
    for (((block, place), words), y) in across.blocks.iter().zip(&places).zip(&words).zip(middles) {
        drawing.name((left - 10.0, y), room, place);
        draw_block(&mut drawing, &scale, y, across, block);
        if words_room > 0.0 {
            let first = y - LINE_HEIGHT * (words.len() as f64 - 1.0) / 2.0;
            for (index, line) in words.iter().enumerate() {
                let at = (scale.right() + 10.0, first + LINE_HEIGHT * index as f64);
                drawing.text(at, line, TEXT, Anchor::Left, GREY);
            }
        }
    }
    drawing.height = bottom + FOOT;
    drawing.caption(&caption(across, &margins));
    drawing.finish().map(Some)
}

fn draw_block(drawing: &mut Canvas, scale: &Scale, y: f64, across: &Across, block: &Block) {
    let Some(comparison) = &block.comparison else {
        drawing.text((scale.left + 6.0, y), "no seed has both rows", TEXT, Anchor::Left, GREY);
        return;
    };
    if let Some((low, high)) = block.simultaneous {
        let colour = colour(Judgement::of(&across.metric, comparison));
        drawing.line(&[(scale.x(low), y), (scale.x(high), y)], colour, 0.8);
        for end in [low, high] {
            drawing.line(&[(scale.x(end), y - WHISKER), (scale.x(end), y + WHISKER)], colour, 0.8);
        }
    }
    scale.difference(drawing, y, &across.metric, comparison);
}

fn words(across: &Across, block: &Block) -> String {
    block.comparison.as_ref().map_or(String::new(), |comparison| across.judged(block, comparison))
}

/// Returns all ends of intervals, and 0.
fn shown(across: &Across) -> impl Iterator<Item = f64> {
    let ends = across.blocks.iter().flat_map(|block| {
        let own = block.comparison.as_ref().map(|c| c.interval.unwrap_or((c.difference, c.difference)));
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
    let mut text = format!(
        "Marks are mean differences, paired by seed, with their 95 % Student t intervals; thin lines are intervals that hold \
         with 95 % for all experiments at once (Bonferroni). {MARKS} these experiments. {NOT_SHOWN}"
    );
    if across.blocks.iter().any(|block| block.margin().is_some()) {
        text += " Equivalent: within a margin that the sweep states (two one-sided tests, Holm); a gain of it is ruled out \
                 where all of the thin line is worse.";
    }
    if let [margin] = margins {
        text += &format!(" Dashed: the margin of {margin} that all experiments state.");
    }
    text
}
