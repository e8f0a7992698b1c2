//! The command line: arguments, devices, progress on the screen. Nothing else prints.

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;
use std::str::FromStr;
use std::sync::LazyLock;

use clap::{Args, CommandFactory, Parser, Subcommand};

use crate::base::{Class, Error, Result, features, revision, version};
use crate::runtime::{Runtime, instructions};
use crate::settings::Config;

mod answer;
mod bench;
mod compare;
mod data;
mod eval;
mod exchange;
mod experiment;
mod manual;
mod measure;
mod mesh;
mod profile;
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

/// Trains neural radiance fields, plain (NeRF) and with worst-case augmentation (Aug-NeRF), and
/// measures them under one protocol.
///
/// Start with `augnerf train`: it needs no data and takes less than a minute.
#[derive(Parser)]
#[command(version = SHORT_VERSION.as_str(), long_version = LONG_VERSION.as_str(), max_term_width = 100, after_help = exit_codes())]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

/// Version and revision, for `-V`.
static SHORT_VERSION: LazyLock<String> = LazyLock::new(|| format!("{} ({})", version(), revision()));

/// What a report of a defect should say, for `--version`.
static LONG_VERSION: LazyLock<String> = LazyLock::new(|| {
    let built_in = features().collect::<Vec<_>>().join(", ");
    let built_in = if built_in.is_empty() { "none" } else { &built_in };
    let system = format!("{}-{}", std::env::consts::ARCH, std::env::consts::OS);
    format!(
        "{}\nrevision: {}\nfeatures: {built_in}\ninstructions: {} (of this processor)\nbuilt for: {system}",
        version(),
        revision(),
        instructions()
    )
});

/// What the exit codes mean, for `--help`.
fn exit_codes() -> String {
    let classes = Class::ALL.map(|class| format!("{} {}", class.exit_code(), class.words()));
    format!(
        "Exit codes: 0 done, {}, 129, 130 or 143 stopped by a hangup, Ctrl-C or SIGTERM with a checkpoint (resume it).",
        classes.join(", ")
    )
}

const TRAIN_EXAMPLES: &str = "Examples:
  augnerf train                                             # the embedded scene, under a minute
  augnerf train --data fern --preset cpu                    # NeRF on a real scene, minutes
  augnerf train --data fern --preset cpu --method aug-nerf  # the same with worst-case augmentation
  augnerf train --data fern --preset cpu --method aug-nerf --set perturb.attack=calibrated
  augnerf train --data fern --preset cpu --method aug-nerf --set 'perturb.levels=[\"feature\"]'
  augnerf train --data fern --preset cpu --set regularizer.kind=tv --set regularizer.weight=8e-7
  augnerf train --data fern --preset cpu --set 'regularizer.kind=[\"tv\",\"l1\"]'
  augnerf train --data fern --preset fast --method srn     # or llff; nv on bounded scenes
  augnerf train --data fern --preset paper-llff --print-config";

const MEASURE_EXAMPLES: &str = "Examples:
  augnerf measure runs/fern-nerf-*  # coarse and fine field, 64 cells a side
  augnerf measure runs/fern-nerf-* --lattice 128 > smoothness.csv

Each run's own smoothness.csv has the same numbers with the run's whole protocol.";

const BALANCE_EXAMPLES: &str = "Examples:
  augnerf balance --data fern --preset cpu  # after 100 steps of plain NeRF
  augnerf balance --data fern --preset cpu --set regularizer.points_per_step=16384

For each term the weights at which its gradient is 0.1 %, 1 %, 10 %, 100 % and 1000 % as long as the photometric loss's.";

const COMPARE_EXAMPLES: &str = "Examples:
  augnerf compare runs/fern-nerf-* runs/fern-aug-nerf-*         # where they differ most
  augnerf compare A B --view 2 --zoom 120,80,100,75 --gif       # a box of your own, and a fade
  augnerf compare A B C --label NeRF --label TV --label Aug-NeRF --box-width 64 --out figures/fern
  augnerf compare runs/tab4_fern --rows NeRF,Aug-NeRF --seed 0  # rows of a sweep by their names

It leaves compare.png, compare.json with its numbers and each run's protocol, and fade.gif.";

const PROFILE_EXAMPLES: &str = "Examples:
  augnerf profile runs/fern-nerf-* runs/fern-aug-nerf-*  # the ray of the first view's middle pixel
  augnerf profile A B --view 2 --pixel 240,96 --patch 16 --out figures/ray

It leaves profile.png and profile.svg; ray.csv: the samples of the pixel's ray as an evaluation takes them (coarse, fine), and \
even ones; patch.csv: even samples of all rays of the patch; profile.json: how smooth each run is.";

