//! Distances between surfaces, from random points on both.
//!
//! The paper's Chamfer distance is the mean distance from a point of the first surface to the nearest point of the
//! second, plus the reverse (appendix, "Geometry extraction"; Euclidean, not squared). Finitely many points stand for
//! each surface, so that even two samples of one surface are at a distance. That distance is reported next to the
//! result.

use rayon::prelude::*;

use augnerf_base::rng::{Random, Stream};
use augnerf_base::{Error, Result};
use augnerf_scenes::formats::builtin::{self, Stage};
use augnerf_scenes::vector::{Vec3, add, length, scale};

use super::Mesh;
use super::nearest::PointTree;

/// Required free space before a facet of the built-in scene. Half of it is certain, because facets are up to 1.3e-3
/// inside round solids.
const BEFORE: f64 = 4e-3;

/// Points on a surface.
#[derive(Clone, Debug, PartialEq)]
pub struct PointCloud {
    /// In scene units.
    pub points: Vec<Vec3>,
    /// Area of the surface.
    pub area: f64,
}

impl PointCloud {
    /// Returns the expected distance from a point of the surface to the nearest random point, if the surface is flat at
    /// that scale: 1/2 sqrt(area / count).
    fn spacing(&self) -> f64 {
        0.5 * (self.area / self.points.len() as f64).sqrt()
    }
}

/// Returns `count` random points on a mesh, each in its own equal part of the area, in the order of triangles. Equal
/// meshes give equal points. A mesh without area is an error.
pub fn sample(mesh: &Mesh, count: usize, seed: u64) -> Result<PointCloud> {
    sample_where(mesh, count, seed, |_, _| true)
}

/// The same without the points for which `keep` (number of the triangle, point) is false.
fn sample_where(mesh: &Mesh, count: usize, seed: u64, keep: impl Fn(usize, Vec3) -> bool) -> Result<PointCloud> {
    let mut ends: Vec<f64> = Vec::with_capacity(mesh.triangles.len());
    let mut area = 0.0;
    for part in mesh.areas() {
        area += part;
        ends.push(area);
    }
    if !(area.is_finite() && area > 0.0) {
        return Err(Error::Data(format!(
            "a mesh of {} triangles has an area of {area}: there is no surface to draw points on",
            mesh.triangles.len()
        )));
    }
    let mut random = Random::new(seed, Stream::Surface, 0);
    let mut points = Vec::with_capacity(count);
    let mut triangle = 0;
    for i in 0..count {
        let at = (i as f64 + random.uniform()) / count as f64 * area;
        while ends[triangle] <= at && triangle + 1 < ends.len() {
            triangle += 1;
        }
        let (u, v) = (random.uniform().sqrt(), random.uniform());
        let [a, b, c] = mesh.corners(mesh.triangles[triangle]);
        let point = add(scale(a, 1.0 - u), add(scale(b, u * (1.0 - v)), scale(c, u * v)));
        if keep(triangle, point) {
            points.push(add(point, mesh.origin));
        }
    }
    let share = points.len() as f64 / count as f64;
    Ok(PointCloud { points, area: area * share })
}

/// The surface with which a mesh is compared.
pub enum Reference {
    /// A mesh as it is, including hidden surfaces.
    Mesh(Mesh),
    /// The built-in scene with cameras all around: triangles whose corners are on it.
    Builtin(Box<Stage>),
}

impl Reference {
    /// Returns the built-in scene, or that of a seed, as its Blender-style cameras see it.
    pub fn builtin(seed: Option<u64>) -> Reference {
        Reference::Builtin(Box::new(builtin::blender_stage(seed)))
    }

    /// Returns at most `count` points. For the built-in scene it removes points with another solid directly in front.
    /// Its objects stand on and in one another, and where they touch or overlap there is no surface. The underside of
    /// its board, which no camera sees, stays.
    pub fn sample(&self, count: usize, seed: u64) -> Result<PointCloud> {
        let stage = match self {
            Reference::Mesh(mesh) => return sample(mesh, count, seed),
            Reference::Builtin(stage) => stage,
        };
        let builtin::Mesh { vertices, triangles, .. } = builtin::Mesh::of(stage);
        let mesh = Mesh { vertices, triangles, ..Mesh::default() };
        let has_room = |triangle: usize, point: Vec3| {
            let facing = mesh.area_vector(mesh.triangles[triangle]);
            stage.distance(add(point, scale(facing, BEFORE / length(facing)))) > 0.5 * BEFORE
        };
        sample_where(&mesh, count, seed, has_room)
    }
}

