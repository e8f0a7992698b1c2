//! Columns of a LaTeX table, and which are side by side. Widths are estimated from the letters of Computer Modern,
//! rather too wide than too narrow.

use super::escape::escape;
use super::{Heading, Line};

/// Width limit of a table in points: a text of 17 cm has 483.
const WIDTH: f64 = 470.0;
/// Width limit of the first column in points; longer labels wrap.
const LABEL: f64 = 165.0;
/// Half the space between two columns, as `floats` sets it.
pub const SEPARATION: f64 = 4.0;
/// Size of `\footnotesize` in points.
const SIZE: f64 = 8.0;
/// Least width of a wrapped head.
const HEAD: f64 = 48.0;

/// Text of a line's cell, and whether it is bold.
type Cell<'a> = Box<dyn Fn(&Line) -> (String, bool) + 'a>;

/// A column: its head and its cells.
pub struct Column<'a> {
    head: String,
    cell: Cell<'a>,
}

impl<'a> Column<'a> {
    pub fn new(head: String, cell: impl Fn(&Line) -> (String, bool) + 'a) -> Column<'a> {
        Column { head, cell: Box::new(cell) }
    }

    /// Returns the width of its cells alone.
    fn cells_width(&self, lines: &[&Line]) -> f64 {
        let width = |line: &&Line| {
            let (text, bold) = (self.cell)(line);
            width(&text) * if bold { 1.16 } else { 1.0 }
        };
        lines.iter().map(width).fold(0.0, f64::max)
    }

    fn text(&self, line: &Line) -> String {
        match (self.cell)(line) {
            (text, true) if !text.is_empty() => format!("\\textbf{{\\boldmath {}}}", escape(&text)),
            (text, _) => escape(&text),
        }
    }
}

/// Columns that stay together, with a name if they have one.
pub struct Group<'a> {
    pub name: Option<String>,
    pub columns: Vec<Column<'a>>,
}

/// A group in a part, with the wrapped lines of its heads.
struct GroupLayout<'g, 'a> {
    group: &'g Group<'a>,
    name: Vec<String>,
    heads: Vec<Vec<String>>,
    width: f64,
}

impl<'g, 'a> GroupLayout<'g, 'a> {
    fn new(group: &'g Group<'a>, lines: &[&Line]) -> GroupLayout<'g, 'a> {
        let broken = |column: &Column| {
            let own = column.cells_width(lines);
            let head = broken(&column.head, own.max(HEAD));
            let widest = head.iter().map(|line| width(line)).fold(own, f64::max);
            (head, widest + 2.0 * SEPARATION)
        };
        let (heads, widths): (Vec<_>, Vec<_>) = group.columns.iter().map(broken).unzip();
        let own: f64 = widths.into_iter().sum();
        let name = group.name.as_ref().map(|name| self::broken(name, own.max(HEAD))).unwrap_or_default();
        let width = name.iter().map(|line| width(line) + 2.0 * SEPARATION).fold(own, f64::max);
        GroupLayout { group, name, heads, width }
    }
}

/// Groups that fit side by side after the labels.
pub struct Part<'g, 'a> {
    groups: Vec<GroupLayout<'g, 'a>>,
    /// Width of the first column in points, if labels wrap.
    label: Option<f64>,
}

/// Splits the groups into as many parts as the width needs.
pub fn parts<'g, 'a>(labels: &[String], groups: &'g [Group<'a>], lines: &[&Line]) -> Vec<Part<'g, 'a>> {
    let longest = labels.iter().map(|label| width(label)).fold(30.0, f64::max);
    let label = (longest > LABEL).then_some(LABEL);
    let room = WIDTH - longest.min(LABEL) - 2.0 * SEPARATION;
    let mut parts: Vec<Part> = Vec::new();
    let mut taken = f64::INFINITY;
    for group in groups {
        let layout = GroupLayout::new(group, lines);
        if taken + layout.width > room {
            parts.push(Part { groups: Vec::new(), label });
            taken = 0.0;
        }
        taken += layout.width;
        parts.last_mut().expect("just begun").groups.push(layout);
    }
    parts
}

impl Part<'_, '_> {
    /// Returns the number of columns, with that of the labels.
    pub fn count(&self) -> usize {
        1 + self.groups.iter().map(|layout| layout.heads.len()).sum::<usize>()
    }

    fn has_names(&self) -> bool {
        self.groups.iter().any(|layout| !layout.name.is_empty())
    }

