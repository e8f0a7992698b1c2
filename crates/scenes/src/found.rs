//! Photos in folders: which are there, which of them a name means, and which are not used.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use unicode_normalization::UnicodeNormalization;

use super::images::{ENDINGS, Size, factor_of, is_image, list};
use augnerf_base::{Event, Listener, first_names};

/// Words in the names of images that are no photos: masks, and the maps of depth and normals of Blender scenes.
const NO_PHOTOS: [&str; 7] = ["mask", "masked", "depth", "normal", "alpha", "depthmap", "normalmap"];
/// Largest number of unused photos that are named.
const UNUSED_NAMED: usize = 5;

/// Least likeness (0 to 1) of a name that is suggested.
const NEAR: f64 = 0.6;

/// Folders below a scene's that are searched.
const DEEPEST: usize = 3;
/// Most files and folders that are searched.
const MOST_PATHS: usize = 100_000;

/// Returns the files and folders below a folder that can be seen, as paths within it, the less deep first.
pub(super) fn paths_below(folder: &Path) -> Vec<PathBuf> {
    let inside = |within: &Path| {
        let entries = std::fs::read_dir(folder.join(within)).into_iter().flatten().flatten();
        let seen = entries.map(|entry| entry.file_name()).filter(|name| !name.to_string_lossy().starts_with('.'));
        let mut paths: Vec<PathBuf> = seen.map(|name| within.join(name)).collect();
        paths.sort();
        paths
    };
    let mut found = inside(Path::new(""));
    let mut at = 0;
    while at < found.len() && found.len() < MOST_PATHS {
        if found[at].components().count() <= DEEPEST && folder.join(&found[at]).is_dir() {
            let more = inside(&found[at]);
            found.extend(more);
        }
        at += 1;
    }
    found
}

/// Returns the images below a folder as paths within it, in order.
pub(super) fn below(folder: &Path) -> Vec<PathBuf> {
    let is_file = |within: &PathBuf| is_image(within) && folder.join(within).is_file();
    let mut found: Vec<PathBuf> = paths_below(folder).into_iter().filter(is_file).collect();
    found.sort();
    found
}

/// Returns a file without detours and links, by which equal files are known.
pub(super) fn real(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| path.to_path_buf())
}

/// Notes photos that are not used because the same name with another ending is, and returns them.
pub(super) fn note_twins<'a>(
    scene: &Path,
    used: impl Iterator<Item = &'a PathBuf>,
    events: &dyn Listener,
) -> BTreeSet<PathBuf> {
    let used: BTreeSet<&PathBuf> = used.collect();
    let stems: BTreeSet<PathBuf> = used.iter().map(|path| path.with_extension("")).collect();
    let folders: BTreeSet<&Path> = used.iter().filter_map(|path| path.parent()).collect();
    let there = folders.into_iter().flat_map(|folder| list(folder).unwrap_or_default());
    let twins: BTreeSet<PathBuf> =
        there.filter(|path| !used.contains(path) && stems.contains(&path.with_extension(""))).collect();
    if let Some(first) = twins.first().and_then(|first| first.file_name()) {
        events.on(Event::Note(&format!(
            "{}: {} photos are there again with another ending and are not used, such as {}: if no ending is named, PNG is read before \
             JPEG and WebP",
            scene.display(),
            twins.len(),
            first.to_string_lossy()
        )));
    }
    twins
}

/// Notes photos in the folders of the used ones, and below their folder in the scene, that are not used themselves. `why`
/// ends "3 photos".
pub(super) fn note_unused<'a>(scene: &Path, used: impl Iterator<Item = &'a PathBuf>, why: &str, events: &dyn Listener) {
    let used: Vec<&PathBuf> = used.collect();
    let twins = note_twins(scene, used.iter().copied(), events);
    // The folder in the scene, such as `images`; the scene itself has others' folders.
    let top =
        |path: &&PathBuf| Some(path.parent()?.strip_prefix(scene).ok()?.components().next()?.as_os_str().to_owned());
    let tops: BTreeSet<_> = used.iter().filter_map(top).map(|name| scene.join(name)).collect();
    let mut folders: BTreeMap<PathBuf, Vec<PathBuf>> = BTreeMap::new();
    let parents: BTreeSet<&Path> = used.iter().filter_map(|path| path.parent()).collect();
    for folder in parents.into_iter().filter(|folder| !tops.iter().any(|top| folder.starts_with(top))) {
        folders.insert(folder.to_path_buf(), list(folder).unwrap_or_default());
    }
    for top in tops {
        for within in below(&top) {
            let path = top.join(within);
            folders.entry(path.parent().unwrap_or(&top).to_path_buf()).or_default().push(path);
        }
    }
    let used: BTreeSet<PathBuf> = used.into_iter().map(|path| real(path)).collect();
    for (folder, there) in &folders {
        let within = folder.strip_prefix(scene).unwrap_or(folder);
        let is_other = |path: &&PathBuf| {
            let name = within.join(path.file_name().unwrap_or_default());
            is_photo(&name.to_string_lossy().to_lowercase()) && !twins.contains(*path) && !used.contains(&real(path))
        };
        let others: Vec<String> = there
            .iter()
            .filter(is_other)
            .map(|path| path.file_name().unwrap_or_default().to_string_lossy().into_owned())
            .collect();
        if others.is_empty() {
            continue;
        }
        let place = if within.as_os_str().is_empty() { String::new() } else { format!(" in {}", within.display()) };
        events.on(Event::Note(&format!(
            "{}: {} of the {} photos{place} {why} and are not used: {}",
            scene.display(),
            others.len(),
            there.len(),
            first_names(&others, UNUSED_NAMED)
        )));
    }
}

