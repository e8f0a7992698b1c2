//! Records the dispatches of passes through a field: forward, and back to what is asked for.

use std::ops::Range;

use augnerf_core::augment::Site;
use augnerf_core::settings::{DensityActivation, FieldConfig, OutputPlace};
use wgpu::Buffer;

use crate::device::{Dispatch, Gpu, groups, rows};
use crate::kernels::{Kernel, Tile, Tiles};
use crate::network::{FieldBuffers, Layer, Shape};

/// Numbers of a ray in the rays' buffer; `rays.wgsl` says which.
pub(crate) const RAY: usize = 20;
/// Numbers of a ray in a pass's output; `composite.wgsl` says which.
pub(crate) const OUT: usize = 8;
/// Numbers of a slot of results; `loss.wgsl` says which.
pub(crate) const SLOT: usize = 16;
/// Parts of a gradient of weights, at most.
const MOST_PARTS: usize = 128;
/// Fewest rows of a part.
const PART: usize = 512;

/// The words of a kernel's parameters.
#[derive(Default)]
pub(crate) struct Words(Vec<u32>);

impl Words {
    pub(crate) fn u(mut self, value: usize) -> Words {
        self.0.push(value as u32);
        self
    }

    pub(crate) fn f(mut self, value: f64) -> Words {
        self.0.push((value as f32).to_bits());
        self
    }

    pub(crate) fn words(&self) -> &[u32] {
        &self.0
    }

    fn flag(self, value: bool) -> Words {
        self.u(usize::from(value))
    }
}

/// A matrix in a buffer: numbers between rows, columns that are read.
#[derive(Clone, Copy)]
pub(crate) struct Matrix<'a> {
    buffer: &'a Buffer,
    stride: usize,
    columns: usize,
    /// Rows that share one of its rows.
    every: usize,
}

impl<'a> Matrix<'a> {
    fn new(buffer: &'a Buffer, stride: usize) -> Matrix<'a> {
        Matrix { buffer, stride, columns: stride, every: 1 }
    }
}

/// Buffers of the samples of a chunk of rays, used by one pass after another.
pub(crate) struct Scratch {
    points: Buffer,
    unit: Buffer,
    inside: Buffer,
    encoded: Buffer,
    trunk: Vec<Buffer>,
    /// The injection layer's output with its delta.
    moved: Buffer,
    head: Buffer,
    view: Vec<Buffer>,
    raw: Buffer,
    pub(crate) values: Buffer,
    density: Buffer,
    pub(crate) weights: Buffer,
    before: Buffer,
    d_values: Buffer,
    d_raw: Buffer,
    d_head: Buffer,
    d_hidden: [Buffer; 2],
    d_encoded: Buffer,
    d_feature: Buffer,
    d_view: Buffer,
    d_points: Buffer,
    d_t: Buffer,
    d_tilt: Buffer,
    t_moved: Buffer,
    view_encoded: Buffer,
    parts: Buffer,
    used_rgb: Buffer,
    used_density: Buffer,
}

impl Scratch {
    /// Bytes of a sample.
    pub(crate) fn bytes_per_sample(shape: &Shape) -> usize {
        let numbers = 3 * 4
            + 1
            + 2 * shape.channels
            + (shape.trunk.len() + 4) * shape.width
            + 2 * (shape.width + 4)
            + shape.view.len() * shape.view_width
            + shape.view_channels
            + 34;
        4 * numbers
    }

