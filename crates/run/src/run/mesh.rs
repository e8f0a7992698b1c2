//! The surface of a trained run as mesh files.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::base::files::{AtomicDir, write_json};
use crate::base::{Error, Event, Listener, Result};
use crate::data::{WorldToScene, npy};
use crate::draw::write_png8;
use crate::mesh::{self, DensityRange, Drawing, LevelSet, Mesh, finish_mesh, level_set};
use crate::revision::version;
use crate::settings::Capability;
use crate::space::Lattice;

use super::mesh_picture::{MeshPicture, mesh_picture};
use super::scene_file::WorldMatrix;
use super::{Protocol, Trained, folder::free_bytes, most_memory_mib, surface_box, surface_threshold};

/// The file of a [`MeshReport`].
pub(super) const REPORT: &str = "mesh.json";
const DENSITY: &str = "density.npy";
const MIB: f64 = 1024.0 * 1024.0;

/// Options for the surface of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshOptions {
    /// Cells along each side of the box, 8 to 1024.
    pub resolution: usize,
    /// Density of the surface, 1 / length in the field's units; by default [`surface_threshold`].
    pub threshold: Option<f64>,
    /// Lower and upper corner of the box in the field's units; by default [`surface_box`].
    pub domain: Option<[[f64; 3]; 2]>,
    /// Close the surface at the box: the outermost cells count as empty.
    pub cap: bool,
    /// Keep only the connected part of largest area.
    pub largest: bool,
    /// Files to write.
    pub formats: Vec<MeshFormat>,
    /// Also write the densities: `density.npy`, float32 `[x, y, z]` at the cells' midpoints.
    pub density: bool,
    /// Memory limit of sampling grid and mesh in MiB; by default [`most_memory_mib`].
    pub most_mib: Option<f64>,
    /// An image of the mesh to draw as well.
    pub picture: Option<MeshPicture>,
    /// The units of the files.
    pub units: MeshUnits,
}

/// Units of a mesh's files.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MeshUnits {
    /// The scene's units, after recentring and scaling.
    #[default]
    Scene,
    /// The units of the capture's own files.
    Capture,
}

impl Default for MeshOptions {
    /// Returns 256 cells a side, PLY, and otherwise the run's own values.
    fn default() -> MeshOptions {
        MeshOptions {
            resolution: 256,
            threshold: None,
            domain: None,
            cap: false,
            largest: false,
            formats: vec![MeshFormat::Ply],
            density: false,
            most_mib: None,
            picture: None,
            units: MeshUnits::default(),
        }
    }
}

impl MeshOptions {
    /// Returns the paper's options for the chair: 512 cells a side of [-1,1]^3, density 25 (1 for drums).
    pub fn paper() -> MeshOptions {
        MeshOptions {
            resolution: 512,
            threshold: Some(25.0),
            domain: Some([[-1.0; 3], [1.0; 3]]),
            ..MeshOptions::default()
        }
    }

    fn drawing(&self, trained: &Trained) -> Drawing {
        let Trained { scene, config, .. } = trained;
        Drawing {
            lattice: Lattice { domain: self.domain.unwrap_or_else(|| surface_box(scene)), side: self.resolution },
            threshold: self.threshold.unwrap_or_else(|| surface_threshold(config, scene)),
            cap: self.cap,
            most_mib: self.most_mib.unwrap_or_else(most_memory_mib),
        }
    }
}

/// A mesh file format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MeshFormat {
    /// Binary, with normals and colours.
    Ply,
    /// Text, with normals, and colours after the positions.
    Obj,
}

impl MeshFormat {
    /// Returns the file's name in a run's `mesh` folder.
    pub fn file(self) -> &'static str {
        match self {
            MeshFormat::Ply => "mesh.ply",
            MeshFormat::Obj => "mesh.obj",
        }
    }

    fn write(self, path: &Path, mesh: &Mesh) -> Result<()> {
        let comment = format!("level set of a density field by augnerf {}", version());
        let write = || {
            let mut out = BufWriter::new(File::create(path)?);
            match self {
                MeshFormat::Ply => mesh::write_ply(mesh, &comment, &mut out)?,
                MeshFormat::Obj => mesh::write_obj(mesh, &comment, &mut out)?,
            }
            out.flush()
        };
        write().map_err(|e| Error::unwritable(path, &e))
    }
}

