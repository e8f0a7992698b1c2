//! Density and colour at points in space, for surfaces and measurements.

use std::sync::{Mutex, PoisonError};

use augnerf_base::Result;
use augnerf_nerf::field::{Density, Field, Order};
use candle_core::{DType, Device, Tensor};
use wgpu::Buffer;

use crate::device::{Dispatch, Gpu};
use crate::limits::{check_buffers, check_density, samples_at_once};
use crate::network::{FieldBuffers, Shape};
use crate::rays::{RAY, packed};
use crate::record::{DeltaBuffers, Form, OUT, PassAt, Recorder, Scratch, SpaceAt};

/// Points that are queried at once, at most.
const MOST_POINTS: usize = 1 << 16;
/// The same on a processor that plays a device.
const MOST_POINTS_IN_SOFTWARE: usize = 1 << 12;

/// The density of a field with the weights that it had when this was made.
pub(crate) struct GpuDensity {
    gpu: Gpu,
    points: Buffer,
    rays: Buffer,
    /// Density and its gradient.
    at: Buffer,
    /// Colours, then density.
    values: Buffer,
    density: Vec<Dispatch>,
    /// Of a quarter of the points.
    gradient: Vec<Dispatch>,
    rgb: Vec<Dispatch>,
    chunk: usize,
    /// One thread at a time has the buffers.
    turn: Mutex<()>,
}

impl GpuDensity {
    /// Copies a field's weights to the device.
    ///
    /// # Errors
    /// The device does not render such a field, or has too little memory.
    pub(crate) fn new(gpu: &Gpu, field: &Field) -> Result<GpuDensity> {
        check_density(field.config())?;
        gpu.checked("making what queries density", || GpuDensity::record(gpu, field))?
    }

    fn record(gpu: &Gpu, field: &Field) -> Result<GpuDensity> {
        let shape = Shape::of(field.config());
        check_buffers(gpu, field.config(), &shape)?;
        let most = if gpu.adapter().is_software { MOST_POINTS_IN_SOFTWARE } else { MOST_POINTS };
        let chunk = samples_at_once(gpu, &shape, Form::RENDERING, 0).clamp(4, most) / 4 * 4;
        let field_buffers = FieldBuffers::of(gpu, &shape, field)?;
        let scratch = Scratch::new(gpu, &shape, chunk, 1, Form::RENDERING);
        let (points, rays, at) = (gpu.numbers(3 * chunk), gpu.numbers(RAY * chunk), gpu.numbers(4 * chunk));
        let (t_vals, out, flags) = (gpu.numbers(2 * chunk), gpu.numbers(OUT * chunk), gpu.numbers(1));
        let recorder = || Recorder::new(gpu, &shape, field.config(), &scratch, &rays, &flags);
        let space = |count: usize, order: Order| {
            let mut recorder = recorder();
            let points = &points;
            recorder.space(&SpaceAt { field: &field_buffers, points, count, order, out: &at });
            recorder.dispatches
        };
        let (density, gradient) = (space(chunk, Order::Density), space(chunk / 4, Order::Gradient));
        // A point is a sample at the start of a ray.
        let mut recorder = recorder();
        let pass = PassAt {
            field: &field_buffers,
            ray0: 0,
            rays: chunk,
            samples: 1,
            columns: 1,
            t_vals: &t_vals,
            noise: None,
            deltas: DeltaBuffers::default(),
            out: &out,
        };
        recorder.forward(&pass, None);
        let rgb = recorder.dispatches;
        let values = scratch.values.clone();
        let turn = Mutex::default();
        Ok(GpuDensity { gpu: gpu.clone(), points, rays, at, values, density, gradient, rgb, chunk, turn })
    }

    /// Runs recorded work on parts of inputs, `[points, width]`. Returns the four numbers of each point.
    fn query(
        &self,
        work: &[Dispatch],
        (to, from): (&Buffer, &Buffer),
        input: &[f32],
        width: usize,
        most: usize,
    ) -> Result<Vec<f32>> {
        let _turn = self.turn.lock().unwrap_or_else(PoisonError::into_inner);
        let mut found = Vec::with_capacity(4 * input.len() / width);
        for part in input.chunks(width * most) {
            self.gpu.write(to, bytemuck::cast_slice(part));
            self.gpu.submit(work);
            found.extend(self.gpu.read_f32(from, 4 * part.len() / width)?);
        }
        Ok(found)
    }
}

/// Returns the numbers of a tensor `[n, 3]`.
fn numbers(tensor: &Tensor) -> Result<Vec<f32>> {
    Ok(tensor.to_dtype(DType::F32)?.flatten_all()?.to_vec1()?)
}

impl Density for GpuDensity {
    fn density(&self, points: &Tensor, _variance: [f64; 3]) -> Result<Tensor> {
        let input = numbers(points)?;
        let found = self.query(&self.density, (&self.points, &self.at), &input, 3, self.chunk)?;
        let density: Vec<f32> = found.chunks_exact(4).map(|at| at[0]).collect();
        Ok(Tensor::from_vec(density, input.len() / 3, &Device::Cpu)?)
    }

    fn gradient(&self, points: &Tensor, _variance: [f64; 3]) -> Result<Tensor> {
        let input = numbers(points)?;
        let found = self.query(&self.gradient, (&self.points, &self.at), &input, 3, self.chunk / 4)?;
        let gradient: Vec<f32> = found.chunks_exact(4).flat_map(|at| [at[1], at[2], at[3]]).collect();
        Ok(Tensor::from_vec(gradient, (input.len() / 3, 3), &Device::Cpu)?)
    }

    fn rgb(&self, points: &Tensor, _variance: [f64; 3], viewdirs: &Tensor) -> Result<Tensor> {
        let (points, views) = (numbers(points)?, numbers(viewdirs)?);
        let rays = packed(&points, &vec![0.0; points.len()], &views, &[]);
        let found = self.query(&self.rgb, (&self.rays, &self.values), &rays, RAY, self.chunk)?;
        let rgb: Vec<f32> = found.chunks_exact(4).flat_map(|at| [at[0], at[1], at[2]]).collect();
        Ok(Tensor::from_vec(rgb, (points.len() / 3, 3), &Device::Cpu)?)
    }

    fn dtype(&self) -> DType {
        DType::F32
    }

    fn device(&self) -> &Device {
        &Device::Cpu
    }

    fn at_once(&self) -> Option<usize> {
        Some(self.chunk)
    }
}
