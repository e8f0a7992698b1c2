//! Images of meshes: triangles in a depth buffer, lit with smooth normals.

use augnerf_base::Image;
use augnerf_scenes::Camera;
use augnerf_scenes::vector::{Vec3, add, cross, dot, length, mix, scale, sub, unit};

use super::Mesh;

/// Samples along each side of a pixel, which are averaged.
const SAMPLES: usize = 2;
/// Everything nearer to the camera than this fraction of the mesh's distance is clipped.
const NEAR: f64 = 1e-4;
/// The value of an image without a mesh.
const PAPER: f32 = 1.0;
/// The colour of a mesh without colours, or whose colours are ignored.
const CLAY: Vec3 = [0.80, 0.80, 0.78];
/// Ambient light, light from above the camera's left shoulder, and light from the camera.
const LIGHTS: [f64; 3] = [0.22, 0.62, 0.20];
/// Direction of the second light, seen from the surface, in the camera's axes (right, up, backward).
const KEY: Vec3 = [-0.45, 0.65, 0.61];
/// Cosine above which a triangle is lit with the smooth normals of its corners: 50 degrees.
const CREASE: f64 = 0.643;
/// Fraction of light on the inner side of a surface.
const INSIDE: f64 = 0.45;

/// The colours of a rendered mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Paint {
    /// One grey, to show the shape.
    #[default]
    Clay,
    /// The colours of its vertices, under the same light.
    Colours,
}

/// A vertex in the camera's axes.
#[derive(Clone, Copy)]
struct Seen {
    /// Right, up, backward.
    place: Vec3,
    normal: Vec3,
    colour: Vec3,
}

impl Seen {
    fn mix(a: &Seen, b: &Seen, s: f64) -> Seen {
        Seen { place: mix(a.place, b.place, s), normal: mix(a.normal, b.normal, s), colour: mix(a.colour, b.colour, s) }
    }
}

/// Renders a mesh from a camera, lit, on white. Normals are the area-weighted means of the triangles around each
/// vertex. A mesh may also carry normals of a density's gradient, but these are noise where density is rough. The inner
/// side of an open surface is darker.
pub fn shade(mesh: &Mesh, camera: &Camera, paint: Paint) -> Image {
    let fine = resized(camera, camera.width * SAMPLES, camera.height * SAMPLES);
    let seen = seen(mesh, &fine, paint);
    let mut target = Target::new(&fine);
    let farthest = seen.iter().map(|vertex| -vertex.place[2]).fold(0.0, f64::max);
    for triangle in &mesh.triangles {
        let corners = creased(triangle.map(|index| seen[index as usize]));
        let polygon = in_front(&corners, NEAR * farthest);
        for i in 2..polygon.len() {
            target.draw([&polygon[0], &polygon[i - 1], &polygon[i]]);
        }
    }
    target.averaged()
}

/// Returns the camera with another number of pixels.
pub fn resized(camera: &Camera, width: usize, height: usize) -> Camera {
    let (x, y) = (width as f64 / camera.width as f64, height as f64 / camera.height as f64);
    let both = |pair: [f64; 2]| [pair[0] * x, pair[1] * y];
    Camera { width, height, focal: both(camera.focal), centre: both(camera.centre), pose: camera.pose }
}

/// Returns a camera on a circle around a mesh, 25 degrees above it, at a fraction `share` of the circle from the x
/// axis. z is up.
pub fn around(mesh: &Mesh, share: f64, width: usize) -> Camera {
    let corner = |start: f64, pick: fn(f64, f64) -> f64| -> Vec3 {
        std::array::from_fn(|axis| mesh.vertices.iter().map(|v| f64::from(v[axis])).fold(start, pick))
    };
    let (low, high) = (corner(f64::INFINITY, f64::min), corner(f64::NEG_INFINITY, f64::max));
    let (centre, radius) = (mix(low, high, 0.5), 0.5 * length(sub(high, low)));
    let (round, down, half_view) = (std::f64::consts::TAU * share, 25f64.to_radians(), 20f64.to_radians());
    let back = [round.cos() * down.cos(), round.sin() * down.cos(), down.sin()];
    let right = [-round.sin(), round.cos(), 0.0];
    let up = cross(back, right);
    let eye = add(centre, scale(back, radius.max(f64::MIN_POSITIVE) / half_view.sin()));
    let focal = 0.5 * width as f64 / half_view.tan();
    Camera {
        width,
        height: width,
        focal: [focal; 2],
        centre: [0.5 * width as f64; 2],
        pose: std::array::from_fn(|axis| [right[axis], up[axis], back[axis], eye[axis]]),
    }
}

