//! Single runs as the points of a table that no definition asked for.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::{Map, Value};

use super::collect::Sheet;
use super::comparability::must_match;
use super::layout::Place;
use super::material::Material;
use super::points::Point;
use crate::base::files::read_json;
use crate::base::{Error, Result};
use crate::compare::labels;
use crate::metrics::{Metric, Scope};
use crate::report::exporters::File;
use crate::report::tables::Table;
use crate::report::{Record, RowSpec, Status, TableSpec, distinct};
use crate::run::RunDir;
use crate::settings::Config;

const ADVICE: &str = "`augnerf eval` writes it anew";

/// Runs side by side: those that differ in nothing but the seed, or were given one name, are one row.
pub struct RunsSheet {
    spec: TableSpec,
    material: Material,
    points: Vec<Point>,
}

/// `metrics.json`.
#[derive(Deserialize)]
struct Evaluated {
    mean: Map<String, Value>,
    protocol: Map<String, Value>,
    #[serde(default)]
    attack: Vec<SiteState>,
}

#[derive(Deserialize)]
struct SiteState {
    level: String,
    inactive: bool,
}

impl RunsSheet {
    /// Of run folders, each under its name of `names` where there are any. The first row is what others are compared with.
    ///
    /// # Errors
    /// A folder that is no run, or was not evaluated; fewer or more names than runs.
    pub fn read(runs: &[PathBuf], names: &[String]) -> Result<RunsSheet> {
        if !names.is_empty() && names.len() != runs.len() {
            return Err(Error::Config(format!(
                "--label: there are {} for {} runs; give one for each run, the same one for seeds of one row",
                names.len(),
                runs.len()
            )));
        }
        let ids = labels(runs, &[])?;
        let mut sheet = RunsSheet {
            spec: TableSpec { name: "runs".into(), ..TableSpec::default() },
            material: Material::default(),
            points: Vec::new(),
        };
        let mut settings: Vec<(String, String)> = Vec::new();
        for (index, (run, id)) in runs.iter().zip(ids).enumerate() {
            let config = RunDir::open(run)?.read_config()?;
            let [path, _] = RunDir::metrics_in(run);
            let evaluated: Evaluated = read_json(&path, ADVICE)?.ok_or_else(|| {
                Error::Checkpoint(format!(
                    "{} was not evaluated: let its training end, or run `augnerf eval {0}`",
                    run.display()
                ))
            })?;
            let row = match names.get(index) {
                Some(name) => name.clone(),
                None => sheet.row_of(&config, &id, &mut settings),
            };
            sheet.material.read_run(&id, run)?;
            sheet.add(id, row, config, evaluated);
        }
        sheet.finish();
        Ok(sheet)
    }

    /// The row of runs that differ from this one in their seed, where one has no such seed yet; otherwise a row of its own.
    fn row_of(&self, config: &Config, id: &str, settings: &mut Vec<(String, String)>) -> String {
        let key = format!("{} {}", config.data.name, Config { seed: 0, ..config.clone() }.hash());
        let taken = |row: &str| self.material.records.iter().any(|r| r.row == row && r.seed == Some(config.seed));
        if let Some((_, row)) = settings.iter().find(|(known, row)| *known == key && !taken(row)) {
            return row.clone();
        }
        settings.push((key, id.to_string()));
        id.to_string()
    }

    fn add(&mut self, id: String, row: String, config: Config, evaluated: Evaluated) {
        let text = |value: &Value| match value {
            Value::Null => String::new(),
            Value::String(text) => text.clone(),
            other => other.to_string(),
        };
        let scene = evaluated.protocol.get("scene").map(text).unwrap_or_default();
        let metrics: Vec<_> = evaluated.mean.iter().map(|(name, value)| (name.clone(), value.as_f64())).collect();
        let inactive = evaluated.attack.iter().filter(|site| site.inactive).map(|site| site.level.clone());
        self.material.records.push(Record {
            id: id.clone(),
            scene: scene.clone(),
            row: row.clone(),
            axes: Vec::new(),
            seed: Some(config.seed),
            status: Status::Done,
            reason: String::new(),
            metrics,
            protocol: evaluated.protocol.iter().map(|(name, value)| (name.clone(), text(value))).collect(),
            inactive_levels: inactive.collect(),
        });
        let places = vec![Place { row, axes: Vec::new() }];
        let source = scene.clone();
        self.points.push(Point { id, scene, source, config, places, without_budget: false, no_data: None });
    }

    /// Rows, metrics and title of what was read.
    fn finish(&mut self) {
        let records = &self.material.records;
        let shown = Metric::in_tables().filter(|metric| {
            let is_wanted = matches!(metric.scope, Scope::View | Scope::Mean | Scope::Surface) || metric.key == "gap";
            let is_variant = ["psnr_float", "psnr_of_mean"].contains(&metric.key);
            is_wanted && !is_variant && records.iter().any(|record| record.metric(metric.key).is_some())
        });
        self.spec.metrics = shown.map(|metric| metric.key.to_string()).collect();
        let names = distinct(records.iter().map(|record| record.row.clone()));
        let row = |name: &String| RowSpec {
            name: name.clone(),
            baseline: (*name != names[0]).then(|| names[0].clone()),
            ..RowSpec::default()
        };
        self.spec.rows = names.iter().map(row).collect();
        let scenes = distinct(records.iter().map(|record| record.scene.as_str())).join(", ");
        self.spec.title = match names.as_slice() {
            [name] => format!("{name} on {scenes}"),
            _ => format!("{} on {scenes}", names.join(", ")),
        };
        self.spec.must_match = must_match(&self.spec.metrics, &self.points);
    }

    /// The table, and the page as it lies in `folder`. Rows that differ in what is not varied are marked.
    pub fn page(&self, folder: &Path, with_timing: bool) -> Result<(Table, String)> {
        let sheet =
            Sheet { spec: &self.spec, material: &self.material, points: &self.points, force: true, with_timing };
        let mut files: Vec<File> = Vec::new();
        let table = sheet.files(&mut |name, bytes| {
            files.push((name.into(), bytes.to_vec()));
            Ok(())
        })?;
        let page = sheet.page(&table, &files, folder)?;
        Ok((table, page))
    }
}
