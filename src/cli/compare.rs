//! `augnerf compare`.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use crate::base::files::AtomicDir;
use crate::base::{Error, Result};
use crate::compare::{
    Comparison, Profile, Profiles, RunView, Window, check_box, check_overlay, check_profiled, labels, name_steps,
};
use crate::data::View;
use crate::report::label;
use crate::run::{OpenOptions, RunDir, Trained, Viewer};
use crate::runtime::Runtime;
use crate::sweep::{Point, SweepFolder, split_names};
use crate::train::checkpoint;

use super::answer::Answer;
use super::progress::{Console, open_next};
use super::{Compute, numbers, whole};

/// Flags for runs and the held-out view that they show.
#[derive(Args)]
#[command(next_help_heading = "Experiment")]
struct Runs {
    /// Run folders of one scene (newest checkpoints), or the folder of one sweep
    #[arg(required = true, value_name = "RUN")]
    runs: Vec<PathBuf>,
    /// Rows of the sweep, in this order [default: all finished ones]
    #[arg(long, value_name = "ROW,...")]
    rows: Vec<String>,
    /// Seed of the sweep's points [default: the first]
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Scene of the sweep [default: its only one]
    #[arg(long, value_name = "NAME")]
    scene: Option<String>,
    /// Name of a run, once for each in their order [default: its folder's]
    #[arg(long = "label", value_name = "NAME")]
    labels: Vec<String>,
    /// Held-out view, by name or by number from 0
    #[arg(long, value_name = "VIEW", default_value = "0")]
    view: String,
    /// Scene folder, if it has moved [default: the run's]
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
}

/// The result for each run, and the runs' folders, which stay locked.
type Gathered<T> = (Vec<(RunView, T)>, Vec<RunDir>);

/// A run folder.
struct NamedRun {
    /// The folder.
    path: PathBuf,
    /// The run's name.
    label: String,
}

/// Run folders with the runs' names.
type Named = Vec<NamedRun>;

impl Runs {
    /// Returns the runs as a command line names them.
    fn words(&self) -> String {
        let runs = self.runs.iter().map(|run| run.display().to_string());
        let rows = self.rows.iter().map(|row| format!("--rows '{row}'"));
        let seed = self.seed.iter().map(|seed| format!("--seed {seed}"));
        runs.chain(rows).chain(seed).collect::<Vec<_>>().join(" ")
    }

    /// Returns the named runs, or rows of a sweep with their names.
    fn named(&self) -> Result<Named> {
        if let Some(results) = self.runs.iter().find(|path| path.join("provenance.toml").is_file()) {
            return Err(Error::Config(format!(
                "{}: a sweep's results, without its runs; name the sweep's folder, such as runs/NAME",
                results.display()
            )));
        }
        let mut named: Named = match self.runs.iter().find(|path| SweepFolder::new(path).is_begun()) {
            Some(sweep) if self.runs.len() == 1 => self.rows_of(&SweepFolder::new(sweep))?,
            Some(sweep) => {
                return Err(Error::Config(format!(
                    "{}: a sweep; name it alone with --rows and --seed, or name runs only",
                    sweep.display()
                )));
            }
            None => Vec::new(),
        };
        if named.is_empty() && (!self.rows.is_empty() || self.seed.is_some() || self.scene.is_some()) {
            return Err(Error::Config(format!(
                "{}: not a sweep, so --rows, --seed and --scene do not apply; name a sweep's folder, such as runs/NAME",
                self.runs[0].display()
            )));
        }
        let given: Vec<String> = match self.labels.as_slice() {
            [] => named.iter().map(|run| run.label.clone()).collect(),
            labels => labels.to_vec(),
        };
        if named.is_empty() {
            let unnamed = |path: &PathBuf| NamedRun { path: path.clone(), label: String::new() };
            named = self.runs.iter().map(unnamed).collect();
        }
        let paths: Vec<PathBuf> = named.iter().map(|run| run.path.clone()).collect();
        for (run, label) in named.iter_mut().zip(labels(&paths, &given)?) {
            run.label = label;
        }
        Ok(named)
    }