/// The distance between two surfaces.
#[derive(Clone, Debug, PartialEq)]
pub struct Chamfer {
    /// Sum of both means below: the paper's distance.
    pub chamfer: f64,
    /// Mean distance from a point of the mesh to the nearest of the reference.
    pub mesh_to_reference: f64,
    /// Mean distance from a point of the reference to the nearest of the mesh.
    pub reference_to_mesh: f64,
    /// The expected value of the first for two samples of one surface with as many points. Differences well below it
    /// have no meaning.
    pub floor: f64,
    /// Harmonic mean of precision and recall (Knapitsch et al. 2017, Tanks and Temples): the fractions of the mesh's and
    /// of the reference's points that are near the other surface.
    pub f_score: f64,
}

/// Compares two surfaces through random points on them. Points of a distance of at most `at` are near. Both need at
/// least one point.
pub fn chamfer(mesh: &PointCloud, reference: &PointCloud, at: f64) -> Result<Chamfer> {
    let (to_reference, to_mesh) = (distances(mesh, reference)?, distances(reference, mesh)?);
    let mean = |distances: &[f64]| distances.iter().sum::<f64>() / distances.len() as f64;
    let near = |distances: &[f64]| {
        distances.iter().filter(|&&distance| distance <= at).count() as f64 / distances.len() as f64
    };
    let (precision, recall) = (near(&to_reference), near(&to_mesh));
    let (mesh_to_reference, reference_to_mesh) = (mean(&to_reference), mean(&to_mesh));
    Ok(Chamfer {
        chamfer: mesh_to_reference + reference_to_mesh,
        mesh_to_reference,
        reference_to_mesh,
        floor: mesh.spacing() + reference.spacing(),
        f_score: if precision + recall > 0.0 { 2.0 * precision * recall / (precision + recall) } else { 0.0 },
    })
}

