//! The relation of a scene's units to those of its capture's files.

use serde::{Deserialize, Serialize};

use super::pose::{self, Pose, Vec3};

/// A similarity from the capture's units to the scene's, `x_scene = scale * R x_capture + t`. It combines recentring,
/// scaling and spherifying of the poses in the files. Cameras' orientations are rotated by R only.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct WorldToScene {
    /// Scene units per unit of the capture.
    pub scale: f64,
    /// `[R | t]`: a rotation, and the capture's origin in the scene.
    pub rotation_and_origin: Pose,
}

impl Default for WorldToScene {
    /// Scene units are the capture's own.
    fn default() -> WorldToScene {
        let rotation_and_origin = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];
        WorldToScene { scale: 1.0, rotation_and_origin }
    }
}

impl WorldToScene {
    /// Moves cameras so that their mean position is the origin, and scales them so that all coordinates are within [-1,
    /// 1].
    pub fn centre(cameras: &mut [&mut Pose]) -> WorldToScene {
        let mean = pose::mean(cameras.iter().map(|camera| pose::column(camera, 3)));
        let mut largest: f64 = 0.0;
        for (row, mean) in cameras.iter_mut().flat_map(|camera| camera.iter_mut().zip(mean)) {
            row[3] -= mean;
            largest = largest.max(row[3].abs());
        }
        let mut world = WorldToScene::default();
        world.rotation_and_origin.iter_mut().zip(mean).for_each(|(row, mean)| row[3] = -mean);
        // Cameras at one point (a panorama) have no extent to scale by.
        if largest <= 1e-9 {
            return world;
        }
        cameras.iter_mut().flat_map(|camera| camera.iter_mut()).for_each(|row| row[3] /= largest);
        world.scaled(1.0 / largest)
    }

    /// Returns the map followed by a rigid motion of the scene.
    pub fn moved(self, motion: &Pose) -> WorldToScene {
        WorldToScene { rotation_and_origin: pose::compose(motion, &self.rotation_and_origin), ..self }
    }

    /// Returns the map followed by a change of scale about the scene's origin.
    pub fn scaled(self, factor: f64) -> WorldToScene {
        let mut placed = WorldToScene { scale: self.scale * factor, ..self };
        placed.rotation_and_origin.iter_mut().for_each(|row| row[3] *= factor);
        placed
    }

    /// Maps a point of the capture to the scene.
    pub fn point(&self, capture: Vec3) -> Vec3 {
        pose::transform(&self.rotation_and_origin, capture.map(|v| v * self.scale))
    }

    /// Maps a camera of the capture to the scene.
    pub fn camera(&self, capture: &Pose) -> Pose {
        let scaled = capture.map(|[a, b, c, origin]| [a, b, c, origin * self.scale]);
        pose::compose(&self.rotation_and_origin, &scaled)
    }

    /// Maps a point of the scene to the capture's units.
    pub fn to_capture(&self, scene: Vec3) -> Vec3 {
        pose::transform(&pose::inverse_rigid(&self.rotation_and_origin), scene).map(|v| v / self.scale)
    }

    /// Maps a direction of the scene to the capture.
    pub fn direction_to_capture(&self, scene: Vec3) -> Vec3 {
        let rotation = &self.rotation_and_origin;
        std::array::from_fn(|axis| pose::dot(pose::column(rotation, axis), scene))
    }

    /// Returns the matrix `[scale R | t]`, rows.
    pub fn matrix(&self) -> Pose {
        self.rotation_and_origin.map(|[a, b, c, t]| [a * self.scale, b * self.scale, c * self.scale, t])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn centred_cameras_are_those_that_the_way_leads_to() {
        let file: Vec<Pose> = (0..5)
            .map(|i| {
                let i = f64::from(i);
                pose::look_along([i, 1.0, 2.0], [0.0, 0.0, 1.0], [i, 3.0 * i, 7.0 - i * i]).unwrap()
            })
            .collect();
        let mut cameras = file.clone();
        let world = WorldToScene::centre(&mut cameras.iter_mut().collect::<Vec<&mut Pose>>());
        let largest = cameras.iter().flat_map(|camera| pose::column(camera, 3)).map(f64::abs).fold(0.0, f64::max);
        assert!((largest - 1.0).abs() < 1e-12);
        for (file, camera) in file.iter().zip(&cameras) {
            let placed = world.camera(file);
            assert!(placed.iter().flatten().zip(camera.iter().flatten()).all(|(a, b)| (a - b).abs() < 1e-12));
        }
    }

    #[test]
    fn points_and_cameras_go_there_and_back() {
        let motion = pose::look_along([0.3, -0.5, 0.9], [0.1, 1.0, 0.2], [1.0, 2.0, -3.0]).unwrap();
        let world = WorldToScene::default().scaled(2.0).moved(&motion).scaled(0.3);
        let point = [0.4, -1.2, 5.0];
        let scene = world.point(point);
        // Step by step.
        let expected = pose::transform(&motion, point.map(|v| 2.0 * v)).map(|v| 0.3 * v);
        assert!(pose::length(pose::sub(scene, expected)) < 1e-12);
        assert!(pose::length(pose::sub(world.to_capture(scene), point)) < 1e-12);
        let by_matrix = pose::transform(&world.matrix(), point);
        assert!(pose::length(pose::sub(by_matrix, scene)) < 1e-12);
        // A camera's place is a point, and its axes turn back to what they were.
        let camera = pose::look_along([1.0, 0.2, -0.4], [0.0, 0.0, 1.0], point).unwrap();
        let placed = world.camera(&camera);
        assert!(pose::length(pose::sub(pose::column(&placed, 3), scene)) < 1e-12);
        let axis = world.direction_to_capture(pose::column(&placed, 1));
        assert!(pose::length(pose::sub(axis, pose::column(&camera, 1))) < 1e-12);
    }
}
