//! Rendering of rays: one pass through one field, and coarse plus fine for evaluation.

use candle_core::{D, Tensor};

use crate::augment::{Deltas, Sets};
use crate::base::Result;
use crate::data::Rays;
use crate::field::{FeatureDelta, Field, RawOutput};
use crate::settings::{Encoding, Level, OutputPlace, SamplingConfig};

mod cast;
pub mod sampling;
mod scan;
pub mod volume;

pub use cast::{gaussians_at, points_at, positions_at, ray_parts, samples_of};
pub use volume::Composite;

/// What one pass needs besides the field.
#[derive(Clone, Copy)]
pub struct Pass<'a> {
    /// The rays.
    pub rays: &'a Rays,
    /// Sample positions, `[rays, samples]`; of a field with integrated encoding the edges of intervals,
    /// `[rays, samples + 1]`.
    pub t_vals: &'a Tensor,
    /// Added to raw density, `[rays, samples]`.
    pub density_noise: Option<&'a Tensor>,
    /// Fills missing accumulation.
    pub background: Option<[f32; 3]>,
    /// The samples' points or Gaussians with their deltas (see [`moved_positions`]), where they are known already: a search that does
    /// not move them asks for the very same tensor again and again (see [`Field::searching`]).
    pub positions: Option<&'a Tensor>,
}

/// Deltas of a perturbed pass and how they enter it.
#[derive(Clone, Copy)]
pub struct Perturbation<'a> {
    /// The deltas.
    pub deltas: &'a Deltas,
    /// Their sets, for the projection of the output level onto what this forward leaves it.
    pub sets: &'a Sets,
    /// Trunk layer (1-based) that the feature delta is added to.
    pub injection_layer: usize,
    /// Where the output deltas are added.
    pub output: OutputPlace,
}

/// What one pass gives.
pub struct PassOutput {
    /// Colour, depth, accumulation, weights.
    pub composite: Composite,
    /// Colour of each sample after activation and delta, `[rays, samples, 3]`.
    pub rgb: Tensor,
    /// Density of each sample after activation and delta, `[rays, samples]`.
    pub density: Tensor,
    /// The pass's `t_vals` with their delta.
    pub t_vals: Tensor,
    /// Raw density of each sample without noise, detached, `[rays, samples]`.
    pub raw_density: Tensor,
    /// The deltas as used: `rgb` and `density` projected for this forward, the others as given.
    pub used: Deltas,
    /// The sets that they were projected onto: `rgb` and `density` cut by what this forward left.
    pub sets: Sets,
}

/// Renders one pass without perturbation.
pub fn clean_pass(field: &Field, pass: Pass) -> Result<PassOutput> {
    let positions = positions_at(field, pass.rays, pass.t_vals)?.flatten(0, 1)?;
    let raw = query(field, &positions, pass.t_vals, &pass.rays.viewdirs, None)?;
    let (rgb, density) = activate(field, &raw, pass.density_noise)?;
    finish(pass, pass.t_vals, &raw, (rgb, density), (Deltas::default(), Sets::default()))
}

/// Renders one pass with perturbation (paper, algorithm 1, lines 9 to 13).
pub fn perturbed_pass(field: &Field, pass: Pass, perturbation: Perturbation) -> Result<PassOutput> {
    let deltas = perturbation.deltas;
    let t_vals = moved_t_vals(pass, deltas)?;
    let known = pass.positions.map(|positions| Ok(positions.clone()));
    let positions = known.unwrap_or_else(|| moved_positions(field, pass, deltas))?;
    let viewdirs = match deltas.get(Level::View) {
        Some(delta) => tilt(pass.rays, delta)?,
        None => pass.rays.viewdirs.clone(),
    };
    let feature = deltas.get(Level::Feature).map(|delta| (perturbation.injection_layer, delta));
    let raw = query(field, &positions, &t_vals, &viewdirs, feature)?;
    let (mut used, mut sets) = (deltas.clone(), perturbation.sets.clone());
    let activated = match perturbation.output {
        OutputPlace::After => {
            let (rgb, density) = activate(field, &raw, pass.density_noise)?;
            add_after(field, perturbation, (rgb, density), (&mut used, &mut sets))?
        }
        OutputPlace::Before => activate(field, &add_before(perturbation, &raw, &mut used)?, pass.density_noise)?,
    };
    finish(pass, &t_vals, &raw, activated, (used, sets))
}

fn moved_t_vals(pass: Pass, deltas: &Deltas) -> Result<Tensor> {
    Ok(match deltas.get(Level::T) {
        Some(delta) => (pass.t_vals + delta)?,
        None => pass.t_vals.clone(),
    })
}

