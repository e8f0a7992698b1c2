//! Density in space, whatever holds it.

use candle_core::{DType, Device, Tensor};

use crate::base::Result;

use super::Field;

/// What is where in space. A place is a point `[n, 3]` with the `variance` (length^2, along each axis) of the
/// surroundings that it stands for, which matters to methods that are queried at more than points.
pub trait Density: Send + Sync {
    /// Density `[n]`, 1 / length, not negative.
    fn density(&self, points: &Tensor, variance: [f64; 3]) -> Result<Tensor>;

    /// Its exact gradient in space, `[n, 3]`.
    fn gradient(&self, points: &Tensor, variance: [f64; 3]) -> Result<Tensor>;

    /// Colour `[n, 3]` seen along unit directions `viewdirs [n, 3]`.
    fn rgb(&self, points: &Tensor, variance: [f64; 3], viewdirs: &Tensor) -> Result<Tensor>;

    /// Precision that points are expected in.
    fn dtype(&self) -> DType;

    /// Where points are expected.
    fn device(&self) -> &Device;
}

/// The density of a field with its weights as they are now.
pub struct FieldDensity(Field);

impl FieldDensity {
    /// Of a field, without gradients of its weights.
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
