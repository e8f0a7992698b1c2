//! `perturb.kind`: what a step's second pass is, and where its deltas come from.

use serde::{Deserialize, Serialize};

/// What a step's second pass is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "Kind", into = "Kind")]
pub enum SecondPass {
    /// The clean pass with deltas at the sites.
    Perturbed(DeltaSource),
    /// Another clean pass with fresh jitter, noise and samples: the control of equal loss weight. Nothing is searched, so that
    /// it costs two of NeRF's steps where the worst case costs four with the paper's three steps of ascent.
    Clean,
}

/// Where the deltas of a perturbed pass come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeltaSource {
    /// Projected gradient ascent on the perturbed loss.
    WorstCase,
    /// Normal draws of std epsilon/sqrt(3), projected to the same sets.
    Gaussian,
    /// Uniform draws in the same sets.
    Uniform,
}

/// The names of `perturb.kind`.
#[derive(Clone, Copy, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Kind {
    WorstCase,
    Gaussian,
    Uniform,
    #[serde(alias = "clean")]
    FreshJitter,
}

impl From<Kind> for SecondPass {
    fn from(kind: Kind) -> SecondPass {
        match kind {
            Kind::WorstCase => SecondPass::Perturbed(DeltaSource::WorstCase),
            Kind::Gaussian => SecondPass::Perturbed(DeltaSource::Gaussian),
            Kind::Uniform => SecondPass::Perturbed(DeltaSource::Uniform),
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
            SecondPass::Clean => Kind::FreshJitter,
        }
    }
}
