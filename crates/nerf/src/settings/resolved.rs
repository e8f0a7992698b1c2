//! From a draft, [`Config`], to numbers: the scene's kind and then its bounds fill the settings that a draft may leave
//! empty.

use std::ops::Deref;

use super::{Batching, Config, DataKind, Representation, ResolvedPerturb, UnseenPoses};
use crate::base::Result;
use crate::base::settings::IdleKind;
use crate::data::Extent;

/// A configuration whose scene is known. It derefs to the draft that it fills in. Settings that depend on the scene's
/// kind are here as plain values.
#[derive(Clone, Debug, PartialEq)]
pub struct Located {
    config: Config,
    /// Standard deviation of the noise on raw density in training.
    pub density_noise: f64,
    /// Source of a step's rays.
    pub batching: Batching,
    /// Number of steps in which an exponential learning rate falls by `train.decay_rate`.
    pub decay_steps: u64,
    /// Number of steps whose one-image batches use the central part only.
    pub precrop_steps: u64,
    /// Number of unseen rays of each kind that a term reads in a step.
    pub unseen_rays: usize,
    /// Where their cameras are.
    pub unseen_poses: UnseenPoses,
}

/// A configuration without open numbers: what is trained, and what a run's `config.toml` holds.
#[derive(Clone, Debug, PartialEq)]
pub struct Resolved {
    located: Located,
    /// Section `perturb` with every number filled in.
    pub perturb: ResolvedPerturb,
}

impl Deref for Located {
    type Target = Config;

    fn deref(&self) -> &Config {
        &self.config
    }
}

impl Deref for Resolved {
    type Target = Located;

    fn deref(&self) -> &Located {
        &self.located
    }
}

impl Config {
    /// Fills the settings whose default depends on the kind of scene, removes those without effect, and checks the
    /// whole.
    ///
    /// # Errors
    /// If a setting is out of range, or contradicts another setting or the kind of scene.
    pub fn locate(mut self, kind: DataKind) -> Result<Located> {
        self.data.kind = kind;
        self.regularizer.settle();
        self.checked_table()?;
        let idle = self.idle();
        self = self.at_defaults(|setting| idle.at(&setting.path).any(|idle| idle.kind == IdleKind::Dropped));
        let forward = kind.forward_facing();
        self.data.downscale.get_or_insert(kind.format().map_or(1, |format| format.downscale));
        self.data.pixel_origin = Some(self.data.origin_of_pixels());
        let density_noise = self.sampling.density_noise.unwrap_or(if forward { 1.0 } else { 0.0 });
        self.sampling.density_noise = self.method.has_fields().then_some(density_noise);
        let batching =
            *self.train.batching.get_or_insert(if forward { Batching::AllImages } else { Batching::OneImage });
        let decay_steps = *self.train.decay_steps.get_or_insert(if forward { 250_000 } else { 500_000 });
        let precrop = if batching == Batching::OneImage { 500 } else { 0 };
        let precrop_steps = *self.train.precrop_steps.get_or_insert(precrop);
        let around = match kind.object_half() {
            _ if forward && !self.data.spherify => UnseenPoses::Box,
            Some(_) => UnseenPoses::Sphere,
            None => UnseenPoses::Between,
        };
        let unseen_poses = self.regularizer.unseen_poses.unwrap_or(around);
        // Whole patches and pairs, of as many rays as a step's.
        let groups = self.regularizer.unseen_groups();
        let together = groups.last().map_or(1, |group| group.rays());
        let unseen_rays = self.regularizer.unseen_rays.unwrap_or((self.train.rays / together).max(1) * together);
        self.regularizer.unseen_rays = (!groups.is_empty()).then_some(unseen_rays);
        self.regularizer.unseen_poses = self.regularizer.reads_unseen_cameras().then_some(unseen_poses);
        self.validate()?;
        Ok(Located { config: self, density_noise, batching, decay_steps, precrop_steps, unseen_rays, unseen_poses })
    }

    /// Calls [`Config::locate`] and [`Located::resolve`] for a scene whose kind and extent are known.
    ///
    /// # Errors
    /// Those of [`Config::locate`].
    pub fn resolve(self, kind: DataKind, extent: Extent) -> Result<Resolved> {
        Ok(self.locate(kind)?.resolve(extent))
    }
}

impl Located {
    /// Fills the settings whose default depends on the scene's extent.
    pub fn resolve(mut self, extent: Extent) -> Resolved {
        let Extent { near, far, domain, pixels } = extent;
        let perturb = self.config.perturb.clone();
        let perturb = perturb.resolve(far - near, self.config.sampling.coarse, self.config.field.width);
        self.config.perturb = perturb.clone().into_draft();
        let (kind, ndc) = (self.config.data.kind, self.config.data.in_ndc());
        match self.config.representation() {
            Representation::Nerf | Representation::MipNerf => {}
            Representation::HashNerf => {
                self.config.field.hash.resolve(ndc, kind.object_half().is_some(), (near, far), domain, pixels);
            }
            Representation::Srn => {}
            Representation::Volume => self.config.nv.resolve(kind, domain),
            Representation::Planes => self.config.llff.resolve(kind.object_half().is_some(), (near, far)),
        }
        Resolved { located: self, perturb }
    }

    /// Returns the draft, filled in as far as is known.
    pub fn into_draft(self) -> Config {
        self.config
    }
}

impl Resolved {
    /// Returns the same with other unseen rays, for terms that section `regularizer` does not name. `None` keeps what is
    /// there.
    ///
    /// # Errors
    /// If a value is out of range, or contradicts another setting.
    pub fn with_unseen(mut self, rays: Option<usize>, poses: Option<UnseenPoses>) -> Result<Resolved> {
        let mut draft = self.clone().into_draft();
        (draft.regularizer.unseen_rays, draft.regularizer.unseen_poses) = (rays, poses);
        draft.validate()?;
        let Located { unseen_rays, unseen_poses, .. } = &mut self.located;
        (*unseen_rays, *unseen_poses) = (rays.unwrap_or(*unseen_rays), poses.unwrap_or(*unseen_poses));
        Ok(self)
    }

    /// Returns the draft with every number filled in. It resolves to itself.
    pub fn into_draft(self) -> Config {
        self.located.config
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// They are checked as those of a term, and are no part of the configuration.
    #[test]
    fn unseen_rays_of_other_terms_are_checked_and_change_no_hash() {
        let extent = Extent { near: 0.0, far: 1.0, domain: None, pixels: 16 };
        let config = Config::default().resolve(DataKind::BuiltinForward, extent).unwrap();
        let with = |rays, poses| config.clone().with_unseen(rays, poses);
        assert_eq!(with(None, None).unwrap(), config);
        let other = with(Some(128), Some(UnseenPoses::Between)).unwrap();
        assert_eq!((other.unseen_rays, other.unseen_poses), (128, UnseenPoses::Between));
        assert_eq!((other.hash(), other.into_draft()), (config.hash(), config.clone().into_draft()));
        let refused = |rays, poses| with(rays, poses).unwrap_err().to_string();
        assert!(refused(Some(0), None).contains("regularizer.unseen_rays"));
        assert!(refused(None, Some(UnseenPoses::Sphere)).contains("regularizer.unseen_poses = \"sphere\""));
    }
}
