//! Cameras that took no photograph, and the rays that terms of the loss read there.
//!
//! They come from the training cameras alone. InfoNeRF's also come from validation and test poses, and RegNeRF's box
//! spans all cameras, so a method trained there knows more than its photographs.

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

use augnerf_base::rng::Random;
use augnerf_base::settings::name_of;
use augnerf_base::{Error, Result};

use super::path;
use super::pose::{self, Pose, Vec3};
use super::{Camera, Rig, tangents};

/// Where cameras without photographs are. All placements are made from the training cameras alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum UnseenPoses {
    /// In the box around the training cameras, looking at what they look at (RegNeRF on forward-facing scenes).
    Box,
    /// Around what the training cameras look at, as far away and at least as high as they are (RegNeRF on objects).
    Sphere,
    /// Between two training cameras.
    Between,
}

impl UnseenPoses {
    /// Returns the name in files and tables.
    pub fn name(self) -> &'static str {
        name_of::<UnseenPoses>(self as usize)
    }
}

/// Largest angle about each axis by which a ray's twin is turned, in degrees (InfoNeRF).
const MOST_DEGREES: f64 = 5.0;
/// Draws of two cameras whose mean direction exists before one of them is taken.
const MOST_DRAWS: usize = 16;

/// Side of a patch of rays, in pixels (RegNeRF).
pub const PATCH_SIDE: usize = 8;

/// Rays that belong together: a term on rays has a value for each group.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RayGroup {
    /// A ray alone.
    One,
    /// A ray and its twin from nearby.
    Pair,
    /// A photograph's ray through a point of the capture, of which t is known.
    Point,
    /// The rays of [`PATCH_SIDE`] x [`PATCH_SIDE`] pixels, row by row.
    Patch,
}

impl RayGroup {
    /// Returns the number of its rays.
    pub fn rays(self) -> usize {
        match self {
            RayGroup::One | RayGroup::Point => 1,
            RayGroup::Pair => 2,
            RayGroup::Patch => PATCH_SIDE * PATCH_SIDE,
        }
    }
}

/// Where cameras without photographs are, from those of the training views.
pub struct UnseenCameras {
    cameras: Vec<Camera>,
    place: Place,
    /// What the training cameras look at.
    focus: Option<Vec3>,
}

enum Place {
    /// In the box around the training cameras, looking at the focus.
    Box { corners: [Vec3; 2], focus: Vec3, up: Vec3 },
    /// Around the focus, from the lowest training camera's elevation (its sine) to above it, and from the nearest's
    /// distance to the farthest's.
    Sphere { focus: Vec3, up: Vec3, lowest: f64, distances: (f64, f64) },
    /// Between two training cameras.
    Between,
}

/// A camera and the pixel of a ray.
pub type UnseenRay = (Camera, u32, u32);

impl UnseenCameras {
    /// Creates the cameras of a placement.
    ///
    /// # Errors
    /// [`Error::Config`] if there are fewer than two training cameras, or none of their axes meet where the placement
    /// needs it.
    pub fn of(cameras: &[Camera], poses: UnseenPoses) -> Result<UnseenCameras> {
        let refuse = |why: &str, instead: &str| {
            let name = poses.name();
            Err(Error::Config(format!("regularizer.unseen_poses = \"{name}\": {why}; {instead}")))
        };
        if cameras.len() < 2 {
            return refuse("there is one training view, and poses are found from two or more", "add training views");
        }
        let all: Vec<Pose> = cameras.iter().map(|camera| camera.pose).collect();
        let focus = path::centre(&all);
        let (Some(at), Some(up)) = (focus, path::up(&all)) else {
            return match poses {
                UnseenPoses::Between => Ok(UnseenCameras { cameras: cameras.to_vec(), place: Place::Between, focus }),
                _ => refuse(
                    "the training cameras look at no common point in front of them",
                    "set regularizer.unseen_poses = \"between\"",
                ),
            };
        };
        let place = match poses {
            UnseenPoses::Between => Place::Between,
            UnseenPoses::Box => Place::Box { corners: Rig::of(cameras).extent, focus: at, up },
            UnseenPoses::Sphere => around(&all, at, up),
        };
        Ok(UnseenCameras { cameras: cameras.to_vec(), place, focus })
    }

