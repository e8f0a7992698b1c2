//! Checks of settings against one another. Each section checks its own settings.

use super::registry::Section;
use super::{
    ChangedEntries, Config, Core, CorruptionKind, DataKind, DeltaSource, Encoding, EvalSplit, LatticePoints,
    MESH_SIDES, Objective, PerturbField, Precision, Regularizer, Resample, SecondPass, Sizes, Spacing, Split,
    TermNeeds, UnseenPoses, word,
};
use crate::base::{Error, Result, SettingError};
use crate::data::RayGroup;
use crate::perturb::{Epsilon, Geometry, Level, Norm, Passes, REACH, StepUnit};

/// Largest number of points of a step. They are drawn at once, and this many take a few hundred megabytes.
const MOST_POINTS_PER_STEP: usize = 1 << 22;

/// Returns an error for `path = value` unless `ok`.
pub(super) fn require(ok: bool, path: &str, value: impl std::fmt::Display, allowed: &str) -> Result<()> {
    if ok {
        return Ok(());
    }
    Err(SettingError { path: path.into(), value: value.to_string(), allowed: allowed.into() }.into())
}

/// Returns an error with a sentence if `wrong`.
pub(super) fn refuse(wrong: bool, message: impl FnOnce() -> String) -> Result<()> {
    if wrong { Err(Error::Config(message())) } else { Ok(()) }
}

/// Returns a number of things in words: `1 term`, `2 terms`.
fn counted(number: usize, thing: &str) -> String {
    format!("{number} {thing}{}", if number == 1 { "" } else { "s" })
}

impl Config {
    /// Checks every setting, and the settings against one another.
    ///
    /// # Errors
    /// [`Error::Setting`] for the first setting out of its range, [`Error::Config`] for settings that contradict each
    /// other.
    pub fn validate(&self) -> Result<()> {
        self.check("")?;
        self.validate_data()?;
        self.validate_representation()?;
        if self.method.has_fields() {
            self.validate_field()?;
            self.validate_sampling()?;
            self.validate_perturb()?;
        }
        self.validate_sites()?;
        self.validate_openings()?;
        self.validate_regularizer()?;
        let side = self.eval.mesh.resolution;
        let allowed = format!("0 (no surface), or {} to {} cells a side", MESH_SIDES.start(), MESH_SIDES.end());
        require(side == 0 || MESH_SIDES.contains(&side), "eval.mesh.resolution", side, &allowed)
    }

    fn validate_data(&self) -> Result<()> {
        let data = &self.data;
        let kind = data.kind;
        refuse(data.spherify && !matches!(kind, DataKind::Auto | DataKind::Llff), || {
            format!("data.spherify = true is for LLFF scenes; this one is {}", kind.name())
        })?;
        let may_have = matches!(kind, DataKind::Auto | DataKind::Transforms) && data.split != Some(Split::Every);
        let without_val = !may_have && !data.has_splits() && data.validation == 0;
        refuse(data.eval_split == EvalSplit::Val && without_val, || {
            format!(
                "data.eval_split = \"val\" is for scenes with a validation split, and this one is {}: keep every N-th view for \
                 that with data.validation",
                kind.name()
            )
        })?;
        require(
            data.validation != 1,
            "data.validation",
            1,
            "0 (none) or at least 2, so that views are left to train on",
        )?;
        let (offset, holdout) = (data.holdout_offset, data.holdout);
        require(
            offset < holdout,
            "data.holdout_offset",
            offset,
            &format!("0 to {} (below data.holdout)", holdout - 1),
        )?;
        let own = data.split == Some(Split::Own);
        refuse(own && !matches!(kind, DataKind::Auto | DataKind::Transforms | DataKind::Blender), || {
            format!("data.split = \"own\" is for captures whose files name a split; this one is {}", kind.name())
        })?;
        refuse(data.split == Some(Split::Every) && kind.has_splits(), || {
            format!(
                "data.split = \"every\" is for captures of which views are held out; this one is {}, whose splits are given",
                kind.name()
            )
        })?;
        refuse(offset > 0 && data.has_splits(), || {
            format!(
                "data.holdout_offset = {offset} is for scenes of which every N-th view is held out; this one is {}, whose splits \
                 are given",
                kind.name()
            )
        })?;
        refuse(data.spherify && data.ndc && kind == DataKind::Llff, || {
            "data.spherify and data.ndc exclude each other: NDC is for cameras that face forward; set data.ndc=false"
                .into()
        })?;
        if let (Some(near), Some(far)) = (data.near, data.far) {
            require(near < far, "data.far", far, &format!("beyond data.near = {near}"))?;
        }
        Ok(())
    }

