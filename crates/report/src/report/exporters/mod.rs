//! The files that are made from a sweep's points: one exporter each, and the list of all.

use crate::base::{Error, Result};
pub use crate::draw::canvas::File;

use super::plots::Curve;
use super::tables::{AttackLine, Constants, PointTiming, Table};
use super::{Record, TableSpec};

mod figures;
mod text;

/// The results of a sweep's points.
pub struct Collected<'a> {
    /// The definition's description of its table.
    pub spec: &'a TableSpec,
    /// The points, one record for each position in the table.
    pub records: &'a [Record],
    /// Clock times of the points that are done.
    pub timing: &'a [PointTiming],
    /// Add clock times to the tables, which are then no longer reproducible.
    pub with_timing: bool,
    /// The protocol fields that all points share, which are no columns.
    pub constants: Constants,
    /// The table, or `None` until its rows are known to be comparable.
    pub table: Option<&'a Table>,
    /// Training curves by scene.
    pub curves: &'a [(String, Vec<Curve>)],
    /// Effect of the attack, line by line of the table.
    pub attacks: &'a [AttackLine<'a>],
}

impl<'a> Collected<'a> {
    /// Returns the table, for exporters that need it.
    fn table(&self) -> Result<&'a Table> {
        self.table.ok_or_else(|| Error::Output("the table is not made yet".into()))
    }

    /// Returns the clock times that tables show.
    fn joined_timing(&self) -> &'a [PointTiming] {
        if self.with_timing { self.timing } else { &[] }
    }
}

/// Makes files from a sweep's points.
pub trait Exporter: Sync {
    /// Returns whether its files show rows side by side. They are written only if rows are comparable.
    fn needs_table(&self) -> bool;

    /// Returns whether a file in the results folder is its own, to be deleted before it is written again.
    fn owns(&self, file: &str) -> bool;

    /// Returns the files, by their names below the results folder.
    fn export(&self, collected: &Collected) -> Result<Vec<File>>;
}

/// The exporters that read the points' logs, which a results folder may lack.
pub static OF_LOGS: [&dyn Exporter; 2] = [&text::ATTACK_CSV, &figures::CURVES];

/// All exporters, in the order of writing.
pub static EXPORTERS: [&dyn Exporter; 9] = [
    &text::POINTS_CSV,
    &text::TIMING_CSV,
    &text::TABLE_CSV,
    &text::ATTACK_CSV,
    &text::MARKDOWN,
    &text::LATEX,
    &figures::ROWS,
    &figures::AXES,
    &figures::CURVES,
];
