//! `augnerf train` and `augnerf resume`.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};

use clap::Args;

use crate::base::{Error, Result};
use crate::data::Photos;
use crate::metrics::{Backbone, FLOOR_PSNR, PSNR, SSIM};
use crate::run::{Existing, Finished, Job, RunDir, Setup, load_lpips, load_scene, load_scene_of};
use crate::runtime::Runtime;
use crate::settings::{Config, DataKind, Placing};
use crate::train::Origin;
use crate::train::checkpoint::{self, State};

use super::answer::{Answer, Measured};
use super::experiment::{Base, Experiment, placing, say_without_effect};
use super::measure::print_balance;
use super::progress::{Console, print};
use super::signals::catch_signals;
use super::{Compute, LpipsWeights, Sources};

/// Steps from which on settings are the paper's.
pub const PAPER_STEPS: u64 = 100_000;

/// Seconds of training from which on pictures are drawn before its end.
const PREVIEWS_FROM: f64 = 10.0;

pub const RESUME_EXAMPLES: &str = "Examples:
  augnerf resume runs/fern-nerf-*
  augnerf resume RUN --data ~/data/fern  # the scene has moved
  augnerf resume RUN --device gpu        # on another device";

#[derive(Args)]
pub struct TrainArguments {
    #[command(flatten)]
    experiment: Experiment,
    /// Continue from this run's newest checkpoint, with its optimizer and, without --preset and --config, its settings
    #[arg(long, value_name = "RUN", help_heading = "Experiment")]
    from: Option<PathBuf>,
    /// With --from: take the weights alone and start at step 0
    #[arg(long, requires = "from", help_heading = "Experiment")]
    restart: bool,
    #[command(flatten)]
    weights: LpipsWeights,
    /// Run folder [default: runs/SCENE-METHOD-HASH]
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    out: Option<PathBuf>,
    /// Replace the run in that folder
    #[arg(long, help_heading = "Output")]
    overwrite: bool,
    /// Train plain NeRF for some steps [default: 100], print which weights balance each regularizer with the
    /// photometric loss, as CSV, and stop
    #[arg(
        long,
        value_name = "STEPS",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "100",
        conflicts_with_all = ["from", "out", "overwrite", "print_config"],
        help_heading = "Experiment"
    )]
    balance: Option<u64>,
    /// Print the resolved settings and stop
    #[arg(long, help_heading = "Output")]
    print_config: bool,
    #[command(flatten)]
    answer: Answer,
    #[command(flatten)]
    compute: Compute,
}

#[derive(Args)]
pub struct ResumeArguments {
    /// Run folder
    run: PathBuf,
    #[command(flatten)]
    sources: Sources,
    #[command(flatten)]
    answer: Answer,
    #[command(flatten)]
    compute: Compute,
}

impl TrainArguments {
    pub fn run(self) -> Result<()> {
        self.compute.run(|runtime, console| match self.balance {
            Some(steps) => print_balance(&self.experiment, steps, self.answer, (runtime, console)),
            None => self.train(runtime, console),
        })
    }

    fn train(&self, runtime: &Runtime, console: &Console) -> Result<()> {
        // Restarted weights on another scene bring none of their own scene's settings.
        let parent = self.from.as_deref().map(Parent::open).transpose()?;
        let base = parent.as_ref().map_or_else(|| Base::of_training(runtime), |parent| parent.base(self.restart));
        let config = self.experiment.config_over(base, &self.weights, console)?;
        if let Some(parent) = parent.as_ref().filter(|_| !self.print_config) {
            parent.check(&config, self.restart)?;
        }
        let lpips = load_lpips(&config.eval.lpips_weights, runtime.device())?;
        let (config, scene) = load_scene(config, console)?;
        if self.print_config {
            return self.answer.give(&config.to_table(), || print(config.to_toml().trim_end()));
        }
        let folder = self.out.clone().unwrap_or_else(|| default_folder(&config));
        let setup = Setup { config, scene: &scene, lpips: &lpips, runtime: runtime.clone() };
        let existing = if self.overwrite { Existing::Replace } else { Existing::Refuse };
        let mut words = what_is_trained(&setup);
        if self.from.is_none() && !self.experiment.names_length() && setup.config.train.steps >= PAPER_STEPS {
            words += "\nno --preset is named, so these are the paper's own settings; --preset fast takes minutes";
        }
        say_without_effect(self.experiment.settings(), |setting| setup.config.without_effect(setting), console);
        let job = match &parent {
            None => Job::create(&folder, existing, setup)?,
            Some(parent) => {
                let origin = Origin::Checkpoint { folder: &parent.checkpoint, goes_on: !self.restart };
                let job = Job::create_from(&folder, existing, setup, origin)?;
                let (from, step) = (parent.run.path().display(), job.step_count());
                console
                    .say(&format!("weights of {from} at step {}: this run starts at step {step}", parent.state.step));
                job
            }
        };
        drop(parent);
        console.say(&words);
        train(job, &folder, console, self.answer)
    }
}

