//! The perturbed pass (paper, algorithm 1, lines 9 to 13): where each site's delta is added, and what a search need not
//! compute again.

use candle_core::Tensor;

use crate::base::Result;
use crate::field::{FeatureDelta, Field, FixedPoints, RawOutput};
use crate::perturb::settings::OutputPlace;
use crate::perturb::{Deltas, PaperSite, Sets, UsedDeltas, output_range, tilt, worst_case};

use super::cast::{positions_at, samples_of};
use super::pass::{Pass, PassOutput, SampleValues, activate, by_ray, finish, near_scaled};
use super::photometric_loss;

/// Deltas of a perturbed pass, and how they are added.
#[derive(Clone, Copy)]
pub struct Perturbation<'a> {
    /// The deltas.
    pub deltas: &'a Deltas,
    /// Their sites and constraint sets. A delta without one is not added.
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

impl Perturbation<'_> {
    /// Returns all that is added at a site of the paper.
    fn at(&self, site: PaperSite) -> Result<Option<Tensor>> {
        self.deltas.at(self.sets, site)
    }
}

/// Renders one pass with deltas.
///
/// # Errors
/// Those of candle, if shapes do not fit.
pub fn perturbed_pass(field: &Field, pass: Pass, perturbation: Perturbation) -> Result<PerturbedOutput> {
    let samples = MovedSamples::new(field, pass, perturbation)?;
    let query = |viewdirs: &Tensor, delta: Option<FeatureDelta>| field.forward(&samples.positions, viewdirs, delta);
    Queried::new(field, pass, &samples.t_vals, perturbation, query)?.finish()
}

/// Runs PGD ([`worst_case`]) from the deltas of `start`, on `sign` times the photometric loss against `target` `[rays, 3]`.
/// `field` must be frozen.
///
/// # Errors
/// Those of candle, if shapes do not fit.
pub fn search(field: &Field, pass: Pass, start: Perturbation, target: &Tensor, sign: f64) -> Result<Deltas> {
    let mut fixed = None;
    worst_case(start.sets, start.deltas.clone(), |iterate| {
        let perturbation = Perturbation { deltas: iterate.deltas, ..start };
        if fixed.is_none() && iterate.fixes_samples() {
            fixed = Some(FixedSamples::new(field, pass, perturbation)?);
        }
        let PerturbedOutput { pass: out, used } = match &fixed {
            Some(fixed) => fixed.perturbed_pass(perturbation)?,
            None => perturbed_pass(field, pass, perturbation)?,
        };
        let loss = photometric_loss(&out.composite.rgb, target)?;
        Ok((if sign == 1.0 { loss } else { (loss * sign)? }, used.deltas))
    })
}

/// The samples of a pass that no delta moves any more. What depends only on them is computed once for all passes.
struct FixedSamples<'a> {
    field: &'a Field,
    pass: Pass<'a>,
    t_vals: Tensor,
    points: FixedPoints<'a>,
}

impl<'a> FixedSamples<'a> {
    /// Fixes the samples of `pass` where deltas have moved them.
    fn new(field: &'a Field, pass: Pass<'a>, perturbation: Perturbation) -> Result<FixedSamples<'a>> {
        let MovedSamples { t_vals, positions } = MovedSamples::new(field, pass, perturbation)?;
        Ok(FixedSamples { field, pass, t_vals, points: field.fix(&positions)? })
    }

    /// Runs [`perturbed_pass`] on these samples. The deltas of sites that move samples must be those at creation.
    fn perturbed_pass(&self, perturbation: Perturbation) -> Result<PerturbedOutput> {
        let query = |viewdirs: &Tensor, delta: Option<FeatureDelta>| self.points.forward(viewdirs, delta);
        Queried::new(self.field, self.pass, &self.t_vals, perturbation, query)?.finish()
    }
}

/// The positions at which a perturbed pass queries its field.
struct MovedSamples {
    t_vals: Tensor,
    /// Points `[rays * samples, 3]`, or Gaussians `[rays * samples, 6]` whose mean `xyz` moves.
    positions: Tensor,
}

impl MovedSamples {
    fn new(field: &Field, pass: Pass, perturbation: Perturbation) -> Result<MovedSamples> {
        let t_vals = match perturbation.at(PaperSite::T)? {
            Some(delta) => (pass.t_vals + delta)?,
            None => pass.t_vals.clone(),
        };
        let positions = positions_at(field, pass.rays, &t_vals)?;
        let positions = match perturbation.at(PaperSite::Xyz)? {
            Some(delta) if positions.dim(2)? > 3 => (positions + Tensor::cat(&[&delta, &delta.zeros_like()?], 2)?)?,
            Some(delta) => (positions + delta)?,
            None => positions,
        };
        Ok(MovedSamples { t_vals, positions: positions.flatten(0, 1)? })
    }
}

/// A perturbed pass after its field, before compositing.
struct Queried<'a> {
    field: &'a Field,
    pass: Pass<'a>,
    /// With their delta.
    t_vals: Tensor,
    perturbation: Perturbation<'a>,
    raw: RawOutput,
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
        let viewdirs = match perturbation.at(PaperSite::View)? {
            Some(angles) => tilt(&pass.rays.viewdirs, tangents(pass)?, &angles)?,
            None => pass.rays.viewdirs.clone(),
        };
        let feature = perturbation.at(PaperSite::Feature)?.map(|delta| delta.flatten(0, 1)).transpose()?;
        let feature = feature.as_ref().map(|delta| FeatureDelta { layer: perturbation.injection_layer, delta });
        let raw = by_ray(query(&viewdirs, feature)?, pass.rays.len(), samples_of(field, t_vals)?)?;
        let raw = near_scaled(raw, pass, t_vals)?;
        Ok(Queried { field, pass, t_vals: t_vals.clone(), perturbation, raw })
    }

    /// Finishes the pass after its field.
    fn finish(self) -> Result<PerturbedOutput> {
        let Queried { field, pass, t_vals, perturbation, raw } = self;
        let mut used = UsedDeltas { deltas: perturbation.deltas.clone(), sets: perturbation.sets.clone() };
        let values = match perturbation.output {
            OutputPlace::After => {
                let SampleValues { rgb, density } = activate(field, &raw, pass.density_noise)?;
                let range = |site| Some(output_range(site, field.config().rgb_padding));
                SampleValues {
                    rgb: used.add_to(rgb, PaperSite::Rgb, range(PaperSite::Rgb))?,
                    density: used.add_to(density, PaperSite::Density, range(PaperSite::Density))?,
                }
            }
            OutputPlace::Before => {
                let perturbed = RawOutput {
                    rgb: used.add_to(raw.rgb.clone(), PaperSite::Rgb, None)?,
                    density: used.add_to(raw.density.clone(), PaperSite::Density, None)?,
                };
                activate(field, &perturbed, pass.density_noise)?
            }
        };
        Ok(PerturbedOutput { pass: finish(pass, &t_vals, &raw, values)?, used })
    }
}

fn tangents(pass: Pass<'_>) -> Result<&[Tensor; 2]> {
    let missing = || candle_core::Error::Msg("these rays have no tangents to tilt them along".into());
    Ok(pass.rays.tangents.as_ref().ok_or_else(missing)?)
}
