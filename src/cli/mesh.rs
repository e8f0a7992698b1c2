//! `augnerf mesh`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use serde_json::json;

use crate::base::settings::numbers;
use crate::base::{Error, Result};
use crate::mesh::Paint;
use crate::run::{
    MeshFormat, MeshOptions, MeshPicture, MeshReport, MeshUnits, OpenOptions, RunDir, Trained, Viewpoint,
};
use crate::runtime::Runtime;
use crate::settings::MESH_SIDES;
use crate::settings::registry::check_flag;
use crate::space::Lattice;

use super::answer::Answer;
use super::compare::pictures_folder;
use super::measure::parse_box;
use super::progress::{Console, open_next};
use super::{Choice, Compute, choice, whole};

#[derive(Args)]
#[command(next_help_heading = "Experiment")]
pub struct MeshArguments {
    /// Run folder (newest checkpoint)
    run: PathBuf,
    /// Scene folder, if it has moved [default: the run's]
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Cells along each side of the box, 8 to 1024 [default: 256]
    #[arg(long, value_name = "N")]
    resolution: Option<usize>,
    /// Density of the surface, per unit of the field [default: ln 2 * samples / (far - near)]
    #[arg(long, value_name = "DENSITY")]
    threshold: Option<f64>,
    /// Corners of the box in the field's units [default: NDC -1..1; built-in scene -1.2..1.2; Blender -1.5..1.5;
    /// otherwise the region that most cameras view, or that of the training rays]
    #[arg(long, value_name = "X,Y,Z,X,Y,Z", allow_hyphen_values = true)]
    bbox: Option<String>,
    /// Values for the flags that are not given
    #[arg(long, value_enum)]
    preset: Option<MeshPreset>,
    /// Close the surface at the sides of the box
    #[arg(long)]
    cap: bool,
    /// Keep only the connected part with the largest area
    #[arg(long)]
    largest: bool,
    /// Output folder, new or empty [default: RUN/mesh, replaced]
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    out: Option<PathBuf>,
    /// Files to write, one or both
    #[arg(long, value_parser = choice(&FORMATS), default_value = "ply", value_delimiter = ',', help_heading = "Output")]
    format: Vec<MeshFormat>,
    /// Units of the files
    #[arg(long, value_parser = choice(&UNITS), default_value = "scene", help_heading = "Output")]
    units: MeshUnits,
    /// Write density.npy, too: float32 [x, y, z] at the cells' midpoints
    #[arg(long, help_heading = "Output")]
    density: bool,
    #[command(flatten)]
    picture: PictureArguments,
    #[command(flatten)]
    answer: Answer,
    #[command(flatten)]
    compute: Compute,
    /// Most memory of grid and mesh in MiB [default: half of the free memory]
    #[arg(long, value_name = "MIB", help_heading = "Hardware")]
    memory: Option<f64>,
}

const FORMATS: [Choice<MeshFormat>; 2] = [
    ("ply", "Binary, with normals and colours", MeshFormat::Ply),
    ("obj", "Text, with normals, and colours after the positions", MeshFormat::Obj),
];
const UNITS: [Choice<MeshUnits>; 2] = [
    ("scene", "The scene's, after recentring and scaling", MeshUnits::Scene),
    ("capture", "Those of the capture's own poses (scene.json has the transform)", MeshUnits::Capture),
];
const PAINTS: [Choice<Paint>; 2] =
    [("clay", "One grey", Paint::Clay), ("colours", "The mesh's own colours", Paint::Colours)];

/// Flags for an image of the mesh.
#[derive(Args)]
#[command(next_help_heading = "Output")]
struct PictureArguments {
    /// Write a shaded image of the mesh, too: a PNG with the views side by side
    #[arg(long, value_name = "FILE.png")]
    picture: Option<PathBuf>,
    /// Held-out views whose cameras the image uses, from 0 [default: 0]
    #[arg(long, value_name = "N,...", value_delimiter = ',', requires = "picture", conflicts_with = "at")]
    view: Vec<usize>,
    /// Positions on the scene's camera path, 0 to 1
    #[arg(long, value_name = "SHARE,...", value_delimiter = ',', requires = "picture")]
    at: Vec<f64>,
    /// Colours of the image
    #[arg(long, value_parser = choice(&PAINTS), default_value = "clay", requires = "picture")]
    paint: Paint,
    /// Width of each view in pixels [default: the scene's, at least 400]
    #[arg(long, value_name = "N", requires = "picture", value_parser = whole::<u16>(8..=4096))]
    columns: Option<u16>,
}

