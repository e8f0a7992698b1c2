//! The table of settings: its page, its command, its columns.

use std::path::Path;

use augnerf::perturb::{Norm, PaperSite, Passes};
use augnerf::run::{Protocol, columns};
use augnerf::settings::columns::COLUMNS;
use augnerf::settings::{Config, Core, Method, Preset, Schedule, TrainViews, build, parse_assignment, settings_page};

use crate::common::program::Place;
use crate::common::{put_on_grid, tiny_config, tiny_scene, trained};

/// `AUGNERF_UPDATE_DOCS=1 cargo test settings` writes the page anew.
#[test]
fn the_page_of_settings_is_current() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/settings.md");
    let page = settings_page();
    if std::env::var_os("AUGNERF_UPDATE_DOCS").is_some() {
        std::fs::write(&file, &page).unwrap();
    }
    let kept = std::fs::read_to_string(&file).unwrap();
    assert!(kept == page, "docs/settings.md is not what the program says; write it anew with AUGNERF_UPDATE_DOCS=1");
    for path in ["train.steps", "perturb.density.epsilon", "eval.mesh.box", "data.corruption.kind"] {
        let (section, key) = path.rsplit_once('.').unwrap();
        let rows = page.split_once(&format!("## `{section}`")).expect(section).1;
        assert!(rows.split("\n## ").next().unwrap().contains(&format!("| `{key}` |")), "{path}");
    }
}

/// Returns the settings of a row of a shipped sweep, without its seeds. `row` is what the row sets.
fn set_of_sweep(name: &str, row: &[&str]) -> toml::Table {
    let read = |name: &str| -> toml::Table {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("sweeps/few_views/{name}.toml"));
        toml::from_str(&std::fs::read_to_string(file).unwrap()).unwrap()
    };
    let own = read(name);
    let base = own.get("extends").map(|base| read(base.as_str().unwrap().trim_end_matches(".toml")));
    let tables = base.iter().chain([&own]).map(|table| table["set"].as_table().unwrap());
    let set = tables.flatten().map(|(key, value)| format!("{key}={value}")).chain(row.iter().map(|&text| text.into()));
    let set: Vec<_> = set.map(|text| parse_assignment(&text).unwrap()).collect();
    build(Some(Preset::Fast), None, &set).unwrap().to_table()
}

#[test]
fn presets_of_few_views_train_as_the_sweeps_do() {
    let curves = ["train.eval_every=75", "train.eval_stride=10", "eval.pictures=1"];
    let set = |preset, further: &[&str]| {
        let set: Vec<_> = curves.iter().chain(further).map(|text| parse_assignment(text).unwrap()).collect();
        build(Some(preset), None, &set).unwrap().to_table()
    };
    assert_eq!(set(Preset::FewViewsLlff, &[]), set_of_sweep("few_views_llff_3", &[]));
    assert_eq!(set(Preset::FewViewsLlff, &["data.train_views=6 even"]), set_of_sweep("few_views_llff_6", &[]));
    assert_eq!(set(Preset::FewViewsBlender, &[]), set_of_sweep("few_views_blender_8", &[]));
    let of_scenes = ["train.eval_every=500", "data.train_views=8 disjoint", "train.collapse_steps=0"];
    let row = ["regularizer.kind=occlusion", "regularizer.weight=0.03"];
    assert_eq!(set(Preset::FewViews, &of_scenes), set_of_sweep("scenes", &row));
}

/// Words need no quotes, and those of other programs lead somewhere.
#[test]
fn the_command_explains_settings() {
    let place = Place::new();
    let said = place.run("settings warmup", 0);
    assert!(said.contains("train.warmup_share = 0.0025\n") && !said.contains("train.steps"), "{said}");
    assert!(said.contains("0 (no warm-up) to 1; changes numbers"), "{said}");
    place.says("settings train.stepz", 2, &["did you mean 'train.steps'"]);
    for words in ["total variation", "regulariser", "tv"] {
        place.says(&format!("settings {words}"), 0, &["regularizer.weight = ", "tv 3.8e-6"]);
    }
}

