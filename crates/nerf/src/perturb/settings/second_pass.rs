//! `perturb.kind`: the second pass of a step, and the source of its deltas.

use serde::{Deserialize, Serialize};

/// The second pass of a step: the clean pass with deltas at the sites, by their source, or another clean pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SecondPass {
    /// PGD on the perturbed loss.
    WorstCase,
    /// Normal samples of standard deviation epsilon/sqrt(3), projected onto the same constraint sets.
    Gaussian,
    /// Uniform samples in the same constraint sets.
    Uniform,
    /// PGD down the perturbed loss: as much search, the other way.
    BestCase,
    /// The worst case of the rays, each given to another ray: deltas of the same sizes that answer nothing.
    Permuted,
    /// Another clean pass with new jitter, noise and samples: the control of equal loss weight. Nothing is searched. It
    /// costs two of NeRF's steps, where the worst case with the paper's three PGD steps costs four.
    FreshJitter,
}

impl SecondPass {
    /// Returns whether the pass has deltas.
    pub fn perturbs(self) -> bool {
        self != SecondPass::FreshJitter
    }

    /// Returns whether PGD searches the deltas.
    pub fn searches(self) -> bool {
        matches!(self, SecondPass::WorstCase | SecondPass::BestCase | SecondPass::Permuted)
    }
}
