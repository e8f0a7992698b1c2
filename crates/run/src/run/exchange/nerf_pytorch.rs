//! nerf-pytorch's names of a field's layers, and the fields that it supports.

use crate::base::{Error, Result};
use crate::settings::{Config, DensityActivation, Encoding};

/// Keys of its checkpoints: networks by role, Adam, step.
pub const NETWORKS: [(&str, &str); 2] = [("coarse", "network_fn_state_dict"), ("fine", "network_fine_state_dict")];
pub const OPTIMIZER: &str = "optimizer_state_dict";
pub const STEP: &str = "global_step";

/// Returns a parameter's name there, from its name in a field here (`trunk.0.weight`), or `None` for a layer that it
/// does not have.
pub fn name(ours: &str) -> Option<String> {
    let (layer, kind) = ours.rsplit_once('.')?;
    let theirs = match layer {
        "density" => "alpha_linear".to_string(),
        "feature" => "feature_linear".to_string(),
        "rgb" => "rgb_linear".to_string(),
        "view" => "views_linears.0".to_string(),
        trunk => format!("pts_linears.{}", trunk.strip_prefix("trunk.")?),
    };
    Some(format!("{theirs}.{kind}"))
}

/// Returns the position of a network's parameter in Adam's state: the order in which modules were created.
pub fn order(theirs: &str) -> usize {
    const MODULES: [&str; 5] = ["pts_linears", "views_linears", "feature_linear", "alpha_linear", "rgb_linear"];
    let module = MODULES.iter().position(|module| theirs.starts_with(module)).unwrap_or(MODULES.len());
    let layer = theirs.split('.').nth(1).and_then(|layer| layer.parse::<usize>().ok()).unwrap_or(0);
    2 * (1000 * module + layer) + usize::from(theirs.ends_with("bias"))
}

/// Returns an error for fields that nerf-pytorch would render differently.
pub fn check(config: &Config) -> Result<()> {
    let field = &config.field;
    let refused = |what: String| {
        Err(Error::Config(format!(
            "nerf-pytorch has no {what}, so its image would differ; export to .safetensors instead"
        )))
    };
    if field.encoding != Encoding::Positional {
        return refused(format!("field.encoding = \"{}\"", crate::settings::word(field.encoding)));
    }
    if field.density_activation != DensityActivation::Relu {
        return refused(format!("field.density_activation = \"{}\"", crate::settings::word(field.density_activation)));
    }
    if field.rgb_limit != 0.0 {
        return refused(format!("field.rgb_limit = {}", field.rgb_limit));
    }
    if field.rgb_padding != 0.0 {
        return refused(format!("field.rgb_padding = {}", field.rgb_padding));
    }
    if field.view_depth != 1 || field.view_neurons() != field.width / 2 {
        let (depth, neurons) = (field.view_depth, field.view_neurons());
        return refused(format!("{depth} layers of {neurons} neurons before colour, but 1 of {}", field.width / 2));
    }
    // Its layer after the fifth reads the position again (skips=[4] in its own count). Fields with fewer layers have
    // no such layer.
    let skips: &[usize] = if field.depth > 5 { &[5] } else { &[] };
    if field.depth == 5 || field.skips != skips {
        return refused(format!(
            "field.depth = {} with field.skips = {:?}, but [5] at depths from 6 on, and [] at depths up to 4",
            field.depth, field.skips
        ));
    }
    Ok(())
}
