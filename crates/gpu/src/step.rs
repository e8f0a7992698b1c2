//! Training steps of fields on the device.

use augnerf_base::Result;
use augnerf_nerf::methods::{
    Batches, DeviceSteps, Fields, LogColumns, Plan, StepAt, StepReport, is_regularized, log_columns, not_finite,
};
use augnerf_nerf::optimizer::Moments;
use augnerf_nerf::perturb::PaperSite;
use augnerf_nerf::settings::{Precision, Regularizer, Resolved};
use augnerf_scenes::{RayParts, Scene};
use candle_core::Tensor;
use wgpu::Buffer;

use crate::device::{Dispatch, Gpu, groups, rows};
use crate::kernels::Kernel;
use crate::limits::{check_on, rays_of_chunk};
use crate::network::{FieldBuffers, Learned, Shape};
use crate::params::{Layout, layouts};
use crate::rays::{bins, of_batch};
use crate::record::{FIXED_SCALE, Integrand, Recorder, SpaceAt};
use crate::sets::PassSets;

use self::buffers::StepBuffers;
use self::chunk::ChunkRecorder;
use self::results::{COUNTS, DIAGNOSED, Left, SPACE, alone, first_of, no_flags, shift_of, slot};

mod buffers;
mod chunk;
mod results;
#[cfg(test)]
mod tests;

const BETA1: f64 = 0.9;
/// A limit that no gradient reaches.
const NO_LIMIT: f64 = 3e38;
/// Numbers whose squares a group adds.
const OF_NORM: usize = 4096;

/// Steps whose reports the device keeps.
pub(crate) const MOST_REPORTS: usize = 16;

/// A run's parameters and the recorded work of its steps.
pub struct Steps {
    gpu: Gpu,
    config: Resolved,
    plan: Plan,
    scene_bounds: (f64, f64),
    background: Option<[f32; 3]>,
    has_cylinders: bool,
    fields: Fields,
    shape: Shape,
    batches: Batches,
    /// In the order of [`Fields::by_role`].
    learned: Vec<FieldBuffers>,
    /// The same as passes read them: while the encodings open, with weights of their own.
    opened: Vec<FieldBuffers>,
    /// What these weights are multiplied by, and the share of the opening that it is for.
    opening: Option<(Buffer, f64)>,
    roles: Vec<&'static str>,
    sets: [Option<PassSets>; 2],
    buffers: StepBuffers,
    /// The struct of what changes from step to step.
    now: Layout,
    /// The work of a step, and that of a step with diagnostics.
    plain: Vec<Dispatch>,
    logged: Option<Vec<Dispatch>>,
    update: Vec<Dispatch>,
    /// Steps whose reports are on the device, and whether they were diagnosed.
    waiting: Vec<(u64, bool)>,
    /// The weights that these steps have. Others are recorded anew.
    weights: LossWeights,
    /// Reports that were read and not asked for.
    reports: Vec<StepReport>,
}

