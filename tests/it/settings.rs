//! The table of settings: its page, its command, its columns.

use std::path::Path;

use augnerf::run::{Protocol, columns};
use augnerf::settings::columns::{COLUMNS, find};
use augnerf::settings::registry::REGISTRY;
use augnerf::settings::{Method, settings_page};

use crate::common::program::{refuse, succeed};
use crate::common::{tiny_config, tiny_scene, trained};

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

#[test]
fn the_command_explains_settings() {
    let text = String::from_utf8(succeed(&["settings", "warmup"]).stdout).unwrap();
    assert!(
        text.contains("train.warmup_share = 0.0025\n") && text.contains("0 (no warm-up) to 1; changes numbers"),
        "{text}"
    );
    assert!(!text.contains("train.steps"), "{text}");
    refuse(&["settings", "train.stepz"], 2, &["did you mean 'train.steps'"]);
}

/// The protocol's columns are those of the table, each once, and settings name no others.
#[test]
fn the_table_of_columns_is_the_protocol() {
    let trainer = trained(&tiny_config(Method::AugNerf, |_| {}), 0);
    let protocol = Protocol::new(trainer.config(), &tiny_scene(), &trainer.state());
    let mut written: Vec<String> = columns(&protocol).into_iter().map(|(name, _)| name).collect();
    let mut listed: Vec<&str> = COLUMNS.iter().map(|column| column.name).collect();
    written.sort();
    listed.sort_unstable();
    assert_eq!(written, listed);
    for setting in &REGISTRY.settings {
        assert!(setting.rule.columns.iter().all(|name| find(name).is_some()), "{}", setting.path);
    }
}
