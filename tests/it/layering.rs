//! Modules import downwards only, as the table at the top of `src/lib.rs` says, and the files of a folder import along
//! no circle.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::Path;

use crate::common::files::files;

/// `module -> tier`, read from the table itself.
fn tiers() -> HashMap<String, u32> {
    let mut tiers = HashMap::new();
    for line in include_str!("../../src/lib.rs").lines() {
        let cells: Vec<&str> = line.trim_start_matches("//!").split('|').map(str::trim).collect();
        let Some(tier) = cells.get(1).and_then(|cell| cell.parse::<u32>().ok()) else { continue };
        for module in cells[2].split(',') {
            tiers.insert(module.trim().trim_matches('`').to_string(), tier);
        }
    }
    tiers
}

/// Sources by module: `src/a/b.rs` and `src/a/b/mod.rs` are both `[a, b]`.
type Sources = BTreeMap<Vec<String>, String>;

/// A module's path, or one that a source names.
fn path(text: &str) -> Vec<String> {
    text.split("::").map(String::from).collect()
}

/// The program's sources, test code and comments left out.
fn sources() -> Sources {
    let code = |text: &str| {
        let code = text.split("#[cfg(test)]\nmod tests").next().unwrap();
        code.lines().map(|line| line.split("//").next().unwrap()).collect::<Vec<_>>().join("\n")
    };
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let rust = files(&root, &[]).into_iter().filter(|(file, _)| file.extension().is_some_and(|ending| ending == "rs"));
    let module = |file: &Path| {
        let stem = file.with_extension("");
        let names = stem.iter().map(|name| name.to_string_lossy().into_owned());
        names.filter(|name| name != "mod").collect::<Vec<String>>()
    };
    rust.map(|(file, bytes)| (module(&file), code(&String::from_utf8(bytes).unwrap()))).collect()
}

/// Names and marks of a source: `a::{b, c}` gives `a`, `::`, `{`, `b`, `,`, `c` and `}`.
fn tokens(code: &str) -> Vec<&str> {
    let mut rest = code.trim_start();
    let mut tokens = Vec::new();
    while let Some(first) = rest.chars().next() {
        let length = match rest.find(|c: char| !(c.is_alphanumeric() || c == '_')) {
            Some(0) if rest.starts_with("::") => 2,
            Some(0) => first.len_utf8(),
            end => end.unwrap_or(rest.len()),
        };
        tokens.push(&rest[..length]);
        rest = rest[length..].trim_start();
    }
    tokens
}

/// The paths that the tree at `tokens[*at]` stands for, each with its other name behind it where it has one:
/// `a::{b, c::d as e}` is `a::b` and `a::c::d::e`.
fn branches(tokens: &[&str], at: &mut usize) -> Vec<Vec<String>> {
    let name = tokens[*at];
    *at += 1;
    let next = |at: usize| tokens.get(at).copied().unwrap_or("");
    if name == "{" {
        let mut all = Vec::new();
        while !["}", ""].contains(&next(*at)) {
            all.extend(branches(tokens, at));
            *at += usize::from(next(*at) == ",");
        }
        *at += 1;
        return all;
    }
    let behind = match next(*at) {
        "::" | "as" => {
            *at += 1;
            branches(tokens, at)
        }
        _ => vec![vec![]],
    };
    behind.into_iter().map(|path| [vec![name.to_string()], path].concat()).collect()
}

/// Every path that a module names from `crate`, `self` or `super` on, as seen from the crate's root.
fn named(module: &[String], code: &str) -> Vec<Vec<String>> {
    let tokens = tokens(code);
    let starts = (0..tokens.len()).filter(|&i| {
        let whole = i == 0 || tokens[i - 1] != "::";
        whole && ["crate", "self", "super"].contains(&tokens[i]) && tokens.get(i + 1) == Some(&"::")
    });
    starts.flat_map(|mut at| branches(&tokens, &mut at)).map(|path| from_root(module, &path)).collect()
}

/// A path that a module names, as seen from the crate's root. Without one of the three words it begins in the module.
fn from_root(module: &[String], path: &[String]) -> Vec<String> {
    let mut root = module.to_vec();
    let mut rest = path;
    while let Some((first, behind)) = rest.split_first() {
        match first.as_str() {
            "crate" => root.clear(),
            "super" => drop(root.pop()),
            "self" => (),
            _ => break,
        }
        rest = behind;
    }
    [root, rest.to_vec()].concat()
}

/// What `folder/mod.rs` imports or re-exports under a name, as seen from the crate's root.
fn imported(sources: &Sources, folder: &[String], name: &str) -> Option<Vec<String>> {
    let tokens = tokens(sources.get(folder)?);
    let trees = (0..tokens.len()).filter(|&i| tokens[i] == "use").flat_map(|i| branches(&tokens, &mut (i + 1)));
    let found = trees.into_iter().find(|path| path.last().is_some_and(|last| last == name));
    found.map(|path| from_root(folder, &path))
}

