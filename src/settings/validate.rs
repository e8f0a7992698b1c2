//! Checks of ranges and across fields. Each message names the field, what was found and what is
//! allowed.

use std::ops::RangeInclusive;

use super::{
    Config, CorruptionConfig, DataKind, EvalSplit, LatticePoints, MeshConfig, PerturbField, RegularizerConfig,
    SecondPass, SiteConfig, Sizes,
};
use crate::augment::{Norm, Site, StepUnit};
use crate::base::{Error, Result};

/// Points of a step are drawn at once: so many take a few hundred megabytes.
const MOST_POINTS_PER_STEP: usize = 1 << 22;

/// Refuses with `field = value: allowed` unless `ok`.
fn require(ok: bool, field: &str, value: impl std::fmt::Display, allowed: &str) -> Result<()> {
    if ok {
        return Ok(());
    }
    Err(Error::Config(format!("{field} = {value} is out of range: it must be {allowed}")))
}

/// Checks section `regularizer`.
pub fn validate_regularizer(regularizer: &RegularizerConfig) -> Result<()> {
    let kinds = &regularizer.kind;
    for (i, kind) in kinds.iter().enumerate() {
        require(!kinds[..i].contains(kind), "regularizer.kind", kind.name(), "named once")?;
    }
    for &weight in &regularizer.weight {
        require(weight.is_finite() && weight >= 0.0, "regularizer.weight", weight, "0 (off) or positive")?;
    }
    if !regularizer.weight.is_empty() && regularizer.weight.len() != kinds.len() {
        return Err(Error::Config(format!(
            "regularizer.weight has {} numbers and regularizer.kind names {} terms; give one weight for each term, \
             or none for the defaults",
            regularizer.weight.len(),
            kinds.len()
        )));
    }
    require_box(regularizer.domain, "regularizer.domain")?;
    let lattice = regularizer.lattice;
    let allowed = "4 to 1024 cells a side: fewer say nothing about smoothness, more would never finish";
    require((4..=1024).contains(&lattice), "regularizer.lattice", lattice, allowed)?;
    let (points, cells) = (regularizer.points_per_step, lattice.pow(3));
    if regularizer.points == LatticePoints::Sampled {
        let most = cells.min(MOST_POINTS_PER_STEP);
        let allowed = format!(
            "1 to {most} on a lattice of {lattice} a side (regularizer.points = \"full\" asks for all {cells} cells)"
        );
        require((1..=most).contains(&points), "regularizer.points_per_step", points, &allowed)?;
    }
    Ok(())
}

/// Whether two corners span a box.
fn require_box([lower, upper]: [[f64; 3]; 2], field: &str) -> Result<()> {
    let is_box = lower.iter().zip(&upper).all(|(a, b)| a.is_finite() && b.is_finite() && a < b);
    let allowed = "two corners [[x, y, z], [x, y, z]], each number of the first under that of the second";
    require(is_box, field, format!("{:?}", [lower, upper]), allowed)
}

/// Cells along each side of a mesh's lattice.
pub const MESH_SIDES: RangeInclusive<usize> = 8..=1024;

/// Checks section `eval.mesh`.
pub fn validate_mesh(mesh: &MeshConfig) -> Result<()> {
    let (side, at) = (mesh.resolution, mesh.at);
    let sides = format!("0 (no surface), or {} to {} cells a side", MESH_SIDES.start(), MESH_SIDES.end());
    require(side == 0 || MESH_SIDES.contains(&side), "eval.mesh.resolution", side, &sides)?;
    if let Some(threshold) = mesh.threshold {
        require(threshold.is_finite() && threshold > 0.0, "eval.mesh.threshold", threshold, "a positive density")?;
    }
    if let Some(domain) = mesh.domain {
        require_box(domain, "eval.mesh.box")?;
    }
    require((100..=20_000_000).contains(&mesh.points), "eval.mesh.points", mesh.points, "100 to 20000000")?;
    require(at.is_finite() && at > 0.0, "eval.mesh.at", at, "a positive distance")
}

