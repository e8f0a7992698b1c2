//! Makes the tables and figures of a sweep from its files.

use std::fs;
use std::path::{Path, PathBuf};

use crate::base::files::{check_own, clean_temporaries, remove, wait_and_hold, write_atomic};
use crate::base::{Error, Result};

use super::folder::{STEP_SECONDS, SweepFolder};
use super::outputs::SweepOutputs;
use super::points::Point;
use super::provenance::Provenance;
use super::sweep::TableOptions;
use crate::report::exporters::{self, Comparable, File, is_made};
use crate::report::plots::{Curve, Seeds};
use crate::report::tables::{AttackLine, Table};
use crate::report::{RowSpec, Status, TableSpec};
use crate::settings::columns::column_of_setting;

/// The page's file in a results folder. It shows the content of the other files, and images of the runs.
pub const PAGE: &str = "report.html";
/// Clock times of the points.
pub(super) const TIMING: &str = "timing.csv";

/// Checks that the results of the sweep `name` in `folder` may be written to `results`, where old tables and figures
/// are deleted: it is missing or empty, or holds results of the same sweep.
///
/// # Errors
/// [`Error::Output`]: it holds results of another sweep, or other files.
pub fn check_results_place(results: &Path, name: &str, folder: &SweepFolder) -> Result<()> {
    let absolute = |path: &Path| std::path::absolute(path).map_err(|e| Error::unreadable(path, &e));
    // A sweep in a folder of its own may have had another name.
    let is_inside = absolute(results)?.parent() == Some(absolute(folder.path())?.as_path());
    if is_inside {
        check_own(results, true)?;
    }
    if !results.is_dir() {
        return Ok(());
    }
    let holds = match Provenance::read(results)? {
        Some(earlier) if is_inside || earlier.name == name => return Ok(()),
        Some(earlier) => format!("results of the sweep '{}', which those of '{name}' would replace", earlier.name),
        // Seconds of steps are taken over from there.
        None if !holds_files(results, &[STEP_SECONDS]) => return Ok(()),
        None => "files that are not results of a sweep".into(),
    };
    Err(Error::Output(format!("{} holds {holds}; name another folder with --out", results.display())))
}

/// Returns whether a folder holds more than hidden entries, pages, what systems leave, and the files named in `besides`.
pub(super) fn holds_files(folder: &Path, besides: &[&str]) -> bool {
    let names = fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.file_name());
    names
        .map(|name| name.to_string_lossy().into_owned())
        .any(|name| !is_ignored(&name) && !besides.contains(&name.as_str()))
}

fn is_ignored(name: &str) -> bool {
    name.starts_with('.') || ["README.md", "desktop.ini", "Thumbs.db"].contains(&name)
}

/// A locked results folder, until the value is dropped. Of several processes that collect into one folder, each writes
/// the state that it saw under the lock. If the file system has no locks, each file is still complete.
pub struct Results {
    path: PathBuf,
    _held: Option<fs::File>,
}

impl Results {
    /// Creates the folder, waits for its lock, and deletes the remains of killed processes.
    pub fn take(path: &Path) -> Result<Results> {
        // In a sweep's folder, which may be somebody else's, it is not a place that the user named.
        let is_of_sweep = path.parent().is_some_and(|parent| SweepFolder::new(parent).is_begun());
        if is_of_sweep {
            check_own(path, true)?;
        }
        fs::create_dir_all(path).map_err(|e| Error::unwritable(path, &e))?;
        let held = wait_and_hold(path);
        if held.is_some() {
            clean_temporaries(path)?;
        }
        Ok(Results { path: path.to_path_buf(), _held: held })
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes files into the folder, and deletes old tables and figures that are not among them.
    pub(super) fn put(&self, files: &[File]) -> Result<()> {
        files.iter().try_for_each(|(name, bytes)| write_atomic(&self.path.join(name), bytes))?;
        self.delete_others(files)
    }

    fn delete_others(&self, written: &[File]) -> Result<()> {
        let own = |name: &str| name == PAGE || is_made(name);
        for entry in fs::read_dir(&self.path).map_err(|e| Error::unreadable(&self.path, &e))? {
            let path = entry.map_err(|e| Error::unreadable(&self.path, &e))?.path();
            let Some(name) = path.file_name().map(|name| name.to_string_lossy()) else { continue };
            if own(&name) && !written.iter().any(|(written, _)| *written == name) {
                remove(&path).map_err(|e| Error::unwritable(&path, &e))?;
            }
        }
        Ok(())
    }
}

/// Inputs of a table: all rows of a sweep, or chosen rows of several.
pub(super) struct Tables<'a> {
    /// The rows, metrics and title.
    pub spec: TableSpec,
    /// Outputs of the points.
    pub outputs: &'a SweepOutputs,
    /// The points.
    pub points: &'a [Point],
    /// How rows are shown.
    pub options: TableOptions,
}

