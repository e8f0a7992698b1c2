//! The table for a paper: needs `\usepackage{booktabs}`.

use super::Table;
use super::text::{Grid, general_notes, protocol_text, scene_notes};

/// One `table` environment with all scenes, notes below.
pub fn table_latex(table: &Table) -> String {
    let grid = Grid::new(table);
    let columns = grid.head.len();
    let mut rows = grid.rows.iter();
    let mut text = format!("\\begin{{table}}\n\\centering\n\\caption{{{}}}\n", escape(&table.title));
    text += &format!("\\begin{{tabular}}{{l{}}}\n\\toprule\n{}", "r".repeat(columns - 1), row_text(&grid.head));
    for (scene, lines) in table.scenes() {
        text += &format!("\\midrule\n\\multicolumn{{{columns}}}{{l}}{{\\emph{{{}}}}} \\\\\n", escape(scene));
        text.extend(rows.by_ref().take(lines.len()).map(|row| row_text(row)));
    }
    text += "\\bottomrule\n\\end{tabular}\n\n\\smallskip\n\\begin{minipage}{\\linewidth}\n\\footnotesize\n";
    text += &notes_text(table);
    text + "\\end{minipage}\n\\end{table}\n"
}

fn notes_text(table: &Table) -> String {
    let of_scene = |(scene, lines): (&str, Vec<_>)| {
        let protocol = format!("{scene}, all rows: {}", protocol_text(&lines));
        std::iter::once(protocol).chain(scene_notes(&lines))
    };
    let notes = table.scenes().into_iter().flat_map(of_scene).chain(general_notes(table));
    notes.map(|note| format!("{}\\par\n", escape(&note))).collect()
}

/// Cells in braces: a row must not begin with `[` or `*`, which the line end before it would take.
fn row_text(cells: &[String]) -> String {
    let cells: Vec<String> = cells.iter().map(|cell| format!("{{{}}}", escape(cell))).collect();
    format!("{} \\\\\n", cells.join(" & "))
}

/// Text that LaTeX prints as it is.
fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    let mut before = ' ';
    for c in text.chars() {
        match c {
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => escaped.extend(['\\', c]),
            '\\' => escaped += "\\textbackslash{}",
            '~' => escaped += "\\textasciitilde{}",
            '^' => escaped += "\\textasciicircum{}",
            '<' => escaped += "\\textless{}",
            '>' => escaped += "\\textgreater{}",
            '|' => escaped += "\\textbar{}",
            '±' => escaped += "$\\pm$",
            '†' => escaped += "$\\dagger$",
            '‡' => escaped += "$\\ddagger$",
            '§' => escaped += "\\S{}",
            '¶' => escaped += "\\P{}",
            // A sign, not a hyphen.
            '-' if matches!(before, ' ' | '[') => escaped += "$-$",
            other => escaped.push(other),
        }
        before = c;
    }
    escaped
}

#[cfg(test)]
mod tests {
    use super::escape;

    #[test]
    fn special_characters_are_printed() {
        assert_eq!(
            escape("a_b & 5 % {x} \\ <~^>|"),
            concat!(
                "a\\_b \\& 5 \\% \\{x\\} \\textbackslash{} ",
                "\\textless{}\\textasciitilde{}\\textasciicircum{}\\textgreater{}\\textbar{}"
            )
        );
        assert_eq!(escape("1 ± 2 †§"), "1 $\\pm$ 2 $\\dagger$\\S{}");
        assert_eq!(escape("-0.1 [-0.2, -0.0] pre-output"), "$-$0.1 [$-$0.2, $-$0.0] pre-output");
    }
}
