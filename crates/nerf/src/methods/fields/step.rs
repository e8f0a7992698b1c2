//! One training step of fields, from top to bottom as algorithm 1 of the Aug-NeRF paper. The [`Plan`](super::Plan) says which
//! passes it has. Its lines, whose numbers stand below:
//!
//! | lines | what they do |
//! |---|---|
//! | 3 | draw rays |
//! | 4 | search the deltas of all sites by PGD |
//! | 6, 7 | place coarse samples in even bins, with jitter, and fine ones by the coarse weights |
//! | 9 to 13 | query the field at each sample, and at perturbed ones with their deltas |
//! | 16 to 20 | render both |
//! | 22 | the loss: squared error of the clean colours, plus lambda times that of the perturbed ones |
//! | 23 | update the parameters |
//!
//! Clean passes come first; a perturbed pass and its search repeat one of them. Each pass is searched by its own loss.
//! Fine samples are placed without a graph, so coarse deltas have no gradient in the fine loss: two searches follow the gradient
//! of the joint loss.
//!
//! No scalar holds the whole loss: the gradients of its parts are added.
//!
//! Rays are processed in chunks whose gradients are added. The chunk bounds memory, and small chunks stay in a CPU's cache.

use candle_core::{DType, Tensor};

use crate::base::Result;
use crate::base::machine::over_parts;
use crate::base::rng::{Random, Stream};
use crate::data::RayGroup;
use crate::field::Field;
use crate::losses::{LossTerm, TermSource, WeightedTerm};
use crate::methods::Extremes;
use crate::methods::gradients::Gradients;
use crate::methods::learner::{StepResult, StopCheck};
use crate::perturb::settings::SecondPass;
use crate::perturb::{Deltas, Distribution, PassGeometry, Sets};
use crate::render::{
    self, Pass, Perturbation, PlacedSamples, clean_pass, noiseless_acc, perturbed_pass, photometric_loss, resample,
    sample_count, t_vals_by_density,
};

use super::diagnosis::diagnose;
use super::entries::{ONLY_SECOND, table_gradients};
use super::learner::FieldLearner;
use super::networks::Fields;
use super::plan::{DeltaPlan, PassPlan, Plan, SampleSource};
use super::rays::StepRays;
use super::space::{space_terms, table_terms};
use super::sums::{Sums, plus};
use super::terms::{RayTerms, in_space};

/// Number of parts of a step, which threads share. Each sums its gradients in place.
const PARTS: usize = 16;

/// Returns the number of parts of a step with this many chunks.
pub fn parts(chunks: usize) -> usize {
    chunks.div_ceil(chunks.div_ceil(PARTS).max(1))
}

/// Computes the loss of the step after `step` finished ones, and its gradients. Adam then updates the
/// parameters (line 23).
pub(super) fn step(learner: &mut FieldLearner, step: u64, log: bool, stop_check: &StopCheck) -> Result<StepResult> {
    learner.fields = learner.fields.at_step(&learner.config, step)?;
    // Line 3: rays with their colours, and all random numbers of their clean passes.
    let batch = StepRays::batch(learner, step)?;
    let learner = &*learner;
    let (plan, config) = (&learner.plan, &learner.config);
    let terms: Vec<WeightedTerm> = learner.terms.iter().map(|term| term.at(step)).collect();
    let mut further: Vec<(&str, f64, f64)> =
        terms.iter().map(|WeightedTerm { term, weight, .. }| (term.name(), *weight, f64::NAN)).collect();
    // Fills in the values of all terms of a source, in their order.
    let mut fill = |source: TermSource, measured: &[f64]| {
        let filled = terms.iter().zip(&mut further).filter(|(term, _)| term.term.source() == source);
        filled.zip(measured).for_each(|((_, (.., value)), measured)| *value = *measured);
    };

    // Lines 4 to 22.
    let passes = StepPasses {
        learner,
        clean: &plan.clean,
        second: &plan.second,
        loss_weights: plan.loss_weights(step),
        terms: &terms,
        source: TermSource::TrainingRays,
        log,
        stop_check,
    };
    let Sums { mut gradients, losses, on_rays, extremes, only_second, diagnostics, .. } = passes.over(&batch)?;
    fill(TermSource::TrainingRays, &on_rays);

    // Terms that the paper's line 22 has not: on rays without photographs, in space, and on tables.
    for group in LossTerm::unseen_groups(terms.iter().map(|term| &term.term)) {
        let unseen = on_unseen(passes, group, step)?;
        gradients.merge(unseen.gradients)?;
        fill(TermSource::UnseenRays(group), &unseen.on_rays);
    }
    if let Some((space_values, space_gradients)) =
        space_terms(learner, &in_space(&terms), &config.regularizer, step, stop_check)?
    {
        gradients.merge(space_gradients)?;
        fill(TermSource::Space, &space_values.to_vec1::<f64>()?);
    }
    for WeightedTerm { term, weight, .. } in &terms {
        if let LossTerm::OnTables(term) = term {
            let (value, decay_gradients) = table_terms(learner, *term, *weight, &config.regularizer, &gradients)?;
            gradients.merge(decay_gradients)?;
            fill(TermSource::Tables, &[value]);
        }
    }

    let extremes = extremes.expect("every chunk has a pass that is evaluated");
    let sites = |clean| diagnostics.map_or_else(Vec::new, |sums| sums.finish(clean));
    let mut report = losses.report(plan, step, &further, extremes, sites);
    report.weight_columns.extend(only_second.map(|fraction| (ONLY_SECOND.to_string(), fraction)));
    Ok(StepResult { gradients, report })
}

