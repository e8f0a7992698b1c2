//! Training steps of NeRF and Aug-NeRF on the device.

use augnerf_core::augment::{Draw, Site};
use augnerf_core::base::rng::Stream;
use augnerf_core::base::{Error, Result};
use augnerf_core::data::{RayParts, Scene, tangents};
use augnerf_core::methods::{
    Batch, Batches, Extremes, Fields, LogColumns, SiteDiagnostics, StepReport, Term, not_finite, site_columns,
};
use augnerf_core::runtime::Accelerator;
use augnerf_core::settings::{
    Config, DeltaSource, Encoding, Objective, OutputPlace, PerturbField, Precision, RegularizedFields, Regularizer,
    Resample, Resolved, SecondPass, Spacing,
};
use candle_core::Tensor;
use wgpu::Buffer;

use crate::device::{Dispatch, Gpu};
use crate::kernels::Kernel;
use crate::network::{FieldBuffers, Shape};
use crate::record::{
    DeltaBuffers, FIXED_SCALE, OUT, Outputs, PassAt, PassLoss, RAY, Recorder, Resampling, SLOT, Scratch, Wanted, Words,
    Work,
};
use crate::sets::{DrawAt, HostChunks, PassSets, PassSize, SetBuffers, Stretch, Which, numbers_to_draw};

const BETA1: f64 = 0.9;
const EIGHT_BIT: f64 = 255.0;
/// Samples that the groups of one dispatch of a product reach.
pub(crate) const MOST_POINTS: usize = 64 * 65_535;
/// Positions of a ray that a group can sort.
const MOST_POSITIONS: usize = 2048;

/// Slots of results: clean passes, perturbed passes, and the diagnostics.
const COARSE: usize = 0;
const FINE: usize = 1;
const SECOND_COARSE: usize = 2;
const SECOND_FINE: usize = 3;
const DIAGNOSED: usize = 4;
/// Slots of a pass's diagnostics: without deltas, and of each site with its deltas, their shift, and with random ones.
const OF_PASS: usize = 1 + 3 * Site::ALL.len();
const SLOTS: usize = DIAGNOSED + 2 * OF_PASS;

/// Words of the flags: what is broken, and the first broken number of each field's weights and tables.
const FLAGS: usize = 8;
/// Counts of a pass's and site's numbers at their bound, and of those that may move.
const COUNTS: usize = 2 * 2 * Site::ALL.len();

/// Returns an error that names what a configuration asks for and the device does not do.
///
/// # Errors
/// [`Error::Config`].
pub fn check(config: &Resolved) -> Result<()> {
    check_fields(config)?;
    let refuse = |what: &str| Err(Error::Config(format!("device gpu does not train {what} yet; use --device cpu")));
    for (term, _) in config.regularizer.terms() {
        if term != Regularizer::Distortion {
            return refuse(&format!("with regularizer {}", term.name()));
        }
    }
    if config.field.precision == Precision::Bf16 {
        return refuse("in field.precision = \"bf16\"");
    }
    if !config.train.chunk.is_multiple_of(2) && config.train.chunk < config.train.rays {
        return refuse("an odd train.chunk");
    }
    Ok(())
}

/// Returns an error for fields that the device neither trains nor renders.
pub(crate) fn check_fields(config: &Config) -> Result<()> {
    let refuse =
        |what: &str| Err(Error::Config(format!("device gpu does not train or render {what} yet; use --device cpu")));
    if !config.representation().is_field() || config.field.encoding == Encoding::Integrated {
        return refuse(&format!("method {}", config.method.name()));
    }
    if !config.field.width.is_multiple_of(4) {
        return refuse(&format!("networks of width {}, which is no multiple of 4,", config.field.width));
    }
    let (coarse, fine) = config.samples();
    if coarse.max(fine) + 1 > MOST_POSITIONS {
        return refuse(&format!("{} samples of a ray (at most {})", coarse.max(fine), MOST_POSITIONS - 1));
    }
    Ok(())
}

/// A run's parameters and the recorded work of its steps.
pub struct Steps {
    gpu: Gpu,
    config: Resolved,
    scene_bounds: (f64, f64),
    background: Option<[f32; 3]>,
    fields: Fields,
    shape: Shape,
    batches: Batches,
    /// In the order of [`Fields::by_role`].
    learned: Vec<FieldBuffers>,
    roles: Vec<&'static str>,
    sets: [Option<PassSets>; 2],
    buffers: StepBuffers,
    /// The work of a step, and that of a step with diagnostics.
    plain: Option<Vec<Dispatch>>,
    logged: Option<Vec<Dispatch>>,
    update: Vec<Dispatch>,
    /// What a step does, by counting.
    work: Work,
    /// Bytes that the last step sent.
    sent: usize,
}

struct StepBuffers {
    now: Buffer,
    rays: Buffer,
    rows: Buffer,
    jitter: Buffer,
    noise: Buffer,
    u: Buffer,
    numbers: Buffer,
    t_coarse: Buffer,
    t_fine: Buffer,
    t_second: Buffer,
    outs: Vec<Buffer>,
    results: Buffer,
    flags: Buffer,
    counts: Buffer,
    scratch: Scratch,
    sets: [Option<SetBuffers>; 2],
    /// Rays of a chunk.
    chunk: usize,
}

