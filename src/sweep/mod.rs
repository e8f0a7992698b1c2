//! Sweeps: a definition expanded to points, points run wherever there is room, tables and plots
//! from what they left.

mod published;
mod record;
pub mod statistics;
pub mod tables;

pub use published::{PUBLISHED_NOTE, PublishedProtocol, PublishedRow, published_rows};
pub use record::{AxisValue, PublishedKey, Record, RowSpec, Status, TableSpec};