const MESH_EXAMPLES: &str = "Examples:
  augnerf mesh runs/builtin-nerf-*                # 256 cells a side of the scene's own box
  augnerf mesh runs/chair-nerf-* --preset paper   # 512 cells a side of [-1,1]^3, density 25
  augnerf mesh RUN --resolution 400 --threshold 5 --bbox -1,-1,-0.5,1,1,1 --format ply,obj
  augnerf mesh RUN --picture mesh.png --view 0,4  # shaded, from two held-out views' cameras
  augnerf mesh builtin --picture truth.png --paint colours --at 0.1,0.6

A density has no surface of its own: the mesh is the level set where it equals the threshold. Where that leaves the box \
the mesh is open, unless --cap closes it. Runs in normalised device coordinates are cut in those (--bbox, --resolution, \
--threshold) and written in scene units.";

const CHAMFER_EXAMPLES: &str = "Examples:
  augnerf chamfer RUN builtin  # a run's mesh against the embedded scene
  augnerf chamfer mesh.ply reference.obj --at 0.005,0.01 --points 1000000

chamfer is the sum of both mean distances to the other surface's nearest point (Euclidean). Both meshes count as they \
are, with surfaces that no camera sees; of the embedded scene, what lies inside of it does not. floor is what two drawings \
of one surface would give with as many points.";

#[derive(Subcommand)]
enum Command {
    /// Train one scene, evaluate it and render held-out views
    #[command(after_help = TRAIN_EXAMPLES)]
    Train(train::TrainArguments),
    /// Go on with a run that was stopped or killed
    #[command(after_help = train::RESUME_EXAMPLES)]
    Resume(train::ResumeArguments),
    /// Run many experiments as one table: rows, axes, seeds, paired differences
    #[command(subcommand)]
    Sweep(sweep::SweepCommand),
    /// Check that committed tables, figures and quoted numbers come out of their points
    #[command(after_help = verify::EXAMPLES)]
    Verify(verify::VerifyArguments),
    /// Measure a trained run again: its held-out views, or others
    #[command(after_help = eval::EXAMPLES)]
    Eval(eval::EvalArguments),
    /// Measure pictures that any program rendered, under the same protocol, alone or as a row of a sweep's table
    #[command(after_help = score::EXAMPLES)]
    Score(score::ScoreArguments),
    /// One page of runs side by side: table, figures, views, protocol, in one file that fetches nothing
    #[command(after_help = report::EXAMPLES)]
    Report(report::ReportArguments),
    /// Measure how smooth runs are: l1, total variation and Laplacian of density on a full lattice, as CSV
    #[command(after_help = MEASURE_EXAMPLES)]
    Measure(measure::MeasureArguments),
    /// Measure which regularizer weights balance the photometric loss, as CSV: the grid for a search
    #[command(after_help = BALANCE_EXAMPLES)]
    Balance(measure::BalanceArguments),
    /// Render held-out views or a camera path: PNG frames, depth maps, GIFs and MP4s
    #[command(after_help = render::EXAMPLES)]
    Render(render::RenderArguments),
    /// Write a run's weights for other programs: nerf-pytorch's checkpoints, safetensors with metadata
    #[command(after_help = exchange::EXPORT_EXAMPLES)]
    Export(exchange::ExportArguments),
    /// Make a run of weights that nerf-pytorch or `export` wrote, to be measured, rendered or trained further
    #[command(after_help = exchange::IMPORT_EXAMPLES)]
    Import(exchange::ImportArguments),
    /// Put runs side by side: one held-out view with zoom, error and depth, as one picture
    #[command(after_help = COMPARE_EXAMPLES)]
    Compare(compare::CompareArguments),
    /// Look along a ray: density, weight and colour of several runs, over it and over a small patch
    #[command(after_help = PROFILE_EXAMPLES)]
    Profile(profile::ProfileArguments),
    /// Draw a trained density's surface as a mesh: PLY or OBJ with normals and colours, in RUN/mesh
    #[command(after_help = MESH_EXAMPLES)]
    Mesh(mesh::MeshArguments),
    /// Measure how far two meshes are apart: Chamfer distance and F-scores, as CSV
    #[command(after_help = CHAMFER_EXAMPLES)]
    Chamfer(mesh::ChamferArguments),
    /// Look at scenes
    #[command(subcommand)]
    Data(data::DataCommand),
    /// Explain the settings of --set and files: values, defaults, what each can change
    #[command(after_help = settings::EXAMPLES)]
    Settings(settings::SettingsArguments),
    /// Time training steps on made-up rays, as one line of JSON
    #[command(after_help = bench::EXAMPLES)]
    Bench(bench::BenchArguments),
    /// Print what a shell completes commands and flags with
    #[command(after_help = manual::COMPLETIONS_EXAMPLES)]
    Completions(manual::CompletionsArguments),
    /// Write manual pages, one a command
    #[command(after_help = manual::MAN_EXAMPLES)]
    Man(manual::ManArguments),
}