/// Returns the distance from each point of one cloud to the nearest of another.
fn distances(from: &PointCloud, to: &PointCloud) -> Result<Vec<f64>> {
    if from.points.is_empty() || to.points.is_empty() {
        return Err(Error::Data("a surface without points has no distance to any other".into()));
    }
    let tree = PointTree::new(&to.points);
    let nearest = |point: &Vec3| tree.squared_distance(*point).sqrt();
    Ok(from.points.par_iter().with_min_len(4096).map(nearest).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use augnerf_scenes::settings::{DataConfig, DataKind};
    use augnerf_scenes::vector::along;

    /// A sphere of triangles.
    fn sphere(radius: f64, centre: Vec3) -> Mesh {
        const RINGS: u32 = 64;
        let point = |i: u32, j: u32| {
            let (s, c) = (std::f64::consts::PI * f64::from(i) / f64::from(RINGS)).sin_cos();
            let (t, d) = (std::f64::consts::TAU * f64::from(j) / f64::from(RINGS)).sin_cos();
            add(centre, scale([s * d, s * t, c], radius)).map(|v| v as f32)
        };
        let vertices = (0..=RINGS).flat_map(|i| (0..RINGS).map(move |j| point(i, j))).collect();
        let cell = |i: u32, j: u32| {
            let at = |i: u32, j: u32| i * RINGS + j % RINGS;
            [[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]]
        };
        let triangles = (0..RINGS).flat_map(|i| (0..RINGS).flat_map(move |j| cell(i, j))).collect();
        Mesh { vertices, triangles, ..Mesh::default() }
    }

    #[test]
    fn points_lie_evenly_on_the_surface() {
        let cloud = sample(&sphere(0.5, [0.0; 3]), 20_000, 3).unwrap();
        assert!((cloud.area - 4.0 * std::f64::consts::PI * 0.25).abs() < 5e-3, "{}", cloud.area);
        let radius = |p: &Vec3| augnerf_scenes::vector::length(*p);
        assert!(cloud.points.iter().all(|p| (radius(p) - 0.5).abs() < 2e-3));
        // A sphere's area is even in height: the mean of z^2 is r^2 / 3, with a standard error under 6e-4.
        let height = cloud.points.iter().map(|p| p[2] * p[2]).sum::<f64>() / 20_000.0;
        assert!((height - 0.25 / 3.0).abs() < 3e-3, "{height}");
    }

    #[test]
    fn a_mesh_is_0_from_itself_and_the_floor_from_another_drawing() {
        let mesh = sphere(0.5, [0.0; 3]);
        let cloud = |seed| sample(&mesh, 20_000, seed).unwrap();
        let same = chamfer(&cloud(0), &cloud(0), 1e-9).unwrap();
        assert_eq!((same.chamfer, same.f_score), (0.0, 1.0));
        let drawn = chamfer(&cloud(0), &cloud(1), 0.0).unwrap();
        // Points in equal shares of the area lie a little more evenly than scattered ones.
        assert!((drawn.chamfer / drawn.floor - 1.0).abs() < 0.1, "{drawn:?}");
    }

    #[test]
    fn spheres_are_as_far_apart_as_their_radii_or_shift_say() {
        let cloud = |radius: f64, x: f64, seed: u64| sample(&sphere(radius, [x, 0.0, 0.0]), 40_000, seed).unwrap();
        // Concentric: 0.1 each way.
        let rings = |at: f64| chamfer(&cloud(0.5, 0.0, 0), &cloud(0.6, 0.0, 1), at).unwrap();
        assert!((rings(0.05).chamfer - 0.2).abs() < 4e-3, "{:?}", rings(0.05));
        assert_eq!((rings(0.05).f_score, rings(0.2).f_score), (0.0, 1.0));
        // Shifted by s: the nearest point is | |p - s| - r | away, whose mean over the sphere is close to s / 2.
        let shifted = chamfer(&cloud(0.5, 0.0, 0), &cloud(0.5, 0.1, 1), 0.0).unwrap();
        assert!((shifted.mesh_to_reference - 0.05).abs() < 2e-3, "{shifted:?}");
        assert!((shifted.reference_to_mesh - shifted.mesh_to_reference).abs() < 1e-3, "{shifted:?}");
        // Apart: from p on the first, |p - 3| - 0.5, whose mean over the sphere is (3 + r^2 / 9) - 0.5.
        let apart = chamfer(&cloud(0.5, 0.0, 0), &cloud(0.5, 3.0, 1), 0.0).unwrap();
        assert!((apart.mesh_to_reference - (2.5 + 0.25 / 9.0)).abs() < 3e-3, "{apart:?}");
    }

    #[test]
    fn flat_meshes_with_equal_coordinates_can_be_searched() {
        let vertices = vec![[0.0, 0.0, 0.5], [1.0, 0.0, 0.5], [1.0, 1.0, 0.5], [0.0, 1.0, 0.5]];
        let mesh = Mesh { vertices, triangles: vec![[0, 1, 2], [0, 2, 3]], ..Mesh::default() };
        let cloud = sample(&mesh, 5_000, 0).unwrap();
        assert_eq!(chamfer(&cloud, &cloud, 0.0).unwrap().chamfer, 0.0);
        let point = PointCloud { points: vec![[0.5; 3]; 1_000], area: 1.0 };
        assert_eq!(chamfer(&point, &point, 0.0).unwrap().chamfer, 0.0);
        let nothing = PointCloud { points: Vec::new(), area: 1.0 };
        assert!(chamfer(&point, &nothing, 0.0).unwrap_err().to_string().contains("without points"));
        let line = Mesh { triangles: vec![[0, 1, 0]], ..mesh };
        assert!(sample(&line, 10, 0).unwrap_err().to_string().contains("area of 0"));
    }

    #[test]
    fn the_embedded_scene_hides_what_lies_within_it() {
        let reference = Reference::builtin(None);
        let Reference::Builtin(stage) = &reference else { unreachable!() };
        let cloud = reference.sample(20_000, 0).unwrap();
        assert!(cloud.points.iter().all(|&p| stage.distance(p) > -BEFORE), "none is left inside of a solid");
        // Board and foot touch in a disc, which is a third of all that is hidden.
        let touching = |p: &&Vec3| (p[2] + 0.81).abs() < 1e-3 && p[0].hypot(p[1]) < 0.83;
        assert_eq!(cloud.points.iter().filter(touching).count(), 0);
        assert!((0.6..0.8).contains(&(cloud.points.len() as f64 / 20_000.0)), "{}", cloud.points.len());

        // Whatever a camera sees is still there.
        let (mut seen, mut rays) = (Vec::new(), 0);
        let config = DataConfig { kind: DataKind::BuiltinBlender, width: 24, ..DataConfig::default() };
        for view in builtin::load_blender(&config).unwrap().test {
            for pixel in 0..24 * 24 {
                let (origin, direction) = view.camera.ray(f64::from(pixel % 24), f64::from(pixel / 24));
                seen.extend(stage.first_hit(origin, direction).map(|hit| along(origin, direction, hit.t)));
                rays += 1;
            }
        }
        assert!(seen.len() > rays / 5, "{} of {rays} rays hit", seen.len());
        let seen = PointCloud { points: seen, area: cloud.area };
        let farthest = distances(&seen, &cloud).unwrap().into_iter().fold(0.0, f64::max);
        // Of scattered points one in e^18 would have none so near.
        assert!(farthest < 6.0 * cloud.spacing(), "{farthest} for a spacing of {}", cloud.spacing());
    }
}