impl Steps {
    /// Copies fields and their moments to the device.
    ///
    /// # Errors
    /// [`Error::Config`]: the device does not do what the configuration asks for, or has too little memory.
    pub fn new(
        gpu: &Gpu,
        config: &Resolved,
        scene: &Scene,
        fields: &Fields,
        moments: Option<[Vec<Tensor>; 2]>,
    ) -> Result<Steps> {
        check(config)?;
        if config.field.precision == Precision::F16 && !gpu.adapter().has_matrices {
            return Err(Error::Config(format!(
                "field.precision = \"f16\" needs matrix units with f16, which {} lacks; choose \"f32\"",
                gpu.adapter().name
            )));
        }
        let shape = Shape::of(&config.field);
        let tangents = config.method.is_augmented() && config.perturb.sites[Site::View].on();
        let batches = Batches::new(config, scene, RayParts { tangents, ..RayParts::default() })?;
        let (roles, of_roles): (Vec<_>, Vec<_>) = fields.by_role().into_iter().unzip();
        let learned = gpu.checked("copying the parameters", || -> Result<Vec<FieldBuffers>> {
            let mut start = 0;
            let mut learned = Vec::new();
            for field in &of_roles {
                let values: Vec<Tensor> = field.variables().iter().map(|(_, var)| var.as_detached_tensor()).collect();
                let part = start..start + values.len();
                let of_field =
                    moments.as_ref().map(|pair| [pair[0][part.clone()].to_vec(), pair[1][part.clone()].to_vec()]);
                start = part.end;
                learned.push(FieldBuffers::new(gpu, &shape, &values, of_field)?);
            }
            Ok(learned)
        })??;
        let sizes = pass_sizes(config);
        let perturbed = config.method.is_augmented() && config.perturb.source().is_some();
        let mut sets: [Option<PassSets>; 2] = [None, None];
        if perturbed {
            for (set, size) in sets.iter_mut().zip(sizes) {
                *set = size.map(|size| PassSets::new(config, scene, size)).transpose()?;
            }
        }
        let (coarse, fine) = config.samples();
        let chunk = rays_of_chunk(gpu, config, &shape, coarse.max(fine))?;
        let buffers =
            gpu.checked("making the buffers of a step", || StepBuffers::new(gpu, config, scene, &shape, &sets, chunk))?;
        let mut steps = Steps {
            gpu: gpu.clone(),
            config: config.clone(),
            scene_bounds: scene.bounds(),
            background: scene.background,
            fields: fields.clone(),
            shape,
            batches,
            learned,
            roles,
            sets,
            buffers,
            plain: None,
            logged: None,
            update: Vec::new(),
            work: Work::default(),
            sent: 0,
        };
        let gpu = steps.gpu.clone();
        gpu.write(&steps.buffers.flags, bytemuck::cast_slice(&no_flags()));
        let (plain, work) = gpu.checked("compiling the kernels", || steps.record(false))?;
        steps.plain = Some(plain);
        steps.work = work;
        steps.update = gpu.checked("compiling Adam", || steps.record_update())?;
        Ok(steps)
    }

    /// Returns the columns that its steps log, in order.
    pub fn columns(&self) -> LogColumns {
        let config = &self.config;
        let mut photometric = Vec::new();
        if has_coarse_loss(config) {
            photometric.push("loss_coarse".to_string());
        }
        if config.sampling.fine > 0 {
            photometric.push("loss_fine".into());
        }
        let mut further: Vec<String> =
            config.regularizer.terms().map(|(term, _)| format!("regularizer.{}", term.name())).collect();
        if config.method.is_augmented() {
            further.push("loss_perturbed".into());
            if config.perturb.source().is_some() {
                further.extend(config.perturb.sites_on().flat_map(|(site, _)| site_columns(site)));
            }
        }
        LogColumns { photometric, further }
    }

    /// Returns what a step does, by counting.
    pub fn work(&self) -> (usize, f64, usize) {
        (self.work.dispatches + self.update.len(), self.work.multiply_adds, self.sent)
    }

    /// Takes the step after `step` finished ones. `updates` counts Adam's updates with this one.
    ///
    /// # Errors
    /// [`Error::Diverged`]: something is not finite, or the device was lost.
    pub fn step(&mut self, step: u64, updates: u64, learning_rate: f64, log: bool) -> Result<StepReport> {
        self.compute(step, updates, learning_rate, log, true)
    }

    /// Computes a step without an update.
    ///
    /// # Errors
    /// Those of [`Steps::step`].
    pub fn try_step(&mut self, step: u64, log: bool) -> Result<StepReport> {
        let report = self.compute(step, 1, 0.0, log, false);
        self.clear_gradients();
        report
    }

    fn compute(&mut self, step: u64, updates: u64, rate: f64, log: bool, moves: bool) -> Result<StepReport> {
        self.send(step, updates, rate);
        let gpu = self.gpu.clone();
        let diagnoses = log && self.sets.iter().any(Option::is_some);
        if diagnoses && self.logged.is_none() {
            let (logged, _) = gpu.checked("compiling the kernels", || self.record(true))?;
            self.logged = Some(logged);
        }
        if diagnoses {
            gpu.write(&self.buffers.counts, bytemuck::cast_slice(&[0u32; COUNTS]));
        }
        let work = if diagnoses { &self.logged } else { &self.plain };
        let update: &[Dispatch] = if moves { &self.update } else { &[] };
        gpu.submit(work.iter().flatten().chain(update));
        let read = gpu.read(&[&self.buffers.results, &self.buffers.flags, &self.buffers.counts])?;
        let results: Vec<f32> = bytemuck::pod_collect_to_vec(&read[0]);
        let flags: Vec<u32> = bytemuck::pod_collect_to_vec(&read[1]);
        let counts: Vec<u32> = bytemuck::pod_collect_to_vec(&read[2]);
        let report = self.report(&results, diagnoses.then_some(&counts[..]));
        if let Some(what) = self.broken(&report, &flags) {
            return Err(not_finite(step + 1, &what, self.config.train.learning_rate));
        }
        Ok(report)
    }

