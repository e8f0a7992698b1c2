//! The table as GitHub prints it.

use super::Table;
use super::text::{Grid, general_notes, protocol_text, scene_notes};

/// Title, then for each scene the shared protocol, the rows and their notes, then how to read them.
pub fn table_markdown(table: &Table) -> String {
    let grid = Grid::new(table);
    let mut rows = grid.rows.iter();
    let mut text = format!("**{}** ({})\n", escape(&table.title), escape(&table.name));
    for (scene, lines) in table.scenes() {
        text += &format!("\n### {}\n\n", escape(scene));
        text += &format!("All rows: {}\n\n", escape(&protocol_text(&lines)));
        text += &row_text(&grid.head);
        text += &format!("|---|{}\n", "---:|".repeat(grid.head.len() - 1));
        text.extend(rows.by_ref().take(lines.len()).map(|row| row_text(row)));
        text += "\n";
        text += &list_text(&scene_notes(&lines));
    }
    text + "\n" + &list_text(&general_notes(table))
}

fn list_text(notes: &[String]) -> String {
    notes.iter().map(|note| format!("- {}\n", escape(note))).collect()
}

fn row_text(cells: &[String]) -> String {
    let cells: Vec<String> = cells.iter().map(|cell| escape(cell)).collect();
    format!("| {} |\n", cells.join(" | "))
}

/// Text that Markdown prints as it is; a line break would end a row.
fn escape(text: &str) -> String {
    let escaped = text.chars().map(|c| match c {
        '\\' | '|' | '*' | '<' | '`' => format!("\\{c}"),
        '\n' | '\r' => " ".into(),
        other => other.into(),
    });
    escaped.collect()
}

#[cfg(test)]
mod tests {
    use super::escape;

    #[test]
    fn cells_stay_cells() {
        assert_eq!(escape("a|b *c* <d>\n+ l1 `e`"), "a\\|b \\*c\\* \\<d> + l1 \\`e\\`");
    }
}
