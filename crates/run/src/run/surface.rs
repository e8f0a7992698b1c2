//! Compares the surface of a trained run with a reference mesh: the columns `chamfer` and `f_score`.

use std::path::Path;

use crate::base::{Error, Event, Image, Listener, Result};
use crate::data::{Camera, Scene};
use crate::mesh::{Chamfer, Drawing, Reference, chamfer, in_scene, level_set, read_mesh, sample};
use crate::runtime::free_memory_mib;
use crate::settings::{BuiltinScene, Config, DataKind, MeshConfig, NO_REFERENCE, Placing, Representation};
use crate::space::Lattice;

use super::mesh_picture::surface_picture;
use super::{RenderedView, Viewer};

/// Name of the built-in scene's own mesh as a reference.
const BUILTIN: &str = "builtin";
/// Fraction of the free memory that a surface may take.
const MEMORY_SHARE: f64 = 0.5;
/// Memory limit in MiB if the system does not report the free memory.
const MEMORY_UNKNOWN: f64 = 2048.0;
/// Fixed, since the numbers of an evaluation must not depend on the training's seed.
const SEED: u64 = 0;

/// Returns the default memory limit of a surface in MiB.
pub fn most_memory_mib() -> f64 {
    free_memory_mib().map_or(MEMORY_UNKNOWN, |free| MEMORY_SHARE * free)
}

/// Returns the default box of a scene's surface, in the field's units. Under NDC it is all of NDC. For NeRF-Synthetic
/// and the built-in scene it contains the objects with a margin. For other captures, and Blender folders of another size, it is
/// the box that most cameras look at, or else the box of the training rays.
pub fn surface_box(scene: &Scene) -> [[f64; 3]; 2] {
    let cube = |half: f64| [[-half; 3], [half; 3]];
    match scene.format().and_then(|format| format.kind.object_half()) {
        _ if scene.ndc.is_some() => cube(1.0),
        Some(half) if scene.space.domain.is_none() => cube(half),
        _ => scene.space.domain.unwrap_or_else(|| Lattice::seen(scene)),
    }
}

/// Returns the default density of a scene's surface: it stops half of the light within the mean interval between a
/// ray's samples, ln 2 * samples / (far - near). The run's own rendering shows thinner density as a veil, and cannot
/// resolve a denser surface. For the paper's 64 + 128 samples from 2 to 6 it is 33 (the paper: 25). Under NDC, where
/// rays run from z = -1 to 1, `far - near` is 2. In occupied cells it stops half of the light within
/// six intervals.
///
/// Neural Volumes add up opacity * length: there the surface stops half of the light of one step.
pub fn surface_threshold(config: &Config, scene: &Scene) -> f64 {
    if let (Representation::Volume, Some((_, half))) = (config.representation(), config.nv.cube()) {
        return 0.5 / (config.nv.step_length() * half);
    }
    let length = if scene.ndc.is_some() { 2.0 * (scene.far - scene.near) } else { scene.far - scene.near };
    let (coarse, fine) = config.samples();
    let samples = match config.sampling.kind {
        Placing::Occupancy => fine as f64 / OCCUPIED_INTERVALS,
        Placing::Resampled => (if fine > 0 { fine } else { coarse }) as f64,
    };
    std::f64::consts::LN_2 * samples / length
}

/// Intervals in occupied cells that stop half of the light at a scene's surface. The light of one alone leaves holes.
const OCCUPIED_INTERVALS: f64 = 6.0;

/// Returns the built-in scene whose surface a name means: `builtin`, or `builtin:17`.
pub(super) fn builtin_surface(name: &str) -> Option<BuiltinScene> {
    BuiltinScene::named(name).filter(|scene| scene.kind == DataKind::BuiltinBlender)
}

/// Reads a reference mesh: `builtin`, `builtin:17`, or a file.
fn reference_mesh(name: &str) -> Result<Reference> {
    match builtin_surface(name) {
        Some(scene) => Ok(Reference::builtin(scene.seed)),
        None => read_mesh(Path::new(name)).map(Reference::Mesh),
    }
}

/// Returns the reference mesh of a configuration's surface, or `None` if no surface or no comparison is configured. A
/// scene without a mesh, or a box that cannot contain a surface, is an error.
pub fn surface_reference(config: &Config, scene: &Scene) -> Result<Option<Reference>> {
    let MeshConfig { resolution, reference, domain, .. } = &config.eval.mesh;
    if *resolution == 0 {
        return Ok(None);
    }
    let named = builtin_surface(reference);
    let is_another = |named: &BuiltinScene| named.seed != config.data.scene_number();
    if let Some(named) = named.filter(|named| scene.format().is_some_and(|format| format.has_mesh) && is_another(named))
    {
        let other = named.seed.map_or_else(|| BUILTIN.to_string(), |seed| format!("{BUILTIN}:{seed}"));
        return Err(Error::Config(format!(
            "eval.mesh.reference = \"{other}\" is the surface of another scene than {}; leave it empty for the scene's own",
            scene.name
        )));
    }
    let own = reference.is_empty() || named.is_some();
    if own && !scene.format().is_some_and(|format| format.has_mesh) {
        return Err(Error::Config(format!(
            "eval.mesh.resolution = {resolution} needs a reference mesh for the Chamfer distance, but {} ({}) has none; set \
             eval.mesh.reference to a PLY or OBJ file in the scene's units, or to \"none\" for an image of the surface only, \
             or eval.mesh.resolution to 0",
            scene.name, scene.kind
        )));
    }
    let domain = domain.unwrap_or_else(|| surface_box(scene));
    Lattice { domain, side: *resolution }.check_meets(scene, "eval.mesh.box")?;
    if scene.ndc.is_some() && domain[1][2] > 1.0 {
        return Err(Error::Config(format!(
            "eval.mesh.box reaches z = {}, but {} is queried in normalized device coordinates, where z = 1 is \
             infinitely far away; end the box at 1 or below",
            domain[1][2], scene.name
        )));
    }
    if reference == NO_REFERENCE {
        return Ok(None);
    }
    if own { Ok(Some(Reference::builtin(config.data.scene_number()))) } else { reference_mesh(reference).map(Some) }
}