/// `mesh.json`: properties and provenance of the mesh.
#[derive(Clone, Debug, Serialize)]
pub struct MeshReport {
    /// Training step of the checkpoint.
    pub step: u64,
    /// Cells along each side of the box.
    pub resolution: usize,
    /// Density of the surface.
    pub threshold: f64,
    /// Corners of the box, in the field's units.
    #[serde(rename = "box")]
    pub domain: [[f64; 3]; 2],
    /// `NDC` or `scene units`: the units of box, threshold and densities.
    pub box_units: &'static str,
    /// Units of the mesh, its area and its volume.
    pub units: MeshUnits,
    /// What is to be added to the files' positions: not 0 for a mesh in capture units far from 0.
    pub offset: [f64; 3],
    /// From the capture's units to the scene's: x_scene = scale R x_capture + t, and `matrix` is `[scale R | t]`.
    pub world_to_scene: WorldMatrix,
    /// The variance along each axis of the Gaussians of a MipNeRF field, in these units squared. Empty for a field
    /// that is queried at points.
    pub variance: Option<[f64; 3]>,
    /// The outermost cells were emptied.
    pub cap: bool,
    /// Densities at the cells' midpoints.
    pub density: DensityRange,
    /// Number of vertices.
    pub vertices: usize,
    /// Number of triangles.
    pub faces: usize,
    /// Each edge belongs to two triangles with opposite directions.
    pub closed: bool,
    /// Number of directed edges without a partner.
    pub open_edges: usize,
    /// Area, units squared.
    pub area: f64,
    /// Volume, units cubed; empty for an open mesh.
    pub volume: Option<f64>,
    /// Number of connected parts of the level set.
    pub components: usize,
    /// Number of parts that were dropped.
    pub components_dropped: usize,
    /// Provenance of the numbers.
    pub protocol: Protocol,
}

impl Trained {
    /// Draws the surface of the evaluated field into a folder, such as the run's `mesh`: `mesh.ply`, `mesh.obj`,
    /// `mesh.json`, `density.npy`. The old files are replaced all at once.
    ///
    /// # Errors
    /// The box misses the scene's rays; the level set is empty or exceeds the memory; the disk has too little space;
    /// weights are not numbers.
    pub fn draw_mesh_into(&self, into: AtomicDir, options: &MeshOptions, events: &dyn Listener) -> Result<MeshReport> {
        self.runtime.install(|| self.draw_mesh_here(into, options, events))
    }

    fn draw_mesh_here(&self, files: AtomicDir, options: &MeshOptions, events: &dyn Listener) -> Result<MeshReport> {
        self.config.require_capability(
            Capability::Density,
            "a mesh of this run",
            "`augnerf compare` shows its depth",
        )?;
        let drawing = options.drawing(self);
        drawing.lattice.check_meets(&self.scene, "the mesh's sampling grid")?;
        options.picture.iter().try_for_each(|picture| picture.cameras(&self.scene).map(|_| ()))?;
        let LevelSet { mut mesh, range } = self.level_set(&drawing, options.density.then_some(&files), events)?;
        let components = mesh.components();
        if options.largest {
            mesh = mesh.keep(&components[0]);
        }
        let (density, ndc) = (self.model.density(&self.runtime)?, self.scene.ndc.as_ref());
        let mut finished = finish_mesh(&*density, mesh, &drawing.lattice, ndc)?;
        if let Some(picture) = &options.picture {
            let cameras = picture.cameras(&self.scene)?;
            write_png8(&picture.file, &mesh_picture(&finished, &cameras, picture.paint)?)?;
        }
        if options.units == MeshUnits::Capture {
            in_capture(&mut finished, &self.scene.space.world);
        }
        for format in &options.formats {
            format.write(&files.path().join(format.file()), &finished)?;
        }
        let dropped = if options.largest { components.len() - 1 } else { 0 };
        let counts = [components.len(), dropped];
        let report = MeshReport::new(self, &drawing, range, &finished, options, counts);
        write_json(&files.path().join(REPORT), &report)?;
        files.commit()?;
        Ok(report)
    }