impl Config {
    /// Checks every field, and the fields against one another.
    pub fn validate(&self) -> Result<()> {
        require(self.seed <= i64::MAX as u64, "seed", self.seed, "at most 2^63 - 1")?;
        self.validate_data()?;
        self.validate_field()?;
        self.validate_sampling()?;
        self.validate_train()?;
        self.validate_perturb()?;
        validate_regularizer(&self.regularizer)?;
        require((1..=1 << 20).contains(&self.eval.chunk), "eval.chunk", self.eval.chunk, "1 to 1048576 rays")?;
        validate_mesh(&self.eval.mesh)
    }

    fn validate_data(&self) -> Result<()> {
        let data = &self.data;
        if let Some(downscale) = data.downscale {
            require((1..=64).contains(&downscale), "data.downscale", downscale, "1 to 64")?;
        }
        require(data.width <= 16_384, "data.width", data.width, "0 (use data.downscale) to 16384 pixels")?;
        require(data.holdout >= 2, "data.holdout", data.holdout, "at least 2, so that views are left to train on")?;
        require(data.test_skip >= 1, "data.test_skip", data.test_skip, "at least 1")?;
        let plain = !data.name.contains(['/', '\\']) && data.name != "." && data.name != "..";
        require(plain, "data.name", format!("\"{}\"", data.name), "a name without path separators")?;
        let other = |kinds: &[DataKind]| data.kind != DataKind::Auto && !kinds.contains(&data.kind);
        if data.spherify && other(&[DataKind::Llff]) {
            return Err(Error::Config(format!(
                "data.spherify = true is for LLFF scenes; this one is {}",
                data.kind.name()
            )));
        }
        if data.eval_split == EvalSplit::Val && data.kind != DataKind::Auto && !data.kind.has_splits() {
            return Err(Error::Config(format!(
                "data.eval_split = \"val\" is for scenes with a validation split (Blender); this one is {}",
                data.kind.name()
            )));
        }
        let factor = data.bound_factor;
        require(factor.is_finite() && factor >= 0.0, "data.bound_factor", factor, "0 (not scaled) or positive")?;
        if data.spherify && data.ndc && data.kind == DataKind::Llff {
            return Err(Error::Config(
                "data.spherify and data.ndc exclude each other: NDC is for cameras that face forward; \
                 set data.ndc=false"
                    .into(),
            ));
        }
        self.validate_corruption()?;
        for (name, bound) in [("data.near", data.near), ("data.far", data.far)] {
            if let Some(bound) = bound {
                require(bound.is_finite() && bound >= 0.0, name, bound, "a finite distance of at least 0")?;
            }
        }
        if let (Some(near), Some(far)) = (data.near, data.far) {
            require(near < far, "data.far", far, &format!("beyond data.near = {near}"))?;
        }
        Ok(())
    }

    fn validate_corruption(&self) -> Result<()> {
        let CorruptionConfig { severity, share, degrees, offset, .. } = self.data.corruption;
        require((1..=5).contains(&severity), "data.corruption.severity", severity, "1 to 5, as in ImageNet-C")?;
        require((0.0..=10.0).contains(&share), "data.corruption.share", share, "0 to 10 draws a pixel")?;
        require((0.0..=180.0).contains(&degrees), "data.corruption.degrees", degrees, "0 to 180")?;
        let allowed = "0 or more scene units";
        require(offset.is_finite() && offset >= 0.0, "data.corruption.offset", offset, allowed)
    }

