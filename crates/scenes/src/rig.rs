//! What the cameras of a capture tell of the scene without images: their extent, the spread of their directions, what
//! they look at, and its distance.

use super::Camera;
use super::pose::{self, Pose, Vec3};

/// Least start of a ray, as a fraction of the way from the nearest camera to what it looks at. 0 would be the lens.
const LEAST_NEAR: f64 = 0.2;
/// Number of radii behind what is looked at where rays end, so that a background is included.
const BEHIND: f64 = 3.0;
/// Fraction of the cameras that must have the common point in front of them and within their image.
const MOST: f64 = 0.5;

/// The cameras of a capture, taken together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rig {
    /// Lower and upper corner of the box around the cameras.
    pub extent: [Vec3; 2],
    /// The largest angle between a viewing direction and their mean, in degrees. `None` if they cancel out.
    pub spread: Option<f64>,
    /// What most of them look at. `None` if their axes meet nowhere, or not in front of them.
    pub subject: Option<Subject>,
}

/// The part of space that most cameras look at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Subject {
    /// The point with the least mean squared distance to all viewing axes.
    pub focus: Vec3,
    /// Radius around it that the longer side of an image covers, as a median over the cameras. All cameras see what is
    /// within.
    pub radius: f64,
    /// The least, the median and the largest depth of that point over the cameras that have it in front of them.
    pub depths: [f64; 3],
}

impl Rig {
    /// Creates the rig of at least one camera.
    pub fn of(cameras: &[Camera]) -> Rig {
        let origins = || cameras.iter().map(|camera| pose::column(&camera.pose, 3));
        let corner = |pick: fn(f64, f64) -> f64, start: f64| {
            origins().fold([start; 3], |found, origin| std::array::from_fn(|axis| pick(found[axis], origin[axis])))
        };
        let backs = || cameras.iter().map(|camera| pose::column(&camera.pose, 2));
        let spread = pose::normalized(pose::mean(backs())).map(|mean| {
            let angle = |back: Vec3| pose::dot(back, mean).clamp(-1.0, 1.0).acos().to_degrees();
            backs().map(angle).fold(0.0, f64::max)
        });
        let extent = [corner(f64::min, f64::INFINITY), corner(f64::max, f64::NEG_INFINITY)];
        Rig { extent, spread, subject: Subject::of(cameras) }
    }
}

impl Subject {
    fn of(cameras: &[Camera]) -> Option<Subject> {
        let poses: Vec<Pose> = cameras.iter().map(|camera| camera.pose).collect();
        let focus = pose::focus_point(&poses)?;
        let mut depths: Vec<f64> = Vec::new();
        let mut radii: Vec<f64> = Vec::new();
        for camera in cameras {
            let Some(depth) = seen_depth(camera, focus) else { continue };
            let side = (camera.width as f64 / camera.focal[0]).max(camera.height as f64 / camera.focal[1]);
            depths.push(depth);
            // The sphere that touches the planes of those two sides of the frustum.
            radii.push(depth * (0.5 * side).atan().sin());
        }
        depths.sort_by(f64::total_cmp);
        radii.sort_by(f64::total_cmp);
        let enough = depths.len() >= 2 && depths.len() as f64 >= MOST * cameras.len() as f64;
        let middle = depths.len() / 2;
        let subject =
            || Subject { focus, radius: radii[middle], depths: [depths[0], depths[middle], depths[depths.len() - 1]] };
        enough.then(subject).filter(|subject| subject.radius.is_finite() && subject.radius > 0.0)
    }

    /// Returns the cube around what is looked at.
    pub fn domain(&self) -> [Vec3; 2] {
        [self.focus.map(|x| x - self.radius), self.focus.map(|x| x + self.radius)]
    }

    /// Returns the ends of a ray: half way from the nearest camera to what is looked at, and some way behind that for
    /// the farthest.
    pub fn bounds(&self) -> (f64, f64) {
        let [least, _, largest] = self.depths;
        let near = (0.5 * (least - self.radius)).max(LEAST_NEAR * least);
        (near, largest + BEHIND * self.radius)
    }

    /// Returns the ends of rays that hold what is looked at and nothing else: a radius before it for the nearest camera, a
    /// radius behind it for the farthest.
    pub fn extent(&self) -> (f64, f64) {
        let [least, _, largest] = self.depths;
        ((least - self.radius).max(LEAST_NEAR * least), largest + self.radius)
    }

    /// Describes how these ends were found.
    pub fn extent_words(&self) -> String {
        self.words("from a radius before it to a radius behind it, since the views show one object on one colour")
    }

