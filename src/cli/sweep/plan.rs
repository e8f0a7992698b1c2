//! `augnerf sweep plan`.

use clap::Args;

use crate::base::{Error, Result};
use crate::cli::Compute;
use crate::cli::progress::{Console, print, print_shown};
use crate::runtime::Runtime;
use crate::sweep::{Point, Trainings, plan_costs};

use super::{Changes, Location, duration, planned_points};

#[derive(Args)]
pub struct PlanArguments {
    #[command(flatten)]
    location: Location,
    #[command(flatten)]
    changes: Changes,
    #[command(flatten)]
    compute: Compute,
}

impl PlanArguments {
    pub fn run(self) -> Result<()> {
        let runtime = self.compute.runtime()?;
        runtime.install(|| self.plan(&runtime))
    }

    fn plan(&self, runtime: &Runtime) -> Result<()> {
        let console = Console::new(self.compute.quiet);
        let definition = self.changes.definition(&self.location)?;
        let folder = self.location.folder()?;
        let trainings = Trainings::new(runtime.clone(), (Vec::new(), String::new()), false, &console);
        let points = planned_points(&self.location, &definition, &trainings, &console)?;
        print(&format!("{} points", points.len()))?;
        let left: Vec<&Point> =
            points.iter().filter(|point| point.no_data.is_none() && !folder.point(&point.id).ended()).collect();
        let (mut total, mut memory) = (0.0, None);
        plan_costs(&left, &trainings, |group| {
            total += group.points.len() as f64 * group.seconds;
            memory = [memory, group.cost.peak_memory_mib].into_iter().flatten().reduce(f64::max);
            print(&format!(
                "{:4} x {:44} {:8.3} s/step  {:9} a point  {}",
                group.points.len(),
                group.points[0].label(),
                group.cost.seconds_per_step,
                duration(group.seconds),
                mebibytes(group.cost.peak_memory_mib)
            ))
        })?;
        let missing: Vec<&Point> = points.iter().filter(|point| point.no_data.is_some()).collect();
        if let Some(reason) = missing.first().and_then(|point| point.no_data.as_ref()) {
            print_shown(&format!("{:4} x no data: {reason}", missing.len()))?;
        }
        let missing = missing.len();
        let ended = points.len() - missing - left.len();
        if ended > 0 {
            print(&format!("{ended:4} x done or failed before"))?;
        }
        if left.is_empty() && missing > 0 {
            return Err(Error::PointsWithoutData(format!(
                "nothing could be measured: the {missing} points that are left have no data here; put the scenes below \
                 --data-root (AUGNERF_DATA)"
            )));
        }
        let counted = if missing == 0 { String::new() } else { format!(" for the {} points with data", left.len()) };
        print(&format!(
            "{} in all{counted}, one point after the other, and {} of memory; --jobs N needs N times as much. Rendering is counted; \
             LPIPS and smoothness are not",
            duration(total),
            mebibytes(memory)
        ))
    }
}

fn mebibytes(memory: Option<f64>) -> String {
    memory.map_or("unknown".into(), |mib| format!("{mib:.0} MiB"))
}
