//! Rendering of rays on the device.

use std::sync::{Mutex, PoisonError};

use augnerf_base::{Error, Result};
use augnerf_nerf::methods::{Fields, RenderedRays, Renderer};
use augnerf_nerf::render::ray_parts;
use augnerf_nerf::settings::Config;
use augnerf_scenes::{RayParts, Rays, Scene};
use candle_core::{DType, Device, Tensor};
use wgpu::Buffer;

use crate::device::{Dispatch, Gpu, groups};
use crate::kernels::Kernel;
use crate::limits::{check_buffers, check_fields, samples_at_once};
use crate::network::{FieldBuffers, Shape};
use crate::rays::{RAY, bins, packed};
use crate::record::{DeltaBuffers, Form, OUT, PassAt, Recorder, Resampling, Scratch};

/// Rays that are rendered at once, at most.
const MOST_RAYS: usize = 2048;
/// The same on a processor that plays a device.
const MOST_RAYS_IN_SOFTWARE: usize = 512;

/// Renders rays through the coarse and the fine field, without randomness.
pub struct GpuRenderer {
    gpu: Gpu,
    rays: Buffer,
    out: Buffer,
    work: Vec<Dispatch>,
    parts: RayParts,
    chunk: usize,
    /// One thread at a time has the buffers.
    turn: Mutex<()>,
}

impl GpuRenderer {
    /// Copies the current weights of fields to the device.
    ///
    /// # Errors
    /// The device has too little memory.
    pub fn new(gpu: &Gpu, fields: &Fields, config: &Config, scene: &Scene) -> Result<GpuRenderer> {
        check_fields(config)?;
        let shape = Shape::of(&config.field);
        check_buffers(gpu, &config.field, &shape)?;
        let (coarse, fine) = config.samples();
        let samples = coarse.max(fine);
        let most = if gpu.adapter().is_software { MOST_RAYS_IN_SOFTWARE } else { MOST_RAYS };
        let fits = samples_at_once(gpu, &shape, Form::RENDERING, 0);
        let chunk = (fits / samples).clamp(1, most);
        gpu.checked("making a renderer", || GpuRenderer::record(gpu, fields, config, scene, &shape, chunk))?
    }

    fn record(
        gpu: &Gpu,
        fields: &Fields,
        config: &Config,
        scene: &Scene,
        shape: &Shape,
        chunk: usize,
    ) -> Result<GpuRenderer> {
        let coarse_field = FieldBuffers::of(gpu, shape, fields.coarse())?;
        let fine_field = fields.get("fine").map(|field| FieldBuffers::of(gpu, shape, field)).transpose()?;
        let (encoding, (coarse, fine)) = (config.field.encoding, config.samples());
        let (columns, samples) = (encoding.t_vals(coarse), coarse.max(fine));
        let scratch = Scratch::new(gpu, shape, chunk, samples, Form::RENDERING);
        let [rays, out, jitter, flags] = [RAY * chunk, OUT * chunk, chunk * columns, 1].map(|count| gpu.numbers(count));
        let [t_coarse, t_fine] = [(); 2].map(|()| gpu.numbers(chunk * (samples + 1)));
        let rows = gpu.storage(&bins(config.sampling.spacing, scene.bounds(), columns, false));
        let mut recorder = Recorder {
            bounds: scene.bounds(),
            background: scene.background,
            has_cylinders: scene.ndc.is_some(),
            ..Recorder::new(gpu, shape, &config.field, &scratch, &rays, &flags)
        };
        let params = params! { rays: chunk, columns };
        let buffers = [(1, &rows), (2, &jitter), (3, &t_coarse)];
        recorder.run(Kernel::new("sample"), params, &buffers, groups(chunk * columns));
        let deltas = DeltaBuffers::default();
        let field = &coarse_field;
        let pass = PassAt {
            field,
            ray0: 0,
            rays: chunk,
            samples: coarse,
            columns,
            t_vals: &t_coarse,
            noise: None,
            deltas,
            out: &out,
        };
        if config.sampling.fine == 0 {
            recorder.forward(&pass, None);
        } else {
            recorder.place_by_density(&pass);
            let at = Resampling {
                rays: chunk,
                coarse,
                columns,
                fine: encoding.t_vals(config.sampling.fine),
                intervals: encoding.at_intervals(),
                padding: config.sampling.resample_padding,
                mode: 2,
            };
            recorder.resample(at, &t_coarse, &jitter, &t_fine);
            let field = fine_field.as_ref().unwrap_or(&coarse_field);
            let fine = PassAt { field, samples: fine, columns: encoding.t_vals(fine), t_vals: &t_fine, ..pass };
            recorder.forward(&fine, None);
        }
        let work = recorder.dispatches;
        let parts = ray_parts(fields.coarse());
        Ok(GpuRenderer { gpu: gpu.clone(), rays, out, work, parts, chunk, turn: Mutex::default() })
    }

    /// Renders at most a chunk of rays: their colours, depths and accumulations, `OUT` numbers each.
    fn render_chunk(&self, packed: &[f32]) -> Result<Vec<f32>> {
        let _turn = self.turn.lock().unwrap_or_else(PoisonError::into_inner);
        self.gpu.write(&self.rays, bytemuck::cast_slice(packed));
        self.gpu.submit(&self.work);
        self.gpu.read_f32(&self.out, packed.len() / RAY * OUT)
    }
}

impl Renderer for GpuRenderer {
    fn chunk(&self) -> Option<usize> {
        Some(self.chunk)
    }

    fn ray_parts(&self) -> RayParts {
        self.parts
    }

    fn render(&self, rays: &Rays) -> Result<RenderedRays> {
        let host = |tensor: &Tensor| tensor.to_dtype(DType::F32)?.flatten_all()?.to_vec1::<f32>();
        if self.parts.footprint && rays.footprint.is_none() {
            return Err(Error::Config("these rays have no footprint to cast".into()));
        }
        let radii = rays.footprint.as_ref().map(|footprint| host(&footprint.radii)).transpose()?;
        let [origins, directions, views] = [&rays.origins, &rays.directions, &rays.viewdirs].map(host);
        let packed = packed(&origins?, &directions?, &views?, &radii.unwrap_or_default());
        let mut out = Vec::with_capacity(rays.len() * OUT);
        for part in packed.chunks(self.chunk * RAY) {
            out.extend(self.render_chunk(part)?);
        }
        let column = |at: usize| out.chunks_exact(OUT).map(|ray| ray[at]).collect::<Vec<f32>>();
        let rgb: Vec<f32> = out.chunks_exact(OUT).flat_map(|ray| [ray[0], ray[1], ray[2]]).collect();
        Ok(RenderedRays {
            rgb: Tensor::from_vec(rgb, (rays.len(), 3), &Device::Cpu)?,
            depth: Tensor::from_vec(column(3), rays.len(), &Device::Cpu)?,
            acc: Tensor::from_vec(column(4), rays.len(), &Device::Cpu)?,
        })
    }
}
