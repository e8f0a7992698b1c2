//! What an address asks for, checked.

use std::collections::HashMap;

use crate::data::pose::{Pose, check_rotation};
use crate::data::{Camera, Scene, View};

use super::perturbed::Attack;
use super::picture::Layer;

/// Least and greatest width and height of a picture, and its most pixels.
const SIDES: std::ops::RangeInclusive<usize> = 8..=4096;
const MOST_PIXELS: usize = 4 << 20;
/// Least and greatest vertical field of view in degrees.
const FIELDS_OF_VIEW: std::ops::RangeInclusive<f64> = 1.0..=170.0;
/// The greatest coordinate of a camera.
const FARTHEST: f64 = 1e6;
/// The greatest factor on deltas.
const GREATEST_SCALE: f64 = 100.0;

/// The arguments of an address, by name.
pub struct Arguments(HashMap<String, String>);

impl Arguments {
    /// Reads what follows the question mark.
    pub fn of(query: &str) -> Arguments {
        Arguments(form_urlencoded::parse(query.as_bytes()).into_owned().collect())
    }

    /// Returns an argument, if it is there.
    pub fn get(&self, name: &str) -> Option<&str> {
        self.0.get(name).map(String::as_str)
    }

    /// Returns a number.
    ///
    /// # Errors
    /// It is missing or no such number.
    pub fn number<T: std::str::FromStr>(&self, name: &str) -> Result<T, String> {
        let text = self.get(name).ok_or_else(|| format!("{name} is missing"))?;
        text.parse().map_err(|_| format!("{name}={text} is not a number that fits there"))
    }

    /// Returns which picture a page has asked for: the page's name and slot, and the request's number.
    ///
    /// # Errors
    /// The name is not one.
    pub fn turn(&self) -> Result<(String, u64), String> {
        let page = self.get("page").unwrap_or_default();
        match page.len() <= 32 && page.chars().all(|c| c.is_ascii_alphanumeric() || c == '-') {
            true => Ok((page.to_string(), self.number("turn")?)),
            false => Err("page must be at most 32 letters, digits and hyphens".into()),
        }
    }

    /// Returns the camera, for a scene: `view=train:3` names one of its own, and `pose`, twelve numbers row by row of
    /// camera to world, with `fov` any other. `width` and `height` are the picture's.
    ///
    /// # Errors
    /// Something is missing or out of range; with `ndc`, the camera looks away from -z.
    pub fn camera(&self, scene: &Scene, ndc: bool) -> Result<Camera, String> {
        let (width, height) = (self.number("width")?, self.number("height")?);
        if !SIDES.contains(&width) || !SIDES.contains(&height) || width * height > MOST_PIXELS {
            return Err(format!(
                "{width} x {height} pixels: width and height must be {} to {}, and their product at most {MOST_PIXELS}",
                SIDES.start(),
                SIDES.end()
            ));
        }
        let camera = match self.view(scene)? {
            Some(view) => view.camera.with_size(width, height),
            None => self.free_camera(width, height)?,
        };
        match ndc && !camera.faces_forward() {
            true => {
                Err("the camera looks away from the -z axis, where this scene has no normalized device coordinates"
                    .into())
            }
            false => Ok(camera),
        }
    }