    /// Makes the buffers of so many rays, those of the way back if `trains`.
    pub(crate) fn new(gpu: &Gpu, shape: &Shape, rays: usize, samples: usize, trains: bool) -> Scratch {
        let n = rays * samples;
        let f = |numbers: usize| gpu.numbers(numbers);
        let back = |numbers: usize| gpu.numbers(if trains { numbers } else { 1 });
        let hidden = n * shape.width.max(shape.view_width);
        Scratch {
            points: f(3 * n),
            unit: f(3 * n),
            inside: f(n),
            encoded: f(n * shape.channels),
            trunk: shape.trunk.iter().map(|_| f(n * shape.width)).collect(),
            moved: back(n * shape.width),
            head: f(n * (shape.width + 4)),
            view: shape.view.iter().map(|_| f(n * shape.view_width)).collect(),
            raw: f(4 * n),
            values: f(4 * n),
            density: f(n),
            weights: f(n),
            before: back(n),
            d_values: back(4 * n),
            d_raw: back(4 * n),
            d_head: back(n * (shape.width + 4)),
            d_hidden: [back(hidden), back(hidden)],
            d_encoded: back(n * shape.channels),
            d_feature: back(n * shape.width),
            d_view: back(n * shape.view_channels),
            d_points: back(3 * n),
            d_t: back(rays * (samples + 1)),
            d_tilt: back(2 * rays),
            t_moved: back(rays * (samples + 1)),
            view_encoded: f(rays * shape.view_channels),
            parts: back(Recorder::parts(n).1 * shape.weights()),
            used_rgb: back(3 * n),
            used_density: back(n),
        }
    }
}

/// The numbers of a field's outputs that kernels need.
#[derive(Clone, Copy)]
pub(crate) struct Outputs {
    activation: usize,
    padding: f64,
    limit: f64,
}

impl Outputs {
    pub(crate) fn of(config: &FieldConfig) -> Outputs {
        let activation = match config.density_activation {
            DensityActivation::Relu => 0,
            DensityActivation::Softplus => 1,
            DensityActivation::Exp => 2,
        };
        let limit = if config.rgb_limit > 0.0 { config.rgb_limit } else { 3e38 };
        Outputs { activation, padding: config.rgb_padding, limit }
    }
}

/// The deltas of a perturbed pass that are on, and how the last two are projected.
#[derive(Clone, Copy, Default)]
pub(crate) struct DeltaBuffers<'a> {
    pub(crate) t: Option<&'a Buffer>,
    pub(crate) xyz: Option<&'a Buffer>,
    pub(crate) view: Option<&'a Buffer>,
    pub(crate) feature: Option<(&'a Buffer, usize)>,
    pub(crate) rgb: Option<(&'a Buffer, f64, bool)>,
    pub(crate) density: Option<(&'a Buffer, f64, bool)>,
    pub(crate) before: bool,
}

impl<'a> DeltaBuffers<'a> {
    /// Returns the same with one site alone.
    pub(crate) fn only(self, site: Site) -> DeltaBuffers<'a> {
        let none = DeltaBuffers { before: self.before, ..DeltaBuffers::default() };
        match site {
            Site::T => DeltaBuffers { t: self.t, ..none },
            Site::Xyz => DeltaBuffers { xyz: self.xyz, ..none },
            Site::View => DeltaBuffers { view: self.view, ..none },
            Site::Feature => DeltaBuffers { feature: self.feature, ..none },
            Site::Rgb => DeltaBuffers { rgb: self.rgb, ..none },
            Site::Density => DeltaBuffers { density: self.density, ..none },
        }
    }
}

/// What the way back computes.
#[derive(Clone, Copy, Default)]
pub(crate) struct Wanted {
    pub(crate) weights: bool,
    pub(crate) t: bool,
    pub(crate) xyz: bool,
    pub(crate) view: bool,
    pub(crate) feature: bool,
}

impl Wanted {
    fn points(self) -> bool {
        self.t || self.xyz
    }
}

/// A pass of a chunk of rays through a field.
#[derive(Clone, Copy)]
pub(crate) struct PassAt<'a> {
    pub(crate) field: &'a FieldBuffers,
    /// First ray of the chunk, and number.
    pub(crate) ray0: usize,
    pub(crate) rays: usize,
    pub(crate) samples: usize,
    pub(crate) columns: usize,
    pub(crate) t_vals: &'a Buffer,
    /// Noise on raw density, and the place of the first sample's.
    pub(crate) noise: Option<(&'a Buffer, usize)>,
    pub(crate) deltas: DeltaBuffers<'a>,
    /// Colours and more of all rays.
    pub(crate) out: &'a Buffer,
}

impl PassAt<'_> {
    fn points(&self) -> usize {
        self.rays * self.samples
    }
}

/// The loss of a pass.
#[derive(Clone, Copy)]
pub(crate) struct PassLoss {
    /// Weight of the squared error of one channel of one ray.
    pub(crate) weight: f64,
    /// Weight of the distortion of one ray.
    pub(crate) distortion: f64,
}

/// Where a gradient of a delta is: buffer, numbers between two vectors, place of the first.
pub(crate) type GradientAt<'a> = (&'a Buffer, usize, usize);

/// What dispatches do, by counting.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Work {
    pub(crate) dispatches: usize,
    pub(crate) multiply_adds: f64,
}

/// Records dispatches.
pub(crate) struct Recorder<'a> {
    pub(crate) gpu: &'a Gpu,
    pub(crate) shape: &'a Shape,
    pub(crate) outputs: Outputs,
    pub(crate) scratch: &'a Scratch,
    pub(crate) rays: &'a Buffer,
    pub(crate) flags: &'a Buffer,
    pub(crate) bounds: (f64, f64),
    pub(crate) background: Option<[f32; 3]>,
    pub(crate) tiles: Tiles,
    /// Factor of all gradients up to Adam, which keeps them in the range of f16.
    pub(crate) loss_scale: f64,
    pub(crate) dispatches: Vec<Dispatch>,
    pub(crate) work: Work,
}

