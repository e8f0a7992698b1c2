use crate::settings::{Config, DataKind, build, parse_assignment};

fn built(set: &[&str]) -> Config {
    let set: Vec<_> = set.iter().map(|text| parse_assignment(text).unwrap()).collect();
    build(None, None, &set).unwrap()
}

#[test]
fn a_setting_of_another_method_is_told_why() {
    let why = |set: &[&str], path: &str| built(set).without_effect(path).unwrap_or_default();
    for (set, path, words) in [
        (&[][..], "perturb.t.epsilon", "method nerf has no perturbed pass"),
        (&["method=mip-nerf"], "perturb.lambda", "method mip-nerf has no perturbed pass"),
        (&[], "regularizer.weight", "regularizer.kind names no term; choose from l1, tv, laplacian, distortion"),
        (&[], "field.hash.levels", "hash grids need \"hash\""),
        (&["method=srn"], "field.width", "method srn has no field"),
        (&[], "srn.steps", "only method srn reads it"),
    ] {
        assert!(why(set, path).contains(words), "{path}: {}", why(set, path));
    }
    for (set, path) in [
        (&["method=aug-nerf"][..], "perturb.lambda"),
        (&["regularizer.kind=tv"], "regularizer.weight"),
        (&[], "regularizer.kind"),
        (&["field.encoding=hash"], "field.hash.levels"),
        (&["method=srn"], "srn.steps"),
        (&[], "train.stepz"),
        (&[], "seed"),
    ] {
        assert_eq!(why(set, path), "", "{path}");
    }
}

/// Each line has settings, a setting without effect there, words of the reason, and a further setting with which it has one.
#[test]
fn settings_count_where_they_are_read() {
    let (aug, uniform, clean) = ("method=aug-nerf", "perturb.kind=uniform", "perturb.kind=fresh-jitter");
    let off = |site: &str| format!("perturb.{site}.passes=off");
    let [xyz, feature, rgb, density] = ["xyz", "feature", "rgb", "density"].map(off);
    let noise = "data.corruption.kind=shot-noise";
    for (set, path, words, further) in [
        (&["train.batching=all-images"][..], "train.precrop_steps", "\"all-images\"", "train.batching=one-image"),
        (&["method=llff"], "train.rays", "windows of views", "method=srn"),
        (&[], "train.final_learning_rate", "\"exponential\"", "train.schedule=log-linear"),
        (&["train.schedule=log-linear"], "train.decay_steps", "\"log-linear\"", "train.schedule=exponential"),
        (&["field.encoding=hash"], "train.coarse_weight", "\"hash\"", "field.encoding=positional"),
        (&["method=srn"], "train.coarse_weight", "method srn has no field", "method=nerf"),
        (&[], "train.eval_stride", "train.eval_every is 0", "train.eval_every=5"),
        (&[], "sampling.resample_padding", "\"positional\"", "field.encoding=hash"),
        (&["field.encoding=hash"], "field.position_octaves", "\"hash\"", "field.encoding=positional"),
        (&[], "eval.mesh.threshold", "eval.mesh.resolution is 0", "eval.mesh.resolution=16"),
        (&["method=nv"], "nv.kl", "\"fixed\"", "nv.code=variational"),
        (&[aug, uniform], "perturb.t.steps", "\"uniform\", which searches nothing", "perturb.kind=permuted"),
        (&[aug, uniform], "perturb.xyz.step_size", "searches nothing", "perturb.xyz.epsilon=reach"),
        (&[aug, clean], "perturb.t.epsilon", "\"fresh-jitter\", a second pass without deltas", uniform),
        (&[aug, clean], "perturb.attack", "without deltas", uniform),
        (&[aug, &feature], "perturb.injection_layer", "perturb.feature.passes is", "perturb.feature.passes=fine"),
        (&[aug, &feature], "perturb.feature.epsilon", "passes is \"off\"", "perturb.feature.passes=fine"),
        (&[aug, &rgb, &density], "perturb.output", "perturb.rgb.passes and", "perturb.rgb.passes=coarse"),
        (&[aug, &xyz], "perturb.xyz_radius", "perturb.xyz.passes is \"off\"", "perturb.xyz.passes=both"),
        (&[], "data.corruption.severity", "data.corruption.kind is \"none\"", noise),
        (&[noise], "data.corruption.share", "\"shot-noise\"; pepper", "data.corruption.kind=pepper"),
        (&["data.width=16"], "data.downscale", "data.width is 16", "data.width=0"),
    ] {
        let located = |set: &[&str]| built(set).locate(DataKind::BuiltinBlender).unwrap();
        let why = located(set).without_effect(path).unwrap_or_default();
        assert!(why.contains(words), "{set:?} {path}: {why}");
        let all = [set, &[further]].concat();
        assert_eq!(located(&all).without_effect(path), None, "{all:?} {path}");
    }
    let control = built(&[aug, clean]);
    for path in ["perturb.kind", "perturb.lambda", "perturb.objective", "perturb.entries"] {
        assert_eq!(control.without_effect(path), None, "{path}");
    }
}

#[test]
fn settings_of_a_scene_count_where_its_kind_reads_them() {
    let idle = |set: &[&str], kind, path| built(set).locate(kind).unwrap().without_effect(path);
    for (kind, path, words) in [
        (DataKind::Blender, "data.ndc", Some("\"blender\"; scenes of llff, builtin-forward read it")),
        (DataKind::Llff, "data.colmap_model", Some("scenes of colmap read it")),
        (DataKind::Llff, "data.rescale", Some("outside normalized device coordinates")),
        (DataKind::BuiltinBlender, "data.validation", Some("splits of its own")),
        (DataKind::BuiltinForward, "data.validation", None),
        (DataKind::Blender, "data.holdout", None),
        (DataKind::Colmap, "data.rescale", None),
        (DataKind::Llff, "data.axes", None),
    ] {
        let why = idle(&[], kind, path);
        assert_eq!(why.is_some(), words.is_some(), "{path}: {why:?}");
        assert!(why.unwrap_or_default().contains(words.unwrap_or_default()), "{path}");
        assert_eq!(built(&[]).without_effect(path), None, "{path} of a scene that is not known yet");
    }
    assert_eq!(idle(&["data.ndc=false"], DataKind::Llff, "data.rescale"), None);
    assert!(idle(&["data.split=own"], DataKind::Transforms, "data.holdout").is_some());
}
