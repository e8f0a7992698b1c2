//! The files that are made of a sweep's points: an exporter each, and one list.

use crate::base::{Error, Result};

use super::plots::{Curve, Shifts, Surface};
use super::tables::{AttackLine, PointTiming, Table};
use super::{Record, TableSpec};

mod figures;
mod text;

/// What a sweep's points came to.
pub struct Collected<'a> {
    /// What the definition says about its table.
    pub spec: &'a TableSpec,
    /// The points, one record a place in the table.
    pub records: &'a [Record],
    /// Clock times of the points that are done.
    pub timing: &'a [PointTiming],
    /// Join clock times to the tables, which then no longer repeat.
    pub with_timing: bool,
    /// The table; none until it is known that its rows may stand side by side.
    pub table: Option<&'a Table>,
    /// Training curves by scene.
    pub curves: &'a [(String, Vec<Curve>)],
    /// What the attack did, line by line of the table.
    pub attacks: &'a [AttackLine<'a>],
    /// How far it moved colours over training, by scene.
    pub shifts: &'a [(String, Vec<Shifts>)],
    /// Pictures of surfaces by scene.
    pub surfaces: &'a [(String, Vec<Surface>)],
}

impl<'a> Collected<'a> {
    /// The table, for exporters that need it.
    fn table(&self) -> Result<&'a Table> {
        self.table.ok_or_else(|| Error::Output("the table is not made yet".into()))
    }

    /// The points that were trained here, or the pictures of other programs.
    fn records_of(&self, scored: bool) -> Vec<Record> {
        self.records.iter().filter(|record| self.spec.is_scored(&record.row) == scored).cloned().collect()
    }

    /// The clock times that tables show.
    fn joined_timing(&self) -> &'a [PointTiming] {
        if self.with_timing { self.timing } else { &[] }
    }
}

/// Name and bytes of a file.
pub type File = (String, Vec<u8>);

/// Makes files of a sweep's points.
pub trait Exporter: Sync {
    /// It shows rows side by side: nothing is written where they may not stand so.
    fn needs_table(&self) -> bool;

    /// Whether a file in the results' folder is one of its own, to be deleted before it is written anew.
    fn owns(&self, file: &str) -> bool;

    /// The files are made of what is kept beside the tables. Those of others cannot be made again without the runs.
    fn repeats(&self) -> bool {
        true
    }

    /// The files, by their names below the results' folder.
    fn export(&self, collected: &Collected) -> Result<Vec<File>>;
}

/// The exporters that read the points' logs, which a results' folder may lack.
pub static OF_LOGS: [&dyn Exporter; 3] = [&text::ATTACK_CSV, &figures::CURVES, &figures::ATTACK];

/// All exporters, in the order in which they write.
pub static EXPORTERS: [&dyn Exporter; 13] = [
    &text::POINTS_CSV,
    &text::SCORED_CSV,
    &text::TIMING_CSV,
    &text::TABLE_CSV,
    &text::ATTACK_CSV,
    &text::MARKDOWN,
    &text::LATEX,
    &figures::ROWS,
    &figures::AXES,
    &figures::HEATMAPS,
    &figures::CURVES,
    &figures::ATTACK,
    &figures::SURFACES,
];