    /// Names what is not finite.
    fn broken(&self, report: &StepReport, flags: &[u32]) -> Option<String> {
        if let Some(term) = report.terms.iter().find(|term| !term.value.is_finite()) {
            return Some(term.described.clone());
        }
        if flags[0] == 0 {
            return None;
        }
        let what = if flags[0] & 4 != 0 { "parameter" } else { "gradient" };
        let name = (0..2 * self.roles.len()).find_map(|i| {
            let at = flags[1 + i];
            (at != u32::MAX).then(|| {
                let part = if i % 2 == 0 { "weights" } else { "table" };
                format!("{}.{part}", self.roles[i / 2])
            })
        });
        Some(match name {
            Some(name) => format!("{what} of {name}"),
            None => "gradient of a table, which must be below 64,".into(),
        })
    }

    fn clear_gradients(&self) {
        for field in &self.learned {
            for learned in std::iter::once(&field.weights).chain(&field.tables) {
                self.gpu.clear(&learned.gradient);
            }
        }
    }

    /// Sends the step's numbers and rays.
    fn send(&mut self, step: u64, updates: u64, learning_rate: f64) {
        let train = &self.config.train;
        let [correction1, correction2] = [BETA1, train.adam_beta2].map(|beta| 1.0 - beta.powf(updates as f64));
        let halves = |value: u64| [value as u32, (value >> 32) as u32];
        let [seed0, seed1] = halves(self.config.seed);
        let [step0, step1] = halves(step);
        let words = Words::default().u(seed0 as usize).u(seed1 as usize).u(step0 as usize).u(step1 as usize);
        let words = words.f(learning_rate / correction1).f(correction2).u(0).u(0);
        let rays = packed(&self.batches.batch(step));
        self.gpu.write(&self.buffers.now, bytemuck::cast_slice(words.words()));
        self.gpu.write(&self.buffers.rays, bytemuck::cast_slice(&rays));
        self.sent = 4 * (words.words().len() + rays.len());
    }

    /// Copies parameters into the model's variables, and returns the moments in their order.
    ///
    /// # Errors
    /// The device was lost.
    pub fn fetch(&self) -> Result<[Vec<Tensor>; 2]> {
        let mut moments: [Vec<Tensor>; 2] = Default::default();
        for (learned, (_, field)) in self.learned.iter().zip(self.fields.by_role()) {
            let [values, first, second] = learned.read(&self.gpu, &self.shape)?;
            for ((_, var), value) in field.variables().iter().zip(values) {
                var.set(&value)?;
            }
            moments[0].extend(first);
            moments[1].extend(second);
        }
        Ok(moments)
    }

    /// Computes a step without an update, and returns its gradients in the host's order, for tests.
    #[doc(hidden)]
    pub fn gradients(&mut self, step: u64) -> Result<(StepReport, Vec<Tensor>)> {
        let report = self.compute(step, 1, 0.0, false, false)?;
        let mut gradients = Vec::new();
        for learned in &self.learned {
            gradients.extend(learned.gradients(&self.gpu, &self.shape, loss_scale(&self.config))?);
        }
        self.clear_gradients();
        Ok((report, gradients))
    }

    /// Whether the device measures the time of kernels.
    pub fn has_timestamps(&self) -> bool {
        self.gpu.has_timestamps()
    }

