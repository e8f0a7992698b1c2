//! Points of samples, their encoding, and the way back from it.

use augnerf_nerf::field::hash::{Domain, HashGrid, Level};
use augnerf_nerf::settings::{Contraction, Interpolation};
use wgpu::Buffer;

use crate::device::groups;
use crate::kernels::Kernel;
use crate::network::FieldBuffers;
use crate::params::{Params, Value};

use super::products::Rows;
use super::{FIXED_SCALE, PassAt, Recorder, Wanted};

impl<'a> Recorder<'a> {
    /// Records positions, points and their encoding. Returns the positions along rays.
    pub(super) fn place(&mut self, pass: &PassAt<'a>) -> &'a Buffer {
        let (n, scratch) = (pass.points(), self.scratch);
        let mut t_vals = pass.t_vals;
        if let Some(delta) = pass.deltas.t {
            let count = pass.rays * pass.columns;
            let params = params! { numbers: count };
            self.run(Kernel::new("add"), params, &[(1, t_vals), (2, delta), (3, &scratch.t_moved)], groups(count));
            t_vals = &scratch.t_moved;
        }
        let params = params! { rays: pass.rays, samples: pass.samples, columns: pass.columns, ray0: pass.ray0 };
        let mut buffers = vec![(1, self.rays), (2, t_vals), (3, &scratch.points)];
        buffers.extend(pass.deltas.xyz.map(|shift| (4, shift)));
        let kernel = match self.shape.is_integrated {
            true => self.of_solids("gaussians"),
            false => Kernel::new("points"),
        };
        buffers.extend(self.shape.is_integrated.then_some((5, &scratch.variances)));
        self.run(kernel.with("SHIFT", pass.deltas.xyz.is_some()), params, &buffers, groups(n));
        self.encode(Rows::Samples(n), &scratch.points, pass.field);
        t_vals
    }

    /// Chooses between cones and the cylinders of rays in NDC.
    fn of_solids(&self, name: &'static str) -> Kernel {
        Kernel::new(name).with("CYLINDERS", self.has_cylinders)
    }

    /// Records the encoding of points, with its derivatives in jets, or that of Gaussians.
    pub(super) fn encode(&mut self, rows: Rows, points: &Buffer, field: &FieldBuffers) {
        let (n, scratch) = (rows.points(), self.scratch);
        let Some(grid) = &self.shape.grid else {
            let params = params! { points: n, octaves: self.shape.octaves, channels: self.shape.channels };
            if self.shape.is_integrated {
                let buffers = [(1, points), (2, &scratch.variances), (3, &scratch.encoded)];
                return self.run(Kernel::new("integrated"), params, &buffers, groups(3 * n));
            }
            let kernel = rows.chosen(Kernel::new("frequency"));
            self.run(kernel, params, &[(1, points), (2, &scratch.encoded)], groups(3 * n));
            return;
        };
        let params = self.domain(n);
        let buffers = [(1, points), (2, &scratch.unit), (3, &scratch.inside)];
        self.run(Kernel::new("domain"), params, &buffers, groups(n));
        let tables = &tables(field).values;
        let kernel = rows.chosen(of_grid(grid, "encode"));
        let domain = rows.are_jets().then(|| self.gpu.uniform(&self.gpu.words(&kernel, 4, &self.domain(n))));
        let mut buffers = vec![(1, &scratch.unit), (2, tables), (3, &scratch.encoded)];
        buffers.extend(domain.iter().flat_map(|domain| [(4, domain), (5, points)]));
        self.run(kernel, self.grid(n), &buffers, groups(n * grid.levels().len()));
    }

    fn domain(&self, points: usize) -> Params {
        domain_params(self.shape.domain.as_ref().expect("a grid"), points)
    }

    fn grid(&self, points: usize) -> Params {
        let grid = self.shape.grid.as_ref().expect("a grid");
        grid_params(grid, points, self.shape.channels, FIXED_SCALE / self.loss_scale)
    }

    /// Records the gradient of a field's tables from that of the encoding.
    pub(super) fn tables_back(&mut self, rows: Rows, points: &Buffer, field: &FieldBuffers) {
        let Some(grid) = &self.shape.grid else { return };
        let (n, scratch) = (rows.points(), self.scratch);
        let gradient = &tables(field).gradient;
        let kernel = rows.chosen(of_grid(grid, "scatter"));
        let domain = rows.are_jets().then(|| self.gpu.uniform(&self.gpu.words(&kernel, 5, &self.domain(n))));
        let mut buffers = vec![(1, &scratch.unit), (2, &scratch.d_encoded), (3, gradient), (4, self.flags)];
        buffers.extend(domain.iter().flat_map(|domain| [(5, domain), (6, points)]));
        self.run(kernel, self.grid(n), &buffers, groups(n * grid.levels().len()));
    }

    /// From the encoding of a pass to tables, points and positions along rays.
    pub(super) fn encoding_back(&mut self, pass: &PassAt<'a>, wanted: Wanted) {
        let (shape, scratch, n) = (self.shape, self.scratch, pass.points());
        if wanted.weights {
            self.tables_back(Rows::Samples(n), &scratch.points, pass.field);
        }
        if let (Some(grid), true) = (&shape.grid, wanted.points()) {
            let tables = &tables(pass.field).values;
            let buffers = [(1, &scratch.unit), (2, tables), (3, &scratch.d_encoded), (4, &scratch.d_points)];
            self.run(of_grid(grid, "slope"), self.grid(n), &buffers, groups(n));
            let buffers = [(1, &scratch.points), (2, &scratch.inside), (3, &scratch.d_points)];
            self.run(Kernel::new("domain_back"), self.domain(n), &buffers, groups(n));
        } else if wanted.points() {
            let params = params! { points: n, octaves: shape.octaves, channels: shape.channels };
            let mut buffers = vec![(1, &scratch.encoded), (2, &scratch.d_encoded), (3, &scratch.d_points)];
            buffers.extend(shape.is_integrated.then_some((4, &scratch.d_variances)));
            let name = if shape.is_integrated { "integrated_back" } else { "frequency_back" };
            self.run(Kernel::new(name), params, &buffers, groups(3 * n));
        }
        if wanted.t {
            let params = params! { rays: pass.rays, samples: pass.samples, columns: pass.columns, ray0: pass.ray0 };
            let t_vals = if pass.deltas.t.is_some() { &scratch.t_moved } else { pass.t_vals };
            let (kernel, buffers) = match shape.is_integrated {
                true => (
                    self.of_solids("gaussians_back"),
                    vec![
                        (1, self.rays),
                        (2, t_vals),
                        (3, &scratch.d_points),
                        (4, &scratch.d_variances),
                        (5, &scratch.d_t),
                    ],
                ),
                false => (Kernel::new("t_back"), vec![(1, self.rays), (2, &scratch.d_points), (3, &scratch.d_t)]),
            };
            self.run(kernel, params, &buffers, groups(pass.rays * pass.columns));
        }
    }
}

/// Returns the parameters of the kernels of a box, for so many points.
pub(crate) fn domain_params(domain: &Domain, points: usize) -> Params {
    let (low, high) = domain.corners();
    let contraction: usize = match domain.contraction() {
        Contraction::None => 0,
        Contraction::Axes => 1,
        Contraction::Ball => 2,
    };
    params! { low, points, high, contraction }
}

/// Returns the parameters of the kernels of a grid, for so many points with rows of `channels` numbers and for sums in units of
/// 1 / `scale`.
pub(crate) fn grid_params(grid: &HashGrid, points: usize, channels: usize, scale: f64) -> Params {
    let of = |level: &Level| [level.resolution as usize, level.entries, level.offset, usize::from(level.dense)];
    let levels = grid.levels().iter().map(of).chain(std::iter::repeat([1, 1, 0, 1]));
    let level: Value = levels.take(32).flatten().collect();
    let smooth_step = grid.interpolation() == Interpolation::Smoothstep;
    params! { points, levels: grid.levels().len(), scale, smooth_step, stride: channels, level }
}

fn of_grid(grid: &HashGrid, name: &'static str) -> Kernel {
    Kernel::new(name).set("FEATURES", grid.features())
}

fn tables(field: &FieldBuffers) -> &crate::network::Learned {
    field.tables.as_ref().expect("a grid has tables")
}
