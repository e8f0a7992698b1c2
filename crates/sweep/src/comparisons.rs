//! Rows compared over several sweeps or their scenes, and the folder that keeps the comparison.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::base::files::write_atomic;
use crate::base::input::{TEXT_BYTES, read_text};
use crate::base::{Error, Result};
use crate::report::exporters::File;
use crate::report::plots::comparisons_figure;
use crate::report::tables::Table;
use crate::report::{Comparisons, Record, Unit, distinct};
use crate::settings::registry::{Effect, REGISTRY};
use crate::settings::value_at;

use super::collect::holds_files;
use super::folder::DEFINITION;
use super::points::Point;
use super::sweep::Sweep;
use super::view::{Origin, VIEW, View};
use super::words::{check_name, quoted};

/// The file that a folder of a comparison over sweeps has instead of a sweep's definition.
pub const ACROSS: &str = "across.toml";
/// The same of rows over scenes.
pub const OVER_SCENES: &str = "over_scenes.toml";
/// A line a scene and row.
const SCENES_CSV: &str = "scenes.csv";

/// The question, and the sweeps: `across.toml` or `over_scenes.toml`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ComparisonRequest {
    /// The row that is compared in each sweep; `None` compares rows over the sweeps' scenes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub row: Option<String>,
    /// What rows are compared with.
    pub baseline: String,
    /// Key of the metric.
    pub metric: String,
    /// Chosen rows over scenes; empty for all.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub rows: Vec<String>,
    /// Chosen scenes; empty for all.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub scenes: Vec<String>,
    /// Chosen seeds over scenes; empty for all.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub seeds: Vec<u64>,
    /// The sweeps, in the order of the comparisons.
    #[serde(default)]
    pub sweep: Vec<Origin>,
}

impl ComparisonRequest {
    /// Compares rows of `sources`, which replace `self.sweep`. `labels` are what some sweeps are called instead of their names.
    ///
    /// # Errors
    /// An unknown row, scene, seed, metric or label; a sweep or scene that counts twice; rows that are not comparable. Over
    /// scenes, also rows that differ in an uncontrolled setting between two sweeps, and sweeps that state different margins.
    pub fn answer(
        mut self,
        sources: &[Sweep],
        labels: &[(String, String)],
    ) -> Result<(ComparisonRequest, Comparisons)> {
        if sources.is_empty() {
            return Err(Error::Config("no sweep is named: a comparison needs at least one".into()));
        }
        self.sweep = sources.iter().map(Origin::of).collect();
        let comparisons = match self.row.clone() {
            Some(row) => self.over_sweeps(&row, sources, labels),
            None => self.over_scenes(sources),
        };
        Ok((self, comparisons?))
    }

    fn over_sweeps(&mut self, row: &str, sources: &[Sweep], labels: &[(String, String)]) -> Result<Comparisons> {
        if row == self.baseline {
            return Err(Error::Config(format!("--row and --baseline are both '{row}'; name two rows")));
        }
        let mut tables = Vec::new();
        for (index, source) in sources.iter().enumerate() {
            if sources[..index].iter().any(|other| other.name == source.name) {
                return Err(Error::Config(format!("sweep '{}' is named twice: each is one block", source.name)));
            }
            [row, &self.baseline].into_iter().try_for_each(|name| has_row(source, name))?;
            let view = self.view(source, &[self.baseline.clone(), row.into()])?;
            tables.push(of_sweep(source, table_of(&view, view.records()))?);
        }
        for (name, label) in labels {
            check_name("a label", label).map_err(Error::Config)?;
            let Some(origin) = self.sweep.iter_mut().find(|origin| origin.name == *name) else {
                let names: Vec<&str> = sources.iter().map(|source| source.name.as_str()).collect();
                return Err(Error::Config(format!("--label {name}: the sweeps are {}", names.join(", "))));
            };
            origin.label = Some(label.clone());
        }
        Ok(Comparisons::over_sweeps(row, &self.baseline, &tables, labels))
    }

