//! `perturb.kind`: the second pass of a step, and the source of its deltas.

use serde::{Deserialize, Serialize};

/// The second pass of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "Kind", into = "Kind")]
pub enum SecondPass {
    /// The clean pass with deltas at the sites.
    Perturbed(DeltaSource),
    /// Another clean pass with new jitter, noise and samples: the control of equal loss weight. Nothing is searched. It
    /// costs two of NeRF's steps, where the worst case with the paper's three PGD steps costs four.
    Clean,
}

/// The source of the deltas of a perturbed pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeltaSource {
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
}

impl DeltaSource {
    /// Returns whether PGD searches the deltas.
    pub fn searches(self) -> bool {
        matches!(self, DeltaSource::WorstCase | DeltaSource::BestCase | DeltaSource::Permuted)
    }
}

/// The names of `perturb.kind`.
#[derive(Clone, Copy, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Kind {
    WorstCase,
    Gaussian,
    Uniform,
    BestCase,
    Permuted,
    FreshJitter,
}

impl From<Kind> for SecondPass {
    fn from(kind: Kind) -> SecondPass {
        match kind {
            Kind::WorstCase => SecondPass::Perturbed(DeltaSource::WorstCase),
            Kind::Gaussian => SecondPass::Perturbed(DeltaSource::Gaussian),
            Kind::Uniform => SecondPass::Perturbed(DeltaSource::Uniform),
            Kind::BestCase => SecondPass::Perturbed(DeltaSource::BestCase),
            Kind::Permuted => SecondPass::Perturbed(DeltaSource::Permuted),
            Kind::FreshJitter => SecondPass::Clean,
        }
    }
}

impl From<SecondPass> for Kind {
    fn from(second: SecondPass) -> Kind {
        match second {
            SecondPass::Perturbed(DeltaSource::WorstCase) => Kind::WorstCase,
            SecondPass::Perturbed(DeltaSource::Gaussian) => Kind::Gaussian,
            SecondPass::Perturbed(DeltaSource::Uniform) => Kind::Uniform,
            SecondPass::Perturbed(DeltaSource::BestCase) => Kind::BestCase,
            SecondPass::Perturbed(DeltaSource::Permuted) => Kind::Permuted,
            SecondPass::Clean => Kind::FreshJitter,
        }
    }
}
