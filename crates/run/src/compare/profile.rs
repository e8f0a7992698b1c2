//! Density and colour of runs along the ray of one pixel and the rays around it.

use candle_core::{DType, Tensor};
use serde::Serialize;

use super::run_view::RunView;
use super::window::Window;
use crate::base::{Error, Result};
use crate::data::{RayBuffer, Rays};
use crate::render::sampling::stratified;
use crate::render::volume::{middles, transmittance};
use crate::render::{Pass, PassOutput, clean_pass, columns, fine_t_vals, points_at, ray_parts};
use crate::run::Viewer;
use crate::settings::{Capability, Config, Spacing};

/// Even samples of a ray: over 6 units, more than two for each period of the encoding's finest octave, 2 pi / 2^9.
pub const EVEN: usize = 1024;

/// Samples of one ray.
#[derive(Clone, Debug, Default)]
pub struct Samples {
    /// Positions along the ray.
    pub t: Vec<f32>,
    /// Positions of the samples in scene units (NDC if rays are in NDC).
    pub points: Vec<[f32; 3]>,
    /// Density, 1 / unit of space.
    pub density: Vec<f32>,
    /// Contribution to the pixel's colour, 0..=1.
    pub weights: Vec<f32>,
    /// Fraction of the light that reaches the camera from the sample: exp of minus the optical depth in front of it.
    pub transmittance: Vec<f32>,
    /// Colour as seen from the camera.
    pub rgb: Vec<[f32; 3]>,
}

/// Changes of a run's density and colour over a patch of even samples. Smaller is smoother.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RaySmoothness {
    /// Mean density of the patch's rays, 1 / unit of space (of NDC if rays are in NDC), for reference.
    pub density_mean: f64,
    /// Total variation of density along a ray, the sum of |change| between samples; mean over rays.
    pub density_tv_along: f64,
    /// Mean |difference| of density between neighbouring pixels' rays at equal t; empty for a single pixel.
    pub density_tv_across: Option<f64>,
    /// As `density_tv_along`, for colour, mean over channels. Includes colour in empty space.
    pub rgb_tv_along: f64,
    /// As `density_tv_across`, for colour, mean over channels.
    pub rgb_tv_across: Option<f64>,
}

/// One run along the rays of a patch.
#[derive(Clone, Debug)]
pub struct Profile {
    /// Samples of the pixel's ray in the coarse pass of an evaluation.
    pub coarse: Samples,
    /// The same for the fine pass, if there is one.
    pub fine: Option<Samples>,
    /// Even samples of the evaluated field from near to far, for each pixel of the patch, row by row.
    pub even: Vec<Samples>,
    /// The rendered colour of the pixel.
    pub rgb: [f32; 3],
    /// Mean of t over the pixel's weights, or `None` if nothing was accumulated.
    pub depth: Option<f32>,
    /// Smoothness over the patch.
    pub smoothness: RaySmoothness,
}

/// Returns a square of `side` pixels around a pixel, moved to lie inside the view.
pub fn patch_around((x, y): (usize, usize), side: usize, (width, height): (usize, usize)) -> Result<Window> {
    if x >= width || y >= height {
        return Err(Error::Config(format!(
            "--pixel {x},{y} is outside the view of {width} x {height} pixels; give 0,0 to {},{}",
            width - 1,
            height - 1
        )));
    }
    if side == 0 || side > width.min(height) {
        return Err(Error::Config(format!(
            "--patch {side} does not fit into the view of {width} x {height} pixels; give 1 to {}",
            width.min(height)
        )));
    }
    let start = |at: usize, length: usize| at.saturating_sub(side / 2).min(length - side);
    Ok(Window { x: start(x, width), y: start(y, height), width: side, height: side })
}

/// Returns an error for a run without samples along rays.
///
/// # Errors
/// [`Error::Config`]: the method has no fields.
pub fn check_profiled(label: &str, config: &Config) -> Result<()> {
    let instead = "profile runs of nerf, aug-nerf, mip-nerf and aug-mip-nerf; `augnerf compare` shows this run";
    config.require_capability(Capability::Samples, &format!("{label}: a profile along a ray"), instead)
}

