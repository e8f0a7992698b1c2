//! Rows against a baseline over scenes: one line a row, with each scene's difference.

use super::differences::{FOOT, MARKS, NOT_SHOWN, Scale, heights, middles};
use super::{Figure, metric_label};
use crate::base::Result;
use crate::draw::canvas::{Anchor, Canvas, GREY, LINE_HEIGHT, SIDE, TEXT, Width, range, text_width, wrapped};
use crate::report::statistics::mean;
use crate::report::{OverScenes, RowOverScenes};

/// Half of the height of an interval's ends.
const WHISKER: f64 = 5.0;
/// Room of the verdicts at the right: of a page, and of a column, which has none.
const WORDS: (f64, f64) = (170.0, 0.0);
/// Most room of the names.
const NAMES: (f64, f64) = (250.0, 140.0);

/// Draws the differences of all rows, or returns `None` without rows.
pub fn over_scenes_figure(over: &OverScenes, width: Width) -> Result<Option<Figure>> {
    if over.rows.is_empty() {
        return Ok(None);
    }
    let title = format!("Rows against {} over {} scenes", over.baseline, over.scenes.len());
    let mut drawing = Canvas::titled(width, &title);
    let names: Vec<String> = over.rows.iter().map(|row| row.row.clone()).collect();
    let widest = names.iter().map(|name| text_width(name, TEXT)).fold(60.0, f64::max);
    let room = widest.min(width.pick(NAMES.0, NAMES.1));
    let words_room = width.pick(WORDS.0, WORDS.1);
    let left = SIDE + room + 10.0;
    let mut scale = Scale {
        left,
        width: width.units() - left - words_room - SIDE - 10.0,
        top: 0.0,
        range: range(shown(over)).unwrap_or((-1.0, 1.0)),
    };
    let head = scale.head(&format!("difference in {}", metric_label(&over.metric)));
    scale.top = drawing.height + head.len() as f64 * LINE_HEIGHT + 8.0;
    let words: Vec<Vec<String>> = over.rows.iter().map(|row| wrapped(&over.judged(row), words_room, TEXT)).collect();
    let own = heights(&names, room).into_iter().zip(&words);
    let heights: Vec<f64> = own.map(|(height, words)| height.max(words.len() as f64 * LINE_HEIGHT + 6.0)).collect();
    let (middles, bottom) = middles(&heights, scale.top);
    scale.frame(&mut drawing, &head, bottom);
    scale.zero(&mut drawing, bottom);
    for end in over.margin.into_iter().flat_map(|margin| [-margin, margin]) {
        drawing.dashed(&[(scale.x(end), scale.top), (scale.x(end), bottom)], GREY, 1.0);
    }
    for ((row, words), y) in over.rows.iter().zip(&words).zip(middles) {
        drawing.name((left - 10.0, y), room, &row.row);
        draw_row(&mut drawing, &scale, y, over, row);
        if words_room == 0.0 {
            continue;
        }
        let first = y - LINE_HEIGHT * (words.len() as f64 - 1.0) / 2.0;
        for (index, line) in words.iter().enumerate() {
            let at = (scale.right() + 10.0, first + LINE_HEIGHT * index as f64);
            drawing.text(at, line, TEXT, Anchor::Left, GREY);
        }
    }
    drawing.height = bottom + FOOT;
    drawing.caption(&caption(over));
    drawing.finish().map(Some)
}

fn draw_row(drawing: &mut Canvas, scale: &Scale, y: f64, over: &OverScenes, row: &RowOverScenes) {
    for value in row.seeds.iter().filter_map(|seeds| mean(seeds)) {
        drawing.dot((scale.x(value), y), 2.5, GREY, 0.4);
    }
    if let Some((low, high)) = row.prediction {
        drawing.line(&[(scale.x(low), y), (scale.x(high), y)], GREY, 0.8);
        for end in [low, high] {
            drawing.line(&[(scale.x(end), y - WHISKER), (scale.x(end), y + WHISKER)], GREY, 0.8);
        }
    }
    if let Some(comparison) = &row.comparison {
        scale.difference(drawing, y, &over.metric, comparison);
    }
}

/// Returns all that is drawn, and 0.
fn shown(over: &OverScenes) -> impl Iterator<Item = f64> {
    let of_row = |row: &RowOverScenes| -> Vec<f64> {
        let scenes = row.seeds.iter().filter_map(|seeds| mean(seeds));
        let ends = row.prediction.into_iter().chain(row.comparison.and_then(|comparison| comparison.interval));
        scenes.chain(ends.flat_map(|(low, high)| [low, high])).collect()
    };
    over.rows.iter().flat_map(of_row).chain(over.margin.into_iter().flat_map(|margin| [-margin, margin])).chain([0.0])
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
