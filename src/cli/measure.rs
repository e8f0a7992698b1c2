//! `augnerf measure` and `augnerf balance`.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;
use serde_json::json;

use crate::base::csv::csv_text;
use crate::base::{Error, Result};
use crate::run::{
    BalancedWeight, FieldSmoothness, OpenOptions, RunDir, SMOOTHNESS_SIDE, Trained, balance, check_measurable, columns,
    smoothness_box,
};
use crate::runtime::Runtime;
use crate::settings::Config;
use crate::settings::registry::check_flag;
use crate::space::Lattice;

use super::answer::Answer;
use super::experiment::{Experiment, say_without_effect};
use super::progress::{Console, print};
use super::{Compute, UnusedWeights, numbers};

/// The smoothness of one network of a run.
#[derive(Serialize)]
struct Measured<'a> {
    run: String,
    #[serde(flatten)]
    field: &'a FieldSmoothness,
}

#[derive(Args)]
#[command(next_help_heading = "Experiment")]
pub struct MeasureArguments {
    /// Run folders (newest checkpoints)
    #[arg(required = true)]
    runs: Vec<PathBuf>,
    /// Cells along each side of the box; compare equal values only
    #[arg(long, value_name = "N", default_value_t = SMOOTHNESS_SIDE)]
    lattice: usize,
    /// Corners of the box in the field's units [default: -1..1; for transforms.json, COLMAP and spherified scenes the
    /// region that most cameras view]
    #[arg(long, alias = "domain", value_name = "X,Y,Z,X,Y,Z", allow_hyphen_values = true)]
    bbox: Option<String>,
    /// Scene folder, if it has moved [default: the run's]
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    #[command(flatten)]
    answer: Answer,
    #[command(flatten)]
    compute: Compute,
}

impl MeasureArguments {
    pub fn run(self) -> Result<()> {
        let domain = self.bbox.as_deref().map(|text| parse_box("bbox", text)).transpose()?;
        domain.map_or(Ok(()), |domain| check_flag("--bbox", "regularizer.domain", &domain))?;
        check_flag("--lattice", "regularizer.lattice", &self.lattice)?;
        // A run without such numbers is an error before the first is measured.
        for run in &self.runs {
            check_measurable(run, &RunDir::open(run)?.read_config()?)?;
        }
        self.compute.run(|runtime, console| self.measure(domain, runtime, console))
    }

    fn measure(&self, domain: Option<[[f64; 3]; 2]>, runtime: &Runtime, console: &Console) -> Result<()> {
        let (mut header, mut measured) = (true, Vec::new());
        for run in &self.runs {
            let trained = Trained::open_at(run, OpenOptions::CAMERAS, self.data.as_deref(), runtime, console)?;
            let domain = domain.unwrap_or_else(|| smoothness_box(&trained.scene));
            let lattice = Lattice { domain, side: self.lattice };
            lattice.check_meets(&trained.scene, "--bbox")?;
            let report = trained.measure_smoothness(&lattice, console)?;
            for field in &report.fields {
                let row = Measured { run: run.display().to_string(), field };
                if self.answer.json {
                    measured.push(serde_json::to_value(row).expect("plain data"));
                    continue;
                }
                let (names, values): (Vec<_>, Vec<_>) = columns(&row).into_iter().unzip();
                if std::mem::take(&mut header) {
                    print(&csv_line(&names))?;
                }
                print(&csv_line(&values))?;
            }
            let file = trained.run.smoothness();
            console.say(&match trained.run.is_writable() {
                true => format!("with the run's protocol: {}", file.display()),
                false => format!("{}: read-only, so {} is unchanged", run.display(), file.display()),
            });
        }
        self.answer.give_silently(&json!({ "fields": measured }))
    }
}

/// Formats cells as a line of CSV.
pub fn csv_line(cells: &[String]) -> String {
    csv_text([cells.to_vec()]).trim_end().to_string()
}

/// Parses the two corners of a box, the value of the flag `flag`.
pub fn parse_box(flag: &str, text: &str) -> Result<[[f64; 3]; 2]> {
    let [a, b, c, d, e, f] = numbers(text).ok_or_else(|| {
        Error::Config(format!(
            "--{flag} {text}: not six numbers; give the two corners of the box, such as -1,-1,-1,1,1,1"
        ))
    })?;
    Ok([[a, b, c], [d, e, f]])
}

#[derive(Args)]
pub struct BalanceArguments {
    #[command(flatten)]
    experiment: Experiment,
    /// Steps of plain training before the measurement
    #[arg(long, value_name = "N", default_value_t = 100, help_heading = "Experiment")]
    steps: u64,
    #[command(flatten)]
    _unused: UnusedWeights,
    #[command(flatten)]
    answer: Answer,
    #[command(flatten)]
    compute: Compute,
}

impl BalanceArguments {
    pub fn run(self) -> Result<()> {
        self.compute.run(|runtime, console| self.balance(runtime, console))
    }

    fn balance(&self, runtime: &Runtime, console: &Console) -> Result<()> {
        let config = self.experiment.config(console)?;
        say_without_effect(self.experiment.settings(), |setting| not_balanced(&config, setting), console);
        let (config, lines) = balance(config, self.steps, runtime, console)?;
        let answer = json!({ "scene": config.data.name, "steps": self.steps, "weights": lines });
        self.answer.give(&answer, || print(&balance_csv(&config.data.name, self.steps, &lines)))?;
        console.say(
            "share: the term's gradient norm at that weight, divided by the photometric loss's; use a weight with \
             --set regularizer.kind=TERM --set regularizer.weight=WEIGHT",
        );
        Ok(())
    }
}

/// Returns why a setting has no effect on `balance`, or `None` if it may have one. Section `regularizer` says where terms are
/// evaluated, whichever terms it names.
fn not_balanced(config: &Config, setting: &str) -> Option<String> {
    match setting {
        "regularizer.kind" | "regularizer.weight" | "regularizer.schedule" => {
            Some("balance measures every term at weight 1".into())
        }
        _ if setting.starts_with("regularizer.") => None,
        _ => config.without_effect(setting),
    }
}

/// Formats the weights as CSV without a final newline.
fn balance_csv(scene: &str, steps: u64, lines: &[BalancedWeight]) -> String {
    let head = ["scene", "steps", "term", "photometric_norm", "term_norm", "share", "weight"].map(String::from);
    let rows = lines.iter().map(|line| {
        vec![
            scene.to_string(),
            steps.to_string(),
            line.term.clone(),
            format!("{:e}", line.photometric_norm),
            format!("{:e}", line.term_norm),
            format!("{:.3}", line.share),
            line.weight.map_or(String::new(), |weight| format!("{weight:.2e}")),
        ]
    });
    csv_text(std::iter::once(head.to_vec()).chain(rows)).trim_end().to_string()
}
