//! The buffers of a step.

use augnerf_base::Result;
use augnerf_nerf::field::Order;
use augnerf_nerf::settings::{LatticePoints, Regularizer, Resolved};
use augnerf_nerf::space::Quadrature;
use augnerf_scenes::Scene;
use candle_core::{DType, Device};
use wgpu::Buffer;

use crate::device::Gpu;
use crate::network::Shape;
use crate::rays::{RAY, bins};
use crate::record::{Form, OUT, SLOT, Scratch};
use crate::sets::{PassSets, SetBuffers, numbers_to_draw};

use super::MOST_REPORTS;
use super::results::{COUNTS, DIAGNOSED, FLAGS, LEFT, SLOTS};

pub(super) struct StepBuffers {
    pub(super) now: Buffer,
    pub(super) rays: Buffer,
    pub(super) rows: Buffer,
    pub(super) jitter: Buffer,
    pub(super) noise: Buffer,
    pub(super) u: Buffer,
    pub(super) numbers: Buffer,
    pub(super) t_coarse: Buffer,
    pub(super) t_fine: Buffer,
    pub(super) t_second: Buffer,
    pub(super) outs: Vec<Buffer>,
    pub(super) results: Buffer,
    pub(super) flags: Buffer,
    pub(super) counts: Buffer,
    /// What each of the last steps left: results, flags and counts.
    pub(super) kept: Vec<Buffer>,
    pub(super) scratch: Scratch,
    pub(super) form: Form,
    pub(super) sets: [Option<SetBuffers>; 2],
    pub(super) space: Option<SpaceBuffers>,
    /// Rays of a chunk.
    pub(super) chunk: usize,
}

impl StepBuffers {
    pub(super) fn new(
        gpu: &Gpu,
        config: &Resolved,
        scene: &Scene,
        shape: &Shape,
        sets: &[Option<PassSets>; 2],
        chunk: usize,
    ) -> Result<StepBuffers> {
        let rays = config.train.rays;
        let (coarse, fine) = config.samples();
        let samples = coarse.max(fine);
        let encoding = config.field.encoding;
        let columns = encoding.t_vals(coarse);
        let fine_columns = encoding.t_vals(config.sampling.fine);
        let numbers = sets
            .iter()
            .flatten()
            .map(|sets| numbers_to_draw(sets, chunk, config.train.chunk.min(config.train.rays)))
            .max();
        let form = Form::of_steps(gpu, config, shape);
        let f = |count: usize| gpu.numbers(count);
        let t_vals = || f(chunk * (samples + 1));
        let pair = |i: usize| sets[i].as_ref().map(|sets| SetBuffers::new(gpu, sets, chunk));
        // Passes that a run has.
        let used = if config.method.is_augmented() { SLOTS } else { DIAGNOSED };
        Ok(StepBuffers {
            now: gpu.uniform(&[0; 8]),
            rays: f(rays * RAY),
            rows: gpu.storage(&bins(config.sampling.spacing, scene.bounds(), columns, config.sampling.jitter)),
            jitter: f(chunk * columns),
            noise: f(chunk * samples + 2),
            u: f(chunk * fine_columns),
            numbers: f(numbers.unwrap_or(1)),
            t_coarse: t_vals(),
            t_fine: t_vals(),
            t_second: t_vals(),
            outs: (0..SLOTS).map(|slot| f(if slot < used { rays * OUT } else { 1 })).collect(),
            results: f(SLOTS * SLOT),
            flags: f(FLAGS),
            counts: f(COUNTS),
            kept: (0..MOST_REPORTS).map(|_| f(LEFT)).collect(),
            scratch: Scratch::new(gpu, shape, chunk, samples, form),
            form,
            sets: [pair(0), pair(1)],
            space: SpaceBuffers::new(gpu, config, chunk * samples)?,
            chunk,
        })
    }
}

/// The points of the terms in space.
pub(super) struct SpaceBuffers {
    /// Points that are queried at once, and their number.
    pub(super) parts: Vec<(Buffer, usize)>,
    /// Density and its derivatives at a part of them.
    pub(super) at: Buffer,
    pub(super) order: Order,
    /// The volume that a point stands for.
    pub(super) volume_each: f64,
}

impl SpaceBuffers {
    /// Makes the buffers for terms whose points are queried through so many rows of samples. `None` without such terms.
    fn new(gpu: &Gpu, config: &Resolved, rows: usize) -> Result<Option<SpaceBuffers>> {
        if !config.regularizer.has_space_terms() {
            return Ok(None);
        }
        let order_of = |(term, _)| match term {
            Regularizer::Laplacian => Order::Laplacian,
            Regularizer::Tv => Order::Gradient,
            _ => Order::Density,
        };
        let order = config.regularizer.terms().map(order_of).max().unwrap_or(Order::Density);
        let (rows_each, numbers_each) = match order {
            Order::Density => (1, 4),
            Order::Gradient => (4, 4),
            Order::Laplacian => (8, 8),
        };
        let points = config.regularizer.quadrature(config.seed, 0);
        let most = (rows / rows_each).max(1);
        let part = |first: usize| {
            let count = most.min(points.count() - first);
            (gpu.numbers(3 * count), count)
        };
        let space = SpaceBuffers {
            parts: (0..points.count()).step_by(most).map(part).collect(),
            at: gpu.numbers(numbers_each * most.min(points.count())),
            order,
            volume_each: points.volume_each(),
        };
        space.write(gpu, &points)?;
        Ok(Some(space))
    }

    fn write(&self, gpu: &Gpu, points: &Quadrature) -> Result<()> {
        let mut first = 0;
        for (buffer, count) in &self.parts {
            let values = points.tensor(first, *count, DType::F32, &Device::Cpu)?.flatten_all()?.to_vec1::<f32>()?;
            gpu.write(buffer, bytemuck::cast_slice(&values));
            first += count;
        }
        Ok(())
    }

    /// Sends the points of a step. Midpoints of all cells are there already.
    pub(super) fn send(&self, gpu: &Gpu, config: &Resolved, step: u64) -> Result<()> {
        if config.regularizer.points == LatticePoints::Full {
            return Ok(());
        }
        self.write(gpu, &config.regularizer.quadrature(config.seed, step))
    }
}
