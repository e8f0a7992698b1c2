//! The learner of all field methods: its state, and what is added to it.

use std::sync::Arc;

use candle_core::{DType, Device, Tensor, Var};

use crate::base::machine::over_parts;
use crate::base::place::is_host;
use crate::base::rng::{Random, Stream};
use crate::base::{Error, Result};
use crate::data::{Camera, PointRays, RayGroup, RayParts, Scene, UnseenCameras};
use crate::field::Order;
use crate::field::settings::Encoding;
use crate::losses::{LossTerm, WeightedTerm};
use crate::methods::batches::Batches;
use crate::methods::diagnostics::site_columns;
use crate::methods::learner::{Learner, LogColumns, StepResult, StopCheck};
use crate::perturb::settings::{ChangedEntries, SecondPass};
use crate::perturb::{AttackGeometry, PaperSite, Site};
use crate::render::ray_parts;
use crate::render::settings::OccupancyConfig;
use crate::settings::Resolved;

use super::networks::Fields;
use super::plan::Plan;
use super::report::log_columns;
use super::{entries, step};

/// Trains the fields of one experiment on one scene.
pub struct FieldLearner {
    pub(super) config: Resolved,
    /// What a step consists of.
    pub(super) plan: Plan,
    /// The colour behind missing accumulation.
    pub(super) background: Option<[f32; 3]>,
    /// The geometry of the constraint sets.
    pub(super) geometry: AttackGeometry,
    pub(super) device: Device,
    pub(super) dtype: DType,
    pub(super) fields: Fields,
    pub(super) variables: Vec<(String, Var)>,
    pub(super) batches: Batches,
    /// Terms of the loss next to the photometric ones.
    pub(super) terms: Vec<WeightedTerm>,
    /// Cameras without photographs, if a term reads their rays.
    pub(super) unseen: Option<UnseenCameras>,
    /// The training views' rays to points.
    pub(super) points: PointRays,
}

impl FieldLearner {
    /// Creates a learner of `fields` on the training views of `scene`.
    pub fn new(
        config: &Resolved,
        scene: &Scene,
        fields: Fields,
        dtype: DType,
        device: &Device,
    ) -> Result<FieldLearner> {
        check_device(config, dtype, device)?;
        let tangents = config.method.is_augmented() && config.perturb[PaperSite::View].on();
        let terms = WeightedTerm::all(&config.regularizer);
        let mut learner = FieldLearner {
            config: config.clone(),
            plan: Plan::of(config),
            background: scene.background,
            geometry: AttackGeometry::new(config, scene),
            device: device.clone(),
            dtype,
            batches: Batches::new(config, scene, RayParts { tangents, ..ray_parts(fields.coarse()) })?,
            variables: fields.variables(),
            fields,
            terms: Vec::new(),
            unseen: None,
            points: PointRays::of(scene, config.data.origin_of_pixels()),
        };
        learner.place_unseen_cameras(&terms)?;
        learner.terms = terms;
        Ok(learner)
    }

    /// Makes the cameras of unseen rays if terms read such rays. See [`unseen_cameras`].
    pub(super) fn place_unseen_cameras(&mut self, terms: &[WeightedTerm]) -> Result<()> {
        let cameras = unseen_cameras(&self.config, self.batches.cameras(), &self.points, terms)?;
        self.unseen = cameras.or(self.unseen.take());
        Ok(())
    }

    /// Returns an error for a term that needs what these fields lack.
    pub(super) fn check_term(&self, term: &LossTerm) -> Result<()> {
        let reads_derivatives = match term {
            LossTerm::InSpace(_) => true,
            LossTerm::OnRays(term, _) => term.reads_slopes(),
            LossTerm::OnTables(_) => false,
        };
        if reads_derivatives && !self.config.representation().has_derivatives_at_points() {
            return Err(Error::Config(format!(
                "the term '{}' needs density's derivatives at points, which method {} lacks; use nerf or aug-nerf",
                term.name(),
                self.config.method.name()
            )));
        }
        let reads_laplacian = matches!(term, LossTerm::InSpace(term) if term.order() == Order::Laplacian);
        if reads_laplacian && !self.config.field.has_laplacian() {
            let name = term.name();
            return Err(Error::Config(format!(
                "the term '{name}' needs density's Laplacian, which a linear hash grid lacks; set field.hash.interpolation = \"smoothstep\""
            )));
        }
        if matches!(term, LossTerm::OnTables(_)) && self.config.field.encoding != Encoding::Hash {
            let name = term.name();
            return Err(Error::Config(format!(
                "the term '{name}' needs the tables of a hash grid; set field.encoding = \"hash\""
            )));
        }
        Ok(())
    }

    /// Returns the fields that are trained.
    pub fn fields(&self) -> &Fields {
        &self.fields
    }
}

impl Learner for FieldLearner {
    fn columns(&self) -> LogColumns {
        let terms = self.terms.iter().map(|WeightedTerm { term, .. }| term.name());
        let mut columns = log_columns(&self.config, &self.plan, terms);
        columns.further.extend(self.plan.user_sites().flat_map(|site| site_columns(site.name())));
        if self.config.method.is_augmented() && entries::are_separate(self) {
            columns.further.push(entries::ONLY_SECOND.into());
        }
        columns
    }

