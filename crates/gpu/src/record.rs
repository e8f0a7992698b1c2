//! Records the dispatches of passes through a field: forward, and back to what is asked for.

use augnerf_nerf::perturb::PaperSite;
use augnerf_nerf::settings::{DensityActivation, FieldConfig, Precision, Regularizer};
use wgpu::Buffer;

use crate::device::{Dispatch, Gpu, rows};
use crate::kernels::{Kernel, Tiles};
use crate::network::{FieldBuffers, Shape};
use crate::params::Params;

mod back;
mod encoding;
mod forward;
mod products;
mod scratch;
mod space;
mod trunk;

#[cfg(test)]
pub(crate) use encoding::{domain_params, grid_params};
pub(crate) use products::most_parts;
pub(crate) use scratch::{Form, Scratch};
pub(crate) use space::{Integrand, SpaceAt};

/// Numbers of a ray in a pass's output; `composite.wgsl` says which, and `sizes.wgsl` how many.
pub(crate) const OUT: usize = 12;

/// The terms on rays that the device has, with the parts of `composite.wgsl` that compute them, in the order of their
/// numbers in outputs and slots.
pub(crate) const ON_RAYS: [(Regularizer, &str); 5] = [
    (Regularizer::Distortion, "DISTORTION"),
    (Regularizer::Occlusion, "OCCLUSION"),
    (Regularizer::Entropy, "ENTROPY"),
    (Regularizer::Cauchy, "CAUCHY"),
    (Regularizer::OpacityPrior, "OPACITY_PRIOR"),
];

/// Numbers of a slot of results; `sizes.wgsl` says the same.
pub(crate) const SLOT: usize = 20;

/// The numbers of a slot of results before those of terms on rays; `loss.wgsl` says which they are.
pub(crate) const FIRST_TERM: usize = 14;

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
    pub(crate) fn only(self, site: PaperSite) -> DeltaBuffers<'a> {
        let none = DeltaBuffers { before: self.before, ..DeltaBuffers::default() };
        match site {
            PaperSite::T => DeltaBuffers { t: self.t, ..none },
            PaperSite::Xyz => DeltaBuffers { xyz: self.xyz, ..none },
            PaperSite::View => DeltaBuffers { view: self.view, ..none },
            PaperSite::Feature => DeltaBuffers { feature: self.feature, ..none },
            PaperSite::Rgb => DeltaBuffers { rgb: self.rgb, ..none },
            PaperSite::Density => DeltaBuffers { density: self.density, ..none },
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
    /// Noise on raw density.
    pub(crate) noise: Option<&'a Buffer>,
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
#[derive(Clone, Copy, Default)]
pub(crate) struct PassLoss {
    /// Weight of the squared error of one channel of one ray.
    pub(crate) weight: f64,
    /// Weights of the terms of one ray, as [`ON_RAYS`]. `None`: the term does not count.
    pub(crate) terms: [Option<f64>; ON_RAYS.len()],
    /// The share of near..far in which occlusion counts density.
    pub(crate) occlusion_share: f64,
}

/// Where a gradient of a delta is: buffer, numbers between two vectors, place of the first.
pub(crate) type GradientAt<'a> = (&'a Buffer, usize, usize);

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
    /// Rays are in NDC, where pixels have cylinders in place of cones.
    pub(crate) has_cylinders: bool,
    pub(crate) tiles: Tiles,
    pub(crate) form: Form,
    /// Tiles of derivatives, which are computed in f32.
    pub(crate) jet_tiles: Tiles,
    /// Factor of all gradients up to Adam, which keeps them in the range of f16.
    pub(crate) loss_scale: f64,
    pub(crate) dispatches: Vec<Dispatch>,
}

impl<'a> Recorder<'a> {
    /// Starts a record, in f32 until other tiles are set, of rays from 0 to 1 without a background.
    pub(crate) fn new(
        gpu: &'a Gpu,
        shape: &'a Shape,
        config: &FieldConfig,
        scratch: &'a Scratch,
        rays: &'a Buffer,
        flags: &'a Buffer,
    ) -> Recorder<'a> {
        let tiles = gpu.tiles(Precision::F32);
        Recorder {
            gpu,
            shape,
            outputs: Outputs::of(config),
            scratch,
            rays,
            flags,
            bounds: (0.0, 1.0),
            background: None,
            has_cylinders: false,
            tiles,
            form: Form::RENDERING,
            jet_tiles: tiles,
            loss_scale: 1.0,
            dispatches: Vec::new(),
        }
    }

    /// Records a kernel with parameters at binding 0.
    pub(crate) fn run(&mut self, kernel: Kernel, params: Params, buffers: &[(u32, &Buffer)], size: [u32; 3]) {
        self.dispatches.push(self.gpu.dispatch(&kernel, &params, buffers, size));
    }

    /// Records the sums over all rays of a pass.
    pub(crate) fn sums(&mut self, rays: usize, out: &Buffer, slot: usize, results: &Buffer) {
        let params = params! { rays, slot, numbers: FIRST_TERM + ON_RAYS.len() };
        self.run(Kernel::new("loss"), params, &[(1, self.rays), (2, out), (3, results)], [1, 1, 1]);
    }

    /// Records the inverse of the CDF of the weights that the last pass left.
    pub(crate) fn resample(&mut self, at: Resampling, t_vals: &Buffer, u: &Buffer, out: &Buffer) {
        let Resampling { rays, coarse, columns, fine, intervals, padding, mode } = at;
        let narrowest = if intervals { 0.0 } else { FLOOR };
        let padding = if intervals { padding } else { FLOOR };
        let params = params! { coarse, columns, fine, intervals, padding, narrowest, mode, rays };
        let most = (coarse + 1).max(if intervals { fine } else { coarse + fine }).next_power_of_two();
        let buffers = [(1, t_vals), (2, &self.scratch.weights), (3, u), (4, out)];
        self.run(Kernel::new("resample").set("MOST", most), params, &buffers, rows(rays));
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