impl<'a> Recorder<'a> {
    /// Records a kernel with parameters at binding 0.
    pub(crate) fn run(&mut self, kernel: Kernel, words: Words, buffers: &[(u32, &Buffer)], size: [u32; 3]) {
        let uniform = self.gpu.uniform(&words.0);
        let bound: Vec<(u32, &Buffer)> = std::iter::once((0, &uniform)).chain(buffers.iter().copied()).collect();
        self.dispatches.push(self.gpu.dispatch(&kernel, &bound, size));
        self.work.dispatches += 1;
    }

    /// Returns the tile and the kernel of a product with so many columns.
    fn tiled(&self, name: &'static str, columns: usize) -> (Tile, Kernel) {
        let tile = Tile::of(columns, self.tiles);
        (tile, tile.kernel(name).with("F16", tile.in_f16))
    }

    fn product_words(m: usize, n: usize, a: Matrix, second: Option<Matrix>) -> Words {
        let b = second.unwrap_or(Matrix { columns: 0, stride: 1, every: 1, ..a });
        Words::default().u(m).u(n).u(a.columns).u(b.columns).u(a.stride).u(b.stride).u(b.every)
    }

    /// Records C = [A1 | A2] W + b over some columns of a layer.
    #[expect(clippy::too_many_arguments, reason = "the operands of a product")]
    fn dense(
        &mut self,
        m: usize,
        field: &FieldBuffers,
        layer: Layer,
        columns: Range<usize>,
        (a, second): (Matrix, Option<Matrix>),
        c: (&Buffer, usize, usize),
        relu: bool,
        delta: Option<(&Buffer, &Buffer)>,
    ) {
        let n = columns.len();
        let (tile, kernel) = self.tiled("product", n);
        let kernel = kernel.with("SECOND", second.is_some()).with("DELTA", delta.is_some());
        let words = Recorder::product_words(m, n, a, second).u(layer.outputs).u(layer.offset + columns.start);
        let words = words.u(c.1).u(c.2).flag(relu).u(n).u(0).u(0).u(0);
        let mut buffers = vec![(1, a.buffer), (3, &field.weights.values), (4, c.0)];
        buffers.extend(second.map(|second| (2, second.buffer)));
        if let Some((delta, moved)) = delta {
            buffers.extend([(5, delta), (6, moved)]);
        }
        let size = [m.div_ceil(tile.rows) as u32, n.div_ceil(tile.columns) as u32, 1];
        self.run(kernel, words, &buffers, size);
        self.work.multiply_adds += (m * n * layer.inputs) as f64;
    }

    /// Records C = D W^T over some of a layer's inputs, by the mask of a ReLU's output, added to C, and beside it without
    /// the mask.
    #[expect(clippy::too_many_arguments, reason = "the operands of a product")]
    fn dense_back(
        &mut self,
        m: usize,
        field: &FieldBuffers,
        layer: Layer,
        inputs: Range<usize>,
        d: Matrix,
        c: (&Buffer, usize),
        mask: Option<&Buffer>,
        adds: bool,
        open: Option<&Buffer>,
    ) {
        let n = inputs.len();
        let (tile, kernel) = self.tiled("product_back", n);
        let kernel = kernel.with("ADD", adds).with("MASK", mask.is_some());
        let kernel = kernel.with("OPEN", open.is_some());
        let words = Recorder::product_words(m, n, d, None).u(layer.outputs);
        let words = words.u(layer.offset + inputs.start * layer.outputs).u(c.1).u(0).u(0).u(n).u(0).u(0).u(0);
        let mut buffers = vec![(1, d.buffer), (3, &field.weights.values), (4, c.0)];
        buffers.extend(mask.map(|mask| (5, mask)));
        buffers.extend(open.map(|open| (6, open)));
        let size = [m.div_ceil(tile.rows) as u32, n.div_ceil(tile.columns) as u32, 1];
        self.run(kernel, words, &buffers, size);
        self.work.multiply_adds += (m * n * layer.outputs) as f64;
    }

    /// Rows of a part of a gradient of weights over `m` rows, and parts.
    fn parts(m: usize) -> (usize, usize) {
        let rows = m.div_ceil(MOST_PARTS).max(PART).next_multiple_of(16);
        (rows, m.div_ceil(rows))
    }

