//! The perturbed pass (paper, algorithm 1, lines 9 to 13): where each site's delta is added, and what a search need not
//! compute again.

use candle_core::Tensor;

use crate::augment::{DeltaSet, Deltas, Sets, Site};
use crate::base::Result;
use crate::data::Rays;
use crate::field::{FeatureDelta, Field, FixedPoints, RawOutput};
use crate::settings::OutputPlace;

use super::cast::{positions_at, samples_of};
use super::pass::{Pass, PassOutput, SampleValues, activate, by_ray, finish, near_scaled};

/// Deltas of a perturbed pass, and how they are added.
#[derive(Clone, Copy)]
pub struct Perturbation<'a> {
    /// The deltas.
    pub deltas: &'a Deltas,
    /// Their constraint sets, for the projection of the output level onto what this forward pass allows.
    pub sets: &'a Sets,
    /// Trunk layer (1-based) to which the feature delta is added.
    pub injection_layer: usize,
    /// Where the output deltas are added.
    pub output: OutputPlace,
}

/// The result of a perturbed pass.
pub struct PerturbedOutput {
    /// Colours, densities and rendered rays.
    pub pass: PassOutput,
    /// The deltas that it used.
    pub used: UsedDeltas,
}

/// Deltas as a pass used them.
pub struct UsedDeltas {
    /// `rgb` and `density` projected for this forward pass, the others as given.
    pub deltas: Deltas,
    /// The sets onto which they were projected: `rgb` and `density` cut by what this forward pass allows.
    pub sets: Sets,
}

impl UsedDeltas {
    fn of(perturbation: Perturbation) -> UsedDeltas {
        UsedDeltas { deltas: perturbation.deltas.clone(), sets: perturbation.sets.clone() }
    }

    fn put(&mut self, site: Site, delta: Tensor, set: DeltaSet) {
        self.deltas.set(site, delta);
        self.sets.set(site, set);
    }
}

/// Renders one pass with deltas.
///
/// # Errors
/// Those of candle, if shapes do not fit.
pub fn perturbed_pass(field: &Field, pass: Pass, perturbation: Perturbation) -> Result<PerturbedOutput> {
    query(field, pass, perturbation)?.finish()
}

/// Runs the pass through its field.
pub(super) fn query<'a>(field: &'a Field, pass: Pass<'a>, perturbation: Perturbation<'a>) -> Result<Queried<'a>> {
    let samples = MovedSamples::new(field, pass, perturbation.deltas)?;
    let query = |viewdirs: &Tensor, delta: Option<FeatureDelta>| field.forward(&samples.positions, viewdirs, delta);
    Queried::new(field, pass, &samples.t_vals, perturbation, query)
}

/// The samples of a pass that no delta moves any more. What depends only on them is computed once for all passes.
pub struct FixedSamples<'a> {
    field: &'a Field,
    pass: Pass<'a>,
    t_vals: Tensor,
    points: FixedPoints<'a>,
}

impl<'a> FixedSamples<'a> {
    /// Fixes the samples of `pass` where `deltas` have moved them. `field` must be frozen. A search can do so once
    /// [`Iterate::fixes_samples`](crate::augment::Iterate::fixes_samples) says so.
    ///
    /// # Errors
    /// Those of candle, if shapes do not fit.
    pub fn new(field: &'a Field, pass: Pass<'a>, deltas: &Deltas) -> Result<FixedSamples<'a>> {
        let MovedSamples { t_vals, positions } = MovedSamples::new(field, pass, deltas)?;
        Ok(FixedSamples { field, pass, t_vals, points: field.fix(&positions)? })
    }

    /// Runs [`perturbed_pass`] on these samples. The deltas of sites that move samples must be those at creation.
    ///
    /// # Errors
    /// Those of candle, if shapes do not fit.
    pub fn perturbed_pass(&self, perturbation: Perturbation) -> Result<PerturbedOutput> {
        self.query(perturbation)?.finish()
    }

    /// Runs the pass through its field.
    pub(super) fn query<'b>(&'b self, perturbation: Perturbation<'b>) -> Result<Queried<'b>> {
        let query = |viewdirs: &Tensor, delta: Option<FeatureDelta>| self.points.forward(viewdirs, delta);
        Queried::new(self.field, self.pass, &self.t_vals, perturbation, query)
    }
}

