//! The intrinsics in a `transforms.json`, for all frames or per frame.

use super::distortion::{Distortion, Intrinsics};
use crate::SMALLEST;
use crate::foreign::FOCAL;
use crate::json::Object;
use augnerf_base::{Result, number_text};

/// Names of pinhole models, with or without OpenCV's radial and tangential distortion.
const MODELS: [&str; 6] = ["OPENCV", "FULL_OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"];
/// Coefficients that no supported model has.
const UNSUPPORTED: [&str; 3] = ["k4", "k5", "k6"];

/// Difference of two focal lengths, as a fraction, that contradict each other.
const CONTRADICTION: f64 = 0.05;

/// The keys that are read from a document or a frame here.
pub(super) const KEYS: [&str; 18] = [
    "fl_x",
    "fl_y",
    "cx",
    "cy",
    "w",
    "h",
    "camera_angle_x",
    "camera_angle_y",
    "camera_model",
    "is_fisheye",
    "k1",
    "k2",
    "k3",
    "k4",
    "k5",
    "k6",
    "p1",
    "p2",
];

/// The lens of a photo.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Lens {
    pub(super) intrinsics: Intrinsics,
    pub(super) distortion: Distortion,
}

/// Keys of a frame, and of the document if the frame lacks them.
pub(crate) struct Keys<'a> {
    pub(crate) frame: Object<'a>,
    pub(crate) document: Object<'a>,
}

impl Keys<'_> {
    pub(crate) fn number(&self, key: &str) -> Result<Option<f64>> {
        Ok(self.frame.number(key)?.or(self.document.number(key)?))
    }

    /// Returns `w` and `h`; missing ones come from `size`.
    fn stated(&self, size: [f64; 2]) -> Result<[f64; 2]> {
        Ok([self.positive("w")?.unwrap_or(size[0]), self.positive("h")?.unwrap_or(size[1])])
    }

    pub(crate) fn angle(&self, key: &str) -> Result<Option<f64>> {
        Ok(self.frame.angle(key)?.or(self.document.angle(key)?))
    }

    pub(crate) fn positive(&self, key: &str) -> Result<Option<f64>> {
        match self.number(key)? {
            Some(v) if v < SMALLEST => Err(self
                .frame
                .error(&format!("\"{key}\" is {}, but it must be positive, at least {SMALLEST:e}", number_text(v)))),
            number => Ok(number),
        }
    }
}

/// Returns whether an image of `size` is a scaled one of the `stated` size. A pixel in either direction is rounding;
/// more is a crop or a turn.
pub(in super::super) fn is_scaled(stated: [f64; 2], (width, height): (usize, usize)) -> bool {
    let size = [width as f64, height as f64];
    (stated[1] * size[0] / stated[0] - size[1]).abs() <= 1.0 + 0.01 * size[1]
}

/// Returns `w` and `h`, if both are given.
pub(super) fn stated(frame: Object, document: Object) -> Result<Option<[f64; 2]>> {
    let keys = Keys { frame, document };
    Ok(keys.positive("w")?.zip(keys.positive("h")?).map(Into::into))
}

impl Lens {
    /// Reads the lens of a frame whose image is `stored` (width, height). Intrinsics for images of another size (`w`,
    /// `h`) are scaled. If neither is there, they are for one that is `reduced` times as large.
    pub(super) fn read(frame: Object, document: Object, stored: (usize, usize), reduced: usize) -> Result<Lens> {
        let keys = Keys { frame, document };
        check_model(frame, document)?;
        check_coefficients(&keys)?;
        let size = [stored.0 as f64, stored.1 as f64];
        let stated = keys.stated(size.map(|side| side * reduced as f64))?;
        let scale = [size[0] / stated[0], size[1] / stated[1]];
        if !is_scaled(stated, stored) {
            return Err(frame.error(&format!(
                "the image is {}x{} pixels, but \"w\" and \"h\" say {}x{}: it was cropped or turned, \
                 so the intrinsics are not its own",
                stored.0, stored.1, stated[0], stated[1]
            )));
        }
        let [Some(x), y] = focal(&keys, stated)? else {
            let (of_frame, of_all) = (frame.instead(FOCAL), document.instead(FOCAL));
            return Err(frame.error(&format!(
                "neither \"fl_x\" nor \"camera_angle_x\" is there, in the frame or for all frames: the focal length is unknown{}",
                if of_frame.is_empty() { of_all } else { of_frame }
            )));
        };
        let focal = [x, y.unwrap_or(x)];
        let centre = [keys.number("cx")?.unwrap_or(0.5 * stated[0]), keys.number("cy")?.unwrap_or(0.5 * stated[1])];
        let scaled = |values: [f64; 2]| [values[0] * scale[0], values[1] * scale[1]];
        let intrinsics = Intrinsics { focal: scaled(focal), centre: scaled(centre) };
        Ok(Lens { intrinsics, distortion: distortion(&keys)? })
    }
}