impl Profile {
    /// Measures a run along the ray of `pixel`, as an evaluation samples it, and evenly along the rays of `patch`,
    /// which contains it.
    pub fn measure(viewer: &Viewer, run: &RunView, pixel: (usize, usize), patch: Window) -> Result<Profile> {
        let Viewer { model, config, scene, runtime } = *viewer;
        check_profiled(&run.label, config)?;
        let device = runtime.device();
        let camera = &run.view.camera;
        let bounds = scene.bounds();
        let fields = model.fields()?.frozen()?;
        let (coarse, fine) = (&fields.coarse, fields.fine());
        let parts = ray_parts(fields.evaluated());
        let rays = |pixels: &[(usize, usize)]| {
            let pixels: Vec<_> = pixels.iter().map(|&(x, y)| (camera, x as u32, y as u32)).collect();
            RayBuffer::new(&pixels, scene.ndc.as_ref(), config.data.origin_of_pixels(), parts)
                .to_tensors(DType::F32, device)
        };
        let pass = |field, rays: &Rays, t_vals: &Tensor| {
            clean_pass(
                field,
                Pass { rays, t_vals, density_noise: None, background: scene.background, scales_gradients: false },
            )
        };
        let ray = rays(&[pixel])?;
        let sampling = &config.sampling;
        let (coarse_columns, _) = columns(coarse, sampling);
        let t_vals = stratified(bounds, sampling.spacing, 1, coarse_columns, None, &ray.origins)?;
        let coarse_pass = pass(coarse, &ray, &t_vals)?;
        let fine_pass = fine.map(|fine| pass(fine, &ray, &fine_t_vals(coarse, &ray, &t_vals, sampling)?));
        let fine_pass = fine_pass.transpose()?;
        let pixels = pixels_of(patch);
        let around = rays(&pixels)?;
        // MipNeRF's intervals have one edge more.
        let even_columns = EVEN + coarse_columns - sampling.coarse;
        let t_vals = stratified(bounds, Spacing::Depth, pixels.len(), even_columns, None, &around.origins)?;
        let even = samples(&around, &pass(fields.evaluated(), &around, &t_vals)?)?;
        let shown = &fine_pass.as_ref().unwrap_or(&coarse_pass).composite;
        let acc = shown.acc.to_vec1::<f32>()?[0];
        let depth = shown.depth.to_vec1::<f32>()?[0] / acc;
        let rgb = shown.rgb.to_vec2::<f32>()?.remove(0);
        Ok(Profile {
            coarse: samples(&ray, &coarse_pass)?.remove(0),
            fine: fine_pass.map(|fine| samples(&ray, &fine)).transpose()?.map(|mut fine| fine.remove(0)),
            rgb: [rgb[0], rgb[1], rgb[2]],
            depth: depth.is_finite().then_some(depth),
            smoothness: smoothness(&even, patch.width),
            even,
        })
    }
}

/// Returns a window's pixels, row by row.
pub(super) fn pixels_of(Window { x, y, width, height }: Window) -> Vec<(usize, usize)> {
    (y..y + height).flat_map(|y| (x..x + width).map(move |x| (x, y))).collect()
}