    fn validate_field(&self) -> Result<()> {
        let field = &self.field;
        require((4..=4096).contains(&field.width), "field.width", field.width, "4 to 4096 neurons")?;
        require(field.width.is_multiple_of(2), "field.width", field.width, "even (the view layer has half of it)")?;
        require((1..=64).contains(&field.depth), "field.depth", field.depth, "1 to 64 layers")?;
        let integrated = field.encoding.at_intervals();
        let least = usize::from(integrated);
        let allowed = format!("{least} to 20");
        let octaves = field.position_octaves;
        require((least..=20).contains(&octaves), "field.position_octaves", octaves, &allowed)?;
        require((0.0..=0.5).contains(&field.rgb_padding), "field.rgb_padding", field.rgb_padding, "0 to 0.5")?;
        if self.method.representation().encoding() != field.encoding {
            return Err(Error::Config(format!(
                "field.encoding = \"{}\" is not that of method {}: integrated is for mip-nerf and aug-mip-nerf, positional \
                 for nerf and aug-nerf",
                if integrated { "integrated" } else { "positional" },
                self.method.name()
            )));
        }
        if !self.method.representation().has_derivatives_at_points() && self.regularizer.has_space_terms() {
            return Err(Error::Config(format!(
                "regularizer.kind with method {}: terms in space are made of derivatives at points, and this field is queried at \
                 Gaussians; use nerf or aug-nerf, or the distortion loss alone",
                self.method.name()
            )));
        }
        require(field.view_octaves <= 20, "field.view_octaves", field.view_octaves, "0 to 20")?;
        for (i, &skip) in field.skips.iter().enumerate() {
            let allowed = format!("a layer from 1 to {} (field.depth - 1)", field.depth - 1);
            require(skip >= 1 && skip < field.depth, "field.skips", skip, &allowed)?;
            require(!field.skips[..i].contains(&skip), "field.skips", skip, "named once")?;
        }
        Ok(())
    }

    fn validate_sampling(&self) -> Result<()> {
        let sampling = &self.sampling;
        require((3..=4096).contains(&sampling.coarse), "sampling.coarse", sampling.coarse, "3 to 4096 samples")?;
        require(sampling.fine <= 4096, "sampling.fine", sampling.fine, "0 (coarse only) to 4096 samples")?;
        let allowed = "0 (coarse only) or at least 2 intervals";
        require(!(self.field.encoding.at_intervals() && sampling.fine == 1), "sampling.fine", sampling.fine, allowed)?;
        let padding = sampling.resample_padding;
        let allowed = "positive: where all weights are 0, intervals are drawn from it alone";
        require(padding.is_finite() && padding > 0.0, "sampling.resample_padding", padding, allowed)?;
        let noise = sampling.density_noise.unwrap_or(0.0);
        require(noise.is_finite() && noise >= 0.0, "sampling.density_noise", noise, "0 or positive")
    }

    fn validate_train(&self) -> Result<()> {
        let train = &self.train;
        let positive = |name: &str, value: f64| require(value.is_finite() && value > 0.0, name, value, "positive");
        require((1..=1_000_000_000).contains(&train.steps), "train.steps", train.steps, "at least 1, at most 10^9")?;
        require((1..=1 << 20).contains(&train.rays), "train.rays", train.rays, "1 to 1048576")?;
        require((1..=1 << 20).contains(&train.chunk), "train.chunk", train.chunk, "1 to 1048576 rays")?;
        positive("train.learning_rate", train.learning_rate)?;
        positive("train.decay_rate", train.decay_rate)?;
        positive("train.final_learning_rate", train.final_learning_rate)?;
        positive("train.coarse_weight", train.coarse_weight)?;
        let share = train.warmup_share;
        require((0.0..=1.0).contains(&share), "train.warmup_share", share, "0 (no warm-up) to 1")?;
        let from = train.warmup_from;
        require(from > 0.0 && from <= 1.0, "train.warmup_from", from, "above 0, at most 1")?;
        if let Some(decay) = train.decay_steps {
            require(decay >= 1, "train.decay_steps", decay, "at least 1")?;
        }
        let fraction = train.precrop_fraction;
        require(fraction > 0.0 && fraction <= 1.0, "train.precrop_fraction", fraction, "above 0, at most 1")?;
        require(train.log_every >= 1, "train.log_every", train.log_every, "at least 1")?;
        let minutes = train.checkpoint_minutes;
        require(minutes.is_finite() && minutes >= 0.0, "train.checkpoint_minutes", minutes, "0 (off) or positive")?;
        let keep = train.keep_checkpoints;
        require((1..=10_000).contains(&keep), "train.keep_checkpoints", keep, "1 to 10000")?;
        let share = train.dead_start_share;
        require((0.0..1.0).contains(&share), "train.dead_start_share", share, "0 (off) to below 1")
    }

