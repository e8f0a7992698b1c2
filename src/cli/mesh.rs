//! `augnerf mesh` and `augnerf chamfer`.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use candle_core::Device;
use clap::{Args, ValueEnum};
use serde::Serialize;

use crate::base::files::{AtomicDir, write_json};
use crate::base::{Error, Progress, Result, version};
use crate::data::npy;
use crate::run::{
    BUILTIN, Protocol, RunDir, columns, folder, most_memory_mib, reference_mesh, run_config, surface_box,
    surface_threshold,
};
use crate::settings::{DataKind, MeshConfig, validate_mesh};
use crate::space::{self, DensityRange, Drawing, Lattice, LevelSet, Mesh, Reference, Score, Skin, level_set, skin};

use super::Machine;
use super::eval::Trained;
use super::measure::{csv_line, parse_box};
use super::progress::{Screen, print, report};

/// Cells a side where nobody says how many.
const RESOLUTION: usize = 256;
const DENSITY: &str = "density.npy";
const MIB: f64 = 1024.0 * 1024.0;

#[derive(Args)]
pub struct MeshArguments {
    /// Run folder; its newest checkpoint's evaluated field is drawn
    run: PathBuf,
    /// Cells along each side of the box, 8 to 1024 [default: 256]
    #[arg(long, value_name = "N")]
    resolution: Option<usize>,
    /// Density of the surface, 1 / length in the units that the field is asked in [default: that which stops half of
    /// the light within the run's mean sample interval, ln 2 * samples / (far - near)]
    #[arg(long, value_name = "DENSITY")]
    threshold: Option<f64>,
    /// Corners of the box in the units that the field is asked in [default: NDC -1..1; embedded scene -1.2..1.2;
    /// NeRF-Synthetic -1.5..1.5; otherwise what the training rays run through]
    #[arg(long, value_name = "X,Y,Z,X,Y,Z", allow_hyphen_values = true)]
    bbox: Option<String>,
    /// Settings that the other flags change
    #[arg(long, value_enum)]
    preset: Option<MeshPreset>,
    /// Close the surface where it would leave the box: its outermost cells count as empty
    #[arg(long)]
    cap: bool,
    /// Keep the connected part of largest area alone
    #[arg(long)]
    largest: bool,
    /// Files to write, one or both
    #[arg(long, value_enum, value_delimiter = ',', default_value = "ply")]
    format: Vec<Format>,
    /// Write the densities, too: density.npy, float32 [x, y, z] at the cells' midpoints
    #[arg(long)]
    density: bool,
    /// Memory that lattice and mesh may take, MiB [default: a half of what is free]
    #[arg(long, value_name = "MIB")]
    memory: Option<f64>,
    /// Scene folder, if it has moved since training
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    #[command(flatten)]
    machine: Machine,
}

#[derive(Clone, Copy, ValueEnum)]
enum MeshPreset {
    /// 512 cells a side of [-1,1]^3, density 25: the paper's for the chair (1 for drums)
    Paper,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Format {
    /// Binary, with normals and colours
    Ply,
    /// Text, with normals, and colours behind the positions
    Obj,
}

impl Format {
    fn file(self) -> &'static str {
        match self {
            Format::Ply => "mesh.ply",
            Format::Obj => "mesh.obj",
        }
    }
}

/// `mesh.json`: what the mesh is and where it comes from.
#[derive(Serialize)]
struct MeshReport {
    /// Training step of the checkpoint.
    step: u64,
    /// Cells along each side of the box.
    resolution: usize,
    /// Density of the surface.
    threshold: f64,
    /// Corners of the box, in the units that the field is asked in.
    #[serde(rename = "box")]
    domain: [[f64; 3]; 2],
    /// `NDC` or `scene units`: those of box, threshold and densities. The mesh is always in scene units.
    box_units: &'static str,
    /// What a MipNeRF field is asked at: Gaussians of a cell's variance along each axis, in these units squared. Empty for
    /// a field that is asked at points.
    variance: Option<[f64; 3]>,
    /// Whether the outermost cells were emptied.
    cap: bool,
    density: DensityRange,
    vertices: usize,
    faces: usize,
    /// Each edge belongs to two triangles that walk it in opposite directions.
    closed: bool,
    /// Directed edges that do not.
    open_edges: usize,
    /// Area in scene units.
    area: f64,
    /// Volume in scene units; empty for an open mesh, which encloses none.
    volume: Option<f64>,
    /// Connected parts of the level set.
    components: usize,
    /// Those that were left out.
    components_dropped: usize,
    /// Vertices where density has no gradient, whose normal is that of the triangles around them.
    normals_of_triangles: usize,
    protocol: Protocol,
}

