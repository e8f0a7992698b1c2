//! Single runs as the points of a table without a sweep definition.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::{Map, Value};

use super::collect::Tables;
use super::comparability::{by_seed, must_match};
use super::layout::TablePosition;
use super::outputs::SweepOutputs;
use super::points::Point;
use super::sweep::TableOptions;
use crate::base::files::read_json;
use crate::base::{Error, Result};
use crate::compare::{differing_settings, labels};
use crate::metrics::{Metric, PSNR, PSNR_FLOAT, PSNR_OF_MEAN, Scope};
use crate::report::tables::Table;
use crate::report::{PointResult, Record, RowSpec, Status, TableSpec, distinct};
use crate::run::{RunDir, cell};
use crate::settings::Config;

const ADVICE: &str = "`augnerf eval` writes it again";
/// Most differing settings in a row's name.
const MOST_SETTINGS: usize = 3;

/// A table of single runs. Runs that differ only in the seed, or have the same given name, are one row.
pub struct RunsTable {
    spec: TableSpec,
    outputs: SweepOutputs,
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

impl RunsTable {
    /// Reads run folders, each under its name in `names` if names are given. The other rows are compared with the
    /// first.
    ///
    /// # Errors
    /// A folder is not a run, was not evaluated, or has another run's evaluation; the numbers of names and runs differ.
    pub fn read(runs: &[PathBuf], names: &[String]) -> Result<RunsTable> {
        if !names.is_empty() && names.len() != runs.len() {
            return Err(Error::Config(format!(
                "--label: {} labels for {} runs; give one label a run, the same one for all seeds of a row",
                names.len(),
                runs.len()
            )));
        }
        let ids = labels(runs, &[])?;
        let mut table = RunsTable {
            spec: TableSpec { name: "runs".into(), ..TableSpec::default() },
            outputs: SweepOutputs::default(),
            points: Vec::new(),
        };
        let configs = runs.iter().map(|run| RunDir::open(run)?.read_config()).collect::<Result<Vec<Config>>>()?;
        let rows = if names.is_empty() { row_names(&configs, &ids) } else { names.to_vec() };
        for (((run, id), config), row) in runs.iter().zip(ids).zip(configs).zip(rows) {
            let [path, _] = RunDir::metrics_in(run);
            let evaluated: Evaluated = read_json(&path, ADVICE)?.ok_or_else(|| {
                Error::Checkpoint(format!(
                    "{} was not evaluated; complete its training, or run `augnerf eval {0}`",
                    run.display()
                ))
            })?;
            if let Some(why) = foreign(&evaluated.protocol, &config) {
                return Err(Error::Checkpoint(format!(
                    "{}: not the run's own evaluation: {why}; `augnerf eval {}` writes it again",
                    path.display(),
                    run.display()
                )));
            }
            table.outputs.read_run(&id, run)?;
            table.add(id, row, config, evaluated);
        }
        table.finish();
        Ok(table)
    }

    fn add(&mut self, id: String, row: String, config: Config, evaluated: Evaluated) {
        let scene = evaluated.protocol.get("scene").map(cell).unwrap_or_default();
        let metrics: Vec<_> = evaluated.mean.iter().map(|(name, value)| (name.clone(), value.as_f64())).collect();
        let inactive = evaluated.attack.iter().filter(|site| site.inactive).map(|site| site.level.clone());
        let record = Record {
            id: id.clone(),
            scene: scene.clone(),
            row: row.clone(),
            seed: Some(config.seed),
            status: Status::Done,
            result: PointResult {
                metrics,
                protocol: evaluated.protocol.iter().map(|(name, value)| (name.clone(), cell(value))).collect(),
                inactive_levels: inactive.collect(),
            },
            ..Record::default()
        };
        self.outputs.records.push(record);
        let places = vec![TablePosition { row, axes: Vec::new() }];
        let source = scene.clone();
        self.points.push(Point {
            id,
            scene,
            source,
            config,
            places,
            on_cpu: false,
            without_budget: false,
            no_data: None,
        });
    }

