//! Scenes by seed: other objects, materials, supports and lights in the place of the still life's.
//!
//! A scene has a support and four to nine objects of twelve kinds, whose sizes, patterns and colours are drawn. Objects do
//! not touch one another, and all is within 1.2 of the origin, as in the still life.

use std::f64::consts::TAU;

use super::material::{Material, Pattern};
use super::shading::Light;
use super::shapes::{Shape, Solid};
use super::still_life::TOP;
use crate::vector::Vec3;
use augnerf_base::rng::{Random, Stream};

/// Objects stay within this distance of the axis, and below this height over the support.
const REACH: f64 = 0.86;
const HIGHEST: f64 = 1.15;
/// Least gap between two objects.
const GAP: f64 = 0.05;
/// Draws of a place before an object is left out.
const MOST_DRAWS: usize = 300;

/// The parts of a scene.
pub struct Drawn {
    /// The objects, without their support.
    pub objects: Vec<Vec<Solid>>,
    /// The support for cameras all around.
    pub board: Vec<Solid>,
    /// Table and wall for forward-facing cameras.
    pub room: Vec<Vec<Solid>>,
    /// The lights.
    pub light: Light,
}

/// Draws the scene of a seed.
pub fn draw(seed: u64) -> Drawn {
    let mut maker = Maker { random: Random::new(seed, Stream::Scene, 0), hue: 0.0 };
    maker.hue = maker.random.uniform();
    let light = maker.light();
    let (board, room) = (maker.board(), maker.room());
    Drawn { objects: maker.objects(), board, room, light }
}

struct Maker {
    random: Random,
    /// The scene's main hue, 0 to 1.
    hue: f64,
}

/// Where an object stands, and how large it may be.
#[derive(Clone, Copy)]
struct Site {
    x: f64,
    y: f64,
    radius: f64,
    height: f64,
}

impl Site {
    /// Returns a point above the site, from its middle.
    fn at(&self, x: f64, y: f64, up: f64) -> Vec3 {
        [self.x + x, self.y + y, TOP + up]
    }
}

