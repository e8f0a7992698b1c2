//! `augnerf sweep plan`.

use std::time::{Duration, Instant};

use clap::Args;
use serde::Serialize;

use crate::base::{Error, Result};
use crate::cli::Compute;
use crate::cli::answer::Answer;
use crate::cli::progress::{Console, print, print_shown};
use crate::runtime::Runtime;
use crate::sweep::{Point, Trainings, plan_costs};

use super::{Changes, Location, duration, planned_points};

pub const EXAMPLES: &str = "Examples:
  augnerf sweep plan sweeps/checks/smoke.toml  # points, seconds per step, memory
  augnerf sweep plan sweeps/paper/tab1_llff.toml --data-root ~/data
  augnerf sweep plan sweeps/checks/smoke.toml --set train.steps=1000 --json";

#[derive(Args)]
pub struct PlanArguments {
    #[command(flatten)]
    location: Location,
    #[command(flatten)]
    changes: Changes,
    #[command(flatten)]
    answer: Answer,
    #[command(flatten)]
    compute: Compute,
}

/// The cost of a sweep.
#[derive(Default, Serialize)]
struct Planned {
    points: usize,
    groups: Vec<Group>,
    no_data: usize,
    no_data_because: Option<String>,
    ended: usize,
    seconds: f64,
    peak_memory_mib: Option<f64>,
}

/// Points with the same cost.
#[derive(Serialize)]
struct Group {
    points: usize,
    label: String,
    measured: bool,
    seconds_per_step: f64,
    seconds: f64,
    peak_memory_mib: Option<f64>,
}

impl Group {
    fn words(&self) -> String {
        format!(
            "{:4} x {:44} {:8.3} s/step  {:9} per point  {}{}",
            self.points,
            self.label,
            self.seconds_per_step,
            duration(self.seconds),
            mebibytes(self.peak_memory_mib),
            if self.measured { "" } else { "  estimated" }
        )
    }
}

/// Time for measurements; the costs of what is left are estimated.
const LIMIT: Duration = Duration::from_secs(60);

impl PlanArguments {
    pub fn run(self) -> Result<()> {
        self.compute.run(|runtime, console| self.plan(runtime, console))
    }

    fn plan(&self, runtime: &Runtime, console: &Console) -> Result<()> {
        let begun = Instant::now();
        let definition = self.changes.definition(&self.location)?;
        let folder = self.location.folder()?;
        let trainings = Trainings::new(runtime.clone(), (Vec::new(), String::new()), false, console);
        let checked = || {
            console.say(&format!(
                "timing some steps of the points, for about {} s; slow first steps take longer",
                LIMIT.as_secs()
            ));
        };
        let points = planned_points(&self.location, &definition, &trainings, console, checked)?;
        let say = |words: &str| if self.answer.json { Ok(()) } else { print(words) };
        say(&format!("{} points", points.len()))?;
        let open: Vec<&Point> = points.iter().filter(|point| !folder.point(&point.id).ended()).collect();
        let (left, lost): (Vec<&Point>, Vec<&Point>) = open.iter().partition(|point| point.no_data.is_none());
        let (no_data, ended) = (lost.len(), points.len() - open.len());
        let mut planned = Planned { points: points.len(), no_data, ended, ..Planned::default() };
        plan_costs(&left, &trainings, LIMIT.saturating_sub(begun.elapsed()), |group| {
            let group = Group {
                points: group.points.len(),
                label: group_label(group.points),
                measured: group.measured,
                seconds_per_step: group.cost.seconds_per_step,
                seconds: group.seconds,
                peak_memory_mib: group.cost.peak_memory_mib,
            };
            say(&group.words())?;
            planned.seconds += group.points as f64 * group.seconds;
            planned.peak_memory_mib =
                [planned.peak_memory_mib, group.peak_memory_mib].into_iter().flatten().reduce(f64::max);
            planned.groups.push(group);
            Ok(())
        })?;
        planned.no_data_because = lost.iter().find_map(|point| point.no_data.clone());
        if left.is_empty() && no_data > 0 {
            planned.say_what_is_left_out(self.answer)?;
            return Err(Error::PointsWithoutData(format!(
                "nothing measured: no data for the {no_data} remaining points; put the scenes into --data-root (AUGNERF_DATA)"
            )));
        }
        self.answer.give(&planned, || planned.say_the_end())
    }
}

impl Planned {
    /// Prints the points that were not measured.
    fn say_what_is_left_out(&self, answer: Answer) -> Result<()> {
        if answer.json {
            return answer.give_silently(self);
        }
        if let Some(reason) = &self.no_data_because {
            print_shown(&format!("{:4} x no data: {reason}", self.no_data))?;
        }
        if self.ended > 0 {
            print(&format!("{:4} x already done or failed", self.ended))?;
        }
        Ok(())
    }

    /// Prints the lines after the groups.
    fn say_the_end(&self) -> Result<()> {
        self.say_what_is_left_out(Answer { json: false })?;
        let measured = self.points - self.no_data - self.ended;
        let counted = if self.no_data == 0 { String::new() } else { format!(" for the {measured} points with data") };
        print(&format!(
            "{} in total{counted}, one point after the other, and {} of memory; --jobs N needs N times as much. Includes \
             rendering, not LPIPS and smoothness",
            duration(self.seconds),
            mebibytes(self.peak_memory_mib)
        ))?;
        let estimated: usize = self.groups.iter().filter(|group| !group.measured).map(|group| group.points).sum();
        match estimated {
            0 => Ok(()),
            _ => print(&format!(
                "{estimated} points are estimated from the others by the evaluations of their networks: measuring stops after {} s",
                LIMIT.as_secs()
            )),
        }
    }
}

/// Returns what points of one cost are: the first, without its seed if others differ in that alone.
fn group_label(points: &[&Point]) -> String {
    let first = points[0];
    match points {
        [only] => only.label(),
        _ if points.iter().all(|point| point.cell() == first.cell()) => first.cell(),
        _ => {
            let mut others: Vec<String> =
                points.iter().map(|point| point.cell()).filter(|cell| *cell != first.cell()).collect();
            others.dedup();
            format!("{} and {} more", first.cell(), others.len())
        }
    }
}

fn mebibytes(memory: Option<f64>) -> String {
    memory.map_or("unknown".into(), |mib| format!("{mib:.0} MiB"))
}