impl Steps {
    /// Copies fields and their moments to the device.
    ///
    /// # Errors
    /// [`Error::Config`](augnerf_base::Error::Config): the device does not do what the configuration asks for, or has
    /// too little memory.
    pub fn new(
        gpu: &Gpu,
        config: &Resolved,
        scene: &Scene,
        fields: &Fields,
        moments: Option<&[Moments]>,
    ) -> Result<Steps> {
        check_on(gpu, config)?;
        let shape = Shape::of(&config.field);
        let footprint = config.field.encoding.queries_gaussians();
        let parts = RayParts { tangents: has_tangents(config), footprint };
        let batches = Batches::new(config, scene, parts)?;
        let (learned, opened, opening) = gpu.checked("copying the parameters", || -> Result<_> {
            let learned = copied(gpu, &shape, fields, moments)?;
            let opening = (config.field.frequency_steps > 0).then(|| (gpu.numbers(shape.weights()), f64::NAN));
            let of_passes = |field: &FieldBuffers| match opening {
                Some(_) => field.with_own_weights(gpu),
                None => field.clone(),
            };
            let of_passes = |field: &FieldBuffers| FieldBuffers {
                halves: is_f16(config).then(|| gpu.numbers(shape.weights() / 2)),
                ..of_passes(field)
            };
            let opened = learned.iter().map(of_passes).collect();
            Ok((learned, opened, opening))
        })??;
        let plan = Plan::of(config);
        let mut sets: [Option<PassSets>; 2] = [None, None];
        for pass in &plan.second {
            if let Some(delta_plan) = &pass.deltas {
                sets[slot(pass, false)] = Some(PassSets::new(config, scene, pass, delta_plan)?);
            }
        }
        let (coarse, fine) = config.samples();
        let chunk = rays_of_chunk(gpu, config, &shape, coarse.max(fine))?;
        let buffers = gpu
            .checked("making the buffers of a step", || StepBuffers::new(gpu, config, scene, &shape, &sets, chunk))??;
        let mut steps = Steps {
            gpu: gpu.clone(),
            config: config.clone(),
            scene_bounds: scene.bounds(),
            background: scene.background,
            has_cylinders: scene.ndc.is_some(),
            fields: fields.clone(),
            shape,
            batches,
            learned,
            opened,
            opening,
            roles: fields.by_role().map(|(role, _)| role).collect(),
            sets,
            buffers,
            now: layouts(&Kernel::new("adam_weights").text()).remove(&1).expect("it reads them"),
            plain: Vec::new(),
            logged: None,
            update: Vec::new(),
            waiting: Vec::new(),
            weights: LossWeights::at(config, &plan, 0),
            plan,
            reports: Vec::new(),
        };
        gpu.write(&steps.buffers.flags, bytemuck::cast_slice(&no_flags()));
        steps.plain = gpu.checked("compiling the kernels", || steps.record(false))?;
        steps.update = gpu.checked("compiling Adam", || steps.record_update())?;
        Ok(steps)
    }

    /// Returns the number of dispatches of a step, for tests.
    #[doc(hidden)]
    pub fn dispatches(&self) -> usize {
        self.plain.len() + self.update.len()
    }

    fn wait_for_reports(&mut self) -> Result<()> {
        if self.waiting.is_empty() {
            return Ok(());
        }
        let kept = &self.buffers.kept[..self.waiting.len()];
        let read = self.gpu.read(&kept.iter().collect::<Vec<&Buffer>>())?;
        for ((step, diagnosed), bytes) in std::mem::take(&mut self.waiting).into_iter().zip(read) {
            let left = Left::of(&bytes, diagnosed);
            let report = self.report(&left, step);
            if let Some(what) = self.broken(&report, &left.flags) {
                return Err(not_finite(step + 1, &what, self.config.train.learning_rate));
            }
            self.reports.push(report);
        }
        Ok(())
    }

    fn compute(&mut self, step: u64, updates: u64, rate: f64, log: bool, moves: bool) -> Result<()> {
        self.send(step, updates, rate)?;
        let gpu = self.gpu.clone();
        let weights = LossWeights::at(&self.config, &self.plan, step);
        if weights != self.weights {
            (self.weights, self.logged) = (weights, None);
            self.plain = gpu.checked("compiling the kernels", || self.record(false))?;
        }
        let diagnoses = log && self.sets.iter().any(Option::is_some);
        if diagnoses && self.logged.is_none() {
            self.logged = Some(gpu.checked("compiling the kernels", || self.record(true))?);
        }
        if diagnoses {
            gpu.write(&self.buffers.counts, bytemuck::cast_slice(&[0u32; COUNTS]));
        }
        let work = self.logged.as_ref().filter(|_| diagnoses).unwrap_or(&self.plain);
        let update: &[Dispatch] = if moves { &self.update } else { &[] };
        gpu.submit(work.iter().chain(update));
        let StepBuffers { results, flags, counts, kept, .. } = &self.buffers;
        gpu.copy(&[results, flags, counts], &kept[self.waiting.len()]);
        self.waiting.push((step, diagnoses));
        Ok(())
    }

    fn clear_gradients(&self) {
        for field in &self.learned {
            for learned in field.learned() {
                self.gpu.clear(&learned.gradient);
            }
        }
    }

    /// Sends the step's numbers, its rays, and its points in space.
    fn send(&mut self, step: u64, updates: u64, learning_rate: f64) -> Result<()> {
        let train = &self.config.train;
        let [correction1, correction2] = [BETA1, train.adam_beta2].map(|beta| 1.0 - beta.powf(updates as f64));
        let halves = |value: u64| [value as u32, (value >> 32) as u32].map(|half| half as usize);
        let rate = learning_rate / correction1;
        let now = params! { seed: halves(self.config.seed), step: halves(step), rate, correction2, learning_rate };
        let rays = of_batch(&self.batches.batch(step), has_tangents(&self.config));
        self.gpu.write(&self.buffers.now, bytemuck::cast_slice(&self.now.words("adam_weights", &now)));
        self.gpu.write(&self.buffers.rays, bytemuck::cast_slice(&rays));
        if let Some(space) = &self.buffers.space {
            space.send(&self.gpu, &self.config, step)?;
        }
        self.send_bins(step);
        self.send_opening(step)
    }

