//! Worst-case augmentation: the sites of the three levels, the constraint sets of their deltas, and the search for the
//! worst case.
//!
//! Outside of `settings` nothing here knows a field, a renderer or a settings file. A site describes its set from a pass's geometry. The
//! search ascends a loss that is passed as a closure, so that tests can use a quadratic with a known maximum.

mod epsilon;
mod feature;
mod geometry;
mod input;
mod output;
mod pgd;
mod set;
mod sets;
pub mod settings;
mod site;

pub use epsilon::{Epsilon, REACH};
pub use feature::Feature;
pub use geometry::{AttackGeometry, Geometry, PaperPass, PassGeometry, PixelScale, SampleDensity};
pub use input::{Radius, T, View, Xyz, tilt};
pub use output::{Density, Rgb, UsedDeltas, output_range};
pub use pgd::worst_case;
pub use set::{DeltaSet, Distribution, Norm};
pub use sets::{Deltas, Sets, SiteSet};
pub use site::{DefaultSizes, Level, PaperSite, Passes, PerSite, Pgd, Site, SiteNumbers, SiteSpec, StepUnit};
