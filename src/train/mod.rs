//! Training: one step is a clean pass, where asked for a search and a perturbed pass, and an
//! update.
//!
//! Rays are worked through in chunks whose gradients add up: memory is bounded by the chunk, and
//! small chunks stay in a processor's cache.

use candle_core::backprop::GradStore;
use candle_core::{DType, Device, Tensor};
use rayon::prelude::*;

use crate::augment::PixelScale;
use crate::base::rng::{Random, Stream};
use crate::base::{Error, Result};
use crate::data::{Rays, Scene};
use crate::methods::Model;
use crate::render::{
    self, Pass, PassOutput, clean_pass, noiseless_acc, photometric_loss, positions_at, resample, sampling,
};
use crate::settings::{Config, DensityActivation, Objective, PerturbKind, Regularizer};

mod batches;
pub mod checkpoint;
pub mod diagnostics;
mod optimizer;
mod perturbed;
mod regularized;

pub use batches::{Batch, Batches};
pub use diagnostics::{AttackSummary, LevelDiagnostics};
pub use optimizer::{Adam, Moments, learning_rate};
pub use regularized::Balance;

/// Accumulation under which a ray counts as empty.
const EMPTY_ACC: f64 = 1e-3;
/// Parts of a step that threads share; each sums its gradients in place.
const PARTS: usize = 16;
/// Times that a dead start is drawn again before the configuration is blamed.
const MOST_REDRAWS: u64 = 100;

/// What a scene contributes to the numerics besides rays.
#[derive(Clone, Copy, Debug)]
pub struct Volume {
    /// Start and end of a ray's interval, in units of `t_vals`.
    pub bounds: (f64, f64),
    /// Fills missing accumulation.
    pub background: Option<[f32; 3]>,
    /// A pixel's size.
    pub pixel: PixelScale,
}

impl Volume {
    /// That of a scene; the first training camera stands for all.
    pub fn of(scene: &Scene) -> Volume {
        let camera = &scene.train[0].camera;
        let pixel = PixelScale {
            width: camera.width as f64,
            height: camera.height as f64,
            focal: camera.focal[0],
            ndc: scene.ndc.is_some(),
        };
        Volume { bounds: (scene.near, scene.far), background: scene.background, pixel }
    }
}

/// What one step measured.
#[derive(Clone, Debug)]
pub struct StepStats {
    /// Steps finished, this one included.
    pub step: u64,
    /// Learning rate of this step's update.
    pub learning_rate: f64,
    /// Photometric loss of the clean coarse pass.
    pub loss_coarse: f64,
    /// That of the clean fine pass, where there is one.
    pub loss_fine: Option<f64>,
    /// Loss of the perturbed passes (coarse + fine, unweighted), where there are any.
    pub loss_perturbed: Option<f64>,
    /// Each regularizer's term, unweighted, summed over the fields that it holds for.
    pub regularizers: Vec<(Regularizer, f64)>,
    /// What was minimised: clean and perturbed loss as the objective mixes them, plus weighted
    /// regularizers.
    pub loss: f64,
    /// Largest accumulation of a ray in the pass that is evaluated, without density noise.
    pub largest_acc: f64,
    /// Per level that is on, at log steps.
    pub levels: Vec<LevelDiagnostics>,
}

impl StepStats {
    /// PSNR of the batch in the pass that is evaluated, dB, unrounded.
    /// None where the error is 0.
    pub fn psnr(&self) -> Option<f64> {
        let mse = self.loss_fine.unwrap_or(self.loss_coarse);
        (mse > 0.0).then(|| -10.0 * mse.log10())
    }
}

/// State of a run in memory.
pub struct Trainer {
    config: Config,
    volume: Volume,
    device: Device,
    dtype: DType,
    model: Model,
    adam: Adam,
    batches: Batches,
    step: u64,
    /// Steps in a row on which every ray was empty.
    empty_steps: u64,
    /// Redraws of each field before it was alive.
    redraws: Vec<u64>,
    /// Revisions of the code and kinds of devices that took earlier steps.
    revisions: Vec<String>,
    devices: Vec<String>,
}

