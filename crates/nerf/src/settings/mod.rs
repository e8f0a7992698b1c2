//! The experiment as data: nested sections whose defaults are the paper's, presets, `--set a.b=v`, and checks across
//! settings.
//!
//! Later layers override earlier ones: defaults, preset, the method's own (MipNeRF, SRN), configuration file,
//! `--data`/`--method`/`--seed`, `--set`. Every run's `config.toml` holds the result.

pub mod columns;
mod document;
mod eval;
mod identity;
mod idle;
mod layers;
mod method;
mod over_run;
mod planes;
pub mod registry;
mod resolved;
mod srn;
mod train;
mod validate;
mod volume;

pub use crate::base::settings::{name_of, word};
pub use document::{SettingRow, settings_page, settings_rows, settings_text};
pub use eval::{EvalConfig, MESH_SIDES, MeshConfig, NO_REFERENCE};
pub use identity::{leaves, value_at};
pub use layers::{Preset, build, check_assignment, data_section, parse_assignment, regularizer_hint};
pub use method::{Capability, Method, Representation};
pub use planes::{PlanesConfig, PlanesLoss};
pub use resolved::Resolved;
pub use srn::SrnConfig;
pub use train::{Batching, SamDirection, Schedule, TrainConfig};
pub use volume::{VolumeCode, VolumeConfig};

// Sections stand beside what they set.
pub use crate::base::short_hash;
pub use crate::data::settings::{
    Axes, Background, BuiltinScene, CorruptionConfig, CorruptionKind, DataConfig, DataKind, EvalSplit, PixelOrigin,
    RuledViews, Split, TrainViews, ViewsRule, scene_name,
};
pub use crate::data::{Extent, UnseenPoses};
use crate::data::{Scene, seen_views};
pub use crate::field::settings::{Contraction, HashConfig, Interpolation};
pub use crate::field::settings::{Core, DensityActivation, Encoding, FieldConfig, Init, Precision};
pub use crate::losses::{
    LatticePoints, REGULARIZERS, RegularizedFields, Regularizer, RegularizerConfig, TermNeeds, TermRays, WeightSchedule,
};
pub use crate::perturb::settings::{
    ChangedEntries, Objective, OutputPlace, PerturbConfig, PerturbField, Resample, SecondPass, SiteConfig, Sizes,
};
pub use crate::render::settings::{OccupancyConfig, Placing, SamplingConfig, Spacing};

use crate::base::settings::{Setting, numbers, section};
use crate::base::{Error, Result};
use registry::REGISTRY;

section! {
    /// One experiment: everything that can change a number. What cannot (device, threads, output folder) is not part of
    /// it.
    pub struct Config {
        /// Seed of every random stream.
        pub seed: u64 = 0, numbers().whole(0, i64::MAX as u64, "at most 2^63 - 1").column("seed").same_time();
        /// Method to train: `nerf` or `mip-nerf` (clean pass only), `aug-nerf` or `aug-mip-nerf` (clean + perturbed
        /// pass, section `perturb`), `srn`, `nv` or `llff` (sections of these names).
        pub method: Method = Method::Nerf, numbers().column("method");
    }
    sections {
        /// The scene.
        pub data: DataConfig;
        /// The network of a method with fields (NeRF, MipNeRF).
        pub field: FieldConfig;
        /// Samples along a ray of a method with fields.
        pub sampling: SamplingConfig;
        /// Optimization.
        pub train: TrainConfig;
        /// The perturbed pass. Methods without one ignore it.
        pub perturb: PerturbConfig;
        /// Terms of the loss next to the colour loss: smoothness of density, compactness along rays. Every method with
        /// a field supports them.
        pub regularizer: RegularizerConfig;
        /// Evaluation and its images.
        pub eval: EvalConfig;
        /// Scene Representation Networks. Only `method = "srn"` reads it.
        pub srn: SrnConfig;
        /// Neural Volumes. Only `method = "nv"` reads it.
        pub nv: VolumeConfig;
        /// Local Light Field Fusion. Only `method = "llff"` reads it.
        pub llff: PlanesConfig;
    }
}