/// Runs the clean passes of a step's rays without photographs, in such groups.
pub(super) fn on_unseen(passes: StepPasses, group: RayGroup, step: u64) -> Result<Sums> {
    let passes = StepPasses { second: &[], source: TermSource::UnseenRays(group), log: false, ..passes };
    let clean = Plan::unseen(passes.clean, |pass| passes.terms_of(pass).any_counts());
    StepPasses { clean: &clean, ..passes }.over(&StepRays::unseen(passes.learner, group, step)?)
}

/// The passes of a step over its rays, and what they minimize.
#[derive(Clone, Copy)]
pub(super) struct StepPasses<'a> {
    pub(super) learner: &'a FieldLearner,
    /// See [`Plan`].
    pub(super) clean: &'a [PassPlan],
    pub(super) second: &'a [PassPlan],
    /// Factors of the photometric losses of both.
    pub(super) loss_weights: (f64, f64),
    /// Further terms, of which those of `source` count.
    pub(super) terms: &'a [WeightedTerm],
    /// The rays: a step's own, or unseen ones.
    pub(super) source: TermSource,
    /// Requests diagnostics.
    pub(super) log: bool,
    pub(super) stop_check: &'a StopCheck<'a>,
}

/// The samples of a pass, and their weights along the ray, both without graph.
struct SampleWeights {
    samples: PlacedSamples,
    weights: Tensor,
}

impl<'a> StepPasses<'a> {
    /// Runs them over all rays of a step.
    pub(super) fn over(&self, batch: &StepRays) -> Result<Sums> {
        let learner = self.learner;
        // The rays of a group stay in one chunk.
        let group_size = if let TermSource::UnseenRays(group) = self.source { group.rays() } else { 1 };
        let chunk_size = (learner.config.train.chunk / group_size).max(1) * group_size;
        let starts: Vec<(usize, usize)> = (0..batch.rays.len()).step_by(chunk_size).enumerate().collect();
        let prepared = learner.fields.prepared()?;
        let sums_of_part = |part: &[(usize, usize)]| -> Result<Sums> {
            let fields = prepared.recording()?;
            let mut sums = Sums::new(learner.variables.len());
            for &(index, start) in part {
                (self.stop_check)()?;
                let count = chunk_size.min(batch.rays.len() - start);
                sums.add(self.over_chunk(&fields, &batch.narrow(index, start, count)?)?)?;
            }
            sums.gradients.merge(Gradients(fields.recorded()?))?;
            Ok(sums)
        };
        // One thread per part, so that a chunk's tensors stay in its core's cache. Parts do not depend on the number of
        // threads, and the sums below are in their order. The bits are always the same.
        let mut sums = Sums::sum(over_parts(&learner.device, &starts, starts.len().div_ceil(PARTS), sums_of_part)?)?;
        let records = std::mem::take(&mut sums.tables);
        let (gradients_of_tables, only_second) = table_gradients(learner, &records, self.log)?;
        sums.gradients.merge(gradients_of_tables)?;
        Ok(Sums { only_second, ..sums })
    }