    fn validate_field(&self) -> Result<()> {
        let (field, method) = (&self.field, self.method.name());
        let halves = field.view_width.is_some() || field.width.is_multiple_of(2);
        require(
            halves,
            "field.width",
            field.width,
            "even (the view layer has half of it, unless field.view_width says otherwise)",
        )?;
        let octaves = field.position_octaves;
        let integrated = field.encoding == Encoding::Integrated;
        require(!integrated || octaves >= 1, "field.position_octaves", octaves, "1 to 20")?;
        let Some(representation) = self.method.representation(field.encoding) else {
            return Err(Error::Config(format!(
                "field.encoding = \"{}\" is not that of method {method}: integrated is for mip-nerf and aug-mip-nerf, \
                 positional and hash are for nerf and aug-nerf",
                word(field.encoding),
            )));
        };
        refuse(!representation.has_derivatives_at_points() && self.regularizer.reads_points(), || {
            format!(
                "regularizer.kind with method {method}: terms in space and orientation read density at points, and this \
                 field is queried at Gaussians; use nerf or aug-nerf, or other terms on rays, such as distortion"
            )
        })?;
        if let Some((name, value, allowed)) = field.hash.wrong() {
            require(false, &format!("field.hash.{name}"), value, &allowed)?;
        }
        refuse(field.precision == Precision::Bf16 && field.core == Core::Plain, || {
            "field.precision = \"bf16\" is for field.core = \"fused\": the plain one is the reference and computes in f32".into()
        })?;
        for (i, &skip) in field.skips.iter().enumerate() {
            let allowed = format!("a layer from 1 to {} (field.depth - 1)", field.depth - 1);
            require(skip >= 1 && skip < field.depth, "field.skips", skip, &allowed)?;
            refuse(field.skips[..i].contains(&skip), || {
                format!("field.skips names layer {skip} twice; name each layer once")
            })?;
        }
        Ok(())
    }

    fn validate_spacing(&self) -> Result<()> {
        let (data, in_disparity) = (&self.data, self.sampling.spacing == Spacing::Disparity);
        refuse(in_disparity && data.in_ndc(), || {
            "sampling.spacing = \"disparity\" with data.ndc: normalized device coordinates are even in disparity already; \
             set data.ndc=false, or leave sampling.spacing at \"depth\""
                .into()
        })?;
        let of_paper = self.method.is_augmented() && self.perturb.geometry == Geometry::Paper;
        refuse(in_disparity && of_paper, || {
            "sampling.spacing = \"disparity\" with perturb.geometry = \"paper\": the paper's gaps are those of samples that are even \
             in depth; leave perturb.geometry at \"sampling\""
                .into()
        })
    }

    fn validate_sampling(&self) -> Result<()> {
        self.validate_spacing()?;
        let fine = self.sampling.fine;
        if !self.representation().has_coarse_loss() {
            let allowed =
                "at least 2 with field.encoding = \"hash\", whose coarse pass only places the samples of the fine one";
            return require(fine >= 2, "sampling.fine", fine, allowed);
        }
        let allowed = "0 (coarse only) or at least 2 intervals";
        require(!(self.field.encoding.at_intervals() && fine == 1), "sampling.fine", fine, allowed)
    }