    /// Returns the runs of a sweep's rows at one seed.
    fn rows_of(&self, sweep: &SweepFolder) -> Result<Named> {
        let points = sweep.points(None)?.unwrap_or_default();
        let definition = sweep.definition()?;
        let seed = self.seed.unwrap_or(definition.seeds[0]);
        if !definition.seeds.contains(&seed) {
            let seeds: Vec<String> = definition.seeds.iter().map(u64::to_string).collect();
            return Err(Error::Config(format!("--seed {seed}: not in the sweep; choose one of {}", seeds.join(", "))));
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
            // Rows that share a point are drawn once.
            let twice = named.iter().any(|known| known.path == run);
            if chosen.is_empty() && done && !twice {
                named.push(NamedRun { path: run, label: label.clone() });
            } else if chosen.contains(label) && !done {
                let status = sweep.point(&point.id).record(point)?.status.name();
                return Err(Error::Config(format!(
                    "row '{label}' with seed {seed}: {status}; train it with `augnerf sweep run`, or see `augnerf sweep \
                     status {}`",
                    sweep.path().display()
                )));
            }
        }
        for name in &chosen {
            let (_, point) = known.iter().find(|(label, _)| label == name).expect("split");
            named.push(NamedRun { path: sweep.point(&point.id).run(), label: name.clone() });
        }
        if named.is_empty() {
            return Err(Error::Config(format!(
                "{}: no finished point with seed {seed}; see `augnerf sweep status {}`",
                sweep.path().display(),
                sweep.path().display()
            )));
        }
        Ok(named)
    }

    /// Returns the scene of the sweep that the command line names, or its only one.
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
                let found = named.as_ref().map_or("is required", |_| "is not in the sweep");
                let named = named.as_deref().unwrap_or("NAME");
                Err(Error::Config(format!("--scene {named}: {found}; choose one of {}", known.join(", "))))
            }
        }
    }

    /// Passes each run to `make`, one at a time, after checking that it shows the same view as the first.
    fn gather<T>(
        &self,
        runs: &[NamedRun],
        runtime: &Runtime,
        console: &Console,
        make: impl Fn(&Viewer, &RunView) -> Result<T>,
    ) -> Result<Gathered<T>> {
        let (mut gathered, mut folders) = (Vec::<(RunView, T)>::new(), Vec::new());
        // Folders without a trained run are errors before the first rendering.
        for NamedRun { path, .. } in runs {
            let run = RunDir::open(path)?;
            run.read_config()?;
            checkpoint::latest(&run.checkpoints())?;
        }
        for NamedRun { path, label } in runs {
            let trained = Trained::open_at(path, OpenOptions::CAMERAS, self.data.as_deref(), runtime, console)?;
            let (viewer, state) = (trained.viewer(), &trained.state);
            let mut shown = RunView::new(label.clone(), &viewer, state, &self.view)?;
            shown.protocol = trained.protocol();
            gathered.first().map_or(Ok(()), |(first, _)| shown.check_alike(first))?;
            console.say(&format!("{}: view {} at step {}", shown.label, shown.view.name, state.step));
            let made = make(&viewer, &shown)?;
            gathered.push((shown, made));
            folders.push(trained.run);
        }
        name_steps(gathered.iter_mut().map(|(run, _)| run));
        Ok((gathered, folders))
    }
}

#[derive(Args)]
pub struct CompareArguments {
    #[command(flatten)]
    runs: Runs,
    /// Box to zoom into, in pixels [default: where the runs' squared errors differ most]
    #[arg(long, value_name = "X,Y,WIDTH,HEIGHT", conflicts_with = "box_width", help_heading = "Output")]
    zoom: Option<String>,
    /// Width of the searched box in pixels [default: a fifth of the view's]
    #[arg(long, value_name = "N", value_parser = whole::<u32>(1..=u32::MAX.into()), help_heading = "Output")]
    box_width: Option<u32>,
    /// Plot density, transmittance, weight and colour along the ray of a pixel (column and row, from 0) instead
    #[arg(long, value_name = "X,Y", conflicts_with_all = ["zoom", "box_width"], help_heading = "Output")]
    ray: Option<String>,
    /// Output folder, new or empty [default: RUN/renders/compare (or ray) of the first run, replaced]
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    out: Option<PathBuf>,
    #[command(flatten)]
    answer: Answer,
    #[command(flatten)]
    compute: Compute,
}

impl CompareArguments {
    pub fn run(self) -> Result<()> {
        let runs = self.runs.named()?;
        let zoom = self.zoom.as_deref().map(parse_zoom).transpose()?;
        let ray = self.ray.as_deref().map(parse_pixel).transpose()?;
        self.out.as_deref().map_or(Ok(()), AtomicDir::check_vacant)?;
        match ray {
            None => self.compute.run(|runtime, console| self.compare(&runs, zoom, runtime, console)),
            Some(pixel) => {
                check_overlay(runs.len())?;
                self.compute.run(|runtime, console| self.profile(&runs, pixel, runtime, console))
            }
        }
    }

