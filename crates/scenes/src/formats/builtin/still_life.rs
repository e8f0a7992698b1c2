//! The objects of the built-in scene: x to the right, y away from the front, z up.

use std::f64::consts::TAU;

use super::material::{Material, Pattern};
use super::shapes::{Shape, Solid};
use crate::vector::{Vec3, add, axes_along, scale};

/// Height of the surface that everything stands on.
pub(super) const TOP: f64 = -0.72;

const CREAM: Vec3 = [0.95, 0.88, 0.74];
const COBALT: Vec3 = [0.10, 0.20, 0.55];
const LEAF: Vec3 = [0.20, 0.52, 0.20];
const GOLD: Vec3 = [0.98, 0.78, 0.36];

/// Returns the objects without their support.
fn objects() -> Vec<Vec<Solid>> {
    let blooms = [
        ([-0.24, 0.28, 0.74], [0.92, 0.30, 0.38]),
        ([0.22, 0.62, 0.90], [0.98, 0.55, 0.15]),
        ([0.54, 0.22, 0.62], [0.72, 0.32, 0.76]),
    ];
    let mut all = vec![mug(), vase(), ring_tower(), dice_and_ball(), apple(), pencil(), candle(), hoop()];
    all.extend(blooms.map(|(head, colour)| bloom(head, colour)));
    all
}

/// Returns the objects on a round wooden board, for cameras all around.
pub fn on_board() -> Vec<Vec<Solid>> {
    let wood = Material::patterned(Pattern::Wood(0.13), [0.80, 0.58, 0.36], [0.56, 0.35, 0.19]).glossy(0.12, 30.0);
    let shape = Shape::Frustum { bottom: 0.98, top: 1.04, half_height: 0.045 };
    let rim = Material::matte([0.36, 0.22, 0.13]);
    let foot = Shape::Frustum { bottom: 0.80, top: 0.84, half_height: 0.03 };
    let board = vec![Solid::at(shape, [0.0, 0.0, TOP - 0.045], wood), Solid::at(foot, [0.0, 0.0, TOP - 0.12], rim)];
    let mut all = objects();
    all.push(board);
    all
}

/// Returns the objects on a table before a wall, for forward-facing cameras.
pub fn on_table() -> Vec<Vec<Solid>> {
    let cloth = Material::patterned(Pattern::Gingham(0.36), [0.93, 0.92, 0.88], [0.30, 0.48, 0.62]);
    let bricks = Material::patterned(Pattern::Bricks(0.22), [0.70, 0.42, 0.32], [0.90, 0.86, 0.80]);
    let table = Solid::at(Shape::Cuboid { half: [3.4, 1.55, 0.1] }, [0.0, -0.05, TOP - 0.1], cloth);
    let wall = Solid::at(Shape::Cuboid { half: [6.0, 0.1, 5.0] }, [0.0, 1.6, 0.8], bricks);
    let mut all = objects();
    all.extend([vec![table], vec![wall], picture()]);
    all
}

/// A framed picture of a hill and a sun.
fn picture() -> Vec<Solid> {
    let wood = Material::matte([0.30, 0.19, 0.12]).glossy(0.3, 40.0);
    let flat =
        |half: Vec3, centre: Vec3, colour: Vec3| Solid::at(Shape::Cuboid { half }, centre, Material::matte(colour));
    let disc = |radius: f64, centre: Vec3, colour: Vec3| {
        let shape = Shape::Frustum { bottom: radius, top: radius, half_height: 0.006 };
        Solid::at(shape, centre, Material::matte(colour)).facing([0.0, 1.0, 0.0])
    };
    let (x, z) = (-0.85, 0.62);
    vec![
        Solid::at(Shape::Cuboid { half: [0.46, 0.035, 0.36] }, [x, 1.47, z], wood),
        flat([0.40, 0.02, 0.30], [x, 1.445, z], [0.55, 0.78, 0.92]),
        disc(0.09, [x + 0.2, 1.42, z + 0.13], [0.98, 0.84, 0.30]),
        disc(0.15, [x - 0.2, 1.42, z - 0.14], [0.45, 0.66, 0.36]),
        disc(0.11, [x + 0.13, 1.415, z - 0.185], [0.30, 0.54, 0.30]),
    ]
}