    /// Sets rows, metrics and title after reading.
    fn finish(&mut self) {
        let records = &self.outputs.records;
        let shown = Metric::in_tables().filter(|metric| {
            let is_wanted =
                matches!(metric.scope, Scope::View | Scope::Mean | Scope::Surface) || metric.key == PSNR.gap().key;
            let is_variant = [PSNR_FLOAT.key, PSNR_OF_MEAN.key].contains(&metric.key);
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
        // No definition says what runs of two seeds share, so they may differ in anything.
        self.spec.by_seed = by_seed(&self.spec.must_match, &self.points);
    }

    /// Returns the number of characters of the longest row name.
    pub fn longest_name(&self) -> usize {
        self.spec.rows.iter().map(|row| row.name.chars().count()).max().unwrap_or(0)
    }

    /// Returns the table, and the page for `folder`. Rows that differ in settings that are not varied are marked.
    pub fn page(&self, folder: &Path, with_timing: bool) -> Result<(Table, String)> {
        let options = TableOptions { force: true, with_timing };
        let tables = Tables { spec: self.spec.clone(), outputs: &self.outputs, points: &self.points, options };
        let mut figures = Vec::new();
        let table = tables.files(&mut figures)?;
        let page = tables.page(&table, &figures, folder)?;
        Ok((table, page))
    }
}

/// Returns why numbers of this protocol are not those of a run of this configuration: another seed or configuration, or
/// training views. Earlier versions wrote fewer columns, and other revisions may hash other settings.
pub(super) fn foreign(protocol: &Map<String, Value>, config: &Config) -> Option<String> {
    let told = |column: &str| protocol.get(column).map(cell).filter(|found| !found.is_empty());
    let is_of_now = told("code_revision").is_some_and(|revision| revision == crate::revision::revision());
    for (column, own) in [("seed", config.seed.to_string()), ("config_hash", config.hash())] {
        if let Some(found) = told(column).filter(|found| *found != own && (column == "seed" || is_of_now)) {
            return Some(format!("its {column} is {found}, that of config.toml is {own}"));
        }
    }
    // They are no split that settings name, so that the hash is the same.
    (told("split")? == "train").then(|| "it is of training views".into())
}

/// Returns the row of each run if no names are given. Runs that differ only in the seed are one row. A row's name is
/// its method with the settings that differ among the rows. If that name is ambiguous in a scene, it is the first
/// run's `id`.
fn row_names(configs: &[Config], ids: &[String]) -> Vec<String> {
    let key = |config: &Config| (config.data.name.clone(), Config { seed: 0, ..config.clone() }.hash());
    let mut rows: Vec<Vec<usize>> = Vec::new();
    for (run, config) in configs.iter().enumerate() {
        let is_other_seed = |row: &&mut Vec<usize>| {
            key(&configs[row[0]]) == key(config) && row.iter().all(|&other| configs[other].seed != config.seed)
        };
        match rows.iter_mut().find(is_other_seed) {
            Some(row) => row.push(run),
            None => rows.push(vec![run]),
        }
    }
    let firsts: Vec<&Config> = rows.iter().map(|row| &configs[row[0]]).collect();
    let called: Vec<(&str, String)> =
        firsts.iter().map(|config| config.data.name.as_str()).zip(called(&firsts)).collect();
    let mut names = vec![String::new(); configs.len()];
    for (row, own) in rows.iter().zip(&called) {
        let is_unique = called.iter().filter(|other| *other == own).count() == 1;
        let name = if is_unique { &own.1 } else { &ids[row[0]] };
        row.iter().for_each(|&run| names[run].clone_from(name));
    }
    names
}

/// Settings that a row's name writes in a form of its own.
const IN_NAME: [&str; 4] = ["method", "data.name", "regularizer.kind", "regularizer.weight"];

/// Returns method, differing regularizers and other differing settings of each configuration: `nerf + tv 8e-5`, `aug-nerf
/// (train.steps 4000)`.
fn called(configs: &[&Config]) -> Vec<String> {
    let differences = differing_settings(configs);
    let regularized = differences.iter().any(|difference| IN_NAME[2..].contains(&difference.name.as_str()));
    let told = differences.iter().filter(|difference| !IN_NAME.contains(&difference.name.as_str()));
    let told: Vec<_> = told.collect();
    let name = |(row, config): (usize, &&Config)| {
        let own = told.iter().filter(|difference| !difference.values[row].is_empty()).take(MOST_SETTINGS);
        let own = own.map(|difference| format!("{} {}", difference.name, difference.values[row]));
        let own = own.collect::<Vec<String>>().join(", ");
        let terms = if regularized { config.regularizer.added() } else { String::new() };
        let method = format!("{}{terms}", config.method.name());
        if own.is_empty() { method } else { format!("{method} ({own})") }
    };
    configs.iter().enumerate().map(name).collect()
}
