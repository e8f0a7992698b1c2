//! Settings that have no effect in a configuration, with the reason.

use super::registry::REGISTRY;
use super::{Config, Encoding, Method, REGULARIZERS, Regularizer, word};
use crate::data::RayGroup;

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
        let section = |name: &str| path.strip_prefix(name).is_some_and(|key| key.starts_with('.'));
        let method = self.method.name();
        if section("perturb") && !self.method.is_augmented() {
            return Some(format!("method {method} has no perturbed pass; aug-nerf and aug-mip-nerf have one"));
        }
        if section("regularizer") && self.regularizer.kind.is_empty() && path != "regularizer.kind" {
            let terms = REGULARIZERS.map(|term| term.name()).join(", ");
            return Some(format!("regularizer.kind names no term; choose from {terms}"));
        }
        let of_box =
            ["domain", "lattice", "points", "points_per_step", "jitter"].map(|key| format!("regularizer.{key}"));
        if of_box.iter().any(|setting| setting == path) && !self.regularizer.has_space_terms() {
            return Some("no term of regularizer.kind is an integral over the box".into());
        }
        if path == "regularizer.occlusion_share" && !self.regularizer.kind.contains(&Regularizer::Occlusion) {
            return Some("regularizer.kind does not name occlusion".into());
        }
        let is_of_single_rays = |term: &Regularizer| term.group() == Some(RayGroup::One);
        if path == "regularizer.rays" && !self.regularizer.kind.iter().any(is_of_single_rays) {
            return Some(
                "no term of regularizer.kind is computed on single rays; distortion and occlusion are, among others"
                    .into(),
            );
        }
        let is_idle = path == "regularizer.unseen_rays" && self.regularizer.unseen_groups().is_empty()
            || path == "regularizer.unseen_poses" && !self.regularizer.reads_unseen_cameras();
        if is_idle {
            return Some(
                "no term of regularizer.kind reads unseen rays; depth-smoothness and information-gain do, and others with \
                 regularizer.rays = \"unseen\""
                    .into(),
            );
        }
        if ["sampling.anneal_start", "sampling.anneal_middle"].contains(&path) && self.sampling.anneal_steps == 0 {
            return Some("sampling.anneal_steps is 0".into());
        }
        if path == "train.sam_direction" && self.train.sam_radius == 0.0 {
            return Some("train.sam_radius is 0".into());
        }
        let own = [("srn", Method::Srn), ("nv", Method::Nv), ("llff", Method::Llff)];
        if let Some((name, _)) = own.iter().find(|(name, of)| section(name) && self.method != *of) {
            return Some(format!("only method {name} reads it, and this is {method}"));
        }
        if (section("field") || section("sampling")) && !self.method.has_fields() {
            return Some(format!("method {method} has no field"));
        }
        let encoding = self.field.encoding;
        (section("field.hash") && encoding != Encoding::Hash)
            .then(|| format!("field.encoding is \"{}\"; hash grids need \"hash\"", word(encoding)))
    }
}

#[cfg(test)]
mod tests {
    use super::super::{build, parse_assignment};

    #[test]
    fn a_setting_without_effect_is_told_why() {
        let why = |set: &[&str], path: &str| {
            let set: Vec<_> = set.iter().map(|text| parse_assignment(text).unwrap()).collect();
            build(None, None, &set).unwrap().without_effect(path).unwrap_or_default()
        };
        for (set, path, words) in [
            (&[][..], "perturb.t.epsilon", "method nerf has no perturbed pass"),
            (&["method=mip-nerf"], "perturb.lambda", "method mip-nerf has no perturbed pass"),
            (&[], "regularizer.weight", "regularizer.kind names no term; choose from l1, tv, laplacian, distortion"),
            (&[], "field.hash.levels", "hash grids need \"hash\""),
            (&["method=srn"], "field.width", "method srn has no field"),
            (&[], "srn.steps", "only method srn reads it"),
        ] {
            assert!(why(set, path).contains(words), "{path}: {}", why(set, path));
        }
        for (set, path) in [
            (&["method=aug-nerf"][..], "perturb.lambda"),
            (&["regularizer.kind=tv"], "regularizer.weight"),
            (&[], "regularizer.kind"),
            (&["field.encoding=hash"], "field.hash.levels"),
            (&["method=srn"], "srn.steps"),
            (&[], "train.stepz"),
        ] {
            assert_eq!(why(set, path), "", "{path}");
        }
    }
}
