//! `augnerf bench`.

use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser};

use crate::base::Result;
use crate::bench::{self, Workload};
use crate::settings::parse_assignment;

use super::Compute;
use super::answer::Answer;
use super::progress::print;

pub const EXAMPLES: &str = "Examples:
  augnerf bench  # steps of NeRF's networks, 1,024 rays of 64 + 64 samples
  augnerf bench --method aug-nerf --rays 512 --width 64 --set field.encoding=hash";

#[derive(Args)]
pub struct BenchArguments {
    /// A method as train names it, or nerf with one regularizer
    #[arg(long, default_value = "nerf", value_parser = methods())]
    method: String,
    /// Rays of a step [default: 1024]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=4096))]
    rays: Option<u16>,
    /// Samples of the coarse pass [default: 64]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(3..=4096))]
    coarse: Option<u16>,
    /// Further samples of the fine pass (mip: all its intervals) [default: 64]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(..=4096))]
    fine: Option<u16>,
    /// Width of both networks, which have 8 layers, or of SRN's layers [default: 256]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(4..=4096))]
    width: Option<u16>,
    /// Steps that are timed, after two that are not
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u16).range(1..))]
    steps: u16,
    /// Any setting over the defaults: --set field.core=plain
    #[arg(long, value_name = "FIELD=VALUE")]
    set: Vec<String>,
    #[command(flatten)]
    compute: Compute,
    #[command(flatten)]
    answer: Answer,
}

impl BenchArguments {
    pub fn run(self) -> Result<()> {
        let runtime = self.compute.runtime()?;
        let workload = Workload {
            method: self.method,
            rays: self.rays.map(usize::from),
            coarse: self.coarse.map(usize::from),
            fine: self.fine.map(usize::from),
            width: self.width.map(usize::from),
            steps: self.steps.into(),
            set: self.set.iter().map(|text| parse_assignment(text)).collect::<Result<_>>()?,
        };
        let timed = workload.run(&runtime)?;
        // JSON it always was.
        self.answer.give(&timed, || print(&serde_json::to_string(&timed).expect("plain data")))
    }
}

/// The names, with those that they had before as hidden ones.
fn methods() -> PossibleValuesParser {
    let names = bench::methods().into_iter();
    names.map(|(name, before)| PossibleValue::new(name).aliases(before)).collect::<Vec<_>>().into()
}
