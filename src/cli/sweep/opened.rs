//! A sweep to be looked at: its folder, or the folder of its results, which has everything that tables are made of.

use std::path::Path;

use crate::base::{Error, Result};
use crate::sweep::verify::Archive;
use crate::sweep::{Definition, Point, Source, SweepFolder, SweepOutputs};

use super::{begun, name_of};

/// A sweep as a folder has it.
pub struct Opened {
    /// Its name.
    pub name: String,
    /// The folder.
    pub folder: SweepFolder,
    /// What was run.
    pub definition: Definition,
    /// Its points.
    pub points: Vec<Point>,
    /// What is kept beside its tables; none of a folder with the points themselves.
    kept: Option<SweepOutputs>,
}

impl Opened {
    /// Of `runs/NAME`, or of `results/NAME`.
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

    /// Refuses results, which `verify` looks after.
    pub fn check_runs(&self) -> Result<()> {
        if self.kept.is_none() {
            return Ok(());
        }
        Err(Error::Config(format!(
            "{} holds results and no points: choose what to show with --rows, --metrics, --baseline or --merge, and a folder with \
             --out; `augnerf verify --update` writes its tables anew",
            self.folder.path().display()
        )))
    }

    /// What the points left.
    pub fn outputs(&self) -> Result<SweepOutputs> {
        match &self.kept {
            Some(outputs) => Ok(outputs.clone()),
            None => SweepOutputs::of_folder(&self.folder, &self.definition, &self.points),
        }
    }

    /// As a view takes it.
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