/// The run whose weights another run starts with.
struct Parent {
    run: RunDir,
    /// The file of the run's settings.
    config: PathBuf,
    settings: Config,
    checkpoint: PathBuf,
    state: State,
}

impl Parent {
    /// Opens a run.
    fn open(run: &Path) -> Result<Parent> {
        let run = RunDir::take_to_read(run)?;
        let checkpoint = checkpoint::latest(&run.checkpoints())?;
        let state = checkpoint::load_state(&checkpoint)?;
        let settings = run.read_config()?;
        checkpoint::check_config(&checkpoint, &state, &settings)?;
        Ok(Parent { config: run.config(), settings, run, checkpoint, state })
    }

    /// Returns the run's settings as a base; the parent's name overrides everything.
    fn base(&self, restart: bool) -> Base<'_> {
        let restarted = if restart { " restarted" } else { "" };
        let name = format!("{}@{}{restarted}", self.state.config_hash, self.state.step);
        let last = vec![(vec!["train".into(), "parent".into()], name.into())];
        // Weights in occupied cells stay there, whatever preset replaces the file.
        let first = vec![placing(self.settings.sampling.kind)];
        Base { file: Some(&self.config), first, last, ..Base::default() }
    }

    /// Returns an error for a child that would train nothing, or that would not query where its own scene is.
    fn check(&self, config: &Config, restart: bool) -> Result<()> {
        let (data, own) = (&config.data, &self.settings.data);
        let is_other = data.dir != own.dir || data.kind != DataKind::Auto && data.kind != own.kind;
        if restart && config.sampling.kind == Placing::Occupancy && is_other {
            return Err(Error::Config(format!(
                "--restart with {} on another scene: its occupied cells leave out where the new scene is; add --set \
                 sampling.kind=resampled --set field.hash.log2_table={}",
                self.run.path().display(),
                self.settings.field.hash.log2_table
            )));
        }
        let steps = config.train.steps;
        if restart || self.state.step < steps {
            return Ok(());
        }
        Err(Error::Config(format!(
            "{}: at step {}, but train.steps = {steps}; raise it with --set train.steps={}, or start at step 0 with --restart",
            self.run.path().display(),
            self.state.step,
            2 * self.state.step.max(1)
        )))
    }
}

impl ResumeArguments {
    pub fn run(self) -> Result<()> {
        let run = RunDir::take(&self.run)?;
        let config = run.read_config()?;
        let device = run.read_timing()?.map_or("cpu".into(), |timing| timing.device);
        self.compute.run_or(&device, |runtime, console| self.resume(run, config, runtime, console))
    }

    fn resume(&self, run: RunDir, mut config: Config, runtime: &Runtime, console: &Console) -> Result<()> {
        if let Some(dir) = &self.sources.data {
            config.data.dir = dir.to_string_lossy().into_owned();
        }
        config.eval.lpips_weights = self.sources.weights.or(&config);
        let lpips = load_lpips(&config.eval.lpips_weights, runtime.device())?;
        let (config, scene) = load_scene_of(&run, config, Photos::Read, console)?;
        let steps = config.train.steps;
        let setup = Setup { config, scene: &scene, lpips: &lpips, runtime: runtime.clone() };
        let job = Job::resume(run, setup)?;
        console.say(&how_it_resumes(&self.run, (job.step_count(), steps)));
        train(job, &self.run, console, self.answer)
    }
}

/// Says where a run resumes, or that it has ended and what trains it further.
fn how_it_resumes(run: &Path, (step, steps): (u64, u64)) -> String {
    let run = run.display();
    match step < steps {
        true => format!("{run} resumes at step {step}"),
        false => format!(
            "{run} has ended at step {step}, the last: it is only measured again, as by `augnerf eval {run}`; more steps are \
             another run: augnerf train --from {run} --set train.steps={}",
            2 * steps
        ),
    }
}

