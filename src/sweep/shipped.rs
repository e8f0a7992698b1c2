//! The sweep files that the program carries: a commented one to begin with, and those of `sweeps/`.

use std::path::{Path, PathBuf};

use crate::base::files::write_atomic;
use crate::base::{Error, Result};

/// Every key of the schema, with what it does.
pub const TEMPLATE: &str = include_str!("new.toml");

macro_rules! shipped {
    ($($name:literal),* $(,)?) => {
        /// The files of `sweeps/`, by name.
        pub const SHIPPED: &[(&str, &str)] = &[$(($name, include_str!(concat!("../../sweeps/", $name, ".toml")))),*];
    };
}

shipped![
    "baselines_builtin",
    "baselines_chair",
    "baselines_fern",
    "baselines_llff_builtin",
    "baselines_presets_chair",
    "epsilon",
    "few_views_chair",
    "fig_embedded",
    "fig_strength_location",
    "geometry",
    "geometry_chair",
    "lambda",
    "mip_chair",
    "mip_fern",
    "noise_fern",
    "precision",
    "regularizer_grid",
    "smoke",
    "study_chair_25",
    "study_chair_few",
    "study_choice_chair_25",
    "study_choice_chair_few",
    "study_choice_fern_few",
    "study_choice_fern_noise",
    "study_choice_own_few",
    "study_fern_few",
    "study_fern_noise",
    "study_gate_chair",
    "study_gate_chair_small",
    "study_gate_fern",
    "study_gate_fern_small",
    "study_gate_own",
    "study_gate_own_bf16",
    "study_gate_own_fern",
    "study_gate_own_few",
    "study_layer",
    "study_levels",
    "study_levels_fern",
    "study_own_few",
    "study_strength",
    "tab1_llff",
    "tab2_blender",
    "tab3_noise",
    "tab4_ablation",
    "tab4_embedded",
    "tab4_fern",
    "tabA1_capacity",
    "tabA2_noise",
    "variants",
    "variants_blender",
];

/// Writes a sweep file at `file`: the commented one, or the shipped one of that name with those that it extends beside it, under
/// their own names. Returns what was written, `file` first.
///
/// # Errors
/// A name that there is not; a file that is there already.
pub fn write_new(file: &Path, from: Option<&str>) -> Result<Vec<PathBuf>> {
    let mut files = vec![(file.to_path_buf(), TEMPLATE)];
    if let Some(name) = from {
        files = vec![(file.to_path_buf(), shipped(name)?)];
        let mut base = base_of(files[0].1);
        while let Some(name) = base {
            let text = shipped(&name)?;
            files.push((file.with_file_name(format!("{name}.toml")), text));
            base = base_of(text);
        }
    }
    for (index, (path, text)) in files.iter().enumerate() {
        // A base that is there as it is shipped serves.
        let same = index > 0 && std::fs::read(path).is_ok_and(|found| found == text.as_bytes());
        let taken = path.symlink_metadata().is_ok() || files[..index].iter().any(|(other, _)| other == path);
        if taken && !same {
            return Err(Error::Output(format!("{} is there already: name another file", path.display())));
        }
    }
    files.iter().try_for_each(|(path, text)| write_atomic(path, text.as_bytes()))?;
    Ok(files.into_iter().map(|(path, _)| path).collect())
}

fn shipped(name: &str) -> Result<&'static str> {
    let plain = name.trim_end_matches(".toml").trim_start_matches("sweeps/");
    SHIPPED.iter().find(|(known, _)| *known == plain).map(|(_, text)| *text).ok_or_else(|| {
        let names: Vec<&str> = SHIPPED.iter().map(|(name, _)| *name).collect();
        Error::Config(format!("--from {name}: no sweep of this name is shipped; choose from {}", names.join(", ")))
    })
}

/// The shipped file that a text extends, by its name.
fn base_of(text: &str) -> Option<String> {
    let table: toml::Table = toml::from_str(text).ok()?;
    let base = table.get("extends")?.as_str()?;
    Some(base.trim_end_matches(".toml").to_string())
}