    fn add_term(&mut self, term: LossTerm, weight: f64) -> Result<()> {
        if self.terms.iter().any(|other| other.term.name() == term.name()) {
            let name = term.name();
            return Err(Error::Config(format!("the loss already has a term '{name}'; rename the new one")));
        }
        self.check_term(&term)?;
        let term = WeightedTerm::constant(term, weight);
        self.place_unseen_cameras(std::slice::from_ref(&term))?;
        self.terms.push(term);
        Ok(())
    }

    fn add_site(&mut self, site: Arc<dyn Site>) -> Result<()> {
        let (name, at) = (site.name(), site.at());
        let refuse = |why: &str| Err(Error::Config(format!("the site '{name}' cannot be added: {why}")));
        let perturb = &self.config.perturb;
        if !self.config.method.is_augmented() || !perturb.second.perturbs() {
            return refuse(
                "no pass of this training is perturbed; use --method aug-nerf and a perturb.kind with deltas",
            );
        }
        if perturb.second == SecondPass::Permuted {
            return refuse(
                "perturb.kind = \"permuted\" gives rays each other's deltas, and an own delta need not have rays",
            );
        }
        if name.is_empty()
            || !name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_' || c == '-')
        {
            return refuse(
                "its name must have lower-case letters, digits, '_' and '-' alone, because it names columns of the logs",
            );
        }
        if PaperSite::of_name(name).is_some() || self.plan.user_sites().any(|other| other.name() == name) {
            return refuse("there is a site of that name; rename it");
        }
        if at == PaperSite::View && !perturb[PaperSite::View].on() {
            return refuse("rays have tangents at view only if the site view is on; set perturb.view.passes");
        }
        self.plan.add_site(&site);
        Ok(())
    }

    fn has_colours(&self) -> bool {
        true
    }

    fn colours(&mut self, step: u64) -> Result<Option<Tensor>> {
        let fields = self.fields.at_step(&self.config, step)?.frozen()?;
        let rays = self.batches.batch(step).rays.to_tensors(self.dtype, &self.device)?;
        let size = self.config.train.chunk;
        let evaluation = fields.evaluation(&self.config.sampling, self.geometry.bounds, self.background);
        let starts: Vec<usize> = (0..rays.len()).step_by(size).collect();
        let colours_of_part = |starts: &[usize]| -> Result<Tensor> {
            Ok(evaluation.render(&rays.narrow(starts[0], size.min(rays.len() - starts[0]))?)?.rgb)
        };
        Ok(Some(Tensor::cat(&over_parts(&self.device, &starts, 1, colours_of_part)?, 0)?))
    }

    fn updated(&mut self, finished: u64) -> Result<()> {
        let OccupancyConfig { refresh, warmup, .. } = self.config.sampling.occupancy;
        let Some(occupancy) = self.fields.occupancy().filter(|_| finished.is_multiple_of(refresh)) else {
            return Ok(());
        };
        let field = self.fields.at_step(&self.config, finished)?.evaluated().frozen()?;
        let mut random = Random::new(self.config.seed, Stream::Occupancy, finished);
        occupancy.update(&field, self.geometry.bounds, finished < warmup, &mut random)
    }

    fn step(&mut self, step: u64, log: bool, stop_check: &StopCheck) -> Result<StepResult> {
        step::step(self, step, log, stop_check)
    }
}

/// Returns the cameras of unseen rays if terms read such rays.
///
/// # Errors
/// There are no such cameras, no points, or fewer rays than terms read at once.
pub(super) fn unseen_cameras(
    config: &Resolved,
    cameras: &[Camera],
    points: &PointRays,
    terms: &[WeightedTerm],
) -> Result<Option<UnseenCameras>> {
    let needs_cameras = |group: &RayGroup| *group != RayGroup::Point;
    let groups = LossTerm::unseen_groups(terms.iter().map(|term| &term.term));
    let unseen =
        groups.iter().any(needs_cameras).then(|| UnseenCameras::of(cameras, config.unseen_poses)).transpose()?;
    groups.into_iter().try_for_each(|group| {
        if config.unseen_rays < group.rays() {
            return Err(Error::Config(format!(
                "a term of the loss reads {} unseen rays at once, and regularizer.unseen_rays is {}; raise it, or train.rays",
                group.rays(),
                config.unseen_rays
            )));
        }
        if group == RayGroup::Point && points.count() == 0 {
            return Err(Error::Config(
                "a term of the loss, such as regularizer.kind=sparse-depth, reads depth at points of a COLMAP model, and this scene \
                 has none; take a COLMAP scene with its points, or another term"
                    .into(),
            ));
        }
        unseen.as_ref().filter(|_| needs_cameras(&group)).map_or(Ok(()), |cameras| cameras.check(group))
    })?;
    Ok(unseen)
}

/// Returns an error for clean entries where they are not recorded.
pub(super) fn check_device(config: &Resolved, dtype: DType, device: &Device) -> Result<()> {
    let masks = config.method.is_augmented() && config.perturb.entries == ChangedEntries::Clean;
    if masks && !(is_host(device) && dtype == DType::F32) {
        let message = "perturb.entries = \"clean\" needs --device cpu in single precision";
        return Err(Error::Config(message.into()));
    }
    Ok(())
}
