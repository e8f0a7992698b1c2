//! The feature level: the delta of a trunk layer's output.

use crate::base::Result;
use crate::perturb::geometry::PassGeometry;
use crate::perturb::set::{DeltaSet, Norm};
use crate::perturb::site::{ANY_EPSILON, DefaultSizes, Level, PaperSite, Pgd, Site, SiteNumbers, SiteSpec};

/// Added to the output of a trunk layer, `[rays, samples, width]`.
pub struct Feature {
    /// Its numbers in an experiment.
    pub numbers: SiteNumbers,
}

impl Feature {
    pub(super) const SPEC: SiteSpec = SiteSpec {
        name: "feature",
        level: Level::Feature,
        moves_samples: false,
        sizes: DefaultSizes {
            steps: 1,
            norm: Norm::Linf,
            paper_epsilon: 1e-3,
            paper_step_size: 1e-3,
            calibrated_epsilon: |_| 1e-2,
        },
        largest_epsilon: ANY_EPSILON,
        over_units: true,
        scalar: false,
    };
}

impl Site for Feature {
    fn at(&self) -> PaperSite {
        PaperSite::Feature
    }

    fn pgd(&self) -> Pgd {
        self.numbers.pgd
    }

    fn set(&self, pass: &PassGeometry) -> Result<DeltaSet> {
        let radius = pass.scalar(self.numbers.radius(|epsilon| epsilon))?.reshape((1, 1, 1))?;
        Ok(DeltaSet::new(self.numbers.norm, radius, &[pass.rays()?, pass.samples, pass.run.width]))
    }
}
