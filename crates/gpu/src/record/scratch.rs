//! The buffers of samples.

use augnerf_nerf::settings::{Precision, Resolved};
use wgpu::Buffer;

use crate::device::Gpu;
use crate::kernels::{Tiles, trunk_rows};
use crate::network::Shape;

use super::products::{most_parts, parts_of};

/// Samples of which a group lists those with a gradient.
pub(super) const LIVE_GROUP: usize = 256;

/// How samples are kept and computed.
#[derive(Clone, Copy)]
pub(crate) struct Form {
    /// What layers leave for each other, and the weights that products read, are in f16.
    pub(crate) in_f16: bool,
    /// Bytes of a number that layers leave. Derivatives in space need all of f32.
    of_hidden: usize,
    /// Rows of a group that computes all layers of the trunk, if one does. What they leave is in one buffer then.
    pub(super) trunk_rows: Option<usize>,
    pub(crate) trains: bool,
}

impl Form {
    /// Without a way back, in f32.
    pub(crate) const RENDERING: Form = Form { in_f16: false, of_hidden: 4, trunk_rows: None, trains: false };

    pub(crate) fn of_steps(gpu: &Gpu, config: &Resolved, shape: &Shape) -> Form {
        let in_f16 = config.field.precision == Precision::F16;
        let has_space_terms = config.regularizer.has_space_terms();
        let of_hidden = if in_f16 && !has_space_terms { 2 } else { 4 };
        // Derivatives in space pass through the layers one by one, which a buffer of all cannot be bound for. Skips are bits of a word.
        let has_trunks = gpu.tiles(config.field.precision) == Tiles::Matrices
            && (2..=32).contains(&shape.trunk.len())
            && !has_space_terms;
        let trunk_rows = if has_trunks { trunk_rows(shape.width, shape.channels, gpu.shared_bytes()) } else { None };
        Form { in_f16, of_hidden, trunk_rows, trains: true }
    }

    /// Returns the bytes of a sample in the buffer of all layers, if there is one.
    pub(crate) fn bytes_of_trunk(self, shape: &Shape) -> usize {
        self.trunk_rows.map_or(0, |_| self.of_hidden * shape.trunk.len() * shape.width)
    }
}

/// What the layers of a trunk leave, or the gradients of that: a buffer of each, or parts of one.
#[derive(Clone)]
pub(crate) struct Layers {
    pub(super) buffers: Vec<Buffer>,
    /// Bytes of each part.
    pub(super) bytes: u64,
}

impl Layers {
    fn new(gpu: &Gpu, layers: usize, bytes: usize, are_parts: bool) -> Layers {
        // Parts begin where bindings may.
        let bytes = bytes.next_multiple_of(256);
        let buffers =
            if are_parts { vec![gpu.buffer(layers * bytes)] } else { (0..layers).map(|_| gpu.buffer(bytes)).collect() };
        Layers { buffers, bytes: bytes as u64 }
    }
}

/// Buffers of the samples of a chunk of rays, used by one pass after another.
pub(crate) struct Scratch {
    pub(super) points: Buffer,
    /// Of Gaussians.
    pub(super) variances: Buffer,
    pub(super) unit: Buffer,
    pub(super) inside: Buffer,
    pub(super) encoded: Buffer,
    pub(super) trunk: Layers,
    /// The injection layer's output with its delta.
    pub(super) moved: Buffer,
    pub(super) head: Buffer,
    pub(super) view: Vec<Buffer>,
    pub(super) raw: Buffer,
    pub(crate) values: Buffer,
    pub(crate) density: Buffer,
    pub(super) weights: Buffer,
    pub(super) before: Buffer,
    pub(super) d_values: Buffer,
    pub(super) d_raw: Buffer,
    pub(super) d_head: Buffer,
    /// The samples with a gradient: how many, and which.
    pub(super) live: Buffer,
    pub(super) live_counts: Buffer,
    /// The gradients of what layers leave, of two in turn.
    pub(super) d_hidden: Layers,
    /// Those of the trunk, the same two or one of each layer.
    pub(super) d_trunk: Layers,
    pub(super) d_encoded: Buffer,
    pub(super) d_feature: Buffer,
    pub(super) d_view: Buffer,
    pub(super) d_points: Buffer,
    pub(super) d_variances: Buffer,
    pub(super) d_t: Buffer,
    pub(super) d_tilt: Buffer,
    pub(super) t_moved: Buffer,
    pub(super) view_encoded: Buffer,
    pub(super) parts: Buffer,
    /// Parts of a gradient of weights, at most.
    pub(super) most_parts: usize,
    pub(super) used_rgb: Buffer,
    pub(super) used_density: Buffer,
}