/// A chunk of one step: rays, targets and the clean pass's random numbers.
struct Chunk {
    rays: Rays,
    target: Tensor,
    t_coarse: Tensor,
    noise_coarse: Option<Tensor>,
    noise_fine: Option<Tensor>,
    /// Positions in the inverse CDF, `[rays, fine]`.
    u: Option<Tensor>,
    /// Share of the step's rays.
    share: f64,
    /// Number of the chunk within the step.
    index: u64,
}

impl Chunk {
    fn narrow(&self, index: usize, start: usize, count: usize) -> Result<Chunk> {
        let part = |tensor: &Tensor| tensor.narrow(0, start, count)?.contiguous();
        let maybe = |tensor: &Option<Tensor>| tensor.as_ref().map(part).transpose();
        Ok(Chunk {
            rays: self.rays.narrow(start, count)?,
            target: part(&self.target)?,
            t_coarse: part(&self.t_coarse)?,
            noise_coarse: maybe(&self.noise_coarse)?,
            noise_fine: maybe(&self.noise_fine)?,
            u: maybe(&self.u)?,
            share: count as f64 / self.rays.len() as f64,
            index: index as u64,
        })
    }
}

/// Gradients (or other tensors of the parameters' shapes) in the order of the optimizer's variables.
struct Gradients(Vec<Option<Tensor>>);

/// What one chunk adds to a step.
struct ChunkResult {
    gradients: Gradients,
    losses: Losses,
    diagnostics: diagnostics::Sums,
}

/// Losses weighted with the chunk's share, and the largest accumulation of a ray: f64 scalars that stay on the device
/// until the step is over.
#[derive(Default)]
struct Losses {
    coarse: Option<Tensor>,
    fine: Option<Tensor>,
    perturbed: Option<Tensor>,
    largest_acc: Option<Tensor>,
}

impl ChunkResult {
    fn new(parameters: usize) -> ChunkResult {
        ChunkResult {
            gradients: Gradients(vec![None; parameters]),
            losses: Losses::default(),
            diagnostics: diagnostics::Sums::default(),
        }
    }

    fn add(&mut self, other: ChunkResult) -> Result<()> {
        self.gradients.merge(other.gradients)?;
        self.losses.add(other.losses)?;
        self.diagnostics.merge(other.diagnostics);
        Ok(())
    }
}

impl Losses {
    fn add(&mut self, other: Losses) -> Result<()> {
        self.coarse = sum(self.coarse.take(), other.coarse)?;
        self.fine = sum(self.fine.take(), other.fine)?;
        self.perturbed = sum(self.perturbed.take(), other.perturbed)?;
        self.largest_acc = match (self.largest_acc.take(), other.largest_acc) {
            (Some(a), Some(b)) => Some(a.maximum(&b)?),
            (a, b) => a.or(b),
        };
        Ok(())
    }

    /// Loss of the passes that [`Trainer::clean`] descended.
    fn clean(&self, coarse_weight: f64) -> Result<Option<Tensor>> {
        let coarse = self.coarse.as_ref().map(|loss| loss * coarse_weight).transpose()?;
        sum(coarse, self.fine.clone())
    }

    /// Coarse, fine and perturbed loss and the largest accumulation, in one transfer.
    fn read(self) -> Result<[Option<f64>; 4]> {
        let all = [self.coarse, self.fine, self.perturbed, self.largest_acc];
        let there: Vec<&Tensor> = all.iter().flatten().collect();
        let mut values = Tensor::stack(&there, 0)?.to_vec1::<f64>()?.into_iter();
        Ok(all.map(|tensor| tensor.and_then(|_| values.next())))
    }
}

fn sum(a: Option<Tensor>, b: Option<Tensor>) -> Result<Option<Tensor>> {
    Ok(match (a, b) {
        (Some(a), Some(b)) => Some((a + b)?),
        (a, b) => a.or(b),
    })
}

impl Gradients {
    fn add(&mut self, adam: &Adam, store: &GradStore) -> Result<()> {
        for ((_, var), sum) in adam.variables().iter().zip(&mut self.0) {
            if let Some(gradient) = store.get(var) {
                let gradient = gradient.detach();
                *sum = Some(match sum.take() {
                    Some(sum) => (sum + gradient)?,
                    None => gradient,
                });
            }
        }
        Ok(())
    }