    /// Runs them over a chunk. Losses and gradients are weighted with its fraction of the rays, so that chunks add up.
    fn over_chunk(&self, fields: &Fields, chunk: &StepRays) -> Result<Sums> {
        let (clean_weight, second_weight) = self.loss_weights;
        let mut sums = Sums::new(self.learner.variables.len()).with_diagnostics(self.log);
        let mut clean: Vec<SampleWeights> = Vec::new();
        for plan in self.clean {
            let samples = self.samples(plan, fields, chunk, clean.last(), None)?;
            clean.push(self.train_clean(plan, fields, chunk, samples, clean_weight, &mut sums)?);
        }
        sums.add_tables(fields.table_records());
        // Clean passes that follow clean ones have random numbers of their own.
        let redrawn = match self.second {
            [PassPlan { deltas: None, .. }, ..] => Some(chunk.redrawn(self.learner)?),
            _ => None,
        };
        let chunk = redrawn.as_ref().unwrap_or(chunk);
        let mut control = Sums::new(self.learner.variables.len());
        let mut second: Vec<SampleWeights> = Vec::new();
        for (plan, clean_samples) in self.second.iter().zip(&clean) {
            let samples = self.samples(plan, fields, chunk, second.last(), Some(clean_samples))?;
            second.push(match &plan.deltas {
                Some(delta_plan) => self.train_perturbed(plan, delta_plan, fields, chunk, samples, &mut sums)?,
                None => self.train_clean(plan, fields, chunk, samples, second_weight, &mut control)?,
            });
        }
        let mut second_records = fields.table_records();
        second_records.iter_mut().flatten().for_each(|record| record.is_of_second_pass = true);
        sums.add_tables(second_records);
        sums.gradients.merge(control.gradients)?;
        let coarse = control.losses.coarse.map(|loss| loss * self.clean[0].weight);
        sums.losses.perturbed = plus(sums.losses.perturbed, plus(coarse, control.losses.fine));
        Ok(sums)
    }

    /// Returns the samples of a pass (lines 6 and 7). `coarse` is the coarse pass before it in the same list, and `clean`
    /// the clean pass that a second pass repeats.
    fn samples(
        &self,
        plan: &PassPlan,
        fields: &Fields,
        chunk: &StepRays,
        coarse: Option<&SampleWeights>,
        clean: Option<&SampleWeights>,
    ) -> Result<PlacedSamples> {
        let sampling = &self.learner.config.sampling;
        let t_vals = match plan.samples {
            SampleSource::Stratified => chunk.t_coarse().clone(),
            SampleSource::Resampled => {
                let SampleWeights { samples, weights } = coarse.expect("the coarse pass comes first");
                resample(fields.coarse(), sampling, &samples.t_vals, weights, chunk.u())?
            }
            SampleSource::PlacedByDensity => {
                t_vals_by_density(&fields.coarse().frozen()?, &chunk.rays, chunk.t_coarse(), sampling, chunk.u())?
            }
            SampleSource::Occupied => {
                let occupancy = fields.occupancy().expect("the plan asks for cells that there are");
                return occupancy.place(&self.field(fields, plan).frozen()?, &chunk.rays, chunk.intervals());
            }
            SampleSource::OfCleanPass => return Ok(clean.expect("clean passes come first").samples.clone()),
        };
        Ok(PlacedSamples::all(t_vals))
    }

