//! The files of a profile.

use std::path::Path;

use serde::Serialize;

use super::differences::{Difference, differences};
use super::profile::{EVEN, Profile, Profiles, RaySmoothness, Samples, pixels_of};
use super::profile_figure;
use super::run_view::RunView;
use super::window::Window;
use crate::base::files::{write_atomic, write_json};
use crate::base::{Error, Result};
use crate::run::Protocol;

/// A line of `ray.csv`.
#[derive(Serialize)]
struct RayRow<'a> {
    run: &'a str,
    pixel_x: usize,
    pixel_y: usize,
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

/// `profile.json`.
#[derive(Serialize)]
struct ProfileFile<'a> {
    scene: String,
    view: &'a str,
    index: usize,
    pixel: (usize, usize),
    patch: Window,
    even_samples: usize,
    t_unit: &'static str,
    /// The photo's colour at the pixel.
    truth_rgb: &'a [f32],
    differences: Vec<Difference>,
    runs: Vec<RunLine<'a>>,
}

#[derive(Serialize)]
struct RunLine<'a> {
    run: &'a str,
    rgb: [f32; 3],
    depth: Option<f32>,
    smoothness: &'a RaySmoothness,
    protocol: &'a Protocol,
}

impl Profiles {
    /// Writes `profile.svg`, `profile.png` (with the feature `png-figures`), `ray.csv`, `patch.csv` and
    /// `profile.json` into a folder.
    pub fn write(&self, folder: &Path) -> Result<()> {
        for (name, content) in profile_figure::draw(self)?.files("profile") {
            write_atomic(&folder.join(name), &content.bytes()?)?;
        }
        self.write_csv(&folder.join("ray.csv"), |run, profile| {
            let passes = [("coarse", Some(&profile.coarse)), ("fine", profile.fine.as_ref())];
            let passes = passes.into_iter().filter_map(|(name, samples)| Some((name, samples?)));
            let rows = passes.chain([("even", self.own(profile))]);
            rows.flat_map(|(name, samples)| ray_rows(run, self.pixel, name, samples)).collect()
        })?;
        self.write_csv(&folder.join("patch.csv"), |run, profile| {
            let rays = pixels_of(self.patch).into_iter().zip(&profile.even);
            rays.flat_map(|(pixel, samples)| ray_rows(run, pixel, "even", samples)).collect()
        })?;
        write_json(&folder.join("profile.json"), &self.report())
    }

    /// Returns the content of `profile.json`.
    pub fn json(&self) -> serde_json::Value {
        serde_json::to_value(self.report()).expect("plain data")
    }

    fn write_csv<'a>(&'a self, path: &Path, rows: impl Fn(&'a str, &'a Profile) -> Vec<RayRow<'a>>) -> Result<()> {
        let unwritable =
            |error: &dyn std::fmt::Display| Error::Output(format!("cannot write {}: {error}", path.display()));
        let mut writer = csv::Writer::from_writer(Vec::new());
        for (run, profile) in &self.runs {
            rows(&run.label, profile).iter().try_for_each(|row| writer.serialize(row)).map_err(|e| unwritable(&e))?;
        }
        write_atomic(path, &writer.into_inner().map_err(|e| unwritable(&e))?)
    }

    fn report(&self) -> ProfileFile<'_> {
        let named: Vec<&RunView> = self.runs.iter().map(|(run, _)| run).collect();
        let first = named[0];
        let (x, y) = self.pixel;
        let runs = self.runs.iter().map(|(run, profile)| RunLine {
            run: &run.label,
            rgb: profile.rgb,
            depth: profile.depth,
            smoothness: &profile.smoothness,
            protocol: &run.protocol,
        });
        ProfileFile {
            scene: first.protocol.text("scene"),
            view: &first.view.name,
            index: first.index,
            pixel: self.pixel,
            patch: self.patch,
            even_samples: EVEN,
            t_unit: first.depth_unit(),
            truth_rgb: &first.view.image.pixels[(y * first.view.image.width + x) * 3..][..3],
            differences: differences(&named),
            runs: runs.collect(),
        }
    }
}

fn ray_rows<'a>(
    run: &'a str,
    (pixel_x, pixel_y): (usize, usize),
    name: &'static str,
    samples: &'a Samples,
) -> impl Iterator<Item = RayRow<'a>> {
    (0..samples.t.len()).map(move |k| {
        let ([x, y, z], [r, g, b]) = (samples.points[k], samples.rgb[k]);
        let (t, density, weight) = (samples.t[k], samples.density[k], samples.weights[k]);
        let transmittance = samples.transmittance[k];
        RayRow { run, pixel_x, pixel_y, samples: name, t, x, y, z, density, weight, transmittance, r, g, b }
    })
}