fn seen(mesh: &Mesh, camera: &Camera, paint: Paint) -> Vec<Seen> {
    let axis = |column: usize| -> Vec3 { std::array::from_fn(|row| camera.pose[row][column]) };
    let axes = [axis(0), axis(1), axis(2)];
    let eye = axis(3);
    let turned = |v: Vec3| -> Vec3 { axes.map(|axis| dot(axis, v)) };
    let normals = mesh.face_normals();
    let painted = paint == Paint::Colours && mesh.colours.len() == mesh.vertices.len();
    let vertex = |index: usize| {
        let normal = normals[index];
        Seen {
            place: turned(sub(mesh.vertex(index as u32), eye)),
            normal: if length(normal) > 0.0 { turned(unit(normal)) } else { [0.0, 0.0, 1.0] },
            colour: if painted { mesh.colours[index].map(|v| f64::from(v) / 255.0) } else { CLAY },
        }
    };
    (0..mesh.vertices.len()).map(vertex).collect()
}

/// Gives a triangle's corners its own normal where theirs differ too much: at an edge of a solid.
fn creased(mut corners: [Seen; 3]) -> [Seen; 3] {
    let [a, b, c] = corners.map(|vertex| vertex.place);
    let own = cross(sub(b, a), sub(c, a));
    if length(own) > 0.0 {
        let own = unit(own);
        let leans = |vertex: &&mut Seen| dot(vertex.normal, own) < CREASE;
        corners.iter_mut().filter(leans).for_each(|vertex| vertex.normal = own);
    }
    corners
}

/// Returns the part of a triangle in front of a plane near the camera: nothing, or three or four corners.
fn in_front(corners: &[Seen; 3], near: f64) -> Vec<Seen> {
    let depth = |vertex: &Seen| -vertex.place[2] - near;
    let mut kept = Vec::with_capacity(4);
    for (i, a) in corners.iter().enumerate() {
        let b = &corners[(i + 1) % 3];
        let (from, to) = (depth(a), depth(b));
        if from > 0.0 {
            kept.push(*a);
        }
        if (from > 0.0) != (to > 0.0) {
            kept.push(Seen::mix(a, b, from / (from - to)));
        }
    }
    kept
}

/// The image in progress.
struct Target {
    camera: Camera,
    /// 1 / depth of the nearest surface; 0 without one.
    nearness: Vec<f64>,
    colours: Vec<[f32; 3]>,
}

impl Target {
    fn new(camera: &Camera) -> Target {
        let pixels = camera.width * camera.height;
        Target { camera: *camera, nearness: vec![0.0; pixels], colours: vec![[PAPER; 3]; pixels] }
    }