/// Returns the known focal lengths in x and y, for images of `size` (width, height): `fl_x`, `fl_y`, or from the fields of
/// view. A field of view in y counts only without `fl_x`.
pub(crate) fn focal(keys: &Keys, [width, height]: [f64; 2]) -> Result<[Option<f64>; 2]> {
    let from_angle = |angle: Option<f64>, size: f64| angle.map(|angle| 0.5 * size / (0.5 * angle).tan());
    let [x, y] = [keys.positive("fl_x")?, keys.positive("fl_y")?];
    let wide = from_angle(keys.angle("camera_angle_x")?, width);
    let high = if x.is_none() { from_angle(keys.angle("camera_angle_y")?, height) } else { None };
    Ok([x.or(wide), y.or(high)])
}

/// Says of a frame's field of view that it contradicts the focal length, which is read.
pub(super) fn doubt(frame: Object, document: Object, stored: (usize, usize)) -> Result<Option<String>> {
    let keys = Keys { frame, document };
    let (stated, focal) = (keys.stated([stored.0 as f64, stored.1 as f64])?, keys.positive(FOCAL)?);
    let from_angle = keys.angle("camera_angle_x")?.map(|angle| 0.5 * stated[0] / (0.5 * angle).tan());
    let other = focal.zip(from_angle).filter(|(focal, other)| (other / focal - 1.0).abs() > CONTRADICTION);
    Ok(other.map(|(focal, other)| {
        format!(
            "\"fl_x\" is {focal:.1} and is used, but \"camera_angle_x\" would make it {other:.1}: one of them is wrong"
        )
    }))
}

fn distortion(keys: &Keys) -> Result<Distortion> {
    let coefficient = |key| Ok::<f64, augnerf_base::Error>(keys.number(key)?.unwrap_or(0.0));
    Ok(Distortion {
        radial: [coefficient("k1")?, coefficient("k2")?, coefficient("k3")?],
        tangential: [coefficient("p1")?, coefficient("p2")?],
        rational: [0.0; 3],
    })
}

const ADVICE: &str = "undistort the images first, for example with COLMAP's image_undistorter";

/// Returns an error for lenses that are not pinholes with the supported distortion.
pub(crate) fn check_model(frame: Object, document: Object) -> Result<()> {
    const FISHEYE: &str = "is_fisheye";
    if let Some(key) = [frame, document].into_iter().find_map(|object| object.orthographic()) {
        return Err(frame.error(&format!(
            "\"{key}\" says that the camera is orthographic, but only perspective cameras are read; render the scene with a \
             perspective camera"
        )));
    }
    let model = frame.text("camera_model")?.or(document.text("camera_model")?).unwrap_or("OPENCV");
    if !MODELS.contains(&model.to_ascii_uppercase().as_str()) {
        let what = format!("\"camera_model\" is \"{model}\", but only {} are read; {ADVICE}", MODELS.join(", "));
        return Err(frame.error(&what));
    }
    for object in [frame, document] {
        if object.truth(FISHEYE)? == Some(true) {
            return Err(frame.error(&format!("\"{FISHEYE}\" is true, but only pinhole lenses are read; {ADVICE}")));
        }
    }
    Ok(())
}

fn check_coefficients(keys: &Keys) -> Result<()> {
    for key in UNSUPPORTED {
        if let Some(value) = keys.number(key)?.filter(|v| *v != 0.0) {
            let what = format!("\"{key}\" is {value}, but of distortion only k1, k2, k3, p1 and p2 are read; {ADVICE}");
            return Err(keys.frame.error(&what));
        }
    }
    Ok(())
}