    /// Describes how the ends of [`Subject::bounds`] were found.
    pub fn bounds_words(&self) -> String {
        self.words(&format!("half way to it from the nearest one, {BEHIND} radii behind it for the farthest"))
    }

    fn words(&self, ends: &str) -> String {
        let ([least, _, largest], radius) = (self.depths, self.radius);
        format!(
            "the cameras, which are {least:.3} to {largest:.3} away from what they look at (radius {radius:.3}): {ends}"
        )
    }
}

/// Returns the depth of a point that a camera has within its image, or `None`.
fn seen_depth(camera: &Camera, point: Vec3) -> Option<f64> {
    let [x, y, back] = pose::transform(&pose::inverse_rigid(&camera.pose), point);
    let depth = -back;
    let column = camera.focal[0] * x / depth + camera.centre[0];
    let row = -camera.focal[1] * y / depth + camera.centre[1];
    let inside = (0.0..=camera.width as f64).contains(&column) && (0.0..=camera.height as f64).contains(&row);
    (depth > 0.0 && depth.is_finite() && inside).then_some(depth)
}

/// Interpolates linearly between order statistics of at least one number, as NumPy's default.
pub(super) fn percentile(sorted: &[f64], share: f64) -> f64 {
    let at = share * (sorted.len() - 1) as f64;
    let (low, high) = (sorted[at.floor() as usize], sorted[at.ceil() as usize]);
    low + (high - low) * at.fract()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(origin: Vec3, target: Vec3) -> Camera {
        let pose = pose::look_along(pose::sub(origin, target), [0.0, 0.1, 1.0], origin).unwrap();
        Camera { width: 60, height: 80, focal: [100.0; 2], centre: [30.0, 40.0], pose }
    }

    fn ring(target: Vec3) -> Vec<Camera> {
        let place = |i: usize| {
            let (sin, cos) = (i as f64 * 0.7).sin_cos();
            [target[0] + 4.0 * cos, target[1] + 4.0 * sin, target[2] + 0.5 * (i % 3) as f64]
        };
        (0..9).map(|i| camera(place(i), target)).collect()
    }

    #[test]
    fn what_a_ring_of_cameras_looks_at_is_found_and_seen_by_all() {
        let target = [0.5, -1.0, 2.0];
        let cameras = ring(target);
        let rig = Rig::of(&cameras);
        let subject = rig.subject.unwrap();
        assert!(pose::length(pose::sub(subject.focus, target)) < 1e-9);
        assert!(rig.spread.is_none_or(|spread| spread > 80.0));
        // The longer side alone: no point of the sphere leaves a picture over its top or bottom.
        for camera in &cameras {
            let up = pose::column(&camera.pose, 1);
            let depth = seen_depth(camera, target).unwrap();
            assert!(subject.depths[0] <= depth + 1e-9 && depth <= subject.depths[2] + 1e-9);
            let top = pose::add_scaled(target, 0.95 * subject.radius, up);
            assert!(seen_depth(camera, top).is_some());
        }
        let (near, far) = subject.bounds();
        assert!(0.0 < near && near < subject.depths[0] - subject.radius && far > subject.depths[2] + subject.radius);
        let [low, high] = subject.domain();
        assert!((0..3).all(|axis| low[axis] < target[axis] && target[axis] < high[axis]));
    }

    #[test]
    fn bounds_follow_the_capture_s_units() {
        let cameras = ring([0.0; 3]);
        let scaled: Vec<Camera> = cameras
            .iter()
            .map(|camera| Camera { pose: camera.pose.map(|[a, b, c, t]| [a, b, c, 7.0 * t]), ..*camera })
            .collect();
        let bounds = |cameras: &[Camera]| Rig::of(cameras).subject.unwrap().bounds();
        let ((near, far), (near7, far7)) = (bounds(&cameras), bounds(&scaled));
        assert!((near7 - 7.0 * near).abs() < 1e-9 && (far7 - 7.0 * far).abs() < 1e-9);
    }

    #[test]
    fn cameras_that_look_outwards_or_side_by_side_look_at_nothing_in_common() {
        let outward: Vec<Camera> = ring([0.0; 3])
            .iter()
            .map(|c| camera(pose::column(&c.pose, 3), pose::column(&c.pose, 3).map(|v| 2.0 * v)))
            .collect();
        assert_eq!(Rig::of(&outward).subject, None);
        let row: Vec<Camera> = (0..5).map(|i| camera([i as f64, 0.0, 0.0], [i as f64, 3.0, 0.0])).collect();
        let rig = Rig::of(&row);
        assert_eq!((rig.subject, rig.extent), (None, [[0.0; 3], [4.0, 0.0, 0.0]]));
        assert!(rig.spread.unwrap() < 1e-6);
    }
}
