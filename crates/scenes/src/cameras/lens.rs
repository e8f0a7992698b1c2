//! Lenses and image sizes in a file of cameras.

use super::super::Camera;
use super::super::formats::transforms::{Keys, check_model, focal};
use super::super::json::Object;
use augnerf_base::{Result, number_text};

/// Largest side of a rendered image in pixels.
pub const MOST_PIXELS: usize = 16_384;

/// Returns the pixels along a side from these keys.
fn side(keys: &Keys, key: &str) -> Result<Option<usize>> {
    match keys.number(key)? {
        Some(value) if value.fract() != 0.0 || !(1.0..=MOST_PIXELS as f64).contains(&value) => {
            let found = number_text(value);
            Err(keys.frame.error(&format!("\"{key}\" is {found}, but it must be whole, 1 to {MOST_PIXELS} pixels")))
        }
        value => Ok(value.map(|value| value as usize)),
    }
}

/// Returns the lens of a frame of a `transforms.json`, at the size that the file states.
pub fn of_transforms(frame: Object, document: Object, like: &Camera) -> Result<Camera> {
    check_model(frame, document)?;
    let keys = Keys { frame, document };
    let (width, height) = (side(&keys, "w")?, side(&keys, "h")?);
    let sized = width.zip(height);
    let (width, height) = sized.unwrap_or((like.width, like.height));
    let stated = [keys.positive("fl_x")?, keys.positive("fl_y")?, keys.number("cx")?, keys.number("cy")?];
    if sized.is_none() && stated.iter().any(Option::is_some) {
        return Err(
            frame.error("\"w\" and \"h\" are missing: focal length and principal point are in pixels of that size")
        );
    }
    let [.., cx, cy] = stated;
    let focal = match focal(&keys, [width as f64, height as f64])? {
        [None, None] => return Ok(like.with_size(width, height)),
        [Some(x), None] => [x, x],
        [None, Some(y)] => [y, y],
        [Some(x), Some(y)] => [x, y],
    };
    let centre = [cx.unwrap_or(0.5 * width as f64), cy.unwrap_or(0.5 * height as f64)];
    Ok(Camera { width, height, focal, centre, pose: like.pose })
}

/// Returns the lens of a camera of a `camera_path.json`: its vertical field of view in degrees at the requested size.
/// Additional keys by this program override it.
pub fn of_camera_path(object: Object, document: Object, like: &Camera) -> Result<Camera> {
    let [own, all] = [object, document].map(|object| Keys { frame: object, document: object });
    let width = side(&own, "w")?.or(side(&all, "render_width")?).unwrap_or(like.width);
    let height = side(&own, "h")?.or(side(&all, "render_height")?).unwrap_or(like.height);
    let camera = match object.number("fov")? {
        None => like.with_size(width, height),
        Some(fov) if !(1e-3..=180.0 - 1e-3).contains(&fov) => {
            let found = number_text(fov);
            return Err(object.error(&format!("\"fov\" is {found}, but it must be between 0 and 180 degrees")));
        }
        Some(fov) => {
            let focal = 0.5 * height as f64 / (0.5 * fov).to_radians().tan();
            let centre = [0.5 * width as f64, 0.5 * height as f64];
            Camera { width, height, focal: [focal; 2], centre, pose: like.pose }
        }
    };
    let focal = [own.positive("fl_x")?.unwrap_or(camera.focal[0]), own.positive("fl_y")?.unwrap_or(camera.focal[1])];
    let centre = [own.number("cx")?.unwrap_or(camera.centre[0]), own.number("cy")?.unwrap_or(camera.centre[1])];
    Ok(Camera { focal, centre, ..camera })
}