    fn merge(&mut self, other: Gradients) -> Result<()> {
        for (sum, gradient) in self.0.iter_mut().zip(other.0) {
            *sum = self::sum(sum.take(), gradient)?;
        }
        Ok(())
    }

    /// The first parameter whose tensor is not finite.
    fn find_non_finite(&self, adam: &Adam) -> Result<Option<String>> {
        let named = adam.variables().iter().zip(&self.0).filter_map(|((name, _), g)| g.as_ref().map(|g| (name, g)));
        let (names, sums): (Vec<&String>, Vec<_>) = named.map(|(name, g)| (name, g.sum_all())).unzip();
        let sums: Vec<Tensor> = sums.into_iter().collect::<candle_core::Result<_>>()?;
        let sums: Vec<f64> = Tensor::stack(&sums, 0)?.to_dtype(DType::F64)?.to_vec1()?;
        Ok(names.into_iter().zip(sums).find(|(_, sum)| !sum.is_finite()).map(|(name, _)| name.clone()))
    }
}

impl Trainer {
    /// A run at step 0. `config` is resolved. Dead starts are drawn again.
    pub fn new(config: &Config, scene: &Scene, dtype: DType, device: &Device) -> Result<Trainer> {
        if !config.regularizer.kind.is_empty() {
            regularized::lattice(&config.regularizer).check_meets(scene, "regularizer.domain")?;
        }
        let mut redraws = vec![0; Model::roles(config).len()];
        let mut trainer =
            Trainer::with_model(config, scene, Model::init(config, &redraws, dtype, device)?, dtype, device)?;
        let first = trainer.chunk(0)?;
        let positions = positions_at(&trainer.model.coarse, &first.rays, &first.t_coarse)?.flatten(0, 1)?;
        loop {
            let dead = trainer.dead_fields(&positions)?;
            if dead.is_empty() {
                trainer.redraws = redraws;
                if !config.regularizer.kind.is_empty() {
                    trainer.check_duration(&config.regularizer, config.train.steps)?;
                }
                return Ok(trainer);
            }
            for field in dead {
                redraws[field] += 1;
                if redraws[field] > MOST_REDRAWS {
                    return Err(Error::Diverged(format!(
                        "{MOST_REDRAWS} draws of the {} field all start with under {} of densities positive; \
                         lower train.dead_start_share or change field.init",
                        Model::roles(config)[field],
                        config.train.dead_start_share
                    )));
                }
            }
            trainer.model = Model::init(config, &redraws, dtype, device)?;
            trainer.adam = Adam::new(trainer.model.variables())?;
        }
    }

    fn with_model(config: &Config, scene: &Scene, model: Model, dtype: DType, device: &Device) -> Result<Trainer> {
        Ok(Trainer {
            volume: Volume::of(scene),
            device: device.clone(),
            dtype,
            adam: Adam::new(model.variables())?,
            redraws: vec![0; model.fields().len()],
            model,
            batches: Batches::new(config, scene)?,
            step: 0,
            empty_steps: 0,
            revisions: Vec::new(),
            devices: Vec::new(),
            config: config.clone(),
        })
    }

    /// Fields whose share of positive densities at `positions` is under the configured one. Softplus has none: it is
    /// positive, and has a slope, everywhere.
    fn dead_fields(&self, positions: &Tensor) -> Result<Vec<usize>> {
        if self.config.field.density_activation == DensityActivation::Softplus {
            return Ok(Vec::new());
        }
        let mut dead = Vec::new();
        for (index, (_, field)) in self.model.fields().into_iter().enumerate() {
            let positive = field.frozen()?.raw_density(positions)?.gt(0f64)?.to_dtype(DType::F64)?;
            if positive.mean_all()?.to_scalar::<f64>()? < self.config.train.dead_start_share {
                dead.push(index);
            }
        }
        Ok(dead)
    }

    /// The resolved configuration.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The networks.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Steps finished.
    pub fn step_count(&self) -> u64 {
        self.step
    }

