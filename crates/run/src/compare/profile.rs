//! Density and colour of runs along the ray of one pixel.

use std::path::Path;

use candle_core::{DType, Tensor};
use serde::Serialize;

use super::differences::File;
use super::profile_figure;
use super::run_view::RunView;
use crate::base::files::{write_atomic, write_json};
use crate::base::{Error, Result};
use crate::data::{Camera, RayBuffer, Rays};
use crate::render::sampling::stratified;
use crate::render::volume::{middles, transmittance};
use crate::render::{Pass, PassOutput, PlacedSamples, clean_pass, points_at, ray_parts, t_vals_per_ray};
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

/// One run along the ray of a pixel.
#[derive(Clone, Debug)]
pub struct Profile {
    /// Samples of the pixel's ray in the coarse pass of an evaluation.
    pub coarse: Samples,
    /// The same for the fine pass, if there is one.
    pub fine: Option<Samples>,
    /// Even samples of the evaluated field from near to far.
    pub even: Samples,
    /// The rendered colour of the pixel.
    pub rgb: [f32; 3],
    /// Mean of t over the pixel's weights, or `None` if nothing was accumulated.
    pub depth: Option<f32>,
}

/// Returns an error for a pixel outside the view of a run.
fn check_pixel((x, y): (usize, usize), Camera { width, height, .. }: &Camera) -> Result<()> {
    if x < *width && y < *height {
        return Ok(());
    }
    Err(Error::Config(format!(
        "--ray {x},{y}: outside the view of {width} x {height} pixels; give 0,0 to {},{}",
        width - 1,
        height - 1
    )))
}

/// Returns an error for a run without samples along rays.
///
/// # Errors
/// [`Error::Config`]: the method has no fields.
pub fn check_profiled(label: &str, config: &Config) -> Result<()> {
    let instead =
        "plot runs of nerf, aug-nerf, mip-nerf and aug-mip-nerf; without --ray, `augnerf compare` shows this run";
    config.require_capability(Capability::Samples, &format!("{label}: a profile along a ray"), instead)
}

impl Profile {
    /// Measures a run along the ray of `pixel`, as an evaluation samples it and at even places.
    pub fn measure(viewer: &Viewer, run: &RunView, pixel: (usize, usize)) -> Result<Profile> {
        let Viewer { model, config, scene, runtime } = *viewer;
        check_profiled(&run.label, config)?;
        check_pixel(pixel, &run.view.camera)?;
        let bounds = scene.bounds();
        let fields = model.fields()?.frozen()?;
        let (coarse, fine) = (fields.coarse(), fields.fine());
        let pixel = [(&run.view.camera, pixel.0 as u32, pixel.1 as u32)];
        let parts = ray_parts(fields.evaluated());
        let ray = RayBuffer::new(&pixel, scene.ndc.as_ref(), config.data.origin_of_pixels(), parts)
            .to_tensors(DType::F32, runtime.device())?;
        let pass = |field, samples: &PlacedSamples| clean_pass(field, Pass::noiseless(&ray, samples, scene.background));
        let sampling = &config.sampling;
        let (coarse_columns, _) = t_vals_per_ray(coarse, sampling);
        let t_vals = stratified(bounds, sampling.spacing, 1, coarse_columns, None, &ray.origins)?;
        let coarse_pass = pass(coarse, &PlacedSamples::all(t_vals))?;
        let placed = fields.evaluation(sampling, bounds, scene.background).samples(&ray)?;
        let fine_pass = fine.map(|fine| pass(fine, &placed)).transpose()?;
        // MipNeRF's intervals have one edge more.
        let even_columns = EVEN + coarse_columns - sampling.coarse;
        let t_vals = stratified(bounds, Spacing::Depth, 1, even_columns, None, &ray.origins)?;
        let even = samples(&ray, &pass(fields.evaluated(), &PlacedSamples::all(t_vals))?)?;
        let shown = &fine_pass.as_ref().unwrap_or(&coarse_pass).composite;
        let depth = shown.depth.to_vec1::<f32>()?[0] / shown.acc.to_vec1::<f32>()?[0];
        let rgb = shown.rgb.to_vec2::<f32>()?.remove(0);
        Ok(Profile {
            coarse: samples(&ray, &coarse_pass)?,
            fine: fine_pass.map(|fine| samples(&ray, &fine)).transpose()?,
            rgb: [rgb[0], rgb[1], rgb[2]],
            depth: depth.is_finite().then_some(depth),
            even,
        })
    }

    /// Returns the samples of the last pass of an evaluation.
    pub(super) fn evaluated(&self) -> &Samples {
        self.fine.as_ref().unwrap_or(&self.coarse)
    }

    /// Returns the total variation of density: the sum of |change| between even samples. Smaller is smoother.
    pub fn density_variation(&self) -> f64 {
        self.even.density.windows(2).map(|pair| f64::from((pair[1] - pair[0]).abs())).sum()
    }
}