    /// Measures each kernel of a step, summed by name: milliseconds and dispatches.
    ///
    /// # Errors
    /// The device has no timestamps, or was lost.
    pub fn profile(&mut self, step: u64) -> Result<Vec<(&'static str, f64, usize)>> {
        if !self.gpu.has_timestamps() {
            return Err(Error::Config(format!("{} has no timestamps", self.gpu.description())));
        }
        self.send(step, 1, 0.0);
        let work = self.plain.as_ref().expect("recorded");
        let times = self.gpu.time(work)?;
        self.clear_gradients();
        let mut sums: Vec<(&'static str, f64, usize)> = Vec::new();
        for (dispatch, nanoseconds) in work.iter().zip(times) {
            match sums.iter_mut().find(|(name, ..)| *name == dispatch.label) {
                Some((_, sum, count)) => (*sum, *count) = (*sum + 1e-6 * nanoseconds, *count + 1),
                None => sums.push((dispatch.label, 1e-6 * nanoseconds, 1)),
            }
        }
        sums.sort_by(|a, b| b.1.total_cmp(&a.1));
        Ok(sums)
    }
}

/// Returns the factor of gradients. In f16 typical ones of a ray's colours are then near 1.
fn loss_scale(config: &Resolved) -> f64 {
    match config.field.precision {
        Precision::F16 => ((64 * 3 * config.train.rays) as f64).log2().round().exp2(),
        _ => 1.0,
    }
}

fn no_flags() -> [u32; FLAGS] {
    let mut flags = [u32::MAX; FLAGS];
    flags[0] = 0;
    flags
}

fn has_coarse_loss(config: &Resolved) -> bool {
    config.representation().has_coarse_loss()
}

/// Returns the sizes of a step's perturbed passes, coarse and fine.
fn pass_sizes(config: &Resolved) -> [Option<PassSize>; 2] {
    let (coarse, fine) = config.samples();
    let size = |is_coarse: bool, samples: usize| PassSize {
        is_coarse,
        samples,
        columns: config.field.encoding.t_vals(samples),
    };
    [has_coarse_loss(config).then(|| size(true, coarse)), (fine > 0).then(|| size(false, fine))]
}

/// Returns rays as the kernels read them.
pub(crate) fn packed(Batch { rays, target }: &Batch) -> Vec<f32> {
    let mut packed = Vec::with_capacity(rays.len() * RAY);
    let three = |values: &[f32], ray: usize| [values[3 * ray], values[3 * ray + 1], values[3 * ray + 2]];
    for ray in 0..rays.len() {
        let (direction, view) = (three(&rays.directions, ray), three(&rays.viewdirs, ray));
        let (u, w) = tangents(view.map(f64::from));
        packed.extend(three(&rays.origins, ray));
        packed.extend(direction);
        packed.extend(view);
        packed.extend(u.map(|x| x as f32));
        packed.extend(w.map(|x| x as f32));
        packed.extend(three(target, ray));
        let norm = direction.iter().map(|x| x * x).sum::<f32>().sqrt();
        packed.extend([norm, 0.0]);
    }
    packed
}

/// Returns widths and lower ends of the bins of coarse positions, or the positions themselves without jitter.
pub(crate) fn bins(spacing: Spacing, bounds: (f64, f64), columns: usize, jitter: bool) -> Vec<f32> {
    let last = (columns - 1) as f64;
    let points: Vec<f64> = (0..columns).map(|i| spacing.at(bounds, i as f64 / last)).collect();
    let middle = |i: usize| 0.5 * (points[i] + points[i + 1]);
    let lower: Vec<f64> = (0..columns).map(|i| if i == 0 { points[0] } else { middle(i - 1) }).collect();
    let upper: Vec<f64> = (0..columns).map(|i| if i + 1 == columns { points[i] } else { middle(i) }).collect();
    let widths = upper.iter().zip(&lower).map(|(upper, lower)| if jitter { (upper - lower) as f32 } else { 0.0 });
    let ends = if jitter { lower.clone() } else { points.clone() };
    widths.collect::<Vec<f32>>().into_iter().chain(ends.into_iter().map(|t| t as f32)).collect()
}

impl StepBuffers {
    fn new(
        gpu: &Gpu,
        config: &Resolved,
        scene: &Scene,
        shape: &Shape,
        sets: &[Option<PassSets>; 2],
        chunk: usize,
    ) -> StepBuffers {
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
        let f = |count: usize| gpu.numbers(count);
        let t_vals = || f(chunk * (samples + 1));
        let pair = |i: usize| sets[i].as_ref().map(|sets| SetBuffers::new(gpu, sets, chunk));
        StepBuffers {
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
            outs: (0..SLOTS).map(|_| f(1)).collect(),
            results: f(SLOTS * SLOT),
            flags: f(FLAGS),
            counts: f(COUNTS),
            scratch: Scratch::new(gpu, shape, chunk, samples, true),
            sets: [pair(0), pair(1)],
            chunk,
        }
        .with_outs(gpu, config)
    }

    /// Makes the outputs of the passes that a run has.
    fn with_outs(mut self, gpu: &Gpu, config: &Resolved) -> StepBuffers {
        let used = if config.method.is_augmented() { SLOTS } else { DIAGNOSED };
        for out in &mut self.outs[..used] {
            *out = gpu.numbers(config.train.rays * OUT);
        }
        self
    }
}

/// Returns the rays whose samples fit into the device's memory at once: whole chunks of the host, an even number.
///
/// # Errors
/// A single chunk does not fit.
fn rays_of_chunk(gpu: &Gpu, config: &Resolved, shape: &Shape, samples: usize) -> Result<usize> {
    // Deltas of both passes, random ones, and the numbers that they are drawn from.
    let deltas = 4 * 5 * (shape.width + 8) * usize::from(config.method.is_augmented());
    let bytes = Scratch::bytes_per_sample(shape) + deltas;
    let widest = 4 * (shape.width + 4).max(shape.channels);
    let fits = (gpu.budget() / bytes).min(gpu.largest_buffer() / widest).min(MOST_POINTS) / samples;
    let unit = config.train.chunk.min(config.train.rays).next_multiple_of(2);
    if fits < unit {
        return Err(Error::Config(format!(
            "device gpu ({}) has memory for {fits} rays of {samples} samples at once, which is less than a chunk; lower \
             train.chunk ({}) or field.width",
            gpu.adapter().name,
            config.train.chunk
        )));
    }
    Ok((fits / unit * unit).min(config.train.rays))
}

impl Steps {
    fn recorder(&self) -> Recorder<'_> {
        Recorder {
            gpu: &self.gpu,
            shape: &self.shape,
            outputs: Outputs::of(&self.config.field),
            scratch: &self.buffers.scratch,
            rays: &self.buffers.rays,
            flags: &self.buffers.flags,
            bounds: self.scene_bounds,
            background: self.background,
            tiles: self.gpu.tiles(self.config.field.precision),
            loss_scale: loss_scale(&self.config),
            dispatches: Vec::new(),
            work: Work::default(),
        }
    }

    fn field(&self, role: &str) -> Option<&FieldBuffers> {
        let index = self.roles.iter().position(|known| *known == role)?;
        Some(&self.learned[index])
    }

    /// The field of clean fine passes.
    fn fine(&self) -> Option<&FieldBuffers> {
        (self.config.sampling.fine > 0).then(|| self.field("fine").unwrap_or_else(|| self.coarse()))
    }

    fn coarse(&self) -> &FieldBuffers {
        self.field("coarse").expect("there is always a coarse field")
    }

    fn coarse_weight(&self) -> f64 {
        if self.fine().is_some() { self.config.train.coarse_weight } else { 1.0 }
    }

    /// Weights of clean and perturbed loss.
    fn mixing(&self) -> (f64, f64) {
        let lambda = self.config.perturb.lambda;
        match (self.config.method.is_augmented(), self.config.perturb.objective) {
            (false, _) => (1.0, 0.0),
            (true, Objective::Paper) => (1.0, lambda),
            (true, Objective::Released) => (1.0 - lambda, lambda),
        }
    }