    /// How often each field (see [`Model::roles`]) was drawn again because it started dead.
    pub fn redraws(&self) -> &[u64] {
        &self.redraws
    }

    /// The whole batch of a step with the clean pass's random numbers.
    fn chunk(&mut self, step: u64) -> Result<Chunk> {
        let batch = self.batches.batch(step);
        let rays = batch.rays.to_tensors(self.dtype, &self.device)?;
        let target = Tensor::from_vec(batch.target, (rays.len(), 3), &self.device)?.to_dtype(self.dtype)?;
        let mut random = Random::new(self.config.seed, Stream::Jitter, step);
        self.draw_clean(rays, target, &mut random)
    }

    /// Draws jitter, density noise and inverse-CDF positions of a clean pass, in a fixed order.
    fn draw_clean(&self, rays: Rays, target: Tensor, random: &mut Random) -> Result<Chunk> {
        let sampling = &self.config.sampling;
        let (n, coarse, fine) = (rays.len(), sampling.coarse, sampling.fine);
        let (columns, fine_columns) = render::columns(&self.model.coarse, sampling);
        let (mip, (_, fine_samples)) = (self.config.method.is_mip(), self.config.samples());
        let jitter = match sampling.jitter {
            true => Some(random.uniform_tensor(&[n, columns], self.dtype, &self.device)?),
            false => None,
        };
        let (near, far) = self.volume.bounds;
        let t_coarse = sampling::stratified(near, far, n, columns, jitter.as_ref(), &rays.origins)?;
        let std = sampling.density_noise.expect("resolved");
        let mut noise = |samples: usize| -> Result<Option<Tensor>> {
            if std == 0.0 {
                return Ok(None);
            }
            Ok(Some((random.normal_tensor(&[n, samples], self.dtype, &self.device)? * std)?))
        };
        let noise_coarse = noise(coarse)?;
        let noise_fine = if fine > 0 { noise(fine_samples)? } else { None };
        let u = match (fine, sampling.jitter) {
            (0, _) => None,
            (_, true) => {
                let uniform = random.uniform_tensor(&[n, fine_columns], self.dtype, &self.device)?;
                Some(if mip { sampling::stratified_u(&uniform)? } else { uniform })
            }
            (_, false) => Some(sampling::even_u(n, fine_columns, &t_coarse)?),
        };
        Ok(Chunk { rays, target, t_coarse, noise_coarse, noise_fine, u, share: 1.0, index: 0 })
    }

    /// Takes one step. `log` asks for the diagnostics of the perturbed levels.
    pub fn step(&mut self, log: bool) -> Result<StepStats> {
        let whole = self.chunk(self.step)?;
        let ChunkResult { mut gradients, losses, diagnostics } = self.passes(&whole, log)?;
        let terms = match self.regularize(&self.config.regularizer)? {
            Some((values, pull)) => {
                gradients.merge(pull)?;
                Some(values)
            }
            None => None,
        };
        let (clean_weight, perturbed_weight) = mixing(&self.config);
        let [loss_coarse, loss_fine, loss_perturbed, largest_acc] = losses.read()?;
        let loss_coarse = loss_coarse.expect("every chunk has a coarse pass");
        let clean = self.coarse_weight(&self.model) * loss_coarse + loss_fine.unwrap_or(0.0);
        let mut loss = clean_weight * clean + loss_perturbed.map_or(0.0, |loss| perturbed_weight * loss);
        let mut regularizers = Vec::new();
        if let Some(values) = terms {
            let values = values.to_vec1::<f64>()?;
            loss +=
                self.config.regularizer.terms().zip(&values).map(|((_, weight), value)| weight * value).sum::<f64>();
            regularizers = self.config.regularizer.kind.iter().copied().zip(values).collect();
        }
        let stats = StepStats {
            step: self.step + 1,
            learning_rate: learning_rate(&self.config.train, self.step),
            loss_coarse,
            loss_fine,
            loss_perturbed,
            regularizers,
            loss,
            largest_acc: largest_acc.expect("every chunk has one"),
            levels: diagnostics.finish(clean),
        };
        self.check_finite(&stats, &gradients)?;
        self.check_alive(&stats)?;
        self.adam.update(&gradients.0, stats.learning_rate, stats.step)?;
        let parameters =
            Gradients(self.adam.variables().iter().map(|(_, var)| Some(var.as_detached_tensor())).collect());
        if let Some(name) = parameters.find_non_finite(&self.adam)? {
            return Err(self.non_finite(stats.step, &format!("parameter {name}")));
        }
        self.step += 1;
        Ok(stats)
    }

