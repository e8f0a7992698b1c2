//! The trained seeds of one row, and the held-out views that all of them share.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::run_view::{RunView, find_view};
use super::spread::{SpreadNumbers, ViewSpread};
use super::spread_files::{Shown, Spread, ViewLine};
use crate::base::{Error, Event, Listener, Result};
use crate::data::{Camera, Scene, View};
use crate::methods::Renderer;
use crate::report::calibration::{Predicted, calibration_curve};
use crate::run::{RunDir, Trained, Viewer};
use crate::runtime::Runtime;
use crate::train::checkpoint;

/// Number of bins of the calibration curve.
pub const BINS: usize = 20;
/// Names of views that an error lists for each seed.
const LISTED: usize = 4;

/// Trained seeds of one row, at their newest checkpoints.
pub struct SeedSet {
    row: String,
    seeds: Vec<Trained>,
    /// Each seed with the first common view.
    runs: Vec<RunView>,
    /// The common views, as indices among the first seed's held-out views.
    common: Vec<usize>,
    /// Held-out views of some seeds that are not common.
    skipped: Vec<String>,
}

impl SeedSet {
    /// Opens the run folders of a row's seeds. Each photo is kept in memory once.
    ///
    /// # Errors
    /// Fewer than two runs; a run without a checkpoint; a scene that cannot be read; no held-out view with equal camera
    /// and photo in all seeds.
    pub fn open(
        row: String,
        runs: &[PathBuf],
        data: Option<&Path>,
        runtime: &Runtime,
        events: &dyn Listener,
    ) -> Result<SeedSet> {
        check_checkpoints(&row, runs)?;
        let mut seeds: Vec<Trained> = Vec::new();
        for run in runs {
            let mut trained = Trained::open(run, data, runtime, events)?;
            if let Some(first) = seeds.first() {
                share_photos(&mut trained.scene, &first.scene);
            }
            seeds.push(trained);
        }
        SeedSet::new(row, seeds)
    }

    fn new(row: String, seeds: Vec<Trained>) -> Result<SeedSet> {
        if seeds.len() < 2 {
            return Err(Error::Config(format!("row '{row}': {} seed; a spread needs at least two", seeds.len())));
        }
        let (mut common, mut differs, mut runs) = (Vec::new(), None, Vec::new());
        for (index, view) in seeds[0].scene.test.iter().enumerate() {
            if !seeds.iter().all(|seed| names(&seed.scene).any(|known| known == view.name)) {
                continue;
            }
            let shown = seeds.iter().map(|seed| run_view(seed, &view.name)).collect::<Result<Vec<RunView>>>()?;
            match shown.iter().try_for_each(|run| run.check_same_view(&shown[0])) {
                Ok(()) => common.push(index),
                Err(error) => differs = differs.or(Some(error)),
            }
            if common.len() == 1 && runs.is_empty() {
                runs = shown;
            }
        }
        if common.is_empty() {
            return Err(differs.unwrap_or_else(|| none_in_common(&row, &seeds)));
        }
        let kept = |name: &String| common.iter().any(|&index| seeds[0].scene.test[index].name == *name);
        let mut skipped: Vec<String> = seeds.iter().flat_map(|seed| names(&seed.scene)).map(String::from).collect();
        skipped.sort_unstable();
        skipped.dedup();
        skipped.retain(|name| !kept(name));
        Ok(SeedSet { row, seeds, runs, common, skipped })
    }

    /// Returns the first seed's run.
    pub fn first(&self) -> &RunDir {
        &self.seeds[0].run
    }

    /// Returns the seeds.
    pub fn seeds(&self) -> Vec<u64> {
        self.seeds.iter().map(|seed| seed.config.seed).collect()
    }

    /// Returns the number of common held-out views.
    pub fn views(&self) -> usize {
        self.common.len()
    }

    /// Returns the common held-out views, as the first seed has them.
    fn common(&self) -> impl Iterator<Item = &View> {
        self.common.iter().map(|&index| &self.seeds[0].scene.test[index])
    }

