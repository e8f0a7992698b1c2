//! Weights of nerf-pytorch: checkpoints (`.tar`, `.pth`, `.pt` of `torch.save`), which are read only.

mod import;
mod nerf_pytorch;

pub use import::Foreign;
