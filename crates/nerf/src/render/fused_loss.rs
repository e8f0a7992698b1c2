//! From a field's raw output to the photometric loss of its rays, as one differentiable operation in f32 on the CPU. It
//! includes activations, density noise, output deltas after them, compositing and the loss.
//!
//! `activate`, `UsedDeltas::add_to`, [`super::volume::composite`] and [`photometric_loss`] are the same in tensor operations.
//! They serve all other cases. They are also the reference, which this operation equals bit for bit.

use candle_core::{CpuStorage, CustomOp3, DType, Device, Layout, Result as TensorResult, Shape, Tensor};

use crate::base::Result;
use crate::base::tensors::Values;
use crate::field::settings::DensityActivation;
use crate::field::{Field, RawOutput, density_of, leads_away, raw_density_gradient};
use crate::perturb::{DeltaSet, Deltas, Norm, PaperSite, Sets, SiteSet, larger, output_range, smaller};
use augnerf_fast::scan::{Gradients, Passed, Scan};

use super::pass::Pass;
use super::photometric_loss;
use super::volume::{Composite, LAST_INTERVAL};

/// Samples with the output of their field.
#[derive(Clone, Copy)]
pub(super) struct Samples<'a> {
    pub(super) field: &'a Field,
    pub(super) pass: Pass<'a>,
    /// Their positions: the pass's `t_vals` with their delta.
    pub(super) t_vals: &'a Tensor,
    /// `[rays, samples, 3]` and `[rays, samples]`.
    pub(super) raw: &'a RawOutput,
    /// Output deltas that are added after the activations, and their constraint sets.
    pub(super) added: Option<(&'a Deltas, &'a Sets)>,
}

/// The loss of the composited samples.
pub(super) struct ShadedLoss {
    /// A scalar, with its graph.
    pub(super) loss: Tensor,
    /// Without a graph.
    pub(super) composite: Composite,
    /// The output deltas as they were used: projected onto what the samples allow.
    pub(super) used: Vec<(PaperSite, Tensor)>,
}

/// The box of an output delta.
struct BoxSet {
    radius: f32,
    /// 1 for each sample of a ray that may move, 0 for others.
    mask: Option<Vec<f32>>,
}

impl BoxSet {
    /// Returns `None` for any other kind of set.
    fn of(set: &DeltaSet) -> Result<Option<BoxSet>> {
        if set.norm != Norm::Linf || set.bounds.is_some() || set.radius.elem_count() != 1 {
            return Ok(None);
        }
        let mask = set.mask.as_ref().map(|mask| mask.flatten_all()?.to_vec1::<f32>()).transpose()?;
        Ok(Some(BoxSet { radius: set.radius.flatten_all()?.to_vec1::<f32>()?[0], mask }))
    }
}

/// The output deltas of a pass, added after the activations.
enum Added {
    Nothing,
    Boxes(Boxes),
    /// Deltas that this operation does not add.
    NotHere,
}

/// The output deltas whose sets are boxes.
struct Boxes {
    /// Of colours `[3 n]`, then of densities `[n]`. 0 where a site is off.
    delta: Tensor,
    rgb: Option<BoxSet>,
    density: Option<BoxSet>,
}

impl Added {
    fn of(samples: &Samples) -> Result<Added> {
        let Samples { raw, added: Some((deltas, sets)), .. } = samples else { return Ok(Added::Nothing) };
        let (mut rgb, mut density) = (None, None);
        for SiteSet { site, set } in sets.iter() {
            let at_site = match site.at() {
                // Samples and raw output have these.
                PaperSite::T | PaperSite::Xyz | PaperSite::View | PaperSite::Feature => continue,
                PaperSite::Rgb => &mut rgb,
                PaperSite::Density => &mut density,
            };
            let Some(delta) = deltas.get(site.name()) else { continue };
            // A site of the user's own.
            if site.name() != site.at().name() {
                return Ok(Added::NotHere);
            }
            let Some(box_set) = BoxSet::of(set)? else { return Ok(Added::NotHere) };
            *at_site = Some((delta, box_set));
        }
        if rgb.is_none() && density.is_none() {
            return Ok(Added::Nothing);
        }
        let flat = |site: &Option<(&Tensor, BoxSet)>, raw: &Tensor| match site {
            Some((delta, _)) => delta.flatten_all(),
            None => raw.detach().flatten_all()?.zeros_like(),
        };
        let delta = Tensor::cat(&[flat(&rgb, &raw.rgb)?, flat(&density, &raw.density)?], 0)?;
        let box_set = |site: Option<(&Tensor, BoxSet)>| site.map(|(_, set)| set);
        Ok(Added::Boxes(Boxes { delta, rgb: box_set(rgb), density: box_set(density) }))
    }
}

/// The operation from raw output `[4 n]`, positions and output deltas `[4 n]` to the loss. The loss is known when the
/// operation is created.
struct FusedLoss {
    activation: DensityActivation,
    /// `field.rgb_padding`.
    padding: f64,
    /// `field.rgb_limit`, or infinity.
    limit: f32,
    scan: Scan,
    /// Added to raw density, `[n]`.
    noise: Option<Vec<f32>>,
    loss: f32,
    /// Rendered colours minus their targets, `[3 rays]`.
    errors: Vec<f32>,
    activations: Activations,
    /// Whether output deltas need a gradient.
    wants_delta: bool,
}