    /// Extracts the level set; writes `density.npy` into `density_in`.
    fn level_set(&self, drawing: &Drawing, density_in: Option<&AtomicDir>, events: &dyn Listener) -> Result<LevelSet> {
        let path = density_in.map(|files| files.path().join(DENSITY));
        let volume = path.as_ref().map(|path| density_file(path, &drawing.lattice));
        let mut volume = volume.transpose()?;
        let out = volume.as_mut().map(|volume| volume as &mut dyn Write);
        events.on(Event::Started { what: "density", parts: drawing.lattice.side as u64 });
        let advance = || {
            events.on(Event::Advanced);
            Ok(())
        };
        let drawn = level_set(&*self.model.density(&self.runtime)?, drawing, out, advance)?;
        events.on(Event::Finished);
        if let (Some(mut volume), Some(path)) = (volume, path) {
            volume.flush().map_err(|e| Error::unwritable(&path, &e))?;
        }
        Ok(drawn)
    }
}

impl MeshReport {
    fn new(
        trained: &Trained,
        drawing: &Drawing,
        density: DensityRange,
        mesh: &Mesh,
        options: &MeshOptions,
        [components, components_dropped]: [usize; 2],
    ) -> MeshReport {
        let Trained { scene, config, state, .. } = trained;
        let open_edges = mesh.open_edges();
        MeshReport {
            step: state.step,
            resolution: drawing.lattice.side,
            threshold: drawing.threshold,
            domain: drawing.lattice.domain,
            box_units: if scene.ndc.is_some() { "NDC" } else { "scene units" },
            units: options.units,
            offset: mesh.origin,
            world_to_scene: WorldMatrix::of(&scene.space.world),
            variance: config.field.encoding.queries_gaussians().then(|| drawing.lattice.cell_variance()),
            cap: drawing.cap,
            density,
            vertices: mesh.vertices.len(),
            faces: mesh.triangles.len(),
            closed: open_edges == 0,
            open_edges,
            area: mesh.area(),
            volume: (open_edges == 0).then(|| mesh.volume()),
            components,
            components_dropped,
            protocol: trained.protocol(),
        }
    }
}

/// Converts a mesh of the scene to the units of its capture.
fn in_capture(mesh: &mut Mesh, world: &WorldToScene) {
    let single = |point: [f64; 3]| point.map(|v| v as f32);
    let places: Vec<[f64; 3]> = mesh.vertices.iter().map(|vertex| world.to_capture(vertex.map(f64::from))).collect();
    (mesh.vertices, mesh.origin) = mesh::with_origin(&places);
    mesh.normals.iter_mut().for_each(|normal| *normal = single(world.direction_to_capture(normal.map(f64::from))));
}

/// Creates the file of densities, after a check for disk space.
fn density_file(path: &Path, lattice: &Lattice) -> Result<BufWriter<File>> {
    let folder = path.parent().unwrap_or(path);
    let needed = (lattice.cells() * size_of::<f32>()) as f64;
    if let Some(free) = free_bytes(folder).filter(|free| (*free as f64) < needed) {
        return Err(Error::Output(format!(
            "{} has too little space for --density: it takes {:.0} MiB, but {:.0} MiB are free",
            folder.display(),
            needed / MIB,
            free as f64 / MIB
        )));
    }
    let unwritable = |e: std::io::Error| Error::unwritable(path, &e);
    let mut file = BufWriter::new(File::create(path).map_err(unwritable)?);
    file.write_all(&npy::header("<f4", &[lattice.side; 3])).map_err(unwritable)?;
    Ok(file)
}
