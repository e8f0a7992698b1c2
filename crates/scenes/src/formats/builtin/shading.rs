//! The sky and the lights, in closed form. Colours are linear here and become display values (0..=1, gamma 2.2) in
//! [`display`].

use super::material::Material;
use super::stage::{Hit, Stage};
use crate::vector::{Vec3, add, along, axes_along, dot, mix, mul, scale, sub, unit};

/// Rays of one pixel along each side, and the square root of the number of light samples.
pub const SIDE: usize = 4;
/// Samples of one pixel.
pub const SAMPLES: usize = SIDE * SIDE;

const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;
/// Half the key light's angular size as a tangent, which makes its shadows soft.
const KEY_SPREAD: f64 = 0.10;
/// Light that arrives from directions in which another surface is near.
const BOUNCE: f64 = 0.22;
/// Surfaces further away than this do not darken, in still-life units.
const BOUNCE_REACH: f64 = 0.9;
/// Distance of shadow rays' starts from the surface.
const LIFT: f64 = 1e-6;

/// The lights of a scene.
#[derive(Clone, Debug)]
pub struct Light {
    /// Radiance of the key light.
    key: Vec3,
    /// Factor on the sky's light.
    ambient: Vec3,
    /// Radiance at the horizon, the zenith and the ground.
    sky: [Vec3; 3],
    /// Unit directions to points of the key light's disc, for each sample of a pixel; the same for every pixel.
    to_key: [Vec3; SAMPLES],
    /// Points on the unit sphere. Added to a normal they are cosine-distributed around it.
    sphere: [Vec3; SAMPLES],
}

impl Light {
    /// Creates the lights of a scene. `to_key` may have any length but 0.
    pub fn new(to_key: Vec3, key: Vec3, ambient: Vec3, sky: [Vec3; 3]) -> Light {
        let to_key = std::array::from_fn(|sample| to_disc(to_key, sample));
        Light { key, ambient, sky, to_key, sphere: std::array::from_fn(on_sphere) }
    }

    /// Returns those of the still life.
    pub fn of_still_life() -> Light {
        let sky = [[0.80, 0.82, 0.86], [0.38, 0.55, 0.90], [0.22, 0.20, 0.19]];
        Light::new([-0.42, -0.52, 0.74], [1.10, 1.03, 0.92], [0.66, 0.68, 0.72], sky)
    }

    /// Returns the radiance from a unit direction in which there is nothing: a bright zenith, a dim ground.
    fn sky(&self, direction: Vec3) -> Vec3 {
        let up = direction[2];
        let [horizon, zenith, ground] = self.sky;
        if up >= 0.0 { mix(horizon, zenith, up.sqrt()) } else { mix(horizon, ground, (-4.0 * up).min(1.0)) }
    }
}

/// Returns a direction to the key light's disc, filled by the golden angle.
fn to_disc(to_key: Vec3, sample: usize) -> Vec3 {
    let [x, y, z] = axes_along(to_key);
    // 7 is odd: a permutation that keeps light and pixel positions unrelated.
    let i = (sample * 7 % SAMPLES) as f64;
    let radius = KEY_SPREAD * ((i + 0.5) / SAMPLES as f64).sqrt();
    let (s, c) = (i * GOLDEN_ANGLE).sin_cos();
    unit(add(z, add(scale(x, radius * c), scale(y, radius * s))))
}

/// Returns a point on the unit sphere, filled by the golden angle. 11 permutes as 7 does above.
fn on_sphere(sample: usize) -> Vec3 {
    let i = (sample * 11 % SAMPLES) as f64;
    let z = 1.0 - 2.0 * (i + 0.5) / SAMPLES as f64;
    let (s, c) = (i * GOLDEN_ANGLE + 0.4).sin_cos();
    let r = (1.0 - z * z).sqrt();
    [r * c, r * s, z]
}

/// Returns the linear colour of a hit seen along `direction` (still-life frame, any length).
///
/// `sample` (`0..SAMPLES`) picks the points of the key light and the sky for this one of a pixel's samples. Their mean
/// over a pixel is its colour. `bounces` mirror reflections are followed.
pub fn shade(stage: &Stage, hit: &Hit, origin: Vec3, direction: Vec3, sample: usize, bounces: u32) -> Vec3 {
    let solid = &stage.solids()[hit.solid];
    let material = &solid.material;
    let point = along(origin, direction, hit.t);
    let ahead = unit(direction);
    let start = along(point, hit.normal, LIFT);
    let albedo = material.albedo(solid.local(point));
    let (key, highlight) = key_light(stage, material, hit.normal, start, ahead, sample);
    let diffuse = mul(albedo, add(key, ambient(stage, hit.normal, start, sample)));
    let facing = -dot(hit.normal, ahead);
    let mirrored = sub(ahead, scale(hit.normal, -2.0 * facing));
    let fresnel = (1.0 - facing.clamp(0.0, 1.0)).powi(5);
    let glint = scale(stage.light().key, material.gloss * highlight);
    if material.mirror > 0.0 {
        let tint = mix(material.colours[0], [1.0; 3], fresnel);
        let seen = mul(tint, reflection(stage, start, mirrored, sample, bounces));
        return add(mix(diffuse, seen, material.mirror), glint);
    }
    let film = material.gloss.min(1.0) * (0.04 + 0.6 * fresnel);
    add(mix(diffuse, stage.light().sky(mirrored), film), glint)
}

/// Returns the diffuse irradiance of the key light and the strength of its highlight.
fn key_light(stage: &Stage, material: &Material, normal: Vec3, start: Vec3, ahead: Vec3, sample: usize) -> (Vec3, f64) {
    let light = stage.light().to_key[sample];
    let cosine = dot(normal, light);
    if cosine <= 0.0 || stage.blocked(start, light, f64::INFINITY) {
        return ([0.0; 3], 0.0);
    }
    let half = dot(normal, unit(sub(light, ahead))).max(0.0);
    let highlight = if material.gloss > 0.0 { half.powf(material.shininess) * cosine.sqrt() } else { 0.0 };
    (scale(stage.light().key, cosine), highlight)
}

/// Returns the sky light, reduced where other surfaces are near.
fn ambient(stage: &Stage, normal: Vec3, start: Vec3, sample: usize) -> Vec3 {
    let direction = add(normal, stage.light().sphere[sample]);
    let direction = unit(if dot(direction, direction) < 1e-9 { normal } else { direction });
    let open = if stage.blocked(start, direction, BOUNCE_REACH) { BOUNCE } else { 1.0 };
    mul(stage.light().ambient, scale(stage.light().sky(direction), open))
}

fn reflection(stage: &Stage, start: Vec3, direction: Vec3, sample: usize, bounces: u32) -> Vec3 {
    match stage.nearest(start, direction) {
        Some(hit) if bounces > 0 => shade(stage, &hit, start, direction, sample, bounces - 1),
        Some(hit) => stage.solids()[hit.solid].material.colours[0],
        None => stage.light().sky(direction),
    }
}

/// Converts linear light to display values: a soft shoulder above 0.8, then gamma 2.2.
pub fn display(linear: Vec3) -> Vec3 {
    linear.map(|v| {
        let soft = if v > 0.8 { 0.8 + 0.2 * (1.0 - (-(v - 0.8) / 0.2).exp()) } else { v.max(0.0) };
        soft.powf(1.0 / 2.2)
    })
}