    /// Returns the scene's own view that is named, if one is.
    ///
    /// # Errors
    /// There is no such view.
    pub fn view<'a>(&self, scene: &'a Scene) -> Result<Option<&'a View>, String> {
        let Some(name) = self.get("view").filter(|name| !name.is_empty()) else { return Ok(None) };
        let found = name.split_once(':').and_then(|(split, index)| {
            let views = match split {
                "train" => &scene.train,
                "held-out" => &scene.test,
                _ => return None,
            };
            views.get(index.parse::<usize>().ok()?)
        });
        let (train, test) = (scene.train.len(), scene.test.len());
        let wrong = || format!("view={name}: there are {train} train and {test} held-out views, counted from 0");
        found.map(Some).ok_or_else(wrong)
    }

    fn free_camera(&self, width: usize, height: usize) -> Result<Camera, String> {
        let text = self.get("pose").ok_or("pose is missing")?;
        let numbers: Vec<f64> = text.split(',').filter_map(|number| number.trim().parse().ok()).collect();
        if numbers.len() != 12 || text.split(',').count() != 12 {
            return Err("pose must be 12 numbers: rows of camera to world".into());
        }
        let pose = std::array::from_fn(|row| std::array::from_fn(|column| numbers[4 * row + column]));
        check_pose(&pose)?;
        let degrees: f64 = self.number("fov")?;
        if !FIELDS_OF_VIEW.contains(&degrees) {
            let (least, most) = (FIELDS_OF_VIEW.start(), FIELDS_OF_VIEW.end());
            return Err(format!("fov={degrees}: the vertical field of view must be {least} to {most} degrees"));
        }
        let focal = 0.5 * height as f64 / (0.5 * degrees.to_radians()).tan();
        Ok(Camera { width, height, focal: [focal; 2], centre: [0.5 * width as f64, 0.5 * height as f64], pose })
    }

    /// Returns the layer; colour if none is named.
    ///
    /// # Errors
    /// There is no such layer.
    pub fn layer(&self) -> Result<Layer, String> {
        let name = self.get("layer").unwrap_or("colour");
        let names = || Layer::ALL.map(Layer::name).join(", ");
        Layer::ALL
            .into_iter()
            .find(|layer| layer.name() == name)
            .ok_or_else(|| format!("layer={name}: layers are {}", names()))
    }

    /// Returns the attack, if any of `sites` is on.
    ///
    /// # Errors
    /// There is no such site; the factor is out of range.
    pub fn attack(&self, sites: &[&str]) -> Result<Option<Attack>, String> {
        let Some(names) = self.get("sites").filter(|names| !names.is_empty()) else { return Ok(None) };
        let on: Vec<String> = names.split(',').map(str::to_string).collect();
        if let Some(unknown) = on.iter().find(|name| !sites.contains(&name.as_str())) {
            let known = if sites.is_empty() { "none".to_string() } else { sites.join(", ") };
            return Err(format!("sites: {unknown} is none of this run's sites, which are {known}"));
        }
        let scale = if self.get("scale").is_some() { self.number("scale")? } else { 1.0 };
        match (0.0..=GREATEST_SCALE).contains(&scale) {
            true => Ok(Some(Attack { sites: on, scale })),
            false => Err(format!("scale={scale}: the factor on deltas must be 0 to {GREATEST_SCALE}")),
        }
    }
}

/// Returns what is wrong with a camera's pose, if anything is.
pub fn check_pose(pose: &Pose) -> Result<(), String> {
    if !pose.iter().flatten().all(|value| value.is_finite() && value.abs() <= FARTHEST) {
        return Err(format!("pose must be 12 numbers from -{FARTHEST:e} to {FARTHEST:e}"));
    }
    check_rotation(pose).map_err(|found| format!("pose must be a rotation and a place, but has {found}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_that_cannot_be_are_refused_in_words() {
        let free = |query: &str| Arguments::of(query).free_camera(40, 30);
        let level = "pose=1,0,0,0.5,0,1,0,0,0,0,1,4";
        let camera = free(&format!("{level}&fov=90")).unwrap();
        assert!((camera.focal[1] - 15.0).abs() < 1e-12 && camera.pose[2][3] == 4.0);
        for (query, words) in [
            ("fov=60", "pose is missing"),
            ("pose=1,0,0&fov=60", "12 numbers"),
            ("pose=1,0,0,nan,0,1,0,0,0,0,1,4&fov=60", "12 numbers"),
            ("pose=1,0,0,1e9,0,1,0,0,0,0,1,4&fov=60", "12 numbers"),
            ("pose=2,0,0,0,0,1,0,0,0,0,1,4&fov=60", "rotation"),
            (level, "fov is missing"),
            (&format!("{level}&fov=180"), "1 to 170"),
        ] {
            let found = free(query).unwrap_err();
            assert!(found.contains(words), "{query}: {found}");
        }
    }

    #[test]
    fn attacks_name_sites_that_exist() {
        let attack = |query: &str| Arguments::of(query).attack(&["t", "xyz"]);
        assert_eq!(attack("sites="), Ok(None));
        assert_eq!(
            attack("sites=t%2Cxyz&scale=2"),
            Ok(Some(Attack { sites: vec!["t".into(), "xyz".into()], scale: 2.0 }))
        );
        assert!(attack("sites=rgb").unwrap_err().contains("t, xyz"));
        assert!(attack("sites=t&scale=-1").unwrap_err().contains("0 to 100"));
        assert!(attack("sites=t&scale=x").unwrap_err().contains("not a number"));
    }
}
