//! The drawing of `data check --picture`: cameras, points, ends of rays and the box, from above and from the side.

use crate::base::Result;
use crate::base::rng::{Random, Stream};
use crate::data::pose::{self, Vec3};
use crate::data::{Camera, Scene, UnseenCameras, View};
use crate::draw::canvas::{Anchor, BLACK, BLUE, Canvas, Colour, Figure, GREY, ORANGE, PAGE, PALETTE, SIDE, TEXT};
use crate::settings::Resolved;

/// Side of a panel.
const PANEL: f64 = (PAGE - 2.0 * SIDE - GAP) / 2.0;
const GAP: f64 = 24.0;
/// Limit on drawn points; more points are thinned evenly.
const MOST_POINTS: usize = 6000;
/// Length of a drawn frustum, as a fraction of the panel.
const FRUSTUM: f64 = 0.05;
/// Rays longer than this multiple of the extent of everything else are cut off.
const FAR_SHARE: f64 = 1.5;
/// Quantiles of the points that decide the extent.
const SHOWN: [f64; 2] = [0.02, 0.98];
const GREEN: Colour = PALETTE[1];
const PURPLE: Colour = PALETTE[5];
/// Number of cameras of unseen rays that are drawn.
const UNSEEN: usize = 24;

/// One of two parallel views: its directions to the right and up.
struct Panel {
    name: &'static str,
    left: f64,
    top: f64,
    axes: [Vec3; 2],
    /// Its centre, and half of its side in scene units.
    middle: Vec3,
    half: f64,
}

/// Draws the scene's cameras (training blue, held out orange, some of unseen rays purple if a term reads such), points
/// (grey), box (green) and rays from near to far, from two sides.
///
/// # Errors
/// The training cameras do not suit `regularizer.unseen_poses`.
pub fn scene_picture(config: &Resolved, scene: &Scene) -> Result<Figure> {
    let unseen = unseen_cameras(config, scene)?;
    let title = format!("{}: {} views to train on, {} held out", scene.name, scene.train.len(), scene.test.len());
    let mut canvas = Canvas::titled(&title);
    let top = canvas.height + 20.0;
    let [right, forward, up] = axes(scene);
    let (middle, half, is_cut) = shown(scene);
    let views = [
        ("from above (up: where cameras look)", [right, forward]),
        ("from the side (right: where cameras look)", [forward, up]),
    ];
    for (place, (name, axes)) in views.into_iter().enumerate() {
        let left = SIDE + place as f64 * (PANEL + GAP);
        Panel { name, left, top, axes, middle, half }.draw(&mut canvas, scene, &unseen);
    }
    canvas.height = top + PANEL + 6.0;
    canvas.caption(&caption(scene, &unseen, half, is_cut));
    Ok(canvas.finish())
}

/// Returns some cameras of a run's unseen rays, or none if it reads none.
fn unseen_cameras(config: &Resolved, scene: &Scene) -> Result<Vec<Camera>> {
    if !config.regularizer.reads_unseen_cameras() {
        return Ok(Vec::new());
    }
    let cameras: Vec<Camera> = scene.train.iter().map(|view| view.camera).collect();
    let unseen = UnseenCameras::of(&cameras, config.unseen_poses)?;
    let mut random = Random::new(config.seed, Stream::Unseen, 0);
    Ok((0..UNSEEN).map(|_| unseen.draw(&mut random)).collect())
}

/// Returns right, forward and up of the capture, from all its cameras.
fn axes(scene: &Scene) -> [Vec3; 3] {
    let cameras = || views(scene).map(|view| view.camera.pose);
    let up = pose::normalized(pose::mean(cameras().map(|pose| pose::column(&pose, 1)))).unwrap_or([0.0, 0.0, 1.0]);
    let level = |direction: Vec3| pose::normalized(pose::add_scaled(direction, -pose::dot(direction, up), up));
    let ahead = level(pose::mean(cameras().map(|pose| pose::column(&pose, 2).map(|v| -v))));
    let any = || level([0.0, 1.0, 0.0]).or_else(|| level([1.0, 0.0, 0.0])).expect("one of two axes is not up");
    let forward = ahead.unwrap_or_else(any);
    [pose::cross(forward, up), forward, up]
}

