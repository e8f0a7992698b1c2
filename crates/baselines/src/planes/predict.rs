//! Prediction of multiplane images of complete views, once per weights and views.

use std::sync::{Arc, PoisonError};

use candle_core::{DType, Tensor};
use sha2::{Digest, Sha256};

use crate::base::{Error, Image, Result};
use crate::grids::blend_views::blend_views;

use super::geometry::{Viewpoint, inputs_of};
use super::mpi::{CachedMpis, Mpi, Mpis, SourceView, eyes};
use super::network::MpiNetwork;
use super::sweep::{Window, sweep};

impl MpiNetwork {
    /// Returns the multiplane images of `views` with the current weights, each predicted when it is needed. Earlier
    /// ones are returned again if weights, views and depths are the same, so that a second image costs no prediction.
    pub fn mpis(&self, views: &[SourceView], depths: &[f64]) -> Result<Arc<Mpis>> {
        let weights = self.digest()?;
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let same = |mpis: &Mpis| {
            mpis.depths == depths
                && mpis.views.len() == views.len()
                && mpis.views.iter().zip(views).all(|(a, b)| a.is(b))
        };
        if let Some(known) = kept.as_ref().filter(|known| known.weights == weights && same(&known.mpis)) {
            return Ok(known.mpis.clone());
        }
        let network = self.copy()?;
        let predict =
            Box::new(move |views: &[SourceView], view: usize, depths: &[f64]| network.predict(views, view, depths));
        let mpis = Arc::new(Mpis::new(views, depths, predict));
        *kept = Some(CachedMpis { weights, mpis: mpis.clone() });
        Ok(mpis)
    }

    /// Predicts the multiplane image of one view. Threads share the work of each operation.
    ///
    /// # Errors
    /// If weights are NaN; those of candle.
    pub fn predict(&self, views: &[SourceView], view: usize, depths: &[f64]) -> Result<Mpi> {
        let eyes = eyes(views);
        let eye = eyes[view];
        let seen: Vec<(&Viewpoint, &Image)> = inputs_of(&eyes, view, self.inputs(), None)
            .into_iter()
            .map(|input| (&views[input].eye, &*views[input].image))
            .collect();
        let window = Window::whole(eye.camera.width, eye.camera.height);
        let volume = sweep(&eye, &seen, depths, window, self.dtype(), self.device())?;
        let raw = self.weights(false).forward(&volume)?;
        let sum = raw.sum_all()?.to_dtype(DType::F64)?.to_scalar::<f64>()?;
        if !sum.is_finite() {
            return Err(Error::Diverged(format!(
                "the planes of training view {view} are not numbers: the weights are broken; delete the newest checkpoint to fall \
                 back on the one before it"
            )));
        }
        // One plane at a time: all at once would take more memory than the network.
        let plane = |k: usize| blend_views(&raw.narrow(0, k, 1)?, &volume.narrow(0, k, 1)?);
        let planes = (0..depths.len()).map(plane).collect::<candle_core::Result<Vec<_>>>()?;
        Mpi::new(eye, &Tensor::cat(&planes, 0)?)
    }

    /// Returns a hash of all weights.
    fn digest(&self) -> Result<[u8; 32]> {
        let mut digest = Sha256::new();
        for (_, var) in &self.parameters.variables {
            let values = var.as_detached_tensor().flatten_all()?.to_dtype(DType::F64)?.to_vec1::<f64>()?;
            let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
            digest.update(bytes);
        }
        Ok(digest.finalize().into())
    }
}