/// Describes the training in one line.
fn what_is_trained(Setup { config, scene, .. }: &Setup) -> String {
    let size = scene.train.first().map(|view| (view.camera.width, view.camera.height)).unwrap_or_default();
    let most = if config.sampling.kind == Placing::Occupancy { "up to " } else { "" };
    format!(
        "{}{} on {}: {} views of {} x {} pixels, {} held out; {} steps of {most}{} rays",
        config.method.name(),
        config.regularizer.added(),
        scene.name,
        scene.train.len(),
        size.0,
        size.1,
        scene.test.len(),
        config.train.steps,
        config.rays_per_step()
    )
}

/// Trains in `folder`. Its name is printed first, so that a script has it even if the training is stopped.
fn train(job: Job, folder: &Path, console: &Console, answer: Answer) -> Result<()> {
    if !answer.json {
        let label = if std::io::stdout().is_terminal() { "run folder: " } else { "" };
        print(&format!("{label}{}", folder.display()))?;
    }
    let signal = catch_signals()?;
    let finished = job.with_previews(PREVIEWS_FROM).train(console, &signal)?;
    summarize(&finished, folder, console);
    let Finished { report, seconds, .. } = &finished;
    let [metrics, _] = RunDir::metrics_in(folder);
    answer.give_silently(&Measured::new((folder, &metrics), report, finished.steps, Some(*seconds)))?;
    // Without train.collapse_steps a sweep counts such a training. Here it is an error all the same.
    report.check_learned(folder)
}

fn summarize(Finished { report, model, seconds, heavy_terms, .. }: &Finished, folder: &Path, console: &Console) {
    let mean = &report.mean;
    let number = |value: Option<f64>, digits: usize| value.map_or("-".into(), |value| format!("{value:.digits$}"));
    let lpips =
        mean.get(Backbone::Squeeze.lpips()).map_or(String::new(), |lpips| format!("  LPIPS(squeeze) {lpips:.3}"));
    console.say(&format!(
        "{} held-out views: PSNR {} dB (one colour: {})  SSIM {}{lpips}  ({} steps, {seconds:.0} s)",
        report.views.len(),
        number(mean.get(&PSNR), 2),
        number(mean.get(&FLOOR_PSNR), 2),
        number(mean.get(&SSIM), 3),
        report.protocol.text("steps"),
    ));
    if !report.training_views.is_empty() {
        console.say(&format!(
            "{} training views: PSNR {} dB (gap {} dB)",
            report.training_views.len(),
            number(mean.get(PSNR.train()), 2),
            number(mean.get(PSNR.gap()), 2),
        ));
    }
    report.no_better_than_one_colour().iter().chain(heavy_terms).for_each(|remark| console.say(remark));
    let inactive = report.inactive_levels();
    if let (Some(site), false) = (report.attack.first(), inactive.is_empty()) {
        console.say(&format!("{}: {}", site.inactive_by().meaning(), inactive.join(", ")));
    }
    console.say(&format!("results: {}", folder.display()));
    let first = report.views.first().map(|view| RunDir::renders_in(folder).join(format!("{}_beside.png", view.name)));
    for picture in first.iter().filter(|picture| picture.is_file()) {
        console.say(&format!("image: {}", picture.display()));
    }
    // What learned nothing has no surface.
    let surface = model.has_density() && report.check_learned(folder).is_ok();
    console.say(&next_commands(folder, surface));
}

/// Names the commands that show a finished run: a mesh only of a run with a `surface`.
fn next_commands(folder: &Path, surface: bool) -> String {
    let folder = folder.display();
    let mesh = surface.then(|| format!("augnerf mesh {folder} --picture mesh.png"));
    let always = |command: &str| Some(format!("augnerf {command} {folder}"));
    let commands = [always("view"), always("render"), mesh, always("report")];
    format!("next: {}", commands.into_iter().flatten().collect::<Vec<_>>().join("\n      "))
}

/// Returns the run folder for settings where none is named: `runs/SCENE-METHOD-HASH`.
pub fn default_folder(config: &Config) -> PathBuf {
    let terms = config.regularizer.kind.iter().map(|term| format!("-{}", term.name()));
    let method = std::iter::once(config.method.name().to_string()).chain(terms).collect::<String>();
    Path::new("runs").join(format!("{}-{method}-{}", config.data.name, config.hash()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_without_surface_is_not_sent_to_mesh() {
        let next = |surface| next_commands(Path::new("runs/a"), surface);
        assert_eq!(next(false), "next: augnerf view runs/a\n      augnerf render runs/a\n      augnerf report runs/a");
        assert!(next(true).contains("\n      augnerf mesh runs/a --picture mesh.png\n"));
    }
}