impl Scratch {
    /// Bytes of a sample.
    pub(crate) fn bytes_per_sample(shape: &Shape, form: Form) -> usize {
        let numbers = 3 * 4 + 1 + 2 * shape.channels + shape.width + 2 * (shape.width + 4) + shape.view_channels + 42;
        let trunks = if form.trunk_rows.is_some() { 2 } else { 1 };
        let hidden = (trunks * shape.trunk.len() + 3) * shape.width + shape.view.len() * shape.view_width;
        4 * numbers + form.of_hidden * hidden
    }

    /// Makes the buffers of so many rays.
    pub(crate) fn new(gpu: &Gpu, shape: &Shape, rays: usize, samples: usize, form: Form) -> Scratch {
        let Form { of_hidden, trunk_rows, trains, .. } = form;
        // Eight rows are a point with its derivatives and its Laplacian.
        let n = (rays * samples).max(8);
        let f = |numbers: usize| gpu.numbers(numbers);
        let back = |numbers: usize| gpu.numbers(if trains { numbers } else { 1 });
        let most_parts = most_parts(gpu, shape.weights());
        let of_variances = if shape.is_integrated { 3 * n } else { 1 };
        let hidden = |width: usize| f(of_hidden * n * width / 4);
        let hidden_back = |width: usize| back(of_hidden * n * width / 4);
        let (layers, in_one) = (shape.trunk.len(), trunk_rows.is_some());
        let of_layer = of_hidden * n * shape.width;
        let of_gradient = if trains { of_hidden * n * shape.width.max(shape.view_width) } else { 1 };
        let d_hidden = Layers::new(gpu, 2, of_gradient, false);
        let d_trunk = if in_one { Layers::new(gpu, layers, of_layer, true) } else { d_hidden.clone() };
        Scratch {
            points: f(3 * n),
            variances: f(of_variances),
            unit: f(3 * n),
            inside: f(n),
            encoded: f(n * shape.channels),
            trunk: Layers::new(gpu, layers, of_layer, in_one),
            moved: hidden_back(shape.width),
            head: f(n * (shape.width + 4)),
            view: shape.view.iter().map(|_| hidden(shape.view_width)).collect(),
            raw: f(4 * n),
            values: f(4 * n),
            density: f(n),
            weights: f(n),
            before: back(n),
            d_values: back(4 * n),
            d_raw: back(4 * n),
            d_head: back(n * (shape.width + 4)),
            live: back(n + 1),
            live_counts: back(n.div_ceil(LIVE_GROUP)),
            d_hidden,
            d_trunk,
            d_encoded: back(n * shape.channels),
            d_feature: back(n * shape.width),
            d_view: back(n * shape.view_channels),
            d_points: back(3 * n),
            d_variances: back(of_variances),
            d_t: back(rays * (samples + 1)),
            d_tilt: back(2 * rays),
            t_moved: back(rays * (samples + 1)),
            view_encoded: f(rays * shape.view_channels),
            parts: back(parts_of(n, most_parts) * shape.weights()),
            most_parts,
            used_rgb: back(3 * n),
            used_density: back(n),
        }
    }
}
