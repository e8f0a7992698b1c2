//! Settings that have no effect in a configuration, with the reason.

use super::registry::REGISTRY;
use super::{
    Batching, Config, CorruptionKind, DataKind, DensityActivation, Encoding, LatticePoints, Method, NO_REFERENCE,
    REGULARIZERS, Regularizer, Schedule, SecondPass, VolumeCode, word,
};
use crate::data::{RayGroup, may_have_box};
use crate::perturb::{Epsilon, Level, PaperSite};

/// Keys of a section, whether they have no effect, and why.
type Row<'a> = (&'a [&'a str], bool, String);

/// Returns the reason of the first row that holds for a key.
fn reason<const N: usize>(key: &str, rows: [Row; N]) -> Option<String> {
    rows.into_iter().find(|(keys, holds, _)| *holds && keys.contains(&key)).map(|(_, _, why)| why)
}

fn idle_in_corruption(kind: CorruptionKind, key: &str) -> Option<String> {
    let is_noise = matches!(kind, CorruptionKind::GaussianNoise | CorruptionKind::ShotNoise);
    let corrupted = |who: &str| format!("data.corruption.kind is \"{}\"; {who}", kind.name());
    reason(
        key,
        [
            (&["severity"], !is_noise, corrupted("gaussian-noise and shot-noise have a severity")),
            (&["share"], kind != CorruptionKind::Pepper, corrupted("pepper has a share")),
            (&["degrees", "offset"], kind != CorruptionKind::Poses, corrupted("poses moves cameras")),
        ],
    )
}

impl Config {
    /// Returns why the setting `path` has no effect in this configuration, or `None` if it may have one. An unknown setting
    /// gives `None`.
    ///
    /// ```
    /// use augnerf_core::settings::Config;
    ///
    /// let nerf = Config::default();
    /// assert!(nerf.without_effect("perturb.lambda").unwrap().contains("no perturbed pass"));
    /// assert_eq!(nerf.without_effect("train.steps"), None);
    /// ```
    pub fn without_effect(&self, path: &str) -> Option<String> {
        REGISTRY.get(path)?;
        let (section, key) = path.split_once('.')?;
        let method = self.method.name();
        let own = [("srn", Method::Srn), ("nv", Method::Nv), ("llff", Method::Llff)];
        if let Some((name, _)) = own.iter().find(|(name, of)| *name == section && self.method != *of) {
            return Some(format!("only method {name} reads it, and this is {method}"));
        }
        match section {
            "field" | "sampling" if !self.method.has_fields() => Some(format!("method {method} has no field")),
            "data" => self.idle_in_data(key),
            "field" => self.idle_in_field(key),
            "sampling" => self.idle_in_sampling(key),
            "train" => self.idle_in_train(key),
            "perturb" => self.idle_in_perturb(key),
            "regularizer" => self.idle_in_regularizer(key),
            "eval" => self.idle_in_eval(key),
            "nv" => self.idle_in_nv(key),
            _ => None,
        }
    }

    fn on_hash_grid(&self) -> bool {
        self.method.has_fields() && self.field.encoding == Encoding::Hash
    }

    /// A scene whose kind is not known may read all. So may a Blender scene read `holdout`, if its split has no photos.
    fn idle_in_data(&self, key: &str) -> Option<String> {
        let data = &self.data;
        if let Some(key) = key.strip_prefix("corruption.") {
            return idle_in_corruption(data.corruption.kind, key);
        }
        let is_builtin = matches!(data.kind, DataKind::BuiltinBlender | DataKind::BuiltinForward);
        let is_not = |kind: DataKind| data.kind != DataKind::Auto && data.kind != kind;
        let of_kind = |who: &str| format!("data.kind is \"{}\"; {who}", data.kind.name());
        reason(
            key,
            [
                (&["downscale"], data.width > 0, format!("data.width is {}", data.width)),
                (
                    &["ndc"],
                    is_not(DataKind::Llff) && !data.kind.forward_facing(),
                    of_kind("only forward-facing scenes have normalized device coordinates"),
                ),
                (
                    &["bound_factor", "spherify", "recognise_orbits"],
                    is_not(DataKind::Llff),
                    of_kind("only LLFF scenes read it"),
                ),
                (
                    &["recentre"],
                    is_builtin || data.kind == DataKind::Blender,
                    of_kind("cameras of such scenes stay where they are"),
                ),
                (
                    &["rescale"],
                    data.kind != DataKind::Auto && !may_have_box(data),
                    of_kind("only captures outside normalized device coordinates are rescaled"),
                ),
                (&["colmap_model"], is_not(DataKind::Colmap), of_kind("only COLMAP scenes read it")),
                (&["masks"], is_builtin, of_kind("built-in scenes have no masks")),
                (
                    &["background"],
                    data.kind == DataKind::BuiltinForward,
                    of_kind("its images have no transparent pixels"),
                ),
                (&["split"], is_not(DataKind::Transforms), of_kind("only captures with transforms.json have a choice")),
                (&["validation", "holdout_offset"], data.has_splits(), "the scene has splits of its own".into()),
                (
                    &["holdout"],
                    data.has_splits() && data.kind != DataKind::Blender,
                    "the scene has splits of its own".into(),
                ),
            ],
        )
    }

    fn idle_in_field(&self, key: &str) -> Option<String> {
        let encoding = word(self.field.encoding);
        let is_of_grid = key.starts_with("hash.");
        let needs_grid = format!("field.encoding is \"{encoding}\"; hash grids need \"hash\"");
        if is_of_grid && !self.on_hash_grid() {
            return Some(needs_grid);
        }
        reason(
            key,
            [
                (
                    &["position_octaves"],
                    self.on_hash_grid(),
                    "field.encoding is \"hash\"; the grid encodes positions".into(),
                ),
                (&["hash.finest"], self.field.hash.levels == 1, "field.hash.levels is 1".into()),
            ],
        )
    }

    fn idle_in_sampling(&self, key: &str) -> Option<String> {
        let sampling = &self.sampling;
        reason(
            key,
            [
                (&["anneal_start", "anneal_middle"], sampling.anneal_steps == 0, "sampling.anneal_steps is 0".into()),
                (
                    &["resample_padding"],
                    !self.field.encoding.at_intervals(),
                    "field.encoding is \"positional\"; MipNeRF and hash grids read it".into(),
                ),
                (&["resample_padding"], sampling.fine == 0, "sampling.fine is 0".into()),
            ],
        )
    }

    fn idle_in_train(&self, key: &str) -> Option<String> {
        let (train, method, activation) = (&self.train, self.method.name(), self.field.density_activation);
        let is_log_linear = train.schedule == Schedule::LogLinear;
        let (without_field, of_schedule) =
            (format!("method {method} has no field"), format!("train.schedule is \"{}\"", word(train.schedule)));
        reason(
            key,
            [
                (
                    &["rays", "chunk", "batching", "precrop_steps", "precrop_fraction"],
                    !self.method.learns_from_rays(),
                    format!("a step of method {method} has windows of views, not rays"),
                ),
                (
                    &["precrop_steps", "precrop_fraction"],
                    train.batching == Some(Batching::AllImages),
                    "train.batching is \"all-images\"; only batches of one image are cropped".into(),
                ),
                (&["precrop_fraction"], train.precrop_steps == Some(0), "train.precrop_steps is 0".into()),
                (&["final_learning_rate", "warmup_share", "warmup_from"], !is_log_linear, of_schedule.clone()),
                (&["warmup_from"], train.warmup_share == 0.0, "train.warmup_share is 0".into()),
                (&["decay_rate", "decay_steps"], is_log_linear, of_schedule),
                (&["decay_steps"], train.decay_rate == 1.0, "train.decay_rate is 1".into()),
                (&["coarse_weight", "dead_start_share"], !self.method.has_fields(), without_field),
                (
                    &["coarse_weight"],
                    self.on_hash_grid(),
                    "field.encoding is \"hash\"; the coarse pass of a hash grid has no loss".into(),
                ),
                (
                    &["coarse_weight"],
                    self.sampling.fine == 0,
                    "sampling.fine is 0; the weight of the only pass is 1".into(),
                ),
                (
                    &["dead_start_share"],
                    activation != DensityActivation::Relu,
                    format!(
                        "field.density_activation is \"{}\", with which every density is positive",
                        word(activation)
                    ),
                ),
                (&["sam_direction"], train.sam_radius == 0.0, "train.sam_radius is 0".into()),
                (&["eval_stride"], train.eval_every == 0, "train.eval_every is 0".into()),
            ],
        )
    }

    fn idle_in_perturb(&self, key: &str) -> Option<String> {
        let (perturb, method) = (&self.perturb, self.method.name());
        if !self.method.is_augmented() {
            return Some(format!("method {method} has no perturbed pass; aug-nerf and aug-mip-nerf have one"));
        }
        let kind = word(perturb.second);
        // What a second clean pass reads, too.
        let of_both = ["kind", "lambda", "lambda_schedule", "objective", "entries", "field"];
        if perturb.second == SecondPass::Clean && !of_both.contains(&key) {
            return Some(format!("perturb.kind is \"{kind}\", a second pass without deltas"));
        }
        let no_search = perturb.source().is_none_or(|source| !source.searches());
        let no_search = no_search.then(|| format!("perturb.kind is \"{kind}\", which searches nothing"));
        if let Some((site, key)) = key.split_once('.') {
            return self.idle_at_site(PaperSite::of_name(site)?, key, no_search);
        }
        // Whether none of the chosen sites is on, and that in words.
        let off = |chosen: fn(PaperSite) -> bool| {
            let sites: Vec<PaperSite> = PaperSite::ALL.into_iter().filter(|site| chosen(*site)).collect();
            let named: Vec<String> = sites.iter().map(|site| format!("perturb.{}.passes", site.name())).collect();
            let verb = if sites.len() == 1 { "is" } else { "are" };
            let is_off = sites.iter().all(|site| !perturb.sites[*site].on());
            (is_off, format!("{} {verb} \"off\"", named.join(" and ")))
        };
        let (feature_off, no_feature) = off(|site| site.about().level == Level::Feature);
        let (output_off, no_output) = off(|site| site.about().level == Level::Output);
        let (density_off, no_density) = off(|site| site == PaperSite::Density);
        let (xyz_off, no_xyz) = off(|site| site == PaperSite::Xyz);
        let encoding = word(self.field.encoding);
        reason(
            key,
            [
                (&["step_unit"], no_search.is_some(), no_search.unwrap_or_default()),
                (&["injection_layer"], feature_off, no_feature),
                (&["output"], output_off, no_output),
                (&["perturb_last"], density_off, no_density),
                (
                    &["perturb_last"],
                    self.field.encoding.at_intervals(),
                    format!("field.encoding is \"{encoding}\", with which the last sample is as the others"),
                ),
                (&["xyz_radius"], xyz_off, no_xyz),
                (&["resample"], self.sampling.fine == 0, "sampling.fine is 0".into()),
                (
                    &["resample"],
                    self.on_hash_grid(),
                    "field.encoding is \"hash\"; the coarse pass of a hash grid is not perturbed".into(),
                ),
            ],
        )
    }

    /// `no_search` is the reason why no deltas are searched, if none are.
    fn idle_at_site(&self, site: PaperSite, key: &str, no_search: Option<String>) -> Option<String> {
        let (config, name) = (&self.perturb.sites[site], site.name());
        // The reach of steps is a size for random deltas, too.
        let reaches = config.epsilon == Some(Epsilon::Reach);
        reason(
            key,
            [
                (&["steps", "step_size", "epsilon", "norm"], !config.on(), format!("perturb.{name}.passes is \"off\"")),
                (
                    &["steps", "step_size", "norm"],
                    config.epsilon == Some(Epsilon::Units(0.0)),
                    format!("perturb.{name}.epsilon is 0"),
                ),
                (&["steps", "step_size"], no_search.is_some() && !reaches, no_search.unwrap_or_default()),
                (&["step_size"], config.steps == Some(0), format!("perturb.{name}.steps is 0")),
            ],
        )
    }

    fn idle_in_regularizer(&self, key: &str) -> Option<String> {
        let regularizer = &self.regularizer;
        if regularizer.kind.is_empty() && key != "kind" {
            let terms = REGULARIZERS.map(|term| term.name()).join(", ");
            return Some(format!("regularizer.kind names no term; choose from {terms}"));
        }
        let is_of_single_rays = |term: &Regularizer| term.group() == Some(RayGroup::One);
        let unseen = "no term of regularizer.kind reads unseen rays; depth-smoothness and information-gain do, and others with \
                      regularizer.rays = \"unseen\"";
        reason(
            key,
            [
                (
                    &["domain", "lattice", "points", "points_per_step", "jitter"],
                    !regularizer.has_space_terms(),
                    "no term of regularizer.kind is an integral over the box".into(),
                ),
                (
                    &["points_per_step", "jitter"],
                    regularizer.points == LatticePoints::Full,
                    "regularizer.points is \"full\"".into(),
                ),
                (
                    &["occlusion_share"],
                    !regularizer.kind.contains(&Regularizer::Occlusion),
                    "regularizer.kind does not name occlusion".into(),
                ),
                (
                    &["rays"],
                    !regularizer.kind.iter().any(is_of_single_rays),
                    "no term of regularizer.kind is computed on single rays; distortion and occlusion are, among others"
                        .into(),
                ),
                (&["unseen_rays"], regularizer.unseen_groups().is_empty(), unseen.into()),
                (&["unseen_poses"], !regularizer.reads_unseen_cameras(), unseen.into()),
            ],
        )
    }

    fn idle_in_eval(&self, key: &str) -> Option<String> {
        let mesh = &self.eval.mesh;
        reason(
            key,
            [
                (
                    &["mesh.threshold", "mesh.box", "mesh.reference", "mesh.points", "mesh.at"],
                    mesh.resolution == 0,
                    "eval.mesh.resolution is 0".into(),
                ),
                (
                    &["mesh.points", "mesh.at"],
                    mesh.reference == NO_REFERENCE,
                    format!("eval.mesh.reference is \"{NO_REFERENCE}\""),
                ),
            ],
        )
    }

    fn idle_in_nv(&self, key: &str) -> Option<String> {
        let nv = &self.nv;
        reason(
            key,
            [
                (&["kl"], nv.code == VolumeCode::Fixed, "nv.code is \"fixed\"".into()),
                (&["warp_resolution"], !nv.warp, "nv.warp is false".into()),
            ],
        )
    }
}

#[cfg(test)]
mod tests;
