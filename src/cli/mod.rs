//! The command line: arguments, devices and progress on the screen. No other module prints.

use std::io::Write;
use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::process::ExitCode;
use std::str::FromStr;
use std::sync::LazyLock;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Args, CommandFactory, FromArgMatches, Parser, Subcommand};

use crate::base::{EXIT_CODES, Error, Result, features, revision, version};
use crate::runtime::{Runtime, instructions, open_runtime};
use crate::settings::Config;

use progress::Console;

mod answer;
mod bench;
mod compare;
mod completions;
mod data;
mod devices;
mod eval;
mod experiment;
mod import;
mod measure;
mod mesh;
mod progress;
mod render;
mod report;
mod score;
mod settings;
mod signals;
mod sweep;
mod tips;
mod train;
mod verify;
mod view;

/// Train and compare neural radiance fields with and without worst-case augmentation
///
/// Start with `augnerf train`: it needs no data and takes half a minute.
#[derive(Parser)]
#[command(version = SHORT_VERSION.as_str(), long_version = LONG_VERSION.as_str(), max_term_width = 100, after_help = exit_codes())]
#[command(arg_required_else_help = true, args_conflicts_with_subcommands = true, override_usage = "augnerf <COMMAND>")]
struct Arguments {
    /// Print a completion script for this shell: bash, elvish, fish, powershell or zsh
    #[arg(long, value_name = "SHELL", hide_possible_values = true)]
    completions: Option<clap_complete::Shell>,
    #[command(subcommand)]
    command: Option<Command>,
}

/// The version and revision, for `-V`.
static SHORT_VERSION: LazyLock<String> = LazyLock::new(|| format!("{} ({})", version(), revision()));

/// What a bug report should contain, for `--version`.
static LONG_VERSION: LazyLock<String> = LazyLock::new(|| {
    let built_in = features().collect::<Vec<_>>().join(", ");
    let built_in = if built_in.is_empty() { "none" } else { &built_in };
    let system = format!("{}-{}", std::env::consts::ARCH, std::env::consts::OS);
    format!(
        "{}\nrevision: {}\nfeatures: {built_in}\ninstructions: {} (of this CPU)\nbuilt for: {system}",
        version(),
        revision(),
        instructions()
    )
});

/// Describes the exit codes, for `--help`.
fn exit_codes() -> String {
    let codes = EXIT_CODES.map(|(code, words)| format!("{code} {words}"));
    format!(
        "Exit codes: 0 done, {}, 129, 130 or 143 stopped with a checkpoint by a hangup, Ctrl-C or SIGTERM.",
        codes.join(", ")
    )
}

const TRAIN_EXAMPLES: &str = "Examples:
  augnerf train                                             # the built-in scene, half a minute
  augnerf train --data fern --preset cpu                    # NeRF on a real scene, minutes
  augnerf train --data fern --preset cpu --method aug-nerf  # with worst-case augmentation

`augnerf settings` lists what --set can change.";

const COMPARE_EXAMPLES: &str = "Examples:
  augnerf compare runs/fern-nerf-* runs/fern-aug-nerf-*  # zoomed to where they differ most
  augnerf compare runs/tab4_fern --rows NeRF,Aug-NeRF --zoom 120,80,100,75
  augnerf compare A B --view 2 --ray 240,96              # density and more along one pixel's ray

