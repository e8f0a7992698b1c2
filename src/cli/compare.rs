//! `augnerf compare`.

use std::path::{Path, PathBuf};

use clap::Args;

use crate::base::files::AtomicDir;
use crate::base::{Error, Result};
use crate::compare::{Comparison, RunView, Window, check_box, check_fade, labels};
use crate::draw::SVG_ALONE;
use crate::run::{RunDir, Trained, Viewer};
use crate::runtime::Runtime;
use crate::train::checkpoint;

use super::progress::Console;
use super::{Compute, numbers};

/// Runs and the held-out view that they show.
#[derive(Args)]
pub struct Runs {
    /// Run folders of one scene; each run's newest checkpoint is shown
    #[arg(required = true, value_name = "RUN")]
    runs: Vec<PathBuf>,
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

impl Runs {
    /// How many are named.
    pub fn count(&self) -> usize {
        self.runs.len()
    }

    /// Hands each run to `make`, one at a time, after a check that it shows what the first one does.
    pub fn gather<T>(
        &self,
        runtime: &Runtime,
        console: &Console,
        make: impl Fn(&Viewer, &RunView) -> Result<T>,
    ) -> Result<Gathered<T>> {
        let (mut gathered, mut folders) = (Vec::<(RunView, T)>::new(), Vec::new());
        let labels = labels(&self.runs, &self.labels)?;
        // A folder without a trained run is refused before the first rendering.
        for run in &self.runs {
            let run = RunDir::open(run)?;
            run.read_config()?;
            checkpoint::latest(&run.checkpoints())?;
        }
        for (run, label) in self.runs.iter().zip(labels) {
            let trained = Trained::open(run, self.data.as_deref(), runtime, console)?;
            let (viewer, state) = (trained.viewer(), &trained.state);
            let shown = RunView::new(label, &viewer, state, &self.view)?;
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
}

impl CompareArguments {
    pub fn run(self) -> Result<()> {
        if self.gif {
            check_fade(self.runs.count())?;
        }
        let zoom = self.zoom.as_deref().map(parse_zoom).transpose()?;
        self.out.as_deref().map_or(Ok(()), AtomicDir::check_vacant)?;
        let runtime = self.compute.runtime()?;
        runtime.install(|| self.compare(zoom, &runtime))
    }

    fn compare(&self, zoom: Option<Window>, runtime: &Runtime) -> Result<()> {
        let console = Console::new(self.compute.quiet);
        let box_width = self.box_width.map(|width| width as usize);
        let render = |viewer: &Viewer, run: &RunView| {
            check_box(zoom, box_width, &run.view.image)?;
            viewer.render(&run.view.camera)
        };
        let (rendered, folders) = self.runs.gather(runtime, &console, render)?;
        let comparison = Comparison::new(rendered, zoom, box_width)?;
        let (folder, pictures) = pictures_folder(self.out.as_deref(), folders[0].renders().join("compare"))?;
        comparison.write(pictures.path(), self.gif)?;
        pictures.commit()?;
        console.say(&format!("pictures: {}", folder.display()));
        SVG_ALONE.into_iter().for_each(|note| console.say(note));
        Ok(())
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
