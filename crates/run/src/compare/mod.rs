//! Compares several trained runs on one held-out view, or along the ray of one pixel: what they must share, how they
//! differ, and the resulting figure and numbers.

mod comparison;
mod comparison_figure;
mod differences;
mod display_size;
mod parts;
mod profile;
mod profile_figure;
mod run_view;
mod window;

pub use comparison::Comparison;
pub use comparison::check_box;
pub use differences::{Difference, differences, differing_settings};
pub use profile::{Profile, Profiles, Samples, check_profiled};
pub use profile_figure::check_overlay;
pub use run_view::{RunView, labels, name_steps};
pub use window::{Window, crop, most_different};
