//! Pinhole cameras and pixel rays.

/// A pinhole camera with intrinsics without skew, and a camera-to-world pose in OpenGL axes (x right, y up, z towards
/// the viewer).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Columns of the image.
    pub width: usize,
    /// Rows of the image.
    pub height: usize,
    /// Focal lengths in pixels, x and y.
    pub focal: [f64; 2],
    /// Principal point in pixels, x and y.
    pub centre: [f64; 2],
    /// Camera-to-world matrix, rows of `[R | origin]`, scene units.
    pub pose: [[f64; 4]; 3],
}

/// The projection to normalized device coordinates of forward-facing scenes (NeRF paper, appendix C; near plane 1).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ndc {
    /// Image width in pixels.
    pub width: f64,
    /// Image height in pixels.
    pub height: f64,
    /// Focal length in pixels.
    pub focal: f64,
}

/// Distance of the plane where NDC begin.
const NEAR: f64 = 1.0;

impl Camera {
    /// Returns the camera for an image of another size with the same vertical field of view. The horizontal field of
    /// view follows from the size.
    pub fn with_size(&self, width: usize, height: usize) -> Camera {
        let scale = height as f64 / self.height as f64;
        let centre = [0.5 * width as f64 + (self.centre[0] - 0.5 * self.width as f64) * scale, self.centre[1] * scale];
        Camera { width, height, focal: self.focal.map(|focal| focal * scale), centre, ..*self }
    }

    /// Returns the camera for another height and the same aspect ratio.
    pub fn with_height(&self, height: usize) -> Camera {
        let width = (self.width as f64 * height as f64 / self.height as f64).round().max(1.0);
        self.with_size(width as usize, height)
    }

    /// Returns whether every ray of the view goes towards -z, as NDC need.
    pub fn faces_forward(&self) -> bool {
        let corners = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)];
        corners.into_iter().all(|(x, y)| self.ray(x * self.width as f64, y * self.height as f64).1[2] < -1e-3)
    }

    /// Returns whether the camera stands before the plane where NDC begin.
    pub fn is_before_ndc(&self) -> bool {
        self.pose[2][3] >= -NEAR
    }

    /// Returns the world ray through pixel coordinates (`x`, `y`): origin, and direction with unit z-component in the
    /// camera frame. `t` is then depth along the view axis.
    pub fn ray(&self, x: f64, y: f64) -> ([f64; 3], [f64; 3]) {
        let local = [(x - self.centre[0]) / self.focal[0], -(y - self.centre[1]) / self.focal[1], -1.0];
        let row = |r: &[f64; 4]| r[0] * local[0] + r[1] * local[1] + r[2] * local[2];
        (self.pose.map(|r| r[3]), [row(&self.pose[0]), row(&self.pose[1]), row(&self.pose[2])])
    }
}

impl Ndc {
    /// Returns the depth of a world ray at `t` of the ray in NDC, in lengths of its direction. It is infinite from 1
    /// on.
    pub fn world_t(origin: [f64; 3], direction: [f64; 3], t: f64) -> f64 {
        let z = -NEAR / (1.0 - t).max(0.0);
        (z - origin[2]) / direction[2]
    }

    /// Maps a world ray to NDC: `t` in 0..1 covers the near plane at 1 to infinity.
    pub fn map(&self, origin: [f64; 3], direction: [f64; 3]) -> ([f64; 3], [f64; 3]) {
        let shift = -(NEAR + origin[2]) / direction[2];
        let o: [f64; 3] = std::array::from_fn(|i| origin[i] + shift * direction[i]);
        let d = direction;
        let sx = -2.0 * self.focal / self.width;
        let sy = -2.0 * self.focal / self.height;
        (
            [sx * o[0] / o[2], sy * o[1] / o[2], 1.0 + 2.0 * NEAR / o[2]],
            [sx * (d[0] / d[2] - o[0] / o[2]), sy * (d[1] / d[2] - o[1] / o[2]), -2.0 * NEAR / o[2]],
        )
    }

    /// Returns the world point of a point in NDC, or `None` from the plane z = 1 on, which is infinitely far.
    pub fn unmap(&self, point: [f64; 3]) -> Option<[f64; 3]> {
        let z = 2.0 / (point[2] - 1.0);
        let across = |at: f64, size: f64| -0.5 * at * z * size / self.focal;
        (z < 0.0).then(|| [across(point[0], self.width), across(point[1], self.height), z])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NDC: Ndc = Ndc { width: 40.0, height: 30.0, focal: 35.0 };

    #[test]
    fn points_return_from_ndc() {
        let (origin, direction) = ([0.1, -0.2, 0.3], [0.2, 0.1, -1.0]);
        let (o, d) = NDC.map(origin, direction);
        for t in [0.0, 0.3, 0.9] {
            let world = NDC.unmap(std::array::from_fn(|i| o[i] + t * d[i])).unwrap();
            let s = (world[2] - origin[2]) / direction[2];
            assert!((0..3).all(|i| (world[i] - origin[i] - s * direction[i]).abs() < 1e-12), "{t}: {world:?}");
            assert!((Ndc::world_t(origin, direction, t) - s).abs() < 1e-12);
        }
        assert_eq!(NDC.unmap([0.0, 0.0, 1.0]), None);
        assert_eq!(Ndc::world_t(origin, direction, 1.0), f64::INFINITY);
    }
}