/// Returns the samples of a pass along one ray.
fn samples(ray: &Rays, out: &PassOutput) -> Result<Samples> {
    let row = |tensor: &Tensor| tensor.flatten_all()?.to_vec1::<f32>();
    let triples = |tensor: &Tensor| -> Result<Vec<[f32; 3]>> {
        Ok(row(tensor)?.chunks(3).map(|triple| [triple[0], triple[1], triple[2]]).collect())
    };
    let (t_vals, density, weights) = (row(&out.t_vals)?, row(&out.density)?, row(&out.composite.weights)?);
    let middles = middles(&out.t_vals, density.len())?;
    let (t, points, rgb) = (row(&middles)?, triples(&points_at(ray, &middles)?)?, triples(&out.rgb)?);
    if !rgb.iter().flatten().chain(&density).all(|value| value.is_finite()) {
        return Err(Error::Diverged(
            "density or colour along the ray is not a number, so the weights are broken; delete the newest checkpoint to \
             use the one before it"
                .into(),
        ));
    }
    let wide = |values: &[f32]| values.iter().copied().map(f64::from).collect::<Vec<f64>>();
    let transmittance = transmittance(&wide(&t_vals), &wide(&density), f64::from(row(&ray.direction_norm)?[0]));
    let transmittance = transmittance.into_iter().map(|value| value as f32).collect();
    Ok(Samples { t, density, weights, transmittance, points, rgb })
}

/// Several runs along the same ray.
pub struct Profiles {
    /// Runs that have passed [`RunView::check_alike`].
    pub runs: Vec<(RunView, Profile)>,
    /// The pixel of the ray.
    pub pixel: (usize, usize),
}

/// A line of `ray.csv`.
#[derive(Serialize)]
struct RayRow<'a> {
    run: &'a str,
    samples: &'static str,
    t: f32,
    x: f32,
    y: f32,
    z: f32,
    density: f32,
    weight: f32,
    transmittance: f32,
    r: f32,
    g: f32,
    b: f32,
}

/// What `ray.json` says of all runs, and of each.
#[derive(Serialize)]
struct RayFacts<'a> {
    pixel: (usize, usize),
    even_samples: usize,
    t_unit: &'static str,
    /// The photo's colour at the pixel.
    truth_rgb: &'a [f32],
}

#[derive(Serialize)]
struct RunFacts {
    rgb: [f32; 3],
    depth: Option<f32>,
    density_variation: f64,
}

impl Profiles {
    /// Writes `ray.svg`, `ray.csv` and `ray.json` into a folder.
    pub fn write(&self, folder: &Path) -> Result<()> {
        write_atomic(&folder.join("ray.svg"), profile_figure::draw(self)?.svg.as_bytes())?;
        let path = folder.join("ray.csv");
        let unwritable =
            |error: &dyn std::fmt::Display| Error::Output(format!("cannot write {}: {error}", path.display()));
        let mut writer = csv::Writer::from_writer(Vec::new());
        for row in self.runs.iter().flat_map(|(run, profile)| ray_rows(&run.label, profile)) {
            writer.serialize(row).map_err(|error| unwritable(&error))?;
        }
        write_atomic(&path, &writer.into_inner().map_err(|error| unwritable(&error))?)?;
        write_json(&folder.join("ray.json"), &self.file())
    }

    /// Returns the content of `ray.json`.
    pub fn json(&self) -> serde_json::Value {
        serde_json::to_value(self.file()).expect("plain data")
    }

    fn file(&self) -> File<'_, RayFacts<'_>, RunFacts> {
        let (first, (x, y)) = (&self.runs[0].0, self.pixel);
        let facts = RayFacts {
            pixel: self.pixel,
            even_samples: EVEN,
            t_unit: first.depth_unit(),
            truth_rgb: &first.view.image.pixels[(y * first.view.image.width + x) * 3..][..3],
        };
        let of_run = |profile: &Profile| RunFacts {
            rgb: profile.rgb,
            depth: profile.depth,
            density_variation: profile.density_variation(),
        };
        File::new(facts, self.runs.iter().map(|(run, profile)| (run, of_run(profile))))
    }
}

fn ray_rows<'a>(run: &'a str, profile: &'a Profile) -> impl Iterator<Item = RayRow<'a>> {
    let passes = [("coarse", Some(&profile.coarse)), ("fine", profile.fine.as_ref()), ("even", Some(&profile.even))];
    let passes = passes.into_iter().filter_map(|(name, samples)| Some((name, samples?)));
    passes.flat_map(move |(name, samples)| {
        (0..samples.t.len()).map(move |k| {
            let ([x, y, z], [r, g, b]) = (samples.points[k], samples.rgb[k]);
            let (t, density, weight) = (samples.t[k], samples.density[k], samples.weights[k]);
            RayRow { run, samples: name, t, x, y, z, density, weight, transmittance: samples.transmittance[k], r, g, b }
        })
    })
}
