//! The learner of all field methods: its state, its start and its step.

use candle_core::{DType, Device, Tensor, Var};

use crate::augment::PixelScale;
use crate::base::{Error, Result};
use crate::data::{RayParts, Scene};
use crate::losses::{LossTerm, WeightedTerm};
use crate::methods::batches::Batches;
use crate::methods::learner::{Learned, Learner, LogColumns, Term};
use crate::render::{positions_at, ray_parts};
use crate::settings::{DensityActivation, LEVELS, Level, PerturbKind, Resolved};

use super::diagnostics;
use super::networks::Fields;
use super::passes::mixing;
use super::regularized;
use super::results::ChunkResult;
use super::terms;

/// Times that a dead start is drawn again before the configuration is blamed.
const MOST_REDRAWS: u64 = 100;

/// Trains the fields of one experiment on one scene.
pub struct FieldLearner {
    pub(super) config: Resolved,
    /// Start and end of a ray's interval, in units of `t_vals`.
    pub(super) bounds: (f64, f64),
    /// Fills missing accumulation.
    pub(super) background: Option<[f32; 3]>,
    /// A pixel's size.
    pub(super) pixel: PixelScale,
    pub(super) device: Device,
    pub(super) dtype: DType,
    pub(super) fields: Fields,
    pub(super) variables: Vec<(String, Var)>,
    pub(super) batches: Batches,
    /// What the loss has beside the photometric ones.
    pub(super) terms: Vec<WeightedTerm>,
}

impl FieldLearner {
    /// Goes on with `fields` on the training views of `scene`.
    pub fn new(
        config: &Resolved,
        scene: &Scene,
        fields: Fields,
        dtype: DType,
        device: &Device,
    ) -> Result<FieldLearner> {
        let tangents = config.method.is_augmented() && config.perturb.delta(Level::View).on();
        Ok(FieldLearner {
            config: config.clone(),
            bounds: scene.bounds(),
            background: scene.background,
            pixel: PixelScale::of(scene),
            device: device.clone(),
            dtype,
            batches: Batches::new(config, scene, RayParts { tangents, ..ray_parts(&fields.coarse) })?,
            variables: fields.variables(),
            fields,
            terms: WeightedTerm::all(&config.regularizer),
        })
    }

    /// Draws the fields of a run, dead starts again. Returns how often each field of [`Fields::roles`] was drawn again,
    /// too.
    pub fn start(config: &Resolved, scene: &Scene, dtype: DType, device: &Device) -> Result<(FieldLearner, Vec<u64>)> {
        if config.regularizer.has_space_terms() {
            regularized::lattice(&config.regularizer).check_meets(scene, "regularizer.domain")?;
        }
        let mut redraws = vec![0; Fields::roles(config).len()];
        let fields = Fields::init(config, &redraws, dtype, device)?;
        let mut learner = FieldLearner::new(config, scene, fields, dtype, device)?;
        let first = learner.draw(0)?;
        let positions = positions_at(&learner.fields.coarse, &first.rays, &first.t_coarse)?.flatten(0, 1)?;
        loop {
            let dead = learner.dead_fields(&positions)?;
            if dead.is_empty() {
                break;
            }
            for field in dead {
                redraws[field] += 1;
                if redraws[field] > MOST_REDRAWS {
                    return Err(Error::Diverged(format!(
                        "{MOST_REDRAWS} draws of the {} field all start with under {} of densities positive; \
                         lower train.dead_start_share or change field.init",
                        Fields::roles(config)[field],
                        config.train.dead_start_share
                    )));
                }
            }
            learner.fields = Fields::init(config, &redraws, dtype, device)?;
            learner.variables = learner.fields.variables();
        }
        learner.check_duration(&learner.terms, &config.regularizer, config.train.steps)?;
        Ok((learner, redraws))
    }

    /// The fields that learn.
    pub fn fields(&self) -> &Fields {
        &self.fields
    }