    /// Sends the bins of samples that spread.
    fn send_bins(&self, step: u64) {
        let sampling = &self.config.sampling;
        if sampling.anneal_steps == 0 || step > sampling.anneal_steps {
            return;
        }
        let columns = self.config.field.encoding.t_vals(sampling.coarse);
        let bins = bins(sampling.spacing, sampling.annealed(self.scene_bounds, step), columns, sampling.jitter);
        self.gpu.write(&self.buffers.rows, bytemuck::cast_slice(&bins));
    }

    /// Sends the factors of an opening if they changed.
    fn send_opening(&mut self, step: u64) -> Result<()> {
        let Some((factors, known)) = &mut self.opening else { return Ok(()) };
        let field = &self.config.field;
        let share = step.min(field.frequency_steps) as f64 / field.frequency_steps as f64;
        if share != *known {
            *known = share;
            self.gpu.write(factors, bytemuck::cast_slice(&self.shape.opening(field, share)?));
        }
        Ok(())
    }

    /// Computes a step without an update, and returns its gradients in the host's order, for tests.
    #[doc(hidden)]
    pub fn gradients(&mut self, step: u64) -> Result<(StepReport, Vec<Tensor>)> {
        self.wait_for_reports()?;
        self.compute(step, 1, 0.0, false, false)?;
        self.wait_for_reports()?;
        let report = self.reports.pop().expect("the step that was waited for");
        let mut gradients = Vec::new();
        for learned in &self.learned {
            gradients.extend(learned.gradients(&self.gpu, &self.shape, loss_scale(&self.config))?);
        }
        self.clear_gradients();
        Ok((report, gradients))
    }
}

impl DeviceSteps for Steps {
    fn columns(&self) -> LogColumns {
        log_columns(&self.config, &self.plan, self.config.regularizer.terms().map(|(term, _)| term.name()))
    }

    fn step(&mut self, StepAt { step, updates, learning_rate, log }: StepAt) -> Result<()> {
        if self.waiting.len() == MOST_REPORTS {
            self.wait_for_reports()?;
        }
        self.compute(step, updates, learning_rate, log, true)
    }

    fn reports(&mut self) -> Result<Vec<StepReport>> {
        self.wait_for_reports()?;
        Ok(std::mem::take(&mut self.reports))
    }

    fn most_reports(&self) -> usize {
        MOST_REPORTS
    }

    fn fetch(&mut self) -> Result<Vec<Moments>> {
        let mut moments = Vec::new();
        for (learned, (_, field)) in self.learned.iter().zip(self.fields.by_role()) {
            let [values, first, second] = learned.read(&self.gpu, &self.shape)?;
            for ((_, var), value) in field.variables().iter().zip(values) {
                var.set(&value)?;
            }
            moments.extend(first.into_iter().zip(second).map(|(first, second)| Moments { first, second }));
        }
        Ok(moments)
    }
}