    /// Estimates the seconds of [`SeedSet::measure`], unless they are few.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn estimate_seconds(&self) -> Result<Option<f64>> {
        let cameras: Vec<&Camera> = self.common().map(|view| &view.camera).collect();
        let of_one = self.seeds[0].viewer().estimate_seconds(&cameras)?;
        Ok(of_one.map(|seconds| seconds * self.seeds.len() as f64))
    }

    /// Returns the number of a common view, which `view` names or numbers.
    ///
    /// # Errors
    /// No such view.
    pub fn find(&self, view: &str) -> Result<usize> {
        let names: Vec<&str> = self.common().map(|view| view.name.as_str()).collect();
        find_view(&format!("row '{}'", self.row), &names, view)
    }

    /// Renders all common views with all seeds, one view at a time. Keeps the images of the view number `shown`.
    ///
    /// # Errors
    /// A colour is not a number.
    ///
    /// # Panics
    /// No view has that number.
    pub fn measure(&self, shown: usize, events: &dyn Listener) -> Result<Spread> {
        events.on(Event::Started { what: "rendering", parts: (self.seeds.len() * self.views()) as u64 });
        let viewers: Vec<Viewer> = self.seeds.iter().map(Trained::viewer).collect();
        let renderers = viewers.iter().map(Viewer::renderer).collect::<Result<Vec<_>>>()?;
        let (mut lines, mut pixels, mut kept) = (Vec::new(), Vec::<Predicted>::new(), None);
        for (index, view) in self.common().enumerate() {
            let found = self.render(view, &viewers, &renderers, events)?;
            pixels.extend(&found.predicted);
            lines.push(ViewLine {
                view: view.name.clone(),
                pixels: found.predicted.len(),
                numbers: found.numbers.clone(),
            });
            if index == shown {
                kept = Some(Shown { view: view.clone(), index, found });
            }
        }
        events.on(Event::Finished);
        Ok(Spread {
            row: self.row.clone(),
            mean: SpreadNumbers::mean(lines.iter().map(|line| &line.numbers)),
            views: lines,
            curve: calibration_curve(&mut pixels, BINS),
            shown: kept.expect("a common view"),
            runs: self.runs.clone(),
            seeds: self.seeds(),
            skipped_views: self.skipped.clone(),
        })
    }

    fn render(
        &self,
        view: &View,
        viewers: &[Viewer],
        renderers: &[Box<dyn Renderer>],
        events: &dyn Listener,
    ) -> Result<ViewSpread> {
        let is_mixed = self.runs.iter().any(|run| run.ndc.is_none());
        let mut rendered = Vec::new();
        for ((viewer, renderer), run) in viewers.iter().zip(renderers).zip(&self.runs) {
            let mut one = viewer.render_with(&**renderer, &view.camera)?;
            if is_mixed {
                let mut run = run.clone();
                run.view = view.clone();
                run.leave_ndc(&mut one.depth);
            }
            rendered.push(one);
            events.on(Event::Advanced);
        }
        ViewSpread::new(view, &rendered)
    }
}

/// Returns an error that names the runs without a checkpoint.
fn check_checkpoints(row: &str, runs: &[PathBuf]) -> Result<()> {
    let has_none = |path: &&PathBuf| match RunDir::open(path) {
        Ok(run) => checkpoint::latest(&run.checkpoints()).is_err(),
        Err(_) => true,
    };
    let without: Vec<String> = runs.iter().filter(has_none).map(|path| path.display().to_string()).collect();
    if without.is_empty() {
        return Ok(());
    }
    Err(Error::Checkpoint(format!(
        "row '{row}': no checkpoint in {}; copy the checkpoints back, or delete the folder of each such point and train it \
         again with `augnerf sweep run`",
        without.join(", ")
    )))
}

/// Lets views use the photo and mask of an equal view in another scene.
fn share_photos(scene: &mut Scene, with: &Scene) {
    for view in scene.train.iter_mut().chain(&mut scene.test) {
        let mut equal = with.train.iter().chain(&with.test).filter(|known| known.name == view.name);
        if let Some(known) = equal.find(|known| known.image == view.image) {
            view.image = Arc::clone(&known.image);
        }
    }
}

fn names(scene: &Scene) -> impl Iterator<Item = &str> {
    scene.test.iter().map(|view| view.name.as_str())
}

fn run_view(seed: &Trained, view: &str) -> Result<RunView> {
    RunView::new(format!("seed {}", seed.config.seed), &seed.viewer(), &seed.state, view)
}

fn none_in_common(row: &str, seeds: &[Trained]) -> Error {
    let of_seed = |seed: &Trained| {
        let mut listed: Vec<&str> = names(&seed.scene).take(LISTED).collect();
        if seed.scene.test.len() > LISTED {
            listed.push("...");
        }
        format!("seed {}: {}", seed.config.seed, listed.join(", "))
    };
    let all: Vec<String> = seeds.iter().map(of_seed).collect();
    Error::Config(format!(
        "row '{row}': its seeds hold out no view in common ({}); name a row whose seeds hold out the same views, or train \
         one without by_seed for settings such as data.holdout_offset",
        all.join("; ")
    ))
}
