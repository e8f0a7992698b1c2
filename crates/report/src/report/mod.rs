//! Tables, figures and a page of points: records, statistics, published numbers.

mod comparisons;
pub mod exporters;
mod over_units;
pub mod page;
pub mod plots;
mod published;
mod record;
pub mod statistics;
pub mod tables;

pub use crate::base::distinct;
pub use comparisons::{Compared, Comparisons, OverScenes, Unit};
pub use published::{PUBLISHED_NOTE, PublishedRow, published_rows};
pub use record::{AxisParts, AxisValue, PointResult, PublishedKey, Record, RowSpec, Status, TableSpec, label};
