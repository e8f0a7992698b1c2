//! Points of samples, their encoding, and the way back from it.

use augnerf_nerf::field::hash::{Domain, HashGrid, Level};
use augnerf_nerf::settings::{Contraction, Interpolation};
use wgpu::Buffer;

use crate::device::groups;
use crate::kernels::Kernel;
use crate::network::FieldBuffers;

use super::products::Rows;
use super::{FIXED_SCALE, PassAt, Recorder, Wanted, Words};

impl<'a> Recorder<'a> {
    /// Records positions, points and their encoding. Returns the positions along rays.
    pub(super) fn place(&mut self, pass: &PassAt<'a>) -> &'a Buffer {
        let (n, scratch) = (pass.points(), self.scratch);
        let mut t_vals = pass.t_vals;
        if let Some(delta) = pass.deltas.t {
            let count = pass.rays * pass.columns;
            let words = Words::default().u(count).u(0).u(0).u(0);
            self.run(Kernel::new("add"), words, &[(1, t_vals), (2, delta), (3, &scratch.t_moved)], groups(count));
            t_vals = &scratch.t_moved;
        }
        let words = Words::default().u(pass.rays).u(pass.samples).u(pass.columns).u(pass.ray0);
        let mut buffers = vec![(1, self.rays), (2, t_vals), (3, &scratch.points)];
        buffers.extend(pass.deltas.xyz.map(|shift| (4, shift)));
        let kernel = match self.shape.is_integrated {
            true => self.of_solids("gaussians"),
            false => Kernel::new("points"),
        };
        buffers.extend(self.shape.is_integrated.then_some((5, &scratch.variances)));
        self.run(kernel.with("SHIFT", pass.deltas.xyz.is_some()), words, &buffers, groups(n));
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
            let words = Words::default().u(n).u(self.shape.octaves).u(self.shape.channels).u(0);
            if self.shape.is_integrated {
                let buffers = [(1, points), (2, &scratch.variances), (3, &scratch.encoded)];
                return self.run(Kernel::new("integrated"), words, &buffers, groups(3 * n));
            }
            let kernel = rows.chosen(Kernel::new("frequency"));
            self.run(kernel, words, &[(1, points), (2, &scratch.encoded)], groups(3 * n));
            return;
        };
        let words = self.domain(n);
        let buffers = [(1, points), (2, &scratch.unit), (3, &scratch.inside)];
        self.run(Kernel::new("domain"), words, &buffers, groups(n));
        let tables = &tables(field).values;
        let domain = rows.are_jets().then(|| self.gpu.uniform(self.domain(n).words()));
        let mut buffers = vec![(1, &scratch.unit), (2, tables), (3, &scratch.encoded)];
        buffers.extend(domain.iter().flat_map(|domain| [(4, domain), (5, points)]));
        let kernel = rows.chosen(of_grid(grid, "encode"));
        self.run(kernel, self.grid(n), &buffers, groups(n * grid.levels().len()));
    }

    fn domain(&self, points: usize) -> Words {
        domain_words(self.shape.domain.as_ref().expect("a grid"), points)
    }

    fn grid(&self, points: usize) -> Words {
        let grid = self.shape.grid.as_ref().expect("a grid");
        grid_words(grid, points, self.shape.channels, FIXED_SCALE / self.loss_scale)
    }

    /// Records the gradient of a field's tables from that of the encoding.
    pub(super) fn tables_back(&mut self, rows: Rows, points: &Buffer, field: &FieldBuffers) {
        let Some(grid) = &self.shape.grid else { return };
        let (n, scratch) = (rows.points(), self.scratch);
        let gradient = &tables(field).gradient;
        let domain = rows.are_jets().then(|| self.gpu.uniform(self.domain(n).words()));
        let mut buffers = vec![(1, &scratch.unit), (2, &scratch.d_encoded), (3, gradient), (4, self.flags)];
        buffers.extend(domain.iter().flat_map(|domain| [(5, domain), (6, points)]));
        let kernel = rows.chosen(of_grid(grid, "scatter"));
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
            let words = Words::default().u(n).u(shape.octaves).u(shape.channels).u(0);
            let mut buffers = vec![(1, &scratch.encoded), (2, &scratch.d_encoded), (3, &scratch.d_points)];
            buffers.extend(shape.is_integrated.then_some((4, &scratch.d_variances)));
            let name = if shape.is_integrated { "integrated_back" } else { "frequency_back" };
            self.run(Kernel::new(name), words, &buffers, groups(3 * n));
        }
        if wanted.t {
            let words = Words::default().u(pass.rays).u(pass.samples).u(pass.columns).u(pass.ray0);
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
            self.run(kernel, words, &buffers, groups(pass.rays * pass.columns));
        }
    }
}

/// Returns the words of the kernels of a box, for so many points.
pub(crate) fn domain_words(domain: &Domain, points: usize) -> Words {
    let (low, high) = domain.corners();
    let contraction = match domain.contraction() {
        Contraction::None => 0,
        Contraction::Axes => 1,
        Contraction::Ball => 2,
    };
    let words = low.into_iter().fold(Words::default(), Words::f).u(points);
    high.into_iter().fold(words, Words::f).u(contraction)
}

/// Returns the words of the kernels of a grid, for so many points with rows of `channels` numbers and for sums in units of
/// 1 / `scale`.
pub(crate) fn grid_words(grid: &HashGrid, points: usize, channels: usize, scale: f64) -> Words {
    let words = Words::default().u(points).u(grid.levels().len()).f(scale);
    let words = words.flag(grid.interpolation() == Interpolation::Smoothstep).u(channels).u(0).u(0).u(0);
    let of = |level: &Level| [level.resolution as usize, level.entries, level.offset, usize::from(level.dense)];
    let levels = grid.levels().iter().map(of).chain(std::iter::repeat([1, 1, 0, 1]));
    levels.take(32).flatten().fold(words, Words::u)
}

fn of_grid(grid: &HashGrid, name: &'static str) -> Kernel {
    Kernel::new(name).set("FEATURES", grid.features())
}

fn tables(field: &FieldBuffers) -> &crate::network::Learned {
    field.tables.as_ref().expect("a grid has tables")
}