fn lathe(centre: [f64; 2], profile: &[(f64, f64)], material: Material) -> Vec<Solid> {
    let piece = |pair: &[(f64, f64)]| {
        let ((bottom, low), (top, high)) = (pair[0], pair[1]);
        let shape = Shape::Frustum { bottom, top, half_height: 0.5 * (high - low) };
        Solid::at(shape, [centre[0], centre[1], TOP + 0.5 * (low + high)], material)
    };
    profile.windows(2).map(piece).collect()
}

fn mug() -> Vec<Solid> {
    let [x, y] = [-0.55, -0.22];
    let glaze = Material::patterned(Pattern::Bands(0.14, 0.38), [0.09, 0.50, 0.54], CREAM).glossy(0.5, 90.0);
    let plain = Material::matte([0.09, 0.50, 0.54]).glossy(0.5, 90.0);
    let coffee = Material::matte([0.24, 0.13, 0.08]).glossy(0.6, 120.0);
    let mut solids = lathe([x, y], &[(0.20, 0.0), (0.23, 0.42)], glaze);
    let rim = Shape::Torus { major: 0.212, minor: 0.018 };
    solids.push(Solid::at(rim, [x, y, TOP + 0.42], plain));
    solids.extend(lathe([x, y], &[(0.2, 0.41), (0.2, 0.425)], coffee));
    let ear = Shape::Torus { major: 0.115, minor: 0.028 };
    let out = [-0.80, -0.60, 0.0];
    let centre = [x + 0.235 * out[0], y + 0.235 * out[1], TOP + 0.22];
    solids.push(Solid::at(ear, centre, plain).facing([-out[1], out[0], 0.0]));
    solids
}

fn vase() -> Vec<Solid> {
    let at = [0.10, 0.42];
    let glaze = Material::patterned(Pattern::Flutes(12.0), COBALT, CREAM).glossy(0.6, 110.0);
    let plain = Material::matte(COBALT).glossy(0.6, 110.0);
    let mut solids = lathe(at, &[(0.13, 0.0), (0.235, 0.26), (0.235, 0.32), (0.11, 0.60)], glaze);
    solids.extend(lathe(at, &[(0.09, 0.60), (0.09, 0.68)], plain));
    let ring = |major: f64, minor: f64, height: f64, material: Material| {
        Solid::at(Shape::Torus { major, minor }, [at[0], at[1], TOP + height], material)
    };
    solids.push(ring(0.230, 0.018, 0.29, Material::matte(GOLD).metal(0.8)));
    solids.push(ring(0.095, 0.026, 0.60, plain));
    solids.push(ring(0.095, 0.022, 0.69, plain));
    solids
}

/// A flower on a thin stem out of the vase, looking outwards and up.
fn bloom(head: Vec3, colour: Vec3) -> Vec<Solid> {
    let root = [0.10, 0.42, TOP + 0.66];
    let green = Material::matte(LEAF);
    let outward = [head[0] - root[0], head[1] - root[1] - 0.35, 0.55];
    let [x, y, z] = axes_along(outward);
    let petal = Material::matte(colour).glossy(0.15, 20.0);
    let heart = Material::matte([0.98, 0.80, 0.18]);
    let mut solids = vec![Solid::rod(root, head, [0.016, 0.012], green)];
    solids.push(Solid::at(Shape::Sphere { radius: 0.062 }, add(head, scale(z, 0.025)), heart));
    for i in 0..7 {
        let (s, c) = (TAU * f64::from(i) / 7.0).sin_cos();
        let centre = add(head, add(scale(x, 0.115 * c), scale(y, 0.115 * s)));
        solids.push(Solid::at(Shape::Sphere { radius: 0.056 }, centre, petal));
    }
    let node = add(scale(root, 0.62), scale(head, 0.38));
    let tip = add(node, add(scale(x, 0.19), [0.0, 0.0, 0.10]));
    solids.push(Solid::rod(node, tip, [0.032, 0.0], green));
    solids
}