impl Tables<'_> {
    /// Returns the table and adds all files, with the page if there is a table.
    pub fn write(&self, results: &Results, files: &mut Vec<File>) -> Result<Table> {
        let table = self.files(files)?;
        let page = self.page(&table, files, &results.path)?;
        files.push((PAGE.into(), page.into_bytes()));
        Ok(table)
    }

    /// Returns the table, and adds all tables and figures to `files`. Files that show no rows side by side come first;
    /// the others are made only if rows are comparable.
    pub fn files(&self, files: &mut Vec<File>) -> Result<Table> {
        let records = &self.outputs.records;
        let points = exporters::Points {
            spec: &self.spec,
            records,
            timing: &self.outputs.timing,
            with_timing: self.options.with_timing,
            constants: self.outputs.constants(),
            column_of: column_of_setting,
        };
        files.extend(points.files());
        let table = Table::new(&self.spec, records, self.options.force)?;
        let scenes: Vec<&str> = table.scenes().into_iter().map(|(scene, _)| scene).collect();
        let curves: Vec<_> = scenes.iter().map(|scene| (scene.to_string(), self.curves(scene))).collect();
        let attacks = self.attacks(&table);
        files.extend(Comparable { points: &points, table: &table, curves: &curves, attacks: &attacks }.files());
        Ok(table)
    }

    /// Returns PSNR curves of the points without axis values, row by row: of training rays and of held-out views.
    fn curves(&self, scene: &str) -> Vec<Curve> {
        let mut curves = Vec::new();
        for row in &self.spec.rows {
            let points = self.done(scene, row);
            let of = |column: &str| self.logged(&points, column);
            let seeds = of("psnr");
            if !seeds.is_empty() {
                let (held_out, seen) = (of("test_psnr"), of("train_psnr"));
                curves.push(Curve { label: row.name.clone(), seeds, held_out, seen });
            }
        }
        curves
    }

    /// Returns the effect of the attack, line by line of a table.
    pub(super) fn attacks<'t>(&self, table: &'t Table) -> Vec<AttackLine<'t>> {
        let scalars = &self.outputs.scalars;
        let numbers = |id: &str, column: &str| scalars.get(id).map_or(Vec::new(), |scalars| scalars.numbers(column));
        table.lines.iter().filter_map(|line| AttackLine::of(line, numbers)).collect()
    }

    /// Returns a row's points without axis values.
    fn plain<'s>(&'s self, scene: &str, row: &RowSpec) -> impl Iterator<Item = &'s Point> {
        let own = move |point: &&Point| {
            point.scene == scene && point.places.iter().any(|place| place.row == row.name && place.axes.is_empty())
        };
        self.points.iter().filter(own)
    }

    /// Returns those that are done.
    fn done(&self, scene: &str, row: &RowSpec) -> Vec<&Point> {
        let done = |point: &&Point| {
            self.outputs.records.iter().any(|record| record.id == point.id && record.status == Status::Done)
        };
        self.plain(scene, row).filter(done).collect()
    }

    /// Returns a column of the points' logs against steps, for points that have it.
    fn logged(&self, points: &[&Point], column: &str) -> Seeds {
        let scalars = points.iter().filter_map(|point| self.outputs.scalars.get(&point.id));
        scalars.map(|scalars| scalars.pairs("step", column)).filter(|curve| !curve.is_empty()).collect()
    }
}