fn views(scene: &Scene) -> impl Iterator<Item = &View> {
    scene.train.iter().chain(&scene.test)
}

/// Returns the ends of a ray in scene units. NDC's near plane is 1 in front of the origin, its far plane at infinity.
fn ends(scene: &Scene, camera: &Camera) -> (f64, f64) {
    match scene.ndc {
        None => (scene.near, scene.far),
        Some(_) => (1.0 + camera.pose[2][3], f64::INFINITY),
    }
}

/// Returns a camera's location and viewing direction.
fn axis(camera: &Camera) -> (Vec3, Vec3) {
    (pose::column(&camera.pose, 3), pose::column(&camera.pose, 2).map(|v| -v))
}

/// Returns the centre of the drawing, half of its side, and whether rays end outside.
fn shown(scene: &Scene) -> (Vec3, f64, bool) {
    let mut places: Vec<Vec3> = views(scene).map(|view| axis(&view.camera).0).collect();
    places.extend(scene.space.domain.iter().flatten());
    let (low, high) = corners(&places);
    let (point_low, point_high) = point_corners(scene).unwrap_or((low, high));
    places.extend([point_low, point_high]);
    for view in views(scene) {
        let (origin, ahead) = axis(&view.camera);
        let (near, _) = ends(scene, &view.camera);
        places.push(pose::add_scaled(origin, near, ahead));
    }
    let size = |places: &[Vec3]| {
        let (low, high) = corners(places);
        (0..3).map(|axis| high[axis] - low[axis]).fold(1e-9, f64::max)
    };
    let all: Vec<Vec3> = views(scene)
        .map(|view| {
            let ((origin, ahead), (_, far)) = (axis(&view.camera), ends(scene, &view.camera));
            pose::add_scaled(origin, far.min(1e12), ahead)
        })
        .chain(places.iter().copied())
        .collect();
    let is_cut = size(&all) > FAR_SHARE * size(&places);
    let kept = if is_cut { &places } else { &all };
    let (low, high) = corners(kept);
    let middle = std::array::from_fn(|axis| 0.5 * (low[axis] + high[axis]));
    // The extent along any axis, with a margin.
    let reach = kept.iter().map(|place| pose::length(pose::sub(*place, middle))).fold(1e-9, f64::max);
    (middle, 1.05 * reach, is_cut)
}

fn corners(places: &[Vec3]) -> (Vec3, Vec3) {
    let fold = |pick: fn(f64, f64) -> f64, start: f64| {
        places.iter().fold([start; 3], |found, place| std::array::from_fn(|axis| pick(found[axis], place[axis])))
    };
    (fold(f64::min, f64::INFINITY), fold(f64::max, f64::NEG_INFINITY))
}

/// Returns the box of most points, or `None` without points.
fn point_corners(scene: &Scene) -> Option<(Vec3, Vec3)> {
    let points = &scene.space.points;
    let last = points.len().checked_sub(1)?;
    let mut found = [[0.0; 3]; 2];
    for axis in 0..3 {
        let mut values: Vec<f32> = points.iter().map(|point| point[axis]).collect();
        values.sort_by(f32::total_cmp);
        for (corner, share) in found.iter_mut().zip(SHOWN) {
            corner[axis] = f64::from(values[(share * last as f64).round() as usize]);
        }
    }
    Some((found[0], found[1]))
}

fn caption(scene: &Scene, unseen: &[Camera], half: f64, is_cut: bool) -> String {
    let mut text = String::from("Blue: cameras that are trained on; orange: held out. ");
    if !unseen.is_empty() {
        text += &format!("Purple: {} cameras of unseen rays; each step draws others. ", unseen.len());
    }
    if !scene.space.points.is_empty() {
        text += &format!("Grey: {} points of the capture. ", scene.space.points.len());
    }
    if scene.space.domain.is_some() {
        text += "Green: the box that most cameras look at. ";
    }
    text += &match scene.ndc {
        None => format!(
            "Thin lines: rays of the pictures' middles from near, {:.3}, to far, {:.3}. ",
            scene.near, scene.far
        ),
        Some(_) => "Thin lines: rays of the pictures' middles from NDC's near plane on, without end. ".into(),
    };
    if is_cut && scene.ndc.is_none() {
        text += "They end outside. ";
    }
    text + &format!("A panel is {:.3} scene units wide.", 2.0 * half)
}

