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

/// Returns the drawing of the first columns whose words fit into `width`, and the heads of those that do not.
fn drawing(table: &Table, lines: &[&Line], width: u16) -> (Drawing, Vec<String>) {
    let column = |head: &str, text: &dyn Fn(&Line) -> String| -> Vec<String> {
        std::iter::once(head.to_string()).chain(lines.iter().map(|line| text(line))).collect()
    };
    let names = column("row", &|line| rounded(&marked_label(line)));
    let of_metric =
        |(index, metric): (usize, &String)| column(metric, &move |line: &Line| cell_text(&line.cells[index]));
    let unknown = column("paper, unknown backbone", &unknown_text);
    // The paper's column is second, so that a narrow terminal does not drop it first.
    let all = [names, unknown].into_iter().chain(table.metrics.iter().enumerate().map(of_metric));
    // A note says why a metric has no number.
    let mut columns: Vec<Vec<String>> = all.filter(|cells| cells[1..].iter().any(|cell| !cell.is_empty())).collect();
    // Room in which the words of a column stay whole, with the space around it.
    let room = |(index, cells): (usize, &Vec<String>)| {
        let words = cells.iter().flat_map(|cell| cell.split_whitespace()).map(|word| word.chars().count());
        let room = words.max().unwrap_or(0) as u16 + PADDING;
        if index == 0 { room.min(width / 2) } else { room }
    };
    let rooms: Vec<u16> = columns.iter().enumerate().map(room).collect();
    let fits = |count: &usize| rooms[..*count].iter().map(|room| u32::from(*room)).sum::<u32>() <= u32::from(width);
    // One metric at least.
    let least = columns.iter().position(|cells| table.metrics.contains(&cells[0])).map_or(2, |first| first + 1);
    let fitting = (least..=columns.len()).rev().find(fits).unwrap_or(least).min(columns.len());
    let left_out = columns.split_off(fitting).into_iter().map(|cells| cells[0].clone()).collect();
    let mut drawing = Drawing::new();
    drawing.load_style(UTF8_HORIZONTAL_ONLY).set_content_arrangement(ContentArrangement::Dynamic).set_width(width);
    drawing.set_header(columns.iter().map(|cells| &cells[0]));
    for line in 1..=lines.len() {
        drawing.add_row(columns.iter().map(|cells| &cells[line]));
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