    /// Draws a triangle in front of the camera. Attributes are linear in space, so that they are weighted by 1 / depth
    /// in the image.
    fn draw(&mut self, corners: [&Seen; 3]) {
        let Camera { width, height, focal, centre, .. } = self.camera;
        let nearness = corners.map(|vertex| -1.0 / vertex.place[2]);
        let at: [[f64; 2]; 3] = std::array::from_fn(|i| {
            let [x, y, _] = corners[i].place;
            [centre[0] + focal[0] * x * nearness[i], centre[1] - focal[1] * y * nearness[i]]
        });
        let edge =
            |a: [f64; 2], b: [f64; 2], p: [f64; 2]| (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]);
        let area = edge(at[0], at[1], at[2]);
        if area == 0.0 || !area.is_finite() {
            return;
        }
        let span = |axis: usize, size: usize| {
            let low = at.iter().map(|p| p[axis]).fold(f64::INFINITY, f64::min);
            let high = at.iter().map(|p| p[axis]).fold(f64::NEG_INFINITY, f64::max);
            // Samples are at the centre of their squares.
            ((low - 0.5).ceil().max(0.0) as usize, (high + 0.5).floor().clamp(0.0, size as f64) as usize)
        };
        let ((left, right), (top, bottom)) = (span(0, width), span(1, height));
        for y in top..bottom {
            for x in left..right {
                let p = [x as f64 + 0.5, y as f64 + 0.5];
                let shares = [edge(at[1], at[2], p), edge(at[2], at[0], p), edge(at[0], at[1], p)].map(|e| e / area);
                if shares.iter().any(|&share| share < 0.0) {
                    continue;
                }
                let weights: [f64; 3] = std::array::from_fn(|i| shares[i] * nearness[i]);
                let near = weights.iter().sum::<f64>();
                let pixel = y * width + x;
                if near > self.nearness[pixel] {
                    self.nearness[pixel] = near;
                    self.colours[pixel] = lit(corners, weights.map(|weight| weight / near));
                }
            }
        }
    }

    /// Returns the image, each pixel the mean of its samples.
    fn averaged(&self) -> Image {
        let (width, height) = (self.camera.width / SAMPLES, self.camera.height / SAMPLES);
        let mut pixels = vec![0.0; width * height * 3];
        for (index, colour) in self.colours.iter().enumerate() {
            let (x, y) = (index % self.camera.width / SAMPLES, index / self.camera.width / SAMPLES);
            for (channel, value) in colour.iter().enumerate() {
                pixels[(y * width + x) * 3 + channel] += value / (SAMPLES * SAMPLES) as f32;
            }
        }
        Image { width, height, channels: 3, pixels }
    }
}

