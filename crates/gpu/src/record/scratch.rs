//! The buffers of samples.

use wgpu::Buffer;

use crate::device::Gpu;
use crate::network::Shape;

use super::products::{most_parts, parts_of};

/// Samples of which a group lists those with a gradient.
pub(super) const LIVE_GROUP: usize = 256;

/// Buffers of the samples of a chunk of rays, used by one pass after another.
pub(crate) struct Scratch {
    pub(super) points: Buffer,
    /// Of Gaussians.
    pub(super) variances: Buffer,
    pub(super) unit: Buffer,
    pub(super) inside: Buffer,
    pub(super) encoded: Buffer,
    pub(super) trunk: Vec<Buffer>,
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
    pub(super) d_hidden: [Buffer; 2],
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
    /// Bytes of a sample. `of_hidden` are those of a number that layers leave for each other.
    pub(crate) fn bytes_per_sample(shape: &Shape, of_hidden: usize) -> usize {
        let numbers = 3 * 4 + 1 + 2 * shape.channels + shape.width + 2 * (shape.width + 4) + shape.view_channels + 42;
        let hidden = (shape.trunk.len() + 3) * shape.width + shape.view.len() * shape.view_width;
        4 * numbers + of_hidden * hidden
    }

    /// Makes the buffers of so many rays, those of the way back if `trains`.
    pub(crate) fn new(
        gpu: &Gpu,
        shape: &Shape,
        rays: usize,
        samples: usize,
        of_hidden: usize,
        trains: bool,
    ) -> Scratch {
        // Eight rows are a point with its derivatives and its Laplacian.
        let n = (rays * samples).max(8);
        let f = |numbers: usize| gpu.numbers(numbers);
        let back = |numbers: usize| gpu.numbers(if trains { numbers } else { 1 });
        let most_parts = most_parts(gpu, shape.weights());
        let of_variances = if shape.is_integrated { 3 * n } else { 1 };
        let hidden = |width: usize| f(of_hidden * n * width / 4);
        let hidden_back = |width: usize| back(of_hidden * n * width / 4);
        let widest = shape.width.max(shape.view_width);
        Scratch {
            points: f(3 * n),
            variances: f(of_variances),
            unit: f(3 * n),
            inside: f(n),
            encoded: f(n * shape.channels),
            trunk: shape.trunk.iter().map(|_| hidden(shape.width)).collect(),
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
            d_hidden: [hidden_back(widest), hidden_back(widest)],
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
