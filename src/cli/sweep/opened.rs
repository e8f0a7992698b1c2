//! A sweep opened for reading: its folder, or the folder of its results.

use std::path::Path;

use crate::base::{Error, Result};
use crate::report::Record;
use crate::sweep::verify::Archive;
use crate::sweep::{Definition, Point, Source, SweepFolder, SweepOutputs};

use super::{begun, name_of};

/// A sweep in a folder.
pub struct Opened {
    /// The sweep's name.
    pub name: String,
    /// The folder.
    pub folder: SweepFolder,
    /// The sweep's definition.
    pub definition: Definition,
    /// The sweep's points.
    pub points: Vec<Point>,
    /// The data kept with tables; `None` in a folder with the points themselves.
    kept: Option<SweepOutputs>,
}

impl Opened {
    /// Opens `runs/NAME` or `results/NAME`.
    pub fn read(path: &Path, data_root: Option<&Path>) -> Result<Opened> {
        let folder = SweepFolder::new(path);
        if path.join("provenance.toml").is_file() {
            let Archive { definition, points, outputs, provenance, .. } = Archive::read(path, data_root)?;
            return Ok(Opened { name: provenance.name, folder, definition, points, kept: Some(outputs) });
        }
        let definition = folder.definition()?;
        let points = begun(&folder, data_root)?;
        Ok(Opened { name: name_of(path)?, folder, definition, points, kept: None })
    }

    /// Checks that the folder holds points, not results.
    ///
    /// # Errors
    /// [`Error::Config`]: the folder holds results.
    pub fn check_runs(&self) -> Result<()> {
        if self.kept.is_none() {
            return Ok(());
        }
        Err(Error::Config(format!(
            "{}: a results folder, not points; use it with --merge FOLDER --out DIR, or write its tables again with \
             `augnerf verify --update`",
            self.folder.path().display()
        )))
    }

    /// Returns the points' outputs.
    pub fn outputs(&self) -> Result<SweepOutputs> {
        match &self.kept {
            Some(outputs) => Ok(outputs.clone()),
            None => SweepOutputs::of_folder(&self.folder, &self.definition, &self.points),
        }
    }

    /// Returns the points' records: as the folder says, or as its results say.
    pub fn records(&self) -> Result<Vec<Record>> {
        match &self.kept {
            Some(outputs) => Ok(outputs.records.clone()),
            None => self.folder.records(&self.definition, &self.points),
        }
    }

    /// Returns whether the folder holds results, not the points themselves.
    pub fn is_results(&self) -> bool {
        self.kept.is_some()
    }

    /// Returns the sweep as the source of a view.
    pub fn source(&self) -> Result<Source<'_>> {
        Ok(Source {
            name: self.name.clone(),
            folder: self.kept.is_none().then_some(&self.folder),
            definition: &self.definition,
            points: &self.points,
            outputs: self.outputs()?,
        })
    }
}
