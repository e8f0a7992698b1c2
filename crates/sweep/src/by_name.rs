//! `by-name/`: symbolic links to the points of a sweep's folder, under the names of their rows.
//!
//! ```text
//! by-name/Aug-NeRF/seed-0 -> ../../points/ID         of several scenes: by-name/SCENE/ROW/seed-0
//! ```
#![cfg_attr(not(unix), allow(dead_code))]

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use crate::base::Result;
use crate::draw::numbers::rounded;
use crate::report::label;

use super::folder::SweepFolder;
use super::points::Point;

/// Longest name of a folder in bytes; most file systems allow 255.
const LONGEST: usize = 120;

/// Returns the paths of the links below `by-name/`, with the targets.
pub fn links(points: &[Point]) -> Vec<(PathBuf, PathBuf)> {
    // Leading zeros, so that names sort as numbers do.
    let digits = points.iter().map(|point| point.config.seed).max().map_or(1, |seed| seed.to_string().len());
    let scenes: BTreeSet<&str> = points.iter().map(|point| point.scene.as_str()).collect();
    let mut taken = BTreeSet::new();
    let folders: BTreeMap<&str, String> =
        scenes.iter().map(|scene| (*scene, unused(&safe(scene), "", &mut taken))).collect();
    let mut names = Vec::<((String, String), String)>::new();
    let mut links = Vec::new();
    for point in points {
        for place in &point.places {
            let cell = (point.scene.clone(), label(&place.row, &place.axes));
            if !names.iter().any(|(known, _)| *known == cell) {
                let name = unused(&safe(&rounded(&cell.1)), &point.scene, &mut taken);
                names.push((cell.clone(), name));
            }
            let (_, name) = names.iter().find(|(known, _)| *known == cell).expect("just named");
            let scene = if scenes.len() > 1 { PathBuf::from(&folders[point.scene.as_str()]) } else { PathBuf::new() };
            let link = scene.join(name).join(format!("seed-{:0digits$}", point.config.seed));
            let up: PathBuf = link.iter().map(|_| "..").collect();
            links.push((link, up.join("points").join(&point.id)));
        }
    }
    links
}

/// Returns a name that no other cell of the scene has, or no other scene if `scene` is empty. Case is ignored, as some
/// file systems do.
fn unused(name: &str, scene: &str, taken: &mut BTreeSet<(String, String)>) -> String {
    let numbered = (1..).map(|number| if number == 1 { name.to_string() } else { format!("{name}-{number}") });
    let mut numbered = numbered.into_iter();
    numbered.find(|name| taken.insert((scene.to_string(), name.to_lowercase()))).expect("numbers do not end")
}

/// Returns a name that every file system accepts: no separators, special or control characters, and no dots or spaces
/// at its ends.
fn safe(name: &str) -> String {
    let plain = |letter: char| match letter {
        '/' | '\\' | '<' | '>' | ':' | '"' | '|' | '?' | '*' => '-',
        letter if letter.is_control() => '-',
        letter => letter,
    };
    let name: String = name.chars().map(plain).collect();
    let mut name = name.trim_matches([' ', '.']).to_string();
    while name.len() > LONGEST {
        name.pop();
    }
    if name.is_empty() { "row".into() } else { name }
}

impl SweepFolder {
    /// Writes the links again. Returns the reason if the file system or the operating system supports none.
    ///
    /// # Errors
    /// The folder cannot be written.
    #[cfg(unix)]
    pub fn link_by_name(&self, points: &[Point]) -> Result<Option<String>> {
        use crate::base::Error;
        use crate::base::files::AtomicDir;

        let _lock = self.lock()?;
        let folder = AtomicDir::new(&self.path().join("by-name"))?;
        for (link, target) in links(points) {
            let link = folder.path().join(link);
            let parent = link.parent().expect("a row's folder");
            std::fs::create_dir_all(parent).map_err(|e| Error::unwritable(parent, &e))?;
            if let Err(error) = std::os::unix::fs::symlink(target, &link) {
                return Ok(Some(format!("cannot make links below {}: {error}", self.path().join("by-name").display())));
            }
        }
        folder.commit()?;
        Ok(None)
    }

    /// On other systems links need special rights.
    #[cfg(not(unix))]
    pub fn link_by_name(&self, _points: &[Point]) -> Result<Option<String>> {
        Ok(None)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_that_file_systems_take() {
        assert_eq!(safe("NeRF, features steps = 3"), "NeRF, features steps = 3");
        assert_eq!(safe("a/b\\c: d?\u{7}"), "a-b-c- d--");
        assert_eq!(safe("..."), "row");
        assert_eq!(safe(" .. x. "), "x");
        assert!(safe(&"é".repeat(200)).len() <= LONGEST);
        let mut taken = BTreeSet::new();
        let mut name = |name: &str| unused(name, "fern", &mut taken);
        assert_eq!([name("A"), name("a"), name("A")], ["A", "a-2", "A-3"]);
    }
}
