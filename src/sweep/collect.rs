//! Tables and figures of a sweep, from its files alone.

use std::path::Path;

use crate::base::files::{read_json, write_atomic};
use crate::base::{Error, Result};
use crate::runtime::Timing;

use super::definition::Definition;
use super::folder::SweepFolder;
use super::points::Point;
use crate::report::exporters::{Collected, EXPORTERS};
use crate::report::plots::Curve;
use crate::report::tables::{PointTiming, Table};
use crate::report::{Status, TableSpec};

/// What is collected, and how.
pub struct Collector<'a> {
    /// Where the points are.
    pub folder: &'a SweepFolder,
    /// What they are points of.
    pub definition: &'a Definition,
    /// All points of the definition, done or not.
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
    /// Writes the files of all exporters. Those that show no rows side by side are written even where rows may not be put
    /// so. Returns the table.
    pub fn write(&self) -> Result<Table> {
        std::fs::create_dir_all(self.results).map_err(|e| Error::unwritable(self.results, &e))?;
        self.clear()?;
        let spec = self.definition.table(self.name, self.points);
        let records = self.folder.records(self.definition, self.points)?;
        let timing = self.timing()?;
        let mut collected = Collected {
            spec: &spec,
            records: &records,
            timing: &timing,
            with_timing: self.with_timing,
            table: None,
            curves: &[],
        };
        self.export(&collected)?;
        let table = Table::new(&spec, &records, self.force)?;
        let scenes = table.scenes().into_iter();
        let curves: Result<Vec<_>> =
            scenes.map(|(scene, _)| Ok((scene.to_string(), self.curves(&spec, scene)?))).collect();
        let curves = curves?;
        (collected.table, collected.curves) = (Some(&table), &curves);
        self.export(&collected)?;
        Ok(table)
    }

    /// The files of the exporters that need a table, or of those that need none.
    fn export(&self, collected: &Collected) -> Result<()> {
        for exporter in EXPORTERS.into_iter().filter(|exporter| exporter.needs_table() == collected.table.is_some()) {
            for (name, bytes) in exporter.export(collected)? {
                write_atomic(&self.results.join(name), &bytes)?;
            }
        }
        Ok(())
    }

    /// Deletes tables and figures of an earlier time, which may not be written again.
    fn clear(&self) -> Result<()> {
        let own = |name: &str| EXPORTERS.iter().any(|exporter| exporter.needs_table() && exporter.owns(name));
        for entry in std::fs::read_dir(self.results).map_err(|e| Error::unreadable(self.results, &e))? {
            let path = entry.map_err(|e| Error::unreadable(self.results, &e))?.path();
            if path.file_name().is_some_and(|name| own(&name.to_string_lossy())) {
                std::fs::remove_file(&path).map_err(|e| Error::unwritable(&path, &e))?;
            }
        }
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
            if folder.state(point)?.status != Status::Done {
                continue;
            }
            let Some(read) = read_json::<Timing>(&path, "delete it to go on")? else { continue };
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
