//! Meshes that are compared, by the names that a command gives them.

use std::path::{Path, PathBuf};

use serde::Deserialize;

use crate::base::input::{JSON_BYTES, read_text};
use crate::base::{Error, Result};
use crate::data::{Format, WorldToScene};
use crate::mesh::Reference;
use crate::settings::Capability;

use super::mesh::{MeshFormat, MeshUnits, REPORT};
use super::scene_file::WorldMatrix;
use super::{RunDir, builtin_surface, reference_mesh};

/// Reads a mesh by name: `builtin` (the built-in scene's own), a PLY or OBJ file, or a run folder with a drawn mesh.
/// `other` names what it will be compared with.
///
/// # Errors
/// The file is not a mesh; the run has no mesh; the other mesh is of another scene, or in other coordinates.
pub fn named_mesh(name: &str, other: &str) -> Result<Reference> {
    let path = Path::new(name);
    if builtin_surface(name).is_some() || !path.is_dir() {
        check_alike(name, other)?;
        return reference_mesh(name);
    }
    let run = RunDir::open(path)?;
    let config = run.read_config()?;
    config.require_capability(
        Capability::Density,
        &format!("the surface of {name}"),
        "compare runs of nerf, aug-nerf or nv",
    )?;
    let scene = config.data;
    let has_mesh = Format::of(scene.kind).is_some_and(|format| format.has_mesh);
    if builtin_surface(other).is_some_and(|surface| !has_mesh || surface.seed != scene.scene_number()) {
        return Err(Error::Config(format!(
            "{name} is of {} ({}), and `{other}` is the surface of another scene",
            scene.name,
            scene.kind.name()
        )));
    }
    let files: [PathBuf; 2] = MeshFormat::ALL.map(|format| RunDir::mesh_in(run.path()).join(format.file()));
    let file = files.into_iter().find(|file| file.is_file()).ok_or_else(|| {
        Error::Data(format!("{name} has no mesh yet; draw it with `augnerf mesh {name}`, then compare again"))
    })?;
    check_units(name)?;
    check_alike(name, other)?;
    reference_mesh(&file.to_string_lossy())
}

/// Where a mesh lies, by its `mesh.json`.
#[derive(Deserialize)]
struct Placed {
    units: MeshUnits,
    world_to_scene: WorldMatrix,
    protocol: OfScene,
}

/// The scene in a protocol.
#[derive(Deserialize)]
struct OfScene {
    scene: String,
    dataset: String,
}

impl Placed {
    /// Reads it for a run folder, or for a mesh file that lies beside its `mesh.json`. Returns `None` if there is none.
    fn of(name: &str) -> Result<Option<Placed>> {
        let path = Path::new(name);
        if builtin_surface(name).is_some() {
            return Ok(None);
        }
        if path.is_dir() {
            return Placed::read(&RunDir::mesh_in(path).join(REPORT));
        }
        let drawn = MeshFormat::ALL.iter().any(|format| path.file_name().is_some_and(|file| file == format.file()));
        if !drawn {
            return Ok(None);
        }
        // A file of this name may be another program's.
        Ok(Placed::read(&path.with_file_name(REPORT)).ok().flatten())
    }

    fn read(path: &Path) -> Result<Option<Placed>> {
        if !path.is_file() {
            return Ok(None);
        }
        let text = read_text(path, JSON_BYTES).map_err(|e| Error::unreadable(path, &e))?;
        let wrong = |e| Error::Data(format!("{} is not what `augnerf mesh` writes: {e}", path.display()));
        serde_json::from_str(&text).map(Some).map_err(wrong)
    }

    /// Returns the scene's name and kind.
    fn scene(&self) -> String {
        format!("{} ({})", self.protocol.scene, self.protocol.dataset)
    }

    /// Returns the map from the capture's units to the mesh's.
    fn world(&self) -> WorldMatrix {
        match self.units {
            MeshUnits::Scene => self.world_to_scene,
            MeshUnits::Capture => WorldMatrix::of(&WorldToScene::default()),
        }
    }
}

/// Returns an error for a run's mesh in its capture's units, since comparisons use the scene's.
fn check_units(name: &str) -> Result<()> {
    if Placed::of(name)?.is_none_or(|placed| placed.units == MeshUnits::Scene) {
        return Ok(());
    }
    Err(Error::Config(format!(
        "{name} has a mesh in its capture's units, but distances are measured in the scene's; draw it again without --units \
         capture, or name the mesh files themselves if both have the same units"
    )))
}

