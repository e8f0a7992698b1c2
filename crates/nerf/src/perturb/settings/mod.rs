//! Section `perturb`: the second pass of a step, the sites of the three levels, and the search for the worst case.
//!
//! The section has one table for each of the paper's sites. `perturb.levels` is a short way to switch sites off. It
//! is read but never written: files and hashes hold only the sites' `passes`.

use std::ops::{Index, IndexMut};
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use crate::base::settings::IdleKind::Noted;
use crate::base::settings::{IdleSettings, one_or_many, refuse, require, word};
use crate::base::settings::{numbers, section};
use crate::base::{self, Error};
use crate::perturb::{
    Density, Epsilon, Feature, Geometry, Level, Norm, PaperPass, PaperSite, Passes, PerSite, Pgd, REACH, Radius, Rgb,
    Site, SiteNumbers, StepUnit, T, View, Xyz,
};
use crate::schedule::{SCHEDULES, WeightSchedule};

mod second_pass;
mod site;

pub use second_pass::SecondPass;
pub use site::{SiteConfig, Sizes};

/// How `lambda` combines clean and perturbed loss.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Objective {
    /// clean + lambda * perturbed.
    #[default]
    Paper,
    /// (1 - lambda) * clean + lambda * perturbed.
    Released,
}

/// The network of the perturbed pass.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PerturbField {
    /// The coarse and the fine network that are evaluated.
    #[default]
    Shared,
    /// One additional network for both passes, which evaluation never uses (released code).
    Separate,
}

/// Where the output deltas are added.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OutputPlace {
    /// To colour and density.
    #[default]
    After,
    /// To the values before sigmoid and ReLU.
    Before,
}

/// The samples of the perturbed fine pass.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Resample {
    /// The clean pass's samples.
    #[default]
    Clean,
    /// New samples from the perturbed coarse weights (released code).
    Perturbed,
}

/// Which entries of a hash grid the second pass changes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ChangedEntries {
    /// All that its points read.
    #[default]
    All,
    /// Those that the clean pass changes in the same step.
    Clean,
}

section! {
    /// The second pass of a step.
    pub struct PerturbConfig {
        /// Second pass of a step: `worst-case`, `gaussian` or `uniform` (the clean pass with deltas from that source),
        /// `best-case` (PGD down the loss), `permuted` (the worst case of other rays), or `fresh-jitter` (a second clean
        /// pass, the control of equal loss weight).
        #[serde(rename = "kind")]
        pub second: SecondPass = SecondPass::WorstCase,
            numbers().key("kind").column("perturb_kind");
        /// Source of the sites' empty numbers: `paper` or `calibrated`.
        #[serde(rename = "attack")]
        pub sizes: Sizes = Sizes::Paper, numbers().key("attack").column("attack");
        /// Weight of the second pass in the loss. The default is the paper's. On hash grids `attack = "calibrated"`
        /// needs less.
        pub lambda: f64 = 0.1,
            numbers()
                .real(|weight| weight >= 0.0, "0 or positive, and at most 1 with perturb.objective = \"released\"")
                .column("lambda")
                .same_time();
        /// How `lambda` moves: `constant`, `from 0 in 5000 steps` (from there to it) or `halved every 5000 steps`.
        pub lambda_schedule: WeightSchedule = WeightSchedule::Constant,
            numbers().text(WeightSchedule::is_possible, SCHEDULES).column("lambda_schedule").same_time();
        /// Combination of the losses: `paper` (clean + lambda * perturbed) or `released`
        /// ((1 - lambda) * clean + lambda * perturbed).
        pub objective: Objective = Objective::Paper, numbers().column("objective");
        /// Entries of a hash grid that the second pass's gradient changes: `all`, or `clean` (those that the step's clean pass
        /// changes, too).
        pub entries: ChangedEntries = ChangedEntries::All, numbers().column("entries");
        /// Network of the perturbed pass: `shared` (the evaluated ones) or `separate` (one additional network, as in
        /// the released code).
        pub field: PerturbField = PerturbField::Shared, numbers().column("perturb_field");
        /// Where the output deltas are added: `after` (to colour and density) or `before` (to the values before sigmoid
        /// and ReLU).
        pub output: OutputPlace = OutputPlace::After, numbers().column("output");
        /// Samples of the perturbed fine pass: `clean` (those of the clean pass) or `perturbed` (drawn from the
        /// perturbed coarse weights, as in the released code).
        pub resample: Resample = Resample::Clean, numbers().column("resample");
        /// Also perturb the density of a ray's last sample (the paper's literal sum).
        pub perturb_last: bool = false, numbers().column("perturb_last");
        /// Unit of all step sizes: `absolute` or `relative` (radii of the set). Empty = the unit of `attack`.
        pub step_unit: Option<StepUnit> = None, numbers().column("step_unit");
        /// Length of one epsilon of `xyz`: `pixel` or `released`.
        pub xyz_radius: Radius = Radius::Pixel, numbers().column("xyz_radius");
        /// Trunk layer (1-based) to whose output `feature` is added.
        pub injection_layer: usize = 4, numbers().column("injection_layer");
        /// Samples, pixels and width that define the length of an epsilon: `sampling` (the run's own) or `paper` (those
        /// of the paper's runs, so that any run searches sets of the paper's absolute size).
        pub geometry: Geometry = Geometry::Sampling,
            numbers().column("attack_geometry").columns(&["step_over_radius"]).same_time();
        /// Levels to perturb, all if they are not named. Sites of the others are off. It is read but never written; a program
        /// sets the passes of sites.
        #[serde(skip_serializing, deserialize_with = "one_or_many")]
        pub levels: Vec<Level> = Level::ALL.to_vec(), numbers().columns(&["levels"]);
    }
    sections {
        /// Site: shift along the ray; epsilon in gap to the nearer sample.
        pub t: SiteConfig;
        /// Site: shift of a sample's point; epsilon in pixels.
        pub xyz: SiteConfig;
        /// Site: tilt of the viewing direction; epsilon in half a pixel's angle, 1/(2f).
        pub view: SiteConfig;
        /// Site: added to the output of a trunk layer; epsilon in feature units.
        pub feature: SiteConfig;
        /// Site: added to the colour of a sample; epsilon in colour, 0 to 1.
        pub rgb: SiteConfig;
        /// Site: added to the density of a sample; epsilon in 1 / length.
        pub density: SiteConfig;
    }
}

