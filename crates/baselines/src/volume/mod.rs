//! Neural Volumes (Lombardi, Simon, Saragih, Schwartz, Lehrmann and Sheikh 2019), for one still scene.
//!
//! A decoder makes a volume of colour and opacity, and a warp, from a code. Rays accumulate the volume until they are
//! full:
//!
//! ```text
//! z ─► template [R, R, R, 4]: softplus(100 + 25 raw) of red, green, blue, softplus(raw) of opacity
//!  └─► warp [r, r, r, 3]: x ─► sum_i w_i(A_i(x)) A_i(x) / sum_i w_i(A_i(x)), 16 affine maps A_i with weights w_i on lattices
//! sample at x: template(warp(x)), both trilinear in [-1, 1]^3        A_k = min(1, A_k-1 + opacity_k step_k)
//! loss = mean ((C - C*) / 25)^2 + 0.01 accumulation prior + 0.01 variation of ln opacity (+ 0.001 KL), colours 0..255
//! ```
//!
//! The original's encoder reads images of the current moment. In a still scene these are always the same, so that the
//! code, or its normal distribution, is learned.

mod cube;
mod decoder;
mod density;
mod learner;
mod parameters;
mod renderer;
#[cfg(test)]
mod tests;

pub use density::VolumeDensity;
pub use learner::VolumeLearner;
pub use parameters::NeuralVolume;
pub use renderer::VolumeRenderer;
