//! `augnerf eval --smoothness` and `augnerf train --balance`.

use std::path::Path;

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
use super::{Compute, numbers};

/// The smoothness of one network of a run.
#[derive(Serialize)]
struct Measured<'a> {
    run: String,
    #[serde(flatten)]
    field: &'a FieldSmoothness,
}

/// Flags for the smoothness of density.
#[derive(Args)]
#[command(next_help_heading = "Experiment")]
pub struct SmoothnessArguments {
    /// Measure how smooth the density is, as CSV, instead of images
    #[arg(long, conflicts_with_all = ["step", "split", "out"])]
    pub smoothness: bool,
    /// Cells along each side of the box; compare equal values only
    #[arg(long, value_name = "N", default_value_t = SMOOTHNESS_SIDE, requires = "smoothness")]
    lattice: usize,
    /// Corners of the box in the field's units [default: -1..1; for transforms.json, COLMAP and spherified scenes the
    /// region that most cameras view]
    #[arg(long, value_name = "X,Y,Z,X,Y,Z", allow_hyphen_values = true, requires = "smoothness")]
    bbox: Option<String>,
}

impl SmoothnessArguments {
    /// Measures a run, and prints a row for each of its networks.
    pub fn measure(&self, path: &Path, data: Option<&Path>, answer: Answer, compute: &Compute) -> Result<()> {
        let domain = self.bbox.as_deref().map(|text| parse_box("bbox", text)).transpose()?;
        domain.map_or(Ok(()), |domain| check_flag("--bbox", "regularizer.domain", domain))?;
        check_flag("--lattice", "regularizer.lattice", self.lattice)?;
        check_measurable(path, &RunDir::open(path)?.read_config()?)?;
        compute.run(|runtime, console| {
            let trained = Trained::open_at(path, OpenOptions::CAMERAS, data, runtime, console)?;
            let domain = domain.unwrap_or_else(|| smoothness_box(&trained.scene));
            let lattice = Lattice { domain, side: self.lattice };
            lattice.check_meets(&trained.scene, "--bbox")?;
            let report = trained.measure_smoothness(&lattice, console)?;
            let fields: Vec<Measured> =
                report.fields.iter().map(|field| Measured { run: path.display().to_string(), field }).collect();
            answer.give(&json!({ "fields": fields }), || {
                let rows: Vec<_> = fields.iter().map(columns).collect();
                let names = rows[0].iter().map(|(name, _)| name.clone()).collect();
                let values = rows.iter().map(|row| row.iter().map(|(_, value)| value.clone()).collect());
                print(csv_text(std::iter::once(names).chain(values)).trim_end())
            })?;
            let file = trained.run.smoothness();
            console.say(&match trained.run.is_writable() {
                true => format!("with the run's protocol: {}", file.display()),
                false => format!("{}: read-only, so {} is unchanged", path.display(), file.display()),
            });
            Ok(())
        })
    }
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

/// Measures the weights that balance the terms after `steps` steps, and prints them.
pub fn print_balance(experiment: &Experiment, steps: u64, answer: Answer, on: (&Runtime, &Console)) -> Result<()> {
    let (runtime, console) = on;
    let config = experiment.config(console)?;
    say_without_effect(experiment.settings(), |setting| not_balanced(&config, setting), console);
    let on_hash_grid = config.on_hash_grid();
    let (config, lines) = balance(config, steps, runtime, console)?;
    let report = json!({ "scene": config.data.name, "steps": steps, "weights": lines });
    answer.give(&report, || print(&balance_csv(&config.data.name, steps, &lines)))?;
    // Occupied cells, which preset `fast` takes for objects, need weights of their own.
    let samples = if on_hash_grid { " --set sampling.kind=resampled" } else { "" };
    console.say(&format!(
        "share: the term's gradient norm at that weight, divided by the photometric loss's; use a weight with \
         --set regularizer.kind=TERM --set regularizer.weight=WEIGHT{samples}",
    ));
    Ok(())
}

/// Returns why a setting has no effect on `--balance`, or `None` if it may have one. Section `regularizer` says where terms are
/// evaluated, whichever terms it names.
fn not_balanced(config: &Config, setting: &str) -> Option<String> {
    match setting {
        "regularizer.kind" | "regularizer.weight" | "regularizer.schedule" => {
            Some("--balance measures every term at weight 1".into())
        }
        "train.steps" => Some("--balance=STEPS names the steps".into()),
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
