//! Density in space, for all representations.

use candle_core::{DType, Device, Tensor};

use crate::base::Result;

use super::Field;

/// Density and colour in space. A position is a point `[n, 3]` with the `variance` (length^2, along each axis) of the
/// region that it stands for. Methods that are not queried at points need the variance.
pub trait Density: Send + Sync {
    /// Returns density `[n]`, 1 / length, at least 0.
    fn density(&self, points: &Tensor, variance: [f64; 3]) -> Result<Tensor>;

    /// Returns its exact gradient in space, `[n, 3]`.
    fn gradient(&self, points: &Tensor, variance: [f64; 3]) -> Result<Tensor>;

    /// Returns the colour `[n, 3]` along unit directions `viewdirs [n, 3]`.
    fn rgb(&self, points: &Tensor, variance: [f64; 3], viewdirs: &Tensor) -> Result<Tensor>;

    /// Returns the precision of points.
    fn dtype(&self) -> DType;

    /// Returns the device of points.
    fn device(&self) -> &Device;

    /// Returns the number of points that it takes at once, if it computes somewhere else, for one thread at a time.
    fn at_once(&self) -> Option<usize> {
        None
    }
}

/// The density of a field with its current weights.
pub struct FieldDensity(Field);

impl FieldDensity {
    /// Creates the density of a field, without gradients of its weights.
    pub fn new(field: &Field) -> Result<FieldDensity> {
        Ok(FieldDensity(field.frozen()?))
    }
}

impl Density for FieldDensity {
    fn density(&self, points: &Tensor, variance: [f64; 3]) -> Result<Tensor> {
        let FieldDensity(field) = self;
        field.activate_density(&field.raw_density(&field.positions(points, variance)?)?)
    }

    fn gradient(&self, points: &Tensor, variance: [f64; 3]) -> Result<Tensor> {
        let FieldDensity(field) = self;
        field.density_gradient(&field.positions(points, variance)?)
    }

    fn rgb(&self, points: &Tensor, variance: [f64; 3], viewdirs: &Tensor) -> Result<Tensor> {
        let FieldDensity(field) = self;
        field.activate_rgb(&field.forward(&field.positions(points, variance)?, viewdirs, None)?.rgb)
    }

    fn dtype(&self) -> DType {
        self.0.dtype()
    }

    fn device(&self) -> &Device {
        self.0.device()
    }
}