/// A toy: rings of falling size on a peg.
fn ring_tower() -> Vec<Solid> {
    let [x, y] = [-0.50, 0.42];
    let rings = [
        (0.175, [0.86, 0.22, 0.20]),
        (0.150, [0.96, 0.60, 0.14]),
        (0.125, [0.95, 0.84, 0.22]),
        (0.100, [0.28, 0.66, 0.32]),
        (0.075, [0.20, 0.42, 0.78]),
    ];
    let plastic = |colour: Vec3| Material::matte(colour).glossy(0.45, 60.0);
    let mut solids = Vec::new();
    for (i, (major, colour)) in rings.into_iter().enumerate() {
        let height = TOP + 0.06 + 0.108 * i as f64;
        solids.push(Solid::at(Shape::Torus { major, minor: 0.06 }, [x, y, height], plastic(colour)));
    }
    solids.extend(lathe([x, y], &[(0.05, 0.0), (0.045, 0.60)], Material::matte(CREAM)));
    solids.push(Solid::at(Shape::Sphere { radius: 0.075 }, [x, y, TOP + 0.64], plastic([0.86, 0.22, 0.20])));
    solids
}

/// A checkered cube with a mirror ball on it.
fn dice_and_ball() -> Vec<Solid> {
    let [x, y] = [0.58, -0.12];
    let checks = Material::patterned(Pattern::Checker(0.1), [0.16, 0.16, 0.18], [0.94, 0.92, 0.86]).glossy(0.15, 40.0);
    let cube = Solid::at(Shape::Cuboid { half: [0.2; 3] }, [x, y, TOP + 0.2], checks).turned(0.5);
    let steel = Material::matte([0.93, 0.94, 0.96]).metal(0.92);
    vec![cube, Solid::at(Shape::Sphere { radius: 0.165 }, [x, y, TOP + 0.565], steel)]
}

fn apple() -> Vec<Solid> {
    let [x, y] = [0.05, -0.38];
    let skin = Material::matte([0.82, 0.10, 0.12]).glossy(0.75, 70.0);
    let bark = Material::matte([0.32, 0.20, 0.10]);
    let crown = [x, y, TOP + 0.37];
    vec![
        Solid::at(Shape::Sphere { radius: 0.19 }, [x, y, TOP + 0.19], skin),
        Solid::rod([x, y, TOP + 0.36], [x + 0.03, y, TOP + 0.47], [0.012, 0.016], bark),
        Solid::rod(crown, [x + 0.17, y - 0.04, TOP + 0.44], [0.034, 0.0], Material::matte(LEAF)),
    ]
}

fn pencil() -> Vec<Solid> {
    let lacquer = Material::matte([0.98, 0.74, 0.12]).glossy(0.4, 60.0);
    let radius = 0.034;
    let [from, to] = [[-0.62, -0.58, TOP + radius], [-0.10, -0.80, TOP + radius]];
    let at = |s: f64| add(scale(from, 1.0 - s), scale(to, s));
    vec![
        Solid::rod(at(0.0), at(0.10), [radius; 2], Material::matte([0.90, 0.50, 0.54])),
        Solid::rod(at(0.10), at(0.17), [radius; 2], Material::matte([0.80, 0.82, 0.84]).metal(0.7)),
        Solid::rod(at(0.17), at(0.82), [radius; 2], lacquer),
        Solid::rod(at(0.82), at(0.955), [radius, 0.009], Material::matte([0.90, 0.74, 0.52])),
        Solid::rod(at(0.955), at(1.0), [0.009, 0.0], Material::matte([0.12; 3])),
    ]
}

fn candle() -> Vec<Solid> {
    let [x, y] = [0.62, 0.46];
    let wax = Material::patterned(Pattern::Bands(0.12, 0.5), [0.90, 0.42, 0.36], CREAM);
    let wick = Material::matte([0.15; 3]);
    let brass = Material::matte(GOLD).metal(0.75);
    let mut solids = lathe([x, y], &[(0.17, 0.0), (0.15, 0.04)], brass);
    solids.extend(lathe([x, y], &[(0.085, 0.04), (0.085, 0.50)], wax));
    solids.extend(lathe([x, y], &[(0.010, 0.50), (0.010, 0.58)], wick));
    solids
}

/// A thin golden hoop, standing aslant.
fn hoop() -> Vec<Solid> {
    let (major, minor, lean) = (0.15, 0.016, 0.35f64);
    let centre = [0.48, -0.62, TOP + major * lean.cos() + minor];
    let hoop = Solid::at(Shape::Torus { major, minor }, centre, Material::matte(GOLD).metal(0.85));
    vec![hoop.facing([-0.3 * lean.cos(), -lean.cos(), lean.sin()])]
}
