//! Shaded images of meshes: viewpoints, size, and several views side by side.

use std::path::PathBuf;

use crate::base::{Error, Image, Result};
use crate::data::{Camera, Scene};
use crate::draw::beside;
use crate::mesh::{Mesh, Paint, resized, shade};

/// White pixels between two views of a mesh.
const GAP: usize = 4;
/// Least columns of a view: a mesh shows more detail than the views of small trainings.
const LEAST_COLUMNS: usize = 400;

/// A shaded image of a mesh: several views side by side.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshPicture {
    /// The PNG.
    pub file: PathBuf,
    /// Viewpoints, from left to right.
    pub viewpoints: Vec<Viewpoint>,
    /// Paint of the mesh.
    pub paint: Paint,
    /// Columns of each view; by default those of the scene's views, at least 400.
    pub columns: Option<usize>,
}

/// A viewpoint in a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Viewpoint {
    /// The camera of a held-out view, by its number.
    View(usize),
    /// A point on the scene's camera path: 0 is its start, 1 its end.
    Path(f64),
}

impl MeshPicture {
    /// Returns the cameras in a scene.
    ///
    /// # Errors
    /// The scene does not have the view, or has no camera path.
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

/// Returns the same view with `columns` columns.
fn enlarged(camera: &Camera, columns: Option<usize>) -> Camera {
    let width = columns.unwrap_or(camera.width.max(LEAST_COLUMNS));
    let height = (camera.height as f64 * width as f64 / camera.width as f64).round().max(1.0) as usize;
    resized(camera, width, height)
}

/// Draws a mesh as several cameras see it, side by side.
pub fn mesh_picture(mesh: &Mesh, cameras: &[Camera], paint: Paint) -> Result<Image> {
    let views: Vec<Image> = cameras.iter().map(|camera| shade(mesh, camera, paint)).collect();
    beside(&views.iter().collect::<Vec<&Image>>(), GAP)
}

/// Draws the surface of an evaluation in its first held-out view, or returns `None` if there is none.
pub(super) fn surface_picture(mesh: &Mesh, scene: &Scene) -> Option<Image> {
    let view = scene.test.first()?;
    Some(shade(mesh, &enlarged(&view.camera, None), Paint::Clay))
}
