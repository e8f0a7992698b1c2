//! Three-component vectors as plain arrays.

/// A point, direction or colour.
pub type Vec3 = [f64; 3];

/// `a . b`
pub fn dot(a: Vec3, b: Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// `a + b`
pub fn add(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// `a - b`
pub fn sub(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// `s a`
pub fn scale(a: Vec3, s: f64) -> Vec3 {
    [a[0] * s, a[1] * s, a[2] * s]
}

/// `a b`, component by component.
pub fn mul(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] * b[0], a[1] * b[1], a[2] * b[2]]
}

/// `a x b`
pub fn cross(a: Vec3, b: Vec3) -> Vec3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// `|a|`
pub fn length(a: Vec3) -> f64 {
    dot(a, a).sqrt()
}

/// `a / |a|`; `a` is not zero.
pub fn unit(a: Vec3) -> Vec3 {
    scale(a, 1.0 / length(a))
}

/// Returns the point at `t` on a ray.
pub fn along(origin: Vec3, direction: Vec3, t: f64) -> Vec3 {
    add(origin, scale(direction, t))
}

/// Returns `(1 - s) a + s b`.
pub fn mix(a: Vec3, b: Vec3, s: f64) -> Vec3 {
    add(scale(a, 1.0 - s), scale(b, s))
}

/// Returns right-handed orthonormal axes whose third one is along `z`, which is not zero.
pub fn axes_along(z: Vec3) -> [Vec3; 3] {
    let z = unit(z);
    let helper = if z[2].abs() < 0.9 { [0.0, 0.0, 1.0] } else { [1.0, 0.0, 0.0] };
    let x = unit(cross(helper, z));
    [x, cross(z, x), z]
}
