//! Solids with exact ray intersections and exact signed distances.

use super::material::Material;
use crate::vector::{Vec3, add, along, axes_along, dot, length, scale, sub, unit};

/// A solid around its own origin, with lengths in scene units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// A ball.
    Sphere {
        /// Its radius.
        radius: f64,
    },
    /// A box along the local axes.
    Cuboid {
        /// Half its edges.
        half: Vec3,
    },
    /// A capped cylinder, cone or truncated cone around the local z axis.
    Frustum {
        /// Radius at `-half_height`.
        bottom: f64,
        /// Radius at `+half_height`; 0 for a cone.
        top: f64,
        /// Half its extent along z.
        half_height: f64,
    },
    /// A ring in the local xy plane.
    Torus {
        /// Radius of the circle through the tube's middle.
        major: f64,
        /// Radius of the tube, less than `major`.
        minor: f64,
    },
}

impl Shape {
    /// Returns the radius of the ball around the local origin that holds the solid.
    pub fn bound(&self) -> f64 {
        match *self {
            Shape::Sphere { radius } => radius,
            Shape::Cuboid { half } => length(half),
            Shape::Frustum { bottom, top, half_height } => bottom.max(top).hypot(half_height),
            Shape::Torus { major, minor } => major + minor,
        }
    }

    /// Returns the Euclidean distance of a local point to the surface, negative inside.
    pub fn distance(&self, p: Vec3) -> f64 {
        match *self {
            Shape::Sphere { radius } => length(p) - radius,
            Shape::Cuboid { half } => {
                let q: Vec3 = std::array::from_fn(|i| p[i].abs() - half[i]);
                length(q.map(|v| v.max(0.0))) + q[0].max(q[1]).max(q[2]).min(0.0)
            }
            Shape::Frustum { bottom, top, half_height } => frustum_distance(p, bottom, top, half_height),
            Shape::Torus { major, minor } => (p[0].hypot(p[1]) - major).hypot(p[2]) - minor,
        }
    }

    /// Returns the least `t > after` at which a local ray crosses the surface. `direction` may have any length.
    pub fn first_crossing(&self, origin: Vec3, direction: Vec3, after: f64) -> Option<f64> {
        match *self {
            Shape::Sphere { radius } => sphere_crossing(origin, direction, radius, after),
            Shape::Cuboid { half } => cuboid_crossing(origin, direction, half, after),
            Shape::Frustum { bottom, top, half_height } => {
                frustum_crossing(origin, direction, [bottom, top, half_height], after)
            }
            Shape::Torus { major, minor } => torus_crossing(origin, direction, [major, minor], after),
        }
    }

    /// Returns the outward unit normal at a local point of the surface.
    pub fn normal(&self, p: Vec3) -> Vec3 {
        match *self {
            Shape::Sphere { .. } => unit(p),
            Shape::Cuboid { half } => cuboid_normal(p, half),
            Shape::Frustum { bottom, top, half_height } => frustum_normal(p, bottom, top, half_height),
            Shape::Torus { major, .. } => {
                let pull = 1.0 - major / p[0].hypot(p[1]);
                unit([p[0] * pull, p[1] * pull, p[2]])
            }
        }
    }
}

/// Returns the signed distance in the (radius, z) half plane, where the solid is a trapezium.
fn frustum_distance(p: Vec3, bottom: f64, top: f64, half: f64) -> f64 {
    let (r, z) = (p[0].hypot(p[1]), p[2]);
    let cap_radius = if z < 0.0 { bottom } else { top };
    let cap = [r - r.min(cap_radius), z.abs() - half];
    let slant = [top - bottom, 2.0 * half];
    let share =
        (((r - bottom) * slant[0] + (z + half) * slant[1]) / (slant[0].powi(2) + slant[1].powi(2))).clamp(0.0, 1.0);
    let side = [r - bottom - share * slant[0], z + half - share * slant[1]];
    let inside = side[0] < 0.0 && cap[1] < 0.0;
    let nearest = cap[0].hypot(cap[1]).min(side[0].hypot(side[1]));
    if inside { -nearest } else { nearest }
}

fn cuboid_normal(p: Vec3, half: Vec3) -> Vec3 {
    let gap = |i: usize| (p[i].abs() - half[i]).abs();
    let nearest = (1..3).fold(0, |best, i| if gap(i) < gap(best) { i } else { best });
    std::array::from_fn(|i| if i == nearest { p[i].signum() } else { 0.0 })
}