impl PictureArguments {
    /// Returns the requested image, or `None` without `--picture`.
    fn picture(&self) -> Result<Option<MeshPicture>> {
        let Some(file) = self.picture.clone() else { return Ok(None) };
        if file.extension().is_none_or(|ending| !ending.eq_ignore_ascii_case("png")) {
            return Err(Error::Config(format!(
                "--picture {}: not a PNG; choose a name that ends in .png",
                file.display()
            )));
        }
        let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty());
        if let Some(folder) = folder.filter(|folder| !folder.is_dir()) {
            return Err(Error::Output(format!(
                "--picture {}: no folder {}; create it or choose another",
                file.display(),
                folder.display()
            )));
        }
        if let Some(share) = self.at.iter().find(|share| !(0.0..=1.0).contains(*share)) {
            return Err(Error::Config(format!("--at {share}: out of range; choose 0 to 1")));
        }
        let on_path = self.at.iter().map(|share| Viewpoint::Path(*share));
        let mut viewpoints: Vec<Viewpoint> =
            self.view.iter().map(|number| Viewpoint::View(*number)).chain(on_path).collect();
        if viewpoints.is_empty() {
            viewpoints.push(Viewpoint::View(0));
        }
        Ok(Some(MeshPicture { file, viewpoints, paint: self.paint, columns: self.columns.map(usize::from) }))
    }
}

#[derive(Clone, Copy, ValueEnum)]
enum MeshPreset {
    /// The paper's for the chair: 512 cells per side of [-1,1]^3, density 25
    Paper,
}

impl MeshArguments {
    pub fn run(self) -> Result<()> {
        let options = self.options()?;
        self.compute.run(|runtime, console| self.draw(&options, runtime, console))
    }

    fn draw(&self, options: &MeshOptions, runtime: &Runtime, console: &Console) -> Result<()> {
        let trained = Trained::open_at(&self.run, OpenOptions::CAMERAS, self.data.as_deref(), runtime, console)?;
        if let Some(domain) = options.domain {
            Lattice { domain, side: options.resolution }.check_meets(&trained.scene, "--bbox")?;
        }
        let (folder, files) = pictures_folder(self.out.as_deref(), RunDir::mesh_in(trained.run.path()))?;
        let report = trained.draw_mesh_into(files, options, console)?;
        console.say(&describe(&report));
        offset_words(&report).iter().for_each(|words| console.say(words));
        let picture = options.picture.as_ref().map(|picture| picture.file.display().to_string());
        let (run, named) = (self.run.display().to_string(), folder.display().to_string());
        self.answer.give_place(&json!({ "of": run, "folder": named, "picture": picture, "mesh": report }), &folder)?;
        let next = match picture {
            Some(_) => format!("augnerf report {run}"),
            None => format!("augnerf mesh {run} --picture mesh.png"),
        };
        let made = ["mesh.ply", "mesh.obj"].map(|name| folder.join(name));
        open_next(console, &made.into_iter().chain(picture.map(PathBuf::from)).collect::<Vec<_>>(), &next);
        Ok(())
    }

    /// Returns the options of preset and flags, checked.
    fn options(&self) -> Result<MeshOptions> {
        let preset = match self.preset {
            Some(MeshPreset::Paper) => MeshOptions::paper(),
            None => MeshOptions::default(),
        };
        let bbox = self.bbox.as_deref().map(|text| parse_box("bbox", text)).transpose()?;
        let options = MeshOptions {
            resolution: self.resolution.unwrap_or(preset.resolution),
            threshold: self.threshold.or(preset.threshold),
            domain: bbox.or(preset.domain),
            cap: self.cap,
            largest: self.largest,
            formats: self.format.clone(),
            density: self.density,
            most_mib: self.memory,
            picture: self.picture.picture()?,
            units: self.units,
        };
        check_options(&options)?;
        Ok(options)
    }
}

/// Checks the ranges of the flags.
fn check_options(options: &MeshOptions) -> Result<()> {
    let MeshOptions { resolution, threshold, domain, most_mib, .. } = *options;
    let (least, most) = (*MESH_SIDES.start() as u64, *MESH_SIDES.end() as u64);
    let (sides, memory) =
        (numbers().whole(least, most, "8 to 1024 cells per side"), numbers().real(|mib| mib > 0.0, "positive (MiB)"));
    sides.check("--resolution", resolution)?;
    most_mib.map_or(Ok(()), |mib| memory.check("--memory", mib))?;
    threshold.map_or(Ok(()), |threshold| check_flag("--threshold", "eval.mesh.threshold", threshold))?;
    Ok(domain.map_or(Ok(()), |domain| check_flag("--bbox", "eval.mesh.box", domain))?)
}

/// Describes a mesh in one line.
fn describe(report: &MeshReport) -> String {
    let shape = match report.volume {
        Some(volume) => format!("closed, area {:.4}, volume {volume:.4}", report.area),
        None => format!("open at {} edges at the sides of the box, area {:.4}", report.open_edges, report.area),
    };
    format!(
        "level set {:.4} of {}^3: {} vertices, {} faces in {} parts ({} skipped), {shape}; density up to {}",
        report.threshold,
        report.resolution,
        report.vertices,
        report.faces,
        report.components,
        report.components_dropped,
        report.density.largest
    )
}

/// Says what is to be added to positions, if anything is.
fn offset_words(MeshReport { offset: [x, y, z], .. }: &MeshReport) -> Option<String> {
    let is_there = [x, y, z].into_iter().any(|v| *v != 0.0);
    is_there.then(|| {
        format!(
            "positions in the files are less an offset of {x}, {y}, {z} (in mesh.json, too), since most programs keep 7 digits: \
             add it for the capture's own"
        )
    })
}