    /// Records the work of a step up to its gradients.
    fn record(&self, log: bool) -> (Vec<Dispatch>, Work) {
        let mut recorder = self.recorder();
        let (rays, chunk) = (self.config.train.rays, self.buffers.chunk);
        for ray0 in (0..rays).step_by(chunk) {
            let count = chunk.min(rays - ray0);
            ChunkRecorder { steps: self, ray0, rays: count, log }.record(&mut recorder);
        }
        for slot in self.slots(log) {
            recorder.sums(rays, &self.buffers.outs[slot], slot, &self.buffers.results);
        }
        if log {
            self.record_shifts(&mut recorder);
        }
        (recorder.dispatches, recorder.work)
    }

    /// The slots of passes that a step has.
    fn slots(&self, log: bool) -> Vec<usize> {
        let augmented = self.config.method.is_augmented();
        let (coarse, fine) = (has_coarse_loss(&self.config), self.config.sampling.fine > 0);
        let mut slots = Vec::new();
        slots.extend(coarse.then_some(COARSE));
        slots.extend(fine.then_some(FINE));
        slots.extend((augmented && coarse).then_some(SECOND_COARSE));
        slots.extend((augmented && fine).then_some(SECOND_FINE));
        if log {
            for (pass, sets) in self.sets.iter().enumerate() {
                let Some(sets) = sets else { continue };
                let first = DIAGNOSED + pass * OF_PASS;
                slots.push(first);
                slots.extend(sets.sites().flat_map(|site| [with(first, site), with_random(first, site)]));
            }
        }
        slots
    }

    fn record_shifts(&self, recorder: &mut Recorder) {
        let outs = &self.buffers.outs;
        for (pass, sets) in self.sets.iter().enumerate() {
            let first = DIAGNOSED + pass * OF_PASS;
            for site in sets.iter().flat_map(PassSets::sites) {
                let words = Words::default().u(self.config.train.rays).u(shift_of(first, site)).u(0).u(0);
                let buffers = [(1, &outs[first]), (2, &outs[with(first, site)]), (3, &self.buffers.results)];
                recorder.run(Kernel::new("shift"), words, &buffers, [1, 1, 1]);
            }
        }
    }

    /// Records the check of what is finite, and Adam's update of all fields.
    fn record_update(&self) -> Vec<Dispatch> {
        let mut recorder = self.recorder();
        let train = &self.config.train;
        for (index, field) in self.learned.iter().enumerate() {
            let weights = &field.weights;
            let words = Words::default().u(weights.count).u(DIAGNOSED).u(2 * index).u(0);
            let buffers = [(1, &weights.gradient), (2, &self.buffers.results), (3, &self.buffers.flags)];
            recorder.run(Kernel::new("check"), words, &buffers, crate::device::groups(weights.count));
        }
        for (index, field) in self.learned.iter().enumerate() {
            for (part, learned) in std::iter::once(&field.weights).chain(&field.tables).enumerate() {
                let words = Words::default().u(learned.count).f(BETA1).f(train.adam_beta2).f(train.adam_epsilon);
                let unit = if part == 0 { loss_scale(&self.config) } else { FIXED_SCALE };
                let words = words.f(1.0 / unit).u(2 * index + part).u(0).u(0);
                let features = self.shape.grid.as_ref().map_or(1, |grid| grid.features);
                let (kernel, threads) = match part {
                    0 => (Kernel::new("adam_weights"), learned.count),
                    _ => (Kernel::new("adam_tables").set("FEATURES", features), learned.count / features),
                };
                let buffers = [
                    (1, &self.buffers.now),
                    (2, &learned.values),
                    (3, &learned.first),
                    (4, &learned.second),
                    (5, &self.buffers.flags),
                    (6, &learned.gradient),
                ];
                recorder.run(kernel, words, &buffers, crate::device::groups(threads));
            }
        }
        recorder.dispatches
    }

    /// Makes the report of a step from its results.
    fn report(&self, results: &[f32], counts: Option<&[u32]>) -> StepReport {
        let value = |slot: usize, what: usize| f64::from(results[slot * SLOT + what]);
        let slots = self.slots(false);
        let mse_of = |slot: usize| slots.contains(&slot).then(|| value(slot, 0));
        let (coarse, fine) = (mse_of(COARSE), mse_of(FINE));
        let coarse_weight = self.coarse_weight();
        let second = [mse_of(SECOND_COARSE).map(|loss| coarse_weight * loss), mse_of(SECOND_FINE)];
        let perturbed = self.config.method.is_augmented().then(|| second.into_iter().flatten().sum::<f64>());
        let (clean_weight, perturbed_weight) = self.mixing();
        let clean = coarse_weight * coarse.unwrap_or(0.0) + fine.unwrap_or(0.0);
        let mut loss = clean_weight * clean + perturbed.map_or(0.0, |loss| perturbed_weight * loss);
        let passes = [
            ("loss_coarse", "loss of the clean coarse pass", coarse, clean_weight * coarse_weight),
            ("loss_fine", "loss of the clean fine pass", fine, clean_weight),
            ("loss_perturbed", "loss of the perturbed pass", perturbed, perturbed_weight),
        ];
        let of_pass = |(name, described, value, weight): (&str, &str, Option<f64>, f64)| {
            value.map(|value| Term { name: name.into(), described: described.into(), value, weight })
        };
        let mut terms: Vec<Term> = passes.into_iter().filter_map(of_pass).collect();
        let evaluated = if fine.is_some() { FINE } else { COARSE };
        for (term, weight) in self.config.regularizer.terms() {
            let both = self.config.regularizer.fields == RegularizedFields::Both;
            let counted = slots.iter().filter(|slot| **slot == evaluated || both && **slot == COARSE);
            let value: f64 = counted.map(|slot| value(*slot, 14)).sum();
            let (name, described) = (format!("regularizer.{}", term.name()), format!("regularizer {}", term.name()));
            loss += weight * value;
            terms.push(Term { name, described, value, weight });
        }
        let extremes: Vec<f64> = (1..14).map(|what| value(evaluated, what)).collect();
        StepReport {
            terms,
            loss,
            mse: value(evaluated, 0),
            extremes: Extremes::read(&extremes),
            sites: counts.map_or_else(Vec::new, |counts| self.diagnose(&value, counts, clean)),
        }
    }

