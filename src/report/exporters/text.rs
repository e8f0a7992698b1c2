//! Single files of text: points and clock times as CSV, the table as CSV, Markdown and LaTeX.

use crate::base::Result;
use crate::report::tables::{points_csv, table_csv, table_latex, table_markdown, timing_csv};

use super::{Collected, Exporter, File};

/// One file of text.
pub struct TextFile {
    name: &'static str,
    needs_table: bool,
    text: fn(&Collected) -> Result<String>,
}

/// One line a point.
pub static POINTS_CSV: TextFile = TextFile {
    name: "points.csv",
    needs_table: false,
    text: |collected| Ok(points_csv(collected.records, collected.joined_timing())),
};

/// Clock times, apart from what repeats.
pub static TIMING_CSV: TextFile = TextFile {
    name: "timing.csv",
    needs_table: false,
    text: |collected| Ok(timing_csv(collected.records, collected.timing)),
};

/// One line a row, all digits.
pub static TABLE_CSV: TextFile = TextFile {
    name: "table.csv",
    needs_table: true,
    text: |collected| Ok(table_csv(collected.table()?, collected.joined_timing())),
};

/// The table as GitHub prints it.
pub static MARKDOWN: TextFile =
    TextFile { name: "table.md", needs_table: true, text: |collected| Ok(table_markdown(collected.table()?)) };

/// The table for a paper.
pub static LATEX: TextFile =
    TextFile { name: "table.tex", needs_table: true, text: |collected| Ok(table_latex(collected.table()?)) };

impl Exporter for TextFile {
    fn needs_table(&self) -> bool {
        self.needs_table
    }

    fn owns(&self, file: &str) -> bool {
        file == self.name
    }

    fn export(&self, collected: &Collected) -> Result<Vec<File>> {
        Ok(vec![(self.name.to_string(), (self.text)(collected)?.into_bytes())])
    }
}
