//! Lists the files of `sweeps/`: name, place in the repository and text of each.

use std::fs;
use std::path::Path;

fn main() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../sweeps");
    println!("cargo:rerun-if-changed={}", root.display());
    let mut list = String::new();
    for folder in names(&root).into_iter().filter(|folder| root.join(folder).is_dir()) {
        for file in names(&root.join(&folder)) {
            if let Some(name) = file.strip_suffix(".toml") {
                let path = root.join(&folder).join(&file);
                list += &format!("({name:?}, {:?}, include_str!({path:?})),\n", format!("sweeps/{folder}/{file}"));
            }
        }
    }
    let out = std::env::var("OUT_DIR").expect("cargo names a folder");
    fs::write(Path::new(&out).join("shipped.rs"), format!("&[{list}]")).expect("the folder can be written");
}

/// Returns the names in a folder, in order.
fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display())).flatten();
    let mut names: Vec<String> = entries.filter_map(|entry| entry.file_name().into_string().ok()).collect();
    names.sort();
    names
}
