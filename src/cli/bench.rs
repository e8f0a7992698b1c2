//! `augnerf bench`.

use clap::Args;

use crate::base::Result;
use crate::bench::{self, Workload};
use crate::settings::parse_assignment;

use super::answer::Answer;
use super::experiment::say_without_effect;
use super::progress::print;
use super::{Compute, devices, whole};

pub const EXAMPLES: &str = "Examples:
  augnerf bench                            # NeRF, 1,024 rays of 64 + 64 samples
  augnerf bench --method aug-nerf --steps 20
  augnerf bench --devices                  # what --device can name here";

#[derive(Args)]
#[command(next_help_heading = "Experiment")]
pub struct BenchArguments {
    /// Method, as in train, or nerf with one regularizer
    #[arg(long, default_value = "nerf", value_parser = bench::methods())]
    method: String,
    /// Rays per step [default: 1024]
    #[arg(long, value_name = "N", value_parser = whole::<u16>(1..=4096))]
    rays: Option<u16>,
    /// Samples per ray of the coarse pass [default: 64]
    #[arg(long, value_name = "N", value_parser = whole::<u16>(3..=4096))]
    coarse: Option<u16>,
    /// Further samples per ray of the fine pass (MipNeRF: all its intervals) [default: 64]
    #[arg(long, value_name = "N", value_parser = whole::<u16>(0..=4096))]
    fine: Option<u16>,
    /// Width of both networks (8 layers), or of SRN's layers [default: 256]
    #[arg(long, value_name = "N", value_parser = whole::<u16>(4..=4096))]
    width: Option<u16>,
    /// Timed steps, after two untimed ones
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = whole::<u16>(1..=u16::MAX.into()))]
    steps: u16,
    /// Any setting, over the defaults: --set field.core=plain
    #[arg(long, value_name = "FIELD=VALUE")]
    set: Vec<String>,
    /// List the devices that --device can name, and time nothing
    #[arg(long, help_heading = "Hardware")]
    devices: bool,
    #[command(flatten)]
    answer: Answer,
    #[command(flatten)]
    compute: Compute,
}

impl BenchArguments {
    pub fn run(self) -> Result<()> {
        if self.devices {
            return devices::list(self.answer);
        }
        let workload = Workload {
            method: self.method,
            rays: self.rays.map(usize::from),
            coarse: self.coarse.map(usize::from),
            fine: self.fine.map(usize::from),
            width: self.width.map(usize::from),
            steps: self.steps.into(),
            set: self.set.iter().map(|text| parse_assignment(text)).collect::<Result<_>>()?,
        };
        let timed = self.compute.run(|runtime, console| {
            let config = workload.config(runtime)?;
            let settings = workload.set.iter().map(|(path, _)| path.join("."));
            say_without_effect(settings, |setting| config.without_effect(setting), console);
            workload.run(runtime)
        })?;
        // Scripts rely on JSON, with or without the flag.
        self.answer.give(&timed, || print(&serde_json::to_string(&timed).expect("plain data")))
    }
}