/// Returns whether no word of a path, in lower case, names a mask or a map of depth.
pub(super) fn is_photo(path: &str) -> bool {
    let mut words = path.split(|letter: char| !letter.is_alphabetic());
    !words.any(|word| NO_PHOTOS.contains(&word.strip_suffix('s').unwrap_or(word)))
}

/// The images below a folder, among which photos are found that are not where they are named.
pub(super) struct Below {
    /// Paths within the folder, with their names as they are compared, without an image's ending.
    files: Vec<(PathBuf, String)>,
}

impl Below {
    pub(super) fn of(paths: Vec<PathBuf>) -> Below {
        let key = |path: PathBuf| (without_ending(name_key(&path)), path);
        Below { files: paths.into_iter().map(key).map(|(key, path)| (path, key)).collect() }
    }

    /// Returns the only file whose name fits. Of a name with several endings it is the first of [`ENDINGS`].
    fn only(&self, fits: impl Fn(&str) -> bool) -> Option<&Path> {
        let mut fitting: Vec<&(PathBuf, String)> = self.files.iter().filter(|(_, key)| fits(key)).collect();
        fitting.sort_by_key(|(path, _)| rank(path));
        let (path, key) = fitting.first()?;
        let is_twin = |(other, name): &&&(PathBuf, String)| name == key && rank(other) > rank(path);
        (fitting.iter().skip(1).filter(is_twin).count() + 1 == fitting.len()).then_some(path)
    }

    /// Returns the file that has a name, apart from its letter case, its Unicode form and an image's ending.
    pub(super) fn under_same_name(&self, name: &str) -> Option<&Path> {
        let wanted = without_ending(name_key(Path::new(name)));
        self.only(|key| key == wanted)
    }

    /// Returns the only file that a name means: its path ends in the name or in the longest end of it, or it lies in the
    /// folder itself under the last part. A split's folder stays part of the name. Masks and maps of depth are no photos.
    pub(super) fn by_end(&self, name: &str) -> Option<&Path> {
        let wanted = without_ending(name_key(Path::new(name.trim_start_matches('/'))));
        let splits = splits_in(&wanted);
        let names_split = |end: &str| splits.iter().all(|split| end.contains(split));
        let only = |fits: &dyn Fn(&str) -> bool| self.only(|key| is_photo(key) && fits(key));
        let ends = |end: &str| {
            only(&|key| key.strip_suffix(end).is_some_and(|front| front.is_empty() || front.ends_with('/')))
        };
        // The longest end first; its last part alone means a file in the folder itself.
        let parts = wanted.match_indices('/').map(|(at, _)| &wanted[at + 1..]);
        let shorter = parts.filter(|end| end.contains('/') && names_split(end));
        let last = wanted.rsplit('/').next().filter(|last| names_split(last));
        self.only(|key| key == wanted)
            .or_else(|| std::iter::once(&*wanted).chain(shorter).find_map(ends))
            .or_else(|| only(&|key| Some(key) == last))
    }

