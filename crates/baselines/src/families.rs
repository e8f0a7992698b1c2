//! The baselines as the trainer sees them.

use std::sync::Arc;

use candle_core::{DType, Device, Var};

use crate::base::Result;
use crate::data::{RayParts, Scene};
use crate::field::Density;
use crate::methods::{Batches, Family, Learner, Network, Renderer};
use crate::planes::{MpiNetwork, PlanesLearner};
use crate::settings::{Config, Representation, Resolved};
use crate::srn::{Srn, SrnLearner, SrnRenderer};
use crate::volume::{NeuralVolume, VolumeDensity, VolumeLearner, VolumeRenderer};

/// Returns the family that makes the parameters of a representation, or `None` if it is no baseline.
pub fn family(representation: Representation) -> Option<&'static Family> {
    match representation {
        Representation::Srn => Some(&SRN),
        Representation::Volume => Some(&VOLUME),
        Representation::Planes => Some(&PLANES),
        Representation::Nerf | Representation::MipNerf | Representation::HashNerf => None,
    }
}

static SRN: Family = Family {
    part: "srn",
    parameter_names: |config| Srn::parameter_names(&config.srn),
    check: check_batches,
    init: |config, dtype, device| Ok(Arc::new(Srn::init(&config.srn, config.seed, dtype, device)?)),
    from_parameters: |config, values| Ok(Arc::new(Srn::from_parameters(&config.srn, values)?)),
};

static VOLUME: Family = Family {
    part: "volume",
    parameter_names: NeuralVolume::parameter_names,
    check: check_batches,
    init: |config, dtype, device| Ok(Arc::new(NeuralVolume::init(config, dtype, device)?)),
    from_parameters: |config, values| Ok(Arc::new(NeuralVolume::from_parameters(config, values)?)),
};

static PLANES: Family = Family {
    part: "planes",
    parameter_names: MpiNetwork::parameter_names,
    check: PlanesLearner::check,
    init: |config, dtype, device| Ok(Arc::new(MpiNetwork::init(config, dtype, device)?)),
    from_parameters: |config, values| Ok(Arc::new(MpiNetwork::from_parameters(config, values)?)),
};

/// Checks that training views hold a step's rays.
fn check_batches(config: &Resolved, scene: &Scene) -> Result<()> {
    Batches::new(config, scene, RayParts::default()).map(drop)
}

impl Network for Srn {
    fn variables(&self) -> Vec<(String, Var)> {
        self.parameters.variables.clone()
    }

    fn learner(&self, config: &Resolved, scene: &Scene, dtype: DType, device: &Device) -> Result<Box<dyn Learner>> {
        Ok(Box::new(SrnLearner::new(config, scene, self.clone(), dtype, device)?))
    }

    fn renderer(&self, _: &Config, _: &Scene) -> Result<Box<dyn Renderer>> {
        Ok(Box::new(SrnRenderer::new(self)))
    }
}

impl Network for NeuralVolume {
    fn variables(&self) -> Vec<(String, Var)> {
        self.parameters.variables.clone()
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

impl Network for MpiNetwork {
    fn variables(&self) -> Vec<(String, Var)> {
        self.parameters.variables.clone()
    }

    fn learner(&self, config: &Resolved, scene: &Scene, _: DType, _: &Device) -> Result<Box<dyn Learner>> {
        Ok(Box::new(PlanesLearner::new(config, scene, self.clone())?))
    }

    fn renderer(&self, config: &Config, scene: &Scene) -> Result<Box<dyn Renderer>> {
        Ok(Box::new(MpiNetwork::renderer(self, config, scene)?))
    }
}