impl Steps {
    fn recorder(&self) -> Recorder<'_> {
        let StepBuffers { scratch, rays, flags, .. } = &self.buffers;
        Recorder {
            bounds: self.scene_bounds,
            background: self.background,
            has_cylinders: self.has_cylinders,
            tiles: self.gpu.tiles(self.config.field.precision),
            form: self.buffers.form,
            loss_scale: loss_scale(&self.config),
            ..Recorder::new(&self.gpu, &self.shape, &self.config.field, scratch, rays, flags)
        }
    }

    fn field(&self, role: &str) -> &FieldBuffers {
        let index = self.roles.iter().position(|known| *known == role).expect("the plan names fields that there are");
        &self.opened[index]
    }

    /// Records the work of a step up to its gradients.
    fn record(&self, log: bool) -> Vec<Dispatch> {
        let mut recorder = self.recorder();
        let (rays, chunk) = (self.config.train.rays, self.buffers.chunk);
        self.record_opening(&mut recorder, true);
        for field in &self.opened {
            let Some(halves) = &field.halves else { continue };
            let (weights, params) = (&field.weights, params! { numbers: field.weights.count });
            recorder.run(Kernel::new("halve"), params, &[(1, &weights.values), (2, halves)], groups(weights.count / 4));
        }
        for ray0 in (0..rays).step_by(chunk) {
            let count = chunk.min(rays - ray0);
            ChunkRecorder { steps: self, ray0, rays: count, log }.record(&mut recorder);
        }
        self.record_space(&mut recorder);
        self.record_opening(&mut recorder, false);
        for slot in self.slots(log) {
            recorder.sums(rays, &self.buffers.outs[slot], slot, &self.buffers.results);
        }
        if log {
            self.record_shifts(&mut recorder);
        }
        recorder.dispatches
    }

    /// Records what the opening of the encodings multiplies: before passes the weights that they read, and after them their
    /// gradients.
    fn record_opening(&self, recorder: &mut Recorder, before: bool) {
        let Some((factors, _)) = &self.opening else { return };
        for (learned, opened) in self.learned.iter().zip(&self.opened) {
            let [learned, opened] = [&learned.weights, &opened.weights];
            let to = if before { &opened.values } else { &learned.gradient };
            let mut buffers = vec![(1, factors), (2, to)];
            buffers.extend(before.then_some((3, &learned.values)));
            let params = params! { numbers: learned.count };
            recorder.run(Kernel::new("multiply").with("FROM", before), params, &buffers, groups(learned.count));
        }
    }

    /// Index and buffers of the fields in which terms in space count.
    fn regularized(&self) -> impl Iterator<Item = (usize, &FieldBuffers)> {
        let counts = |role: &str| is_regularized(&self.config.regularizer, &self.roles, role);
        self.opened.iter().enumerate().filter(move |(index, _)| counts(self.roles[*index]))
    }

    /// Records the terms in space.
    fn record_space<'a>(&'a self, recorder: &mut Recorder<'a>) {
        let Some(space) = &self.buffers.space else { return };
        let volume = space.volume_each;
        let weight_of = |term: Regularizer| volume * self.weights.of_term(term);
        let [l1, tv, laplacian] = [Regularizer::L1, Regularizer::Tv, Regularizer::Laplacian].map(weight_of);
        let integrand = Integrand { l1, tv, laplacian };
        for (index, field) in self.regularized() {
            for (part, (points, count)) in space.parts.iter().enumerate() {
                let at = SpaceAt { field, points, count: *count, order: space.order, out: &space.at };
                recorder.space(&at);
                recorder.space_back(&at, integrand);
                recorder.integrals(&at, part == 0, volume, SPACE + index, &self.buffers.results);
            }
        }
    }

    fn record_shifts(&self, recorder: &mut Recorder) {
        let outs = &self.buffers.outs;
        for (pass, sets) in self.sets.iter().enumerate() {
            let first = first_of(pass);
            for site in sets.iter().flat_map(PassSets::sites) {
                let params = params! { rays: self.config.train.rays, slot: shift_of(first, site) };
                let buffers = [(1, &outs[first]), (2, &outs[alone(first, site)]), (3, &self.buffers.results)];
                recorder.run(Kernel::new("shift"), params, &buffers, [1, 1, 1]);
            }
        }
    }

    /// Records the check of what is finite, and Adam's update of all fields.
    fn record_update(&self) -> Vec<Dispatch> {
        let mut recorder = self.recorder();
        let train = &self.config.train;
        for (index, field) in self.learned.iter().enumerate() {
            let weights = &field.weights;
            let params = params! { numbers: weights.count, slots: DIAGNOSED, field: 2 * index };
            let buffers = [(1, &weights.gradient), (2, &self.buffers.results), (3, &self.buffers.flags)];
            recorder.run(Kernel::new("check"), params, &buffers, groups(weights.count));
        }
        let limit = if train.clip_value > 0.0 { train.clip_value } else { NO_LIMIT };
        let unit_of = |part: usize| 1.0 / if part == 0 { loss_scale(&self.config) } else { FIXED_SCALE };
        let factor = (train.clip_norm > 0.0).then(|| self.record_norm(&mut recorder, limit, unit_of));
        let decays = (train.weight_decay > 0.0).then(|| self.gpu.storage(&self.shape.decays()));
        for (index, field) in self.learned.iter().enumerate() {
            for (part, learned) in field.learned().enumerate() {
                let (numbers, beta2, epsilon) = (learned.count, train.adam_beta2, train.adam_epsilon);
                let params = params! { numbers, beta1: BETA1, beta2, epsilon, unit: unit_of(part) };
                let params = params.and(params! { field: 2 * index + part, limit, decay: train.weight_decay });
                let features = self.shape.grid.as_ref().map_or(1, |grid| grid.features());
                let (kernel, threads) = match part {
                    0 => (Kernel::new("adam_weights").with("DECAY", decays.is_some()), learned.count),
                    _ => (Kernel::new("adam_tables").set("FEATURES", features), learned.count / features),
                };
                let mut buffers = vec![
                    (1, &self.buffers.now),
                    (2, &learned.values),
                    (3, &learned.first),
                    (4, &learned.second),
                    (5, &self.buffers.flags),
                    (6, &learned.gradient),
                ];
                buffers.extend(factor.as_ref().map(|factor| (7, factor)));
                buffers.extend(decays.as_ref().filter(|_| part == 0).map(|decays| (8, decays)));
                recorder.run(kernel.with("NORM", factor.is_some()), params, &buffers, groups(threads));
            }
        }
        recorder.dispatches
    }

    /// Records the norm of all gradients, and returns the factor that limits it.
    fn record_norm(&self, recorder: &mut Recorder, limit: f64, unit_of: impl Fn(usize) -> f64) -> Buffer {
        let all = || self.learned.iter().flat_map(|field| field.learned().enumerate());
        let groups_of = |learned: &Learned| learned.count.div_ceil(OF_NORM);
        let count = all().map(|(_, learned)| groups_of(learned)).sum();
        let (sums, factor) = (self.gpu.numbers(count), self.gpu.numbers(1));
        let mut first = 0;
        for (part, learned) in all() {
            let params = params! { numbers: learned.count, first, unit: unit_of(part), limit };
            let kernel = Kernel::new("norm").with("TABLES", part == 1);
            recorder.run(kernel, params, &[(1, &learned.gradient), (2, &sums)], rows(groups_of(learned)));
            first += groups_of(learned);
        }
        let params = params! { sums: count, norm: self.config.train.clip_norm };
        recorder.run(Kernel::new("norm_factor"), params, &[(1, &sums), (2, &factor)], [1, 1, 1]);
        factor
    }
}