    /// Returns an error if an image is smaller than the pixels of a group.
    ///
    /// # Errors
    /// [`Error::Config`].
    pub fn check(&self, group: RayGroup) -> Result<()> {
        let side = if group == RayGroup::Patch { PATCH_SIDE } else { 2 };
        match self.cameras.iter().find(|camera| camera.width.min(camera.height) < side) {
            None => Ok(()),
            Some(small) => Err(Error::Config(format!(
                "a term of the loss reads {side} x {side} neighbouring pixels, and an image has {} x {}; lower data.downscale",
                small.width, small.height
            ))),
        }
    }

    /// Returns the rays of `count` groups, group by group. A pair is a training camera's ray and its twin: a
    /// neighbouring pixel of it where cameras are placed in a box or look at nothing in common, and otherwise the same
    /// pixel from a pose that is turned about what they look at. A patch has [`PATCH_SIDE`] rows, one after the other.
    pub fn rays(&self, group: RayGroup, count: usize, random: &mut Random) -> Vec<UnseenRay> {
        let one_group = |_| match group {
            RayGroup::One => {
                let camera = self.draw(random);
                vec![any_pixel(camera, random)]
            }
            RayGroup::Pair => {
                let camera = self.cameras[random.below(self.cameras.len() as u32) as usize];
                let ray = any_pixel(camera, random);
                vec![ray, self.twin(ray, random)]
            }
            RayGroup::Patch => patch(self.draw(random), random),
            RayGroup::Point => unreachable!("rays to points are those of photographs"),
        };
        (0..count).flat_map(one_group).collect()
    }

    /// Returns a camera. Its lens is that of a training camera.
    pub fn draw(&self, random: &mut Random) -> Camera {
        let like = self.cameras[random.below(self.cameras.len() as u32) as usize];
        let pose = match &self.place {
            Place::Box { corners: [low, high], focus, up } => {
                let origin: Vec3 = std::array::from_fn(|axis| low[axis] + (high[axis] - low[axis]) * random.uniform());
                pose::look_along(pose::sub(origin, *focus), *up, origin)
            }
            Place::Sphere { focus, up, lowest, distances: (nearest, farthest) } => {
                // Even over the sphere's area.
                let sine = lowest + (1.0 - lowest) * random.uniform();
                let (azimuth, distance) = (TAU * random.uniform(), nearest + (farthest - nearest) * random.uniform());
                let (x, y) = tangents(*up);
                let level = (1.0 - sine * sine).max(0.0).sqrt();
                let side = pose::add_scaled(x.map(|v| v * azimuth.cos()), azimuth.sin(), y);
                let back = pose::add_scaled(up.map(|v| v * sine), level, side);
                pose::look_along(back, *up, pose::add_scaled(*focus, distance, back))
            }
            Place::Between => self.between(random),
        };
        Camera { pose: pose.unwrap_or(like.pose), ..like }
    }

    /// Returns a pose between two training cameras, or `None` if those that were drawn look in opposite directions.
    fn between(&self, random: &mut Random) -> Option<Pose> {
        let one_draw = |_| {
            let pair = random.distinct(2, self.cameras.len() as u32);
            let [a, b] = [pair[0], pair[1]].map(|index| self.cameras[index as usize].pose);
            let share = random.uniform();
            let mixed = |i: usize| {
                let (a, b) = (pose::column(&a, i), pose::column(&b, i));
                pose::add_scaled(a, share, pose::sub(b, a))
            };
            pose::look_along(mixed(2), mixed(1), mixed(3))
        };
        (0..MOST_DRAWS).find_map(one_draw)
    }

    fn twin(&self, (camera, x, y): UnseenRay, random: &mut Random) -> UnseenRay {
        match (self.focus, &self.place) {
            (Some(focus), Place::Sphere { .. } | Place::Between) => {
                let pose = turned(&camera.pose, focus, &mut || MOST_DEGREES * (2.0 * random.uniform() - 1.0));
                (Camera { pose, ..camera }, x, y)
            }
            _ => {
                let beside = |at: u32, size: usize| if at + 1 < size as u32 { at + 1 } else { at - 1 };
                match random.below(2) {
                    0 => (camera, beside(x, camera.width), y),
                    _ => (camera, x, beside(y, camera.height)),
                }
            }
        }
    }
}

