//! Checks of settings against one another. What one may hold by itself stands in its section.

use super::registry::Section;
use super::{
    Config, Core, DataKind, Encoding, EvalSplit, LatticePoints, MESH_SIDES, Objective, PerturbField, Precision,
    Regularizer, Resample, SecondPass, Sizes, word,
};
use crate::augment::{Epsilon, Norm, REACH, Site, StepUnit};
use crate::base::{Error, Result, SettingError};

/// Points of a step are drawn at once: so many take a few hundred megabytes.
const MOST_POINTS_PER_STEP: usize = 1 << 22;

/// Refuses `path = value` unless `ok`.
fn require(ok: bool, path: &str, value: impl std::fmt::Display, allowed: &str) -> Result<()> {
    if ok {
        return Ok(());
    }
    Err(SettingError { path: path.into(), value: value.to_string(), allowed: allowed.into() }.into())
}

/// Refuses with a sentence where `wrong`.
fn refuse(wrong: bool, message: impl FnOnce() -> String) -> Result<()> {
    if wrong { Err(Error::Config(message())) } else { Ok(()) }
}

impl Config {
    /// Checks every setting, and the settings against one another.
    ///
    /// # Errors
    /// [`Error::Setting`] with the first one out of its range, [`Error::Config`] for some that contradict each other.
    pub fn validate(&self) -> Result<()> {
        self.check("")?;
        self.validate_data()?;
        self.validate_field()?;
        self.validate_sampling()?;
        self.validate_perturb()?;
        self.validate_sites()?;
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
        let without_val = kind != DataKind::Auto && !kind.has_splits() && data.validation == 0;
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
        refuse(offset > 0 && kind.has_splits(), || {
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
        refuse(!representation.has_derivatives_at_points() && self.regularizer.has_space_terms(), || {
            format!(
                "regularizer.kind with method {method}: terms in space are made of derivatives at points, and this field is \
                 queried at Gaussians; use nerf or aug-nerf, or the distortion loss alone"
            )
        })?;
        let (coarsest, finest) = (field.hash.coarsest, field.hash.finest);
        if let Some(finest) = finest {
            let allowed = format!("{coarsest} (field.hash.coarsest) to 65536");
            require(finest >= coarsest, "field.hash.finest", finest, &allowed)?;
        }
        refuse(field.encoding == Encoding::Hash && self.sampling.fine == 0, || {
            "sampling.fine = 0 with field.encoding = \"hash\": the coarse pass of a hash field only places the samples of the fine one; \
             set sampling.fine to at least 2"
                .into()
        })?;
        refuse(field.precision == Precision::Bf16 && field.core == Core::Plain, || {
            "field.precision = \"bf16\" is for field.core = \"fused\": the plain one is the reference and computes in f32".into()
        })?;
        for (i, &skip) in field.skips.iter().enumerate() {
            let allowed = format!("a layer from 1 to {} (field.depth - 1)", field.depth - 1);
            require(skip >= 1 && skip < field.depth, "field.skips", skip, &allowed)?;
            require(!field.skips[..i].contains(&skip), "field.skips", skip, "named once")?;
        }
        Ok(())
    }

    fn validate_sampling(&self) -> Result<()> {
        let fine = self.sampling.fine;
        let allowed = "0 (coarse only) or at least 2 intervals";
        require(!(self.field.encoding.at_intervals() && fine == 1), "sampling.fine", fine, allowed)
    }

    fn validate_perturb(&self) -> Result<()> {
        let perturb = &self.perturb;
        let lambda = perturb.lambda;
        let allowed = "0 or positive, and at most 1 with perturb.objective = \"released\"";
        require(perturb.objective == Objective::Paper || lambda <= 1.0, "perturb.lambda", lambda, allowed)?;
        let layer = perturb.injection_layer;
        let fresh = perturb.second == SecondPass::Clean;
        refuse(
            self.method.is_augmented()
                && perturb.resample == Resample::Perturbed
                && !self.representation().has_coarse_loss(),
            || {
                "perturb.resample = \"perturbed\" with field.encoding = \"hash\": there is no perturbed coarse pass to resample \
                 from; use \"clean\""
                    .into()
            },
        )?;
        let perturbs = self.method.is_augmented() && !fresh;
        if perturbs && perturb.sites[Site::Feature].on() {
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

    fn validate_sites(&self) -> Result<()> {
        let perturb = &self.perturb;
        for (site, config) in perturb.sites.iter() {
            let (about, name) = (site.about(), site.name());
            let (largest, allowed) = about.largest_epsilon;
            if let Some(Epsilon::Units(epsilon)) = config.epsilon {
                require(epsilon <= largest, &format!("perturb.{name}.epsilon"), epsilon, allowed)?;
            }
            // A scalar per sample: both norms are the same set, one name for it.
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
            "perturb.attack = \"calibrated\" measures steps in radii; leave perturb.step_unit empty or set it to \
             \"relative\""
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

    fn validate_regularizer(&self) -> Result<()> {
        let regularizer = &self.regularizer;
        let (kinds, weights) = (&regularizer.kind, regularizer.weight.len());
        for (i, kind) in kinds.iter().enumerate() {
            require(!kinds[..i].contains(kind), "regularizer.kind", kind.name(), "named once")?;
        }
        refuse(weights != 0 && weights != kinds.len(), || {
            format!(
                "regularizer.weight has {weights} numbers and regularizer.kind names {} terms; give one weight for each \
                 term, or none for the defaults",
                kinds.len()
            )
        })?;
        refuse(kinds.contains(&Regularizer::Laplacian) && !self.field.has_laplacian(), || {
            "regularizer.kind = \"laplacian\" with field.hash.interpolation = \"linear\": a trilinear grid has no second derivative \
             along an axis; set field.hash.interpolation = \"smoothstep\""
                .into()
        })?;
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
}