    /// Records the parts of a layer's gradient.
    fn dense_weights(&mut self, m: usize, layer: Layer, (a, second): (Matrix, Option<Matrix>), d: Matrix) {
        let (tile, kernel) = self.tiled("weights", layer.outputs);
        let (part_rows, parts) = Recorder::parts(m);
        let kernel = kernel.with("SECOND", second.is_some());
        let words = Recorder::product_words(m, layer.outputs, a, second).u(d.stride).u(0).u(0).u(0).u(0).u(0);
        let words = words.u(part_rows).u(self.shape.weights()).u(layer.offset).u(0);
        let scratch = self.scratch;
        let mut buffers = vec![(1, a.buffer), (3, d.buffer), (4, &scratch.parts)];
        buffers.extend(second.map(|second| (2, second.buffer)));
        let tiles = |size: usize, tile: usize| size.div_ceil(tile) as u32;
        let size = [tiles(layer.inputs, tile.rows), tiles(layer.outputs, tile.columns), parts as u32];
        self.run(kernel, words, &buffers, size);
        self.work.multiply_adds += (m * layer.inputs * layer.outputs) as f64;
    }

    /// Records positions, points and their encoding. Returns the positions along rays.
    fn place(&mut self, pass: &PassAt<'a>) -> &'a Buffer {
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
        self.run(Kernel::new("points").with("SHIFT", pass.deltas.xyz.is_some()), words, &buffers, groups(n));
        let Some(grid) = &self.shape.grid else {
            let words = Words::default().u(n).u(self.shape.octaves).u(self.shape.channels).u(0);
            self.run(Kernel::new("frequency"), words, &[(1, &scratch.points), (2, &scratch.encoded)], groups(3 * n));
            return t_vals;
        };
        let words = self.domain(n);
        let buffers = [(1, &scratch.points), (2, &scratch.unit), (3, &scratch.inside)];
        self.run(Kernel::new("domain"), words, &buffers, groups(n));
        let kernel = Kernel::new("encode").set("FEATURES", grid.features);
        let tables = &pass.field.tables.as_ref().expect("a grid has tables").values;
        let words = self.grid(n);
        let buffers = [(1, &scratch.unit), (2, tables), (3, &scratch.encoded)];
        let threads = n * self.shape.grid.as_ref().map_or(0, |grid| grid.levels.len());
        self.run(kernel, words, &buffers, groups(threads));
        t_vals
    }

    fn domain(&self, points: usize) -> Words {
        let grid = self.shape.grid.as_ref().expect("a grid");
        let corner = |words: Words, [x, y, z]: [f64; 3]| words.f(x).f(y).f(z);
        corner(corner(Words::default(), grid.low).u(points), grid.high).u(grid.contraction as usize)
    }

    fn grid(&self, points: usize) -> Words {
        let grid = self.shape.grid.as_ref().expect("a grid");
        let mut words = Words::default()
            .u(points)
            .u(grid.levels.len())
            .f(FIXED_SCALE / self.loss_scale)
            .flag(grid.smooth)
            .u(self.shape.channels)
            .u(0)
            .u(0)
            .u(0);
        for level in 0..32 {
            for word in grid.levels.get(level).copied().unwrap_or([1, 1, 0, 1]) {
                words = words.u(word as usize);
            }
        }
        words
    }

    /// Whether points can be outside of where density is.
    fn has_outside(&self) -> bool {
        self.shape.grid.as_ref().is_some_and(|grid| grid.contraction == 0)
    }

    /// The input of layer `i` of the trunk.
    fn trunk_input(&self, i: usize, injection: Option<usize>) -> (Matrix<'a>, Option<Matrix<'a>>) {
        let (scratch, shape) = (self.scratch, self.shape);
        let encoded = Matrix::new(&scratch.encoded, shape.channels);
        if i == 0 {
            return (encoded, None);
        }
        let below = if injection == Some(i) { &scratch.moved } else { &scratch.trunk[i - 1] };
        let hidden = Matrix::new(below, shape.width);
        if i < shape.trunk.len() && shape.skips_to(i) { (encoded, Some(hidden)) } else { (hidden, None) }
    }

    /// Records the trunk of a pass.
    fn trunk(&mut self, pass: &PassAt<'a>) {
        let (shape, scratch, n) = (self.shape, self.scratch, pass.points());
        let injection = pass.deltas.feature.map(|(_, layer)| layer);
        for (i, layer) in shape.trunk.iter().enumerate() {
            let input = self.trunk_input(i, injection);
            let delta = pass.deltas.feature.filter(|(_, at)| *at == i + 1).map(|(delta, _)| (delta, &scratch.moved));
            let c = (&scratch.trunk[i], shape.width, 0);
            self.dense(n, pass.field, *layer, 0..shape.width, input, c, true, delta);
        }
    }

    /// Records the weights of samples from the field's density alone.
    pub(crate) fn place_by_density(&mut self, pass: &PassAt<'a>) {
        let (shape, scratch, n) = (self.shape, self.scratch, pass.points());
        let t_vals = self.place(pass);
        self.trunk(pass);
        let last = self.trunk_input(shape.trunk.len(), None).0;
        let columns = shape.width..shape.width + 4;
        let c = (&scratch.head, shape.width + 4, shape.width);
        self.dense(n, pass.field, shape.head, columns, (last, None), c, false, None);
        self.density_of_head(pass);
        self.march(pass, t_vals, None);
    }

    fn output_words(&self, pass: &PassAt) -> Words {
        let Outputs { activation, padding, limit } = self.outputs;
        let deltas = &pass.deltas;
        let (rgb, ball) = deltas.rgb.map_or((0.0, false), |(_, radius, ball)| (radius, ball));
        let (density, masks) = deltas.density.map_or((0.0, false), |(_, radius, masks)| (radius, masks));
        let words = Words::default().u(pass.points()).u(pass.samples).u(self.shape.width + 4).u(activation);
        let words = words.f(padding).f(limit).f(rgb).f(density).flag(ball).flag(masks).flag(deltas.before);
        words.u(pass.noise.map_or(0, |(_, first)| first))
    }

    fn density_of_head(&mut self, pass: &PassAt<'a>) {
        let scratch = self.scratch;
        let words = self.output_words(pass);
        let mut buffers = vec![(2, &scratch.head), (3, &scratch.density)];
        if self.has_outside() {
            buffers.push((4, &scratch.inside));
        }
        let kernel = Kernel::new("density").with("INSIDE", self.has_outside());
        self.run(kernel, words, &buffers, groups(pass.points()));
    }

    /// Records weights, or accumulation without noise into `out`.
    fn march(&mut self, pass: &PassAt<'a>, t_vals: &Buffer, out: Option<&Buffer>) {
        let scratch = self.scratch;
        let words = Words::default().u(pass.rays).u(pass.samples).u(pass.columns).u(pass.ray0).u(0).u(0).u(0).u(0);
        let kernel = Kernel::new("march").with("WEIGHTS", out.is_none()).with("ACC", out.is_some());
        let mut buffers = vec![(1, self.rays), (2, t_vals), (3, &scratch.density)];
        buffers.push(out.map_or((4, &scratch.weights), |out| (5, out)));
        self.run(kernel, words, &buffers, [pass.rays.div_ceil(32) as u32, 1, 1]);
    }

    /// Records a pass forward, and its loss with what the way back starts from.
    pub(crate) fn forward(&mut self, pass: &PassAt<'a>, loss: Option<PassLoss>) {
        let (shape, scratch, n) = (self.shape, self.scratch, pass.points());
        let t_vals = self.place(pass);
        let words = Words::default().u(pass.rays).u(shape.view_octaves).u(shape.view_channels).u(pass.ray0);
        let mut buffers = vec![(1, self.rays), (2, &scratch.view_encoded)];
        buffers.extend(pass.deltas.view.map(|tilt| (3, tilt)));
        self.run(Kernel::new("view").with("TILT", pass.deltas.view.is_some()), words, &buffers, groups(pass.rays));
        self.trunk(pass);
        let injection = pass.deltas.feature.map(|(_, layer)| layer);
        let last = self.trunk_input(shape.trunk.len(), injection).0;
        let head = (&scratch.head, shape.width + 4, 0);
        self.dense(n, pass.field, shape.head, 0..shape.width + 4, (last, None), head, false, None);
        for (i, layer) in shape.view.iter().enumerate() {
            let input = self.view_input(i, pass.samples);
            let c = (&scratch.view[i], shape.view_width, 0);
            self.dense(n, pass.field, *layer, 0..shape.view_width, input, c, true, None);
        }
        let last = (self.view_input(shape.view.len(), pass.samples).0, None);
        self.dense(n, pass.field, shape.rgb, 0..4, last, (&scratch.raw, 4, 0), false, None);
        self.activate(pass);
        self.composite(pass, t_vals, loss);
        if pass.noise.is_some() {
            self.density_of_head(pass);
            self.march(pass, t_vals, Some(pass.out));
        }
    }

    /// The input of layer `i` between trunk and colour.
    fn view_input(&self, i: usize, samples: usize) -> (Matrix<'a>, Option<Matrix<'a>>) {
        let (scratch, shape) = (self.scratch, self.shape);
        if i > 0 {
            return (Matrix::new(&scratch.view[i - 1], shape.view_width), None);
        }
        let feature = Matrix { columns: shape.width, ..Matrix::new(&scratch.head, shape.width + 4) };
        let view = Matrix { every: samples, ..Matrix::new(&scratch.view_encoded, shape.view_channels) };
        (feature, Some(view))
    }

    fn activate(&mut self, pass: &PassAt<'a>) {
        let (scratch, deltas) = (self.scratch, pass.deltas);
        let words = self.output_words(pass);
        let mut buffers = vec![(1, &scratch.raw), (2, &scratch.head), (3, &scratch.values)];
        if self.has_outside() {
            buffers.push((4, &scratch.inside));
        }
        buffers.extend(pass.noise.map(|(noise, _)| (5, noise)));
        if let Some((delta, ..)) = deltas.rgb {
            buffers.extend([(6, delta), (8, &scratch.used_rgb)]);
        }
        if let Some((delta, ..)) = deltas.density {
            buffers.extend([(7, delta), (9, &scratch.used_density)]);
        }
        let kernel = Kernel::new("activate").with("INSIDE", self.has_outside()).with("NOISE", pass.noise.is_some());
        let kernel = kernel.with("RGB", deltas.rgb.is_some()).with("DENSITY", deltas.density.is_some());
        self.run(kernel, words, &buffers, groups(pass.points()));
    }

    fn composite(&mut self, pass: &PassAt<'a>, t_vals: &Buffer, loss: Option<PassLoss>) {
        let scratch = self.scratch;
        let background = self.background.unwrap_or_default().map(f64::from);
        let PassLoss { weight, distortion } = loss.unwrap_or(PassLoss { weight: 0.0, distortion: 0.0 });
        let words = Words::default().u(pass.rays).u(pass.samples).u(pass.columns).u(pass.ray0);
        let words = background.into_iter().fold(words, Words::f).flag(self.background.is_some());
        let words = words.f(weight * self.loss_scale).f(distortion * self.loss_scale).f(self.bounds.0).f(self.bounds.1);
        let mut buffers = vec![(1, self.rays), (2, t_vals), (3, &scratch.values), (4, &scratch.weights), (5, pass.out)];
        if loss.is_some() {
            buffers.extend([(6, &scratch.before), (7, &scratch.d_values), (8, &scratch.d_t)]);
        }
        let kernel = Kernel::new("composite").with("BACK", loss.is_some()).with("DISTORTION", distortion != 0.0);
        self.run(kernel, words, &buffers, [pass.rays.div_ceil(32) as u32, 1, 1]);
    }

    /// Records the way back of the pass that was just recorded forward.
    pub(crate) fn back(&mut self, pass: &PassAt<'a>, wanted: Wanted) {
        let of_tables = wanted.weights && self.shape.grid.is_some();
        let of_encoding = of_tables || wanted.points();
        self.activate_back(pass);
        let below = wanted.weights || wanted.points() || wanted.feature;
        if !(below || wanted.view) {
            return;
        }
        self.colour_back(pass, wanted, below);
        if below {
            self.trunk_back(pass, wanted, of_encoding);
        }
        if wanted.weights {
            self.reduce(pass);
        }
        if of_encoding {
            self.encoding_back(pass, wanted);
        }
    }

    fn activate_back(&mut self, pass: &PassAt<'a>) {
        let (scratch, deltas) = (self.scratch, pass.deltas);
        let words = self.output_words(pass);
        let mut buffers = vec![
            (1, &scratch.raw),
            (2, &scratch.head),
            (3, &scratch.d_values),
            (4, &scratch.d_raw),
            (5, &scratch.d_head),
        ];
        let [rgb, density] = [deltas.rgb.is_some(), deltas.density.is_some()].map(|on| on && deltas.before);
        if self.has_outside() {
            buffers.push((6, &scratch.inside));
        }
        buffers.extend(pass.noise.map(|(noise, _)| (7, noise)));
        if rgb {
            buffers.push((8, &scratch.used_rgb));
        }
        if density {
            buffers.push((9, &scratch.used_density));
        }
        let kernel = Kernel::new("activate_back").with("INSIDE", self.has_outside());
        let kernel = kernel.with("NOISE", pass.noise.is_some()).with("BEFORE_RGB", rgb).with("BEFORE_DENSITY", density);
        self.run(kernel, words, &buffers, groups(pass.points()));
    }

    /// From the raw colour to the head, and to the encoding of view directions.
    fn colour_back(&mut self, pass: &PassAt<'a>, wanted: Wanted, below: bool) {
        let (shape, scratch, n) = (self.shape, self.scratch, pass.points());
        let mut d = Matrix::new(&scratch.d_raw, 4);
        let mut layer = shape.rgb;
        let mut next = 0;
        for i in (0..=shape.view.len()).rev() {
            let input = self.view_input(i, pass.samples);
            if wanted.weights {
                self.dense_weights(n, layer, input, d);
            }
            if i > 0 {
                let to = &scratch.d_hidden[next];
                let c = (to, shape.view_width);
                let mask = Some(&scratch.view[i - 1]);
                self.dense_back(n, pass.field, layer, 0..shape.view_width, d, c, mask, false, None);
                d = Matrix::new(to, shape.view_width);
                next = 1 - next;
                layer = shape.view[i - 1];
            }
        }
        if below {
            let c = (&scratch.d_head, shape.width + 4);
            self.dense_back(n, pass.field, layer, 0..shape.width, d, c, None, false, None);
        }
        if wanted.view {
            let inputs = shape.width..shape.width + shape.view_channels;
            let c = (&scratch.d_view, shape.view_channels);
            self.dense_back(n, pass.field, layer, inputs, d, c, None, false, None);
            let words = Words::default().u(pass.rays).u(shape.view_octaves).u(shape.view_channels);
            let words = words.u(pass.ray0).u(pass.samples).u(0).u(0).u(0);
            let tilt = pass.deltas.view.expect("a gradient of a delta that is there");
            let buffers =
                [(1, self.rays), (2, &scratch.view_encoded), (3, &scratch.d_view), (4, tilt), (5, &scratch.d_tilt)];
            self.run(Kernel::new("view_back"), words, &buffers, groups(pass.rays));
        }
    }

    /// From the head down the trunk: to the injection layer, or to the encoding.
    fn trunk_back(&mut self, pass: &PassAt<'a>, wanted: Wanted, of_encoding: bool) {
        let (shape, scratch, n) = (self.shape, self.scratch, pass.points());
        let injection = pass.deltas.feature.map(|(_, layer)| layer);
        let lowest = if wanted.weights || of_encoding { 0 } else { injection.unwrap_or(0) };
        let mut d = Matrix::new(&scratch.d_head, shape.width + 4);
        let mut layer = shape.head;
        let mut next = 0;
        let mut added = false;
        for i in (0..=shape.trunk.len()).rev() {
            let input = self.trunk_input(i, injection);
            if wanted.weights {
                self.dense_weights(n, layer, input, d);
            }
            if of_encoding && (i == 0 || i < shape.trunk.len() && shape.skips_to(i)) {
                let c = (&scratch.d_encoded, shape.channels);
                self.dense_back(n, pass.field, layer, 0..shape.channels, d, c, None, added, None);
                added = true;
            }
            if i == 0 {
                break;
            }
            let from = if i < shape.trunk.len() && shape.skips_to(i) { shape.channels } else { 0 };
            let to = &scratch.d_hidden[next];
            let open = (wanted.feature && injection == Some(i)).then_some(&scratch.d_feature);
            let mask = Some(&scratch.trunk[i - 1]);
            let inputs = from..from + shape.width;
            self.dense_back(n, pass.field, layer, inputs, d, (to, shape.width), mask, false, open);
            if lowest == i {
                break;
            }
            d = Matrix::new(to, shape.width);
            next = 1 - next;
            layer = shape.trunk[i - 1];
        }
    }

    fn reduce(&mut self, pass: &PassAt<'a>) {
        let (numbers, (_, parts)) = (self.shape.weights(), Recorder::parts(pass.points()));
        let words = Words::default().u(numbers).u(parts).u(0).u(0);
        let buffers = [(1, &self.scratch.parts), (2, &pass.field.weights.gradient)];
        self.run(Kernel::new("reduce"), words, &buffers, groups(numbers));
    }

    /// From the encoding to tables and points.
    fn encoding_back(&mut self, pass: &PassAt<'a>, wanted: Wanted) {
        let (shape, scratch, n) = (self.shape, self.scratch, pass.points());
        if let (Some(grid), Some(tables)) = (&shape.grid, &pass.field.tables) {
            let of_grid = |name| Kernel::new(name).set("FEATURES", grid.features);
            if wanted.weights {
                let words = self.grid(n);
                let buffers = [(1, &scratch.unit), (2, &scratch.d_encoded), (3, &tables.gradient), (4, self.flags)];
                self.run(of_grid("scatter"), words, &buffers, groups(n * grid.levels.len()));
            }
            if wanted.points() {
                let words = self.grid(n);
                let buffers =
                    [(1, &scratch.unit), (2, &tables.values), (3, &scratch.d_encoded), (4, &scratch.d_points)];
                self.run(of_grid("slope"), words, &buffers, groups(n));
                let words = self.domain(n);
                let buffers = [(1, &scratch.points), (2, &scratch.inside), (3, &scratch.d_points)];
                self.run(Kernel::new("domain_back"), words, &buffers, groups(n));
            }
        } else if wanted.points() {
            let words = Words::default().u(n).u(shape.octaves).u(shape.channels).u(0);
            let buffers = [(1, &scratch.encoded), (2, &scratch.d_encoded), (3, &scratch.d_points)];
            self.run(Kernel::new("frequency_back"), words, &buffers, groups(3 * n));
        }
        if wanted.t {
            let words = Words::default().u(pass.rays).u(pass.samples).u(pass.columns).u(pass.ray0);
            let buffers = [(1, self.rays), (2, &scratch.d_points), (3, &scratch.d_t)];
            self.run(Kernel::new("t_back"), words, &buffers, groups(pass.rays * pass.columns));
        }
    }

    /// Where the gradient of a site's delta is after the way back.
    pub(crate) fn gradient_of(&self, site: Site, place: OutputPlace) -> GradientAt<'a> {
        let (scratch, width) = (self.scratch, self.shape.width);
        match (site, place) {
            (Site::T, _) => (&scratch.d_t, 1, 0),
            (Site::Xyz, _) => (&scratch.d_points, 3, 0),
            (Site::View, _) => (&scratch.d_tilt, 2, 0),
            (Site::Feature, _) => (&scratch.d_feature, width, 0),
            (Site::Rgb, OutputPlace::After) => (&scratch.d_values, 4, 0),
            (Site::Density, OutputPlace::After) => (&scratch.d_values, 4, 3),
            (Site::Rgb, OutputPlace::Before) => (&scratch.d_raw, 4, 0),
            (Site::Density, OutputPlace::Before) => (&scratch.d_head, width + 4, width),
        }
    }