/// Returns the surface's part of a protocol, or `None` if no surface is configured.
pub(super) fn describe(config: &Config, scene: &Scene) -> Option<String> {
    let MeshConfig { resolution, threshold, domain, reference, points, at } = &config.eval.mesh;
    let name = Path::new(reference).file_name().map_or(BUILTIN.into(), |name| name.to_string_lossy());
    let domain = domain.unwrap_or_else(|| surface_box(scene));
    let threshold = threshold.unwrap_or_else(|| surface_threshold(config, scene));
    let compared = match reference == NO_REFERENCE {
        true => "not compared".to_string(),
        false => format!("reference {name}, {points} points, F-score at {at}"),
    };
    (*resolution > 0).then(|| format!("{resolution}^3 of {domain:?}, density {threshold}, {compared}"))
}

/// The surface of an evaluation.
pub struct Surface {
    /// Distance to the reference mesh, or `None` without a reference.
    pub chamfer: Option<Chamfer>,
    /// Image in the first held-out view, or `None` if no images are written.
    pub picture: Option<Image>,
}

impl Viewer<'_> {
    /// Draws the configured surface and compares it with its reference mesh. Returns `None` if no surface is
    /// configured. If it cannot be drawn, it also returns `None` and reports the reason to `events`, so that the
    /// views' metrics are not lost. `stop_check` is called repeatedly; its error ends the drawing and is returned.
    pub fn surface(&self, events: &dyn Listener, stop_check: impl Fn() -> Result<()>) -> Result<Option<Surface>> {
        if self.config.eval.mesh.resolution == 0 {
            return Ok(None);
        }
        match self.compare_surface(events, stop_check) {
            Ok(surface) => Ok(Some(surface)),
            Err(error @ Error::Interrupted { .. }) => Err(error),
            Err(error) => {
                events.on(Event::Finished);
                events.on(Event::Note(&format!("no surface, so chamfer and f_score stay empty: {error}")));
                Ok(None)
            }
        }
    }

    fn compare_surface(&self, events: &dyn Listener, stop_check: impl Fn() -> Result<()>) -> Result<Surface> {
        let Viewer { model, config, scene, .. } = *self;
        let reference = surface_reference(config, scene)?;
        let mesh = &config.eval.mesh;
        let domain = mesh.domain.unwrap_or_else(|| surface_box(scene));
        let drawing = Drawing {
            lattice: Lattice { domain, side: mesh.resolution },
            threshold: mesh.threshold.unwrap_or_else(|| surface_threshold(config, scene)),
            cap: false,
            most_mib: most_memory_mib(),
        };
        events.on(Event::Started { what: "surface", parts: mesh.resolution as u64 });
        let drawn = level_set(&*model.density(self.runtime)?, &drawing, None, || {
            events.on(Event::Advanced);
            stop_check()
        })?;
        events.on(Event::Finished);
        let surface = in_scene(drawn.mesh, scene.ndc.as_ref())?;
        let picture = if config.eval.pictures > 0 { surface_picture(&surface, scene) } else { None };
        let compare = |reference: Reference| {
            chamfer(&sample(&surface, mesh.points, SEED)?, &reference.sample(mesh.points, SEED)?, mesh.at)
        };
        Ok(Surface { chamfer: reference.map(compare).transpose()?, picture })
    }

    /// Returns a rendered view's depth along its viewing axis in scene units, NaN where there is none. Under NDC it
    /// comes from the mean NDC depth.
    pub fn scene_depth(&self, camera: &Camera, rendered: &RenderedView) -> Vec<f32> {
        let Some(ndc) = self.scene.ndc else { return rendered.depth.clone() };
        let shift = self.config.data.origin_of_pixels().shift();
        let along = |(i, &t): (usize, &f32)| {
            let (x, y) = ((i % camera.width) as f64 + shift, (i / camera.width) as f64 + shift);
            let (origin, direction) = camera.ray(x, y);
            let (o, d) = ndc.map(origin, direction);
            let world = ndc.unmap([0.0, 0.0, o[2] + f64::from(t) * d[2]]);
            // Directions have unit depth.
            world.map_or(f32::NAN, |world| ((world[2] - origin[2]) / direction[2]) as f32)
        };
        rendered.depth.iter().enumerate().map(along).collect()
    }
}
