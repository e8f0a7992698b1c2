//! `augnerf compare`.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use crate::base::files::AtomicDir;
use crate::base::{Error, Result};
use crate::compare::{Comparison, RunView, Window, check_box, check_fade, labels};
use crate::draw::SVG_ALONE;
use crate::report::label;
use crate::run::{RunDir, Trained, Viewer};
use crate::runtime::Runtime;
use crate::sweep::{Point, SweepFolder, split_names};
use crate::train::checkpoint;

use super::answer::Answer;
use super::progress::Console;
use super::{Compute, numbers};

/// Runs and the held-out view that they show.
#[derive(Args)]
pub struct Runs {
    /// Run folders of one scene, or the folder of one sweep, whose rows they then are; each run's newest checkpoint is shown
    #[arg(required = true, value_name = "RUN")]
    runs: Vec<PathBuf>,
    /// Of a sweep: rows, in this order [default: all whose point is done]
    #[arg(long, value_name = "ROW,...")]
    rows: Vec<String>,
    /// Of a sweep: the seed that all rows have in common [default: the sweep's first]
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Of a sweep with several scenes: which
    #[arg(long, value_name = "NAME")]
    scene: Option<String>,
    /// What pictures and files call a run: once for each run, in their order [default: its folder's name]
    #[arg(long = "label", value_name = "NAME")]
    labels: Vec<String>,
    /// Held-out view, by name or by number from 0; none is picked by what it shows
    #[arg(long, value_name = "VIEW", default_value = "0")]
    view: String,
    /// Scene folder, if it has moved since training
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
}

/// What is made of each run, with the runs' folders, which stay locked.
pub type Gathered<T> = (Vec<(RunView, T)>, Vec<RunDir>);

/// Runs with what pictures and files call them.
pub type Named = Vec<(PathBuf, String)>;

impl Runs {
    /// The runs that are meant: those that are named, or rows of a sweep under their names.
    pub fn named(&self) -> Result<Named> {
        let (paths, mut given) = match self.runs.iter().find(|path| SweepFolder::new(path).is_begun()) {
            Some(sweep) if self.runs.len() == 1 => self.rows_of(&SweepFolder::new(sweep))?.into_iter().unzip(),
            Some(sweep) => {
                return Err(Error::Config(format!(
                    "{} is a sweep: name it alone, with --rows and --seed, or name runs alone",
                    sweep.display()
                )));
            }
            None => (self.runs.clone(), Vec::new()),
        };
        if given.is_empty() && (!self.rows.is_empty() || self.seed.is_some() || self.scene.is_some()) {
            return Err(Error::Config(format!(
                "--rows, --seed and --scene pick runs of a sweep, and {} is none: name the sweep's folder, such as \
                 runs/NAME",
                self.runs[0].display()
            )));
        }
        if !self.labels.is_empty() {
            given.clone_from(&self.labels);
        }
        let labels = labels(&paths, &given)?;
        Ok(paths.into_iter().zip(labels).collect())
    }

    /// Rows of a sweep at one seed.
    fn rows_of(&self, sweep: &SweepFolder) -> Result<Named> {
        let points = sweep.points(None)?.unwrap_or_default();
        let definition = sweep.definition()?;
        let seed = self.seed.unwrap_or(definition.seeds[0]);
        if !definition.seeds.contains(&seed) {
            let seeds: Vec<String> = definition.seeds.iter().map(u64::to_string).collect();
            return Err(Error::Config(format!("--seed {seed}: the sweep's seeds are {}", seeds.join(", "))));
        }
        let scene = self.scene_of(&points)?;
        let mut known = Vec::new();
        for point in points.iter().filter(|point| point.scene == scene && point.config.seed == seed) {
            known.extend(point.places.iter().map(|place| (label(&place.row, &place.axes), point)));
        }
        let all: Vec<&str> = known.iter().map(|(label, _)| label.as_str()).collect();
        let chosen = split_names("--rows", &self.rows, &all)?;
        let mut named: Named = Vec::new();
        for (label, point) in &known {
            let (run, done) = (sweep.point(&point.id).run(), sweep.point(&point.id).result()?.is_some());
            // Rows that share a point show the same.
            let twice = named.iter().any(|(known, _)| *known == run);
            if chosen.is_empty() && done && !twice {
                named.push((run, label.clone()));
            } else if chosen.contains(label) && !done {
                let status = sweep.point(&point.id).state(point)?.status.name();
                return Err(Error::Config(format!(
                    "'{label}' with seed {seed} is {status}: `augnerf sweep run` trains it, and `augnerf sweep status {}` \
                     shows how far it is",
                    sweep.path().display()
                )));
            }
        }
        for name in &chosen {
            let (_, point) = known.iter().find(|(label, _)| label == name).expect("split");
            named.push((sweep.point(&point.id).run(), name.clone()));
        }
        if named.is_empty() {
            return Err(Error::Config(format!(
                "{} has no point of seed {seed} that is done: `augnerf sweep status` shows how far they are",
                sweep.path().display()
            )));
        }
        Ok(named)
    }