    /// Fields whose share of positive densities at `positions` is under the configured one. Softplus has none: it is
    /// positive, and has a slope, everywhere.
    fn dead_fields(&self, positions: &Tensor) -> Result<Vec<usize>> {
        if self.config.field.density_activation == DensityActivation::Softplus {
            return Ok(Vec::new());
        }
        let mut dead = Vec::new();
        for (index, (_, field)) in self.fields.by_role().into_iter().enumerate() {
            let positive = field.frozen()?.raw_density(positions)?.gt(0f64)?.to_dtype(DType::F64)?;
            if positive.mean_all()?.to_scalar::<f64>()? < self.config.train.dead_start_share {
                dead.push(index);
            }
        }
        Ok(dead)
    }

    /// The weighted terms of a step and their sum, from the losses of its passes and of its regularizers.
    fn terms(&self, [coarse, fine, perturbed]: [Option<f64>; 3], regularizers: Vec<f64>) -> (Vec<Term>, f64) {
        let (clean_weight, perturbed_weight) = mixing(&self.config);
        let coarse_weight = self.coarse_weight(&self.fields);
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
        if !regularizers.is_empty() {
            let of_term = |(WeightedTerm { term, weight }, value): (&WeightedTerm, f64)| Term {
                name: format!("regularizer.{}", term.name()),
                described: format!("regularizer {}", term.name()),
                value,
                weight: *weight,
            };
            let regularizers: Vec<Term> = self.terms.iter().zip(regularizers).map(of_term).collect();
            loss += regularizers.iter().map(|term| term.weight * term.value).sum::<f64>();
            terms.extend(regularizers);
        }
        (terms, loss)
    }
}

impl Learner for FieldLearner {
    fn columns(&self) -> LogColumns {
        let config = &self.config;
        let mut photometric = vec!["loss_coarse".to_string()];
        if config.sampling.fine > 0 {
            photometric.push("loss_fine".into());
        }
        let mut further: Vec<String> =
            self.terms.iter().map(|WeightedTerm { term, .. }| format!("regularizer.{}", term.name())).collect();
        if config.method.is_augmented() {
            further.push("loss_perturbed".into());
            if config.perturb.kind != PerturbKind::FreshJitter {
                let on = LEVELS.into_iter().filter(|&level| config.perturb.delta(level).on());
                further.extend(on.flat_map(diagnostics::columns));
            }
        }
        LogColumns { photometric, further }
    }

    fn add_term(&mut self, term: LossTerm, weight: f64) -> Result<()> {
        if self.terms.iter().any(|known| known.term.name() == term.name()) {
            let name = term.name();
            return Err(Error::Config(format!("the loss has a term '{name}' already; give the new one another name")));
        }
        if matches!(term, LossTerm::InSpace(_)) && !self.config.method.representation().has_derivatives_at_points() {
            return Err(Error::Config(format!(
                "the term '{}' is made of density's derivatives at points, which method {} has not; use nerf or aug-nerf",
                term.name(),
                self.config.method.name()
            )));
        }
        self.terms.push(WeightedTerm { term, weight });
        Ok(())
    }

    fn learn(&mut self, step: u64, log: bool) -> Result<Learned> {
        let whole = self.draw(step)?;
        let ChunkResult { mut gradients, losses, diagnostics } = self.passes(&whole, self.step_loss(), log)?;
        let mut in_space = Vec::new();
        if let Some((values, pull)) = self.regularize(&terms::in_space(&self.terms), &self.config.regularizer, step)? {
            gradients.merge(pull)?;
            in_space = values.to_vec1::<f64>()?;
        }
        let on_rays = losses.on_rays.as_ref().map_or(Ok(Vec::new()), |values| values.to_vec1::<f64>())?;
        let regularizers = terms::in_order(&self.terms, &on_rays, &in_space);
        let [coarse, fine, perturbed, largest_acc] = losses.read()?;
        let coarse = coarse.expect("every chunk has a coarse pass");
        let clean = self.coarse_weight(&self.fields) * coarse + fine.unwrap_or(0.0);
        let (terms, loss) = self.terms([Some(coarse), fine, perturbed], regularizers);
        Ok(Learned {
            gradients,
            terms,
            loss,
            mse: fine.unwrap_or(coarse),
            largest_acc: largest_acc.expect("every chunk has one"),
            levels: diagnostics.finish(clean),
        })
    }
}