/// Where the numbers are computed; changes no setting of a run.
#[derive(Args)]
struct Compute {
    #[arg(long, value_name = "DEVICE", help = DEVICES)]
    device: Option<String>,
    /// Processor threads [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// No progress and no remarks; errors and answers are still printed
    #[arg(long, short)]
    quiet: bool,
}

const DEVICES: &str = "cpu, cuda, cuda:N, cuda-tf32 (matrix products of numbers rounded to 10 bits) or metal [default: \
cpu, resume: the run's]";

/// Where a run's scene and LPIPS weights are, if not where they were.
#[derive(Args)]
struct Sources {
    /// Scene folder, if it has moved since training
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    #[command(flatten)]
    weights: LpipsWeights,
}

/// LPIPS needs networks that are not part of this program.
#[derive(Args)]
struct LpipsWeights {
    /// Folder with LPIPS weights (squeeze_lin_v0.1.pth, squeezenet1_1_features.pth, ...; also .safetensors); without
    /// it the lpips and average columns stay empty
    #[arg(long, env = "AUGNERF_LPIPS_WEIGHTS", value_name = "DIR")]
    lpips_weights: Option<PathBuf>,
}

/// Where a run's scene is, if not where it was.
#[derive(Args)]
struct Moved {
    /// Scene folder, if it has moved since training
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    #[command(flatten)]
    _unused: UnusedWeights,
}

/// The same flag where nothing is measured: taken, as it always was, and not offered.
#[derive(Args)]
struct UnusedWeights {
    #[arg(long, value_name = "DIR", hide = true)]
    lpips_weights: Option<PathBuf>,
}

impl LpipsWeights {
    /// The folder that the command line names, otherwise the one that the run was trained with.
    fn or(&self, config: &Config) -> String {
        let named = self.lpips_weights.as_ref().map(|dir| dir.to_string_lossy().into_owned());
        named.unwrap_or_else(|| config.eval.lpips_weights.clone())
    }
}

impl Compute {
    /// The device and threads that are named.
    fn runtime(&self) -> Result<Runtime> {
        self.runtime_or("cpu")
    }

    /// The same with another default device.
    fn runtime_or(&self, default: &str) -> Result<Runtime> {
        let device = self.device.as_deref().unwrap_or(default);
        // The sentences begin with what is called a flag here.
        Runtime::new(device, self.threads.map(usize::from)).map_err(|error| Error::Config(format!("--{error}")))
    }
}

/// Exactly `N` numbers with commas between them.
fn numbers<T: FromStr, const N: usize>(text: &str) -> Option<[T; N]> {
    let numbers: Option<Vec<T>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
    numbers?.try_into().ok()
}

/// The definition of the command line: commands, flags and their help.
pub fn command() -> clap::Command {
    Arguments::command()
}

/// Runs the program; the exit code is that of the error's class.
pub fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(answer) => return say(&tips::with_tips(answer, &std::env::args_os().skip(1).collect::<Vec<_>>())),
    };
    let done = match arguments.command {
        Command::Train(arguments) => arguments.run(),
        Command::Resume(arguments) => arguments.run(),
        Command::Sweep(command) => command.run(),
        Command::Verify(arguments) => arguments.run(),
        Command::Eval(arguments) => arguments.run(),
        Command::Score(arguments) => arguments.run(),
        Command::Report(arguments) => arguments.run(),
        Command::Measure(arguments) => arguments.run(),
        Command::Balance(arguments) => arguments.run(),
        Command::Bench(arguments) => arguments.run(),
        Command::Render(arguments) => arguments.run(),
        Command::Export(arguments) => arguments.run(),
        Command::Import(arguments) => arguments.run(),
        Command::Compare(arguments) => arguments.run(),
        Command::Profile(arguments) => arguments.run(),
        Command::Mesh(arguments) => arguments.run(),
        Command::Chamfer(arguments) => arguments.run(),
        Command::Data(command) => command.run(),
        Command::Settings(arguments) => arguments.run(),
        Command::Completions(arguments) => arguments.run(),
        Command::Man(arguments) => arguments.run(),
    };
    done.map_or_else(|error| fail(&error), |()| ExitCode::SUCCESS)
}

/// Ends with what went wrong.
fn fail(error: &Error) -> ExitCode {
    let word = if matches!(error, Error::Interrupted { .. }) { "stopped" } else { "error" };
    progress::report(&format!("{word}: {error}"));
    ExitCode::from(error.exit_code())
}

/// Prints the help or version that was asked for, or what is wrong with the arguments.
fn say(answer: &clap::Error) -> ExitCode {
    let written = answer.print().and_then(|()| std::io::stdout().flush());
    match progress::printed(written) {
        Err(error) if !answer.use_stderr() => fail(&error),
        _ => ExitCode::from(answer.exit_code() as u8),
    }
}
