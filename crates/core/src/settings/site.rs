//! The table of a site in section `perturb`, and `perturb.levels`, the short way to switch sites off.

use serde::{Deserialize, Serialize, Serializer};
use toml::{Table, Value};

use super::registry::{Registry, Rule, Section, choice, describe, numbers};
use crate::base::SettingError;
use crate::perturb::{Epsilon, Level, Norm, PaperSite, Passes, PerSite, Pgd, SiteNumbers, StepUnit};

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

/// One site. `perturb.attack` fills its empty numbers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SiteConfig {
    /// The passes with this delta.
    pub passes: Passes,
    /// PGD steps. 0 keeps the random start.
    pub steps: Option<usize>,
    /// Length of one PGD step, in `step_unit`.
    pub step_size: Option<f64>,
    /// Size of the constraint set, in the site's unit (see [`crate::perturb::SiteSpec::unit`]), or as far as its steps
    /// reach.
    pub epsilon: Option<Epsilon>,
    /// The norm of the constraint set.
    pub norm: Option<Norm>,
}

impl SiteConfig {
    /// Returns whether any pass has this delta.
    pub fn on(&self) -> bool {
        self.passes != Passes::Off
    }

    /// Fills what is empty. `interval` is (far - near) / coarse samples in the units of `t_vals`.
    pub(super) fn resolve(&mut self, site: PaperSite, sizes: Sizes, unit: StepUnit, interval: f64) -> SiteNumbers {
        let default = site.about().sizes;
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

impl Default for SiteConfig {
    fn default() -> SiteConfig {
        SiteSection::default().into()
    }
}

/// The table of a site in a file.
#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields, expecting = "a site's table, such as { passes = \"fine\", epsilon = 0.01 }")]
pub(super) struct SiteSection {
    pub passes: Option<Passes>,
    steps: Option<usize>,
    step_size: Option<f64>,
    epsilon: Option<Epsilon>,
    norm: Option<Norm>,
}

impl From<SiteSection> for SiteConfig {
    fn from(section: SiteSection) -> SiteConfig {
        let SiteSection { passes, steps, step_size, epsilon, norm } = section;
        SiteConfig { passes: passes.unwrap_or(Passes::Both), steps, step_size, epsilon, norm }
    }
}

choice!(Sizes, Norm, Passes, Level);

const NUMBERS: &[&str] = &["attack_numbers", "step_over_radius"];

describe! {
    SiteConfig {
        /// Passes with this delta: `both`, `coarse`, `fine` or `off`.
        passes: Passes, numbers().columns(&["levels"]);
        /// PGD steps; 0 keeps the random start. Empty = the number of `perturb.attack`.
        steps: Option<usize>, numbers().whole(0, 1000, "0 to 1000").columns(NUMBERS);
        /// Length of one PGD step, in `perturb.step_unit`. Empty = the length of `perturb.attack`.
        step_size: Option<f64>, numbers().real(|size| size >= 0.0, "0 or positive").columns(NUMBERS).same_time();
        /// Size of the constraint set. 0 = no perturbation. `reach` = `steps` x `step_size` in the delta's own unit
        /// (`perturb.step_unit = "absolute"`). Empty = the size of `perturb.attack`.
        epsilon: Option<Epsilon>, numbers().real(|size| size >= 0.0, "0 or positive").columns(NUMBERS).same_time();
        /// Norm of the constraint set. Empty = the site's own.
        norm: Option<Norm>, numbers().columns(&["norms"]);
    }
    sections {}
}

impl Section for PerSite<SiteConfig> {
    fn list(prefix: &str, registry: &mut Registry) {
        let doc =
            "A short way to switch sites off: those of the levels that are not named. It is read but never written.";
        registry.add::<Option<Vec<Level>>>(format!("{prefix}levels"), &[doc], numbers().columns(&["levels"]));
        for site in PaperSite::ALL {
            let (about, path) = (site.about(), format!("{prefix}{}", site.name()));
            registry.add_section(path.clone(), &[&format!("Site: {}; epsilon in {}.", about.what, about.unit)]);
            SiteConfig::list(&format!("{path}."), registry);
        }
    }

    fn check(&self, prefix: &str) -> Result<(), SettingError> {
        self.iter().try_for_each(|(site, config)| config.check(&format!("{prefix}{}.", site.name())))
    }

    fn reset(&mut self, default: &Self, chosen: fn(&Rule) -> bool) {
        self.iter_mut().for_each(|(site, config)| config.reset(&default[site], chosen));
    }
}

/// Writes the table of each site.
pub(super) fn write_sites<S: Serializer>(sites: &PerSite<SiteConfig>, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map(sites.iter().map(|(site, config)| (site.name(), config)))
}

/// Iterates over the sites whose levels are not named. Without `levels` there are none.
pub(super) fn switched_off(levels: Option<&[Level]>) -> impl Iterator<Item = PaperSite> {
    PaperSite::ALL.into_iter().filter(move |site| levels.is_some_and(|levels| !levels.contains(&site.about().level)))
}

/// The levels of `perturb.levels`: a list, or one name.
#[derive(Deserialize)]
#[serde(untagged, expecting = "expected input, feature or output, or a list such as [\"input\", \"output\"]")]
enum OneOrMore {
    One(Level),
    Many(Vec<Level>),
}

/// Reads `perturb.levels`.
#[derive(Deserialize)]
#[serde(from = "OneOrMore")]
pub(super) struct Levels(pub Vec<Level>);

impl From<OneOrMore> for Levels {
    fn from(levels: OneOrMore) -> Levels {
        Levels(match levels {
            OneOrMore::One(level) => vec![level],
            OneOrMore::Many(levels) => levels,
        })
    }
}

/// Removes from `base` the passes of the sites that levels in `over` switch off: the later layer wins.
pub(super) fn forget_passes(base: &mut Table, over: &Table) {
    let levels = over.get("perturb").and_then(|perturb| perturb.get("levels")).cloned();
    let levels: Option<Levels> = levels.and_then(|levels| levels.try_into().ok());
    let Some(perturb) = base.get_mut("perturb").and_then(Value::as_table_mut) else { return };
    for site in switched_off(levels.as_ref().map(|levels| &levels.0[..])) {
        if let Some(site) = perturb.get_mut(site.name()).and_then(Value::as_table_mut) {
            site.remove("passes");
        }
    }
}
