//! The table in GitHub's Markdown.

use super::text::{Grid, capitalized, general_notes, protocol_text, scene_notes};
use super::{Table, epochs_note};
use crate::draw::numbers::rounded;

/// Returns title, then for each scene the shared protocol, the rows and their notes, then how to read them.
pub fn table_markdown(table: &Table) -> String {
    let grid = Grid::new(table);
    let mut rows = grid.rows.iter();
    let mut text = format!("**{}** ({})\n", escape(&table.title), escape(&table.name));
    for (scene, lines) in table.scenes() {
        text += &format!("\n### {}\n\n", escape(scene));
        text.extend(epochs_note(&lines, usize::MAX).map(|note| format!("{}\n\n", escape(&capitalized(&note)))));
        text += &format!("All rows: {}\n\n", escape(&protocol_text(&lines)));
        text += &row_text(&grid.head);
        text += &format!("|---|{}\n", "---:|".repeat(grid.head.len() - 1));
        text.extend(rows.by_ref().take(lines.len()).map(|row| row_text(row)));
        text += "\n";
        text += &list_text(&scene_notes(&lines, usize::MAX));
    }
    text + "\n" + &list_text(&general_notes(table))
}

fn list_text(notes: &[String]) -> String {
    // A note may start with the characters of a heading, list or quotation, but is none.
    let block = |note: &str| if note.starts_with(['#', '+', '-', '>', '=']) { "\\" } else { "" };
    notes.iter().map(|note| format!("- {}{}\n", block(note), escape(&rounded(note)))).collect()
}

fn row_text(cells: &[String]) -> String {
    let cells: Vec<String> = cells.iter().map(|cell| escape(&rounded(cell))).collect();
    format!("| {} |\n", cells.join(" | "))
}

/// Escapes text so that Markdown prints it unchanged; a line break would end a row. It makes no link, image, HTML or
/// formula.
pub fn escape(text: &str) -> String {
    let letters: Vec<char> = text.chars().collect();
    let is_word = |letter: Option<&char>| letter.is_some_and(|letter| letter.is_alphanumeric());
    let escaped = letters.iter().enumerate().map(|(i, &c)| {
        let (before, after) = (i.checked_sub(1).map(|i| &letters[i]), letters.get(i + 1));
        match c {
            '\\' | '|' | '*' | '<' | '`' | '~' | '$' => format!("\\{c}"),
            // Prevents links; brackets themselves are needed for intervals.
            '(' | '[' | ':' if before == Some(&']') => format!("\\{c}"),
            '_' if !(is_word(before) && is_word(after)) => "\\_".into(),
            '&' if is_word(after) || after == Some(&'#') => "\\&".into(),
            c if c.is_control() => " ".into(),
            other => other.into(),
        }
    });
    escaped.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_stay_cells() {
        assert_eq!(escape("a|b *c* <d>\n+ l1 `e`"), "a\\|b \\*c\\* \\<d> + l1 \\`e\\`");
        assert_eq!(
            escape("+0.5 [-0.1, +0.2] (2 pairs), average_vgg, a & b"),
            "+0.5 [-0.1, +0.2] (2 pairs), average_vgg, a & b"
        );
    }

    #[test]
    fn nothing_becomes_a_link_or_a_heading() {
        assert_eq!(escape("[x](javascript:alert)"), "[x]\\(javascript:alert)");
        assert_eq!(escape("![x](http://a)"), "![x]\\(http://a)");
        assert_eq!(escape("[x][y] [x]: z"), "[x]\\[y] [x]\\: z");
        assert_eq!(escape("&#91;x] _y_ ~~z~~ $a$"), "\\&#91;x] \\_y\\_ \\~\\~z\\~\\~ \\$a\\$");
        assert_eq!(list_text(&["# a".into(), "b".into()]), "- \\# a\n- b\n");
    }
}