    /// Returns the text from `\begin{tabular}` to the heads.
    pub fn begin(&self) -> String {
        let label = self.label.map_or("l".into(), |label| format!("p{{{label:.0}pt}}"));
        let mut text = format!("\\begin{{tabular}}{{{label}{}}}\n\\toprule\n", "r".repeat(self.count() - 1));
        if self.has_names() {
            let (mut names, mut rules, mut at) = (vec!["{}".to_string()], String::new(), 2);
            for layout in &self.groups {
                let last = at + layout.heads.len() - 1;
                names.push(format!("\\multicolumn{{{}}}{{c}}{{{}}}", layout.heads.len(), stacked(&layout.name, 'c')));
                rules += &format!("\\cmidrule(lr){{{at}-{last}}}");
                at = last + 1;
            }
            text += &format!("{} \\\\\n{rules}\n", names.join(" & "));
        }
        let heads =
            self.groups.iter().flat_map(|layout| &layout.heads).map(|head| format!("{{{}}}", stacked(head, 'r')));
        let cells: Vec<String> = std::iter::once("{}".to_string()).chain(heads).collect();
        text + &format!("{} \\\\\n", cells.join(" & "))
    }

    /// Returns the number of rows of the heads.
    pub fn head_rows(&self) -> f64 {
        let most = |lines: &mut dyn Iterator<Item = usize>| lines.max().unwrap_or(0) as f64;
        let names = most(&mut self.groups.iter().map(|layout| layout.name.len()));
        2.0 + names + most(&mut self.groups.iter().flat_map(|layout| layout.heads.iter().map(Vec::len)))
    }

    /// Returns the number of rows of a label.
    pub fn label_rows(&self, label: &str) -> f64 {
        self.label.map_or(1.0, |room| (1.15 * width(label) / room).ceil().max(1.0))
    }

    /// Returns the cells of a line.
    pub fn cells(&self, label: &str, line: &Line) -> Vec<String> {
        let label = match self.label {
            // Neither braces nor a paragraph's end: both would double the height of the row.
            Some(_) => format!("\\raggedright {}", escape(label)),
            None => braced(&escape(label)),
        };
        let columns = self.groups.iter().flat_map(|layout| &layout.group.columns);
        std::iter::once(label).chain(columns.map(|column| braced(&column.text(line)))).collect()
    }
}

/// Joins the cells of a row.
pub fn row_text(cells: &[String]) -> String {
    format!("{} \\\\\n", cells.join(" & "))
}

/// Puts a cell in braces: a row must not start with `[` or `*`, which the line end before it would take.
fn braced(cell: &str) -> String {
    format!("{{{cell}}}")
}

/// Stacks lines, with the last on the row's line.
fn stacked(lines: &[String], side: char) -> String {
    let lines: Vec<String> = lines.iter().map(|line| format!("{{{}}}", escape(line))).collect();
    match lines.as_slice() {
        [line] => line.clone(),
        _ => format!("\\begin{{tabular}}[b]{{@{{}}{side}@{{}}}}{}\\end{{tabular}}", lines.join("\\\\")),
    }
}

/// Wraps a head at spaces to a width in points; its arrow stays with the word before.
fn broken(head: &str, room: f64) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in head.split(' ') {
        let joined = lines.last().map(|line| format!("{line} {word}"));
        let fits = |joined: &String| width(joined) <= room || Heading::is_arrow(word);
        match joined.filter(fits) {
            Some(joined) => *lines.last_mut().expect("one was joined") = joined,
            None => lines.push(word.into()),
        }
    }
    lines
}

/// Returns the width of a text in `\footnotesize`, in points.
pub fn width(text: &str) -> f64 {
    text.chars().map(em).sum::<f64>() * SIZE
}

/// Returns a letter's width in ems of cmr8, rounded up.
fn em(letter: char) -> f64 {
    match letter {
        'i' | 'j' | 'l' | '.' | ',' | ':' | ';' | '\'' | '!' | '[' | ']' | '|' => 0.31,
        'f' | 't' | 'r' | 's' | 'I' | '(' | ')' | ' ' | '/' => 0.44,
        'm' | 'M' | 'W' | 'w' | '+' | '-' | '±' | '<' | '>' | '=' | '≈' | '%' | '−' => 0.92,
        '↑' | '↓' | '†' | '‡' | '§' | '¶' | '‖' | '·' | '²' | '³' | '0'..='9' => 0.54,
        letter if letter.is_uppercase() => 0.82,
        // Includes Latin letters with accents.
        letter if u32::from(letter) < 0x180 => 0.57,
        '\u{370}'..='\u{3ff}' | '×' => 0.78,
        '\u{2070}'..='\u{209f}' | '¹' => 0.44,
        // Some are printed as their number: `[U+4E2D]`.
        _ => 4.5,
    }
}