    fn over_scenes(&mut self, sources: &[Sweep]) -> Result<Comparisons> {
        check_apart(sources)?;
        let mut rows = self.rows.clone();
        if !rows.is_empty() {
            rows.insert(0, self.baseline.clone());
        }
        let views = sources.iter().map(|source| self.view(source, &rows)).collect::<Result<Vec<View>>>()?;
        let (baseline, metric) = (&self.baseline, &self.metric);
        check_alike(sources, &distinct(views.iter().flat_map(View::rows)))?;
        if distinct(views.iter().map(|view| view.spec.margin(metric))).len() > 1 {
            return Err(Error::Config(format!("the sweeps state different margins of '{metric}' (equivalence)")));
        }
        if !self.rows.is_empty() {
            self.rows = views[0].rows().filter(|row| row != baseline).map(String::from).collect();
        }
        let records: Vec<Vec<Record>> = views.iter().map(|view| view.records().to_vec()).collect();
        self.check_chosen(&records)?;
        let mut tables = Vec::new();
        for ((source, view), records) in sources.iter().zip(&views).zip(records) {
            let chosen: Vec<Record> = records.into_iter().filter(|record| self.is_chosen(record)).collect();
            if !chosen.is_empty() {
                tables.push(of_sweep(source, table_of(view, &chosen))?);
            }
        }
        let found = Comparisons::over_scenes(baseline, &tables);
        if found.lines.iter().all(|line| line.comparison.is_none()) {
            return Err(Error::Config(format!("no row has '{metric}' on a scene on which '{baseline}' has it")));
        }
        Ok(found)
    }

    /// Returns rows of one sweep; all, if none is named.
    fn view(&self, source: &Sweep, rows: &[String]) -> Result<View> {
        of_sweep(source, View::compared(source, &self.baseline, rows, &self.metric))
    }

    fn check_chosen(&self, records: &[Vec<Record>]) -> Result<()> {
        let known = distinct(records.iter().flatten().map(|record| &record.scene));
        if let Some(unknown) = self.scenes.iter().find(|scene| !known.contains(scene)) {
            return Err(Error::Config(format!("--scenes {unknown}: the scenes are {}", quoted(&known))));
        }
        let known: Vec<u64> = distinct(records.iter().flatten().filter_map(|record| record.seed));
        if let Some(unknown) = self.seeds.iter().find(|seed| !known.contains(seed)) {
            return Err(Error::Config(format!("--seeds {unknown}: the seeds are {}", listed(&known))));
        }
        Ok(())
    }

    fn is_chosen(&self, record: &Record) -> bool {
        let of_seed = self.seeds.is_empty() || record.seed.is_some_and(|seed| self.seeds.contains(&seed));
        of_seed && (self.scenes.is_empty() || self.scenes.contains(&record.scene))
    }

    /// Returns what sweeps are called instead of their names.
    pub fn labels(&self) -> Vec<(String, String)> {
        self.sweep.iter().filter_map(|sweep| Some((sweep.name.clone(), sweep.label.clone()?))).collect()
    }

    /// Returns the name of the file that a folder keeps the request in.
    pub fn file(&self) -> &'static str {
        if self.row.is_some() { ACROSS } else { OVER_SCENES }
    }

    /// Reads a folder's.
    pub fn read(folder: &Path) -> Result<ComparisonRequest> {
        let name = if folder.join(OVER_SCENES).exists() { OVER_SCENES } else { ACROSS };
        let path = folder.join(name);
        let text = read_text(&path, TEXT_BYTES).map_err(|e| Error::unreadable(&path, &e))?;
        let wrong = |what: &str| Error::Data(format!("{}: {what}", path.display()));
        let request: ComparisonRequest = toml::from_str(&text).map_err(|e| wrong(&e.to_string()))?;
        if request.file() != name {
            return Err(wrong(&format!("`row` is named in {ACROSS} alone, and always there")));
        }
        Ok(request)
    }

    /// Returns the files of the folder with their names.
    pub fn files(&self, comparisons: &Comparisons) -> Vec<File> {
        let file = self.file();
        let stem = file.trim_end_matches(".toml");
        let request = toml::to_string(self).expect("plain data");
        let mut texts = vec![
            (file.to_string(), request),
            (format!("{stem}.csv"), comparisons.csv()),
            (format!("{stem}.md"), self.page(comparisons)),
        ];
        if comparisons.unit == Unit::Scene {
            texts.push((SCENES_CSV.into(), comparisons.scenes_csv()));
        }
        let figure = comparisons_figure(comparisons).into_iter().flat_map(|figure| figure.files(stem));
        texts.into_iter().map(|(name, text)| (name, text.into_bytes())).chain(figure).collect()
    }

    /// Returns the comparisons for readers, with the seeds if some are chosen.
    pub fn page(&self, comparisons: &Comparisons) -> String {
        let seeds = listed(&self.seeds);
        let note = if seeds.is_empty() { String::new() } else { format!("- of seeds {seeds} alone\n") };
        comparisons.markdown() + &note
    }

    /// Writes the files into a folder, which may hold pages beside them.
    ///
    /// # Errors
    /// A folder with tables of a sweep, with the other kind of comparison, with other folders, or with files that are no
    /// comparison.
    pub fn write(&self, comparisons: &Comparisons, folder: &Path) -> Result<()> {
        let has = |name: &str| folder.join(name).exists();
        let other = if self.row.is_some() { OVER_SCENES } else { ACROSS };
        let mut entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        let holds = match () {
            () if has(DEFINITION) || has(VIEW) => "tables of a sweep".into(),
            () if has(other) => format!("another comparison ({other})"),
            () if entries.any(|entry| entry.path().is_dir()) => "other folders".into(),
            () if !has(self.file()) && holds_files(folder, &[]) => "files that are not a comparison of sweeps".into(),
            () => String::new(),
        };
        if !holds.is_empty() {
            let folder = folder.display();
            return Err(Error::Output(format!("{folder} holds {holds}: name another folder with --out")));
        }
        std::fs::create_dir_all(folder).map_err(|e| Error::unwritable(folder, &e))?;
        self.files(comparisons).iter().try_for_each(|(name, bytes)| write_atomic(&folder.join(name), bytes))
    }
}

