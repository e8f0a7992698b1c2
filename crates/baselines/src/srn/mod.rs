//! Scene Representation Networks (Sitzmann, Zollhoefer and Wetzstein 2019), one network per scene.
//!
//! A network Phi gives every point x of space a feature. A ray starts a little in front of its camera. An LSTM reads
//! the features along the ray and computes the length of each step:
//!
//! ```text
//! x_0 = o + z_0 d        v_s = Phi(x_s)        (h, c)_s+1 = LSTM(v_s, (h, c)_s)
//! delta_s+1 = w . h_s+1 + b        x_s+1 = x_s + delta_s+1 u        z = z_0 + sum of delta / |d|
//! colour = G(Phi(x_T))
//! ```
//!
//! `o`, `d` and `u` are a ray's origin, direction and unit direction, z a depth along `d`. A scene is opaque, and its
//! background is learned as well.

mod cell;
mod learner;
mod network;
mod renderer;
mod step;
#[cfg(test)]
mod tests;

pub use learner::SrnLearner;
pub use network::Srn;
pub use renderer::SrnRenderer;