    fn validate_perturb(&self) -> Result<()> {
        let perturb = &self.perturb;
        let lambda = perturb.lambda;
        let largest = match perturb.objective {
            super::Objective::Paper => f64::MAX,
            super::Objective::Released => 1.0,
        };
        let allowed = "0 or positive, and at most 1 with perturb.objective = \"released\"";
        require(lambda.is_finite() && (0.0..=largest).contains(&lambda), "perturb.lambda", lambda, allowed)?;
        let layer = perturb.injection_layer;
        let perturbs = self.method.is_augmented() && perturb.source().is_some();
        if perturbs && perturb.sites[Site::Feature].on() {
            let allowed = format!("1 to {} (field.depth)", self.field.depth);
            require((1..=self.field.depth).contains(&layer), "perturb.injection_layer", layer, &allowed)?;
        }
        for (site, config) in perturb.sites.iter() {
            validate_site(site, config)?;
        }
        if perturb.sizes == Sizes::Calibrated && perturb.step_unit == Some(StepUnit::Absolute) {
            return Err(Error::Config(
                "perturb.attack = \"calibrated\" measures steps in radii; leave perturb.step_unit empty or set it to \
                 \"relative\""
                    .into(),
            ));
        }
        if perturbs && perturb.sites_on().next().is_none() {
            return Err(Error::Config(
                "a perturbed method with every perturb.*.passes = \"off\" perturbs nothing; \
                 use method = \"nerf\" or \"mip-nerf\", or perturb.kind = \"fresh-jitter\" for the control"
                    .into(),
            ));
        }
        if perturb.sizes == Sizes::Paper && perturb.step_unit == Some(StepUnit::Relative) {
            let unset = perturb.sites.iter().find(|(_, config)| config.step_size.is_none());
            if let Some((site, _)) = unset {
                return Err(Error::Config(format!(
                    "perturb.step_unit = \"relative\" measures steps in radii, which the paper's step sizes are not; \
                     set perturb.{}.step_size, too",
                    site.name()
                )));
            }
        }
        let still = !self.sampling.jitter && self.sampling.density_noise == Some(0.0);
        if self.method.is_augmented() && perturb.second == SecondPass::Clean && still {
            return Err(Error::Config(
                "perturb.kind = \"fresh-jitter\" needs sampling.jitter = true or sampling.density_noise above 0: \
                 otherwise the second pass equals the first"
                    .into(),
            ));
        }
        if perturb.second == SecondPass::Clean && perturb.field == PerturbField::Separate {
            return Err(Error::Config(
                "perturb.kind = \"fresh-jitter\" is a second pass of the same fields; perturb.field must be \"shared\""
                    .into(),
            ));
        }
        Ok(())
    }
}

fn validate_site(site: Site, config: &SiteConfig) -> Result<()> {
    let about = site.about();
    let name = |field: &str| format!("perturb.{}.{field}", about.name);
    if let Some(steps) = config.steps {
        require(steps <= 1000, &name("steps"), steps, "0 to 1000")?;
    }
    if let Some(size) = config.step_size {
        require(size.is_finite() && size >= 0.0, &name("step_size"), size, "0 or positive")?;
    }
    if let Some(epsilon) = config.epsilon {
        let (largest, allowed) = about.largest_epsilon;
        require(epsilon.is_finite() && (0.0..=largest).contains(&epsilon), &name("epsilon"), epsilon, allowed)?;
    }
    // A scalar per sample: both norms are the same set, one name for it.
    if about.scalar && config.norm == Some(Norm::L2) {
        return Err(Error::Config(format!(
            "{} = \"l2\": this delta is one number a sample, for which l2 and linf are the same; use \"linf\"",
            name("norm")
        )));
    }
    Ok(())
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
