//! The table of a site in section `perturb`.

use serde::{Deserialize, Serialize};

use crate::base::settings::{numbers, section};
use crate::perturb::{Epsilon, Norm, PaperSite, Passes, Pgd, SiteNumbers, StepUnit};

const NUMBERS: &[&str] = &["attack_numbers", "step_over_radius"];

/// The steps, step sizes and epsilons that fill the sites' empty fields.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sizes {
    /// The paper's best steps and step sizes.
    #[default]
    Paper,
    /// Ours: every delta is large enough to matter, with step size 2.5 epsilon / steps.
    Calibrated,
}

section! {
    /// One site. `perturb.attack` fills its empty numbers.
    pub struct SiteConfig {
        /// Passes with this delta: `both`, `coarse`, `fine` or `off`.
        pub passes: Passes = Passes::Both, numbers().columns(&["levels"]);
        /// PGD steps; 0 keeps the random start. Empty = the number of `perturb.attack`.
        pub steps: Option<usize> = None, numbers().whole(0, 1000, "0 to 1000").columns(NUMBERS);
        /// Length of one PGD step, in `perturb.step_unit`. Empty = the length of `perturb.attack`.
        pub step_size: Option<f64> = None,
            numbers().zero_or_positive().columns(NUMBERS).same_time();
        /// Size of the constraint set. 0 = no perturbation. `reach` = `steps` x `step_size` in the delta's own unit
        /// (`perturb.step_unit = "absolute"`). Empty = the size of `perturb.attack`.
        pub epsilon: Option<Epsilon> = None,
            numbers().zero_or_positive().columns(NUMBERS).same_time();
        /// Norm of the constraint set. Empty = the site's own.
        pub norm: Option<Norm> = None, numbers().columns(&["norms"]);
    }
    sections {}
}

impl SiteConfig {
    /// Returns whether any pass has this delta.
    pub fn on(&self) -> bool {
        self.passes != Passes::Off
    }

    /// Fills what is empty. `interval` is (far - near) / coarse samples in the units of `t_vals`.
    pub(super) fn fill(&mut self, site: PaperSite, sizes: Sizes, unit: StepUnit, interval: f64) -> SiteNumbers {
        let default = site.spec().sizes;
        let steps = *self.steps.get_or_insert(default.steps);
        let epsilon = *self.epsilon.get_or_insert_with(|| match sizes {
            Sizes::Paper => default.paper_epsilon.into(),
            Sizes::Calibrated => (default.calibrated_epsilon)(interval).into(),
        });
        let step_size = *self.step_size.get_or_insert(match sizes {
            Sizes::Paper => default.paper_step_size,
            // 2.5 epsilon / steps, or 0 if there are no steps.
            Sizes::Calibrated if steps == 0 => 0.0,
            // In radii, the only unit that validation allows here.
            Sizes::Calibrated => 2.5 / steps as f64,
        });
        let norm = *self.norm.get_or_insert(default.norm);
        SiteNumbers { passes: self.passes, pgd: Pgd { steps, step_size, unit }, epsilon, norm }
    }
}