/// The positions at which a perturbed pass queries its field.
struct MovedSamples {
    t_vals: Tensor,
    /// Points `[rays * samples, 3]`, or Gaussians `[rays * samples, 6]` whose mean `xyz` moves.
    positions: Tensor,
}

impl MovedSamples {
    fn new(field: &Field, pass: Pass, deltas: &Deltas) -> Result<MovedSamples> {
        let (mut t_vals, mut shift) = (pass.t_vals.clone(), None);
        for site in Site::ALL.into_iter().filter(|site| site.about().moves_samples) {
            let Some(delta) = deltas.at(site)? else { continue };
            match site {
                Site::T => t_vals = (t_vals + delta)?,
                Site::Xyz => shift = Some(delta),
                Site::View | Site::Feature | Site::Rgb | Site::Density => unreachable!("it moves no samples"),
            }
        }
        let positions = positions_at(field, pass.rays, &t_vals)?;
        let positions = match shift {
            Some(delta) if positions.dim(2)? > 3 => (positions + Tensor::cat(&[&delta, &delta.zeros_like()?], 2)?)?,
            Some(delta) => (positions + delta)?,
            None => positions,
        };
        Ok(MovedSamples { t_vals, positions: positions.flatten(0, 1)? })
    }
}

/// A perturbed pass after its field, before compositing.
pub(super) struct Queried<'a> {
    pub(super) field: &'a Field,
    pub(super) pass: Pass<'a>,
    /// With their delta.
    pub(super) t_vals: Tensor,
    pub(super) perturbation: Perturbation<'a>,
    pub(super) raw: RawOutput,
}

impl<'a> Queried<'a> {
    /// Creates the pass with samples at `t_vals`. `query` returns their raw colour and density.
    fn new(
        field: &'a Field,
        pass: Pass<'a>,
        t_vals: &Tensor,
        perturbation: Perturbation<'a>,
        query: impl FnOnce(&Tensor, Option<FeatureDelta>) -> Result<RawOutput>,
    ) -> Result<Queried<'a>> {
        let deltas = perturbation.deltas;
        let viewdirs = match deltas.at(Site::View)? {
            Some(delta) => tilt(pass.rays, &delta)?,
            None => pass.rays.viewdirs.clone(),
        };
        let feature = deltas.at(Site::Feature)?.map(|delta| delta.flatten(0, 1)).transpose()?;
        let feature = feature.as_ref().map(|delta| FeatureDelta { layer: perturbation.injection_layer, delta });
        let raw = by_ray(query(&viewdirs, feature)?, pass.rays.len(), samples_of(field, t_vals)?)?;
        let raw = near_scaled(raw, pass, t_vals)?;
        Ok(Queried { field, pass, t_vals: t_vals.clone(), perturbation, raw })
    }

    /// Finishes the pass after its field.
    pub(super) fn finish(self) -> Result<PerturbedOutput> {
        let Queried { field, pass, t_vals, perturbation, raw } = self;
        let mut used = UsedDeltas::of(perturbation);
        let values = match perturbation.output {
            OutputPlace::After => {
                let values = activate(field, &raw, pass.density_noise)?;
                add_after(values, perturbation, field.config().rgb_padding, &mut used)?
            }
            OutputPlace::Before => activate(field, &add_before(&raw, perturbation, &mut used)?, pass.density_noise)?,
        };
        Ok(PerturbedOutput { pass: finish(pass, &t_vals, &raw, values)?, used })
    }
}