impl Index<PaperSite> for PerturbConfig {
    type Output = SiteConfig;

    fn index(&self, site: PaperSite) -> &SiteConfig {
        match site {
            PaperSite::T => &self.t,
            PaperSite::Xyz => &self.xyz,
            PaperSite::View => &self.view,
            PaperSite::Feature => &self.feature,
            PaperSite::Rgb => &self.rgb,
            PaperSite::Density => &self.density,
        }
    }
}

impl IndexMut<PaperSite> for PerturbConfig {
    fn index_mut(&mut self, site: PaperSite) -> &mut SiteConfig {
        match site {
            PaperSite::T => &mut self.t,
            PaperSite::Xyz => &mut self.xyz,
            PaperSite::View => &mut self.view,
            PaperSite::Feature => &mut self.feature,
            PaperSite::Rgb => &mut self.rgb,
            PaperSite::Density => &mut self.density,
        }
    }
}

impl PerturbConfig {
    /// Iterates over the sites, in order.
    pub fn sites(&self) -> impl Iterator<Item = (PaperSite, &SiteConfig)> {
        PaperSite::ALL.into_iter().map(|site| (site, &self[site]))
    }

    /// Iterates over the sites that are on, in order.
    pub fn sites_on(&self) -> impl Iterator<Item = (PaperSite, &SiteConfig)> {
        self.sites().filter(|(_, site)| site.on())
    }

    /// Switches off the sites of the levels that `levels` does not name, and forgets `levels`.
    pub(crate) fn take_levels(&mut self) {
        let levels = std::mem::replace(&mut self.levels, PerturbConfig::default().levels);
        let unnamed = |site: &PaperSite| !levels.contains(&site.spec().level);
        PaperSite::ALL.into_iter().filter(unnamed).for_each(|site| self[site].passes = Passes::Off);
    }

    /// Returns an error if the settings of `named` switch on a site whose level `levels` does not name.
    pub(crate) fn check_levels(levels: Option<&Value>, named: &Table) -> base::Result<()> {
        let Some(levels) = levels.and_then(|levels| one_or_many::<Level, _>(levels.clone()).ok()) else {
            return Ok(());
        };
        let passes = |site: PaperSite| named.get("perturb")?.get(site.name())?.get("passes")?.as_str();
        let is_ignored = |site: &PaperSite| {
            !levels.contains(&site.spec().level) && passes(*site).is_some_and(|passes| passes != "off")
        };
        PaperSite::ALL.into_iter().find(is_ignored).map_or(Ok(()), |site| {
            Err(Error::Config(format!(
                "perturb.{}.passes contradicts perturb.levels, which switches that site off; add its level there (\"{}\"), or \
                 remove one of the two",
                site.name(),
                word(site.spec().level)
            )))
        })
    }