impl Maker {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.random.uniform()
    }

    fn one_of<T: Copy>(&mut self, choices: &[T]) -> T {
        choices[self.random.below(choices.len() as u32) as usize]
    }

    /// Draws a colour as display values. Hues are around the scene's, opposite to it, or anywhere.
    fn colour(&mut self) -> Vec3 {
        let around = self.one_of(&[0.0, 0.08, -0.08, 0.5, 0.42]);
        let anywhere = self.random.uniform();
        let hue = if self.random.uniform() < 0.3 { anywhere } else { self.hue + around };
        let (saturation, value) = (self.between(0.35, 0.9), self.between(0.35, 0.95));
        from_hsv(hue, saturation, value)
    }

    fn material(&mut self) -> Material {
        let (first, second) = (self.colour(), self.colour());
        if self.random.uniform() < 0.12 {
            let tint = first.map(|v| 0.6 + 0.4 * v);
            return Material::matte(tint).metal(self.between(0.6, 0.9));
        }
        let pattern = match self.random.below(6) {
            0 => Pattern::Checker(self.between(0.06, 0.12)),
            1 => Pattern::Bands(self.between(0.08, 0.16), self.between(0.3, 0.6)),
            2 => Pattern::Flutes(f64::from(4 + self.random.below(10))),
            3 => Pattern::Wood(self.between(0.06, 0.14)),
            _ => Pattern::Plain,
        };
        let light = second.map(|v| 0.5 + 0.5 * v);
        Material::patterned(pattern, first, light).glossy(self.between(0.0, 0.7), self.between(20.0, 120.0))
    }

    fn light(&mut self) -> Light {
        // From the front, where no wall is.
        let (turn, height) = (-0.5 * TAU * self.between(0.08, 0.92), self.between(0.55, 1.6));
        let warmth = self.between(-0.12, 0.12);
        let strength = self.between(0.9, 1.2);
        let key = [1.0 + warmth, 1.0, 1.0 - warmth].map(|v| strength * v);
        let zenith = from_hsv(self.between(0.52, 0.66), self.between(0.2, 0.6), 0.9);
        let horizon = [0.82 + 0.6 * warmth, 0.82, 0.84 - 0.6 * warmth];
        let ambient = [0.68 - 0.3 * warmth, 0.68, 0.70 + 0.3 * warmth];
        Light::new([turn.cos(), turn.sin(), height], key, ambient, [horizon, zenith, [0.22, 0.20, 0.19]])
    }

    fn board(&mut self) -> Vec<Solid> {
        let cloth = self.material();
        let edge = Material::matte(self.colour());
        let shape = match self.random.below(3) {
            0 => Shape::Frustum { bottom: 0.94, top: 1.02, half_height: 0.05 },
            1 => Shape::Cuboid { half: [0.74, 0.74, 0.05] },
            _ => Shape::Frustum { bottom: 1.02, top: 0.96, half_height: 0.05 },
        };
        let foot = Shape::Frustum { bottom: 0.66, top: 0.7, half_height: 0.03 };
        vec![Solid::at(shape, [0.0, 0.0, TOP - 0.05], cloth), Solid::at(foot, [0.0, 0.0, TOP - 0.13], edge)]
    }

    fn room(&mut self) -> Vec<Vec<Solid>> {
        let colours = |maker: &mut Maker| (maker.colour().map(|v| 0.4 + 0.6 * v), maker.colour());
        let (first, second) = colours(self);
        let cloth = self.between(0.25, 0.5);
        let cloth = self.one_of(&[Pattern::Gingham(cloth), Pattern::Checker(cloth), Pattern::Wood(0.3 * cloth)]);
        let cloth = Material::patterned(cloth, first, second);
        let (first, second) = colours(self);
        let paper = self.between(0.16, 0.34);
        let paper = self.one_of(&[Pattern::Bricks(paper), Pattern::Checker(paper), Pattern::Bands(2.0 * paper, 0.5)]);
        let paper = Material::patterned(paper, first, second);
        let table = Solid::at(Shape::Cuboid { half: [3.4, 1.55, 0.1] }, [0.0, -0.05, TOP - 0.1], cloth);
        let wall = Solid::at(Shape::Cuboid { half: [6.0, 0.1, 5.0] }, [0.0, 1.6, 0.8], paper);
        vec![vec![table], vec![wall]]
    }

    fn objects(&mut self) -> Vec<Vec<Solid>> {
        let count = 4 + self.random.below(6);
        let mut sites: Vec<Site> = Vec::new();
        // The largest first, so that the others fit between.
        for i in 0..count {
            let radius = if i == 0 { self.between(0.24, 0.32) } else { self.between(0.13, 0.24) };
            if let Some(site) = (0..MOST_DRAWS).find_map(|_| self.free_site(&sites, radius)) {
                sites.push(site);
            }
        }
        sites.into_iter().map(|site| self.object(site)).collect()
    }

    fn free_site(&mut self, taken: &[Site], radius: f64) -> Option<Site> {
        let (distance, turn) = ((REACH - radius) * self.random.uniform().sqrt(), TAU * self.random.uniform());
        let (x, y) = (distance * turn.cos(), distance * turn.sin());
        // Square boards are narrower than round ones.
        let on_board = x.abs().max(y.abs()) + radius <= 0.74;
        let free = taken.iter().all(|other| (x - other.x).hypot(y - other.y) >= radius + other.radius + GAP);
        // The upper rim is within 1.2 of the origin.
        let highest = (1.19f64.powi(2) - (distance + radius).powi(2)).sqrt() - TOP;
        let height = (self.between(1.6, 4.2) * radius).min(highest).min(HIGHEST);
        (on_board && free).then_some(Site { x, y, radius, height })
    }

    fn object(&mut self, site: Site) -> Vec<Solid> {
        match self.random.below(12) {
            0 => self.balls(site),
            1 => self.lathe(site),
            2 => self.rings(site),
            3 => self.cubes(site),
            4 => self.tree(site),
            5 => self.cup(site),
            6 => self.arch(site),
            7 => self.mushroom(site),
            8 => self.column(site),
            9 => self.hoop(site),
            10 => self.rods(site),
            _ => self.flower(site),
        }
    }

    /// Balls on one another, each smaller than the one below.
    fn balls(&mut self, site: Site) -> Vec<Solid> {
        let (mut radius, mut up, mut solids) = (site.radius, 0.0, Vec::new());
        while up + 1.9 * radius <= site.height && solids.len() < 4 && radius > 0.04 {
            solids.push(Solid::at(Shape::Sphere { radius }, site.at(0.0, 0.0, up + radius), self.material()));
            up += 1.85 * radius;
            radius *= self.between(0.6, 0.85);
        }
        if solids.is_empty() {
            let radius = 0.5 * site.height.min(2.0 * site.radius);
            solids.push(Solid::at(Shape::Sphere { radius }, site.at(0.0, 0.0, radius), self.material()));
        }
        solids
    }

    fn frustum(&mut self, site: Site, [bottom, top]: [f64; 2], [low, high]: [f64; 2], material: Material) -> Solid {
        let shape = Shape::Frustum { bottom, top, half_height: 0.5 * (high - low) };
        Solid::at(shape, site.at(0.0, 0.0, 0.5 * (low + high)), material)
    }

    /// A vase of three to five pieces.
    fn lathe(&mut self, site: Site) -> Vec<Solid> {
        let (pieces, glaze) = (3 + self.random.below(3), self.material());
        let (mut radius, mut low, mut solids) = (self.between(0.5, 0.9) * site.radius, 0.0, Vec::new());
        for i in 1..=pieces {
            let high = site.height * f64::from(i) / f64::from(pieces);
            let next = self.between(0.35, 1.0) * site.radius;
            solids.push(self.frustum(site, [radius, next], [low, high], glaze));
            (radius, low) = (next, high);
        }
        let minor = 0.1 * radius;
        let rim = Shape::Torus { major: radius - minor, minor };
        solids.push(Solid::at(rim, site.at(0.0, 0.0, low - minor), self.material()));
        solids
    }

    /// Rings of falling size on a peg.
    fn rings(&mut self, site: Site) -> Vec<Solid> {
        let minor = 0.28 * site.radius;
        let count = ((site.height / (1.8 * minor)) as usize).clamp(2, 6);
        let peg = Material::matte(self.colour());
        let top = 1.8 * minor * count as f64 + 0.6 * minor;
        let mut solids = vec![self.frustum(site, [0.3 * site.radius, 0.25 * site.radius], [0.0, top], peg)];
        for i in 0..count {
            let major = (site.radius - minor) * (1.0 - 0.5 * i as f64 / count as f64);
            let up = minor + 1.8 * minor * i as f64;
            solids.push(Solid::at(Shape::Torus { major, minor }, site.at(0.0, 0.0, up), self.material()));
        }
        solids
    }

    /// Dice on one another, each turned.
    fn cubes(&mut self, site: Site) -> Vec<Solid> {
        let (mut half, mut up, mut solids) = (site.radius / 2f64.sqrt(), 0.0, Vec::new());
        while solids.is_empty() || up + 2.0 * half <= site.height && solids.len() < 3 {
            let tall = if solids.is_empty() { (0.5 * site.height).min(half) } else { half };
            let cube =
                Solid::at(Shape::Cuboid { half: [half, half, tall] }, site.at(0.0, 0.0, up + tall), self.material());
            solids.push(cube.turned(TAU * self.random.uniform()));
            up += 2.0 * tall;
            half *= self.between(0.55, 0.9);
        }
        solids
    }

    /// Cones over a trunk.
    fn tree(&mut self, site: Site) -> Vec<Solid> {
        let (bark, leaves) = (Material::matte([0.36, 0.23, 0.13]), self.material());
        let trunk = 0.2 * site.height;
        let mut solids = vec![self.frustum(site, [0.22 * site.radius, 0.18 * site.radius], [0.0, 1.5 * trunk], bark)];
        for i in 0..3 {
            let step = 0.25 * (site.height - trunk);
            let low = trunk + step * f64::from(i);
            let radius = site.radius * (1.0 - 0.25 * f64::from(i));
            solids.push(self.frustum(site, [radius, 0.02 * radius], [low, low + 2.0 * step], leaves));
        }
        solids
    }

    /// A cup with an ear and a drink.
    fn cup(&mut self, site: Site) -> Vec<Solid> {
        let height = site.height.min(2.2 * site.radius);
        let radius = 0.72 * site.radius;
        let (glaze, plain) = (self.material(), Material::matte(self.colour()).glossy(0.5, 90.0));
        let drink = Material::matte(self.colour()).glossy(0.6, 120.0);
        let turn = TAU * self.random.uniform();
        let (sin, cos) = turn.sin_cos();
        let ear = Shape::Torus { major: 0.2 * radius + 0.12 * height, minor: 0.09 * radius };
        let rim = Shape::Torus { major: 0.93 * radius, minor: 0.07 * radius };
        vec![
            self.frustum(site, [0.85 * radius, radius], [0.0, height], glaze),
            Solid::at(rim, site.at(0.0, 0.0, height), plain),
            self.frustum(site, [0.9 * radius; 2], [0.9 * height, height + 0.01], drink),
            Solid::at(ear, site.at(0.92 * radius * cos, 0.92 * radius * sin, 0.5 * height), plain)
                .facing([-sin, cos, 0.0]),
        ]
    }

    /// Two pillars and a beam.
    fn arch(&mut self, site: Site) -> Vec<Solid> {
        let (stone, beam) = (self.material(), self.material());
        let (sin, cos) = (TAU * self.random.uniform()).sin_cos();
        let thick = 0.26 * site.radius;
        let out = 0.68 * site.radius;
        let high = site.height - 2.0 * thick;
        let pillar = |sign: f64| {
            let shape = Shape::Frustum { bottom: thick, top: 0.85 * thick, half_height: 0.5 * high };
            Solid::at(shape, site.at(sign * out * cos, sign * out * sin, 0.5 * high), stone)
        };
        let lintel = Shape::Cuboid { half: [0.94 * site.radius, thick, thick] };
        let lintel = Solid::at(lintel, site.at(0.0, 0.0, high + thick), beam).turned(sin.atan2(cos));
        vec![pillar(1.0), pillar(-1.0), lintel]
    }

    fn mushroom(&mut self, site: Site) -> Vec<Solid> {
        let radius = site.radius.min(0.5 * site.height);
        let stem = site.height - radius;
        let (skin, cap) = (Material::matte([0.93, 0.90, 0.82]), self.material());
        let mut solids = vec![self.frustum(site, [0.5 * radius, 0.35 * radius], [0.0, stem], skin)];
        solids.push(self.frustum(site, [radius, 0.7 * radius], [stem, stem + 0.4 * radius], cap));
        solids.push(self.frustum(site, [0.7 * radius, 0.15 * radius], [stem + 0.4 * radius, stem + 0.7 * radius], cap));
        solids
    }

    /// A ball on a column with a base.
    fn column(&mut self, site: Site) -> Vec<Solid> {
        let ball = 0.62 * site.radius.min(0.3 * site.height);
        let shaft = self.material();
        let (base, top) = (Material::matte(self.colour()), self.material());
        let high = site.height - 1.9 * ball;
        vec![
            self.frustum(site, [0.95 * site.radius, 0.8 * site.radius], [0.0, 0.12 * high], base),
            self.frustum(site, [0.5 * site.radius, 0.42 * site.radius], [0.12 * high, high], shaft),
            Solid::at(Shape::Sphere { radius: ball }, site.at(0.0, 0.0, high + 0.9 * ball), top),
        ]
    }

    /// A hoop that stands aslant, and a ball in front of it.
    fn hoop(&mut self, site: Site) -> Vec<Solid> {
        let (lean, turn) = (self.between(0.1, 0.4), TAU * self.random.uniform());
        let minor = 0.1 * site.radius;
        let major = (0.8 * site.radius).min(0.5 * site.height / lean.cos()) - minor;
        let centre = site.at(0.0, 0.0, major * lean.cos() + minor);
        let facing = [lean.cos() * turn.cos(), lean.cos() * turn.sin(), lean.sin()];
        let ball = 0.3 * site.radius;
        vec![
            Solid::at(Shape::Torus { major, minor }, centre, self.material()).facing(facing),
            Solid::at(
                Shape::Sphere { radius: ball },
                site.at(0.62 * site.radius * turn.cos(), 0.62 * site.radius * turn.sin(), ball),
                self.material(),
            ),
        ]
    }

    /// Pencils in a cup.
    fn rods(&mut self, site: Site) -> Vec<Solid> {
        let (cup, tall) = (self.material(), 0.5 * site.height);
        let mut solids = vec![self.frustum(site, [0.55 * site.radius, 0.6 * site.radius], [0.0, tall], cup)];
        let count = 4 + self.random.below(3);
        for i in 0..count {
            let (sin, cos) = (TAU * (f64::from(i) + 0.3 * self.random.uniform()) / f64::from(count)).sin_cos();
            let out = self.between(0.75, 0.95) * site.radius;
            let high = self.between(0.8, 0.97) * site.height;
            let radius = 0.09 * site.radius;
            let from = site.at(0.2 * site.radius * cos, 0.2 * site.radius * sin, 0.3 * tall);
            let lacquer = Material::matte(self.colour()).glossy(0.4, 60.0);
            solids.push(Solid::rod(from, site.at(out * cos, out * sin, high), [radius; 2], lacquer));
        }
        solids
    }

    /// A flower in a pot.
    fn flower(&mut self, site: Site) -> Vec<Solid> {
        let pot = self.material();
        let (stem, petal) = (Material::matte([0.22, 0.52, 0.22]), Material::matte(self.colour()).glossy(0.15, 20.0));
        let heart = Material::matte([0.98, 0.80, 0.18]);
        let head = site.height - 0.55 * site.radius;
        let mut solids = vec![
            self.frustum(site, [0.45 * site.radius, 0.65 * site.radius], [0.0, 0.4 * site.height], pot),
            self.frustum(site, [0.09 * site.radius, 0.07 * site.radius], [0.3 * site.height, head], stem),
            Solid::at(Shape::Sphere { radius: 0.24 * site.radius }, site.at(0.0, 0.0, head), heart),
        ];
        let tilt = TAU * self.random.uniform();
        for i in 0..7 {
            let (sin, cos) = (TAU * f64::from(i) / 7.0).sin_cos();
            // A wheel that faces the side, so that cameras all around see it.
            let (across, up) = (0.42 * site.radius * cos, 0.42 * site.radius * sin);
            let centre = site.at(across * tilt.cos(), across * tilt.sin(), head + up);
            solids.push(Solid::at(Shape::Sphere { radius: 0.2 * site.radius }, centre, petal));
        }
        solids
    }
}

