//! Materials of solids. Colours are linear, except the display values from which materials are made.

use std::f64::consts::TAU;

use crate::vector::{Vec3, mix};

/// How colour varies over a solid, as a function of its local coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pattern {
    /// One colour.
    Plain,
    /// Cubes of the given edge.
    Checker(f64),
    /// Bands across local z: their period, and the second colour's fraction of it.
    Bands(f64, f64),
    /// This many stripes around local z.
    Flutes(f64),
    /// Year rings of the given width around an axis next to the solid.
    Wood(f64),
    /// Cloth: two sets of stripes across x and y, of the given period, mixed.
    Gingham(f64),
    /// Courses in the xz plane of the given height.
    Bricks(f64),
}

/// The material of a solid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Distribution of the two colours.
    pub pattern: Pattern,
    /// Linear albedo, 0..=1.
    pub colours: [Vec3; 2],
    /// Strength of the Blinn-Phong highlight and of the sky's reflection, 0 for matte.
    pub gloss: f64,
    /// Exponent of the highlight.
    pub shininess: f64,
    /// Fraction of light that is mirrored, tinted by the first colour.
    pub mirror: f64,
}

impl Material {
    /// Returns a matte material of one colour, given as display values 0..=1.
    pub fn matte(colour: Vec3) -> Material {
        Material::patterned(Pattern::Plain, colour, colour)
    }

    /// Returns a matte material of two colours, given as display values 0..=1.
    pub fn patterned(pattern: Pattern, first: Vec3, second: Vec3) -> Material {
        let colours = [first, second].map(|c| c.map(|v| v.powf(2.2)));
        Material { pattern, colours, gloss: 0.0, shininess: 1.0, mirror: 0.0 }
    }

    /// Adds highlights.
    pub fn glossy(self, gloss: f64, shininess: f64) -> Material {
        Material { gloss, shininess, ..self }
    }

    /// Makes it a metal.
    pub fn metal(self, mirror: f64) -> Material {
        Material { mirror, ..self }.glossy(1.0, 300.0)
    }

    /// Returns the linear albedo at a point in the solid's local coordinates.
    pub fn albedo(&self, p: Vec3) -> Vec3 {
        let [first, second] = self.colours;
        mix(first, second, self.pattern.share(p))
    }
}

impl Pattern {
    /// Returns the fraction of the second colour, 0..=1.
    fn share(self, p: Vec3) -> f64 {
        let half = |v: f64| f64::from(u8::from(v.rem_euclid(1.0) < 0.5));
        match self {
            Pattern::Plain => 0.0,
            Pattern::Checker(edge) => p.map(|v| (v / edge + 1e-6).floor()).iter().sum::<f64>().rem_euclid(2.0),
            Pattern::Bands(period, share) => f64::from(u8::from((p[2] / period).rem_euclid(1.0) < share)),
            Pattern::Flutes(count) => half(p[1].atan2(p[0]) / TAU * count),
            Pattern::Wood(width) => wood_share(p, width),
            Pattern::Gingham(period) => 0.5 * (half(p[0] / period) + half(p[1] / period)),
            Pattern::Bricks(height) => brick_share(p, height),
        }
    }
}

fn wood_share(p: Vec3, width: f64) -> f64 {
    let wobble = 0.03 * (5.0 * p[0]).sin() + 0.015 * (13.0 * p[0] + 4.0 * p[1]).sin();
    let ring = ((p[1] + 1.7 + wobble).hypot(0.35 * p[0]) / width).rem_euclid(1.0);
    ring * ring * (3.0 - 2.0 * ring)
}

fn brick_share(p: Vec3, height: f64) -> f64 {
    const MORTAR: f64 = 0.1;
    let row = p[2] / height;
    let column = p[0] / (2.2 * height) + 0.5 * row.floor().rem_euclid(2.0);
    let joint = row.rem_euclid(1.0) < MORTAR || column.rem_euclid(1.0) < MORTAR / 2.2;
    let tone = 0.35 * (0.5 + 0.5 * (row.floor() * 2.4 + column.floor() * 4.1).sin());
    if joint { 1.0 } else { tone }
}