impl Config {
    /// Parses TOML text over the defaults. Errors name `origin` as the file.
    pub fn from_toml(text: &str, origin: &str) -> Result<Config> {
        let mut config: Config = toml::from_str(text).map_err(|e| Error::Config(format!("{origin}: {e}")))?;
        // What it refuses besides is a whole number that is too large.
        config.check_ranges()?;
        config.perturb.take_levels();
        config.validate()?;
        Ok(config)
    }

    /// Checks each setting by itself.
    ///
    /// # Errors
    /// [`Error::Setting`] for the first setting out of its range.
    pub fn check_ranges(&self) -> Result<()> {
        let table = self.checked_table()?;
        for Setting { path, rule, .. } in &REGISTRY.settings {
            value_at(&table, path).map_or(Ok(()), |value| rule.check(path, value))?;
        }
        Ok(())
    }

    /// Returns the configuration as a table of values, as [`Config::to_table`] does. A whole number above 2^63 - 1, which TOML
    /// cannot hold, is an error.
    pub(super) fn checked_table(&self) -> Result<toml::Table> {
        if let Ok(table) = toml::Table::try_from(self) {
            return Ok(table);
        }
        let values = serde_json::to_value(self).expect("a configuration is plain data");
        let value =
            |path: &str| values.pointer(&format!("/{}", path.replace('.', "/"))).filter(|value| !value.is_null());
        for Setting { path, rule, .. } in &REGISTRY.settings {
            value(path).map_or(Ok(()), |value| rule.check(path, value))?;
        }
        unreachable!("only such a number keeps a configuration from being a table")
    }

    /// Returns the configuration as a table of values, without the open settings.
    pub fn to_table(&self) -> toml::Table {
        toml::Table::try_from(self).expect("a configuration is plain data")
    }

    /// Reads a table over the defaults, unchecked. It goes through text, so that each setting is compiled for one deserializer.
    pub(super) fn from_table(table: &toml::Table) -> std::result::Result<Config, toml::de::Error> {
        toml::from_str(&table.to_string())
    }

    /// Returns the configuration as TOML with every setting written out, except the open ones.
    pub fn to_toml(&self) -> String {
        self.to_table().to_string()
    }

    /// Returns the representation of the scene.
    ///
    /// # Panics
    /// If the method has no field of that encoding, which [`Config::validate`] rejects.
    pub fn representation(&self) -> Representation {
        self.method.representation(self.field.encoding).expect("the encoding was checked")
    }

    /// Returns the indices of the training views that evaluations also measure ([`seen_views`]).
    pub fn seen_views(&self, scene: &Scene) -> Vec<usize> {
        seen_views(scene, self.eval.train_views, self.data.views_seed)
    }

    /// Returns the number of rays whose colours a step compares. For LLFF these are the rays of a complete crop.
    pub fn rays_per_step(&self) -> usize {
        match self.representation() {
            Representation::Planes => self.llff.crop * self.llff.crop,
            _ => self.train.rays,
        }
    }

    /// Returns the rays of this many first steps together.
    pub fn rays_of_steps(&self, steps: u64) -> f64 {
        let (rays, mut left, mut sum) = (self.rays_per_step(), steps, 0.0);
        for first in self.sampling.first_rays(rays) {
            let steps = left.min(self.sampling.occupancy.refresh);
            sum += steps as f64 * first as f64;
            left -= steps;
        }
        sum + left as f64 * rays as f64
    }

    /// Returns the number of samples of the coarse and of the fine pass. The second is 0 if there is no fine pass.
    /// With occupied cells there is no coarse pass, and the other has at most as many as there are intervals.
    pub fn samples(&self) -> (usize, usize) {
        let SamplingConfig { coarse, fine, kind, .. } = self.sampling;
        if kind == Placing::Occupancy {
            return (0, self.sampling.occupancy.intervals);
        }
        (coarse, if fine == 0 || self.field.encoding.at_intervals() { fine } else { coarse + fine })
    }
}
