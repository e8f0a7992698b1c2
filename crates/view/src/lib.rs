//! The page on which runs are looked at live: a server on one port, which renders what the page asks for.
//!
//! A [`ShownRun`] has a run's weights, perhaps of a training that goes on. [`Server`] answers the page: pictures, known
//! cameras with their photographs, samples along a ray, a camera path as a file. Everything is in the program: the page
//! loads nothing from elsewhere.
//!
//! The viewer's pictures may skip empty space ([`EmptySpace`]), so they can differ from `augnerf render`'s in their last digits.

#![warn(missing_docs)]

pub(crate) use augnerf_nerf::{field, methods, perturb, render, runtime, settings};
pub(crate) use augnerf_run::{model, run};
pub(crate) use {augnerf_base as base, augnerf_draw as draw, augnerf_scenes as data};

mod empty_space;
mod http;
mod perturbed;
mod picture;
mod pictures;
mod queue;
mod request;
mod router;
mod samples;
mod server;
mod shown;
mod skipping;

pub use empty_space::EmptySpace;
pub use perturbed::{Attack, PerturbedRenderer};
pub use picture::{Layer, draw_layer};
pub use server::Server;
pub use shown::{ShownRun, Weights};
pub use skipping::SkippingRenderer;