    fn scene_of(&self, points: &[Point]) -> Result<String> {
        let mut scenes: Vec<&str> = Vec::new();
        for point in points {
            if !scenes.contains(&point.scene.as_str()) {
                scenes.push(&point.scene);
            }
        }
        match (&self.scene, scenes.as_slice()) {
            (None, [only]) => Ok(only.to_string()),
            (Some(scene), known) if known.contains(&scene.as_str()) => Ok(scene.clone()),
            (named, known) => {
                let found = named.as_ref().map_or("give one", |_| "it is none of the sweep's");
                let named = named.as_deref().unwrap_or("NAME");
                Err(Error::Config(format!("--scene {named}: {found}; the sweep's scenes are {}", known.join(", "))))
            }
        }
    }

    /// Hands each run to `make`, one at a time, after a check that it shows what the first one does.
    pub fn gather<T>(
        &self,
        runs: &[(PathBuf, String)],
        runtime: &Runtime,
        console: &Console,
        make: impl Fn(&Viewer, &RunView) -> Result<T>,
    ) -> Result<Gathered<T>> {
        let (mut gathered, mut folders) = (Vec::<(RunView, T)>::new(), Vec::new());
        // A folder without a trained run is refused before the first rendering.
        for (run, _) in runs {
            let run = RunDir::open(run)?;
            run.read_config()?;
            checkpoint::latest(&run.checkpoints())?;
        }
        for (run, label) in runs {
            let trained = Trained::open(run, self.data.as_deref(), runtime, console)?;
            let (viewer, state) = (trained.viewer(), &trained.state);
            let shown = RunView::new(label.clone(), &viewer, state, &self.view)?;
            gathered.first().map_or(Ok(()), |(first, _)| shown.check_alike(first))?;
            console.say(&format!("{}: view {} at step {}", shown.label, shown.view.name, state.step));
            let made = make(&viewer, &shown)?;
            gathered.push((shown, made));
            folders.push(trained.run);
        }
        Ok((gathered, folders))
    }
}

#[derive(Args)]
pub struct CompareArguments {
    #[command(flatten)]
    runs: Runs,
    /// The box to look into [default: where the runs' squared errors differ most]
    #[arg(long, value_name = "X,Y,WIDTH,HEIGHT", conflicts_with = "box_width")]
    zoom: Option<String>,
    /// Columns of the box that is searched for; its aspect is the view's [default: a fifth of the view's]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    box_width: Option<u32>,
    /// Also a GIF that fades between two runs
    #[arg(long)]
    gif: bool,
    /// Output folder, new or empty [default: RUN/renders/compare of the first run, replaced]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    compute: Compute,
    #[command(flatten)]
    answer: Answer,
}

impl CompareArguments {
    pub fn run(self) -> Result<()> {
        let runs = self.runs.named()?;
        if self.gif {
            check_fade(runs.len())?;
        }
        let zoom = self.zoom.as_deref().map(parse_zoom).transpose()?;
        self.out.as_deref().map_or(Ok(()), AtomicDir::check_vacant)?;
        let runtime = self.compute.runtime()?;
        runtime.install(|| self.compare(&runs, zoom, &runtime))
    }

    fn compare(&self, runs: &[(PathBuf, String)], zoom: Option<Window>, runtime: &Runtime) -> Result<()> {
        let console = Console::new(self.compute.quiet);
        let box_width = self.box_width.map(|width| width as usize);
        let render = |viewer: &Viewer, run: &RunView| {
            check_box(zoom, box_width, &run.view.image)?;
            viewer.render(&run.view.camera)
        };
        let (rendered, folders) = self.runs.gather(runs, runtime, &console, render)?;
        let comparison = Comparison::new(rendered, zoom, box_width)?;
        let (folder, pictures) = pictures_folder(self.out.as_deref(), folders[0].renders().join("compare"))?;
        comparison.write(pictures.path(), self.gif)?;
        pictures.commit()?;
        SVG_ALONE.into_iter().for_each(|note| console.say(note));
        let answer = json!({ "folder": folder.display().to_string(), "comparison": comparison.json() });
        self.answer.give_place(&answer, &folder)
    }
}

fn parse_zoom(text: &str) -> Result<Window> {
    let [x, y, width, height] = numbers(text).ok_or_else(|| {
        Error::Config(format!("--zoom {text}: give column, row, width and height in pixels, such as 120,80,64,48"))
    })?;
    Ok(Window { x, y, width, height })
}

/// A folder that pictures appear in all together: an earlier rendering's are not left among the new ones. What is
/// not ours is not replaced.
pub fn pictures_folder(out: Option<&Path>, default: PathBuf) -> Result<(PathBuf, AtomicDir)> {
    if let Some(out) = out {
        return Ok((out.to_path_buf(), AtomicDir::vacant(out)?));
    }
    let parent = default.parent().unwrap_or(Path::new("."));
    let made = std::fs::create_dir_all(parent).map_err(|e| Error::unwritable(parent, &e));
    let pictures = made.and_then(|()| AtomicDir::new(&default));
    let pictures = pictures.map_err(|error| Error::Output(format!("{error}; name another folder with --out")))?;
    Ok((default, pictures))
}