fn listed(seeds: &[u64]) -> String {
    seeds.iter().map(u64::to_string).collect::<Vec<String>>().join(", ")
}

/// The table of chosen records of a view.
fn table_of(view: &View, records: &[Record]) -> Result<Table> {
    Table::new(&view.spec, records, false)
}

fn of_sweep<T>(source: &Sweep, made: Result<T>) -> Result<T> {
    made.map_err(|error| error.within(&format!("sweep '{}'", source.name)))
}

fn has_row(source: &Sweep, name: &str) -> Result<()> {
    let rows: Vec<&str> = source.definition.row.iter().map(|row| row.name.as_str()).collect();
    if rows.contains(&name) {
        return Ok(());
    }
    Err(Error::Config(format!("sweep '{}' has no row '{name}'; its rows are {}", source.name, quoted(&rows))))
}

/// Requires that no scene is in two sweeps: their seeds would be mixed.
fn check_apart(sources: &[Sweep]) -> Result<()> {
    for (index, source) in sources.iter().enumerate() {
        let scenes = distinct(source.points.iter().map(|point| point.scene.as_str()));
        let other = sources[..index].iter().find_map(|other| {
            let shared = other.points.iter().find(|point| scenes.contains(&point.scene.as_str()))?;
            Some((other, &shared.scene))
        });
        if let Some((other, scene)) = other {
            return Err(Error::Config(format!(
                "scene '{scene}' is in sweep '{}' and in sweep '{}'; a scene counts once: name sweeps of different scenes",
                other.name, source.name
            )));
        }
    }
    Ok(())
}

/// Requires that a row is the same in all sweeps, but for what goes with the scene or the seed.
fn check_alike(sources: &[Sweep], rows: &[&str]) -> Result<()> {
    let free: Vec<String> = sources.iter().flat_map(|source| source.definition.own_settings()).collect();
    for row in rows {
        let mut own = sources.iter().filter_map(|source| Some((&source.name, settings_of(source, row, &free)?)));
        let Some((first, theirs)) = own.next() else { continue };
        for (name, settings) in own {
            let differs = settings.iter().zip(&theirs).find(|(a, b)| a != b);
            if let Some(((path, a), (_, b))) = differs {
                return Err(Error::NotComparable(format!(
                    "row '{row}' has {path} = {b} in sweep '{first}' and {a} in sweep '{name}': scenes are taken together if \
                     rows differ in by_scene and by_seed alone; `--unit sweep` compares each sweep by itself"
                )));
            }
        }
    }
    Ok(())
}

/// Settings of the data that say what a field is trained on; the others of them are the scene's own, such as its size.
const OF_TRAINING: [&str; 4] = ["data.train_views", "data.corruption.", "data.eval_split", "data.validation"];

/// The settings of a row's first point that change numbers, but for `free` ones, the seed and the scene's own.
fn settings_of(source: &Sweep, row: &str, free: &[String]) -> Option<Vec<(String, String)>> {
    let is_own = |path: &str| {
        path == "seed" || path.starts_with("data.") && !OF_TRAINING.iter().any(|start| path.starts_with(start))
    };
    let is_of_row = |point: &&Point| point.places.iter().any(|place| place.row == row);
    let table = source.points.iter().find(is_of_row)?.config.to_table();
    let settings = REGISTRY.settings.iter().filter(|setting| setting.rule.effect == Effect::Numbers);
    let paths = settings.map(|setting| setting.path.as_str());
    let bound = paths.filter(|path| !is_own(path) && !free.iter().any(|own| own == path));
    let text = |path: &str| value_at(&table, path).map_or("nothing".to_string(), ToString::to_string);
    Some(bound.map(|path| (path.to_string(), text(path))).collect())
}
