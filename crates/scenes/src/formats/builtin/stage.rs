//! The arranged solids, and ray intersections with them.

use super::shading::Light;
use super::shapes::Solid;
use crate::vector::{Vec3, add, along, dot, length, scale, sub};

/// The first intersection of a ray with a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// The point is `origin + t * direction`.
    pub t: f64,
    /// Outward unit normal in the frame of the ray.
    pub normal: Vec3,
    /// Index into [`Stage::solids`].
    pub solid: usize,
}

/// Maps the frame of a scene's cameras to the still life's: `scale * (axes p) + shift`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Still-life units per scene unit.
    pub scale: f64,
    /// Rows of the rotation.
    pub axes: [Vec3; 3],
    /// The scene's origin in the still life.
    pub shift: Vec3,
}

impl Frame {
    /// The map if scene and still life coincide.
    pub const SAME: Frame =
        Frame { scale: 1.0, axes: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], shift: [0.0; 3] };

    /// Maps a scene direction to the still life, where it has `scale` times its length.
    pub fn direction(&self, d: Vec3) -> Vec3 {
        scale(self.axes.map(|row| dot(row, d)), self.scale)
    }

    /// Maps a scene point to the still life.
    pub fn point(&self, p: Vec3) -> Vec3 {
        add(self.direction(p), self.shift)
    }

    /// Maps a still-life point to the scene.
    #[cfg(test)]
    pub(super) fn into_scene(self, p: Vec3) -> Vec3 {
        scale(self.turned_back(sub(p, self.shift)), 1.0 / self.scale)
    }

    /// Maps a still-life unit direction to the scene.
    fn turned_back(&self, d: Vec3) -> Vec3 {
        let [x, y, z] = self.axes;
        add(add(scale(x, d[0]), scale(y, d[1])), scale(z, d[2]))
    }
}

/// Neighbouring solids within a ball. Rays that miss it skip them.
#[derive(Clone, Debug)]
struct Group {
    centre: Vec3,
    radius: f64,
    /// Index of each solid and the radius of its own ball.
    members: Vec<(usize, f64)>,
}

/// Solids in their groups, seen through a frame.
#[derive(Clone, Debug)]
pub struct Stage {
    solids: Vec<Solid>,
    groups: Vec<Group>,
    frame: Frame,
    light: Light,
}

impl Stage {
    /// Creates a stage with objects, each of several solids, in the still life's light.
    pub fn new(objects: Vec<Vec<Solid>>, frame: Frame) -> Stage {
        Stage::lit(objects, frame, Light::of_still_life())
    }

    /// Creates a stage with objects, each of several solids.
    pub fn lit(objects: Vec<Vec<Solid>>, frame: Frame, light: Light) -> Stage {
        let mut first = 0;
        let groups = objects.iter().map(|solids| {
            first += solids.len();
            Group::around(solids, first - solids.len())
        });
        let groups = groups.collect();
        Stage { solids: objects.into_iter().flatten().collect(), groups, frame, light }
    }

    /// Returns the lights.
    pub fn light(&self) -> &Light {
        &self.light
    }

    /// Returns every solid, in still-life coordinates.
    pub fn solids(&self) -> &[Solid] {
        &self.solids
    }

    /// Returns the map from the cameras' frame to the solids'.
    pub fn frame(&self) -> &Frame {
        &self.frame
    }

    /// Returns the first intersection of a ray in the cameras' frame with a surface. `direction` may have any length
    /// but 0.
    pub fn first_hit(&self, origin: Vec3, direction: Vec3) -> Option<Hit> {
        let hit = self.nearest(self.frame.point(origin), self.frame.direction(direction))?;
        Some(Hit { normal: self.frame.turned_back(hit.normal), ..hit })
    }

    /// Returns the signed distance of a point in the cameras' frame to the nearest solid, in that frame's units. It is
    /// exact outside, and a bound inside where solids overlap.
    pub fn distance(&self, point: Vec3) -> f64 {
        let p = self.frame.point(point);
        self.solids.iter().map(|solid| solid.distance(p)).fold(f64::INFINITY, f64::min) / self.frame.scale
    }

    /// Returns the first hit of a ray in still-life coordinates.
    pub(super) fn nearest(&self, origin: Vec3, direction: Vec3) -> Option<Hit> {
        let mut best = (f64::INFINITY, usize::MAX);
        for index in self.candidates(origin, direction) {
            match self.solids[index].first_crossing(origin, direction, 0.0) {
                Some(t) if t < best.0 => best = (t, index),
                _ => {}
            }
        }
        let (t, solid) = best;
        let normal = self.solids.get(solid)?.normal(along(origin, direction, t));
        Some(Hit { t, normal, solid })
    }

    /// Returns whether anything is on a still-life ray before `reach`.
    pub(super) fn blocked(&self, origin: Vec3, direction: Vec3, reach: f64) -> bool {
        self.candidates(origin, direction)
            .any(|index| self.solids[index].first_crossing(origin, direction, 0.0).is_some_and(|t| t < reach))
    }

    /// Iterates over solids whose bounding balls a ray meets.
    fn candidates(&self, origin: Vec3, direction: Vec3) -> impl Iterator<Item = usize> {
        let speed2 = dot(direction, direction);
        let meets = move |centre: Vec3, radius: f64| {
            let offset = sub(centre, origin);
            let ahead = dot(offset, direction);
            let gap2 = dot(offset, offset) - radius * radius;
            gap2 <= 0.0 || (ahead > 0.0 && ahead * ahead >= gap2 * speed2)
        };
        let groups = self.groups.iter().filter(move |group| meets(group.centre, group.radius));
        let members = groups.flat_map(|group| group.members.iter().copied());
        members.filter(move |&(index, radius)| meets(self.solids[index].centre, radius)).map(|(index, _)| index)
    }
}

impl Group {
    /// Creates the group of `solids`, whose indices start at `first`.
    fn around(solids: &[Solid], first: usize) -> Group {
        let sum = solids.iter().fold([0.0; 3], |sum, solid| add(sum, solid.centre));
        let centre = scale(sum, 1.0 / solids.len().max(1) as f64);
        let reach = |solid: &Solid| length(sub(solid.centre, centre)) + solid.shape.bound();
        Group {
            centre,
            radius: solids.iter().map(reach).fold(0.0, f64::max),
            members: solids.iter().enumerate().map(|(i, solid)| (first + i, solid.shape.bound())).collect(),
        }
    }
}