impl Panel {
    fn draw(&self, canvas: &mut Canvas, scene: &Scene, unseen: &[Camera]) {
        canvas.text((self.left, self.top - 12.0), self.name, TEXT, Anchor::Left, BLACK);
        let every = scene.space.points.len().div_ceil(MOST_POINTS).max(1);
        for point in scene.space.points.iter().step_by(every) {
            let at = self.at(point.map(f64::from));
            if self.holds(at) {
                canvas.dot(at, 1.0, GREY, 0.4);
            }
        }
        for camera in unseen {
            self.draw_camera(canvas, scene, camera, PURPLE);
        }
        for (views, colour) in [(&scene.train, BLUE), (&scene.test, ORANGE)] {
            for view in views {
                self.draw_camera(canvas, scene, &view.camera, colour);
            }
        }
        if let Some(domain) = scene.space.domain {
            self.draw_box(canvas, domain);
        }
        canvas.outline((self.left, self.top), (PANEL, PANEL), GREY, 1.0);
    }

    fn draw_camera(&self, canvas: &mut Canvas, scene: &Scene, camera: &Camera, colour: Colour) {
        let (origin, ahead) = axis(camera);
        let (near, far) = ends(scene, camera);
        let [near, far] = [near, far.min(1e3 * self.half)].map(|t| pose::add_scaled(origin, t, ahead));
        self.line(canvas, near, far, colour, 0.3);
        let depth = 2.0 * FRUSTUM * self.half;
        let (w, h) = (camera.width as f64, camera.height as f64);
        let corner = |(x, y): (f64, f64)| {
            let (origin, direction) = camera.ray(x, y);
            pose::add_scaled(origin, depth, direction)
        };
        let corners = [(0.0, 0.0), (w, 0.0), (w, h), (0.0, h)].map(corner);
        for (i, end) in corners.iter().enumerate() {
            self.line(canvas, origin, *end, colour, 0.8);
            self.line(canvas, *end, corners[(i + 1) % 4], colour, 0.8);
        }
    }

    fn draw_box(&self, canvas: &mut Canvas, [low, high]: [Vec3; 2]) {
        let corner =
            |i: usize| -> Vec3 { std::array::from_fn(|axis| if i >> axis & 1 == 0 { low[axis] } else { high[axis] }) };
        for i in 0..8 {
            for axis in (0..3).filter(|axis| i >> axis & 1 == 0) {
                self.line(canvas, corner(i), corner(i | 1 << axis), GREEN, 1.5);
            }
        }
    }

    /// Returns the position of a point in the drawing.
    fn at(&self, point: Vec3) -> (f64, f64) {
        let offset = pose::sub(point, self.middle);
        let [x, y] = self.axes.map(|axis| pose::dot(offset, axis) / self.half);
        (self.left + 0.5 * PANEL * (1.0 + x), self.top + 0.5 * PANEL * (1.0 - y))
    }

    fn holds(&self, (x, y): (f64, f64)) -> bool {
        (self.left..=self.left + PANEL).contains(&x) && (self.top..=self.top + PANEL).contains(&y)
    }

    /// Draws the part of a line that is inside the panel.
    fn line(&self, canvas: &mut Canvas, from: Vec3, to: Vec3, colour: Colour, width: f64) {
        let ((x0, y0), (x1, y1)) = (self.at(from), self.at(to));
        // Fractions of the line at which it enters and leaves the panel, by Liang-Barsky clipping.
        let (mut enters, mut leaves) = (0.0f64, 1.0f64);
        for (start, step, low) in [(x0, x1 - x0, self.left), (y0, y1 - y0, self.top)] {
            if step == 0.0 {
                if !(low..=low + PANEL).contains(&start) {
                    return;
                }
                continue;
            }
            let [a, b] = [low, low + PANEL].map(|side| (side - start) / step);
            (enters, leaves) = (enters.max(a.min(b)), leaves.min(a.max(b)));
        }
        if enters <= leaves {
            let at = |share: f64| (x0 + share * (x1 - x0), y0 + share * (y1 - y0));
            canvas.line(&[at(enters), at(leaves)], colour, width);
        }
    }
}
