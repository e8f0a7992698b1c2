//! Rows against a baseline over the scenes of sweeps, and the folder that keeps the comparison.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::base::input::{TEXT_BYTES, read_text};
use crate::base::{Error, Result};
use crate::report::exporters::Content;
use crate::report::plots::{Width, over_scenes_figure};
use crate::report::{OverScenes, Record, distinct};
use crate::settings::registry::{Effect, REGISTRY};
use crate::settings::value_at;

use super::across::{ACROSS, write_folder};
use super::points::Point;
use super::view::{Origin, Selection, Source, View};
use super::words::quoted;

/// What a folder of such a comparison has instead of a sweep's definition.
pub const OVER_SCENES: &str = "over_scenes.toml";
/// For readers; a page of the folder that is made.
pub const OVER_SCENES_PAGE: &str = "over_scenes.md";
/// A line a row.
pub const OVER_SCENES_CSV: &str = "over_scenes.csv";
/// A line a scene and row.
pub const SCENES_CSV: &str = "scenes.csv";
/// The figure's name, without its ending.
const FIGURE: &str = "over_scenes";

/// The question, and the sweeps: `over_scenes.toml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScenesRequest {
    /// What rows are compared with.
    pub baseline: String,
    /// Key of the metric.
    pub metric: String,
    /// Chosen rows; empty for all.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub rows: Vec<String>,
    /// Chosen scenes; empty for all.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub scenes: Vec<String>,
    /// Chosen seeds; empty for all.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub seeds: Vec<u64>,
    /// The sweeps whose scenes are taken together.
    #[serde(default)]
    pub sweep: Vec<Origin>,
}

impl ScenesRequest {
    /// Compares rows with the baseline over all scenes of `sources`, which replace `self.sweep`.
    ///
    /// # Errors
    /// An unknown row, scene, seed or metric; a scene in two sweeps; rows that differ in an uncontrolled setting, within a sweep or
    /// between two; sweeps that state different margins.
    pub fn answer(mut self, sources: &[Source]) -> Result<(ScenesRequest, OverScenes)> {
        self.sweep = sources.iter().map(Origin::of).collect();
        check_apart(sources)?;
        let views = sources.iter().map(|source| self.view(source)).collect::<Result<Vec<View>>>()?;
        check_alike(sources, &distinct(views.iter().flat_map(View::rows)))?;
        let margins = distinct(views.iter().map(|view| view.margin(&self.metric)));
        let [margin] = margins[..] else {
            return Err(Error::Config(format!(
                "the sweeps state different margins of '{}' (equivalence)",
                self.metric
            )));
        };
        if !self.rows.is_empty() {
            self.rows = views[0].rows().filter(|row| *row != self.baseline).map(String::from).collect();
        }
        let records = self.chosen(views.iter().flat_map(View::records).collect())?;
        let over = OverScenes::new(&self.baseline, &self.metric, margin, &records);
        if over.rows.iter().all(|row| row.comparison.is_none()) {
            let (metric, baseline) = (&self.metric, &self.baseline);
            return Err(Error::Config(format!("no row has '{metric}' on a scene on which '{baseline}' has it")));
        }
        Ok((self, over))
    }

    /// The rows of one sweep, which are comparable.
    fn view(&self, source: &Source) -> Result<View> {
        let rows =
            if self.rows.is_empty() { vec![] } else { [std::slice::from_ref(&self.baseline), &self.rows].concat() };
        let selection = Selection { baseline: Some(self.baseline.clone()), rows, metrics: vec![self.metric.clone()] };
        let source = Source { folder: None, ..source.clone() };
        let view = View::new(&source.name, std::slice::from_ref(&source), selection);
        let checked = view.and_then(|view| view.table().map(|_| view));
        checked.map_err(|error| error.within(&format!("sweep '{}'", source.name)))
    }

    fn chosen(&self, records: Vec<Record>) -> Result<Vec<Record>> {
        let known = distinct(records.iter().map(|record| record.scene.clone()));
        if let Some(unknown) = self.scenes.iter().find(|scene| !known.contains(scene)) {
            return Err(Error::Config(format!("--scenes {unknown}: the scenes are {}", quoted(&known))));
        }
        let known: Vec<u64> = distinct(records.iter().filter_map(|record| record.seed));
        if let Some(unknown) = self.seeds.iter().find(|seed| !known.contains(seed)) {
            return Err(Error::Config(format!("--seeds {unknown}: the seeds are {}", listed(&known))));
        }
        let of_seed =
            |record: &Record| self.seeds.is_empty() || record.seed.is_some_and(|seed| self.seeds.contains(&seed));
        let of_scene = |record: &Record| self.scenes.is_empty() || self.scenes.contains(&record.scene);
        let is_chosen = |record: &Record| of_seed(record) && of_scene(record);
        Ok(records.into_iter().filter(is_chosen).collect())
    }

    /// Reads a folder's.
    pub fn read(folder: &Path) -> Result<ScenesRequest> {
        let path = folder.join(OVER_SCENES);
        let text = read_text(&path, TEXT_BYTES).map_err(|e| Error::unreadable(&path, &e))?;
        toml::from_str(&text).map_err(|e| Error::Data(format!("{}: {e}", path.display())))
    }

    /// The files of the folder, by their names.
    pub fn files(&self, over: &OverScenes) -> Result<Vec<(String, Content)>> {
        let request = toml::to_string(self).expect("plain data");
        let texts = [
            (OVER_SCENES, request),
            (OVER_SCENES_CSV, over.csv()),
            (SCENES_CSV, over.scenes_csv()),
            (OVER_SCENES_PAGE, self.page(over)),
        ];
        let texts = texts.into_iter().map(|(name, text)| (name.to_string(), Content::Bytes(text.into_bytes())));
        let mut files: Vec<(String, Content)> = texts.collect();
        for width in Width::ALL {
            let name = format!("{FIGURE}{}", width.suffix());
            files.extend(over_scenes_figure(over, width)?.into_iter().flat_map(|figure| figure.files(&name)));
        }
        Ok(files)
    }

    /// The comparison for readers, with the seeds if some are chosen.
    pub fn page(&self, over: &OverScenes) -> String {
        let note =
            if self.seeds.is_empty() { String::new() } else { format!("- of seeds {} alone\n", listed(&self.seeds)) };
        over.markdown() + &note
    }

    /// Writes them into a folder, which may hold pages beside them.
    ///
    /// # Errors
    /// A folder with tables of a sweep, with a comparison by sweep, with other folders, or with files that are not such
    /// a comparison.
    pub fn write(&self, over: &OverScenes, folder: &Path) -> Result<()> {
        write_folder(folder, (OVER_SCENES, ACROSS), &self.files(over)?)
    }
}

fn listed(seeds: &[u64]) -> String {
    seeds.iter().map(u64::to_string).collect::<Vec<String>>().join(", ")
}

/// Requires that no scene is in two sweeps: their seeds would be mixed.
fn check_apart(sources: &[Source]) -> Result<()> {
    if sources.is_empty() {
        return Err(Error::Config("no sweep is named: a comparison over scenes needs at least one".into()));
    }
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
fn check_alike(sources: &[Source], rows: &[&str]) -> Result<()> {
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
fn settings_of(source: &Source, row: &str, free: &[String]) -> Option<Vec<(String, String)>> {
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
