//! Smoothness of a trained run's fields: the terms of the explicit regularizers, measured on the full sampling grid
//! whatever the training used.

use std::path::Path;

use serde::Serialize;

use crate::base::columns::file_field;
use crate::base::csv::csv_of_named;
use crate::base::files::write_atomic;
use crate::base::{Error, Event, Listener, Result};
use crate::data::Scene;
use crate::losses::{Smoothness, measure, measure_density};
use crate::model::{Model, density};
use crate::runtime::Runtime;
use crate::settings::{Capability, Config};
use crate::space::Lattice;

use super::{Protocol, Trained, columns};

/// Cells after which a measurement advances.
const CELLS: usize = 1024;
/// The paper's box for its regularizers.
const PAPER_BOX: [[f64; 3]; 2] = [[-1.0; 3], [1.0; 3]];
/// Default number of cells along each side of the sampling grid.
pub const SMOOTHNESS_SIDE: usize = 64;

/// Returns the default box of a scene's measurements, in `measure` and in sweeps: the box that most cameras look at,
/// or the paper's if that is unknown.
pub fn smoothness_box(scene: &Scene) -> [[f64; 3]; 2] {
    scene.space.domain.unwrap_or(PAPER_BOX)
}

/// Smoothness of one network.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FieldSmoothness {
    /// `coarse` or `fine`; the evaluated one comes last.
    pub field: &'static str,
    /// Cells along each side of the box.
    pub lattice: usize,
    /// Corners of the box, in the units of `points`.
    pub domain: String,
    /// The measurements.
    #[serde(flatten)]
    pub smoothness: Smoothness,
}

/// `smoothness.csv`: one row a network, each with the whole protocol.
#[derive(Clone, Debug)]
pub struct SmoothnessReport {
    /// Coarse field, then fine field if there is one.
    pub fields: Vec<FieldSmoothness>,
    /// Provenance of the numbers.
    pub protocol: Protocol,
}

impl SmoothnessReport {
    /// Measures the coarse and the fine field of a model on a runtime.
    ///
    /// # Errors
    /// [`Error::Config`]: the box misses the scene's rays.
    /// [`Error::Diverged`]: densities are not numbers.
    pub fn measure(
        model: &Model,
        scene: &Scene,
        lattice: &Lattice,
        protocol: Protocol,
        runtime: &Runtime,
        events: &dyn Listener,
    ) -> Result<SmoothnessReport> {
        let fields = runtime.install(|| measure_fields(model, scene, lattice, runtime, events))?;
        Ok(SmoothnessReport { fields, protocol })
    }

    /// Writes `smoothness.csv`.
    pub fn write(&self, path: &Path) -> Result<()> {
        let rows = self.fields.iter().map(|field| {
            let mut row = columns(field);
            row.extend(columns(&self.protocol).into_iter().map(file_field));
            row
        });
        write_atomic(path, csv_of_named(rows).as_bytes())
    }
}

fn measure_fields(
    model: &Model,
    scene: &Scene,
    lattice: &Lattice,
    runtime: &Runtime,
    events: &dyn Listener,
) -> Result<Vec<FieldSmoothness>> {
    lattice.check_meets(scene, "the sampling grid of smoothness")?;
    let fields: Vec<_> = model.fields()?.by_role().filter(|(role, _)| *role != "adversarial").collect();
    // Laplacians are the host's.
    let has_laplacian = fields[0].1.config().has_laplacian();
    let on_accelerator = runtime.accelerator().is_some() && !has_laplacian;
    if runtime.accelerator().is_some() && has_laplacian {
        events.on(Event::Note("measured on the CPU: the GPU does not measure this field's Laplacian"));
    }
    if model.fields()?.occupancy().is_some() {
        events.on(Event::Note(
            "sampling.kind is occupancy: this is the field's density everywhere, also where pictures have none",
        ));
    }
    let parts = fields.len() * lattice.cells().div_ceil(CELLS);
    events.on(Event::Started { what: "measuring", parts: parts as u64 });
    let measured = fields.into_iter().map(|(role, field)| {
        let mut cells = 0usize;
        let advance = |more| {
            let before = cells.div_ceil(CELLS);
            cells += more;
            (before..cells.div_ceil(CELLS)).for_each(|_| events.on(Event::Advanced));
        };
        let smoothness = match on_accelerator {
            true => measure_density(&*density(runtime, field)?, lattice, advance)?,
            false => measure(field, lattice, advance)?,
        };
        if !smoothness.l1.is_finite() || !smoothness.laplacian.is_none_or(f64::is_finite) {
            return Err(Error::Diverged(format!(
                "the density of the {role} field is not a number, so its weights are broken"
            )));
        }
        Ok(FieldSmoothness { field: role, lattice: lattice.side, domain: format!("{:?}", lattice.domain), smoothness })
    });
    let fields = measured.collect::<Result<Vec<_>>>()?;
    events.on(Event::Finished);
    Ok(fields)
}

/// Returns an error for a run without such numbers.
///
/// # Errors
/// [`Error::Config`]: the method's field is queried at Gaussians, or it has no field.
pub fn check_measurable(run: &Path, config: &Config) -> Result<()> {
    let Some(why) = config.representation().lacks(Capability::Derivatives) else { return Ok(()) };
    if !config.method.has_fields() {
        return Err(Error::Config(format!(
            "{}: method {} has no l1, TV or Laplacian of density: {why}; measure nerf and aug-nerf runs",
            run.display(),
            config.method.name()
        )));
    }
    Err(Error::Config(format!(
        "{}: a field of method {} is queried at Gaussians, not points, and has no l1, TV or Laplacian; measure \
         nerf and aug-nerf runs",
        run.display(),
        config.method.name()
    )))
}

impl Trained {
    /// Measures the smoothness of the run's fields on a full sampling grid. Writes `smoothness.csv` into the run's
    /// folder if it is writable.
    ///
    /// # Errors
    /// Those of [`SmoothnessReport::measure`] and [`check_measurable`]; the file cannot be written.
    pub fn measure_smoothness(&self, lattice: &Lattice, events: &dyn Listener) -> Result<SmoothnessReport> {
        check_measurable(self.run.path(), &self.config)?;
        let (model, runtime) = (&self.model, &self.runtime);
        let report = SmoothnessReport::measure(model, &self.scene, lattice, self.protocol(), runtime, events)?;
        if self.run.is_writable() {
            report.write(&self.run.smoothness())?;
        }
        Ok(report)
    }
}
