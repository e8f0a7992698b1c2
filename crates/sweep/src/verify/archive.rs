//! A results' folder as it was collected: the definition, the points and what they left.

use std::path::{Path, PathBuf};

use crate::base::{Error, Result};
use crate::collect::{PAGE, Tables};
use crate::folder::SweepFolder;
use crate::outputs::{SweepOutputs, optional, read_scalars};
use crate::points::Point;
use crate::provenance::Provenance;
use crate::report::exporters::File;
use crate::report::tables::{Table, read_points, read_timing};
use crate::report::{Status, label};
use crate::settings::columns::column_of_setting;
use crate::sweep::{Sweep, TableOptions};

/// Folders above results in which their runs are looked for.
const MOST_ABOVE: usize = 5;

/// Everything that tables and figures of a sweep are made of, as its results' folder keeps it.
pub struct Archive {
    /// The results' folder.
    pub path: PathBuf,
    /// What was run and what it left, the scenes looked for on this machine.
    pub sweep: Sweep,
    /// Which code made it, and what is not kept.
    pub provenance: Provenance,
    /// Clocks were joined to the tables.
    with_timing: bool,
}

impl Archive {
    /// Reads a results' folder.
    pub fn read(path: &Path, data_root: Option<&Path>) -> Result<Archive> {
        let folder = SweepFolder::new(path);
        let definition = folder.definition()?;
        let absent =
            |name: &str| Error::Data(format!("{} has no {name}: `augnerf sweep collect` writes it", path.display()));
        let points = folder.points(data_root)?.ok_or_else(|| absent("points.json"))?;
        let provenance = Provenance::read(path)?.ok_or_else(|| absent("provenance.toml"))?;
        let in_file = |name: &str, e: String| Error::Data(format!("{}: {e}", path.join(name).display()));
        let text = |name: &str| -> Result<Option<String>> {
            let bytes = optional(&path.join(name))?;
            bytes.map(|bytes| String::from_utf8(bytes).map_err(|e| in_file(name, e.to_string()))).transpose()
        };
        let timing = text("timing.csv")?.map(|text| read_timing(&text)).transpose();
        let timing = timing.map_err(|e| in_file("timing.csv", e))?.unwrap_or_default();
        let clocks: Vec<String> =
            timing.iter().flat_map(|(_, clocks)| clocks.iter().map(|(name, _)| name.clone())).collect();
        let of_points = text("points.csv")?.ok_or_else(|| absent("points.csv"))?;
        // A scene names files: one that is not the point's would name others.
        let read = read_points(&of_points, &provenance.constants(), &clocks, column_of_setting, |found| {
            let point = points.iter().find(|point| point.id == found.id && point.scene == found.scene)?;
            let at = |axes: &[_]| label("", axes).trim_start_matches(", ").to_string();
            point
                .places
                .iter()
                .find(|place| place.row == found.row && at(&place.axes) == found.axes)
                .map(|place| place.axes.clone())
        });
        let records = read.map_err(|e| in_file("points.csv", e))?;
        let head = of_points.lines().next().unwrap_or_default();
        let with_timing = head.split(',').any(|column| clocks.iter().any(|clock| clock == column));
        let outputs = SweepOutputs {
            records,
            timing,
            scalars: read_scalars(path)?,
            step_seconds: optional(&folder.step_seconds())?,
            ..SweepOutputs::default()
        };
        let sweep = Sweep { name: provenance.name.clone(), runs: None, definition, points, outputs };
        Ok(Archive { path: path.to_path_buf(), sweep, provenance, with_timing })
    }

    /// Returns the table, and adds every table and figure to `files`. Rows that may not stand side by side are marked, as `--force` does.
    pub fn files(&self, files: &mut Vec<File>) -> Result<Table> {
        self.tables().files(files)
    }

    fn tables(&self) -> Tables<'_> {
        self.sweep.tables(TableOptions { force: true, with_timing: self.with_timing })
    }

    /// The page of a results' folder: without pictures of views, which lie with the runs.
    pub fn page(&self, runs: Option<&SweepFolder>) -> Result<(Table, String)> {
        let mut figures = Vec::new();
        let table = self.files(&mut figures)?;
        // Those that nothing makes again, as they were committed.
        for name in self.provenance.pinned.keys() {
            if let Some(bytes) = optional(&self.path.join(name))? {
                figures.push((name.clone(), bytes));
            }
        }
        let mut outputs = self.sweep.outputs.clone();
        if let Some(runs) = runs {
            let known = self.done().map(|point| (point.id.clone(), runs.point(&point.id).run()));
            outputs.runs.extend(known.filter(|(_, run)| run.is_dir()));
        }
        let page = Tables { outputs: &outputs, ..self.tables() }.page(&table, &figures, &self.path)?;
        Ok((table, page))
    }

    /// Returns the folder of the sweep's runs, if it is where `sweep run` puts it: around these results, or `runs/NAME` beside a
    /// folder above.
    pub fn runs(&self) -> Option<SweepFolder> {
        let path = self.path.canonicalize().ok()?;
        let above = path.ancestors().skip(1).take(MOST_ABOVE);
        let places = above.enumerate().flat_map(|(up, folder)| {
            let around = (up == 0).then(|| folder.to_path_buf());
            around.into_iter().chain([folder.join("runs").join(&self.provenance.name)])
        });
        let has_runs =
            |folder: &SweepFolder| folder.is_begun() && self.done().any(|point| folder.point(&point.id).run().is_dir());
        places.map(|place| SweepFolder::new(&place)).find(has_runs)
    }

    /// Returns whether the page in the folder was collected with images of the runs.
    pub fn has_collected_page(&self) -> bool {
        self.provenance.pinned.contains_key(PAGE) && self.path.join(PAGE).is_file()
    }

    /// Points that were measured.
    pub fn done(&self) -> impl Iterator<Item = &Point> {
        let done = |id: &str| self.sweep.outputs.records.iter().any(|r| r.id == id && r.status == Status::Done);
        self.sweep.points.iter().filter(move |point| done(&point.id))
    }
}
