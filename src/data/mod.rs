//! Scenes: posed images split into training, validation and held-out views.

pub mod builtin;
pub mod camera;
pub mod rays;

pub use camera::{Camera, Ndc};
pub use rays::{RayBuffer, Rays};

/// An image in memory: row-major, `pixels[(y * width + x) * channels + c]`, values in 0..=1.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// 3 (RGB) or 4 (RGBA, straight alpha).
    pub channels: usize,
    /// `height * width * channels` values.
    pub pixels: Vec<f32>,
}

/// One posed photograph.
#[derive(Clone, Debug)]
pub struct View {
    /// The file's stem, or the embedded scene's view name; unique within its split.
    pub name: String,
    /// Intrinsics and pose.
    pub camera: Camera,
    /// RGB on the scene's background, `camera.width x camera.height`.
    pub image: Image,
    /// Ground-truth depth along the view's z axis in scene units, row-major, where the scene has
    /// it exactly; `f32::INFINITY` where the ray hits nothing.
    pub depth: Option<Vec<f32>>,
}

/// A loaded scene, ready for training: every pose final, every image at the working resolution.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The folder's name, or `builtin`.
    pub name: String,
    /// `llff`, `blender`, `transforms`, `builtin-blender`, `builtin-forward`.
    pub kind: &'static str,
    /// Views that are trained on.
    pub train: Vec<View>,
    /// Held-out views that metrics are computed on.
    pub test: Vec<View>,
    /// Start of a ray's interval, in the units of `t_vals` (0 under NDC).
    pub near: f64,
    /// End of a ray's interval (1 under NDC).
    pub far: f64,
    /// Set when rays are mapped to normalised device coordinates.
    pub ndc: Option<Ndc>,
    /// Background colour that pixels without accumulation show; `None` for opaque photographs.
    pub background: Option<[f32; 3]>,
    /// Cameras of the scene's usual video path (spiral or orbit), at the working resolution.
    pub path: Vec<Camera>,
}