    /// All passes through the rays of a step, chunk by chunk.
    fn passes(&self, whole: &Chunk, log: bool) -> Result<ChunkResult> {
        let size = self.config.train.chunk;
        let starts: Vec<(usize, usize)> = (0..whole.rays.len()).step_by(size).enumerate().collect();
        let prepared = self.model.prepared()?;
        let work = |part: &[(usize, usize)]| -> Result<ChunkResult> {
            let model = prepared.recording()?;
            let mut sum: Option<ChunkResult> = None;
            for &(index, start) in part {
                let count = size.min(whole.rays.len() - start);
                let chunk = self.work(&model, &whole.narrow(index, start, count)?, log)?;
                match &mut sum {
                    Some(sum) => sum.add(chunk)?,
                    None => sum = Some(chunk),
                }
            }
            let mut sum = sum.expect("a part has chunks");
            sum.gradients.merge(Gradients(model.recorded()?))?;
            Ok(sum)
        };
        // One thread a part: a chunk's tensors stay in its core's cache. Parts are the same whatever
        // the number of threads, and the sums below are in their order: it changes no bit.
        let parts: Vec<&[(usize, usize)]> = starts.chunks(starts.len().div_ceil(PARTS)).collect();
        let parts: Result<Vec<ChunkResult>> = if self.device.is_cpu() {
            parts.into_par_iter().map(work).collect()
        } else {
            parts.into_iter().map(work).collect()
        };
        let mut parts = parts?.into_iter();
        let mut sum = parts.next().expect("a batch has rays");
        for part in parts {
            sum.add(part)?;
        }
        Ok(sum)
    }

    /// Everything that a step does with a chunk. Losses and gradients are
    /// weighted with the chunk's share, so that chunks add up.
    fn work(&self, model: &Model, chunk: &Chunk, log: bool) -> Result<ChunkResult> {
        let (clean_weight, perturbed_weight) = mixing(&self.config);
        let mut result = ChunkResult::new(self.adam.variables().len());
        let t_fine = self.clean(model, chunk, clean_weight, &mut result)?;
        if self.config.method.is_augmented() {
            let loss = if self.config.perturb.kind == PerturbKind::FreshJitter {
                self.second_clean(model, chunk, perturbed_weight, &mut result.gradients)?
            } else {
                self.perturbed(model, chunk, t_fine.as_ref(), perturbed_weight, (&mut result, log))?
            };
            result.losses.perturbed = Some(loss);
        }
        Ok(result)
    }

    /// Clean passes of a chunk; returns the fine pass's samples.
    fn clean(&self, model: &Model, chunk: &Chunk, weight: f64, result: &mut ChunkResult) -> Result<Option<Tensor>> {
        let coarse = clean_pass(&model.coarse, self.coarse_pass(chunk))?;
        let weight = weight * chunk.share;
        let coarse_weight = self.coarse_weight(model);
        let loss = self.descend(&coarse, &chunk.target, weight * coarse_weight, &mut result.gradients)?;
        result.losses.coarse = Some((loss * chunk.share)?);
        let (Some(field), Some(u)) = (model.fine(), &chunk.u) else {
            result.losses.largest_acc =
                Some(largest(&noiseless_acc(&model.coarse, &coarse, self.coarse_pass(chunk))?)?);
            return Ok(None);
        };
        let weights = &coarse.composite.weights;
        let t_vals = resample(&model.coarse, &self.config.sampling, &chunk.t_coarse, weights, u)?;
        drop(coarse);
        let fine = clean_pass(field, self.fine_pass(chunk, &t_vals))?;
        let loss = self.descend(&fine, &chunk.target, weight, &mut result.gradients)?;
        result.losses.fine = Some((loss * chunk.share)?);
        result.losses.largest_acc = Some(largest(&noiseless_acc(field, &fine, self.fine_pass(chunk, &t_vals))?)?);
        Ok(Some(t_vals))
    }

