//! Compares several trained runs on one held-out view: what they must share, how they differ, and the resulting images
//! and numbers. Measures the spread over the seeds of one row.

mod comparison;
mod comparison_figure;
mod comparison_files;
mod differences;
mod display_size;
mod fade;
mod parts;
mod profile;
mod profile_figure;
mod profile_files;
mod run_view;
mod seed_set;
mod spread;
mod spread_figure;
mod spread_files;
mod window;

pub(crate) use display_size::DisplaySize;
pub(crate) use parts::colour_bar;

pub use comparison::Comparison;
pub use comparison::check_box;
pub use differences::{Difference, differences, differing_settings};
pub use fade::check_fade;
pub use profile::{Profile, Profiles, RaySmoothness, check_profiled, patch_around};
pub use profile_figure::check_overlay;
pub use run_view::{RunView, labels, name_steps};
pub use seed_set::SeedSet;
pub use spread::{NUMBERS, QUANTITIES, SpreadNumbers, ViewSpread};
pub use spread_files::{Shown, Spread, ViewLine};
pub use window::{Window, crop, most_different};
