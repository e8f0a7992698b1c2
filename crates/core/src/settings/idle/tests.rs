use crate::settings::{Config, DataKind, build, parse_assignment};

fn built(set: &[&str]) -> Config {
    let set: Vec<_> = set.iter().map(|text| parse_assignment(text).unwrap()).collect();
    build(None, None, &set).unwrap()
}

#[test]
fn a_setting_without_effect_is_told_why() {
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

/// Settings, a setting without effect there, words of the reason, and a further setting with which it has one.
type Case<'a> = (&'a [&'a str], &'a str, &'a str, &'a str);

/// Checks each case on a located scene, with and without its further setting.
fn check(kind: DataKind, cases: &[Case]) {
    for (set, path, words, further) in cases {
        let located = |set: &[&str]| built(set).locate(kind).unwrap();
        let why = located(set).without_effect(path).unwrap_or_default();
        assert!(why.contains(words) && !words.is_empty(), "{set:?} {path}: {why}");
        let all = [*set, &[*further]].concat();
        assert_eq!(located(&all).without_effect(path), None, "{all:?} {path}");
    }
}

#[test]
fn settings_of_training_and_samples_count_where_they_are_read() {
    let all_images = "train.batching=all-images";
    check(
        DataKind::BuiltinBlender,
        &[
            (&[all_images], "train.precrop_steps", "\"all-images\"", "train.batching=one-image"),
            (&[all_images], "train.precrop_fraction", "\"all-images\"", "train.batching=one-image"),
            (&["train.precrop_steps=0"], "train.precrop_fraction", "precrop_steps is 0", "train.precrop_steps=1"),
            (&["method=llff"], "train.rays", "windows of views", "method=srn"),
            (&[], "train.final_learning_rate", "\"exponential\"", "train.schedule=log-linear"),
            (&[], "train.warmup_share", "\"exponential\"", "train.schedule=log-linear"),
            (&["train.schedule=log-linear"], "train.decay_steps", "\"log-linear\"", "train.schedule=exponential"),
            (&["train.schedule=log-linear"], "train.decay_rate", "\"log-linear\"", "train.schedule=exponential"),
            (&["train.decay_rate=1"], "train.decay_steps", "decay_rate is 1", "train.decay_rate=0.5"),
            (
                &["train.schedule=log-linear", "train.warmup_share=0"],
                "train.warmup_from",
                "warmup_share is 0",
                "train.warmup_share=0.5",
            ),
            (&["sampling.fine=0"], "train.coarse_weight", "sampling.fine is 0", "sampling.fine=8"),
            (&["field.encoding=hash"], "train.coarse_weight", "\"hash\"", "field.encoding=positional"),
            (&["method=srn"], "train.coarse_weight", "method srn has no field", "method=nerf"),
            (&["field.density_activation=exp"], "train.dead_start_share", "\"exp\"", "field.density_activation=relu"),
            (&[], "train.eval_stride", "train.eval_every is 0", "train.eval_every=5"),
            (&[], "sampling.resample_padding", "\"positional\"", "field.encoding=hash"),
            (&["method=mip-nerf", "sampling.fine=0"], "sampling.resample_padding", "fine is 0", "sampling.fine=8"),
            (&["field.encoding=hash"], "field.position_octaves", "\"hash\"", "field.encoding=positional"),
            (
                &["field.encoding=hash", "field.hash.levels=1"],
                "field.hash.finest",
                "field.hash.levels is 1",
                "field.hash.levels=2",
            ),
            (
                &["regularizer.kind=tv", "regularizer.points=full"],
                "regularizer.points_per_step",
                "\"full\"",
                "regularizer.points=sampled",
            ),
            (&[], "eval.mesh.threshold", "eval.mesh.resolution is 0", "eval.mesh.resolution=16"),
            (&[], "eval.mesh.box", "eval.mesh.resolution is 0", "eval.mesh.resolution=16"),
            (
                &["eval.mesh.resolution=16", "eval.mesh.reference=none"],
                "eval.mesh.at",
                "\"none\"",
                "eval.mesh.reference=",
            ),
            (&["method=nv"], "nv.kl", "\"fixed\"", "nv.code=variational"),
            (&["method=nv", "nv.warp=false"], "nv.warp_resolution", "nv.warp is false", "nv.warp=true"),
        ],
    );
}

#[test]
fn settings_of_a_perturbed_pass_count_where_it_has_such_deltas() {
    let (aug, uniform, clean) = ("method=aug-nerf", "perturb.kind=uniform", "perturb.kind=fresh-jitter");
    let searched = "perturb.kind=worst-case";
    let off = |site: &str| format!("perturb.{site}.passes=off");
    let [xyz, feature, rgb, density] = ["xyz", "feature", "rgb", "density"].map(off);
    check(
        DataKind::BuiltinBlender,
        &[
            (&[aug, uniform], "perturb.t.steps", "\"uniform\", which searches nothing", "perturb.kind=permuted"),
            (&[aug, uniform], "perturb.xyz.step_size", "searches nothing", "perturb.xyz.epsilon=reach"),
            (&[aug, uniform], "perturb.step_unit", "searches nothing", "perturb.kind=best-case"),
            (&[aug, clean], "perturb.t.epsilon", "\"fresh-jitter\", a second pass without deltas", uniform),
            (&[aug, clean], "perturb.rgb.passes", "without deltas", uniform),
            (&[aug, clean], "perturb.attack", "without deltas", uniform),
            (&[aug, clean], "perturb.levels", "without deltas", searched),
            (&[aug, clean], "perturb.geometry", "without deltas", searched),
            (
                &[aug, &feature],
                "perturb.injection_layer",
                "perturb.feature.passes is \"off\"",
                "perturb.feature.passes=fine",
            ),
            (&[aug, &feature], "perturb.feature.epsilon", "passes is \"off\"", "perturb.feature.passes=fine"),
            (&[aug, &rgb, &density], "perturb.output", "perturb.rgb.passes and", "perturb.rgb.passes=coarse"),
            (&[aug, &density], "perturb.perturb_last", "perturb.density.passes is", "perturb.density.passes=both"),
            (&[aug, "field.encoding=hash"], "perturb.perturb_last", "\"hash\"", "field.encoding=positional"),
            (&[aug, &xyz], "perturb.xyz_radius", "perturb.xyz.passes is \"off\"", "perturb.xyz.passes=both"),
            (&[aug, "sampling.fine=0"], "perturb.resample", "sampling.fine is 0", "sampling.fine=8"),
            (&[aug, "perturb.t.steps=0"], "perturb.t.step_size", "perturb.t.steps is 0", "perturb.t.steps=1"),
            (&[aug, "perturb.rgb.epsilon=0"], "perturb.rgb.norm", "perturb.rgb.epsilon is 0", "perturb.rgb.epsilon=1"),
        ],
    );
    let control = built(&[aug, clean]);
    for path in ["perturb.kind", "perturb.lambda", "perturb.objective", "perturb.entries"] {
        assert_eq!(control.without_effect(path), None, "{path}");
    }
}

#[test]
fn settings_of_a_scene_count_where_its_kind_reads_them() {
    let noise = "data.corruption.kind=shot-noise";
    check(
        DataKind::Llff,
        &[
            (&[], "data.corruption.severity", "data.corruption.kind is \"none\"", noise),
            (&[noise], "data.corruption.share", "\"shot-noise\"; pepper", "data.corruption.kind=pepper"),
            (&[noise], "data.corruption.degrees", "\"shot-noise\"; poses", "data.corruption.kind=poses"),
            (&["data.width=16"], "data.downscale", "data.width is 16", "data.width=0"),
            (&[], "data.rescale", "outside normalized device coordinates", "data.ndc=false"),
        ],
    );
    check(DataKind::Transforms, &[(&["data.split=own"], "data.holdout", "splits of its own", "data.split=every")]);
    let idle = |kind: DataKind, path: &str| built(&[]).locate(kind).unwrap().without_effect(&format!("data.{path}"));
    let kinds = [
        DataKind::Llff,
        DataKind::Blender,
        DataKind::Transforms,
        DataKind::Colmap,
        DataKind::BuiltinBlender,
        DataKind::BuiltinForward,
    ];
    for (path, read_by) in [
        ("ndc", &[DataKind::Llff, DataKind::BuiltinForward][..]),
        ("bound_factor", &[DataKind::Llff]),
        ("spherify", &[DataKind::Llff]),
        ("recognise_orbits", &[DataKind::Llff]),
        ("recentre", &[DataKind::Llff, DataKind::Transforms, DataKind::Colmap]),
        ("rescale", &[DataKind::Transforms, DataKind::Colmap]),
        ("colmap_model", &[DataKind::Colmap]),
        ("masks", &[DataKind::Llff, DataKind::Blender, DataKind::Transforms, DataKind::Colmap]),
        ("split", &[DataKind::Transforms]),
        ("validation", &[DataKind::Llff, DataKind::Transforms, DataKind::Colmap, DataKind::BuiltinForward]),
        ("holdout_offset", &[DataKind::Llff, DataKind::Transforms, DataKind::Colmap, DataKind::BuiltinForward]),
        // If none of its split's photos is there, every N-th view of a Blender scene is held out.
        ("holdout", &kinds.map(|kind| if kind == DataKind::BuiltinBlender { DataKind::Blender } else { kind })),
        // `render --cameras` reads them for runs of all kinds.
        ("axes", &kinds),
        ("near", &kinds),
    ] {
        for kind in kinds {
            assert_eq!(idle(kind, path).is_none(), read_by.contains(&kind), "data.{path} of {}", kind.name());
        }
        assert_eq!(built(&[]).without_effect(&format!("data.{path}")), None, "a scene that is not known yet");
    }
}