    /// The positions of the last pass with a delta of `t`.
    pub(crate) fn moved_t_vals(&self) -> &'a Buffer {
        &self.scratch.t_moved
    }

    /// Where the deltas of the output level are as the last pass used them.
    pub(crate) fn used(&self, site: Site) -> Option<&'a Buffer> {
        match site {
            Site::Rgb => Some(&self.scratch.used_rgb),
            Site::Density => Some(&self.scratch.used_density),
            _ => None,
        }
    }

    /// Records the sums over all rays of a pass.
    pub(crate) fn sums(&mut self, rays: usize, out: &Buffer, slot: usize, results: &Buffer) {
        let words = Words::default().u(rays).u(slot).u(0).u(0);
        self.run(Kernel::new("loss"), words, &[(1, self.rays), (2, out), (3, results)], [1, 1, 1]);
    }

    /// Records the inverse of the CDF of the weights that the last pass left.
    pub(crate) fn resample(&mut self, at: Resampling, t_vals: &Buffer, u: &Buffer, out: &Buffer) {
        let Resampling { rays, coarse, columns, fine, intervals, padding, mode } = at;
        let narrowest = if intervals { 0.0 } else { FLOOR };
        let padding = if intervals { padding } else { FLOOR };
        let words = Words::default().u(coarse).u(columns).u(fine).flag(intervals).f(padding).f(narrowest);
        let words = words.u(mode).u(rays);
        let most = (coarse + 1).max(if intervals { fine } else { coarse + fine }).next_power_of_two();
        let buffers = [(1, t_vals), (2, &self.scratch.weights), (3, u), (4, out)];
        self.run(Kernel::new("resample").set("MOST", most), words, &buffers, rows(rays));
    }
}

/// Added to each weight before it counts as a probability, as on the host.
const FLOOR: f64 = 1e-5;

/// 2^24 in the high word of a fixed-point sum: numbers to 128, in steps of 2^-56.
pub(crate) const FIXED_SCALE: f64 = 16_777_216.0;

/// The numbers of a resampling.
#[derive(Clone, Copy)]
pub(crate) struct Resampling {
    pub(crate) rays: usize,
    pub(crate) coarse: usize,
    pub(crate) columns: usize,
    pub(crate) fine: usize,
    pub(crate) intervals: bool,
    pub(crate) padding: f64,
    pub(crate) mode: usize,
}