impl MeshArguments {
    pub fn run(self) -> Result<()> {
        let settings = self.settings()?;
        let device = self.machine.device()?;
        let screen = Screen::new(self.machine.quiet);
        let trained = Trained::open(&self.run, self.data.as_deref(), &device, &screen)?;
        let (scene, field) = (&trained.scene, trained.model.evaluated());
        let drawing = self.drawing(&settings, &trained);
        drawing.lattice.check_meets(scene, "--bbox")?;
        let folder = trained.run.mesh();
        let files = AtomicDir::new(&folder)?;
        let LevelSet { mut mesh, range } = self.draw(&drawing, &trained, &files, &device, &screen)?;
        let components = mesh.components();
        if self.largest {
            mesh = mesh.keep(&components[0]);
        }
        let skin = skin(field, mesh, &drawing.lattice, scene.ndc.as_ref(), &device)?;
        for format in &self.format {
            write_mesh(&files.path().join(format.file()), *format, &skin.mesh)?;
        }
        let dropped = if self.largest { components.len() - 1 } else { 0 };
        let report = MeshReport::new(&trained, &drawing, range, &skin, [components.len(), dropped]);
        write_json(&files.path().join("mesh.json"), &report)?;
        files.commit()?;
        screen.say(&report.words(&folder));
        Ok(())
    }

    fn drawing(&self, settings: &MeshConfig, trained: &Trained) -> Drawing {
        let Trained { scene, config, .. } = trained;
        Drawing {
            lattice: Lattice {
                domain: settings.domain.unwrap_or_else(|| surface_box(scene)),
                side: settings.resolution,
            },
            threshold: settings.threshold.unwrap_or_else(|| surface_threshold(config, scene)),
            cap: self.cap,
            most_mib: self.memory.unwrap_or_else(most_memory_mib),
        }
    }

    /// The level set, with `density.npy` where it is asked for.
    fn draw(
        &self,
        drawing: &Drawing,
        trained: &Trained,
        files: &AtomicDir,
        device: &Device,
        screen: &Screen,
    ) -> Result<LevelSet> {
        let lattice = &drawing.lattice;
        let mut volume = if self.density { Some(density_file(files, &trained.run, lattice)?) } else { None };
        let out = volume.as_mut().map(|volume| volume as &mut dyn Write);
        screen.start("density", lattice.side as u64);
        let advance = || {
            screen.advance();
            Ok(())
        };
        let drawn = level_set(trained.model.evaluated(), drawing, device, out, advance)?;
        screen.finish();
        if let Some(mut volume) = volume {
            volume.flush().map_err(|e| Error::unwritable(&files.path().join(DENSITY), &e))?;
        }
        Ok(drawn)
    }

    /// Preset and flags, checked.
    fn settings(&self) -> Result<MeshConfig> {
        let mut settings = MeshConfig { resolution: RESOLUTION, ..MeshConfig::default() };
        if let Some(MeshPreset::Paper) = self.preset {
            settings =
                MeshConfig { resolution: 512, threshold: Some(25.0), domain: Some([[-1.0; 3], [1.0; 3]]), ..settings };
        }
        settings.resolution = self.resolution.unwrap_or(settings.resolution);
        settings.threshold = self.threshold.or(settings.threshold);
        if let Some(text) = &self.bbox {
            settings.domain = Some(parse_box("bbox", text)?);
        }
        let of_flags = |error: Error| {
            let text = error.to_string().replace("eval.mesh.box", "--bbox").replace("eval.mesh.", "--");
            Error::Config(text.replace("0 (no surface), or ", ""))
        };
        if settings.resolution == 0 {
            return Err(Error::Config("--resolution 0 is out of range: it must be 8 to 1024 cells a side".into()));
        }
        validate_mesh(&settings).map_err(of_flags)?;
        match self.memory.filter(|memory| !(memory.is_finite() && *memory > 0.0)) {
            Some(memory) => Err(Error::Config(format!("--memory {memory} is out of range: it must be positive (MiB)"))),
            None => Ok(settings),
        }
    }
}

impl MeshReport {
    fn new(
        trained: &Trained,
        drawing: &Drawing,
        density: DensityRange,
        skin: &Skin,
        [components, components_dropped]: [usize; 2],
    ) -> MeshReport {
        let Trained { scene, config, state, .. } = trained;
        let (mesh, open_edges) = (&skin.mesh, skin.mesh.open_edges());
        MeshReport {
            step: state.step,
            resolution: drawing.lattice.side,
            threshold: drawing.threshold,
            domain: drawing.lattice.domain,
            box_units: if scene.ndc.is_some() { "NDC" } else { "scene units" },
            variance: config.method.is_mip().then(|| drawing.lattice.cell_variance()),
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
            normals_of_triangles: skin.flat,
            protocol: Protocol::new(config, scene, state),
        }
    }

    fn words(&self, folder: &Path) -> String {
        let shape = match self.volume {
            Some(volume) => format!("closed, area {:.4}, volume {volume:.4}", self.area),
            None => format!("open at {} edges where it leaves the box, area {:.4}", self.open_edges, self.area),
        };
        format!(
            "level set {:.4} of {}^3: {} vertices, {} faces in {} parts ({} left out), {shape}; density up to {}: {}",
            self.threshold,
            self.resolution,
            self.vertices,
            self.faces,
            self.components,
            self.components_dropped,
            self.density.largest,
            folder.display()
        )
    }
}