/// The values of the samples after their activations.
#[derive(Default)]
struct Activations {
    /// Sigmoids of raw colours, `[3 n]`.
    sigmoids: Vec<f32>,
    /// Colours and densities that are composited.
    rgb: Vec<f32>,
    density: Vec<f32>,
    /// Output deltas as they were used, `[3 n]` and `[n]`.
    used: [Vec<f32>; 2],
    /// Weights, and transmittance behind each sample, `[n]`.
    weights: Vec<f32>,
    behind: Vec<f32>,
}

impl Samples<'_> {
    /// Returns the loss against `target` `[rays, 3]`, or `None` if the fused operation does not support these samples.
    pub(super) fn fused_loss(&self, target: &Tensor) -> Result<Option<ShadedLoss>> {
        let Samples { field, pass, t_vals, raw, .. } = *self;
        let Some(joined) = &raw.joined else { return Ok(None) };
        let added = match Added::of(self)? {
            Added::Nothing => None,
            Added::Boxes(boxes) => Some(boxes),
            Added::NotHere => return Ok(None),
        };
        let (rays, samples) = raw.density.dims2()?;
        let direction_norm = pass.rays.direction_norm.to_dtype(DType::F64)?.flatten_all()?.to_vec1()?;
        let mut operation = FusedLoss {
            activation: field.config().density_activation,
            padding: field.config().rgb_padding,
            limit: match field.config().rgb_limit {
                0.0 => f32::INFINITY,
                limit => limit as f32,
            },
            scan: Scan { direction_norm, last_interval: LAST_INTERVAL, background: pass.background },
            noise: pass.density_noise.map(|noise| noise.flatten_all()?.to_vec1()).transpose()?,
            loss: 0.0,
            errors: Vec::new(),
            activations: Activations::default(),
            wants_delta: added.as_ref().is_some_and(|added| added.delta.track_op()),
        };
        let t_vals = t_vals.contiguous()?;
        let activations = operation.activate(Values::of(joined).slice()?, added.as_ref(), samples)?;
        let (out, behind) =
            operation.scan.forward(&activations.rgb, &activations.density, Values::of(&t_vals).slice()?);
        let device = joined.device();
        operation.activations = Activations { weights: out[5 * rays..].to_vec(), behind, ..activations };
        let composite = Composite::of_flat(&Tensor::from_vec(out, rays * (5 + samples), device)?, rays, samples)?;
        operation.errors = (&composite.rgb - target)?.flatten_all()?.to_vec1()?;
        operation.loss = photometric_loss(&composite.rgb, target)?.to_scalar()?;
        let used = operation.take_used(added.as_ref(), (rays, samples), device)?;
        let none = || Tensor::zeros(1, DType::F32, device);
        let delta = added.map_or_else(none, |added| Ok(added.delta))?;
        let loss = joined.apply_op3(&t_vals, &delta, operation)?;
        Ok(Some(ShadedLoss { loss, composite, used }))
    }
}

impl FusedLoss {
    /// Colour without padding. Its slope is c (1 - c) beyond the limit, too, where it leads back.
    fn sigmoid(&self, raw: f32) -> f32 {
        1.0 / ((-raw.clamp(-self.limit, self.limit)).exp() + 1.0)
    }

    /// Computes what is composited from raw output `[4 n]`.
    fn activate(&self, raw: &[f32], added: Option<&Boxes>, samples: usize) -> Result<Activations> {
        let (colours, densities) = raw.split_at(raw.len() / 4 * 3);
        let sigmoids: Vec<f32> = colours.iter().map(|raw| self.sigmoid(*raw)).collect();
        let (scale, shift) = self.spread();
        let rgb =
            if self.padding > 0.0 { sigmoids.iter().map(|s| s * scale + shift).collect() } else { sigmoids.clone() };
        let density = (0..densities.len()).map(|i| density_of(self.activation, self.noisy(densities, i))).collect();
        let mut activations = Activations { sigmoids, rgb, density, ..Activations::default() };
        if let Some(added) = added {
            let delta = added.delta.detach().to_vec1::<f32>()?;
            let (of_rgb, of_density) = delta.split_at(activations.rgb.len());
            let limits = |site: PaperSite| output_range(site, self.padding);
            if let Some(box_set) = &added.rgb {
                activations.used[0] = box_set.add(&mut activations.rgb, of_rgb, limits(PaperSite::Rgb), 3 * samples);
            }
            if let Some(box_set) = &added.density {
                let limits = limits(PaperSite::Density);
                activations.used[1] = box_set.add(&mut activations.density, of_density, limits, samples);
            }
        }
        Ok(activations)
    }

    /// Returns the factor and the summand that pad colours.
    fn spread(&self) -> (f32, f32) {
        ((1.0 + 2.0 * self.padding) as f32, -self.padding as f32)
    }

