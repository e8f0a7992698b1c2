//! Text files: points, clock times and effect of the attack as CSV, the table as CSV, Markdown and LaTeX.

use crate::base::Result;
use crate::report::tables::{attack_csv, points_csv, table_csv, table_latex, table_markdown, timing_csv};

use super::{Collected, Exporter, File};

/// One file of text.
pub struct TextFile {
    name: &'static str,
    needs_table: bool,
    /// Returns `None` if there is nothing to write.
    text: Text,
}

type Text = fn(&Collected) -> Result<Option<String>>;

impl TextFile {
    const fn of_points(name: &'static str, text: Text) -> TextFile {
        TextFile { name, needs_table: false, text }
    }

    const fn of_table(name: &'static str, text: Text) -> TextFile {
        TextFile { name, needs_table: true, text }
    }
}

/// One line a point.
pub static POINTS_CSV: TextFile = TextFile::of_points("points.csv", |collected| {
    Ok(Some(points_csv(collected.records, collected.joined_timing(), &collected.constants)))
});

/// Clock times, apart from what is reproducible.
pub static TIMING_CSV: TextFile = TextFile::of_points("timing.csv", |collected| {
    Ok(Some(timing_csv(collected.records, collected.timing, &collected.constants)))
});

/// One line a row, with all digits.
pub static TABLE_CSV: TextFile = TextFile::of_table("table.csv", |collected| {
    Ok(Some(table_csv(collected.table()?, collected.joined_timing(), &collected.constants)))
});

/// One line for each attacked row: effect of the attack at each site.
pub static ATTACK_CSV: TextFile = TextFile::of_table("attack.csv", |collected| Ok(attack_csv(collected.attacks)));

/// The table in GitHub's Markdown.
pub static MARKDOWN: TextFile =
    TextFile::of_table("table.md", |collected| Ok(Some(table_markdown(collected.table()?))));

/// The table for a paper.
pub static LATEX: TextFile = TextFile::of_table("table.tex", |collected| Ok(Some(table_latex(collected.table()?))));

impl Exporter for TextFile {
    fn needs_table(&self) -> bool {
        self.needs_table
    }

    fn owns(&self, file: &str) -> bool {
        file == self.name
    }

    fn export(&self, collected: &Collected) -> Result<Vec<File>> {
        let text = (self.text)(collected)?;
        Ok(text.into_iter().map(|text| (self.name.to_string(), text.into_bytes())).collect())
    }
}
