//! Density and its gradient at points in space, and the gradients of what is integrated there.

use augnerf_nerf::field::Order;
use wgpu::Buffer;

use crate::device::groups;
use crate::kernels::Kernel;
use crate::network::FieldBuffers;
use crate::params::Params;

use super::products::Rows;
use super::{Recorder, Wanted};

/// Points at which a field is queried.
#[derive(Clone, Copy)]
pub(crate) struct SpaceAt<'a> {
    pub(crate) field: &'a FieldBuffers,
    pub(crate) points: &'a Buffer,
    pub(crate) count: usize,
    pub(crate) order: Order,
    /// Density and its gradient, `[count, 4]`, and its Laplacian, `[count, 4]`.
    pub(crate) out: &'a Buffer,
}

/// Weights of density, of its gradient's length and of its Laplacian's magnitude at one point.
#[derive(Clone, Copy, Default)]
pub(crate) struct Integrand {
    pub(crate) l1: f64,
    pub(crate) tv: f64,
    pub(crate) laplacian: f64,
}

impl SpaceAt<'_> {
    fn rows(&self) -> Rows {
        match self.order {
            Order::Density => Rows::Samples(self.count),
            Order::Gradient => Rows::Jets(self.count),
            Order::Laplacian => Rows::JetsWithLaplacians(self.count),
        }
    }
}

impl Recorder<'_> {
    fn space_params(&self, at: &SpaceAt, integrand: Integrand) -> Params {
        let Integrand { l1, tv, laplacian } = integrand;
        let [l1, tv, laplacian] = [l1, tv, laplacian].map(|weight| weight * self.loss_scale);
        let (columns, activation) = (self.shape.width + 4, self.outputs.activation);
        params! { points: at.count, columns, activation, l1, tv, laplacian }
    }

    fn space_kernel(&mut self, name: &'static str, at: &SpaceAt, params: Params, to: &Buffer, threads: usize) {
        let mut buffers = vec![(1, &self.scratch.head), (2, to)];
        if self.has_outside() {
            buffers.push((3, &self.scratch.inside));
        }
        let kernel = at.rows().chosen(Kernel::new(name)).with("INSIDE", self.has_outside());
        self.run(kernel, params, &buffers, groups(threads));
    }

    /// Records density at points, and its derivatives if asked.
    pub(crate) fn space(&mut self, at: &SpaceAt) {
        self.encode(at.rows(), at.points, at.field);
        self.raw_density(at.rows(), at.field);
        let params = self.space_params(at, Integrand::default());
        self.space_kernel("space", at, params, at.out, at.count);
    }

    /// Records the gradients of an integrand at the points that were just queried.
    pub(crate) fn space_back(&mut self, at: &SpaceAt, integrand: Integrand) {
        let (scratch, rows) = (self.scratch, at.rows());
        let params = self.space_params(at, integrand);
        self.space_kernel("space_back", at, params, &scratch.d_head, rows.count() * (self.shape.width + 4));
        let wanted = Wanted { weights: true, ..Wanted::default() };
        let has_tables = self.shape.grid.is_some();
        self.trunk_back(rows, at.field, None, wanted, has_tables);
        // Colour's layers come after the head.
        self.reduce(rows, at.field, self.shape.head.end());
        if has_tables {
            self.tables_back(rows, at.points, at.field);
        }
    }

    /// Records the integrals of an integrand's parts over the points, into a slot of results: those of the first points, or added to
    /// what is there.
    pub(crate) fn integrals(&mut self, at: &SpaceAt, are_first: bool, volume: f64, slot: usize, results: &Buffer) {
        let params = params! { points: at.count, slot, volume, are_first };
        self.run(at.rows().chosen(Kernel::new("integrals")), params, &[(1, at.out), (2, results)], [1, 1, 1]);
    }
}
