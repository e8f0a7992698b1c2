//! Tables, figures and a page of points: records, statistics, published numbers.

mod across;
pub mod exporters;
mod over_scenes;
mod over_units;
pub mod page;
pub mod plots;
pub mod power;
mod published;
mod record;
pub mod statistics;
pub mod tables;

pub use across::{Across, Block};
pub use over_scenes::{OverScenes, RowOverScenes};
pub use published::{PUBLISHED_NOTE, PublishedProtocol, PublishedRow, published_rows};
pub use record::{AxisParts, AxisValue, PublishedKey, Record, RowSpec, Status, TableSpec, distinct, label};