    fn validate_perturb(&self) -> Result<()> {
        let perturb = &self.perturb;
        let lambda = perturb.lambda;
        let allowed = "0 or positive, and at most 1 with perturb.objective = \"released\"";
        let first = perturb.lambda_schedule.at(lambda, 0);
        require(
            perturb.objective == Objective::Paper || lambda.max(first) <= 1.0,
            "perturb.lambda",
            lambda.max(first),
            allowed,
        )?;
        let separable = self.field.encoding == Encoding::Hash
            && self.field.core == Core::Fused
            && perturb.field == PerturbField::Shared;
        refuse(self.method.is_augmented() && perturb.entries == ChangedEntries::Clean && !separable, || {
            "perturb.entries = \"clean\" needs the entries of a hash grid that both passes share; use field.encoding = \"hash\", \
             field.core = \"fused\" and perturb.field = \"shared\""
                .into()
        })?;
        let permutes = perturb.second == SecondPass::Perturbed(DeltaSource::Permuted);
        refuse(
            self.method.is_augmented()
                && permutes
                && (self.train.chunk == 1 || self.train.rays % self.train.chunk == 1),
            || {
                format!(
                    "perturb.kind = \"permuted\" with train.chunk = {} and train.rays = {}: a chunk has one ray, whose deltas no other ray \
                 can take; choose a train.chunk that leaves no chunk of one ray",
                    self.train.chunk, self.train.rays
                )
            },
        )?;
        let layer = perturb.injection_layer;
        let fresh = perturb.second == SecondPass::Clean;
        let perturbs = self.method.is_augmented() && !fresh;
        if self.method.is_augmented() && !self.representation().has_coarse_loss() {
            self.validate_fine_alone(perturbs)?;
        }
        if perturbs && perturb.sites_on().any(|(site, _)| site.about().level == Level::Feature) {
            let allowed = format!("1 to {} (field.depth)", self.field.depth);
            require((1..=self.field.depth).contains(&layer), "perturb.injection_layer", layer, &allowed)?;
        }
        refuse(perturbs && perturb.sites_on().next().is_none(), || {
            "a perturbed method with every perturb.*.passes = \"off\" perturbs nothing; \
             use method = \"nerf\" or \"mip-nerf\", or perturb.kind = \"fresh-jitter\" for the control"
                .into()
        })?;
        let still = !self.sampling.jitter && self.sampling.density_noise == Some(0.0);
        refuse(self.method.is_augmented() && fresh && still, || {
            "perturb.kind = \"fresh-jitter\" needs sampling.jitter = true or sampling.density_noise above 0: \
             otherwise the second pass equals the first"
                .into()
        })?;
        refuse(fresh && perturb.field == PerturbField::Separate, || {
            "perturb.kind = \"fresh-jitter\" is a second pass of the same fields; perturb.field must be \"shared\""
                .into()
        })
    }

    /// Rejects settings of a perturbed coarse pass if there is none.
    fn validate_fine_alone(&self, perturbs: bool) -> Result<()> {
        refuse(self.perturb.resample == Resample::Perturbed, || {
            "perturb.resample = \"perturbed\" with field.encoding = \"hash\": there is no perturbed coarse pass to resample \
             from; use \"clean\""
                .into()
        })?;
        let mut sites = self.perturb.sites_on();
        match sites.find(|(_, site)| perturbs && site.passes == Passes::Coarse) {
            Some((site, _)) => Err(Error::Config(format!(
                "perturb.{}.passes = \"coarse\" with field.encoding = \"hash\": the coarse pass of a hash field only places \
                 samples and is never perturbed; use \"fine\", \"both\" (the same here) or \"off\"",
                site.name()
            ))),
            None => Ok(()),
        }
    }

    fn validate_sites(&self) -> Result<()> {
        let perturb = &self.perturb;
        for (site, config) in perturb.sites.iter() {
            let (about, name) = (site.about(), site.name());
            let (largest, allowed) = about.largest_epsilon;
            if let Some(Epsilon::Units(epsilon)) = config.epsilon {
                require(epsilon <= largest, &format!("perturb.{name}.epsilon"), epsilon, allowed)?;
            }
            // For one number per sample both norms give the same set, which has one name.
            refuse(about.scalar && config.norm == Some(Norm::L2), || {
                format!(
                    "perturb.{name}.norm = \"l2\": this delta is one number a sample, for which l2 and linf are the same; \
                     use \"linf\""
                )
            })?;
        }
        let relative = perturb.step_unit == Some(StepUnit::Relative);
        let in_radii = relative || perturb.sizes == Sizes::Calibrated;
        let reaching = perturb.sites.iter().find(|(_, config)| config.epsilon == Some(Epsilon::Reach));
        if let Some((site, _)) = reaching.filter(|_| in_radii) {
            return Err(Error::Config(format!(
                "perturb.{}.epsilon = \"{REACH}\" is as far as steps of a length of their own reach, and here steps are \
                 measured in radii; set perturb.attack = \"paper\" and perturb.step_unit = \"absolute\", or give epsilon a \
                 number",
                site.name()
            )));
        }
        refuse(perturb.sizes == Sizes::Calibrated && perturb.step_unit == Some(StepUnit::Absolute), || {
            "perturb.attack = \"calibrated\" measures steps in radii; omit perturb.step_unit or set it to \"relative\", and \
             omit the sites' numbers that are the paper's"
                .into()
        })?;
        match perturb.sites.iter().find(|(_, config)| config.step_size.is_none()) {
            Some((unset, _)) if perturb.sizes == Sizes::Paper && relative => Err(Error::Config(format!(
                "perturb.step_unit = \"relative\" measures steps in radii, which the paper's step sizes are not; \
                 set perturb.{}.step_size, too",
                unset.name()
            ))),
            _ => Ok(()),
        }
    }