fn frustum_normal(p: Vec3, bottom: f64, top: f64, half: f64) -> Vec3 {
    let r = p[0].hypot(p[1]);
    let slope = (top - bottom) / (2.0 * half);
    let side = unit([p[0] / r.max(1e-300), p[1] / r.max(1e-300), -slope]);
    let side_gap = (r - bottom - slope * (p[2] + half)).abs() / slope.hypot(1.0);
    if (p[2].abs() - half).abs() < side_gap { [0.0, 0.0, p[2].signum()] } else { side }
}

/// Returns the smaller root of `a t^2 + 2 b t + c` beyond `after` for which `keep` is true.
fn first_root(a: f64, b: f64, c: f64, after: f64, keep: impl Fn(f64) -> bool) -> Option<f64> {
    let disc = b * b - a * c;
    if disc < 0.0 {
        return None;
    }
    // The form without cancellation: one root by q / a, the other by c / q.
    let q = -(b + disc.sqrt().copysign(b));
    let (u, v) = (q / a, c / q);
    [u.min(v), u.max(v)].into_iter().find(|&t| t.is_finite() && t > after && keep(t))
}

fn sphere_crossing(o: Vec3, d: Vec3, radius: f64, after: f64) -> Option<f64> {
    first_root(dot(d, d), dot(o, d), dot(o, o) - radius * radius, after, |_| true)
}

fn cuboid_crossing(o: Vec3, d: Vec3, half: Vec3, after: f64) -> Option<f64> {
    let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
    for i in 0..3 {
        if d[i] == 0.0 {
            if o[i].abs() > half[i] {
                return None;
            }
            continue;
        }
        let (u, v) = ((-half[i] - o[i]) / d[i], (half[i] - o[i]) / d[i]);
        enter = enter.max(u.min(v));
        leave = leave.min(u.max(v));
    }
    if enter > leave {
        return None;
    }
    [enter, leave].into_iter().find(|&t| t > after && t.is_finite())
}

/// Side and both caps; `size` is `[bottom, top, half_height]`.
fn frustum_crossing(o: Vec3, d: Vec3, size: [f64; 3], after: f64) -> Option<f64> {
    let [bottom, top, half] = size;
    let (mid, slope) = (0.5 * (bottom + top), (top - bottom) / (2.0 * half));
    let radius = mid + slope * o[2];
    let a = d[0] * d[0] + d[1] * d[1] - (slope * d[2]).powi(2);
    let b = o[0] * d[0] + o[1] * d[1] - slope * d[2] * radius;
    let c = o[0] * o[0] + o[1] * o[1] - radius * radius;
    let side = first_root(a, b, c, after, |t| (o[2] + t * d[2]).abs() <= half);
    let cap = |z: f64, r: f64| {
        let t = (z - o[2]) / d[2];
        let p = along(o, d, t);
        (t.is_finite() && t > after && p[0] * p[0] + p[1] * p[1] <= r * r).then_some(t)
    };
    [side, cap(-half, bottom), cap(half, top)].into_iter().flatten().reduce(f64::min)
}

/// Returns the first root of a torus' quartic beyond `after`, bracketed by the roots of its derivatives. It is as exact
/// as the arithmetic, where Ferrari's closed form loses half the digits. `size` is `[major, minor]`.
fn torus_crossing(o: Vec3, d: Vec3, size: [f64; 2], after: f64) -> Option<f64> {
    let [major, minor] = size;
    let speed = length(d);
    let (d, middle) = (scale(d, 1.0 / speed), -dot(o, d) / speed);
    // From the ray's closest point to the centre, the quartic has no cubic term.
    let o = along(o, d, middle);
    let reach2 = (major + minor).powi(2) - dot(o, o);
    if reach2 <= 0.0 || (o[2].abs() > minor && d[2] == 0.0) {
        return None;
    }
    let g = dot(o, o) + major * major - minor * minor;
    let k = 4.0 * major * major;
    let p = 2.0 * g - k * (d[0] * d[0] + d[1] * d[1]);
    let q = -2.0 * k * (o[0] * d[0] + o[1] * d[1]);
    let r = g * g - k * (o[0] * o[0] + o[1] * o[1]);
    depressed_quartic(p, q, r, reach2.sqrt()).map(|t| (middle + t) / speed).find(|&t| t > after)
}