/// Files have the protocol's columns in the order of the table.
#[test]
fn the_table_of_columns_is_the_protocol() {
    let trainer = trained(&tiny_config(Method::AugNerf, |_| {}), 0);
    let protocol = Protocol::new(trainer.config(), &tiny_scene(), &trainer.state());
    let written: Vec<String> = columns(&protocol).into_iter().map(|(name, _)| name).collect();
    let listed: Vec<&str> = COLUMNS.iter().map(|column| column.name).collect();
    assert_eq!(written, listed);
    assert_eq!(protocol.text("instructions"), trainer.state().instructions.join(" + "));
    assert!(!protocol.text("instructions").is_empty());
}

/// The protocol of a run that has not begun.
fn protocol_of(method: Method, change: impl FnOnce(&mut Config)) -> Protocol {
    let trainer = trained(&tiny_config(method, change), 0);
    Protocol::new(trainer.config(), &tiny_scene(), &trainer.state())
}

/// Demands columns of a protocol: `column=text` with spaces between.
#[track_caller]
fn assert_columns(protocol: &Protocol, columns: &str) {
    for (column, text) in columns.split_whitespace().map(|column| column.split_once('=').unwrap()) {
        assert_eq!(protocol.text(column), text, "{column}");
    }
}

/// What moves a number and hid in no column (encoding, padding, noise, batches, norms, ...) stands in its own, as it was
/// set, filled from the scene, or empty where it has no part in the run.
#[test]
fn columns_hold_the_values_of_settings() {
    let nerf = protocol_of(Method::Nerf, |config| {
        config.field.skips = vec![1, 3];
        config.train.chunk = 17;
        config.eval.chunk = 19;
        config.train.precrop_steps = Some(7);
        config.eval.train_views = Some(2);
        config.data.views_seed = 5;
    });
    assert_columns(&nerf, "encoding=positional view_octaves=2 skips=[1,3] density_noise=0.0 precrop_steps=7 chunk=17");
    assert_columns(&nerf, "eval_chunk=19 core=fused precision=f32 views_seen=2 views_seed=5");
    // No part in this run.
    assert_columns(&nerf, "resample_padding= norms= lambda=");
    let mip = protocol_of(Method::AugMipNerf, |config| {
        config.train.schedule = Schedule::LogLinear;
        config.field.core = Core::Plain;
        config.perturb[PaperSite::Xyz].norm = Some(Norm::Linf);
        config.data.train_views = Some(TrainViews::Named(vec!["r_2".into(), "r_26".into()]));
    });
    assert_columns(&mip, "encoding=integrated position_octaves=6 rgb_padding=0.001 resample_padding=0.01");
    assert_columns(&mip, "warmup_share=0.0025 core=plain xyz_radius=pixel lambda=0.1");
    assert_eq!(mip.text("norms"), "xyz linf, view linf, feature linf, rgb linf");
    assert_eq!(mip.text("training_views"), "r_2 r_26");
}

/// Columns of what a field on a hash grid does not read are empty, and its attack is that of the fine pass.
#[test]
fn columns_of_a_hash_field_tell_what_it_reads() {
    for (levels, grid) in [(2, "2 x 2, 2^8, 16 to "), (1, "1 x 2, 2^8, 16, linear")] {
        let protocol = protocol_of(Method::AugNerf, |config| {
            put_on_grid(config, 8);
            config.field.hash.levels = levels;
            config.perturb[PaperSite::Xyz].passes = Passes::Fine;
            config.perturb[PaperSite::View].passes = Passes::Off;
        });
        assert_columns(&protocol, "position_octaves= coarse_weight= view_octaves=2");
        assert_eq!(protocol.text("levels"), "t:fine xyz:fine feature:fine rgb:fine density:fine");
        assert!(protocol.text("hash_grid").starts_with(grid), "{}", protocol.text("hash_grid"));
    }
}