fn any_pixel(camera: Camera, random: &mut Random) -> UnseenRay {
    let x = random.below(camera.width as u32);
    (camera, x, random.below(camera.height as u32))
}

fn patch(camera: Camera, random: &mut Random) -> Vec<UnseenRay> {
    let side = PATCH_SIDE as u32;
    let x = random.below(camera.width as u32 - side + 1);
    let y = random.below(camera.height as u32 - side + 1);
    (0..side * side).map(|i| (camera, x + i % side, y + i / side)).collect()
}

fn around(poses: &[Pose], focus: Vec3, up: Vec3) -> Place {
    let offsets = || poses.iter().map(|pose| pose::sub(pose::column(pose, 3), focus));
    let sine = |offset: Vec3| pose::dot(offset, up) / pose::length(offset).max(f64::MIN_POSITIVE);
    let distances = || offsets().map(pose::length);
    Place::Sphere {
        focus,
        up,
        lowest: offsets().map(sine).fold(1.0, f64::min),
        distances: (distances().fold(f64::INFINITY, f64::min), distances().fold(0.0, f64::max)),
    }
}

/// Returns a pose that is turned about a point, by an angle in degrees about each axis.
fn turned(pose: &Pose, about: Vec3, degrees: &mut dyn FnMut() -> f64) -> Pose {
    let angles: [f64; 3] = std::array::from_fn(|_| degrees().to_radians());
    let turn = |v: Vec3| {
        (0..3).fold(v, |v, axis| {
            let (sin, cos) = angles[axis].sin_cos();
            let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
            let mut turned = v;
            (turned[i], turned[j]) = (cos * v[i] - sin * v[j], sin * v[i] + cos * v[j]);
            turned
        })
    };
    let [right, up, back] = [0, 1, 2].map(|i| turn(pose::column(pose, i)));
    let origin = pose::add_scaled(about, 1.0, turn(pose::sub(pose::column(pose, 3), about)));
    pose::from_columns([right, up, back, origin])
}

#[cfg(test)]
mod tests {
    use super::*;
    use augnerf_base::rng::Stream;

    fn camera(origin: Vec3) -> Camera {
        let pose = pose::look_along(origin, [0.0, 0.0, 1.0], origin).unwrap();
        Camera { width: 20, height: 16, focal: [25.0; 2], centre: [10.0, 8.0], pose }
    }

    /// Around the origin, 3 to 4 away, 0.5 or more above it.
    fn ring() -> Vec<Camera> {
        let at = |i: usize| {
            let (sin, cos) = (i as f64 * 0.9).sin_cos();
            let distance = 3.0 + i as f64 / 6.0;
            let height = 0.5 + i as f64 / 4.0;
            let flat = (distance * distance - height * height).sqrt();
            camera([flat * cos, flat * sin, height])
        };
        (0..7).map(at).collect()
    }

    fn random() -> Random {
        Random::new(3, Stream::Unseen, 0)
    }

    fn origin(camera: &Camera) -> Vec3 {
        pose::column(&camera.pose, 3)
    }

    /// The distance of the focus, the origin, from a camera's axis.
    fn miss(camera: &Camera) -> f64 {
        pose::length(pose::cross(origin(camera), pose::column(&camera.pose, 2)))
    }

    #[test]
    fn cameras_are_where_their_placement_says_and_look_at_the_focus() {
        let cameras = ring();
        let [low, high] = Rig::of(&cameras).extent;
        let mut random = random();
        for poses in [UnseenPoses::Box, UnseenPoses::Sphere] {
            let unseen = UnseenCameras::of(&cameras, poses).unwrap();
            let drawn: Vec<Camera> = (0..200).map(|_| unseen.draw(&mut random)).collect();
            for camera in &drawn {
                assert!(miss(camera) < 1e-6, "{poses:?}: {}", miss(camera));
                let (at, distance) = (origin(camera), pose::length(origin(camera)));
                match poses {
                    UnseenPoses::Box => assert!((0..3).all(|i| low[i] <= at[i] && at[i] <= high[i])),
                    _ => assert!((3.0 - 1e-6..=4.0 + 1e-6).contains(&distance) && at[2] / distance > 0.5 / 3.0 - 1e-6),
                }
            }
            // They differ, and from above are on all sides.
            assert!(drawn.iter().any(|camera| origin(camera)[0] < 0.0) && drawn.iter().any(|c| origin(c)[0] > 0.0));
        }
    }

