//! Section `perturb`: the three levels, six deltas, and how the worst case is searched.

use std::ops::Deref;

use serde::{Deserialize, Serialize};

/// What fills the perturbed pass.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PerturbKind {
    /// PGD ascends the perturbed loss.
    #[default]
    WorstCase,
    /// Normal draws of std epsilon/sqrt(3), projected to the same sets.
    Gaussian,
    /// Uniform draws in the same sets.
    Uniform,
    /// No perturbation: a second clean pass with fresh jitter, the control of equal loss weight and almost equal
    /// compute (nothing is searched).
    FreshJitter,
}

/// Which numbers fill the deltas' empty fields.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Attack {
    /// The paper's best steps and step sizes.
    #[default]
    Paper,
    /// Ours: every delta large enough to matter, step size 2.5 epsilon / steps.
    Calibrated,
}

/// How clean and perturbed loss are mixed with `lambda`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Objective {
    /// clean + lambda * perturbed.
    #[default]
    Paper,
    /// (1 - lambda) * clean + lambda * perturbed.
    Released,
}

/// Which network the perturbed pass runs through.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PerturbField {
    /// The evaluated coarse and fine fields.
    #[default]
    Shared,
    /// One further field for both passes that evaluation never uses (released code).
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

/// Where the perturbed fine pass takes its samples from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Resample {
    /// The clean pass's samples.
    #[default]
    Clean,
    /// Drawn again from the perturbed coarse weights (released code).
    Perturbed,
}

/// The unit of step sizes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StepUnit {
    /// The delta's own unit.
    #[default]
    Absolute,
    /// Radii of the delta's set.
    Relative,
}

/// The norm of a delta's set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Norm {
    /// Box; steps by the gradient's sign.
    Linf,
    /// Ball per sample; steps along the normalised gradient.
    L2,
}

/// What one epsilon of `xyz` is worth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Radius {
    /// A pixel: 2/W under NDC, 1/f otherwise, at most half a mean sample distance along the ray in scene units.
    /// The cap is on one epsilon's worth, not on epsilon times it.
    #[default]
    Pixel,
    /// min(2/max(H, W), half a mean sample distance), as the released code.
    Released,
}

/// The passes that a delta takes part in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Passes {
    /// Coarse and fine.
    Both,
    /// Coarse only.
    Coarse,
    /// Fine only.
    Fine,
    /// None.
    Off,
}

/// The six deltas in their fixed order, grouped in three levels: input coordinates (`t`, `xyz`,
/// `view`), intermediate features (`feature`), pre-rendering output (`rgb`, `density`).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Level {
    /// Shift along the ray.
    T,
    /// Shift of the sample's position.
    Xyz,
    /// Tilt of the viewing direction.
    View,
    /// Added to a trunk layer's output.
    Feature,
    /// Added to the colour.
    Rgb,
    /// Added to the density.
    Density,
}

/// All deltas in order; arrays indexed by level follow it.
pub const LEVELS: [Level; 6] = [Level::T, Level::Xyz, Level::View, Level::Feature, Level::Rgb, Level::Density];

impl Level {
    /// The delta's name in configuration, logs and tables.
    pub fn name(self) -> &'static str {
        match self {
            Level::T => "t",
            Level::Xyz => "xyz",
            Level::View => "view",
            Level::Feature => "feature",
            Level::Rgb => "rgb",
            Level::Density => "density",
        }
    }
}

/// One delta. Empty numbers are filled from `attack`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DeltaConfig {
    /// The passes it takes part in.
    pub passes: Passes,
    /// Ascent steps; 0 leaves the random start.
    pub steps: Option<usize>,
    /// Length of one step, in `step_unit`.
    pub step_size: Option<f64>,
    /// Size of the set; 0 is no perturbation. Units: see docs/perturbations.md (gap share for `t`,
    /// pixels for `xyz` and `view`, own units for the others).
    pub epsilon: Option<f64>,
    /// The set's norm.
    pub norm: Option<Norm>,
}

impl Default for DeltaConfig {
    fn default() -> Self {
        DeltaConfig { passes: Passes::Both, steps: None, step_size: None, epsilon: None, norm: None }
    }
}

impl DeltaConfig {
    /// Takes part in any pass.
    pub fn on(&self) -> bool {
        self.passes != Passes::Off
    }
}

/// The perturbed pass.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PerturbConfig {
    /// What fills it.
    pub kind: PerturbKind,
    /// Which numbers fill the empty fields below.
    pub attack: Attack,
    /// The perturbed loss's weight.
    pub lambda: f64,
    /// How clean and perturbed loss are mixed.
    pub objective: Objective,
    /// Which network the perturbed pass runs through.
    pub field: PerturbField,
    /// Where the output deltas are added.
    pub output: OutputPlace,
    /// Where the perturbed fine pass takes its samples from.
    pub resample: Resample,
    /// Perturb the density of a ray's last sample, too (the paper's literal sum).
    pub perturb_last: bool,
    /// The unit of all step sizes.
    pub step_unit: Option<StepUnit>,
    /// What one epsilon of `xyz` is worth.
    pub xyz_radius: Radius,
    /// Trunk layer (1-based) whose output `feature` is added to.
    pub injection_layer: usize,
    /// Shift along the ray.
    pub t: DeltaConfig,
    /// Shift of the sample's position.
    pub xyz: DeltaConfig,
    /// Tilt of the viewing direction.
    pub view: DeltaConfig,
    /// Added to a trunk layer's output.
    pub feature: DeltaConfig,
    /// Added to the colour.
    pub rgb: DeltaConfig,
    /// Added to the density.
    pub density: DeltaConfig,
}

