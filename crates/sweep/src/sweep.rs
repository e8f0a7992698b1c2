//! A sweep that was run, or is running.

use super::collect::{PAGE, Results, Tables};
use super::definition::Definition;
use super::folder::{DEFINITION, SweepFolder};
use super::outputs::SweepOutputs;
use super::points::Point;
use super::provenance::Provenance;
use crate::base::Result;
use crate::report::TableSpec;
use crate::report::tables::Table;
use crate::train::sha256;

/// A sweep with what its points left, read from their folders or from results.
pub struct Sweep {
    /// Its name.
    pub name: String,
    /// The folder of its points, or `None` if only its results are available.
    pub runs: Option<SweepFolder>,
    /// The definition that was run.
    pub definition: Definition,
    /// All points of the definition, done or not.
    pub points: Vec<Point>,
    /// Outputs of the points.
    pub outputs: SweepOutputs,
}

/// Options of tables.
#[derive(Clone, Copy)]
pub struct TableOptions {
    /// Put rows in one table that differ in an uncontrolled setting, and mark them.
    pub force: bool,
    /// Add clock times to the tables, which are then no longer reproducible.
    pub with_timing: bool,
}

impl Sweep {
    /// Returns the sweep in a folder with the points' records alone: other outputs are read by [`Sweep::read_outputs`].
    pub fn of_folder(name: String, runs: SweepFolder, definition: Definition, points: Vec<Point>) -> Result<Sweep> {
        let outputs = SweepOutputs { records: runs.records(&definition, &points)?, ..SweepOutputs::default() };
        Ok(Sweep { name, runs: Some(runs), definition, points, outputs })
    }

    /// Reads all outputs of the points anew from their folders, if these are available.
    pub fn read_outputs(&mut self) -> Result<()> {
        if let Some(runs) = &self.runs {
            self.outputs = SweepOutputs::of_folder(runs, &self.definition, &self.points)?;
        }
        Ok(())
    }

    /// Writes all tables and figures, the page, and the inputs that `augnerf verify` needs to make them again.
    /// Files that show no rows side by side are written even if rows are not comparable. Returns the table.
    pub fn write(&self, results: &Results, options: TableOptions) -> Result<Table> {
        let (mut files, mut provenance) = (Vec::new(), Provenance::of(&self.name, &self.outputs.records));
        match Provenance::read(results.path())? {
            // What a person has written of points that are missing stays as long as they are.
            Some(earlier) => provenance.missing = earlier.missing,
            // Written first, so that results that are killed here are recognized as this sweep's.
            None => provenance.write(results.path())?,
        }
        self.outputs.archive(&self.definition, &self.points, results.path())?;
        provenance.set_constants(&self.outputs);
        provenance.missing.retain(|missing| self.outputs.records.iter().any(|record| missing.names(record)));
        let table = self.tables(options).write(results, &mut files);
        // The page shows images of the runs.
        let page = files.iter().find(|(name, _)| name == PAGE);
        provenance.pinned.extend(page.map(|(name, bytes)| (name.clone(), sha256(bytes))));
        provenance.inputs.insert(DEFINITION.into(), sha256(self.definition.to_toml().as_bytes()));
        provenance.write(results.path())?;
        results.put(&files)?;
        table
    }

    pub(super) fn spec(&self) -> TableSpec {
        self.definition.table(&self.name, &self.points)
    }

    pub(super) fn tables(&self, options: TableOptions) -> Tables<'_> {
        Tables { spec: self.spec(), outputs: &self.outputs, points: &self.points, options }
    }
}
