//! Modules import downwards only, as the table at the top of `src/lib.rs` says.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// `module -> tier`, read from the table itself.
fn tiers() -> HashMap<String, u32> {
    let text = std::fs::read_to_string(root().join("lib.rs")).unwrap();
    let mut tiers = HashMap::new();
    for line in text.lines() {
        let cells: Vec<&str> = line.trim_start_matches("//!").split('|').map(str::trim).collect();
        let Some(tier) = cells.get(1).and_then(|cell| cell.parse::<u32>().ok()) else { continue };
        for module in cells[2].split(',') {
            tiers.insert(module.trim().trim_matches('`').to_string(), tier);
        }
    }
    tiers
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src")
}

fn sources(dir: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().path());
    entries
        .flat_map(|path| if path.is_dir() { sources(&path) } else { vec![path] })
        .filter(|path| path.extension().is_some_and(|ending| ending == "rs"))
        .collect()
}

/// The top-level modules that a source names after `crate::`, test code left out.
fn used(text: &str) -> Vec<String> {
    let code = text.split("#[cfg(test)]\nmod tests").next().unwrap();
    let lines = code.lines().filter(|line| !line.trim_start().starts_with("//"));
    let named = |line: &str| -> Vec<String> {
        let after = line.split("crate::").skip(1);
        after.map(|rest| rest.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect()).collect()
    };
    lines.flat_map(named).collect()
}

#[test]
fn every_module_is_in_the_table_and_the_table_holds_no_other() {
    let text = std::fs::read_to_string(root().join("lib.rs")).unwrap();
    let mut declared: Vec<&str> =
        text.lines().filter_map(|line| line.strip_prefix("pub mod ")?.strip_suffix(';')).collect();
    let tiers = tiers();
    let mut listed: Vec<&str> = tiers.keys().map(String::as_str).collect();
    declared.sort_unstable();
    listed.sort_unstable();
    assert_eq!(declared, listed);
}

#[test]
fn imports_go_down() {
    let tiers = tiers();
    let mut checked = 0;
    for path in sources(&root()) {
        let relative = path.strip_prefix(root()).unwrap();
        let module = relative.iter().next().unwrap().to_string_lossy().trim_end_matches(".rs").to_string();
        let Some(tier) = tiers.get(&module) else { continue };
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(!text.contains("crate::{"), "{}: name one module an import", relative.display());
        for name in used(&text) {
            let Some(other) = tiers.get(&name).filter(|_| name != module) else { continue };
            assert!(other < tier, "{} (tier {tier}) uses {name} (tier {other})", relative.display());
            checked += 1;
        }
    }
    assert!(checked > 50, "only {checked} imports were seen: the search is broken");
}
