//! The baselines as the trainer sees them.

use std::sync::Arc;

use candle_core::{DType, Device, Tensor, Var};

use crate::base::Result;
use crate::data::Scene;
use crate::field::Density;
use crate::methods::{Family, Learner, Network, Renderer};
use crate::planes::{MpiNetwork, PlanesLearner};
use crate::settings::{Config, Representation, Resolved};
use crate::srn::{Srn, SrnLearner, SrnRenderer};
use crate::volume::{NeuralVolume, VolumeDensity, VolumeLearner, VolumeRenderer};

/// Returns the family that makes the parameters of a representation, or `None` if it is no baseline.
pub fn family(representation: Representation) -> Option<&'static dyn Family> {
    match representation {
        Representation::Srn => Some(&SrnFamily),
        Representation::Volume => Some(&VolumeFamily),
        Representation::Planes => Some(&PlanesFamily),
        Representation::Nerf | Representation::MipNerf | Representation::HashNerf => None,
    }
}

struct SrnFamily;

impl Family for SrnFamily {
    fn part(&self) -> &'static str {
        "srn"
    }

    fn parameter_names(&self, config: &Config) -> Vec<(String, Vec<usize>)> {
        Srn::parameter_names(&config.srn)
    }

    fn init(&self, config: &Resolved, dtype: DType, device: &Device) -> Result<Arc<dyn Network>> {
        Ok(Arc::new(Srn::init(&config.srn, config.seed, dtype, device)?))
    }

    fn from_parameters(&self, config: &Config, values: Vec<Tensor>) -> Result<Arc<dyn Network>> {
        Ok(Arc::new(Srn::from_parameters(&config.srn, values)?))
    }
}

impl Network for Srn {
    fn variables(&self) -> Vec<(String, Var)> {
        Srn::variables(self).to_vec()
    }

    fn learner(&self, config: &Resolved, scene: &Scene, dtype: DType, device: &Device) -> Result<Box<dyn Learner>> {
        Ok(Box::new(SrnLearner::new(config, scene, self.clone(), dtype, device)?))
    }

    fn renderer(&self, _: &Config, _: &Scene) -> Result<Box<dyn Renderer>> {
        Ok(Box::new(SrnRenderer::new(self)?))
    }

    fn density(&self) -> Result<Option<Box<dyn Density>>> {
        Ok(None)
    }
}

struct VolumeFamily;

impl Family for VolumeFamily {
    fn part(&self) -> &'static str {
        "volume"
    }

    fn parameter_names(&self, config: &Config) -> Vec<(String, Vec<usize>)> {
        NeuralVolume::parameter_names(config)
    }

    fn init(&self, config: &Resolved, dtype: DType, device: &Device) -> Result<Arc<dyn Network>> {
        Ok(Arc::new(NeuralVolume::init(config, dtype, device)?))
    }

    fn from_parameters(&self, config: &Config, values: Vec<Tensor>) -> Result<Arc<dyn Network>> {
        Ok(Arc::new(NeuralVolume::from_parameters(config, values)?))
    }
}

impl Network for NeuralVolume {
    fn variables(&self) -> Vec<(String, Var)> {
        NeuralVolume::variables(self)
    }

    fn learner(&self, config: &Resolved, scene: &Scene, dtype: DType, device: &Device) -> Result<Box<dyn Learner>> {
        Ok(Box::new(VolumeLearner::new(config, scene, self.clone(), dtype, device)?))
    }

    fn renderer(&self, config: &Config, scene: &Scene) -> Result<Box<dyn Renderer>> {
        Ok(Box::new(VolumeRenderer::new(self, config, scene)?))
    }

    fn density(&self) -> Result<Option<Box<dyn Density>>> {
        Ok(Some(Box::new(VolumeDensity::new(self)?)))
    }
}

struct PlanesFamily;

impl Family for PlanesFamily {
    fn part(&self) -> &'static str {
        "planes"
    }

    fn parameter_names(&self, config: &Config) -> Vec<(String, Vec<usize>)> {
        MpiNetwork::parameter_names(config)
    }

    fn check(&self, config: &Resolved, scene: &Scene) -> Result<()> {
        PlanesLearner::check(config, scene)
    }

    fn init(&self, config: &Resolved, dtype: DType, device: &Device) -> Result<Arc<dyn Network>> {
        Ok(Arc::new(MpiNetwork::init(config, dtype, device)?))
    }

    fn from_parameters(&self, config: &Config, values: Vec<Tensor>) -> Result<Arc<dyn Network>> {
        Ok(Arc::new(MpiNetwork::from_parameters(config, values)?))
    }
}

impl Network for MpiNetwork {
    fn variables(&self) -> Vec<(String, Var)> {
        MpiNetwork::variables(self)
    }

    fn learner(&self, config: &Resolved, scene: &Scene, _: DType, _: &Device) -> Result<Box<dyn Learner>> {
        Ok(Box::new(PlanesLearner::new(config, scene, self.clone())?))
    }

    fn renderer(&self, config: &Config, scene: &Scene) -> Result<Box<dyn Renderer>> {
        Ok(Box::new(MpiNetwork::renderer(self, config, scene)?))
    }

    fn density(&self) -> Result<Option<Box<dyn Density>>> {
        Ok(None)
    }
}
