//! The built-in scene: a still life in closed form. Tests, benches and first runs then need no download, and depth and
//! shape are known exactly.

pub mod export;
mod family;
pub mod material;
pub mod mesh;
pub mod picture;
pub mod shading;
pub mod shapes;
pub mod stage;
mod still_life;
mod views;

use family::Drawn;
use rayon::prelude::*;

pub use export::{Exported, export};
pub use mesh::Mesh;
pub use picture::Picture;
pub use stage::{Frame, Hit, Stage};

use crate::formats::Capture;
use crate::formats::transforms::Role;
use crate::resample::composite;
use crate::settings::{DataConfig, DataKind, scene_name};
use crate::{Camera, Ndc, Scene, SceneSpace, View, background};
use augnerf_base::{Error, Result};

/// Default width of the built-in scene's images.
const WIDTH: usize = 100;
/// Largest width; wider images would need more memory than the scene's detail is worth.
const MAX_WIDTH: usize = 4096;

/// Returns the still life, or the objects of a seed, on a board in the cameras' frame: all of it within 1.2 of the origin,
/// z up.
pub fn blender_stage(seed: Option<u64>) -> Stage {
    let Some(seed) = seed else { return Stage::new(still_life::on_board(), Frame::SAME) };
    let Drawn { mut objects, board, light, .. } = family::draw(seed);
    objects.push(board);
    Stage::lit(objects, Frame::SAME, light)
}

/// Returns the same on a table before a wall, in the normalized frame of forward-facing scenes. The cameras near the origin
/// look towards -z, and everything is at z < -1.
pub fn forward_stage(seed: Option<u64>) -> Stage {
    let Some(seed) = seed else { return Stage::new(still_life::on_table(), views::forward_frame()) };
    let Drawn { mut objects, room, light, .. } = family::draw(seed);
    objects.extend(room);
    Stage::lit(objects, views::forward_frame(), light)
}

/// Renders the built-in scene with cameras all around. `config` sets width or downscale, splits, background and pixel
/// origin.
pub fn load_blender(config: &DataConfig) -> Result<Scene> {
    let width = columns(config)?;
    let stage = blender_stage(config.scene_number());
    let background = background(config);
    let render = |cameras: &[(String, Camera)]| -> Vec<View> {
        cameras.par_iter().map(|(name, camera)| view(&stage, name, camera, config, background)).collect()
    };
    let held_out: Vec<_> =
        views::around(Role::evaluated(config), width).into_iter().step_by(config.test_skip.max(1)).collect();
    Ok(Scene {
        name: scene_name(config),
        kind: DataKind::BuiltinBlender.name(),
        train: render(&views::around(Role::Train, width)),
        test: render(&held_out),
        near: 2.0,
        far: 6.0,
        ndc: None,
        background: Some(background),
        path: views::orbit(width),
        corrupted: None,
        lacks_split: false,
        space: SceneSpace::default(),
    })
}

/// Renders the forward-facing built-in scene. `config` sets width or downscale, hold-out, NDC and pixel origin.
pub fn load_forward(config: &DataConfig) -> Result<Scene> {
    let width = columns(config)?;
    let stage = forward_stage(config.scene_number());
    let cameras = views::before(width);
    let all: Vec<View> =
        cameras.par_iter().map(|(name, camera)| view(&stage, name, camera, config, [0.0; 3])).collect();
    let camera = cameras[0].1;
    let ndc = Ndc { width: camera.width as f64, height: camera.height as f64, focal: camera.focal[0] };
    let (near, far) = if config.ndc { (0.0, 1.0) } else { depth_range(&all) };
    let ndc = config.ndc.then_some(ndc);
    let capture = Capture {
        views: all,
        path: views::spiral(width),
        near,
        far,
        ndc,
        background: None,
        space: SceneSpace::default(),
    };
    Ok(capture.hold_out(scene_name(config), DataKind::BuiltinForward.name(), config))
}

/// Returns the working width in pixels.
fn columns(config: &DataConfig) -> Result<usize> {
    let width = match config.width as usize {
        0 => WIDTH / config.downscale.unwrap_or(1).max(1) as usize,
        width => width,
    };
    if (4..=MAX_WIDTH).contains(&width) {
        return Ok(width);
    }
    Err(Error::Config(format!(
        "the built-in scene cannot be rendered {width} pixels wide: data.width must be 4 to {MAX_WIDTH}, \
         data.downscale 1 to {}",
        WIDTH / 4
    )))
}

/// Returns bounds of the depths in all views, with a margin of a tenth in front, as in LLFF scenes without NDC.
fn depth_range(views: &[View]) -> (f64, f64) {
    let depths = || views.iter().filter_map(|view| view.depth.as_ref()).flatten().copied();
    let finite = || depths().filter(|depth| depth.is_finite()).map(f64::from);
    (0.9 * finite().fold(f64::INFINITY, f64::min), finite().fold(0.0, f64::max) * 1.001)
}

fn view(stage: &Stage, name: &str, camera: &Camera, config: &DataConfig, background: [f32; 3]) -> View {
    let picture = stage.render(camera, config.origin_of_pixels());
    View { depth: Some(picture.depth), ..View::new(name, *camera, composite(picture.image, background).0) }
}

#[cfg(test)]
mod tests;