    /// Weight of the coarse pass's loss; 1 where it is the only pass.
    fn coarse_weight(&self, model: &Model) -> f64 {
        if model.fine().is_some() { self.config.train.coarse_weight } else { 1.0 }
    }

    fn coarse_pass<'a>(&self, chunk: &'a Chunk) -> Pass<'a> {
        Pass {
            rays: &chunk.rays,
            t_vals: &chunk.t_coarse,
            density_noise: chunk.noise_coarse.as_ref(),
            background: self.volume.background,
            positions: None,
        }
    }

    fn fine_pass<'a>(&self, chunk: &'a Chunk, t_vals: &'a Tensor) -> Pass<'a> {
        Pass { t_vals, density_noise: chunk.noise_fine.as_ref(), ..self.coarse_pass(chunk) }
    }

    /// Adds the gradients of `weight` times the photometric loss; returns the loss in f64.
    fn descend(&self, out: &PassOutput, target: &Tensor, weight: f64, gradients: &mut Gradients) -> Result<Tensor> {
        let loss = photometric_loss(&out.composite.rgb, target)?;
        gradients.add(&self.adam, &(&loss * weight)?.backward()?)?;
        Ok(loss.detach().to_dtype(DType::F64)?)
    }

    fn check_finite(&self, stats: &StepStats, gradients: &Gradients) -> Result<()> {
        let losses = [
            ("loss of the clean coarse pass", Some(stats.loss_coarse)),
            ("loss of the clean fine pass", stats.loss_fine),
            ("loss of the perturbed pass", stats.loss_perturbed),
        ];
        let passes = losses.into_iter().filter_map(|(name, loss)| loss.map(|loss| (name.to_string(), loss)));
        let terms = stats.regularizers.iter().map(|(term, value)| (format!("regularizer {}", term.name()), *value));
        let loss = passes.chain(terms).find(|(_, loss)| !loss.is_finite());
        let tensor = match loss {
            Some((name, _)) => Some(name),
            None => gradients.find_non_finite(&self.adam)?.map(|name| format!("gradient of {name}")),
        };
        tensor.map_or(Ok(()), |tensor| Err(self.non_finite(stats.step, &tensor)))
    }

    fn non_finite(&self, step: u64, tensor: &str) -> Error {
        Error::Diverged(format!(
            "training went non-finite at step {step}: the {tensor} is not a number; lower train.learning_rate ({}), \
             the step sizes of section perturb or regularizer.weight, and start a new run",
            self.config.train.learning_rate
        ))
    }

    fn check_alive(&mut self, stats: &StepStats) -> Result<()> {
        self.empty_steps = if stats.largest_acc < EMPTY_ACC { self.empty_steps + 1 } else { 0 };
        let limit = self.config.train.collapse_steps;
        if limit == 0 || self.empty_steps < limit {
            return Ok(());
        }
        Err(Error::Diverged(format!(
            "training collapsed at step {}: acc (accumulated weight) stayed under {EMPTY_ACC} on every ray for {} steps; \
             try another seed, a lower train.learning_rate, or precropping (train.precrop_steps); \
             train.collapse_steps = 0 switches this check off",
            stats.step, self.empty_steps
        )))
    }
}

/// Weights of clean and perturbed loss.
fn mixing(config: &Config) -> (f64, f64) {
    let lambda = config.perturb.lambda;
    match (config.method.is_augmented(), config.perturb.objective) {
        (false, _) => (1.0, 0.0),
        (true, Objective::Paper) => (1.0, lambda),
        (true, Objective::Released) => (1.0 - lambda, lambda),
    }
}

fn scalar(tensor: &Tensor) -> Result<f64> {
    Ok(tensor.to_dtype(DType::F64)?.to_scalar()?)
}

fn largest(tensor: &Tensor) -> Result<Tensor> {
    Ok(tensor.flatten_all()?.max(0)?.to_dtype(DType::F64)?)
}