/// The weights of a step's losses.
#[derive(Clone, PartialEq)]
struct LossWeights {
    /// Factors of the photometric losses of the clean and of the second passes.
    passes: (f64, f64),
    terms: Vec<(Regularizer, f64)>,
}

impl LossWeights {
    fn at(config: &Resolved, plan: &Plan, step: u64) -> LossWeights {
        LossWeights { passes: plan.loss_weights(step), terms: config.regularizer.terms_at(step) }
    }

    fn has(&self, wanted: Regularizer) -> bool {
        self.terms.iter().any(|(term, _)| *term == wanted)
    }

    fn of_term(&self, wanted: Regularizer) -> f64 {
        self.terms.iter().filter(|(term, _)| *term == wanted).map(|(_, weight)| weight).sum()
    }
}

/// Returns the factor of gradients. In f16 typical ones of a ray's colours are then near 1.
fn loss_scale(config: &Resolved) -> f64 {
    if is_f16(config) { ((64 * 3 * config.train.rays) as f64).log2().round().exp2() } else { 1.0 }
}

fn is_f16(config: &Resolved) -> bool {
    config.field.precision == Precision::F16
}

/// Whether view directions are tilted.
fn has_tangents(config: &Resolved) -> bool {
    config.method.is_augmented() && config.perturb[PaperSite::View].on()
}

/// Copies the parameters of fields, with their moments, to the device.
fn copied(gpu: &Gpu, shape: &Shape, fields: &Fields, moments: Option<&[Moments]>) -> Result<Vec<FieldBuffers>> {
    let mut start = 0;
    let mut learned = Vec::new();
    for (_, field) in fields.by_role() {
        let values: Vec<Tensor> = field.variables().iter().map(|(_, var)| var.as_detached_tensor()).collect();
        let part = start..start + values.len();
        start = part.end;
        let of_field = moments.map(|moments| {
            let of = |which: fn(&Moments) -> &Tensor| moments[part.clone()].iter().map(|m| which(m).clone()).collect();
            [of(|moments| &moments.first), of(|moments| &moments.second)]
        });
        learned.push(FieldBuffers::new(gpu, shape, &values, of_field)?);
    }
    Ok(learned)
}