/// Returns an error if the meshes are known to be of different scenes, or in different coordinates of one scene.
fn check_alike(name: &str, other: &str) -> Result<()> {
    let (Some(mesh), Some(reference)) = (Placed::of(name)?, Placed::of(other)?) else { return Ok(()) };
    // One capture may be read from two folders, or as two formats. In its own units that makes no difference.
    if [&mesh, &reference].iter().all(|mesh| mesh.units == MeshUnits::Capture) {
        return Ok(());
    }
    let (scene, another) = (mesh.scene(), reference.scene());
    if scene != another {
        return Err(Error::Config(format!(
            "{name} is of {scene}, and {other} is of {another}, so their distance means nothing; compare meshes of one scene"
        )));
    }
    match mesh.world().is_close(&reference.world()) {
        true => Ok(()),
        false => Err(Error::Config(format!(
            "{name} and {other} have different coordinates (units and world_to_scene of {REPORT}); draw both runs with \
             `augnerf mesh RUN --units capture`, then compare their mesh files by name"
        ))),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;

    const TRIANGLE: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";

    /// A mesh file beside its `mesh.json`.
    fn mesh(dir: &Path, name: &str, report: &Value) -> String {
        let folder = dir.join(name);
        std::fs::create_dir(&folder).unwrap();
        std::fs::write(folder.join(REPORT), report.to_string()).unwrap();
        let file = folder.join("mesh.obj");
        std::fs::write(&file, TRIANGLE).unwrap();
        file.display().to_string()
    }

    fn report(scene: &str, units: &str, world: WorldToScene) -> Value {
        json!({
            "units": units,
            "world_to_scene": WorldMatrix::of(&world),
            "protocol": { "scene": scene, "dataset": "llff" },
        })
    }

    #[test]
    fn meshes_of_other_scenes_or_coordinates_are_not_compared() {
        let dir = tempfile::tempdir().unwrap();
        let own = WorldToScene::default().scaled(0.5);
        let mut moved = own;
        moved.rotation_and_origin[0][3] = 0.1;
        let of = |name: &str, scene: &str, units: &str, world| mesh(dir.path(), name, &report(scene, units, world));
        let fern = of("fern", "fern", "scene", own);
        let same = of("same", "fern", "scene", own.scaled(1.0 + 1e-12));
        let larger = of("larger", "fern", "scene", own.scaled(2.5));
        let moved = of("moved", "fern", "scene", moved);
        let [capture, again] =
            [("capture", own), ("again", own.scaled(3.0))].map(|(name, world)| of(name, "fern", "capture", world));
        let chair = of("chair", "chair", "scene", own);
        let refused = |a: &str, b: &str, words: [&str; 2]| {
            for (name, other) in [(a, b), (b, a)] {
                let error = named_mesh(name, other).err().expect("must be refused");
                assert_eq!(error.exit_code(), 2);
                let said = error.to_string();
                assert!(words.iter().chain(&[name, other]).all(|word| said.contains(word)), "{said}");
            }
        };
        for (a, b) in [(&fern, &same), (&capture, &again)] {
            named_mesh(a, b).unwrap();
            named_mesh(b, a).unwrap();
        }
        for other in [&larger, &moved, &capture] {
            refused(&fern, other, ["different coordinates", "--units capture"]);
        }
        refused(&fern, &chair, ["fern (llff)", "chair (llff)"]);
    }

    /// Captures in small units have small matrices.
    #[test]
    fn coordinates_are_told_apart_by_their_scale() {
        let world = |scale: f64| WorldMatrix::of(&WorldToScene::default().scaled(scale));
        assert!(world(1e-9).is_close(&world(1e-9 * (1.0 + 1e-9))) && !world(1e-9).is_close(&world(2e-9)));
    }

    #[test]
    fn meshes_of_which_nothing_is_known_are_compared() {
        let dir = tempfile::tempdir().unwrap();
        let fern = mesh(dir.path(), "fern", &report("fern", "scene", WorldToScene::default()));
        // Another program's, an earlier version's, and a file that lies beside the report of another.
        let foreign = mesh(dir.path(), "foreign", &json!([1, 2]));
        let early = mesh(dir.path(), "early", &json!({ "step": 3 }));
        let beside = mesh(dir.path(), "beside", &report("chair", "scene", WorldToScene::default()));
        let beside = Path::new(&beside).with_file_name("reference.obj");
        std::fs::write(&beside, TRIANGLE).unwrap();
        for other in [&*foreign, &early, beside.to_str().unwrap(), "builtin"] {
            named_mesh(&fern, other).unwrap();
            named_mesh(other, &fern).unwrap();
        }
    }
}
