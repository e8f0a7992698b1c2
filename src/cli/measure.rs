//! `augnerf measure` and `augnerf balance`.

use std::path::PathBuf;

use candle_core::DType;
use clap::Args;

use crate::base::{Error, Result};
use crate::run::{Protocol, RunDir, SmoothnessReport, columns, load_scene, run_config};
use crate::settings::{LatticePoints, Method, REGULARIZERS, RegularizerConfig, validate_regularizer};
use crate::space::Lattice;
use crate::train::Trainer;

use super::eval::Trained;
use super::experiment::Experiment;
use super::progress::{Screen, TrainingBar, print};
use super::{Machine, numbers};

/// The share of the photometric pull that the middle of a grid of weights has.
const MIDDLE_SHARE: f64 = 0.1;
/// The grid: two decades to each side of the middle.
const GRID: [f64; 5] = [1e-2, 1e-1, 1.0, 1e1, 1e2];

#[derive(Args)]
pub struct MeasureArguments {
    /// Run folders; each run's newest checkpoint is measured
    #[arg(required = true)]
    runs: Vec<PathBuf>,
    /// Cells along each side of the box; numbers of different lattices are not comparable
    #[arg(long, value_name = "N", default_value_t = 64)]
    lattice: usize,
    /// Corners of the box in the units that the field is asked in (NDC where the run uses it)
    #[arg(long, value_name = "X,Y,Z,X,Y,Z", default_value = "-1,-1,-1,1,1,1", allow_hyphen_values = true)]
    domain: String,
    /// Scene folder, if it has moved since training
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    #[command(flatten)]
    machine: Machine,
}

impl MeasureArguments {
    pub fn run(self) -> Result<()> {
        let device = self.machine.device()?;
        let screen = Screen::new(self.machine.quiet);
        let domain = parse_box("domain", &self.domain)?;
        let lattice = Lattice { domain, side: self.lattice };
        validate_regularizer(&RegularizerConfig {
            domain,
            lattice: self.lattice,
            points: LatticePoints::Full,
            ..RegularizerConfig::default()
        })
        .map_err(|error| Error::Config(error.to_string().replace("regularizer.", "--")))?;
        for run in &self.runs {
            let method = run_config(&RunDir::open(run)?)?.method;
            if method.is_mip() {
                return Err(Error::Config(format!(
                    "{}: a field of method {} is asked at Gaussians, not at points, and has no l1, TV or Laplacian; measure \
                     nerf and aug-nerf runs",
                    run.display(),
                    method.name()
                )));
            }
        }
        let mut header = true;
        for run in &self.runs {
            let trained = Trained::open(run, self.data.as_deref(), &device, &screen)?;
            let Trained { run: folder, config, scene, state, model } = &trained;
            let protocol = Protocol::new(config, scene, state);
            let report = SmoothnessReport::measure(model, scene, &lattice, protocol, &device, &screen)?;
            report.write(&folder.smoothness())?;
            for field in &report.fields {
                let (mut names, mut values): (Vec<_>, Vec<_>) = columns(field).into_iter().unzip();
                names.insert(0, "run".into());
                values.insert(0, run.display().to_string());
                if std::mem::take(&mut header) {
                    print(&csv_line(&names));
                }
                print(&csv_line(&values));
            }
            screen.say(&format!("with the run's protocol: {}", folder.smoothness().display()));
        }
        Ok(())
    }
}

/// Cells as a line of CSV.
pub fn csv_line(cells: &[String]) -> String {
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(cells).expect("memory holds it");
    let line = writer.into_inner().expect("memory holds it");
    String::from_utf8(line).expect("text stays text").trim_end().to_string()
}

/// The two corners of a box as the flag `flag` takes them.
pub fn parse_box(flag: &str, text: &str) -> Result<[[f64; 3]; 2]> {
    let [a, b, c, d, e, f] = numbers(text).ok_or_else(|| {
        Error::Config(format!(
            "--{flag} {text}: give the two corners of the box as six numbers, such as -1,-1,-1,1,1,1"
        ))
    })?;
    Ok([[a, b, c], [d, e, f]])
}

#[derive(Args)]
pub struct BalanceArguments {
    #[command(flatten)]
    experiment: Experiment,
    /// Steps of plain training before the measurement
    #[arg(long, value_name = "N", default_value_t = 100)]
    steps: u64,
    #[command(flatten)]
    machine: Machine,
}

impl BalanceArguments {
    pub fn run(self) -> Result<()> {
        let device = self.machine.device()?;
        let screen = Screen::new(self.machine.quiet);
        let mut config = self.experiment.config()?;
        if config.method != Method::Nerf {
            return Err(Error::Config(format!(
                "balance measures regularizers beside the loss of plain NeRF: leave method {} out",
                config.method.name()
            )));
        }
        // Where terms are evaluated; the training itself is without any.
        let regularizer = std::mem::take(&mut config.regularizer);
        let (config, scene) = load_scene(config, &screen)?;
        Lattice { domain: regularizer.domain, side: regularizer.lattice }.check_meets(&scene, "regularizer.domain")?;
        let mut trainer = Trainer::new(&config, &scene, DType::F32, &device)?;
        trainer.check_duration(&regularizer, REGULARIZERS.len() as u64)?;
        let mut bar = TrainingBar::new(self.machine.quiet, 0, self.steps, config.train.rays);
        for _ in 0..self.steps {
            let stats = trainer.step(false)?;
            bar.stepped(stats.step, stats.loss, stats.psnr());
        }
        bar.finish();
        print("scene,steps,term,photometric_norm,term_norm,share,weight");
        for balance in trainer.balance(&regularizer)? {
            for factor in GRID {
                let share = MIDDLE_SHARE * factor;
                // Nothing to divide by where the term has no pull: no weight, rather than a wrong one.
                let weight = share * balance.photometric_norm / balance.term_norm;
                let weight = if weight.is_finite() { format!("{weight:.2e}") } else { String::new() };
                print(&csv_line(&[
                    config.data.name.clone(),
                    self.steps.to_string(),
                    balance.term.name().into(),
                    format!("{:e}", balance.photometric_norm),
                    format!("{:e}", balance.term_norm),
                    format!("{share:.3}"),
                    weight,
                ]));
            }
        }
        screen.say(
            "share: the term's pull on the weights at that weight, over the photometric loss's; use a weight with \
             --set regularizer.kind=TERM --set regularizer.weight=WEIGHT",
        );
        Ok(())
    }
}
