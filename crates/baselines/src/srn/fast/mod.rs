//! The march in f32 on the CPU: forward and backward passes of a chunk of rays, on packed weights.
//!
//! Only the normalized numbers of each layer are kept. Its output is recomputed from them for weight gradients.

mod backward;
mod cell;
mod forward;
mod norm;
mod weights;

pub(super) use forward::Lines;
pub(super) use weights::Network;