    #[test]
    fn poses_between_two_cameras_are_on_the_way() {
        let two = [camera([4.0, 0.0, 1.0]), camera([0.0, 4.0, 1.0])];
        let unseen = UnseenCameras::of(&two, UnseenPoses::Between).unwrap();
        let mut random = random();
        for _ in 0..50 {
            let at = origin(&unseen.draw(&mut random));
            assert!((at[0] + at[1] - 4.0).abs() < 1e-9 && (at[2] - 1.0).abs() < 1e-9 && at[0] > 0.0 && at[1] > 0.0);
        }
    }

    #[test]
    fn groups_are_rays_pairs_and_patches() {
        let (cameras, mut random) = (ring(), random());
        let unseen = UnseenCameras::of(&cameras, UnseenPoses::Sphere).unwrap();
        assert_eq!(unseen.rays(RayGroup::One, 5, &mut random).len(), 5);
        for pair in unseen.rays(RayGroup::Pair, 40, &mut random).chunks(2) {
            let [(a, x, y), (b, u, v)] = [pair[0], pair[1]];
            assert_eq!((x, y), (u, v));
            assert!(cameras.contains(&a));
            // Turned about the focus: as far away, and still looking at it.
            assert!((pose::length(origin(&a)) - pose::length(origin(&b))).abs() < 1e-9 && miss(&b) < 1e-6);
            let angle = (pose::dot(origin(&a), origin(&b)) / pose::length(origin(&a)).powi(2)).min(1.0).acos();
            assert!(angle > 0.0 && angle.to_degrees() < 9.0);
        }
        let boxed = UnseenCameras::of(&cameras, UnseenPoses::Box).unwrap();
        for pair in boxed.rays(RayGroup::Pair, 40, &mut random).chunks(2) {
            let [(a, x, y), (b, u, v)] = [pair[0], pair[1]];
            assert!(a == b && x.abs_diff(u) + y.abs_diff(v) == 1 && u < 20 && v < 16);
        }
        let patches = unseen.rays(RayGroup::Patch, 30, &mut random);
        for patch in patches.chunks(PATCH_SIDE * PATCH_SIDE) {
            let (camera, x, y) = patch[0];
            for (i, &(of, u, v)) in patch.iter().enumerate() {
                assert_eq!((of, u as usize, v as usize), (camera, x as usize + i % 8, y as usize + i / 8));
                assert!(u < 20 && v < 16);
            }
        }
    }

    #[test]
    fn placements_without_a_common_point_are_refused_in_words() {
        let row: Vec<Camera> = (0..3)
            .map(|i| {
                let at = [i as f64, 0.0, 0.0];
                Camera {
                    pose: pose::look_along([0.0, 0.0, 1.0], [0.0, 1.0, 0.0], at).unwrap(),
                    ..camera([1.0, 0.0, 1.0])
                }
            })
            .collect();
        for poses in [UnseenPoses::Box, UnseenPoses::Sphere] {
            let said = UnseenCameras::of(&row, poses).err().unwrap().to_string();
            assert!(said.contains(poses.name()) && said.contains("\"between\""), "{said}");
        }
        let between = UnseenCameras::of(&row, UnseenPoses::Between).unwrap();
        let (mut random, mut seen) = (random(), 0);
        for pair in between.rays(RayGroup::Pair, 10, &mut random).chunks(2) {
            seen += usize::from(pair[0].1 != pair[1].1 || pair[0].2 != pair[1].2);
        }
        assert_eq!(seen, 10);
        assert!(
            UnseenCameras::of(&row[..1], UnseenPoses::Between).err().unwrap().to_string().contains("one training view")
        );
    }
}
