//! The march in f32 on a processor: whole marches of a chunk of rays, and their way back, on packed weights.
//!
//! Of each layer only the normalised numbers are kept; its output is made of them again where gradients of weights ask for
//! it.

mod backward;
mod cell;
mod forward;
mod norm;
mod weights;

pub(super) use forward::Lines;
pub(super) use weights::Network;