    /// Returns whether no number is empty, as in a run's file.
    pub(crate) fn is_filled_in(&self) -> bool {
        let mut filled = self.clone();
        filled.fill(1.0, 1, 1);
        filled == *self
    }

    /// Fills every empty number from `attack`, and returns the sites' numbers in the run's own units for every geometry.
    /// `span` is far - near in the units of `t_vals`, `coarse` the samples of the coarse pass, and `width` the network's
    /// width.
    pub fn fill(&mut self, span: f64, coarse: usize, width: usize) -> PerSite<SiteNumbers> {
        let (sizes, geometry) = (self.sizes, self.geometry);
        let coarse = if geometry == Geometry::Paper { PaperPass::COARSE } else { coarse };
        let interval = span / coarse as f64;
        let step_unit = *self.step_unit.get_or_insert(match sizes {
            Sizes::Paper => StepUnit::Absolute,
            Sizes::Calibrated => StepUnit::Relative,
        });
        PerSite::from_fn(|site| {
            let numbers = self[site].fill(site, sizes, step_unit, interval);
            let scales = geometry == Geometry::Paper && site.spec().over_units && numbers.norm == Norm::Linf;
            if scales { scaled(numbers, PaperPass::box_scale(width)) } else { numbers }
        })
    }

    /// Returns the paper's sites in the coarse pass or in the fine one: those that are on, with sets larger than a point.
    pub fn sites_of_pass(&self, numbers: &PerSite<SiteNumbers>, is_coarse: bool) -> Vec<Arc<dyn Site>> {
        let on = |numbers: &SiteNumbers| numbers.passes.include(is_coarse) && numbers.perturbs();
        let on = numbers.iter().filter(|(_, numbers)| on(numbers));
        on.map(|(site, numbers)| self.site(site, *numbers)).collect()
    }

    fn site(&self, site: PaperSite, numbers: SiteNumbers) -> Arc<dyn Site> {
        match site {
            PaperSite::T => Arc::new(T { numbers }),
            PaperSite::Xyz => Arc::new(Xyz { numbers, radius: self.xyz_radius }),
            PaperSite::View => Arc::new(View { numbers }),
            PaperSite::Feature => Arc::new(Feature { numbers }),
            PaperSite::Rgb => Arc::new(Rgb { numbers }),
            PaperSite::Density => Arc::new(Density { numbers, perturb_last: self.perturb_last }),
        }
    }

    /// Checks the sites' numbers.
    pub(crate) fn validate(&self) -> base::Result<()> {
        for (site, config) in self.sites() {
            let (spec, name) = (site.spec(), site.name());
            let (largest, allowed) = spec.largest_epsilon;
            if let Some(Epsilon::Units(epsilon)) = config.epsilon {
                require(epsilon <= largest, &format!("perturb.{name}.epsilon"), epsilon, allowed)?;
            }
            // For one number per sample both norms give the same set, which has one name.
            refuse(
                spec.scalar && config.norm == Some(Norm::L2),
                format!(
                    "perturb.{name}.norm = \"l2\": this delta is one number a sample, for which l2 and linf are the same; \
                     use \"linf\""
                ),
            )?;
        }
        let relative = self.step_unit == Some(StepUnit::Relative);
        let in_radii = relative || self.sizes == Sizes::Calibrated;
        let reaching = self.sites_on().find(|(_, config)| config.epsilon == Some(Epsilon::Reach));
        if let Some((site, _)) = reaching.filter(|_| in_radii) {
            return Err(base::Error::Config(format!(
                "perturb.{}.epsilon = \"{REACH}\" is as far as steps of a length of their own reach, and here steps are \
                 measured in radii; set perturb.attack = \"paper\" and perturb.step_unit = \"absolute\", or give epsilon a \
                 number",
                site.name()
            )));
        }
        refuse(
            self.sizes == Sizes::Calibrated && self.step_unit == Some(StepUnit::Absolute),
            "perturb.attack = \"calibrated\" measures steps in radii; omit perturb.step_unit or set it to \"relative\", and \
             omit the sites' numbers that are the paper's",
        )?;
        match self.sites_on().find(|(_, config)| config.step_size.is_none()) {
            Some((unset, _)) if self.sizes == Sizes::Paper && relative => Err(base::Error::Config(format!(
                "perturb.step_unit = \"relative\" measures steps in radii, which the paper's step sizes are not; \
                 set perturb.{}.step_size, too",
                unset.name()
            ))),
            _ => Ok(()),
        }
    }