Writes compare.svg and compare.json (numbers and protocols). With --ray it writes ray.svg, ray.json and \
ray.csv (coarse, fine and even samples of the pixel's ray) instead.";

const MESH_EXAMPLES: &str = "Examples:
  augnerf mesh runs/builtin-nerf-*                # 256 cells per side of the scene's box
  augnerf mesh RUN --resolution 400 --threshold 5 --bbox -1,-1,-0.5,1,1,1 --format ply,obj
  augnerf mesh RUN --largest --picture mesh.png   # an image, too

The mesh is the level set where density equals the threshold. If a run uses normalized device coordinates, --bbox, \
--resolution and --threshold are in those, and the files are in scene units.";

#[derive(Subcommand)]
enum Command {
    /// Train one scene, evaluate it and render held-out views
    #[command(after_help = TRAIN_EXAMPLES)]
    Train(train::TrainArguments),
    /// Resume a stopped run
    #[command(after_help = train::RESUME_EXAMPLES)]
    Resume(train::ResumeArguments),
    /// Run many experiments and compare them in one table
    #[command(subcommand)]
    Sweep(sweep::SweepCommand),
    /// Check that tables and figures follow from their points
    #[command(after_help = verify::EXAMPLES)]
    Verify(verify::VerifyArguments),
    /// Measure a trained run again, on held-out or other views
    #[command(after_help = eval::EXAMPLES)]
    Eval(eval::EvalArguments),
    /// Measure images that any program rendered, under the same protocol
    #[command(after_help = score::EXAMPLES)]
    Score(score::ScoreArguments),
    /// Write one HTML page that shows runs side by side
    #[command(after_help = report::EXAMPLES)]
    Report(report::ReportArguments),
    /// Render held-out views or a camera path as images and video
    #[command(after_help = render::EXAMPLES)]
    Render(render::RenderArguments),
    /// Look at runs live, on a page that this program serves
    #[command(after_help = view::EXAMPLES)]
    View(view::ViewArguments),
    /// Create a run from a checkpoint of nerf-pytorch
    #[command(after_help = import::IMPORT_EXAMPLES)]
    Import(import::ImportArguments),
    /// Draw one held-out view of several runs, or plot along one ray
    #[command(after_help = COMPARE_EXAMPLES)]
    Compare(compare::CompareArguments),
    /// Extract a mesh from a run's density
    #[command(after_help = MESH_EXAMPLES)]
    Mesh(mesh::MeshArguments),
    /// Check, corrupt or export scenes
    #[command(subcommand)]
    Data(data::DataCommand),
    /// List settings with their values, defaults and effects
    #[command(after_help = settings::EXAMPLES)]
    Settings(settings::SettingsArguments),
    /// Time training steps on synthetic rays, or list devices
    #[command(after_help = bench::EXAMPLES)]
    Bench(bench::BenchArguments),
}

impl Command {
    fn run(self) -> Result<()> {
        match self {
            Command::Train(arguments) => arguments.run(),
            Command::Resume(arguments) => arguments.run(),
            Command::Sweep(command) => command.run(),
            Command::Verify(arguments) => arguments.run(),
            Command::Eval(arguments) => arguments.run(),
            Command::Score(arguments) => arguments.run(),
            Command::Report(arguments) => arguments.run(),
            Command::Bench(arguments) => arguments.run(),
            Command::Render(arguments) => arguments.run(),
            Command::View(arguments) => arguments.run(),
            Command::Import(arguments) => arguments.run(),
            Command::Compare(arguments) => arguments.run(),
            Command::Mesh(arguments) => arguments.run(),
            Command::Data(command) => command.run(),
            Command::Settings(arguments) => arguments.run(),
        }
    }
}

/// The variable that sets the threads of programs on rayon, as this one is.
const RAYON_THREADS: &str = "RAYON_NUM_THREADS";
/// The most threads that can be asked for.
const MOST_THREADS: u16 = 1024;

/// Flags that say where numbers are computed; they change no setting of a run.
#[derive(Args)]
#[command(next_help_heading = "Hardware")]
struct Compute {
    #[arg(long, value_name = "DEVICE", help = DEVICES)]
    device: Option<String>,
    /// CPU threads [default: RAYON_NUM_THREADS, or all cores]
    #[arg(long, value_name = "N", value_parser = whole::<u16>(1..=MOST_THREADS.into()))]
    threads: Option<u16>,
    /// Print errors and the paths of results only
    #[arg(long, short, help_heading = "Output")]
    quiet: bool,
}

const DEVICES: &str = "cpu, gpu, gpu:N, cuda, cuda:N, cuda-tf32 (products rounded to 10 bits) or metal [default: cpu; resume: the run's device]";

/// Flags for a run's scene and LPIPS weights, if they have moved.
#[derive(Args)]
#[command(next_help_heading = "Experiment")]
struct Sources {
    /// Scene folder, if it has moved [default: the run's]
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    #[command(flatten)]
    weights: LpipsWeights,
}

/// The flag for the networks of LPIPS, which are not part of this program.
#[derive(Args, Default)]
#[command(next_help_heading = "Experiment")]
struct LpipsWeights {
    /// Folder with LPIPS weights (.pth or .safetensors) [default: none, LPIPS is not measured]
    #[arg(long, env = "AUGNERF_LPIPS_WEIGHTS", value_name = "DIR")]
    lpips_weights: Option<PathBuf>,
}

/// The flag for a run's scene, if it has moved.
#[derive(Args)]
#[command(next_help_heading = "Experiment")]
struct Moved {
    /// Scene folder, if it has moved [default: the run's]
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
}

impl LpipsWeights {
    /// Returns the folder that the command line names, otherwise the run's.
    fn or(&self, config: &Config) -> String {
        let named = self.lpips_weights.as_ref().map(|dir| dir.to_string_lossy().into_owned());
        named.unwrap_or_else(|| config.eval.lpips_weights.clone())
    }
}

impl Compute {
    /// Does a command's work on the named device and threads, with a console.
    fn run<T: Send>(&self, work: impl FnOnce(&Runtime, &Console) -> Result<T> + Send) -> Result<T> {
        self.run_or("cpu", work)
    }

    /// Does the same with another default device.
    fn run_or<T: Send>(&self, default: &str, work: impl FnOnce(&Runtime, &Console) -> Result<T> + Send) -> Result<T> {
        let (runtime, console) = (self.runtime_or(default)?, Console::new(self.quiet));
        if let Some(accelerator) = runtime.accelerator().filter(|accelerator| accelerator.is_software()) {
            let name = accelerator.description();
            console.say(&format!(
                "device {} is {name}, which the CPU emulates: far slower than --device cpu",
                runtime.name()
            ));
        }
        runtime.install(|| work(&runtime, &console))
    }

    /// Returns the runtime of the named device and threads, with another default device.
    fn runtime_or(&self, default: &str) -> Result<Runtime> {
        let device = self.device.as_deref().unwrap_or(default);
        let threads = self.threads.map(usize::from).or_else(|| self.threads_of_rayon());
        // The messages begin with the name of the flag.
        open_runtime(device, threads).map_err(|error| Error::Config(format!("--{error}")))
    }

    /// Returns the threads that rayon's variable asks for; 0 and nothing are all cores. Says if it is no number.
    fn threads_of_rayon(&self) -> Option<usize> {
        let asked = std::env::var_os(RAYON_THREADS).filter(|asked| !asked.is_empty())?;
        match asked.to_str().and_then(|asked| asked.parse().ok()) {
            Some(threads @ 0..=MOST_THREADS) => (threads > 0).then_some(threads.into()),
            _ => {
                let found = asked.to_string_lossy();
                Console::new(self.quiet).say(&format!(
                    "warning: {RAYON_THREADS}={found} is not a number from 0 to {MOST_THREADS} and is ignored; --threads also sets the threads"
                ));
                None
            }
        }
    }
}

/// Returns a parser of whole numbers of a range.
fn whole<T: TryFrom<u64>>(range: RangeInclusive<u64>) -> impl Fn(&str) -> std::result::Result<T, String> + Clone {
    move |text| {
        let number =
            text.parse().ok().filter(|number| range.contains(number)).and_then(|number| number.try_into().ok());
        number.ok_or_else(|| format!("give a whole number from {} to {}", range.start(), range.end()))
    }
}

/// A value of a flag: its name, its help, and what the library calls it.
type Choice<T> = (&'static str, &'static str, T);

/// Returns a parser of one of these values; help lists all.
fn choice<T: Copy + Send + Sync>(all: &'static [Choice<T>]) -> impl TypedValueParser<Value = T> {
    let values = all.iter().map(|(name, help, _)| PossibleValue::new(*name).help(*help));
    PossibleValuesParser::new(values)
        .map(move |name| all.iter().find(|(known, ..)| *known == name).expect("a possible value").2)
}

/// Parses exactly `N` numbers with commas between them.
fn numbers<T: FromStr, const N: usize>(text: &str) -> Option<[T; N]> {
    let numbers: Option<Vec<T>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
    numbers?.try_into().ok()
}

/// Returns the definition of the command line: commands, flags and their help.
pub fn command() -> clap::Command {
    Arguments::command().mut_subcommands(grouped)
}

/// Flags from which on a command's help groups them.
const MANY_FLAGS: usize = 7;

/// Removes the groups from the help of commands with few flags, and takes `-1` as the value of a flag, not as a flag.
fn grouped(command: clap::Command) -> clap::Command {
    let flags = command.get_arguments().filter(|flag| !flag.is_positional() && !flag.is_hide_set()).count();
    let command = command.mut_subcommands(grouped).mut_args(|flag| {
        let takes_value = !flag.is_positional() && flag.get_action().takes_values();
        flag.allow_negative_numbers(takes_value)
    });
    if flags >= MANY_FLAGS { command } else { command.mut_args(|flag| flag.help_heading(None::<&str>)) }
}

/// Runs the program; the exit code is that of the error's class.
pub fn main() -> ExitCode {
    if env!("AUGNERF_COMMANDS_DIFFER") == "true" {
        augnerf_run::revision::commands_differ();
    }
    signals::survive_large_files();
    let parsed = command().try_get_matches().and_then(|matches| Arguments::from_arg_matches(&matches));
    let arguments = match parsed {
        Ok(arguments) => arguments,
        Err(answer) => return say(&tips::with_tips(answer, &std::env::args_os().skip(1).collect::<Vec<_>>())),
    };
    let done = arguments.command.map_or_else(|| completions::print(arguments.completions), Command::run);
    done.map_or_else(|error| fail(&error), |()| ExitCode::SUCCESS)
}

/// Prints an error and returns its exit code.
fn fail(error: &Error) -> ExitCode {
    let word = match error {
        Error::Interrupted { .. } => "stopped",
        Error::PointsWaiting(_) => "not done",
        _ => "error",
    };
    progress::report(&format!("{word}: {error}"));
    ExitCode::from(error.exit_code())
}

/// Prints the requested help or version, or the error in the arguments.
fn say(answer: &clap::Error) -> ExitCode {
    let written = answer.print().and_then(|()| std::io::stdout().flush());
    match progress::printed(written) {
        Err(error) if !answer.use_stderr() => fail(&error),
        _ => ExitCode::from(answer.exit_code() as u8),
    }
}