    fn noisy(&self, densities: &[f32], i: usize) -> f32 {
        self.noise.as_ref().map_or(densities[i], |noise| densities[i] + noise[i])
    }

    /// Returns the output deltas as they were used.
    fn take_used(
        &mut self,
        added: Option<&Boxes>,
        (rays, samples): (usize, usize),
        device: &Device,
    ) -> Result<Vec<(PaperSite, Tensor)>> {
        let [rgb, density] = std::mem::take(&mut self.activations.used);
        let mut used = Vec::new();
        if added.is_some_and(|added| added.rgb.is_some()) {
            used.push((PaperSite::Rgb, Tensor::from_vec(rgb, (rays, samples, 3), device)?));
        }
        if added.is_some_and(|added| added.density.is_some()) {
            used.push((PaperSite::Density, Tensor::from_vec(density, (rays, samples), device)?));
        }
        Ok(used)
    }

    /// Returns gradients of raw output, positions and output deltas from that of the loss.
    fn gradients(&self, raw: &[f32], t_vals: &[f32], gradient: f32) -> [Vec<f32>; 3] {
        // As candle differentiates the mean of the squares.
        let of_mean = gradient * (1.0 / self.errors.len() as f64) as f32;
        let colours: Vec<f32> = self.errors.iter().map(|error| error * of_mean * 2.0).collect();
        let Activations { sigmoids, rgb, density, weights, behind, .. } = &self.activations;
        let gradients = Gradients { colours: &colours, depths: None, accs: None, weights: None, wants_t_vals: true };
        let [d_rgb, d_density, d_t] = self.scan.backward(Passed { rgb, density, t_vals, weights, behind }, gradients);
        let (scale, _) = self.spread();
        let raw_density = &raw[rgb.len()..];
        // Adding 0 turns a negative 0 into a positive one, as in candle's sums.
        let of_rgb = d_rgb.iter().zip(sigmoids).zip(raw).map(|((&d, s), raw)| {
            let d = if self.padding > 0.0 { d * scale } else { d };
            let d = d * ((1.0 - s) * s) + 0.0;
            if leads_away(*raw, d, self.limit) { 0.0 } else { d }
        });
        let of_density = d_density
            .iter()
            .enumerate()
            .map(|(i, &d)| raw_density_gradient(self.activation, self.noisy(raw_density, i), d) + 0.0);
        let d_raw = of_rgb.chain(of_density).collect();
        let d_delta = if self.wants_delta { [d_rgb, d_density].concat() } else { Vec::new() };
        [d_raw, d_t, d_delta]
    }
}

impl BoxSet {
    /// Adds `delta` to `values`, projected so that they stay within `limits`. Returns the projected delta. It agrees
    /// with `UsedDeltas::add_to`.
    fn add(&self, values: &mut [f32], delta: &[f32], (low, high): (f64, f64), of_ray: usize) -> Vec<f32> {
        let (low, high) = (low as f32, high as f32);
        let entries = values.iter_mut().zip(delta).enumerate();
        let projected = entries.map(|(i, (value, &delta))| {
            let now = *value;
            // Density has no upper limit. A value above it by rounding stays.
            let (lower, upper) = if high == f32::MAX { (-now, high) } else { (-now + low, -now + high) };
            let mut used = larger(smaller(delta, self.radius), -self.radius);
            used = larger(smaller(used, upper), lower);
            if let Some(mask) = &self.mask {
                used *= mask[i % of_ray];
            }
            let moved = now + used;
            let legal = if high == f32::MAX { moved.max(0.0) } else { smaller(larger(moved, low), high) };
            // 0, or NaN if one of them is not finite.
            let broken = (now * 0.0).abs() + (delta * 0.0).abs();
            *value = legal + broken;
            used
        });
        projected.collect()
    }
}

impl CustomOp3 for FusedLoss {
    fn name(&self) -> &'static str {
        "fused-loss"
    }

    fn cpu_fwd(
        &self,
        _raw: &CpuStorage,
        _raw_layout: &Layout,
        _t_vals: &CpuStorage,
        _t_layout: &Layout,
        _delta: &CpuStorage,
        _delta_layout: &Layout,
    ) -> TensorResult<(CpuStorage, Shape)> {
        Ok((CpuStorage::F32(vec![self.loss]), Shape::from(())))
    }

    fn bwd(
        &self,
        raw: &Tensor,
        t_vals: &Tensor,
        delta: &Tensor,
        _loss: &Tensor,
        gradient: &Tensor,
    ) -> TensorResult<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let gradient = gradient.to_scalar()?;
        let [d_raw, d_t, d_delta] = self.gradients(Values::of(raw).slice()?, Values::of(t_vals).slice()?, gradient);
        let tensor = |values: Vec<f32>, like: &Tensor| {
            like.track_op().then(|| Tensor::from_vec(values, like.shape(), like.device())).transpose()
        };
        Ok((tensor(d_raw, raw)?, tensor(d_t, t_vals)?, tensor(d_delta, delta)?))
    }
}
