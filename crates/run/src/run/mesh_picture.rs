//! Shaded pictures of meshes: from where, how large, side by side.

use std::path::PathBuf;

use crate::base::{Error, Image, Result};
use crate::data::{Camera, Scene};
use crate::draw::beside;
use crate::space::{Mesh, Paint, resized, shade};

/// White pixels between two views of a mesh.
const GAP: usize = 4;
/// A picture of a mesh has at least so many columns a view: a mesh is finer than the views of small trainings.
const LEAST_COLUMNS: usize = 400;

/// A shaded picture of a mesh: several views side by side.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshPicture {
    /// The PNG.
    pub file: PathBuf,
    /// From where it is looked at, from left to right.
    pub viewpoints: Vec<Viewpoint>,
    /// What it is painted with.
    pub paint: Paint,
    /// Columns of each view; none: those of the scene's views, at least 400.
    pub columns: Option<usize>,
}

/// A place to look at a scene from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Viewpoint {
    /// The camera of a held-out view, by its number.
    View(usize),
    /// A place on the scene's camera path: 0 is its begin, 1 its end.
    Path(f64),
}

impl MeshPicture {
    /// The cameras in a scene.
    ///
    /// # Errors
    /// A view that the scene has not; a path, where it has none.
    pub fn cameras(&self, scene: &Scene) -> Result<Vec<Camera>> {
        let camera = |viewpoint: &Viewpoint| match *viewpoint {
            Viewpoint::View(number) => scene.test.get(number).map(|view| view.camera).ok_or_else(|| {
                Error::Config(format!(
                    "--view {number}: {} has {} held-out views, counted from 0",
                    scene.name,
                    scene.test.len()
                ))
            }),
            Viewpoint::Path(share) => {
                let index = (share * scene.path.len() as f64) as usize;
                let last = scene.path.len().checked_sub(1);
                last.map(|last| scene.path[index.min(last)]).ok_or_else(|| {
                    Error::Config(format!("--at {share}: {} has no camera path; use --view", scene.name))
                })
            }
        };
        self.viewpoints.iter().map(|viewpoint| Ok(enlarged(&camera(viewpoint)?, self.columns))).collect()
    }
}

/// The same view with so many columns.
fn enlarged(camera: &Camera, columns: Option<usize>) -> Camera {
    let width = columns.unwrap_or(camera.width.max(LEAST_COLUMNS));
    let height = (camera.height as f64 * width as f64 / camera.width as f64).round().max(1.0) as usize;
    resized(camera, width, height)
}

/// A mesh as several cameras see it, side by side.
pub fn mesh_picture(mesh: &Mesh, cameras: &[Camera], paint: Paint) -> Result<Image> {
    let views: Vec<Image> = cameras.iter().map(|camera| shade(mesh, camera, paint)).collect();
    beside(&views.iter().collect::<Vec<&Image>>(), GAP)
}

/// The surface of an evaluation as its first held-out view sees it; none without one.
pub(super) fn surface_picture(mesh: &Mesh, scene: &Scene) -> Option<Image> {
    let view = scene.test.first()?;
    Some(shade(mesh, &enlarged(&view.camera, None), Paint::Clay))
}