/// Returns the display values of a hue (0 to 1, around), saturation and value.
fn from_hsv(hue: f64, saturation: f64, value: f64) -> Vec3 {
    [5.0, 3.0, 1.0].map(|n: f64| {
        let k = (n + 6.0 * hue).rem_euclid(6.0);
        value - value * saturation * k.min(4.0 - k).clamp(0.0, 1.0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vector::length;

    #[test]
    fn hues_are_red_green_and_blue() {
        for (hue, expected) in [(0.0, [1.0, 0.0, 0.0]), (1.0 / 3.0, [0.0, 1.0, 0.0]), (2.0 / 3.0, [0.0, 0.0, 1.0])] {
            assert!(from_hsv(hue, 1.0, 1.0).iter().zip(expected).all(|(a, b): (&f64, f64)| (a - b).abs() < 1e-9));
        }
        assert_eq!(from_hsv(0.3, 0.0, 0.5), [0.5; 3]);
    }

    /// Of 300 seeds: every solid is sound, over the support, within the reach of the cameras' box, and away from other
    /// objects.
    #[test]
    fn scenes_are_within_their_bounds_and_objects_apart() {
        let mut counts = Vec::new();
        for seed in 0..300 {
            let Drawn { objects, board, .. } = draw(seed);
            counts.push(objects.len());
            for solid in objects.iter().flatten().chain(&board) {
                let sizes = match solid.shape {
                    Shape::Sphere { radius } => vec![radius],
                    Shape::Cuboid { half } => half.to_vec(),
                    Shape::Frustum { bottom, top, half_height } => vec![bottom, top, half_height],
                    Shape::Torus { major, minor } => vec![major - minor, minor],
                };
                assert!(sizes.iter().all(|size| *size > 0.0 && *size < 1.2), "{seed}: {:?}", solid.shape);
                assert!(length(solid.centre) < 1.2, "{seed}: {:?}", solid.centre);
            }
            for mesh in objects.iter().map(|object| super::super::mesh::of_solids(object)) {
                for vertex in &mesh.vertices {
                    let point = vertex.map(f64::from);
                    assert!(length(point) < 1.2 + 1e-6, "{seed}: {point:?}");
                    assert!(point[2] > TOP - 1e-6, "{seed}: {point:?}");
                }
            }
            for (i, a) in objects.iter().enumerate() {
                for b in &objects[..i] {
                    let apart = super::super::mesh::of_solids(a)
                        .vertices
                        .iter()
                        .all(|vertex| b.iter().all(|solid| solid.distance(vertex.map(f64::from)) > 0.0));
                    assert!(apart, "{seed}: two objects touch");
                }
            }
        }
        assert!(*counts.iter().min().unwrap() >= 3 && *counts.iter().max().unwrap() >= 8, "{counts:?}");
    }

    /// In the forward-facing frame all is behind NDC's near plane, and every pixel sees something.
    #[test]
    fn forward_facing_scenes_fill_the_picture_behind_the_near_plane() {
        for seed in 0..12 {
            let stage = super::super::forward_stage(Some(seed));
            for vertex in &super::super::mesh::Mesh::of(&stage).vertices {
                let back = super::super::views::forward_frame().into_scene(vertex.map(f64::from))[2];
                assert!(back < -1.0, "{seed}: {back}");
            }
            for (_, camera) in super::super::views::before(12) {
                let picture = stage.render(&camera, crate::settings::PixelOrigin::Centre);
                assert!(picture.depth.iter().all(|depth| depth.is_finite()), "{seed}");
            }
        }
    }

    #[test]
    fn a_seed_is_a_scene_and_seeds_differ() {
        assert_eq!(draw(17).objects, draw(17).objects);
        assert!((0..50).all(|seed| (0..seed).all(|other| draw(seed).objects != draw(other).objects)));
    }
}
