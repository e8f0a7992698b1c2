//! How smooth a trained run's fields are: the terms of the explicit regularizers, measured on the
//! full lattice whatever the run was trained with.

use std::path::Path;

use candle_core::{DType, Device};
use serde::Serialize;

use crate::base::files::write_atomic;
use crate::base::{Error, Progress, Result};
use crate::data::Scene;
use crate::losses::{Smoothness, estimate_seconds, measure};
use crate::methods::Model;
use crate::space::{Lattice, chunk_count};

use super::evaluate::csv_text;
use super::{Protocol, columns};

/// A measurement that would take longer is refused.
const MOST_HOURS: f64 = 12.0;

/// One network's smoothness.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FieldSmoothness {
    /// `coarse` or `fine`; the evaluated one comes last.
    pub field: &'static str,
    /// Cells along each side of the box.
    pub lattice: usize,
    /// Corners of the box, in the units of `points`.
    pub domain: String,
    /// What was measured.
    #[serde(flatten)]
    pub smoothness: Smoothness,
}

/// `smoothness.csv`: one row a network, each with the whole protocol.
#[derive(Clone, Debug)]
pub struct SmoothnessReport {
    /// Coarse field, then fine field where there is one.
    pub fields: Vec<FieldSmoothness>,
    /// Where the numbers come from.
    pub protocol: Protocol,
}

impl SmoothnessReport {
    /// Measures the coarse and the fine field of a model. Refuses a box that the scene's rays do
    /// not meet, and a lattice that would not finish.
    pub fn measure(
        model: &Model,
        scene: &Scene,
        lattice: &Lattice,
        protocol: Protocol,
        device: &Device,
        progress: &dyn Progress,
    ) -> Result<SmoothnessReport> {
        lattice.check_meets(scene, "--bbox")?;
        let fields: Vec<_> = model.fields().into_iter().filter(|(role, _)| *role != "adversarial").collect();
        let seconds = estimate_seconds(fields[0].1, lattice, lattice.cells(), false, (DType::F32, device))?;
        let hours = seconds * fields.len() as f64 / 3600.0;
        if hours > MOST_HOURS {
            return Err(Error::Config(format!(
                "a lattice of {} a side has {} points: measuring it would take about {hours:.0} hours here (at most \
                 {MOST_HOURS} are allowed); choose fewer cells a side",
                lattice.side,
                lattice.cells()
            )));
        }
        progress.start("measuring", (fields.len() * chunk_count(lattice.cells(), device)) as u64);
        let measured = fields.into_iter().map(|(role, field)| {
            let smoothness = measure(field, lattice, (DType::F32, device), || progress.advance())?;
            if !smoothness.l1.is_finite() || !smoothness.laplacian.is_finite() {
                return Err(Error::Diverged(format!(
                    "the density of the {role} field is not a number: its weights are broken"
                )));
            }
            Ok(FieldSmoothness {
                field: role,
                lattice: lattice.side,
                domain: format!("{:?}", lattice.domain),
                smoothness,
            })
        });
        let fields = measured.collect::<Result<Vec<_>>>()?;
        progress.finish();
        Ok(SmoothnessReport { fields, protocol })
    }

    /// Writes `smoothness.csv`.
    pub fn write(&self, path: &Path) -> Result<()> {
        let rows = self.fields.iter().map(|field| {
            let mut row = columns(field);
            row.extend(columns(&self.protocol));
            row
        });
        write_atomic(path, &csv_text(rows, path)?)
    }
}
