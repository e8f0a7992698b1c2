//! Tables and figures of a sweep, from its files alone.

use std::path::{Path, PathBuf};

use crate::base::files::write_atomic;
use crate::base::{Error, Result};
use crate::runtime::Timing;

use super::definition::Definition;
use super::folder::SweepFolder;
use super::points::Point;
use crate::report::plots::{Curve, Figure, axes_figure, curves_figure, rows_figure};
use crate::report::tables::{PointTiming, Table, points_csv, table_csv, table_latex, table_markdown};
use crate::report::{Record, Status, TableSpec};

/// What is collected, and how.
pub struct Collector<'a> {
    /// Where the points are.
    pub folder: &'a SweepFolder,
    /// What they are points of.
    pub definition: &'a Definition,
    /// The points.
    pub points: &'a [Point],
    /// The sweep's name.
    pub name: &'a str,
    /// Where tables and figures go.
    pub results: &'a Path,
    /// Put rows side by side that differ in an uncontrolled setting, and mark them.
    pub force: bool,
    /// Join clocks to the tables, which then no longer repeat.
    pub with_timing: bool,
}

impl Collector<'_> {
    /// Writes `points.csv`, `timing.csv`, `table.csv`, `table.md`, `table.tex`. The first two are
    /// written even where rows may not be put side by side. Returns the table.
    pub fn write(&self) -> Result<Table> {
        std::fs::create_dir_all(self.results).map_err(|e| Error::unwritable(self.results, &e))?;
        self.clear()?;
        let spec = self.definition.table(self.name, self.points);
        let records = self.folder.records(self.definition, self.points)?;
        let timing = self.timing()?;
        let joined = if self.with_timing { timing.as_slice() } else { &[] };
        self.file("points.csv", points_csv(&records, joined).as_bytes())?;
        self.file("timing.csv", self.timing_csv(&timing)?.as_slice())?;
        let table = Table::new(&spec, &records, self.force)?;
        self.file("table.csv", table_csv(&table, joined).as_bytes())?;
        self.file("table.md", table_markdown(&table).as_bytes())?;
        self.file("table.tex", table_latex(&table).as_bytes())?;
        self.figures(&spec, &records, &table)?;
        Ok(table)
    }

    /// Deletes tables and figures of an earlier time, which may not be written again.
    fn clear(&self) -> Result<()> {
        let own = |name: &str| {
            let figure = ["rows_", "axes_", "curves_"].iter().any(|kind| name.starts_with(kind));
            name.starts_with("table.") || figure && (name.ends_with(".svg") || name.ends_with(".png"))
        };
        for entry in std::fs::read_dir(self.results).map_err(|e| Error::unreadable(self.results, &e))? {
            let path = entry.map_err(|e| Error::unreadable(self.results, &e))?.path();
            if path.file_name().is_some_and(|name| own(&name.to_string_lossy())) {
                std::fs::remove_file(&path).map_err(|e| Error::unwritable(&path, &e))?;
            }
        }
        Ok(())
    }

    fn file(&self, name: &str, bytes: &[u8]) -> Result<PathBuf> {
        let path = self.results.join(name);
        write_atomic(&path, bytes)?;
        Ok(path)
    }

    /// `rows_SCENE_METRIC`, `axes_SCENE_METRIC` and `curves_SCENE_psnr`, each as SVG and PNG.
    fn figures(&self, spec: &TableSpec, records: &[Record], table: &Table) -> Result<()> {
        for (scene, _) in table.scenes() {
            for metric in &table.metrics {
                let rows =
                    if self.definition.axis.is_empty() { rows_figure(table, records, scene, metric)? } else { None };
                self.figure(&format!("rows_{scene}_{metric}"), rows)?;
                self.figure(&format!("axes_{scene}_{metric}"), axes_figure(spec, records, scene, metric)?)?;
            }
            let title = format!("{}: training on {scene}", self.definition.title);
            let curves = curves_figure(&title, "PSNR of the step's rays (dB)", &self.curves(spec, scene)?)?;
            self.figure(&format!("curves_{scene}_psnr"), curves)?;
        }
        Ok(())
    }

    fn figure(&self, name: &str, figure: Option<Figure>) -> Result<()> {
        let Some(figure) = figure else { return Ok(()) };
        self.file(&format!("{name}.svg"), figure.svg.as_bytes())?;
        self.file(&format!("{name}.png"), &figure.png)?;
        Ok(())
    }

    /// Training PSNR of the points without axis values, row by row.
    fn curves(&self, spec: &TableSpec, scene: &str) -> Result<Vec<Curve>> {
        let mut curves = Vec::new();
        for row in &spec.rows {
            let own = |point: &&Point| {
                point.scene == scene && point.places.iter().any(|place| place.row == row.name && place.axes.is_empty())
            };
            let mut seeds = Vec::new();
            for point in self.points.iter().filter(own) {
                let folder = self.folder.point(&point.id);
                if folder.state(point)?.status == Status::Done {
                    seeds
                        .extend(Some(psnr_curve(&folder.run().join("scalars.csv"))?).filter(|curve| !curve.is_empty()));
                }
            }
            if !seeds.is_empty() {
                curves.push(Curve { label: row.name.clone(), seeds });
            }
        }
        Ok(curves)
    }

    /// Clocks of the points that are done.
    fn timing(&self) -> Result<Vec<PointTiming>> {
        let mut timing = Vec::new();
        for point in self.points {
            let folder = self.folder.point(&point.id);
            let path = folder.run().join("timing.json");
            if folder.state(point)?.status != Status::Done || !path.exists() {
                continue;
            }
            let bytes = std::fs::read(&path).map_err(|e| Error::unreadable(&path, &e))?;
            let read: Timing = serde_json::from_slice(&bytes)
                .map_err(|e| Error::Checkpoint(format!("cannot read {}: {e}; delete it to go on", path.display())))?;
            let clocks = [
                ("seconds_training", Some(read.seconds_training)),
                ("seconds_evaluation", Some(read.seconds_evaluation)),
                ("rays_per_second", read.rays_per_second),
                ("peak_memory_mib", read.peak_memory_mib),
                ("threads", Some(read.threads as f64)),
                ("sessions", Some(read.sessions as f64)),
            ];
            timing.push((point.id.clone(), clocks.map(|(name, value)| (name.to_string(), value)).to_vec()));
        }
        Ok(timing)
    }

    /// One line a measured point; a point that stands in several rows has one.
    fn timing_csv(&self, timing: &[PointTiming]) -> Result<Vec<u8>> {
        let unwritable = |e: &dyn std::fmt::Display| {
            Error::Output(format!("cannot write {}: {e}", self.results.join("timing.csv").display()))
        };
        let mut writer = csv::Writer::from_writer(Vec::new());
        let names = timing.first().map(|(_, clocks)| clocks.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>());
        let header = ["id", "point"].into_iter().chain(names.unwrap_or_default());
        writer.write_record(header).map_err(|e| unwritable(&e))?;
        for (id, clocks) in timing {
            let point = self.points.iter().find(|point| point.id == *id).expect("its timing was read");
            let clocks = clocks.iter().map(|(_, value)| value.map_or(String::new(), |value| value.to_string()));
            let row = [id.clone(), point.label()].into_iter().chain(clocks);
            writer.write_record(row).map_err(|e| unwritable(&e))?;
        }
        writer.into_inner().map_err(|e| unwritable(&e))
    }
}

/// Step and PSNR of a run's log; empty where it has none, or is gone.
fn psnr_curve(path: &Path) -> Result<Vec<(f64, f64)>> {
    if !path.exists() {
        return Ok(Vec::new());
    }
    let unreadable = |e: csv::Error| Error::Checkpoint(format!("cannot read {}: {e}", path.display()));
    let mut reader = csv::Reader::from_path(path).map_err(unreadable)?;
    let header = reader.headers().map_err(unreadable)?;
    let column = |name: &str| header.iter().position(|known| known == name);
    let (Some(step), Some(psnr)) = (column("step"), column("psnr")) else { return Ok(Vec::new()) };
    let mut points = Vec::new();
    for row in reader.records() {
        let row = row.map_err(unreadable)?;
        let cell = |column: usize| row.get(column).and_then(|cell| cell.parse().ok());
        points.extend(cell(step).zip(cell(psnr)));
    }
    Ok(points)
}
