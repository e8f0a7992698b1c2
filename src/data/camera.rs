//! Pinhole cameras and pixel rays.

/// A pinhole camera with square-free intrinsics and a camera-to-world pose, OpenGL axes
/// (x right, y up, z towards the viewer).
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

/// The projection to normalised device coordinates of forward-facing scenes
/// (NeRF paper, appendix C; near plane 1).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ndc {
    /// Image width in pixels.
    pub width: f64,
    /// Image height in pixels.
    pub height: f64,
    /// Focal length in pixels.
    pub focal: f64,
}

impl Camera {
    /// Every ray of the view goes towards -z, as NDC needs.
    pub fn faces_forward(&self) -> bool {
        let corners = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)];
        corners.into_iter().all(|(x, y)| self.ray(x * self.width as f64, y * self.height as f64).1[2] < -1e-3)
    }

    /// The world ray through pixel coordinates (`x`, `y`): origin and direction with unit
    /// z-component in the camera frame, so that `t` is depth along the view axis.
    pub fn ray(&self, x: f64, y: f64) -> ([f64; 3], [f64; 3]) {
        let local = [(x - self.centre[0]) / self.focal[0], -(y - self.centre[1]) / self.focal[1], -1.0];
        let row = |r: &[f64; 4]| r[0] * local[0] + r[1] * local[1] + r[2] * local[2];
        (self.pose.map(|r| r[3]), [row(&self.pose[0]), row(&self.pose[1]), row(&self.pose[2])])
    }
}

impl Ndc {
    /// Maps a world ray to NDC: `t` in 0..1 covers the near plane at 1 to infinity.
    pub fn map(&self, origin: [f64; 3], direction: [f64; 3]) -> ([f64; 3], [f64; 3]) {
        const NEAR: f64 = 1.0;
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
}