    /// Makes the diagnostics of each site from the losses of its passes.
    fn diagnose(&self, value: &impl Fn(usize, usize) -> f64, counts: &[u32], clean: f64) -> Vec<SiteDiagnostics> {
        let mut found = Vec::new();
        for (site, numbers) in self.config.perturb.numbers.iter() {
            if !numbers.on() {
                continue;
            }
            let (mut gain, mut over_random, mut shifts, mut passes) = (0.0, 0.0, 0.0, 0.0);
            let mut shares = Vec::new();
            for (pass, sets) in self.sets.iter().enumerate() {
                let Some(sets) = sets else { continue };
                if !sets.sites().any(|on| on == site) {
                    // Switched on with a set of size 0: there is no perturbation, and no gain.
                    passes += if numbers.perturbs() { 0.0 } else { 1.0 };
                    continue;
                }
                let first = DIAGNOSED + pass * OF_PASS;
                let weight = if pass == 0 { self.coarse_weight() } else { 1.0 };
                let loss = |slot: usize| weight * value(slot, 0);
                gain += loss(with(first, site)) - loss(first);
                over_random += loss(with(first, site)) - loss(with_random(first, site));
                shifts += EIGHT_BIT * value(shift_of(first, site), 0);
                passes += 1.0;
                let at = count_of(pass, site);
                if counts[at + 1] > 0 {
                    shares.push(f64::from(counts[at]) / f64::from(counts[at + 1]));
                }
            }
            if passes > 0.0 {
                let mean = shares.iter().sum::<f64>() / shares.len() as f64;
                let share = (!shares.is_empty()).then_some(mean);
                found.push(SiteDiagnostics::new(site, [gain, over_random, shifts / passes], share, clean));
            }
        }
        found
    }
}

/// The slot of a pass with one site's deltas alone.
fn with(first: usize, site: Site) -> usize {
    first + 1 + 3 * site as usize
}

fn with_random(first: usize, site: Site) -> usize {
    with(first, site) + 1
}

fn shift_of(first: usize, site: Site) -> usize {
    with(first, site) + 2
}

fn count_of(pass: usize, site: Site) -> usize {
    2 * (pass * Site::ALL.len() + site as usize)
}

/// Records the work of a chunk of rays.
struct ChunkRecorder<'a> {
    steps: &'a Steps,
    ray0: usize,
    rays: usize,
    log: bool,
}

/// The random numbers of a clean pass: one part of a stream for all rays of the step, or one for each chunk of the host.
#[derive(Clone, Copy, PartialEq)]
enum Clean {
    First,
    Second,
}

impl<'a> ChunkRecorder<'a> {
    fn record(&self, recorder: &mut Recorder<'a>) {
        let steps = self.steps;
        let slots = [COARSE, FINE];
        let (clean_weight, perturbed_weight) = steps.mixing();
        self.clean(recorder, Clean::First, clean_weight, slots);
        if !steps.config.method.is_augmented() {
            return;
        }
        match steps.config.perturb.second {
            SecondPass::Clean => self.clean(recorder, Clean::Second, perturbed_weight, [SECOND_COARSE, SECOND_FINE]),
            SecondPass::Perturbed(source) => self.perturbed(recorder, source, perturbed_weight),
        }
    }

