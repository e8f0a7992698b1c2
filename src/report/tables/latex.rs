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
    text += "\\end{minipage}\n\\end{table}\n";
    if text.contains("\\augnerfletter") { format!("{LETTER}{text}") } else { text }
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

/// What LaTeX prints as it is, in any of its engines and encodings: `\augnerfletter` stands for the rest.
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
            // A sign, not a hyphen; two, as of a flag, are no dash.
            '-' if matches!(before, ' ' | '[') => escaped += "$-$",
            '-' if before == '-' => escaped += "{}-",
            // A blank line would end the paragraph, in a caption with an error.
            c if c.is_whitespace() || c.is_control() => escaped.push(' '),
            c if c.is_ascii() || ACCENTED.contains(c) => escaped.push(c),
            other => escaped += &special(other),
        }
        before = c;
    }
    escaped
}

/// Letters with accents that every encoding of LaTeX puts together.
const ACCENTED: &str =
    "ÀÁÂÃÄÅÆÇÈÉÊËÌÍÎÏÑÒÓÔÕÖØÙÚÛÜÝàáâãäåæçèéêëìíîïñòóôõöøùúûüýÿßĆćČčĎďĚěŁłŃńŇňŐőŒœŘřŚśŠšŤťŮůŰűŸŹźŻżŽž";

/// Signs and Greek letters as mathematics has them.
const SPECIAL: [(char, &str); 59] = [
    ('±', "$\\pm$"),
    ('†', "$\\dagger$"),
    ('‡', "$\\ddagger$"),
    ('§', "\\S{}"),
    ('¶', "\\P{}"),
    ('‖', "$\\|$"),
    ('·', "$\\cdot$"),
    ('×', "$\\times$"),
    ('−', "$-$"),
    ('–', "--"),
    ('—', "---"),
    ('…', "\\ldots{}"),
    ('≤', "$\\leq$"),
    ('≥', "$\\geq$"),
    ('≈', "$\\approx$"),
    ('∞', "$\\infty$"),
    ('°', "$^\\circ$"),
    ('²', "$^2$"),
    ('³', "$^3$"),
    ('µ', "$\\mu$"),
    ('α', "$\\alpha$"),
    ('β', "$\\beta$"),
    ('γ', "$\\gamma$"),
    ('δ', "$\\delta$"),
    ('ε', "$\\varepsilon$"),
    ('ζ', "$\\zeta$"),
    ('η', "$\\eta$"),
    ('θ', "$\\theta$"),
    ('ι', "$\\iota$"),
    ('κ', "$\\kappa$"),
    ('λ', "$\\lambda$"),
    ('μ', "$\\mu$"),
    ('ν', "$\\nu$"),
    ('ξ', "$\\xi$"),
    ('ο', "$o$"),
    ('π', "$\\pi$"),
    ('ρ', "$\\rho$"),
    ('σ', "$\\sigma$"),
    ('ς', "$\\varsigma$"),
    ('τ', "$\\tau$"),
    ('υ', "$\\upsilon$"),
    ('φ', "$\\varphi$"),
    ('χ', "$\\chi$"),
    ('ψ', "$\\psi$"),
    ('ω', "$\\omega$"),
    ('Γ', "$\\Gamma$"),
    ('Δ', "$\\Delta$"),
    ('Θ', "$\\Theta$"),
    ('Λ', "$\\Lambda$"),
    ('Ξ', "$\\Xi$"),
    ('Π', "$\\Pi$"),
    ('Σ', "$\\Sigma$"),
    ('Υ', "$\\Upsilon$"),
    ('Φ', "$\\Phi$"),
    ('Ψ', "$\\Psi$"),
    ('Ω', "$\\Omega$"),
    ('ϵ', "$\\epsilon$"),
    ('∇', "$\\nabla$"),
    ('√', "$\\surd$"),
];

fn special(letter: char) -> String {
    let known = SPECIAL.iter().find(|(known, _)| *known == letter).map(|(_, text)| (*text).to_string());
    known.unwrap_or_else(|| format!("\\augnerfletter{{{:04X}}}", u32::from(letter)))
}

/// The letter itself where the engine knows Unicode, its number elsewhere, where it would be an error.
const LETTER: &str = "\\providecommand{\\augnerfletter}[1]{\\ifdefined\\Umathchar\\char\"#1\\relax\\else[U+#1]\\fi}\n";

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
        assert_eq!(escape("a\n\n\tb\u{0}c"), "a   b c");
        assert_eq!(escape("λ 中 é --force"), "$\\lambda$ \\augnerfletter{4E2D} é $-${}-force");
        assert_eq!(escape("-0.1 [-0.2, -0.0] pre-output"), "$-$0.1 [$-$0.2, $-$0.0] pre-output");
    }
}