/// Returns the colour of a point of a triangle.
fn lit(corners: [&Seen; 3], weights: [f64; 3]) -> [f32; 3] {
    let blend = |pick: fn(&Seen) -> Vec3| (0..3).fold([0.0; 3], |sum, i| add(sum, scale(pick(corners[i]), weights[i])));
    let (normal, place, colour) = (blend(|v| v.normal), blend(|v| v.place), blend(|v| v.colour));
    if length(normal) == 0.0 || length(place) == 0.0 {
        return colour.map(|v| v as f32);
    }
    let to_eye = unit(scale(place, -1.0));
    let [a, b, c] = corners.map(|vertex| vertex.place);
    // The triangle itself tells which side is visible: a smooth normal may lean over the edge.
    let outside = dot(cross(sub(b, a), sub(c, a)), to_eye) >= 0.0;
    let normal = scale(unit(normal), if outside { 1.0 } else { -1.0 });
    let [everywhere, key, camera] = LIGHTS;
    let light = everywhere + key * dot(normal, unit(KEY)).max(0.0) + camera * dot(normal, to_eye).max(0.0);
    let light = light * if outside { 1.0 } else { INSIDE };
    colour.map(|v| (v * light).clamp(0.0, 1.0) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sphere of triangles around `at`.
    fn sphere(at: Vec3, radius: f64, colour: [u8; 3]) -> Mesh {
        let (rings, sides) = (32u32, 64u32);
        let point = |ring: u32, side: u32| {
            let (down, round) = (
                std::f64::consts::PI * f64::from(ring) / f64::from(rings),
                std::f64::consts::TAU * f64::from(side % sides) / f64::from(sides),
            );
            add(at, scale([down.sin() * round.cos(), down.sin() * round.sin(), down.cos()], radius)).map(|v| v as f32)
        };
        let vertices: Vec<[f32; 3]> =
            (0..=rings).flat_map(|ring| (0..sides).map(move |side| (ring, side))).map(|(r, s)| point(r, s)).collect();
        let index = |ring: u32, side: u32| ring * sides + side % sides;
        let quads = (0..rings).flat_map(|ring| (0..sides).map(move |side| (ring, side)));
        let triangles = quads.flat_map(|(r, s)| {
            [[index(r, s), index(r + 1, s), index(r + 1, s + 1)], [index(r, s), index(r + 1, s + 1), index(r, s + 1)]]
        });
        Mesh { colours: vec![colour; vertices.len()], triangles: triangles.collect(), vertices, ..Mesh::default() }
    }

    /// Looks down the z axis from `height`.
    fn above(height: f64) -> Camera {
        let pose = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, height]];
        Camera { width: 80, height: 60, focal: [100.0; 2], centre: [40.0, 30.0], pose }
    }

    fn covered(image: &Image) -> usize {
        image.pixels.chunks(3).filter(|pixel| pixel.iter().any(|&v| v < 0.99)).count()
    }

    #[test]
    fn a_sphere_covers_its_cone_and_is_bright_where_the_light_is() {
        let image = shade(&sphere([0.0; 3], 1.0, [0; 3]), &above(5.0), Paint::Clay);
        // Its outline is the circle of the tangents: sin = r / d.
        let radius = 100.0 * (1.0f64 / 5.0).asin().tan();
        let share = covered(&image) as f64 / (std::f64::consts::PI * radius * radius);
        assert!((0.93..1.1).contains(&share), "{share}");
        let at = |x: usize, y: usize| image.pixels[(y * 80 + x) * 3];
        assert!(at(32, 20) > at(40, 30) && at(40, 30) > at(52, 42), "{} {} {}", at(32, 20), at(40, 30), at(52, 42));
        // The four pixels around the middle face the camera, on average: ambient, the key light at its angle and the
        // camera's light, on clay.
        let light = LIGHTS[0] + LIGHTS[1] * unit(KEY)[2] + LIGHTS[2];
        let middle = f64::from(at(39, 29) + at(40, 29) + at(39, 30) + at(40, 30)) / 4.0;
        assert!((middle - light * CLAY[0]).abs() < 0.01, "{middle}");
    }

    #[test]
    fn what_is_nearer_hides_what_is_farther_whatever_is_drawn_first() {
        let (red, blue) = (sphere([0.0, 0.0, 1.5], 0.5, [255, 0, 0]), sphere([0.0; 3], 1.0, [0, 0, 255]));
        let joined = |a: &Mesh, b: &Mesh| {
            let shifted = b.triangles.iter().map(|t| t.map(|i| i + a.vertices.len() as u32));
            Mesh {
                vertices: [a.vertices.clone(), b.vertices.clone()].concat(),
                colours: [a.colours.clone(), b.colours.clone()].concat(),
                triangles: a.triangles.iter().copied().chain(shifted).collect(),
                ..Mesh::default()
            }
        };
        let first = shade(&joined(&red, &blue), &above(5.0), Paint::Colours);
        assert_eq!(first, shade(&joined(&blue, &red), &above(5.0), Paint::Colours));
        let middle = &first.pixels[(30 * 80 + 40) * 3..][..3];
        assert!(middle[0] > 0.5 && middle[2] == 0.0, "{middle:?}");
    }

    #[test]
    fn normals_that_a_mesh_carries_are_not_asked() {
        let plain = sphere([0.0; 3], 1.0, [0; 3]);
        let noise = (0..plain.vertices.len()).map(|i| if i % 2 == 0 { [0.0, 0.0, -1.0] } else { [1.0, 0.0, 0.0] });
        let noisy = Mesh { normals: noise.collect(), ..plain.clone() };
        assert_eq!(shade(&noisy, &above(5.0), Paint::Clay), shade(&plain, &above(5.0), Paint::Clay));
    }

    #[test]
    fn the_inside_is_darker_and_a_camera_within_draws_what_is_before_it() {
        let mut turned = sphere([0.0; 3], 1.0, [0; 3]);
        let outside = shade(&turned, &above(5.0), Paint::Clay);
        turned.flip();
        let inside = shade(&turned, &above(5.0), Paint::Clay);
        assert!((inside.pixels[(30 * 80 + 40) * 3] / outside.pixels[(30 * 80 + 40) * 3] - INSIDE as f32).abs() < 0.02);
        let within = shade(&sphere([0.0; 3], 1.0, [0; 3]), &above(0.2), Paint::Clay);
        assert_eq!(covered(&within), 80 * 60);
    }

    #[test]
    fn a_turntable_holds_the_whole_mesh() {
        let mesh = sphere([3.0, -2.0, 1.0], 0.5, [0; 3]);
        for share in [0.0, 0.3, 0.8] {
            let image = shade(&mesh, &around(&mesh, share, 64), Paint::Clay);
            let edge = |i: usize| image.pixels[i * 3] == 1.0 && image.pixels[i * 64 * 3] == 1.0;
            assert!((0..64).all(edge) && covered(&image) > 400, "{share}: {}", covered(&image));
        }
    }
}