    /// Rejects encodings and samples that open after the training.
    fn validate_openings(&self) -> Result<()> {
        let openings = [
            ("field.frequency_steps", self.field.frequency_steps, "or the encodings never open"),
            ("sampling.anneal_steps", self.sampling.anneal_steps, "or training never sees whole rays"),
        ];
        for (name, steps, why) in openings {
            let allowed = format!("at most train.steps ({}), {why}", self.train.steps);
            require(steps <= self.train.steps || !self.method.has_fields(), name, steps, &allowed)?;
        }
        Ok(())
    }

    fn validate_regularizer(&self) -> Result<()> {
        let regularizer = &self.regularizer;
        let (kinds, weights) = (&regularizer.kind, regularizer.weight.len());
        for (i, kind) in kinds.iter().enumerate() {
            refuse(kinds[..i].contains(kind), || {
                format!("regularizer.kind names {} twice; name each term once", kind.name())
            })?;
        }
        refuse(weights != 0 && weights != kinds.len(), || {
            format!(
                "regularizer.weight has {} and regularizer.kind names {}; give one weight for each term, or none for the \
                 defaults",
                counted(weights, "number"),
                counted(kinds.len(), "term")
            )
        })?;
        refuse(self.train.gradient_scaling && !self.method.has_fields(), || {
            format!(
                "train.gradient_scaling = true with method {}: it has no samples along rays; set it to false",
                self.method.name()
            )
        })?;
        refuse(self.train.gradient_scaling && kinds.contains(&Regularizer::Orientation), || {
            "train.gradient_scaling = true with regularizer.kind = \"orientation\": gradients of normals are not scaled; choose one of them".into()
        })?;
        refuse(self.train.gradient_scaling && self.data.in_ndc(), || {
            "train.gradient_scaling = true with data.ndc = true: t is no distance in normalized device coordinates; set \
             data.ndc=false, or train.gradient_scaling=false"
                .into()
        })?;
        refuse(regularizer.unseen_poses == Some(UnseenPoses::Sphere) && self.data.in_ndc(), || {
            "regularizer.unseen_poses = \"sphere\" with data.ndc = true: cameras on all sides see nothing of a forward-facing scene; \
             choose box or between"
                .into()
        })?;
        refuse(kinds.contains(&Regularizer::SparseDepth) && self.data.in_ndc(), || {
            "regularizer.kind = \"sparse-depth\" with data.ndc = true: t is no depth in normalized device coordinates; set data.ndc=false"
                .into()
        })?;
        let is_moved = self.data.corruption.kind == CorruptionKind::Poses;
        refuse(kinds.contains(&Regularizer::SparseDepth) && is_moved, || {
            "regularizer.kind = \"sparse-depth\" with data.corruption.kind = \"poses\": COLMAP's points are those of the cameras before \
             they were moved; choose one of them"
                .into()
        })?;
        if let (Some(rays), Some(group)) = (regularizer.unseen_rays, regularizer.unseen_groups().last()) {
            let allowed = format!(
                "a multiple of {}, the rays of a {}",
                group.rays(),
                if *group == RayGroup::Patch { "patch" } else { "pair" }
            );
            require(rays.is_multiple_of(group.rays()), "regularizer.unseen_rays", rays, &allowed)?;
        }
        let schedules = regularizer.schedule.len();
        refuse(schedules != 0 && schedules != kinds.len(), || {
            format!(
                "regularizer.schedule has {} and regularizer.kind names {}; give one schedule for each term, or none for \
                 constant weights",
                counted(schedules, "schedule"),
                counted(kinds.len(), "term")
            )
        })?;
        refuse(kinds.contains(&Regularizer::Laplacian) && !self.field.has_laplacian(), || {
            "regularizer.kind = \"laplacian\" with field.hash.interpolation = \"linear\": a trilinear grid has no second derivative \
             along an axis; set field.hash.interpolation = \"smoothstep\""
                .into()
        })?;
        let has_tables = self.method.has_fields() && self.field.encoding == Encoding::Hash;
        if let Some(kind) = kinds.iter().find(|kind| kind.needs() == TermNeeds::Tables && !has_tables) {
            let kind = kind.name();
            return Err(Error::Config(format!(
                "regularizer.kind = \"{kind}\" needs the tables of a hash grid; use nerf or aug-nerf with field.encoding = \"hash\""
            )));
        }
        let (points, lattice) = (regularizer.points_per_step, regularizer.lattice);
        if regularizer.points == LatticePoints::Sampled {
            let cells = lattice.pow(3);
            let most = cells.min(MOST_POINTS_PER_STEP);
            let allowed = format!(
                "1 to {most} on a lattice of {lattice} a side (regularizer.points = \"full\" takes all {cells} cells)"
            );
            require((1..=most).contains(&points), "regularizer.points_per_step", points, &allowed)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::{build, parse_assignment};

    #[test]
    fn messages_name_field_value_and_range() {
        for (assignment, words) in [
            ("train.steps=0", vec!["train.steps", "0", "at least 1"]),
            ("field.width=7", vec!["field.width", "7", "even"]),
            ("perturb.t.epsilon=0.6", vec!["perturb.t.epsilon", "0.6", "0.5"]),
            ("field.skips=[8]", vec!["field.skips", "8", "1 to 7"]),
            ("train.learning_rate=nan", vec!["train.learning_rate", "positive"]),
            ("data.holdout=1", vec!["data.holdout", "at least 2"]),
        ] {
            let set = vec![parse_assignment(assignment).unwrap()];
            let message = build(None, None, &set).unwrap_err().to_string();
            for word in words {
                assert!(message.contains(word), "{assignment}: {message}");
            }
        }
    }

    /// What settings of a hash field are told; nothing where they are taken.
    fn told(further: &[&str]) -> String {
        let texts = ["field.encoding=hash"].iter().chain(further);
        let set: Vec<_> = texts.map(|text| parse_assignment(text).unwrap()).collect();
        build(None, None, &set).map_or_else(|refusal| refusal.to_string(), |_| String::new())
    }

    /// A camera that is moved sees COLMAP's points elsewhere than its photo does.
    #[test]
    fn depth_at_points_needs_the_cameras_that_found_them() {
        let term = ["data.kind=colmap", "regularizer.kind=sparse-depth"];
        let told = |further: &[&str]| told(&[&term[..], further].concat());
        let message = told(&["data.corruption.kind=poses"]);
        assert!(message.contains("sparse-depth") && message.contains("data.corruption.kind = \"poses\""), "{message}");
        assert_eq!(told(&[]) + &told(&["data.corruption.kind=pepper"]), "");
    }

    /// Its coarse pass is never perturbed: such an attack would never run.
    #[test]
    fn an_attack_on_the_coarse_pass_of_a_hash_field_is_refused() {
        for site in ["t", "density"] {
            let message = told(&["method=aug-nerf", &format!("perturb.{site}.passes=coarse")]);
            assert!(message.contains(&format!("perturb.{site}.passes")) && message.contains("\"fine\""), "{message}");
        }
        for taken in [
            &["method=aug-nerf", "perturb.t.passes=fine"][..],
            &["method=nerf", "perturb.t.passes=coarse"],
            &["method=aug-nerf", "perturb.kind=fresh-jitter", "perturb.t.passes=coarse"],
        ] {
            assert_eq!(told(taken), "", "{taken:?}");
        }
    }

    #[test]
    fn a_hash_field_without_a_fine_pass_is_told_one_thing() {
        for fine in [0, 1] {
            let message = told(&[&format!("sampling.fine={fine}")]);
            let says = ["sampling.fine", "at least 2", "hash"].iter().all(|words| message.contains(words));
            assert!(says && !message.contains("coarse only"), "{message}");
        }
        assert_eq!(told(&["sampling.fine=2"]), "");
    }

    #[test]
    fn a_hash_grid_s_box_is_one_that_can_be_computed_with() {
        let with = |low: &str, high: &str| told(&[&format!("field.hash.bounds=[[{low},0,0],[{high},1,1]]")]);
        for (low, high) in [("-1e308", "1e308"), ("-1e-320", "1e-320"), ("0", "1e-7"), ("0", "1e13"), ("1", "0")] {
            let message = with(low, high);
            assert!(
                message.contains("field.hash.bounds") && message.contains("two corners"),
                "{low} {high}: {message}"
            );
        }
        assert_eq!(with("-1e12", "1e12") + &with("0", "1e-6"), "");
        let message = told(&["field.hash.finest=8"]);
        assert!(message.contains("field.hash.finest = 8") && message.contains("16 (field.hash.coarsest)"), "{message}");
    }
}