    fn config(&self) -> &'a Resolved {
        &self.steps.config
    }

    /// Weight of the squared error of a channel.
    fn weight(&self, weight: f64) -> f64 {
        weight / (3 * self.config().train.rays) as f64
    }

    fn pass(&self, field: &'a FieldBuffers, is_coarse: bool, t_vals: &'a Buffer, slot: usize) -> PassAt<'a> {
        let (coarse, fine) = self.config().samples();
        let samples = if is_coarse { coarse } else { fine };
        PassAt {
            field,
            ray0: self.ray0,
            rays: self.rays,
            samples,
            columns: self.config().field.encoding.t_vals(samples),
            t_vals,
            noise: None,
            deltas: DeltaBuffers::default(),
            out: &self.steps.buffers.outs[slot],
        }
    }

    /// Records words of the clean pass's stream: `per_ray` numbers a ray, `before` a ray in the stream before them.
    fn numbers(&self, recorder: &mut Recorder<'a>, which: Clean, to: &Buffer, kind: Kind, before: &[Kind]) {
        let buffers = &self.steps.buffers;
        let rays_of_step = self.config().train.rays;
        let even = |count: usize, kind: &Kind| if kind.normal { count.next_multiple_of(2) } else { count };
        let words_before = |rays: usize| before.iter().map(|kind| even(rays * kind.per_ray, kind)).sum::<usize>();
        let mut draw = |rays: usize, chunks: usize, part: usize, offset: usize, first: usize, stream: Stream| {
            let count = even(rays * kind.per_ray, &kind);
            let at = Stretch { stream, part, part_step: 1, chunks, count, offset, first };
            recorder.random(&buffers.now, to, at);
            if kind.normal {
                recorder.normal(to, chunks, count, kind.scale, first);
            }
        };
        match which {
            Clean::First => {
                let offset = words_before(rays_of_step) + self.ray0 * kind.per_ray;
                draw(self.rays, 1, 0, offset, 0, Stream::Jitter);
            }
            Clean::Second => {
                let chunk = self.config().train.chunk;
                let (whole, rest) = (self.rays / chunk, self.rays % chunk);
                let part = self.ray0 / chunk;
                draw(chunk, whole, part, words_before(chunk), 0, Stream::Search);
                let first = whole * chunk * kind.per_ray;
                draw(rest, usize::from(rest > 0), part + whole, words_before(rest), first, Stream::Search);
            }
        }
    }

    /// The numbers of a clean pass, in the order of its stream: jitter, noise of coarse and fine samples, places in the
    /// CDF.
    fn kinds(&self) -> [Kind; 4] {
        let config = self.config();
        let (coarse, fine) = config.samples();
        let scale = config.density_noise;
        let noise = |samples: usize| Kind { per_ray: if scale == 0.0 { 0 } else { samples }, normal: true, scale };
        let uniform = |per_ray: usize| {
            let per_ray = if config.sampling.jitter { per_ray } else { 0 };
            Kind { per_ray, normal: false, scale: 1.0 }
        };
        let encoding = config.field.encoding;
        let drawn = if config.sampling.fine > 0 { encoding.t_vals(config.sampling.fine) } else { 0 };
        [uniform(encoding.t_vals(config.sampling.coarse)), noise(coarse), noise(fine), uniform(drawn)]
    }

    /// Records the noise of a pass, and returns it.
    fn noise(&self, recorder: &mut Recorder<'a>, which: Clean, is_coarse: bool) -> Option<(&'a Buffer, usize)> {
        if self.config().density_noise == 0.0 {
            return None;
        }
        let kinds = self.kinds();
        let index = if is_coarse { 1 } else { 2 };
        let noise = &self.steps.buffers.noise;
        self.numbers(recorder, which, noise, kinds[index], &kinds[..index]);
        Some((noise, 0))
    }

    /// Records a clean pass of both fields and its gradients.
    fn clean(&self, recorder: &mut Recorder<'a>, which: Clean, weight: f64, [coarse_slot, fine_slot]: [usize; 2]) {
        let steps = self.steps;
        let (config, buffers) = (self.config(), &steps.buffers);
        let kinds = self.kinds();
        self.numbers(recorder, which, &buffers.jitter, kinds[0], &[]);
        let columns = config.field.encoding.t_vals(config.sampling.coarse);
        let words = Words::default().u(self.rays).u(columns).u(0).u(0);
        let bound = [(1, &buffers.rows), (2, &buffers.jitter), (3, &buffers.t_coarse)];
        recorder.run(Kernel::new("sample"), words, &bound, crate::device::groups(self.rays * columns));
        let coarse = self.pass(steps.coarse(), true, &buffers.t_coarse, coarse_slot);
        let is_first = which == Clean::First;
        let distortion = |is_evaluated: bool| {
            let counts = is_first && (is_evaluated || config.regularizer.fields == RegularizedFields::Both);
            let weights = config.regularizer.terms().filter(|_| counts).map(|(_, weight)| weight);
            weights.sum::<f64>() / config.train.rays as f64
        };
        let trained = Wanted { weights: true, ..Wanted::default() };
        if has_coarse_loss(config) {
            let noise = self.noise(recorder, which, true);
            let coarse = PassAt { noise, ..coarse };
            let weight = self.weight(weight * steps.coarse_weight());
            let loss = PassLoss { weight, distortion: distortion(steps.fine().is_none()) };
            recorder.forward(&coarse, Some(loss));
            recorder.back(&coarse, trained);
        } else {
            recorder.place_by_density(&coarse);
        }
        let Some(field) = steps.fine() else { return };
        // The way back leaves the weights of the samples as they are.
        let t_fine = if is_first { &buffers.t_fine } else { &buffers.t_second };
        self.numbers(recorder, which, &buffers.u, kinds[3], &kinds[..3]);
        recorder.resample(self.resampling(), &buffers.t_coarse, &buffers.u, t_fine);
        let noise = self.noise(recorder, which, false);
        let fine = PassAt { noise, ..self.pass(field, false, t_fine, fine_slot) };
        recorder.forward(&fine, Some(PassLoss { weight: self.weight(weight), distortion: distortion(true) }));
        recorder.back(&fine, trained);
    }

    fn resampling(&self) -> Resampling {
        let config = self.config();
        let intervals = config.field.encoding.at_intervals();
        Resampling {
            rays: self.rays,
            coarse: config.sampling.coarse,
            columns: config.field.encoding.t_vals(config.sampling.coarse),
            fine: config.field.encoding.t_vals(config.sampling.fine),
            intervals,
            padding: config.sampling.resample_padding,
            mode: match (config.sampling.jitter, intervals) {
                (false, _) => 2,
                (true, true) => 1,
                (true, false) => 0,
            },
        }
    }

    /// Records the perturbed passes on the clean pass's samples.
    fn perturbed(&self, recorder: &mut Recorder<'a>, source: DeltaSource, weight: f64) {
        let steps = self.steps;
        let buffers = &steps.buffers;
        let separate = (self.config().perturb.field == PerturbField::Separate).then(|| steps.field("adversarial"));
        let own = separate.flatten();
        if has_coarse_loss(self.config()) {
            let field = own.unwrap_or_else(|| steps.coarse());
            let noise = self.noise(recorder, Clean::First, true);
            let pass = PassAt { noise, ..self.pass(field, true, &buffers.t_coarse, SECOND_COARSE) };
            self.perturbed_pass(recorder, 0, source, pass, weight * steps.coarse_weight());
        }
        let Some(field) = steps.fine() else { return };
        let mut t_vals = &buffers.t_fine;
        if self.config().perturb.resample == Resample::Perturbed && has_coarse_loss(self.config()) {
            let t_coarse = match steps.sets[0].as_ref().is_some_and(|sets| sets.sites().any(|site| site == Site::T)) {
                true => recorder.moved_t_vals(),
                false => &buffers.t_coarse,
            };
            let kinds = self.kinds();
            self.numbers(recorder, Clean::First, &buffers.u, kinds[3], &kinds[..3]);
            recorder.resample(self.resampling(), t_coarse, &buffers.u, &buffers.t_second);
            t_vals = &buffers.t_second;
        }
        let noise = self.noise(recorder, Clean::First, false);
        let pass = PassAt { noise, ..self.pass(own.unwrap_or(field), false, t_vals, SECOND_FINE) };
        self.perturbed_pass(recorder, 1, source, pass, weight);
    }

    /// Records the draws, the search, the perturbed pass with its gradients, and the diagnostics before it.
    fn perturbed_pass(
        &self,
        recorder: &mut Recorder<'a>,
        index: usize,
        source: DeltaSource,
        pass: PassAt<'a>,
        weight: f64,
    ) {
        let steps = self.steps;
        let perturb = &self.config().perturb;
        let sets = steps.sets[index].as_ref().expect("a perturbed pass has sets");
        let buffers = steps.buffers.sets[index].as_ref().expect("a perturbed pass has deltas");
        let before = perturb.output == OutputPlace::Before;
        recorder.radii(sets, buffers, &pass);
        let draw = if source == DeltaSource::Gaussian { Draw::Gaussian } else { Draw::Uniform };
        let at = self.draw_at(index, &pass, draw, Stream::Search, false);
        recorder.draw(&at);
        let deltas = buffers.of_pass(sets, Which::Searched, perturb.injection_layer, before);
        let pass = PassAt { deltas, ..pass };
        let loss = PassLoss { weight: self.weight(weight), distortion: 0.0 };
        if source == DeltaSource::WorstCase {
            // A loss without a weight: lambda may be 0.
            let searched = PassLoss { weight: self.weight(1.0), distortion: 0.0 };
            for step in 0..sets.steps() {
                let moving = sets.moving(step);
                let on = |site: Site| moving.contains(&site);
                let wanted = Wanted {
                    weights: false,
                    t: on(Site::T),
                    xyz: on(Site::Xyz),
                    view: on(Site::View),
                    feature: on(Site::Feature),
                };
                recorder.forward(&pass, Some(searched));
                recorder.back(&pass, wanted);
                for site in moving {
                    let gradient = recorder.gradient_of(site, perturb.output);
                    recorder.ascend(sets, buffers, &pass, site, gradient);
                }
            }
        }
        if self.log {
            self.diagnose(recorder, index, &pass);
        }
        recorder.forward(&pass, Some(loss));
        recorder.back(&pass, Wanted { weights: true, ..Wanted::default() });
    }

    fn draw_at<'b>(&self, index: usize, pass: &'b PassAt<'a>, draw: Draw, stream: Stream, random: bool) -> DrawAt<'b>
    where
        'a: 'b,
    {
        let steps = self.steps;
        DrawAt {
            sets: steps.sets[index].as_ref().expect("a perturbed pass has sets"),
            buffers: steps.buffers.sets[index].as_ref().expect("a perturbed pass has deltas"),
            pass,
            draw,
            stream,
            is_coarse: index == 0,
            random,
            chunks: HostChunks {
                size: self.config().train.chunk.min(self.config().train.rays),
                ray0: self.ray0,
                rays: self.rays,
            },
            now: &steps.buffers.now,
            numbers: &steps.buffers.numbers,
        }
    }

    /// Records the passes without deltas, with each site's alone, and with random ones.
    fn diagnose(&self, recorder: &mut Recorder<'a>, index: usize, pass: &PassAt<'a>) {
        let steps = self.steps;
        let perturb = &self.config().perturb;
        let sets = steps.sets[index].as_ref().expect("a perturbed pass has sets");
        let buffers = steps.buffers.sets[index].as_ref().expect("a perturbed pass has deltas");
        let before = perturb.output == OutputPlace::Before;
        let at = self.draw_at(index, pass, Draw::Uniform, Stream::Diagnostics, true);
        recorder.draw(&at);
        // The shares at bounds are those of the deltas that the complete pass uses.
        recorder.forward(pass, None);
        let padding = self.config().field.rgb_padding;
        for site in sets.sites() {
            let range = if site == Site::Rgb { (-padding, 1.0 + padding) } else { (0.0, f64::from(f32::MAX)) };
            let counts = (&steps.buffers.counts, count_of(index, site));
            recorder.at_bound(sets, buffers, pass, site, counts, range);
        }
        let first = DIAGNOSED + index * OF_PASS;
        recorder.keep_used(sets, buffers, pass);
        let [used, random] =
            [Which::Used, Which::Random].map(|which| buffers.of_pass(sets, which, perturb.injection_layer, before));
        let render = |recorder: &mut Recorder<'a>, deltas: DeltaBuffers<'a>, slot: usize| {
            recorder.forward(&PassAt { deltas, out: &steps.buffers.outs[slot], ..*pass }, None);
        };
        render(recorder, DeltaBuffers { before, ..DeltaBuffers::default() }, first);
        for site in sets.sites() {
            render(recorder, used.only(site), with(first, site));
            render(recorder, random.only(site), with_random(first, site));
        }
    }
}

/// Random numbers of a clean pass.
#[derive(Clone, Copy)]
struct Kind {
    per_ray: usize,
    normal: bool,
    scale: f64,
}
