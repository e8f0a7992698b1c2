//! The whole experiment as data: nested sections whose defaults are the paper's, presets,
//! `--set a.b=v`, and checks across fields.
//!
//! Layers, later over earlier: defaults, preset, the method's own (MipNeRF, SRN), configuration file, `--data`/`--method`/`--seed`,
//! `--set`. The result is what stands in every run's `config.toml`.

pub mod columns;
mod corruption;
mod data;
mod document;
mod eval;
mod field;
mod hash;
mod identity;
mod layers;
mod method;
mod perturb;
mod planes;
pub mod registry;
mod regularizer;
mod resolved;
mod rules;
mod sampling;
mod second_pass;
mod site;
mod srn;
mod train;
mod types;
mod validate;
mod volume;
mod without_fields;

pub use corruption::{CorruptionConfig, CorruptionKind};
pub use data::{Background, DataConfig, DataKind, EvalSplit, PixelOrigin, Split, TrainViews};
pub use document::{SettingRow, settings_page, settings_rows, settings_text};
pub use eval::{EvalConfig, MESH_SIDES, MeshConfig, NO_REFERENCE};
pub use field::{Core, DensityActivation, Encoding, FieldConfig, Init, Precision};
pub use hash::{Contraction, HashConfig, Interpolation};
pub use identity::{scene_name, short_hash, value_at};
pub use layers::{Preset, build, data_section, parse_assignment};
pub use method::{Capability, Method, Representation};
pub use perturb::{Objective, OutputPlace, PerturbConfig, PerturbField, Resample, ResolvedPerturb};
pub use planes::{PlanesConfig, PlanesLoss};
pub use regularizer::{LatticePoints, REGULARIZERS, RegularizedFields, Regularizer, RegularizerConfig};
pub use resolved::{Extent, Located, Resolved};
pub use sampling::{SamplingConfig, Spacing};
pub use second_pass::{DeltaSource, SecondPass};
pub use site::{SiteConfig, Sizes};
pub use srn::SrnConfig;
pub use train::{Batching, Schedule, TrainConfig};
pub use types::word;
pub use volume::{VolumeCode, VolumeConfig};

use crate::base::{Error, Result};
use registry::{numbers, section};

section! {
    /// One experiment. Everything that can change a number is in here; what cannot (device, threads,
    /// output folder) is not.
    pub struct Config {
        /// Seed of every random stream.
        pub seed: u64 = 0, numbers().whole(0, i64::MAX as u64, "at most 2^63 - 1").column("seed").same_time();
        /// What is trained: `nerf` or `mip-nerf` (clean pass only), `aug-nerf` or `aug-mip-nerf` (clean + perturbed pass,
        /// section `perturb`), `srn`, `nv` or `llff` (sections of these names).
        pub method: Method = Method::Nerf, numbers().column("method");
    }
    sections {
        /// The scene.
        pub data: DataConfig, false;
        /// The network of a method of fields (NeRF, MipNeRF).
        pub field: FieldConfig, false;
        /// Samples along a ray of a method of fields.
        pub sampling: SamplingConfig, false;
        /// Optimisation.
        pub train: TrainConfig, false;
        /// The perturbed pass; read only where the method has one.
        pub perturb: PerturbConfig, false;
        /// Terms of the loss beside the colours' error: smoothness of density, compactness along rays; with every method of a field.
        pub regularizer: RegularizerConfig, false;
        /// Evaluation and its pictures.
        pub eval: EvalConfig, false;
        /// Scene Representation Networks; read by `method = "srn"` alone.
        pub srn: SrnConfig, true;
        /// Neural Volumes; read by `method = "nv"` alone.
        pub nv: VolumeConfig, true;
        /// Local Light Field Fusion; read by `method = "llff"` alone.
        pub llff: PlanesConfig, true;
    }
}

impl Config {
    /// Parses TOML text over the defaults. `origin` names the file in messages.
    pub fn from_toml(text: &str, origin: &str) -> Result<Config> {
        let config: Config = toml::from_str(text).map_err(|e| Error::Config(format!("{origin}: {e}")))?;
        config.validate()?;
        Ok(config)
    }

    /// The configuration as a table of values; what is left open has none.
    pub fn to_table(&self) -> toml::Table {
        toml::Table::try_from(self).expect("a configuration is plain data")
    }

    /// The configuration as TOML, every field written out.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("a configuration is plain data")
    }

    /// What holds the scene.
    ///
    /// # Panics
    /// Where the method has no field of that encoding, which [`Config::validate`] refuses.
    pub fn representation(&self) -> Representation {
        self.method.representation(self.field.encoding).expect("the encoding was checked")
    }

    /// Rays whose colours a step compares: of LLFF those of a whole crop.
    pub fn rays_per_step(&self) -> usize {
        match self.representation() {
            Representation::Planes => self.llff.crop * self.llff.crop,
            _ => self.train.rays,
        }
    }

    /// Samples of the coarse and of the fine pass; the latter 0 where there is none.
    pub fn samples(&self) -> (usize, usize) {
        let SamplingConfig { coarse, fine, .. } = self.sampling;
        (coarse, if fine == 0 || self.field.encoding.at_intervals() { fine } else { coarse + fine })
    }
}
