//! Worst-case augmentation: the sites of the three levels, the constraint sets of their deltas, and the search for the
//! worst case.
//!
//! Nothing here knows a field, a renderer or a settings file. A site describes its set from a pass's geometry. The
//! search ascends a loss that is passed as a closure, so that tests can use a quadratic with a known maximum.

mod epsilon;
mod flat;
mod geometry;
mod own;
mod search;
mod set;
mod sets;
mod site;
mod sites;

pub use epsilon::{Epsilon, REACH};
pub use flat::{larger, smaller};
pub use geometry::{Geometry, PaperPass, PassGeometry, PixelScale, SampleDensity};
pub use own::{OwnSet, OwnSite, Spread};
pub use search::{Iterate, worst_case};
pub use set::{DeltaSet, Draw, Norm};
pub use sets::{Deltas, Sets};
pub use site::{DefaultSizes, Level, Passes, Radius, SetChoices, SiteNumbers, SiteSpec, StepUnit};
pub use sites::{PerSite, Site};
