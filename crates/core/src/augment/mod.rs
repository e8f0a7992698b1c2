//! Worst-case augmentation: the sites of the three levels, the sets that their deltas live in, and the search for the
//! worst case.
//!
//! Nothing here knows a field, a renderer or a settings file: a site describes its set from a pass's geometry, and the
//! search ascends a loss that it is handed as a closure, so it can be tested on a quadratic with a known maximum.

mod epsilon;
mod flat;
mod geometry;
mod search;
mod set;
mod sets;
mod site;
mod sites;

pub use epsilon::{Epsilon, REACH};
pub use flat::{larger, smaller};
pub use geometry::{Geometry, PaperPass, PassGeometry, PixelScale, SampleDensity};
pub use search::{Iterate, worst_case};
pub use set::{DeltaSet, Draw, Norm};
pub use sets::{Deltas, Sets};
pub use site::{DefaultSizes, Level, Passes, Radius, SetChoices, SiteNumbers, SiteSpec, StepUnit};
pub use sites::{PerSite, Site};