/// Returns the roots of `t^4 + p t^2 + q t + r` within `-reach..=reach`, ascending.
fn depressed_quartic(p: f64, q: f64, r: f64, reach: f64) -> impl Iterator<Item = f64> {
    let turn = (-p / 6.0).max(0.0).sqrt().min(reach);
    let cubic = |t: f64| (4.0 * t * t + 2.0 * p) * t + q;
    let cubic_slope = |t: f64| 12.0 * t * t + 2.0 * p;
    let quartic = move |t: f64| ((t * t + p) * t + q) * t + r;
    let bends = monotone_roots(cubic, cubic_slope, [-reach, -turn, turn, reach]);
    let knots = [-reach, bends[0].unwrap_or(-reach), bends[1].unwrap_or(-turn), bends[2].unwrap_or(reach), reach];
    monotone_roots(quartic, cubic, knots).into_iter().flatten()
}

/// Returns one root between each two neighbouring knots, between which `f` is monotone.
fn monotone_roots<const N: usize>(
    f: impl Fn(f64) -> f64,
    slope: impl Fn(f64) -> f64,
    knots: [f64; N],
) -> [Option<f64>; N] {
    std::array::from_fn(|i| if i + 1 < N { bracketed_root(&f, &slope, knots[i], knots[i + 1]) } else { None })
}

/// Applies Newton's method, with bisection where it would leave the bracket.
fn bracketed_root(f: &impl Fn(f64) -> f64, slope: &impl Fn(f64) -> f64, low: f64, high: f64) -> Option<f64> {
    let (at_low, at_high) = (f(low), f(high));
    if low >= high || (at_low > 0.0) == (at_high > 0.0) {
        return None;
    }
    let rising = at_high > at_low;
    let (mut low, mut high) = (low, high);
    let mut t = 0.5 * (low + high);
    for _ in 0..80 {
        let value = f(t);
        if (value > 0.0) == rising {
            high = t;
        } else {
            low = t;
        }
        let newton = t - value / slope(t);
        let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
        if (next - t).abs() <= 1e-15 {
            return Some(next);
        }
        t = next;
    }
    Some(t)
}

/// A shape placed in the scene, with its material.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solid {
    /// The shape around its own origin.
    pub shape: Shape,
    /// Its origin.
    pub centre: Vec3,
    /// Its local x, y and z axes, orthonormal.
    pub axes: [Vec3; 3],
    /// Its material.
    pub material: Material,
}

impl Solid {
    /// Places a shape with its axes along the scene's.
    pub fn at(shape: Shape, centre: Vec3, material: Material) -> Solid {
        Solid { shape, centre, axes: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], material }
    }

    /// Turns its local z axis along `z`.
    pub fn facing(self, z: Vec3) -> Solid {
        Solid { axes: axes_along(z), ..self }
    }

    /// Turns it by `angle` radians about the vertical.
    pub fn turned(self, angle: f64) -> Solid {
        let (s, c) = angle.sin_cos();
        Solid { axes: [[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]], ..self }
    }

    /// Returns a capped cylinder or cone from `from` to `to`.
    pub fn rod(from: Vec3, to: Vec3, radii: [f64; 2], material: Material) -> Solid {
        let axis = sub(to, from);
        let shape = Shape::Frustum { bottom: radii[0], top: radii[1], half_height: 0.5 * length(axis) };
        Solid::at(shape, scale(add(from, to), 0.5), material).facing(axis)
    }

    /// Returns a scene point in local coordinates.
    pub fn local(&self, p: Vec3) -> Vec3 {
        self.local_direction(sub(p, self.centre))
    }

    /// Returns a local point in scene coordinates.
    pub fn global(&self, p: Vec3) -> Vec3 {
        add(self.centre, self.global_direction(p))
    }

    /// Returns the signed Euclidean distance of a scene point to the surface, negative inside.
    pub fn distance(&self, p: Vec3) -> f64 {
        self.shape.distance(self.local(p))
    }

    /// Returns the least `t > after` at which a scene ray crosses the surface.
    pub fn first_crossing(&self, origin: Vec3, direction: Vec3, after: f64) -> Option<f64> {
        let (o, d) = (self.local(origin), self.local_direction(direction));
        self.shape.first_crossing(o, d, after)
    }

    /// Returns the outward unit normal at a scene point of the surface.
    pub fn normal(&self, p: Vec3) -> Vec3 {
        self.global_direction(self.shape.normal(self.local(p)))
    }

    fn local_direction(&self, d: Vec3) -> Vec3 {
        self.axes.map(|axis| dot(axis, d))
    }

    fn global_direction(&self, d: Vec3) -> Vec3 {
        let [x, y, z] = self.axes;
        add(add(scale(x, d[0]), scale(y, d[1])), scale(z, d[2]))
    }
}
