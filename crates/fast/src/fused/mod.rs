//! The field on the CPU as one differentiable operation: encoding and all layers over tiles of points, with only the
//! requested gradients.
//!
//! candle's graph carries gradients of points, view directions and feature delta. Those of the weights bypass it and go
//! into a [`Recorder`], for two reasons: an operation has at most three arguments, and the gradients of many chunks add
//! up in place. The reference in tests is the plain path of `augnerf_nerf::field`, of a field that neither records nor is
//! frozen.

mod backward;
mod encode;
mod forward;
pub mod kernels;
mod layout;
mod pool;
mod slope;

use std::cell::RefCell;
use std::sync::{Arc, Mutex, PoisonError};

use candle_core::{CpuStorage, CustomOp3, DType, Device, Layout, Result, Shape, Tensor, Var};

use augnerf_base::tensors::{Values, slice};

use backward::InputGradients;
use forward::{Inputs, Kept, Outputs, Prefix};
use slope::Tape;

pub use layout::{Architecture, Network};
pub use pool::forget;

/// Lays out a field's weights. `parameters` are weight and bias of every layer in the order of parameters, f32 on the
/// CPU.
pub fn prepare(architecture: Architecture, parameters: &[Tensor]) -> Result<Network> {
    let values = parameters.iter().map(|tensor| Ok(Values::of(&tensor.contiguous()?).slice()?.to_vec()));
    Ok(Network::new(architecture, values.collect::<Result<_>>()?))
}

/// Sums gradients of a field's weights.
pub struct Recorder {
    network: Arc<Network>,
    sum: Mutex<Vec<f32>>,
}

impl Recorder {
    /// Creates a recorder with a sum of zero.
    pub fn new(network: Arc<Network>) -> Recorder {
        Recorder { sum: Mutex::new(vec![0.0; network.gradient_size]), network }
    }

    /// Returns the sums, in the order of parameters, each in the shape of its entry in `shapes`.
    pub fn gradients(&self, shapes: Vec<Vec<usize>>) -> Result<Vec<Tensor>> {
        let sum = self.sum.lock().unwrap_or_else(PoisonError::into_inner);
        let gradients = self.network.parameter_gradients(&sum).into_iter().zip(shapes);
        gradients.map(|(values, shape)| Tensor::from_vec(values, shape, &Device::Cpu)).collect()
    }
}

/// A cache of the trunk's lower part at fixed points (`QueryPoints` of `augnerf_nerf::field`), up to one layer.
#[derive(Default)]
pub struct PrefixCache(RefCell<Option<(usize, Arc<Prefix>)>>);

impl PrefixCache {
    /// Returns the prefix of `points` up to layer `layer`, computed once.
    fn prefix(&self, network: &Network, points: &Tensor, layer: usize) -> Result<Arc<Prefix>> {
        let known = self.0.borrow().as_ref().filter(|(to, _)| *to == layer).map(|(_, prefix)| prefix.clone());
        if let Some(prefix) = known {
            return Ok(prefix);
        }
        let prefix = Arc::new(network.prefix(Values::of(&points.contiguous()?).slice()?, layer));
        self.0.replace(Some((layer, prefix.clone())));
        Ok(prefix)
    }
}

/// One query of a field.
pub struct Query<'a> {
    /// The weights in the layout of [`Network`].
    pub network: Arc<Network>,
    /// Receives the gradients of the weights. Without it they are constants.
    pub recorder: Option<Arc<Recorder>>,
    /// Keeps the trunk below a delta, if many queries share their points.
    pub below: Option<&'a PrefixCache>,
}

impl Query<'_> {
    /// Returns raw colour `[3 n]` followed by raw density `[n]`. `points` `[n, 3]`, `viewdirs` `[rays, 3]`, `delta`
    /// `[n, width]` of a 1-based trunk layer.
    pub fn run(self, points: &Tensor, viewdirs: &Tensor, delta: Option<(usize, &Tensor)>) -> Result<Tensor> {
        let wanted = Outputs {
            weights: self.recorder.is_some(),
            points: points.track_op(),
            viewdirs: viewdirs.track_op(),
            delta: delta.is_some_and(|(_, delta)| delta.track_op()),
        };
        // If nothing else is tracked, candle's backward pass would not reach the weights.
        let tracked;
        let viewdirs = if wanted == (Outputs { weights: true, ..Outputs::default() }) {
            tracked = Var::from_tensor(viewdirs)?;
            tracked.as_tensor()
        } else {
            viewdirs
        };
        let below = self.below.filter(|_| !wanted.points && !wanted.weights && points.dim(0).is_ok_and(|n| n > 0));
        let layer = delta.map_or(self.network.depth(), |(layer, _)| layer);
        let prefix = below.map(|below| below.prefix(&self.network, points, layer)).transpose()?;
        let none = Tensor::zeros(1, DType::F32, points.device())?;
        let operation = Fused {
            network: self.network,
            recorder: self.recorder,
            delta_layer: delta.map(|(layer, _)| layer),
            wanted,
            prefix,
            kept: Mutex::default(),
        };
        let delta = delta.map_or(Ok(none), |(_, delta)| delta.contiguous())?;
        points.contiguous()?.apply_op3(&viewdirs.contiguous()?, &delta, operation)
    }

    /// Returns raw density `[n]`, without gradients.
    pub fn density(self, points: &Tensor) -> Result<Tensor> {
        let points = points.detach().contiguous()?;
        let values = Values::of(&points);
        let inputs = Inputs { points: values.slice()?, viewdirs: &[], delta: None, prefix: None };
        let (raw, _) = self.network.forward(inputs, Outputs::default());
        let n = raw.len();
        Tensor::from_vec(raw, n, points.device())
    }
}