/// What the field is asked at, with the deltas of `t` and `xyz`: points `[rays * samples, 3]`, or Gaussians
/// `[rays * samples, 6]`, of which `xyz` moves the mean.
pub fn moved_positions(field: &Field, pass: Pass, deltas: &Deltas) -> Result<Tensor> {
    let positions = positions_at(field, pass.rays, &moved_t_vals(pass, deltas)?)?;
    let positions = match deltas.get(Level::Xyz) {
        Some(delta) if positions.dim(2)? > 3 => (positions + Tensor::cat(&[delta, &delta.zeros_like()?], 2)?)?,
        Some(delta) => (positions + delta)?,
        None => positions,
    };
    Ok(positions.flatten(0, 1)?)
}

fn finish(
    pass: Pass,
    t_vals: &Tensor,
    raw: &RawOutput,
    (rgb, density): (Tensor, Tensor),
    (used, sets): (Deltas, Sets),
) -> Result<PassOutput> {
    let composite = volume::composite(&rgb, &density, t_vals, &pass.rays.direction_norm, pass.background)?;
    let (t_vals, raw_density) = (t_vals.detach(), raw.density.detach());
    Ok(PassOutput { composite, rgb, density, t_vals, raw_density, used, sets })
}

/// Accumulation of rays without density noise, `[rays]`: what an evaluation would see.
pub fn noiseless_acc(field: &Field, out: &PassOutput, pass: Pass) -> Result<Tensor> {
    if pass.density_noise.is_none() {
        return Ok(out.composite.acc.detach());
    }
    let samples = out.raw_density.dim(1)?;
    let intervals = volume::intervals(pass.t_vals, &pass.rays.direction_norm, samples)?;
    Ok(volume::weights_from_density(&field.activate_density(&out.raw_density)?, &intervals)?.sum(D::Minus1)?)
}

/// Moves unit view directions by two small angles `[rays, 2]` in their tangent planes.
fn tilt(rays: &Rays, angles: &Tensor) -> Result<Tensor> {
    let missing = || candle_core::Error::Msg("these rays have no tangents to tilt them along".into());
    let [u, w] = rays.tangents.as_ref().ok_or_else(missing)?;
    let along = |axis: usize, tangents: &Tensor| angles.narrow(1, axis, 1)?.broadcast_mul(tangents);
    let moved = ((&rays.viewdirs + along(0, u)?)? + along(1, w)?)?;
    let norm = moved.sqr()?.sum_keepdim(1)?.sqrt()?;
    Ok(moved.broadcast_div(&norm)?)
}

/// Raw output at positions `[rays * samples, 3 or 6]`: rgb `[rays, samples, 3]`, density `[rays, samples]`.
fn query(
    field: &Field,
    positions: &Tensor,
    t_vals: &Tensor,
    viewdirs: &Tensor,
    feature: Option<(usize, &Tensor)>,
) -> Result<RawOutput> {
    let (rays, samples) = (t_vals.dim(0)?, samples_of(field, t_vals)?);
    let delta = feature.map(|(layer, delta)| Ok((layer, delta.flatten(0, 1)?))).transpose();
    let delta: Option<(usize, Tensor)> = delta.map_err(|e: candle_core::Error| e)?;
    let delta = delta.as_ref().map(|(layer, delta)| FeatureDelta { layer: *layer, delta });
    let raw = field.forward(positions, viewdirs, delta)?;
    Ok(RawOutput { rgb: raw.rgb.reshape((rays, samples, 3))?, density: raw.density.reshape((rays, samples))? })
}

/// The field's activations on colour and density, and noise on density.
fn activate(field: &Field, raw: &RawOutput, density_noise: Option<&Tensor>) -> Result<(Tensor, Tensor)> {
    let rgb = field.activate_rgb(&raw.rgb)?;
    let density = match density_noise {
        Some(noise) => field.activate_density(&(&raw.density + noise)?)?,
        None => field.activate_density(&raw.density)?,
    };
    Ok((rgb, density))
}