    /// Adds the settings without effect in a method with a second pass.
    pub(crate) fn idle(&self, idle: &mut IdleSettings) {
        let kind = word(self.second);
        let of_deltas = [
            "attack",
            "levels",
            "output",
            "resample",
            "perturb_last",
            "step_unit",
            "xyz_radius",
            "injection_layer",
            "geometry",
        ];
        let of_deltas = [&of_deltas[..], &PaperSite::ALL.map(PaperSite::name)].concat();
        let why = format!("perturb.kind is \"{kind}\", a second pass without deltas");
        idle.add(Noted, "perturb.", &of_deltas, !self.second.perturbs(), why);
        let is_searched = self.second.searches();
        let no_search = format!("perturb.kind is \"{kind}\", which searches nothing");
        idle.add(Noted, "perturb.", &["step_unit"], !is_searched, &*no_search);
        for (site, config) in self.sites() {
            let section = format!("perturb.{}.", site.name());
            let is_off = format!("{section}passes is \"off\"");
            idle.add(Noted, &section, &["steps", "step_size", "epsilon", "norm"], !config.on(), &*is_off);
            // The reach of steps is a size for random deltas, too.
            let is_idle = !is_searched && config.epsilon != Some(Epsilon::Reach);
            idle.add(Noted, &section, &["steps", "step_size"], is_idle, &*no_search);
            let own: &[&str] = match site {
                PaperSite::Xyz => &["xyz_radius"],
                PaperSite::Feature => &["injection_layer"],
                PaperSite::Density => &["perturb_last"],
                PaperSite::T | PaperSite::View | PaperSite::Rgb => &[],
            };
            idle.add(Noted, "perturb.", own, !config.on(), is_off);
        }
        let no_output = !self.rgb.on() && !self.density.on();
        let why = "perturb.rgb.passes and perturb.density.passes are \"off\"";
        idle.add(Noted, "perturb.", &["output"], no_output, why);
    }
}