/// Raw density and its slope in the encoding, with what the weight gradients need.
pub struct Slope {
    /// `[n]`.
    pub raw: Tensor,
    /// `[n, channels]`.
    pub slope: Tensor,
    network: Arc<Network>,
    tape: Tape,
}

impl Slope {
    /// Computes both at points `[n, 3]`, or at features `[n, channels]` of a hash grid. With `positive_alone` the slope
    /// stays 0 where raw density is not positive.
    pub fn new(network: Arc<Network>, points: &Tensor, positive_alone: bool) -> Result<Slope> {
        let points = points.detach().contiguous()?;
        // NaN counts: it must be found and reported.
        let found = network.slope(Values::of(&points).slice()?, |raw| !positive_alone || raw > 0.0 || raw.is_nan());
        let n = found.raw.len();
        let channels = network.position_channels();
        let raw = Tensor::from_vec(found.raw, n, points.device())?;
        let slope = Tensor::from_vec(found.slope, (n, channels), points.device())?;
        Ok(Slope { raw, slope, network, tape: found.tape })
    }

    /// Returns gradients of weight and bias of the trunk and the density head, in the order of parameters. The loss has
    /// the derivative `cotangent [n, channels]` in the slope, and `d_raw [n]` in raw density.
    pub fn gradients(&self, cotangent: Option<&Tensor>, d_raw: Option<&Tensor>) -> Result<Vec<Vec<f32>>> {
        let whole = |tensor: Option<&Tensor>| tensor.map(|tensor| tensor.contiguous()).transpose();
        let (cotangent, d_raw) = (whole(cotangent)?, whole(d_raw)?);
        let (cotangent, d_raw) = (cotangent.as_ref().map(Values::of), d_raw.as_ref().map(Values::of));
        let cotangent = cotangent.as_ref().map(Values::slice).transpose()?;
        Ok(self.network.slope_gradients(&self.tape, cotangent, d_raw.as_ref().map(Values::slice).transpose()?))
    }
}

struct Fused {
    network: Arc<Network>,
    recorder: Option<Arc<Recorder>>,
    delta_layer: Option<usize>,
    wanted: Outputs,
    prefix: Option<Arc<Prefix>>,
    /// Kept from the forward to the backward pass.
    kept: Mutex<Option<Kept>>,
}

impl Fused {
    fn inputs<'a>(&'a self, points: &'a [f32], viewdirs: &'a [f32], delta: &'a [f32]) -> Inputs<'a> {
        let delta = self.delta_layer.map(|layer| (layer, delta));
        Inputs { points, viewdirs, delta, prefix: self.prefix.as_deref() }
    }
}

impl CustomOp3 for Fused {
    fn name(&self) -> &'static str {
        "fused-field"
    }

    fn cpu_fwd(
        &self,
        points: &CpuStorage,
        points_layout: &Layout,
        viewdirs: &CpuStorage,
        viewdirs_layout: &Layout,
        delta: &CpuStorage,
        delta_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let (points, viewdirs) = (slice(points, points_layout)?, slice(viewdirs, viewdirs_layout)?);
        let (n, rays, delta) =
            (points.len() / self.network.code().inputs(), viewdirs.len() / 3, slice(delta, delta_layout)?);
        if rays == 0 && n > 0 || rays > 0 && n % rays != 0 {
            candle_core::bail!("fused field: {n} points of {rays} rays");
        }
        if self.delta_layer.is_some() && delta.len() != n * self.network.width() {
            candle_core::bail!("fused field: a delta of {} values for {n} points", delta.len());
        }
        let (raw, kept) = self.network.forward(self.inputs(points, viewdirs, delta), self.wanted);
        *self.kept.lock().unwrap_or_else(PoisonError::into_inner) = Some(kept);
        Ok((CpuStorage::F32(raw), Shape::from(4 * n)))
    }

    fn bwd(
        &self,
        points: &Tensor,
        viewdirs: &Tensor,
        delta: &Tensor,
        _raw: &Tensor,
        gradient: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner).take();
        let Some(kept) = kept else {
            candle_core::bail!("fused field: a second backward pass through one forward pass");
        };
        let gradient = gradient.contiguous()?;
        let (p, v, d, g) = (Values::of(points), Values::of(viewdirs), Values::of(delta), Values::of(&gradient));
        let inputs = self.inputs(p.slice()?, v.slice()?, d.slice()?);
        let network = &self.network;
        let found = match &self.recorder {
            Some(recorder) => {
                let mut sums = recorder.sum.lock().unwrap_or_else(PoisonError::into_inner);
                network.backward(inputs, &kept, g.slice()?, self.wanted, &mut sums)
            }
            None => network.backward(inputs, &kept, g.slice()?, self.wanted, &mut []),
        };
        let InputGradients { points: d_points, viewdirs: d_viewdirs, delta: d_delta } = found;
        let tensor = |wanted: bool, values: Vec<f32>, like: &Tensor| {
            wanted.then(|| Tensor::from_vec(values, like.shape(), like.device())).transpose()
        };
        Ok((
            tensor(self.wanted.points, d_points, points)?,
            tensor(self.wanted.viewdirs, d_viewdirs, viewdirs)?,
            tensor(self.wanted.delta, d_delta, delta)?,
        ))
    }
}
