//! Sweeps: a definition is expanded to points, workers run the points, and tables and plots are made of the results.
//!
//! ```text
//! sweeps/NAME.toml ─► definition ─► points (one configuration and seed each, named by content)
//!                                     │
//!          folder: result, failure, claim of each ◄── runner ◄── training (or a fake one)
//!                                     │
//!                                     ▼
//!                                  records ─► tables, plots
//! ```

#![warn(missing_docs)]

pub(crate) use augnerf_measure::{mesh, metrics};
pub(crate) use augnerf_nerf::{runtime, settings, space};
pub(crate) use augnerf_report::report;
pub(crate) use augnerf_run::{compare, revision, run, train};
pub(crate) use {augnerf_base as base, augnerf_draw as draw, augnerf_scenes as data};

mod axes;
mod budget;
mod checks;
mod claim;
mod collect;
mod common_depth;
mod comparability;
mod comparisons;
mod definition;
mod differences;
mod extends;
mod folder;
mod layout;
mod of_runs;
mod outputs;
mod pace;
mod page;
mod planning;
mod point_folder;
mod points;
mod provenance;
mod runner;
mod shipped;
pub mod slurm;
mod step_seconds;
mod sweep;
mod training;
mod varied;
pub mod verify;
mod view;
mod words;
mod worker;

pub use axes::{Axis, AxisPoint};
pub use budget::evaluations_per_step;
pub use claim::{Claim, Claimed, Progress, Sharing};
pub use collect::{PAGE, Results, check_results_place};
pub use comparisons::{ACROSS, ComparisonRequest, OVER_SCENES};
pub use definition::{Budget, BudgetKind, Combine, Definition, Overrides, Row};
pub use folder::{Change, SweepFolder};
pub use layout::{Refused, TablePosition};
pub use of_runs::RunsTable;
pub use outputs::{Scalars, SweepOutputs};
pub use pace::Pace;
pub use page::check_page_place;
pub use planning::{CostGroup, begin, plan, plan_costs};
pub use point_folder::{Failure, PointFolder};
pub use points::{Point, expand};
pub use provenance::{Missing, Provenance};
pub use runner::{Options, Runner, Unmeasured, Work};
pub use shipped::{SHIPPED, TEMPLATE, template, write_new};
pub use step_seconds::{Clock, MeasureSteps, StepSeconds};
pub use sweep::{Sweep, TableOptions};
pub use training::{Cost, Trainings};
pub use view::{Origin, View, split_names};
pub use words::check_name;
pub use worker::last_words;
