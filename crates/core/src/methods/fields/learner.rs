//! The learner of all field methods: its state. Start, step and the parts of the step are in files of their own.

use std::sync::Arc;

use candle_core::{DType, Device, Var};

use crate::base::place::is_host;
use crate::base::{Error, Result};
use crate::data::{PointRays, RayParts, Scene, UnseenCameras};
use crate::losses::WeightedTerm;
use crate::methods::batches::Batches;
use crate::perturb::{PaperSite, Site};
use crate::render::ray_parts;
use crate::settings::{ChangedEntries, Encoding, Resolved};

use super::geometry::AttackGeometry;
use super::networks::Fields;

/// Trains the fields of one experiment on one scene.
pub struct FieldLearner {
    pub(super) config: Resolved,
    /// Start and end of a ray's interval, in units of `t_vals`.
    pub(super) bounds: (f64, f64),
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
    /// Sites of the perturbed pass beside the configuration's.
    pub(super) own_sites: Vec<Arc<dyn Site>>,
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
        let tangents = config.method.is_augmented() && config.perturb.sites[PaperSite::View].on();
        let terms = WeightedTerm::all(&config.regularizer);
        let mut learner = FieldLearner {
            config: config.clone(),
            bounds: scene.bounds(),
            background: scene.background,
            geometry: AttackGeometry::new(config, scene),
            device: device.clone(),
            dtype,
            batches: Batches::new(config, scene, RayParts { tangents, ..ray_parts(&fields.coarse) })?,
            variables: fields.variables(),
            fields,
            terms: Vec::new(),
            unseen: None,
            points: PointRays::of(scene, config.data.origin_of_pixels()),
            own_sites: Vec::new(),
        };
        learner.place_unseen_cameras(&terms)?;
        learner.terms = terms;
        Ok(learner)
    }

    /// Returns the fields that are trained.
    pub fn fields(&self) -> &Fields {
        &self.fields
    }
}

/// Returns an error for terms on derivatives of hash grids on a device of candle that is no CPU, and for clean entries where
/// they are not recorded.
pub(super) fn check_device(config: &Resolved, dtype: DType, device: &Device) -> Result<()> {
    let masks = config.method.is_augmented() && config.perturb.entries == ChangedEntries::Clean;
    if masks && !(is_host(device) && dtype == DType::F32) {
        let message = "perturb.entries = \"clean\" needs --device cpu in single precision";
        return Err(Error::Config(message.into()));
    }
    let read = config.regularizer.terms().find(|(term, _)| term.reads_points());
    match read {
        Some((term, _)) if config.field.encoding == Encoding::Hash && !is_host(device) => Err(Error::Config(format!(
            "regularizer {} of a hash grid needs --device cpu (l1 and tv: or --device gpu); candle's other devices have no derivatives \
             of hash grids",
            term.name()
        ))),
        _ => Ok(()),
    }
}