    /// Returns the only folder that has the most of these files by the last part of their names, at least half, with the file
    /// of each name. Folders of originals come before those of reduced photos. Of these it is the one with the largest factor
    /// that divides `downscale`, or else the one with the largest photos.
    pub(super) fn renamed_folder(&self, names: &[&str], downscale: usize) -> Option<(&Path, Vec<Option<&Path>>)> {
        let keys: Vec<String> = names.iter().map(|name| without_ending(name_key(Path::new(name)))).collect();
        let mut folders: BTreeMap<&Path, BTreeMap<&str, &Path>> = BTreeMap::new();
        for (path, key) in self.files.iter().filter(|(_, key)| is_photo(key)) {
            let files = folders.entry(path.parent().unwrap_or(Path::new(""))).or_default();
            let file = files.entry(last_part(key)).or_insert(path);
            if rank(path) < rank(file) {
                *file = path;
            }
        }
        let fits = |folder: &Path, key: &str| {
            let place = format!("{}/", name_key(folder));
            splits_in(key).iter().all(|split| place.contains(split))
        };
        let found = |(folder, files): (&'_ Path, &BTreeMap<&str, &'_ Path>)| -> usize {
            keys.iter().filter(|key| fits(folder, key) && files.contains_key(last_part(key))).count()
        };
        let most = folders.iter().map(|(folder, files)| found((folder, files))).max()?;
        let mut best: Vec<&Path> = folders
            .iter()
            .filter(|(folder, files)| found((folder, files)) == most)
            .map(|(folder, _)| *folder)
            .collect();
        // Photos reduced by the wanted factor, and nothing else, may be read as they are.
        let order = |folder: &&Path| match factor_in(folder) {
            1 => (0, 0),
            factor if downscale.is_multiple_of(factor) => (1, usize::MAX - factor),
            factor => (2, factor),
        };
        best.sort_by_key(order);
        if 2 * most < names.len() || most == 0 || (best.len() > 1 && order(&best[0]) == order(&best[1])) {
            return None;
        }
        let files = &folders[best[0]];
        let file = |key: &String| files.get(last_part(key)).copied().filter(|_| fits(best[0], key));
        Some((best[0], keys.iter().map(file).collect()))
    }

    /// Returns the file whose name is nearest to a name, if one is near.
    pub(super) fn nearest(&self, name: &str) -> Option<&Path> {
        let wanted = without_ending(name_key(Path::new(name)));
        let likeness = |key: &str| strsim::normalized_damerau_levenshtein(last_part(key), last_part(&wanted));
        let (path, key) = self.files.iter().max_by(|a, b| likeness(&a.1).total_cmp(&likeness(&b.1)))?;
        (likeness(key) >= NEAR).then_some(path)
    }
}

/// Returns the folders of splits that a name has.
fn splits_in(name: &str) -> Vec<&'static str> {
    ["train/", "test/", "val/"].into_iter().filter(|split| name.contains(split)).collect()
}

fn last_part(name: &str) -> &str {
    name.rsplit('/').next().unwrap_or(name)
}

/// Returns the place of a file's ending in [`ENDINGS`], which decides between photos of one name.
fn rank(path: &Path) -> usize {
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
    ENDINGS.iter().position(|known| ending.as_deref() == Some(known)).unwrap_or(ENDINGS.len())
}

/// Returns the factor by which the photos of a folder are reduced, by its name or that of a folder above it.
pub(super) fn factor_in(folder: &Path) -> usize {
    let factors = folder.components().filter_map(|part| factor_of(&part.as_os_str().to_string_lossy()));
    factors.max().unwrap_or(1)
}

/// Says that reduced photos are read because their originals are not there.
pub(super) fn reduced_words(folder: &Path, factor: usize, size: Size) -> String {
    let lost = match size {
        Size::Factor(wanted) if !wanted.is_multiple_of(factor) => {
            "; the originals are not there, and these are read as they are"
        }
        _ => "",
    };
    format!(
        "only {} is there, whose photos are {factor} times smaller than the originals, as data.downscale={factor} reads them{lost}",
        folder.display()
    )
}

/// Keeps one photo of each name where several endings are there: the first of [`ENDINGS`].
pub(super) fn without_twins(paths: Vec<PathBuf>) -> Vec<PathBuf> {
    let mut best: BTreeMap<PathBuf, usize> = BTreeMap::new();
    for path in &paths {
        let best = best.entry(path.with_extension("")).or_insert(usize::MAX);
        *best = rank(path).min(*best);
    }
    paths.into_iter().filter(|path| best[&path.with_extension("")] == rank(path)).collect()
}

/// Returns a name from a file with slashes, without `./` in front.
pub(super) fn slashes(name: &str) -> String {
    name.replace('\\', "/").trim_start_matches("./").to_string()
}

/// Returns a path as names are compared: neither letter case nor the Unicode form (macOS takes letters and accents apart)
/// make a difference, nor which slash.
pub(super) fn name_key(path: &Path) -> String {
    path.to_string_lossy().replace('\\', "/").nfc().collect::<String>().to_lowercase()
}

fn without_ending(text: String) -> String {
    match Path::new(&text) {
        path if is_image(path) => path.with_extension("").to_string_lossy().into_owned(),
        _ => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_and_maps_are_known_by_complete_words() {
        for photo in ["unmasked/1.png", "images/normalized_2.jpg", "alphabet.png"] {
            assert!(is_photo(photo), "{photo}");
        }
        for other in
            ["masks/1.png", "masked/1.png", "r_0_depth_0001.png", "r_0_normal.png", "depthmaps/2.png", "mask001.png"]
        {
            assert!(!is_photo(other), "{other}");
        }
    }
}
