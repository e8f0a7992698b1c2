//! What results are measured with: metrics of views, and surfaces with the distances between them.

#![warn(missing_docs)]

pub mod mesh;
pub mod metrics;