impl Default for PerturbConfig {
    fn default() -> Self {
        PerturbConfig {
            kind: PerturbKind::WorstCase,
            attack: Attack::Paper,
            lambda: 0.1,
            objective: Objective::Paper,
            field: PerturbField::Shared,
            output: OutputPlace::After,
            resample: Resample::Clean,
            perturb_last: false,
            step_unit: None,
            xyz_radius: Radius::Pixel,
            injection_layer: 4,
            t: DeltaConfig::default(),
            xyz: DeltaConfig::default(),
            view: DeltaConfig::default(),
            feature: DeltaConfig::default(),
            rgb: DeltaConfig::default(),
            density: DeltaConfig::default(),
        }
    }
}

impl PerturbConfig {
    /// The settings of one delta.
    pub fn delta(&self, level: Level) -> &DeltaConfig {
        match level {
            Level::T => &self.t,
            Level::Xyz => &self.xyz,
            Level::View => &self.view,
            Level::Feature => &self.feature,
            Level::Rgb => &self.rgb,
            Level::Density => &self.density,
        }
    }

    /// The settings of one delta, to be changed.
    pub fn delta_mut(&mut self, level: Level) -> &mut DeltaConfig {
        match level {
            Level::T => &mut self.t,
            Level::Xyz => &mut self.xyz,
            Level::View => &mut self.view,
            Level::Feature => &mut self.feature,
            Level::Rgb => &mut self.rgb,
            Level::Density => &mut self.density,
        }
    }

    /// Fills every empty number from `attack`. `interval` is (far - near) / coarse samples in the
    /// units of `t_vals`: an output density of (4/255) / interval changes a coarse interval's
    /// opacity by about 4/255.
    pub fn resolve(mut self, interval: f64) -> ResolvedPerturb {
        let attack = self.attack;
        let step_unit = *self.step_unit.get_or_insert(match attack {
            Attack::Paper => StepUnit::Absolute,
            Attack::Calibrated => StepUnit::Relative,
        });
        let deltas = LEVELS.map(|level| self.delta_mut(level).resolve(attack, level, interval));
        ResolvedPerturb { config: self, step_unit, deltas }
    }
}

/// Section `perturb` with every number filled in. It reads as the section, but for what was open there.
#[derive(Clone, Debug, PartialEq)]
pub struct ResolvedPerturb {
    config: PerturbConfig,
    /// The unit of all step sizes.
    pub step_unit: StepUnit,
    deltas: [ResolvedDelta; 6],
}

impl ResolvedPerturb {
    /// One delta.
    pub fn delta(&self, level: Level) -> &ResolvedDelta {
        &self.deltas[level as usize]
    }

    /// The section with every number filled in; it resolves to itself.
    pub fn into_draft(self) -> PerturbConfig {
        self.config
    }
}

impl Deref for ResolvedPerturb {
    type Target = PerturbConfig;

    fn deref(&self) -> &PerturbConfig {
        &self.config
    }
}

/// One delta with its numbers; the units are those of [`DeltaConfig`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResolvedDelta {
    /// The passes it takes part in.
    pub passes: Passes,
    /// Ascent steps; 0 leaves the random start.
    pub steps: usize,
    /// Length of one step, in `step_unit`.
    pub step_size: f64,
    /// Size of the set; 0 is no perturbation.
    pub epsilon: f64,
    /// The set's norm.
    pub norm: Norm,
}

impl ResolvedDelta {
    /// Takes part in any pass.
    pub fn on(&self) -> bool {
        self.passes != Passes::Off
    }
}

impl DeltaConfig {
    fn resolve(&mut self, attack: Attack, level: Level, interval: f64) -> ResolvedDelta {
        let steps = *self.steps.get_or_insert(match level {
            Level::T | Level::Xyz | Level::View => 3,
            Level::Feature | Level::Rgb | Level::Density => 1,
        });
        let epsilon = *self.epsilon.get_or_insert(match (attack, level) {
            (Attack::Paper, Level::T) => 0.5,
            (Attack::Calibrated, Level::T) => 0.25,
            (_, Level::Xyz | Level::View) => 1.0,
            (Attack::Paper, Level::Feature) => 1e-3,
            (Attack::Calibrated, Level::Feature) => 1e-2,
            (Attack::Paper, Level::Rgb | Level::Density) => 1e-5,
            (Attack::Calibrated, Level::Rgb) => 4.0 / 255.0,
            (Attack::Calibrated, Level::Density) => 4.0 / 255.0 / interval,
        });
        let norm = *self.norm.get_or_insert(if level == Level::Xyz { Norm::L2 } else { Norm::Linf });
        let step_size = *self.step_size.get_or_insert(match (attack, level) {
            (Attack::Paper, Level::T | Level::Xyz | Level::View) => 1e-2,
            (Attack::Paper, Level::Feature) => 1e-3,
            (Attack::Paper, Level::Rgb | Level::Density) => 1e-5,
            // 2.5 epsilon / steps; a step of zero length where no step is taken.
            (Attack::Calibrated, _) if steps == 0 => 0.0,
            // In radii, which is the only unit that validation lets it have.
            (Attack::Calibrated, _) => 2.5 / steps as f64,
        });
        ResolvedDelta { passes: self.passes, steps, step_size, epsilon, norm }
    }
}
