//! Settings that have no effect in a configuration, with the reason. Notes name them, and files and hashes may hold their
//! defaults instead.

use super::{Batching, Config, Encoding, Method, Placing, Schedule, VolumeCode, word};
use crate::base::settings::IdleKind::{Dropped, Noted, Unhashed};
use crate::base::settings::IdleSettings;

impl Config {
    /// Returns why the setting `path` has no effect in this configuration, or `None` if it may have one. An unknown setting
    /// gives `None`.
    ///
    /// ```
    /// use augnerf_nerf::settings::Config;
    ///
    /// let nerf = Config::default();
    /// assert!(nerf.without_effect("perturb.lambda").unwrap().contains("no perturbed pass"));
    /// assert_eq!(nerf.without_effect("train.steps"), None);
    /// ```
    pub fn without_effect(&self, path: &str) -> Option<String> {
        self.idle().at(path).next().map(|idle| idle.why.clone())
    }

    /// Returns whether a field on a hash grid is trained.
    pub fn on_hash_grid(&self) -> bool {
        self.method.has_fields() && self.field.encoding == Encoding::Hash
    }

    /// Returns all settings without effect.
    pub(crate) fn idle(&self) -> IdleSettings {
        let mut idle = IdleSettings::default();
        let method = self.method.name();
        for (section, of) in [("srn", Method::Srn), ("nv", Method::Nv), ("llff", Method::Llff)] {
            let why = format!("only method {section} reads it, and this is {method}");
            idle.add(Dropped, "", &[section], self.method != of, why);
        }
        let (without_field, no_field) = (!self.method.has_fields(), format!("method {method} has no field"));
        let no_pass = format!("method {method} has no perturbed pass; aug-nerf and aug-mip-nerf have one");
        idle.add(Unhashed, "", &["perturb"], !self.method.is_augmented(), no_pass);
        idle.add(Dropped, "", &["field", "sampling", "perturb"], without_field, &*no_field);
        idle.add(Unhashed, "train.", &["coarse_weight", "dead_start_share"], without_field, no_field);
        self.data.idle(&mut idle);
        self.idle_in_field(&mut idle);
        self.idle_in_train(&mut idle);
        if self.method.is_augmented() {
            self.perturb.idle(&mut idle);
        }
        self.regularizer.idle(&mut idle);
        let names = ["threshold", "box", "reference", "points", "at"];
        idle.add(Noted, "eval.mesh.", &names, self.eval.mesh.resolution == 0, "eval.mesh.resolution is 0");
        idle.add(Unhashed, "nv.", &["kl"], self.nv.code == VolumeCode::Fixed, "nv.code is \"fixed\"");
        idle.add(Unhashed, "nv.", &["warp_resolution"], !self.nv.warp, "nv.warp is false");
        idle
    }

    fn idle_in_field(&self, idle: &mut IdleSettings) {
        let (encoding, on_grid, sampling) = (word(self.field.encoding), self.on_hash_grid(), &self.sampling);
        let needs_grid = format!("field.encoding is \"{encoding}\"; hash grids need \"hash\"");
        idle.add(Unhashed, "field.", &["hash"], !on_grid, needs_grid);
        idle.add(Unhashed, "field.", &["hash.finest"], self.field.hash.levels == 1, "field.hash.levels is 1");
        let why = "field.encoding is \"hash\"; the grid encodes positions";
        idle.add(Unhashed, "field.", &["position_octaves"], on_grid, why);
        let names = ["anneal_start", "anneal_middle"];
        idle.add(Dropped, "sampling.", &names, sampling.anneal_steps == 0, "sampling.anneal_steps is 0");
        let is_occupied = sampling.kind == Placing::Occupancy;
        idle.add(Unhashed, "sampling.", &["occupancy"], !is_occupied, "sampling.kind is not \"occupancy\"");
        let names = ["coarse", "fine", "resample_padding"];
        idle.add(Unhashed, "sampling.", &names, is_occupied, "sampling.kind is \"occupancy\"");
        let why = format!("field.encoding is \"{encoding}\"; MipNeRF and hash grids read it");
        idle.add(Noted, "sampling.", &["resample_padding"], !self.field.encoding.at_intervals(), why);
    }

    fn idle_in_train(&self, idle: &mut IdleSettings) {
        let train = &self.train;
        let names = ["rays", "chunk", "batching", "precrop_steps", "precrop_fraction"];
        let why = format!("a step of method {} has windows of views, not rays", self.method.name());
        idle.add(Unhashed, "train.", &names, !self.method.learns_from_rays(), why);
        let all_images = train.batching == Some(Batching::AllImages);
        let why = "train.batching is \"all-images\"; only batches of one image are cropped";
        idle.add(Noted, "train.", &["precrop_steps", "precrop_fraction"], all_images, why);
        let (is_exponential, why) =
            (train.schedule == Schedule::Exponential, format!("train.schedule is \"{}\"", word(train.schedule)));
        let names = ["final_learning_rate", "warmup_share", "warmup_from"];
        idle.add(Noted, "train.", &names, is_exponential, &*why);
        idle.add(Noted, "train.", &["decay_rate", "decay_steps"], !is_exponential, why);
        let why = "field.encoding is \"hash\"; the coarse pass of a hash grid has no loss";
        idle.add(Unhashed, "train.", &["coarse_weight"], self.on_hash_grid(), why);
        idle.add(Unhashed, "train.", &["sam_direction"], train.sam_radius == 0.0, "train.sam_radius is 0");
        idle.add(Noted, "train.", &["eval_stride"], train.eval_every == 0, "train.eval_every is 0");
    }
}

#[cfg(test)]
mod tests;