/// Returns the same PGD in a box scaled by `scale`.
fn scaled(numbers: SiteNumbers, scale: f64) -> SiteNumbers {
    let epsilon = match numbers.epsilon {
        Epsilon::Units(epsilon) => Epsilon::Units(epsilon * scale),
        Epsilon::Reach => Epsilon::Reach,
    };
    let step_size = match numbers.pgd.unit {
        StepUnit::Absolute => numbers.pgd.step_size * scale,
        // In radii, which scale with the box.
        StepUnit::Relative => numbers.pgd.step_size,
    };
    SiteNumbers { epsilon, pgd: Pgd { step_size, ..numbers.pgd }, ..numbers }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::{Config, build, parse_assignment};

    fn set(texts: &[&str]) -> base::Result<Config> {
        let assignments: base::Result<Vec<_>> = texts.iter().map(|text| parse_assignment(text)).collect();
        build(None, None, &assignments?)
    }

    #[test]
    fn levels_are_a_short_way_to_write_passes() {
        let off = |sites: &[&str]| -> Vec<String> {
            let aug = std::iter::once("method=aug-nerf".to_string());
            aug.chain(sites.iter().map(|site| format!("perturb.{site}.passes=off"))).collect()
        };
        for (levels, sites) in [
            ("[\"feature\"]", &["t", "xyz", "view", "rgb", "density"][..]),
            ("feature", &["t", "xyz", "view", "rgb", "density"]),
            ("[\"input\"]", &["feature", "rgb", "density"]),
            ("[\"feature\", \"output\"]", &["t", "xyz", "view"]),
            ("[\"output\", \"feature\", \"input\"]", &[]),
        ] {
            let short = set(&["method=aug-nerf", &format!("perturb.levels={levels}")]).unwrap();
            let texts = off(sites);
            let long = set(&texts.iter().map(String::as_str).collect::<Vec<_>>()).unwrap();
            assert_eq!((&short, short.hash(), short.to_toml()), (&long, long.hash(), long.to_toml()), "{levels}");
        }
        // Levels that are named after passes win. A site of a level that is on keeps what is said of it.
        let both = set(&["perturb.t.passes=fine", "perturb.rgb.passes=fine", "perturb.levels=[\"input\"]"]).unwrap();
        let passes = |site| both.perturb[site].passes;
        assert_eq!(
            (passes(PaperSite::T), passes(PaperSite::Xyz), passes(PaperSite::Rgb)),
            (Passes::Fine, Passes::Both, Passes::Off)
        );
        let wrong = set(&["perturb.levels=[\"rgb\"]"]).unwrap_err().to_string();
        assert!(wrong.contains("perturb.levels") && wrong.contains("input"), "{wrong}");
        let none = set(&["method=aug-nerf", "perturb.levels=[]"]).unwrap_err().to_string();
        assert!(none.contains("perturbs nothing"), "{none}");
    }

    #[test]
    fn passes_of_a_site_whose_level_is_off_are_refused_not_ignored() {
        for passes in ["both", "coarse", "fine"] {
            let passes = format!("perturb.rgb.passes={passes}");
            let refused = set(&["perturb.levels=[\"input\"]", &passes]).unwrap_err().to_string();
            assert!(refused.contains("perturb.rgb.passes") && refused.contains("\"output\""), "{passes}: {refused}");
        }
        let off = set(&["perturb.levels=[\"input\"]", "perturb.rgb.passes=off"]).unwrap();
        assert_eq!(off.perturb[PaperSite::Rgb].passes, Passes::Off);
        let inline = set(&["perturb.levels=input", "perturb.rgb={passes=\"both\"}"]).unwrap_err().to_string();
        assert!(inline.contains("contradicts perturb.levels"), "{inline}");
        set(&["perturb.levels=input", "perturb.rgb.passes=both", "perturb.rgb.passes=off"]).unwrap();
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), "[perturb]\nlevels = \"input\"\nrgb.passes = \"both\"\n").unwrap();
        let both = parse_assignment("perturb.levels=[\"input\", \"output\"]").unwrap();
        build(None, Some(file.path()), &[both]).unwrap();
        let refused = build(None, Some(file.path()), &[]).unwrap_err().to_string();
        assert!(refused.contains("contradicts perturb.levels"), "{refused}");
        std::fs::write(file.path(), "[perturb]\nlevels = \"input\"\n").unwrap();
        let passes = parse_assignment("perturb.rgb.passes=both").unwrap();
        let refused = build(None, Some(file.path()), &[passes]).unwrap_err().to_string();
        assert!(refused.contains("contradicts perturb.levels"), "{refused}");
    }

    /// A run's own file names the passes of all sites.
    #[test]
    fn levels_win_over_passes() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), Config::default().to_toml()).unwrap();
        let levels = parse_assignment("perturb.levels=[\"feature\"]").unwrap();
        let narrowed = build(None, Some(file.path()), &[levels]).unwrap();
        assert_eq!(narrowed.perturb.sites_on().map(|(site, _)| site).collect::<Vec<_>>(), [PaperSite::Feature]);
    }

    #[test]
    fn sites_that_are_off_need_no_numbers() {
        let on = ["method=aug-nerf", "perturb.levels=output", "perturb.step_unit=relative", "perturb.rgb.step_size=1"];
        let wrong = set(&on).unwrap_err().to_string();
        assert!(wrong.contains("set perturb.density.step_size, too"), "{wrong}");
        set(&[&on[..], &["perturb.density.step_size=1"]].concat()).unwrap();
    }

    #[test]
    fn a_value_in_the_place_of_a_site_is_refused() {
        let wrong = set(&["perturb.rgb=3"]).unwrap_err().to_string();
        assert!(wrong.contains("perturb.rgb is a section"), "{wrong}");
        let file = toml::from_str::<Config>("[perturb]\nrgb = 3\n").unwrap_err().to_string();
        assert!(file.contains("a section of settings") && !file.contains("SiteConfig"), "{file}");
    }

    #[test]
    fn a_wrong_word_in_a_site_is_found_with_its_line_and_its_keys() {
        let read = |text: &str| toml::from_str::<Config>(text).unwrap_err().to_string();
        let choice = read("[perturb]\nlambda = 1.0\nt.passes = \"of\"\n");
        assert!(choice.contains("line 3") && choice.contains("`of`") && choice.contains("coarse"), "{choice}");
        let key = read("[perturb.xyz]\nstepz = 3\n");
        assert!(key.contains("line 2") && key.contains("stepz") && key.contains("step_size"), "{key}");
        assert!(read("[perturb]\nlambd = 3\n").contains("lambd"));
    }
}