    fn field<'b>(&self, fields: &'b Fields, plan: &PassPlan) -> &'b Field {
        fields.get(plan.field).expect("the plan names fields that there are")
    }

    fn terms_of(&self, plan: &PassPlan) -> RayTerms<'a> {
        RayTerms::of(self.terms, self.source, plan)
    }

    /// Runs a clean pass (lines 10, 11, 17 and 19), and adds the gradients of `weight` times its loss and of the terms on its
    /// rays, in one backward pass. Losses are added times the chunk's fraction, and those of terms unweighted.
    fn train_clean(
        &self,
        plan: &PassPlan,
        fields: &Fields,
        chunk: &StepRays,
        samples: PlacedSamples,
        weight: f64,
        sums: &mut Sums,
    ) -> Result<SampleWeights> {
        let (learner, field, terms) = (self.learner, self.field(fields, plan), self.terms_of(plan));
        let pass = chunk.pass(learner, plan, &samples);
        let weight = weight * chunk.fraction * plan.weight;
        let out = clean_pass(field, pass)?;
        let Some(target) = &chunk.target else {
            terms.descend(learner, (field, pass), &out, None, chunk, sums)?;
            return Ok(SampleWeights { weights: out.composite.weights.detach(), samples });
        };
        let loss = photometric_loss(&out.composite.rgb, target)?;
        if terms.any_counts() {
            terms.descend(learner, (field, pass), &out, Some(&(&loss * weight)?), chunk, sums)?;
        } else {
            sums.gradients.add(&learner.variables, &(&loss * weight)?.backward()?)?;
        }
        let loss = loss.to_dtype(DType::F64)?.to_scalar::<f64>()? * chunk.fraction;
        *(if plan.is_coarse { &mut sums.losses.coarse } else { &mut sums.losses.fine }) = Some(loss);
        if plan.is_evaluated {
            let acc = noiseless_acc(field, &out, pass)?;
            sums.extremes = Some(Extremes::of(&acc, &out.composite.rgb, target)?);
        }
        Ok(SampleWeights { weights: out.composite.weights.detach(), samples })
    }

    /// Finds the deltas of a perturbed pass (line 4), runs it (lines 9 to 13, 18 and 20), and adds the gradients of its loss,
    /// with its weight in the step.
    fn train_perturbed(
        &self,
        plan: &PassPlan,
        delta_plan: &DeltaPlan,
        fields: &Fields,
        chunk: &StepRays,
        samples: PlacedSamples,
        sums: &mut Sums,
    ) -> Result<SampleWeights> {
        let (learner, field) = (self.learner, self.field(fields, plan));
        let pass = chunk.pass(learner, plan, &samples);
        let (t_vals, count, is_coarse) = (&samples.t_vals, sample_count(field, &samples.t_vals)?, plan.is_coarse);
        let direction_norm = &pass.rays.direction_norm;
        let geometry = PassGeometry { run: learner.geometry, is_coarse, t_vals, samples: count, direction_norm };
        let sets = Sets::new(delta_plan.sites.iter().cloned(), &geometry)?;
        let target = chunk.target.as_ref().expect("training rays have colours");
        let perturbed = PerturbedPass { learner, plan, delta_plan, chunk, field, pass, target, sets };
        let deltas = perturbed.deltas()?;
        let out = perturbed_pass(field, pass, perturbed.perturbation(&deltas))?;
        if let Some(diagnostics) = &mut sums.diagnostics {
            diagnose(&perturbed, &out.used, diagnostics)?;
        }
        let loss = photometric_loss(&out.composite.rgb, target)?;
        let weight = chunk.fraction * plan.weight;
        sums.gradients.add(&learner.variables, &(&loss * (self.loss_weights.1 * weight))?.backward()?)?;
        let loss = loss.to_dtype(DType::F64)?.to_scalar::<f64>()? * weight;
        sums.losses.perturbed = plus(sums.losses.perturbed, Some(loss));
        let samples = PlacedSamples { t_vals: out.t_vals, queried: samples.queried.clone() };
        Ok(SampleWeights { samples, weights: out.composite.weights.detach() })
    }
}

/// A perturbed pass of a chunk, and the sets of its deltas.
pub(super) struct PerturbedPass<'a> {
    pub(super) learner: &'a FieldLearner,
    pub(super) plan: &'a PassPlan,
    pub(super) delta_plan: &'a DeltaPlan,
    pub(super) chunk: &'a StepRays,
    pub(super) field: &'a Field,
    pub(super) pass: Pass<'a>,
    pub(super) target: &'a Tensor,
    sets: Sets,
}

impl PerturbedPass<'_> {
    pub(super) fn perturbation<'a>(&'a self, deltas: &'a Deltas) -> Perturbation<'a> {
        let perturb = &self.learner.config.perturb;
        Perturbation { deltas, sets: &self.sets, injection_layer: perturb.injection_layer, output: perturb.output }
    }

    /// Number of the pass within the step. Each has its own random numbers.
    fn number(&self) -> u64 {
        2 * self.chunk.index + u64::from(self.plan.is_coarse)
    }

    /// Returns a random point of every set. Each site has its own numbers of `stream`.
    pub(super) fn draw(&self, distribution: Distribution, stream: Stream) -> Result<Deltas> {
        let random = |part| Random::part(self.learner.config.seed, stream, self.chunk.step, part);
        self.sets.draw(distribution, self.number(), random)
    }

    /// Returns random or worst-case deltas, detached.
    fn deltas(&self) -> Result<Deltas> {
        match self.delta_plan.source {
            SecondPass::FreshJitter => Ok(Deltas::default()),
            SecondPass::Gaussian => self.draw(Distribution::Gaussian, Stream::Search),
            SecondPass::Uniform => self.draw(Distribution::Uniform, Stream::Search),
            SecondPass::WorstCase => self.search(1.0),
            SecondPass::BestCase => self.search(-1.0),
            SecondPass::Permuted => {
                let seed = self.learner.config.seed;
                let mut random = Random::part(seed, Stream::Permutation, self.chunk.step, self.number());
                self.sets.permuted(&self.search(1.0)?, self.pass.rays.len(), &mut random)
            }
        }
    }

    /// Runs PGD from a random start, on the loss times `sign`.
    fn search(&self, sign: f64) -> Result<Deltas> {
        let start = self.draw(Distribution::Uniform, Stream::Search)?;
        let field = self.field.frozen()?;
        // Scaled gradients are for parameters, not for deltas.
        let pass = Pass { scales_gradients: false, ..self.pass };
        render::search(&field, pass, self.perturbation(&start), self.target, sign)
    }
}
