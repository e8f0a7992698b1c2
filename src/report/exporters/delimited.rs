//! CSV: points, clock times, table.

use crate::base::Result;
use crate::report::tables::{points_csv, table_csv, timing_csv};

use super::{Collected, Exporter, File, one};

/// `points.csv`: one line a point.
pub struct PointsCsv;

impl Exporter for PointsCsv {
    fn needs_table(&self) -> bool {
        false
    }

    fn owns(&self, file: &str) -> bool {
        file == "points.csv"
    }

    fn export(&self, collected: &Collected) -> Result<Vec<File>> {
        one("points.csv", points_csv(collected.records, collected.joined_timing()))
    }
}

/// `timing.csv`: clock times, apart from what repeats.
pub struct TimingCsv;

impl Exporter for TimingCsv {
    fn needs_table(&self) -> bool {
        false
    }

    fn owns(&self, file: &str) -> bool {
        file == "timing.csv"
    }

    fn export(&self, collected: &Collected) -> Result<Vec<File>> {
        one("timing.csv", timing_csv(collected.records, collected.timing))
    }
}

/// `table.csv`: one line a row, all digits.
pub struct TableCsv;

impl Exporter for TableCsv {
    fn needs_table(&self) -> bool {
        true
    }

    fn owns(&self, file: &str) -> bool {
        file == "table.csv"
    }

    fn export(&self, collected: &Collected) -> Result<Vec<File>> {
        one("table.csv", table_csv(collected.table()?, collected.joined_timing()))
    }
}
