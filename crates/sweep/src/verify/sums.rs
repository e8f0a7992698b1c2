//! Files that people made and no program makes again: `SHA256SUMS` in the folder of all results, as `sha256sum` writes it.

use std::path::{Path, PathBuf};

use super::findings::Findings;
use super::tree::{Tree, names_in};
use crate::base::input::{TEXT_BYTES, read_text};
use crate::base::{Error, Result};
use crate::outputs::optional;
use crate::train::sha256;

/// The file's name, in the folder of all results.
const SUMS: &str = "SHA256SUMS";
/// Endings of image files.
const IMAGES: [&str; 6] = ["jpg", "jpeg", "png", "svg", "gif", "webp"];

/// The name of a plan, which is frozen before what it plans is run.
const PLAN: &str = "PLAN.md";

/// Compares each listed file of `tree`, a part of all results or `all` of them, with its hash, and demands that images and plans
/// in groups are listed.
pub fn check(root: &Path, tree: &Tree, all: &Tree, findings: &mut Findings) -> Result<()> {
    let is_all = tree.leaves.len() == all.leaves.len();
    let file = root.join(SUMS);
    let sums = if file.is_file() { parse(&file)? } else { Vec::new() };
    let groups = groups(tree);
    let (mut wrong, mut count) = (Vec::new(), 0);
    for (hash, name) in &sums {
        let path = root.join(name);
        if !is_all && !groups.iter().any(|group| path.starts_with(group)) {
            continue;
        }
        count += 1;
        match optional(&path)? {
            None => wrong.push(format!("{name}: it is not there, {SUMS} has its hash")),
            Some(bytes) if sha256(&bytes) != *hash => wrong.push(format!(
                "{name}: it is not the file of which {SUMS} has the hash; restore it, or write the new hash there (`sha256sum {name}`)"
            )),
            Some(_) => {}
        }
    }
    let listed = |path: &Path| sums.iter().any(|(_, name)| root.join(name) == path);
    for group in &groups {
        let files = names_in(group)?.into_iter().map(|name| group.join(name));
        for path in files.filter(|path| (is_image(path) || path.ends_with(PLAN)) && !listed(path)) {
            findings.not_checked(format!("{}: nothing here makes it, and {SUMS} does not list it", path.display()));
        }
    }
    if count > 0 {
        findings.of(format!("{count} files that no program makes have their hashes in {SUMS}"), wrong);
    }
    Ok(())
}

/// The folders of pages, by their absolute paths.
fn groups(tree: &Tree) -> Vec<PathBuf> {
    let folders = tree.pages.iter().filter_map(|page| page.parent()).filter(|folder| !tree.is_leaf(folder));
    let mut folders: Vec<PathBuf> = folders.filter_map(|folder| std::path::absolute(folder).ok()).collect();
    folders.sort();
    folders.dedup();
    folders
}

fn is_image(path: &Path) -> bool {
    path.extension().is_some_and(|ending| IMAGES.iter().any(|known| ending.eq_ignore_ascii_case(known)))
}

/// Hash and name of each line.
fn parse(file: &Path) -> Result<Vec<(String, String)>> {
    let text = read_text(file, TEXT_BYTES).map_err(|e| Error::unreadable(file, &e))?;
    let lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    let parsed = lines.map(|(index, line)| {
        let parts = line.split_once("  ").or_else(|| line.split_once(" *"));
        let is_hash = |hash: &str| hash.len() == 64 && hash.bytes().all(|byte| byte.is_ascii_hexdigit());
        match parts.filter(|(hash, _)| is_hash(hash)) {
            Some((hash, name)) => Ok((hash.to_ascii_lowercase(), name.to_string())),
            None => Err(Error::Data(format!(
                "{}, line {}: it is not `HASH  FILE`, as `sha256sum` writes it",
                file.display(),
                index + 1
            ))),
        }
    });
    parsed.collect()
}