/// The begun `density.npy`, on a disk with room for it.
fn density_file(files: &AtomicDir, run: &RunDir, lattice: &Lattice) -> Result<BufWriter<File>> {
    let path = files.path().join(DENSITY);
    let needed = (lattice.cells() * size_of::<f32>()) as f64;
    if let Some(free) = folder::free_bytes(run.path()).filter(|free| (*free as f64) < needed) {
        return Err(Error::Output(format!(
            "{} has too little room for --density: it takes {:.0} MiB and {:.0} MiB are free",
            run.path().display(),
            needed / MIB,
            free as f64 / MIB
        )));
    }
    let unwritable = |e: std::io::Error| Error::unwritable(&path, &e);
    let mut file = BufWriter::new(File::create(&path).map_err(unwritable)?);
    file.write_all(&npy::header(&[lattice.side; 3])).map_err(unwritable)?;
    Ok(file)
}

fn write_mesh(path: &Path, format: Format, mesh: &Mesh) -> Result<()> {
    let comment = format!("level set of a density field by augnerf {}", version());
    let write = || {
        let mut out = BufWriter::new(File::create(path)?);
        match format {
            Format::Ply => space::write_ply(mesh, &comment, &mut out)?,
            Format::Obj => space::write_obj(mesh, &comment, &mut out)?,
        }
        out.flush()
    };
    write().map_err(|e| Error::unwritable(path, &e))
}

#[derive(Args)]
pub struct ChamferArguments {
    /// A .ply or .obj file, or a run folder with a mesh
    mesh: String,
    /// The same, or `builtin`: the embedded scene as seen from all around
    reference: String,
    /// Points drawn on each surface, evenly over its area
    #[arg(long, value_name = "N", default_value_t = 200_000)]
    points: usize,
    /// Seed of the points
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Distances of the F-scores, in the meshes' units
    #[arg(long, value_name = "D,D,...", value_delimiter = ',', default_value = "0.01,0.02,0.05")]
    at: Vec<f64>,
    /// No words beside the table; errors are still printed
    #[arg(long, short)]
    quiet: bool,
}

impl ChamferArguments {
    pub fn run(self) -> Result<()> {
        for &at in &self.at {
            let checked = validate_mesh(&MeshConfig { points: self.points, at, ..MeshConfig::default() });
            checked.map_err(|error| Error::Config(error.to_string().replace("eval.mesh.", "--")))?;
        }
        let draw = |name: &str, other: &str| named_mesh(name, other)?.sample(self.points, self.seed);
        let (mesh, reference) = (draw(&self.mesh, &self.reference)?, draw(&self.reference, &self.mesh)?);
        let compared = space::chamfer(&mesh, &reference, &self.at)?;
        let mut cells = vec![
            ("mesh".into(), self.mesh.clone()),
            ("reference".into(), self.reference.clone()),
            ("points_mesh".into(), mesh.points.len().to_string()),
            ("points_reference".into(), reference.points.len().to_string()),
            ("seed".into(), self.seed.to_string()),
        ];
        cells.extend(columns(&compared));
        for Score { at, precision, recall, f_score } in &compared.scores {
            let scores = [("precision", precision), ("recall", recall), ("f_score", f_score)];
            cells.extend(scores.map(|(name, value)| (format!("{name}_{at}"), value.to_string())));
        }
        let (names, values): (Vec<_>, Vec<_>) = cells.into_iter().unzip();
        print(&csv_line(&names));
        print(&csv_line(&values));
        if !self.quiet {
            report(&format!(
                "Chamfer {:.5}: {:.5} from the mesh to the reference, {:.5} back; two drawings of one surface would be {:.5} \
                 apart with as many points",
                compared.chamfer, compared.mesh_to_reference, compared.reference_to_mesh, compared.floor
            ));
        }
        Ok(())
    }
}

/// `builtin`, a mesh file, or the mesh of a run folder; `other` is what it is compared with.
fn named_mesh(name: &str, other: &str) -> Result<Reference> {
    let path = Path::new(name);
    if name == BUILTIN || !path.is_dir() {
        return reference_mesh(name);
    }
    let run = RunDir::open(path)?;
    let scene = run_config(&run)?.data;
    if other == BUILTIN && scene.kind != DataKind::BuiltinBlender {
        return Err(Error::Config(format!(
            "{name} is of {} ({}), in units of its own: `{BUILTIN}` is the surface of {} alone",
            scene.name,
            scene.kind.name(),
            DataKind::BuiltinBlender.name()
        )));
    }
    let folder = run.mesh();
    let found =
        [Format::Ply, Format::Obj].map(|format| folder.join(format.file())).into_iter().find(|file| file.is_file());
    let file = found.ok_or_else(|| {
        Error::Data(format!("{name} has no mesh yet: draw it with `augnerf mesh {name}`, then compare again"))
    })?;
    reference_mesh(&file.to_string_lossy())
}
