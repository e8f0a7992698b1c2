//! nerf-pytorch's names of a field's layers.

/// Keys of its checkpoints: networks by role, step.
pub const NETWORKS: [(&str, &str); 2] = [("coarse", "network_fn_state_dict"), ("fine", "network_fine_state_dict")];
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
