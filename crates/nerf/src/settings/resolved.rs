//! From a draft, [`Config`], to numbers: the scene's kind and then its bounds fill the settings that a draft may leave
//! empty.

use std::ops::Deref;

use super::{Batching, Config, DataKind, Representation, UnseenPoses};
use crate::base::Result;
use crate::base::settings::IdleKind;
use crate::data::Extent;
use crate::perturb::{PerSite, SiteNumbers};

/// A configuration without open numbers: what is trained. It derefs to the draft with every number written out, which a
/// run's `config.toml` holds.
#[derive(Clone, Debug, PartialEq)]
pub struct Resolved {
    config: Config,
    /// The numbers of the sites of section `perturb`, in the run's own units for every geometry.
    pub numbers: PerSite<SiteNumbers>,
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

impl Deref for Resolved {
    type Target = Config;

    fn deref(&self) -> &Config {
        &self.config
    }
}

impl Config {
    /// Fills the settings whose default depends on the kind of scene, removes those without effect, and checks the
    /// whole.
    ///
    /// # Errors
    /// If a setting is out of range, or contradicts another setting or the kind of scene.
    pub fn locate(mut self, kind: DataKind) -> Result<Config> {
        self.data.kind = kind;
        self.perturb.take_levels();
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
        self.train.decay_steps.get_or_insert(if forward { 250_000 } else { 500_000 });
        self.train.precrop_steps.get_or_insert(if batching == Batching::OneImage { 500 } else { 0 });
        let (unseen_rays, unseen_poses) = self.unseen();
        let regularizer = &mut self.regularizer;
        regularizer.unseen_rays = (!regularizer.unseen_groups().is_empty()).then_some(unseen_rays);
        regularizer.unseen_poses = regularizer.reads_unseen_cameras().then_some(unseen_poses);
        self.validate()?;
        Ok(self)
    }

    /// Returns the number of unseen rays, and where their cameras are, also if no term reads them.
    fn unseen(&self) -> (usize, UnseenPoses) {
        let around = match self.data.kind.object_half() {
            _ if self.data.kind.forward_facing() && !self.data.spherify => UnseenPoses::Box,
            Some(_) => UnseenPoses::Sphere,
            None => UnseenPoses::Between,
        };
        // Whole patches and pairs, of as many rays as a step's.
        let together = self.regularizer.unseen_groups().last().map_or(1, |group| group.rays());
        let rays = self.regularizer.unseen_rays.unwrap_or((self.train.rays / together).max(1) * together);
        (rays, self.regularizer.unseen_poses.unwrap_or(around))
    }

    /// Calls [`Config::locate`], and fills the settings whose default depends on the scene's extent.
    ///
    /// # Errors
    /// Those of [`Config::locate`].
    pub fn resolve(self, kind: DataKind, extent: Extent) -> Result<Resolved> {
        const FILLED: &str = "a located configuration has it";
        let Extent { near, far, domain, pixels } = extent;
        let mut config = self.locate(kind)?;
        let numbers = config.perturb.fill(far - near, config.sampling.even(), config.field.width);
        let (ndc, is_bounded) = (config.data.in_ndc(), kind.object_half().is_some());
        match config.representation() {
            Representation::Nerf | Representation::MipNerf | Representation::Srn => {}
            Representation::HashNerf => config.field.hash.resolve(ndc, is_bounded, (near, far), domain, pixels),
            Representation::Volume => config.nv.resolve(kind, domain),
            Representation::Planes => config.llff.resolve(is_bounded, (near, far)),
        }
        let (unseen_rays, unseen_poses) = config.unseen();
        Ok(Resolved {
            numbers,
            // A method without fields has none.
            density_noise: config.sampling.density_noise.unwrap_or(0.0),
            batching: config.train.batching.expect(FILLED),
            decay_steps: config.train.decay_steps.expect(FILLED),
            precrop_steps: config.train.precrop_steps.expect(FILLED),
            unseen_rays,
            unseen_poses,
            config,
        })
    }
}

impl Resolved {
    /// Returns the same with other unseen rays, for terms that section `regularizer` does not name. `None` keeps what is
    /// there.
    ///
    /// # Errors
    /// If a value is out of range, or contradicts another setting.
    pub fn with_unseen(mut self, rays: Option<usize>, poses: Option<UnseenPoses>) -> Result<Resolved> {
        let mut draft = self.config.clone();
        (draft.regularizer.unseen_rays, draft.regularizer.unseen_poses) = (rays, poses);
        draft.validate()?;
        self.unseen_rays = rays.unwrap_or(self.unseen_rays);
        self.unseen_poses = poses.unwrap_or(self.unseen_poses);
        Ok(self)
    }

    /// Returns the draft with every number filled in. It resolves to itself.
    pub fn into_draft(self) -> Config {
        self.config
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
