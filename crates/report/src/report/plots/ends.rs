//! Names at the right ends of lines.

use super::Stroke;
use crate::draw::canvas::{Anchor, BLACK, Canvas, GRID, LINE_HEIGHT, Panel, TEXT, wrapped};

/// Gap between a panel and the names, which a leader crosses.
const LEADER: f64 = 18.0;
/// Gap between two names.
const BETWEEN: f64 = 2.0;

/// The end of a line.
pub(super) struct End<'a> {
    /// Its place in pixels.
    pub(super) at: (f64, f64),
    pub(super) stroke: Stroke,
    pub(super) name: &'a str,
}

/// Writes each name next to its line's end, moved up or down so that none covers another.
pub(super) fn draw(drawing: &mut Canvas, panel: &Panel, room: f64, mut ends: Vec<End>) {
    ends.sort_by(|a, b| a.at.1.total_cmp(&b.at.1));
    let names: Vec<Vec<String>> = ends.iter().map(|end| wrapped(end.name, room - LEADER - 4.0, TEXT)).collect();
    let heights: Vec<f64> = names.iter().map(|lines| lines.len() as f64 * (LINE_HEIGHT - 3.0) + BETWEEN).collect();
    let tops = spread(&ends.iter().map(|end| end.at.1).collect::<Vec<f64>>(), &heights, panel.top, panel.bottom());
    for ((end, lines), top) in ends.iter().zip(&names).zip(tops) {
        let first = top + LINE_HEIGHT / 2.0 - 1.0;
        let edge = (panel.right(), end.at.1);
        if end.at.0 < edge.0 - 1.0 {
            // Nothing was measured here: as pale as the grid, so that it is no curve.
            drawing.line(&[end.at, edge], GRID, 1.0);
        }
        let leader = [edge, (panel.right() + 4.0, end.at.1), (panel.right() + LEADER, first)];
        Stroke { width: 1.2, dashed: false, ..end.stroke }.draw(drawing, &leader);
        for (index, line) in lines.iter().enumerate() {
            let at = (panel.right() + LEADER + 4.0, first + (LINE_HEIGHT - 3.0) * index as f64);
            drawing.text(at, line, TEXT, Anchor::Left, BLACK);
        }
    }
}

/// Returns the top of each name: as near to its middle as names before it and the bounds allow.
fn spread(middles: &[f64], heights: &[f64], top: f64, bottom: f64) -> Vec<f64> {
    let mut tops: Vec<f64> = middles.iter().zip(heights).map(|(middle, height)| middle - height / 2.0).collect();
    // Above is the panel's title.
    let mut least = top - 2.0;
    for (own, height) in tops.iter_mut().zip(heights) {
        *own = own.max(least);
        least = *own + height;
    }
    let mut most = bottom.max(top - 2.0 + heights.iter().sum::<f64>());
    for (own, height) in tops.iter_mut().zip(heights).rev() {
        *own = own.min(most - height);
        most = *own;
    }
    tops
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_do_not_cover_one_another() {
        let tops = spread(&[50.0, 51.0, 52.0, 99.0], &[20.0, 20.0, 35.0, 20.0], 0.0, 100.0);
        assert_eq!(tops, [5.0, 25.0, 45.0, 80.0]);
        // Without a neighbour each is where its line ends.
        assert_eq!(spread(&[20.0, 80.0], &[20.0, 20.0], 0.0, 100.0), [10.0, 70.0]);
    }
}