/// Tilts unit view directions by two small angles `[rays, 2]` in their tangent planes.
fn tilt(rays: &Rays, angles: &Tensor) -> Result<Tensor> {
    let missing = || candle_core::Error::Msg("these rays have no tangents to tilt them along".into());
    let [u, w] = rays.tangents.as_ref().ok_or_else(missing)?;
    let along = |axis: usize, tangents: &Tensor| angles.narrow(1, axis, 1)?.broadcast_mul(tangents);
    let moved = ((&rays.viewdirs + along(0, u)?)? + along(1, w)?)?;
    let norm = moved.sqr()?.sum_keepdim(1)?.sqrt()?;
    Ok(moved.broadcast_div(&norm)?)
}

/// Returns the range of the values to which a site of the output level is added. Density has no upper limit: `f32::MAX`.
/// `padding` is that of the field's colours.
///
/// # Panics
/// The site is of another level.
pub fn output_range(site: Site, padding: f64) -> (f64, f64) {
    match site {
        Site::Rgb => (-padding, 1.0 + padding),
        Site::Density => (0.0, f64::from(f32::MAX)),
        Site::T | Site::Xyz | Site::View | Site::Feature => unreachable!("{} is not of the output level", site.name()),
    }
}

/// Adds the output deltas to colour and density. They are projected so that colour stays in 0..=1 (and the field's
/// padding) and density at least 0. The projected value counts. Gradients pass to delta and field as if nothing had
/// been projected.
fn add_after(values: SampleValues, p: Perturbation, padding: f64, used: &mut UsedDeltas) -> Result<SampleValues> {
    let mut add = |site: Site, value: Tensor| -> Result<Tensor> {
        let (low, high) = output_range(site, padding);
        let has_end = high < f64::from(f32::MAX);
        // A projected sum can leave the range by rounding, and own sites know no range.
        let legal = |moved: Tensor| if has_end { moved.clamp(low, high) } else { moved.relu() };
        let value = match p.deltas.spread(site)? {
            Some(own) => straight_through(legal((value.detach() + own.detach())?)?, &value, &own)?,
            None => value,
        };
        let (Some(delta), Some(set)) = (p.deltas.get(site), p.sets.get(site)) else { return Ok(value) };
        let now = value.detach();
        let (lower, upper) = match has_end {
            true => (now.affine(-1.0, low)?, now.affine(-1.0, high)?),
            false => (now.neg()?, (now.zeros_like()? + high)?),
        };
        let cut = set.within(lower, upper);
        let projected = cut.project(&delta.detach())?;
        let moved = (&now + &projected)?;
        used.put(site, projected, cut);
        straight_through(legal(moved)?, &value, delta)
    };
    Ok(SampleValues { rgb: add(Site::Rgb, values.rgb)?, density: add(Site::Density, values.density)? })
}

/// Returns `exact` with the gradient of `value + delta`. The two differences are exactly 0.
fn straight_through(exact: Tensor, value: &Tensor, delta: &Tensor) -> Result<Tensor> {
    let gradient = ((value - value.detach())? + (delta - delta.detach())?)?;
    Ok((exact + gradient)?)
}

/// Adds the output deltas before the activations. Only the box limits them.
fn add_before(raw: &RawOutput, p: Perturbation, used: &mut UsedDeltas) -> Result<RawOutput> {
    let mut add = |site: Site, value: &Tensor| -> Result<Tensor> {
        let value = match p.deltas.spread(site)? {
            Some(own) => &(value + own)?,
            None => value,
        };
        let (Some(delta), Some(set)) = (p.deltas.get(site), p.sets.get(site)) else { return Ok(value.clone()) };
        let projected = set.project(&delta.detach())?;
        let moved = (value.detach() + &projected)?;
        used.deltas.set(site, projected);
        straight_through(moved, value, delta)
    };
    Ok(RawOutput { rgb: add(Site::Rgb, &raw.rgb)?, density: add(Site::Density, &raw.density)?, joined: None })
}