/// Adds the output deltas to colour and density, projected so that colour stays in 0..=1 (and the field's padding) and
/// density does not turn negative. The projected value counts; gradients pass to delta and field
/// as if nothing had been projected.
fn add_after(
    field: &Field,
    p: Perturbation,
    (rgb, density): (Tensor, Tensor),
    (used, sets): (&mut Deltas, &mut Sets),
) -> Result<(Tensor, Tensor)> {
    let padding = field.config().rgb_padding;
    let mut add = |level: Level, value: Tensor| -> Result<Tensor> {
        let (Some(delta), Some(set)) = (p.deltas.get(level), p.sets.get(level)) else { return Ok(value) };
        let now = value.detach();
        let (lower, upper) = match level {
            Level::Rgb => (now.affine(-1.0, -padding)?, now.affine(-1.0, 1.0 + padding)?),
            _ => (now.neg()?, (now.zeros_like()? + f64::from(f32::MAX))?),
        };
        let cut = set.within(lower, upper);
        let projected = cut.project(&delta.detach())?;
        sets.set(level, cut);
        let moved = (&now + &projected)?;
        // The projected sum can leave the range by a rounding.
        let legal = match level {
            Level::Rgb => moved.clamp(-padding, 1.0 + padding)?,
            _ => moved.relu()?,
        };
        used.set(level, projected);
        straight_through(legal, &value, delta)
    };
    Ok((add(Level::Rgb, rgb)?, add(Level::Density, density)?))
}

/// The tensor `exact`, with the gradient of `value + delta`. The two differences are exactly 0.
fn straight_through(exact: Tensor, value: &Tensor, delta: &Tensor) -> Result<Tensor> {
    let gradient = ((value - value.detach())? + (delta - delta.detach())?)?;
    Ok((exact + gradient)?)
}

/// Adds the output deltas before the activations: the box alone limits them.
fn add_before(p: Perturbation, raw: &RawOutput, used: &mut Deltas) -> Result<RawOutput> {
    let mut add = |level: Level, value: &Tensor| -> Result<Tensor> {
        let (Some(delta), Some(set)) = (p.deltas.get(level), p.sets.get(level)) else { return Ok(value.clone()) };
        let projected = set.project(&delta.detach())?;
        let moved = (value.detach() + &projected)?;
        used.set(level, projected);
        straight_through(moved, value, delta)
    };
    Ok(RawOutput { rgb: add(Level::Rgb, &raw.rgb)?, density: add(Level::Density, &raw.density)? })
}

/// Numbers of `t_vals` that a field's passes have, from those of a configuration: for the coarse pass, and for `u` of the
/// fine one.
pub fn columns(field: &Field, sampling: &SamplingConfig) -> (usize, usize) {
    let more = usize::from(field.config().encoding == Encoding::Integrated);
    (sampling.coarse + more, sampling.fine + more)
}

/// The fine pass's `t_vals` from the coarse pass's, its weights and `u`.
pub fn resample(
    field: &Field,
    sampling: &SamplingConfig,
    t_vals: &Tensor,
    weights: &Tensor,
    u: &Tensor,
) -> Result<Tensor> {
    match field.config().encoding {
        Encoding::Positional => sampling::importance(t_vals, weights, u),
        Encoding::Integrated => sampling::resample_intervals(t_vals, weights, u, sampling.resample_padding),
    }
}

/// The deterministic image of rays for evaluation: no jitter, no noise, evenly spaced u. Without a
/// fine field the coarse pass is the result.
pub fn render_rays(
    coarse: &Field,
    fine: Option<&Field>,
    rays: &Rays,
    (near, far): (f64, f64),
    sampling: &SamplingConfig,
    background: Option<[f32; 3]>,
) -> Result<Composite> {
    let t_vals = sampling::stratified(near, far, rays.len(), columns(coarse, sampling).0, None, &rays.origins)?;
    let pass = Pass { rays, t_vals: &t_vals, density_noise: None, background, positions: None };
    let Some(fine) = fine else { return Ok(clean_pass(coarse, pass)?.composite) };
    let t_vals = fine_t_vals(coarse, rays, &t_vals, sampling)?;
    Ok(clean_pass(fine, Pass { t_vals: &t_vals, ..pass })?.composite)
}

/// The `t_vals` of an evaluation's fine pass, after the coarse field at `t_vals`.
pub fn fine_t_vals(coarse: &Field, rays: &Rays, t_vals: &Tensor, sampling: &SamplingConfig) -> Result<Tensor> {
    // The coarse pass only places samples: density alone will do.
    let positions = positions_at(coarse, rays, t_vals)?.flatten(0, 1)?;
    let raw = coarse.raw_density(&positions)?.reshape((rays.len(), sampling.coarse))?;
    let intervals = volume::intervals(t_vals, &rays.direction_norm, sampling.coarse)?;
    let weights = volume::weights_from_density(&coarse.activate_density(&raw)?, &intervals)?;
    let u = sampling::even_u(rays.len(), columns(coarse, sampling).1, t_vals)?;
    resample(coarse, sampling, t_vals, &weights, &u)
}

/// Mean squared error over rays and channels between colours `[rays, 3]`.
pub fn photometric_loss(rgb: &Tensor, target: &Tensor) -> Result<Tensor> {
    Ok((rgb - target)?.sqr()?.mean_all()?)
}