    fn compare(&self, runs: &[NamedRun], zoom: Option<Window>, runtime: &Runtime, console: &Console) -> Result<()> {
        let box_width = self.box_width.map(|width| width as usize);
        let render = |viewer: &Viewer, run: &RunView| {
            check_box(zoom, box_width, &run.view.image)?;
            viewer.render(&run.view.camera)
        };
        let (rendered, folders) = self.runs.gather(runs, runtime, console, render)?;
        let comparison = Comparison::new(rendered, zoom, box_width)?;
        let folder = self.write("compare", &folders[0], |folder| comparison.write(folder))?;
        self.answer(("comparison", comparison.json()), &folder)?;
        let View { image, .. } = comparison.view();
        let (x, y) = (image.width / 2, image.height / 2);
        let ray = format!("augnerf compare {} --ray {x},{y}", self.runs.words());
        open_next(console, &[folder.join("compare.svg")], &ray);
        Ok(())
    }

    fn profile(&self, runs: &[NamedRun], pixel: (usize, usize), runtime: &Runtime, console: &Console) -> Result<()> {
        // Before anything is measured.
        for NamedRun { path, label } in runs {
            check_profiled(label, &RunDir::open(path)?.read_config()?)?;
        }
        let measure = |viewer: &Viewer, run: &RunView| Profile::measure(viewer, run, pixel);
        let (runs, folders) = self.runs.gather(runs, runtime, console, measure)?;
        runs.iter().try_for_each(|(run, _)| run.check_same_interval(&runs[0].0))?;
        let profiles = Profiles { runs, pixel };
        let folder = self.write("ray", &folders[0], |folder| profiles.write(folder))?;
        self.answer(("ray", profiles.json()), &folder)
    }

    /// Writes the files of the result into the output folder, or into a folder of the first run; returns it.
    fn write(&self, name: &str, run: &RunDir, files: impl FnOnce(&Path) -> Result<()>) -> Result<PathBuf> {
        let (folder, pictures) = pictures_folder(self.out.as_deref(), RunDir::renders_in(run.path()).join(name))?;
        files(pictures.path())?;
        pictures.commit()?;
        Ok(folder)
    }

    fn answer(&self, (name, content): (&str, serde_json::Value), folder: &Path) -> Result<()> {
        self.answer.give_place(&json!({ "folder": folder.display().to_string(), name: content }), folder)
    }
}

fn parse_pixel(text: &str) -> Result<(usize, usize)> {
    let [x, y] = numbers(text)
        .ok_or_else(|| Error::Config(format!("--ray {text}: not two numbers; give column and row, such as 120,80")))?;
    Ok((x, y))
}

fn parse_zoom(text: &str) -> Result<Window> {
    let [x, y, width, height] = numbers(text).ok_or_else(|| {
        Error::Config(format!(
            "--zoom {text}: not four numbers; give column, row, width and height, such as 120,80,64,48"
        ))
    })?;
    Ok(Window { x, y, width, height })
}

/// Endings of files, which name no folder.
const OF_FILES: [&str; 8] = ["ply", "obj", "png", "svg", "gif", "mp4", "json", "npy"];

/// Returns the output folder and a writer whose images appear in it all at once. Images of an earlier rendering are
/// removed; a folder with other files is an error.
pub fn pictures_folder(out: Option<&Path>, default: PathBuf) -> Result<(PathBuf, AtomicDir)> {
    if let Some(out) = out {
        let ending = out.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
        if ending.is_some_and(|ending| OF_FILES.contains(&&*ending)) && !out.is_dir() {
            return Err(Error::Config(format!(
                "--out {}: several files are written, into a folder; name a folder, such as {}",
                out.display(),
                out.with_extension("").display()
            )));
        }
        return Ok((out.to_path_buf(), AtomicDir::vacant(out)?));
    }
    let parent = default.parent().unwrap_or(Path::new("."));
    let made = std::fs::create_dir_all(parent).map_err(|e| Error::unwritable(parent, &e));
    let pictures = made.and_then(|()| AtomicDir::new(&default));
    let pictures = pictures.map_err(|error| Error::Output(format!("{error}; name another folder with --out")))?;
    Ok((default, pictures))
}
