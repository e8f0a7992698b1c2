//! Tables for readers.

use crate::base::Result;
use crate::report::tables::{table_latex, table_markdown};

use super::{Collected, Exporter, File, one};

/// `table.md`.
pub struct Markdown;

impl Exporter for Markdown {
    fn needs_table(&self) -> bool {
        true
    }

    fn owns(&self, file: &str) -> bool {
        file == "table.md"
    }

    fn export(&self, collected: &Collected) -> Result<Vec<File>> {
        one("table.md", table_markdown(collected.table()?))
    }
}

/// `table.tex`.
pub struct Latex;

impl Exporter for Latex {
    fn needs_table(&self) -> bool {
        true
    }

    fn owns(&self, file: &str) -> bool {
        file == "table.tex"
    }

    fn export(&self, collected: &Collected) -> Result<Vec<File>> {
        one("table.tex", table_latex(collected.table()?))
    }
}