/// Returns the samples of a pass, ray by ray.
fn samples(rays: &Rays, out: &PassOutput) -> Result<Vec<Samples>> {
    let rows = |tensor: &Tensor| tensor.to_vec2::<f32>();
    let triples = |tensor: &Tensor| -> Result<Vec<Vec<[f32; 3]>>> {
        let triple = |row: Vec<f32>| [row[0], row[1], row[2]];
        Ok(tensor.to_vec3::<f32>()?.into_iter().map(|ray| ray.into_iter().map(triple).collect()).collect())
    };
    let (t_vals, density, weights) = (rows(&out.t_vals)?, rows(&out.density)?, rows(&out.composite.weights)?);
    let middles = middles(&out.t_vals, out.density.dim(1)?)?;
    let (t, points, rgb) = (rows(&middles)?, triples(&points_at(rays, &middles)?)?, triples(&out.rgb)?);
    let norms = rays.direction_norm.flatten_all()?.to_vec1::<f32>()?;
    let mut colours = rgb.iter().flatten().flatten();
    if !colours.all(|value| value.is_finite()) || !density.iter().flatten().all(|value| value.is_finite()) {
        return Err(Error::Diverged(
            "density or colour along the ray is not a number, so the weights are broken; delete the newest checkpoint to \
             use the one before it"
                .into(),
        ));
    }
    let columns = t_vals.into_iter().zip(t).zip(density).zip(weights).zip(points).zip(rgb).zip(norms);
    let samples = columns.map(|((((((t_vals, t), density), weights), points), rgb), norm)| {
        let wide = |values: &[f32]| values.iter().copied().map(f64::from).collect::<Vec<f64>>();
        let transmittance = transmittance(&wide(&t_vals), &wide(&density), f64::from(norm));
        let transmittance = transmittance.into_iter().map(|value| value as f32).collect();
        Samples { t, density, weights, transmittance, points, rgb }
    });
    Ok(samples.collect())
}

/// Computes the smoothness of the rays of a patch of `width` columns.
fn smoothness(rays: &[Samples], width: usize) -> RaySmoothness {
    let density = |ray: usize, k: usize| vec![f64::from(rays[ray].density[k])];
    let rgb = |ray: usize, k: usize| rays[ray].rgb[k].iter().map(|&c| f64::from(c)).collect();
    let count = (rays.len() * EVEN) as f64;
    RaySmoothness {
        density_mean: rays.iter().flat_map(|ray| &ray.density).map(|&density| f64::from(density)).sum::<f64>() / count,
        density_tv_along: along(rays.len(), &density),
        density_tv_across: across(rays.len(), width, &density),
        rgb_tv_along: along(rays.len(), &rgb),
        rgb_tv_across: across(rays.len(), width, &rgb),
    }
}

/// Returns the mean |difference| over channels.
fn apart(a: Vec<f64>, b: Vec<f64>) -> f64 {
    a.iter().zip(&b).map(|(a, b)| (a - b).abs()).sum::<f64>() / a.len() as f64
}

fn along(rays: usize, value: &impl Fn(usize, usize) -> Vec<f64>) -> f64 {
    let of_ray = |ray: usize| (1..EVEN).map(|k| apart(value(ray, k), value(ray, k - 1))).sum::<f64>();
    (0..rays).map(of_ray).sum::<f64>() / rays as f64
}

/// Averages over pairs of neighbours to the right and below.
fn across(rays: usize, width: usize, value: &impl Fn(usize, usize) -> Vec<f64>) -> Option<f64> {
    let right = (0..rays).filter(|ray| (ray + 1) % width != 0).map(|ray| (ray, ray + 1));
    let below = (0..rays).filter(|ray| ray + width < rays).map(|ray| (ray, ray + width));
    let pairs: Vec<(usize, usize)> = right.chain(below).collect();
    let of_pair = |&(a, b): &(usize, usize)| (0..EVEN).map(|k| apart(value(a, k), value(b, k))).sum::<f64>();
    let sum: f64 = pairs.iter().map(of_pair).sum();
    (!pairs.is_empty()).then(|| sum / (pairs.len() * EVEN) as f64)
}

/// Several runs along the same rays.
pub struct Profiles {
    /// Runs that have passed [`RunView::check_alike`].
    pub runs: Vec<(RunView, Profile)>,
    /// The pixel of the ray.
    pub pixel: (usize, usize),
    /// The pixels measured with it.
    pub patch: Window,
}

impl Profiles {
    /// Returns the pixel's own even samples.
    pub fn own<'a>(&self, profile: &'a Profile) -> &'a Samples {
        let (x, y) = self.pixel;
        &profile.even[(y - self.patch.y) * self.patch.width + x - self.patch.x]
    }
}
