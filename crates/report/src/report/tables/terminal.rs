//! The table for a terminal: one column a metric, so that it stays narrow.

use comfy_table::presets::UTF8_HORIZONTAL_ONLY;
use comfy_table::{ColumnConstraint, ContentArrangement, Table as Drawing, Width};

use super::text::{
    UNKNOWN_BACKBONE, difference_text, general_notes, marked_label, mean_text, protocol_text, published_text,
    scene_notes,
};
use super::{Cell, Line, Table, epochs_note};
use crate::draw::numbers::rounded;

/// Returns title, then a drawing for each scene with its notes. `width` is the terminal's, in characters; the terminal
/// wraps the notes.
pub fn table_terminal(table: &Table, width: u16) -> String {
    let mut text = format!("{} ({})\n", table.title, table.name);
    for (scene, lines) in table.scenes() {
        text += &format!("\n{scene}: {}\n", protocol_text(&lines));
        text.extend(epochs_note(&lines, FEW).map(|note| format!("{note}\n")));
        let (drawing, left_out) = drawing(table, &lines, width);
        text += &format!("{drawing}\n");
        if !left_out.is_empty() {
            text += &format!("not shown in {width} characters: {}\n", left_out.join(", "));
        }
        text.extend(scene_notes(&lines, usize::MAX).iter().map(|note| format!("{}\n", rounded(note))));
    }
    text += "\n";
    text.extend(general_notes(table).iter().map(|note| format!("{note}\n")));
    text
}

/// Returns the drawing of the first metrics whose words fit into `width`, and the metrics that do not.
fn drawing<'t>(table: &'t Table, lines: &[&Line], width: u16) -> (Drawing, Vec<&'t str>) {
    let mut drawing = Drawing::new();
    drawing.load_style(UTF8_HORIZONTAL_ONLY).set_content_arrangement(ContentArrangement::Dynamic).set_width(width);
    let unknown = lines.iter().any(|line| !unknown_text(line).is_empty()).then_some("paper, unknown backbone");
    // A note says why a metric has no number.
    let is_filled = |index: &usize| lines.iter().any(|line| !cell_text(&line.cells[*index]).is_empty());
    let mut filled: Vec<usize> = (0..table.metrics.len()).filter(is_filled).collect();
    // Room of a column whose words stay whole, with the space around it.
    let room = |texts: &mut dyn Iterator<Item = String>| {
        let longest =
            texts.map(|text| text.split_whitespace().map(|word| word.chars().count()).max().unwrap_or(0)).max();
        longest.unwrap_or(0) as u16 + PADDING
    };
    let of_metric = |index: &usize| {
        let cells = lines.iter().map(|line| cell_text(&line.cells[*index]));
        room(&mut std::iter::once(table.metrics[*index].clone()).chain(cells))
    };
    let mut rooms = vec![room(&mut lines.iter().map(|line| rounded(&marked_label(line)))).min(width / 2)];
    let last =
        unknown.map(|head| room(&mut std::iter::once(head.to_string()).chain(lines.iter().map(|l| unknown_text(l)))));
    let mut left = width.saturating_sub(rooms[0] + last.unwrap_or(0));
    let fitting = filled.iter().take_while(|index| {
        let room = of_metric(index);
        let fits = room <= left;
        left = left.saturating_sub(room);
        fits
    });
    // One metric at least.
    let fitting = fitting.count().max(1).min(filled.len());
    let left_out = filled.split_off(fitting).into_iter().map(|index| table.metrics[index].as_str()).collect();
    rooms.extend(filled.iter().map(of_metric).chain(last));
    let metrics = filled.iter().map(|index| table.metrics[*index].as_str());
    drawing.set_header(std::iter::once("row").chain(metrics).chain(unknown));
    for line in lines {
        let last = unknown.map(|_| unknown_text(line));
        let cells = filled.iter().map(|index| cell_text(&line.cells[*index]));
        drawing.add_row(std::iter::once(rounded(&marked_label(line))).chain(cells).chain(last));
    }
    for (column, room) in drawing.column_iter_mut().zip(rooms) {
        column.set_constraint(ColumnConstraint::LowerBoundary(Width::Fixed(room)));
    }
    (drawing, left_out)
}

/// Most rows that a line above the table names.
const FEW: usize = 3;
/// Characters of a column besides its text.
const PADDING: u16 = 2;

/// Returns the paper's numbers that match none of our metrics.
fn unknown_text(line: &Line) -> String {
    let numbers = UNKNOWN_BACKBONE.iter().map(|(name, text)| (name, text(line))).filter(|(_, text)| !text.is_empty());
    numbers.map(|(name, text)| format!("{name} {text}")).collect::<Vec<String>>().join("\n")
}

/// Returns mean, difference and the paper's number below one another.
fn cell_text(cell: &Cell) -> String {
    let published = Some(published_text(cell)).filter(|text| !text.is_empty());
    let parts =
        [mean_text(cell), difference_text(cell), published.map_or(String::new(), |text| format!("paper {text}"))];
    parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<String>>().join("\n")
}