/// `folder -> file -> files of the folder that it names`.
type Graphs = BTreeMap<Vec<String>, BTreeMap<String, BTreeSet<String>>>;

/// Which entries of a folder name which others. An entry is a file or a folder with all that is in it. An item that
/// `mod.rs` re-exports belongs to the entry that it comes from. `mod.rs` itself is the folder and no entry: it names its
/// files, and they take what it defines.
fn graphs(sources: &Sources) -> Graphs {
    let mut graphs = Graphs::new();
    for (module, code) in sources {
        for named in named(module, code) {
            let shared = module.iter().zip(&named).take_while(|(a, b)| a == b).count();
            if shared == 0 || shared == module.len() || shared == named.len() {
                continue;
            }
            let folder = &module[..shared];
            let is_entry = |path: &Vec<String>| {
                path.starts_with(folder) && path.get(..=shared).is_some_and(|entry| sources.contains_key(entry))
            };
            let target = Some(named.clone()).filter(is_entry);
            let target = target.or_else(|| imported(sources, folder, &named[shared]).filter(is_entry));
            let Some(target) = target.filter(|path| path[shared] != module[shared]) else { continue };
            let graph = graphs.entry(folder.to_vec()).or_default();
            graph.entry(module[shared].clone()).or_default().insert(target[shared].clone());
        }
    }
    graphs
}

/// A way along the edges from a name back to itself, if there is one.
fn circle(graph: &BTreeMap<String, BTreeSet<String>>) -> Option<Vec<String>> {
    // Names that lead to no other cannot lie on a circle, nor can those that lead to such names alone.
    let mut left = graph.clone();
    while let Some(end) = left.iter().find(|(_, to)| !to.iter().any(|name| left.contains_key(name))) {
        let end = end.0.clone();
        left.remove(&end);
    }
    let mut way = vec![left.keys().next()?.clone()];
    loop {
        let next = left[way.last().unwrap()].iter().find(|name| left.contains_key(*name)).unwrap().clone();
        let met = way.iter().position(|name| *name == next);
        way.push(next);
        if let Some(met) = met {
            return Some(way.split_off(met));
        }
    }
}

#[test]
fn every_module_is_in_the_table_and_the_table_holds_no_other() {
    let text = include_str!("../../src/lib.rs");
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
    for (module, code) in sources() {
        let Some(tier) = tiers.get(&module[0]) else { continue };
        for named in named(&module, &code) {
            let Some((name, other)) = named.first().and_then(|name| tiers.get_key_value(name)) else { continue };
            let down = other < tier || *name == module[0];
            assert!(down, "{} (tier {tier}) names {} (tier {other})", module.join("::"), named.join("::"));
            checked += usize::from(*name != module[0]);
        }
    }
    assert!(checked > 50, "only {checked} imports were seen: the search is broken");
}

#[test]
fn files_of_a_folder_import_along_no_circle() {
    let graphs = graphs(&sources());
    let edges: usize = graphs.values().flat_map(BTreeMap::values).map(BTreeSet::len).sum();
    assert!(edges > 50, "only {edges} imports within folders were seen: the search is broken");
    let circles = graphs.iter().filter_map(|(folder, graph)| {
        let circle = circle(graph)?;
        Some(format!("src/{}: {}", folder.join("/"), circle.join(" -> ")))
    });
    let circles: Vec<String> = circles.collect();
    assert!(circles.is_empty(), "files import each other in a circle:\n{}", circles.join("\n"));
}

#[test]
fn circles_are_found_through_groups_reexports_and_folders() {
    let circle_of = |files: &[(&str, &str)]| {
        let sources = files.iter().map(|(module, code)| (path(module), code.to_string())).collect();
        graphs(&sources).get(&path("a")).and_then(circle)
    };
    let face = ("a", "mod x; mod y; mod z; pub use x::X; use y::{inner::{Y as Why}, Other}; struct Own;");
    let x = |code| ("a::x", code);
    let circle = Some(path("x::y::x"));
    assert_eq!(circle_of(&[face, x("use super::y::f;"), ("a::y", "fn f() { super::x::g::<u8>(); }")]), circle);
    assert_eq!(circle_of(&[face, x("use crate::a::{Own, Why};"), ("a::y", "use super::X;")]), circle);
    let deep = [face, x("use super::y::f;"), ("a::y", ""), ("a::y::deep", "use super::super::{Own, X};")];
    assert_eq!(circle_of(&deep), circle);
    let longer = [face, x("use super::y;"), ("a::y", "use super::z::f;"), ("a::z", "use super::{X, Own};")];
    assert_eq!(circle_of(&longer), Some(path("x::y::z::x")));
    assert_eq!(circle_of(&[face, x("use super::{Own, y};"), ("a::y", "use super::Own; use crate::b::x;")]), None);
}
