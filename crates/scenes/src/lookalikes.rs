//! What a folder or file looks like that is no scene, and how it becomes one. What other programs write is in
//! [`foreign`](super::foreign).

use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use super::foreign::{ARCHIVES, LAYOUTS, OWN, UNREAD, VIDEOS};
use super::formats::transforms::TRANSFORMS_FILE;
use super::formats::{FORMATS, Format};
use super::{images, json};
use crate::found;
use augnerf_base::input::{TEXT_BYTES, read_text};
use augnerf_base::{Error, Result, quoted};

/// Largest number of letters by which a mistaken name differs from a right one.
const TYPING_ERRORS: usize = 2;
/// Folders above one that may be the scene's.
const ABOVE: usize = 3;

/// Iterates over the files by which a folder is recognized as a scene. COLMAP's are in a folder below.
fn markers() -> impl Iterator<Item = &'static str> {
    let names = FORMATS.iter().filter_map(|format| format.marker?.split(' ').next());
    names.filter(|name| !name.contains('/'))
}

/// Returns the folder of a scene's own file, such as `transforms.json`. `None` for other files.
pub fn scene_of_file(file: &Path) -> Option<PathBuf> {
    let is_marker = file.is_file() && file.file_name().is_some_and(|name| markers().any(|marker| name == marker));
    is_marker.then(|| file.parent().map(Path::to_path_buf)).flatten()
}

/// Checks that a scene's path is a folder.
///
/// # Errors
/// It is missing, or a file; a video or an archive is answered with what makes a scene of it.
pub(super) fn check_folder(path: &Path) -> Result<()> {
    let found = std::fs::metadata(path).map_err(|e| Error::unreadable(path, &e))?;
    if found.is_dir() {
        return Ok(());
    }
    let file = path.display();
    let advice = if has_ending(path, &VIDEOS) {
        format!("it looks like a video; {}", of_video(path))
    } else if has_ending(path, &ARCHIVES) {
        "it looks like an archive; unpack it, and name the folder that it holds".into()
    } else {
        "name the folder".into()
    };
    Err(Error::Data(format!("{file} is a file, but a scene is a folder; {advice}")))
}

/// Returns the error for a folder that no format detects: what it looks like, and what to do.
pub(super) fn unknown(dir: &Path) -> Error {
    let entries = entries(dir);
    let paths: Vec<String> =
        found::paths_below(dir).iter().map(|path| found::slashes(&path.to_string_lossy())).collect();
    let holds = |endings: &[&str], kind: &str, advice: &dyn Fn(&Path) -> String| {
        one_of(dir, &entries, endings).map(|file| format!("{} is {kind}; {}", file.display(), advice(&file)))
    };
    // A part of a run, such as its renders, too.
    let own = |above: &Path| layout(above, &self::entries(above), OWN);
    let known = dir
        .ancestors()
        .take(ABOVE)
        .find_map(own)
        .or_else(|| inside_a_scene(dir))
        .or_else(|| without_training_file(dir))
        .or_else(|| misnamed(dir, &entries))
        .or_else(|| model_below(dir, &paths))
        .or_else(|| layout(dir, &paths, LAYOUTS))
        .or_else(|| entries.iter().find_map(|name| json::other_frames(&dir.join(name))))
        .or_else(|| photos(dir, &entries, &paths))
        .or_else(|| holds(&VIDEOS, "a video", &of_video))
        .or_else(|| holds(&ARCHIVES, "an archive", &|_| "unpack it, and check the folder that it holds".into()));
    if let Some(words) = known {
        return Error::Data(words);
    }
    let is_scene = |name: &&String| Format::of_folder(&dir.join(name)).is_some();
    let scenes: Vec<&str> = entries.iter().filter(is_scene).map(String::as_str).collect();
    let hint = match scenes.len() {
        0 => String::new(),
        _ => format!("; scenes lie one level deeper: {}", scenes.join(", ")),
    };
    let markers: Vec<&str> = FORMATS.iter().filter_map(|format| format.marker).collect();
    let (last, first) = markers.split_last().expect("some formats are folders");
    Error::Data(format!("{} is no scene: it has none of {} and {last}{hint}", dir.display(), first.join(", ")))
}

/// Returns the names of a folder's entries that can be seen, in order.
fn entries(dir: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(dir).into_iter().flatten().flatten();
    let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
    let mut names: Vec<String> = names.filter(|name| !name.starts_with('.')).collect();
    names.sort();
    names
}

/// A part of a scene, such as its `images` or `sparse`.
fn inside_a_scene(dir: &Path) -> Option<String> {
    let dir = std::path::absolute(dir).ok()?;
    let scene = dir.ancestors().skip(1).take(ABOVE).find(|above| Format::of_folder(above).is_some())?;
    let part = dir.strip_prefix(scene).ok()?.components().next()?;
    let parts = ["images", "sparse", "colmap", "train", "test", "val", "masks"];
    parts
        .iter()
        .any(|known| part.as_os_str().to_string_lossy().starts_with(known))
        .then(|| format!("{} is a part of the scene {}; name that folder", dir.display(), scene.display()))
}

fn without_training_file(dir: &Path) -> Option<String> {
    let there = ["transforms_test.json", "transforms_val.json"].into_iter().find(|name| dir.join(name).is_file())?;
    Some(format!(
        "{}: transforms_train.json is missing beside {there}, which has views to evaluate on alone",
        dir.display()
    ))
}

/// A COLMAP model in another place than those that are read, or a part of one.
fn model_below(dir: &Path, paths: &[String]) -> Option<String> {
    let folder_of = |path: &String| {
        let (folder, file) = path.rsplit_once('/').unwrap_or(("", path));
        let (name, ending) = file.split_once('.')?;
        (["cameras", "images"].contains(&name) && ["bin", "txt"].contains(&ending)).then(|| folder.to_string())
    };
    let folders: BTreeSet<String> = paths.iter().filter_map(folder_of).collect();
    let (mut whole, mut part) = (None, None);
    for folder in folders.iter().map(|folder| dir.join(folder)) {
        let has = |name: &str, ending: &str| folder.join(format!("{name}.{ending}")).is_file();
        let ending_of = |name: &str| ["bin", "txt"].into_iter().find(|ending| has(name, ending));
        let is_whole = |ending: &&str| has("cameras", ending) && has("images", ending);
        let is_model =
            has("points3D", "bin") || has("points3D", "txt") || has("cameras", "bin") || has("images", "bin");
        match (ending_of("cameras"), ending_of("images")) {
            _ if ["bin", "txt"].iter().any(is_whole) => whole = whole.or(Some(folder)),
            _ if !is_model => {}
            (Some(cameras), Some(images)) => {
                part = part.or(Some(format!(
                    "{} has cameras.{cameras} and images.{images}, but both must end alike; convert the model with `colmap \
                     model_converter`",
                    folder.display()
                )));
            }
            (cameras, images) => {
                let (there, ending) = cameras.map_or(("images", images.unwrap_or("bin")), |ending| ("cameras", ending));
                let lacks = if there == "cameras" { "images" } else { "cameras" };
                part = part.or(Some(format!(
                    "{} has {there}.{ending} of a COLMAP model but no {lacks}.{ending}: copy it from where the model was made",
                    folder.display()
                )));
            }
        }
    }
    let Some(folder) = whole else { return part };
    let is_scene = |above: &&Path| *above != dir && Format::of_folder(above).is_some();
    let advice = match folder.ancestors().skip(1).take(ABOVE).find(is_scene) {
        Some(scene) => format!("name {}", scene.display()),
        None => format!("move it to {}/sparse/0, and the photos to {}/images", dir.display(), dir.display()),
    };
    Some(format!("{} is a COLMAP model, but not where one is looked for; {advice}", folder.display()))
}

/// A file with nearly the name of a scene's own, or with the content of one.
fn misnamed(dir: &Path, entries: &[String]) -> Option<String> {
    let files = || entries.iter().filter(|name| dir.join(name).is_file());
    let nearly = |name: &str| {
        let distance = |marker: &str| strsim::osa_distance(&name.to_lowercase(), marker);
        markers().min_by_key(|marker| distance(marker)).filter(|marker| distance(marker) <= TYPING_ERRORS)
    };
    let (name, marker) = files().find_map(|name| Some((name, nearly(name)?))).or_else(|| {
        let lists_frames = |name: &&String| json::lists_frames(&dir.join(name));
        files().find(lists_frames).map(|name| (name, TRANSFORMS_FILE))
    })?;
    Some(format!("{} is probably a scene's {marker}; rename it to {marker}", dir.join(name).display()))
}

/// The first of `layouts` of which one of the ways to write each of its entries is there.
fn layout(dir: &Path, paths: &[String], layouts: &[(&str, &str, &str)]) -> Option<String> {
    let one = |entry: &str| {
        let (name, begin) = entry.split_once(':').unwrap_or((entry, ""));
        let holds = |path: &str| begin.is_empty() || beginning(&dir.join(path)).to_lowercase().contains(begin);
        paths.iter().find(|path| fits(name, &path.to_lowercase()) && holds(path))
    };
    let first_of = |entries: &str| -> Option<&String> {
        let found: Option<Vec<&String>> = entries.split(' ').map(|entry| entry.split('|').find_map(one)).collect();
        found?.first().copied()
    };
    let (file, (_, name, advice)) = layouts.iter().find_map(|layout| Some((first_of(layout.0)?, layout)))?;
    let advice = match advice.starts_with("ns-process-data") {
        true => format!("convert it with `{advice} --output-dir SCENE`, then check SCENE"),
        false => advice.to_string(),
    };
    let here = dir.display().to_string();
    let photos = if dir.join("images").is_dir() { format!("{here}/images") } else { here.clone() };
    let word = |word: &str| {
        let parts = word.split('/').map(|part| match part {
            "HERE" => &*here,
            "FILE" => file,
            "PHOTOS" => &*photos,
            other => other,
        });
        let path = parts.collect::<Vec<&str>>().join("/");
        if path == word { path } else { quoted(&path) }
    };
    let words = |words: &str| words.split(' ').map(word).collect::<Vec<String>>().join(" ");
    let advice = advice.split('`').map(words).collect::<Vec<String>>().join("`");
    Some(format!("{here} looks like {name}; {advice}"))
}

/// Returns whether a path is like a pattern, in which `*` stands for any letters but `/`.
fn fits(pattern: &str, path: &str) -> bool {
    let Some((begin, rest)) = pattern.split_once('*') else { return pattern == path };
    let Some(path) = path.strip_prefix(begin) else { return false };
    let end = path.find('/').unwrap_or(path.len());
    (0..=end).filter(|at| path.is_char_boundary(*at)).any(|at| fits(rest, &path[at..]))
}

/// Returns the first lines of a text.
fn beginning(file: &Path) -> String {
    const LINES: usize = 8;
    let text = read_text(file, TEXT_BYTES).unwrap_or_default();
    text.lines().take(LINES).collect::<Vec<_>>().join("\n")
}

/// The endings of texts that may hold poses, and how many numbers a line then has: a matrix, or position and quaternion, with a
/// time or a number in front.
const POSE_TEXTS: [&str; 6] = ["txt", "csv", "log", "traj", "dat", "pose"];
const POSE_NUMBERS: [usize; 6] = [7, 8, 12, 13, 16, 17];

/// Returns a text that looks like poses of photos, if there is one.
fn poses<'a>(dir: &Path, paths: &'a [String]) -> Option<&'a String> {
    let looks = |path: &&String| {
        let numbers = |line: &str| {
            let words: Vec<&str> = line.split([' ', ',', '\t', ';']).filter(|word| !word.is_empty()).collect();
            let count = words.iter().filter(|word| word.parse::<f64>().is_ok()).count();
            (count + 1 >= words.len()).then_some(count)
        };
        let text = beginning(&dir.join(path));
        let lines: Vec<Option<usize>> = text.lines().filter(|line| !line.starts_with('#')).map(numbers).collect();
        let in_line = lines.iter().flatten().any(|count| POSE_NUMBERS.contains(count));
        in_line || lines.windows(3).any(|three| three.iter().all(|count| *count == Some(4)))
    };
    paths.iter().filter(|path| has_ending(Path::new(path), &POSE_TEXTS)).take(ABOVE * ABOVE).find(looks)
}

/// Photos without cameras, in the folder or in one below.
fn photos(dir: &Path, entries: &[String], paths: &[String]) -> Option<String> {
    let count = |folder: &Path| images::list(folder).map_or(0, |files| files.len());
    let without_cameras = |photos: &Path, count: usize, scene: &Path| match poses(dir, paths) {
        None => without_cameras(photos, count, scene),
        Some(text) => format!(
            "{}: {count} photos without cameras that are read, and {text}, which may hold their poses; write each photo's matrix \
             (camera to world) as transform_matrix and the focal length in pixels as fl_x into a transforms.json, and read that with \
             data.axes=opencv if y points down",
            photos.display()
        ),
    };
    if let here @ 1.. = count(dir) {
        return Some(without_cameras(dir, here, Path::new("SCENE")));
    }
    let unread = |folder: &Path| {
        let files = self::entries(folder).into_iter().filter(|name| has_ending(Path::new(name), &UNREAD)).count();
        (files > 0).then(|| {
            format!(
                "{}: {files} photos in a format that is not read (HEIC, TIFF, raw); convert them to PNG or JPEG, and find their \
                 cameras with COLMAP or `ns-process-data`",
                folder.display()
            )
        })
    };
    if let Some(words) = unread(dir).or_else(|| unread(&dir.join("images"))) {
        return Some(words);
    }
    let below = |name: &&str| dir.join(name).is_dir() && count(&dir.join(name)) > 0;
    let folder = ["images"].into_iter().chain(entries.iter().map(String::as_str)).find(below)?;
    let is_scene = |name: &String| Format::of_folder(&dir.join(name)).is_some();
    if entries.iter().any(is_scene) {
        return None;
    }
    let scene = if folder == "images" { dir } else { Path::new("SCENE") };
    Some(without_cameras(&dir.join(folder), count(&dir.join(folder)), scene))
}

/// Returns the words for photos whose cameras are unknown, with the commands that find them for the folder `scene`.
fn without_cameras(photos: &Path, count: usize, scene: &Path) -> String {
    let first = if photos == scene.join("images") {
        String::new()
    } else {
        format!("put them into {}/images and ", scene.display())
    };
    let [images, data, scene] = [&scene.join("images"), photos, scene].map(|path| quoted(&path.to_string_lossy()));
    format!(
        "{}: {count} photos without cameras; {first}find the cameras with `colmap \
         automatic_reconstructor --workspace_path {scene} --image_path {images}`, or run `ns-process-data images --data \
         {data} --output-dir {scene}`, then check {scene}",
        photos.display()
    )
}

fn of_video(video: &Path) -> String {
    format!(
        "make a scene of its frames with `ns-process-data video --data {} --output-dir SCENE`, then check SCENE",
        quoted(&video.to_string_lossy())
    )
}

fn one_of(dir: &Path, entries: &[String], endings: &[&str]) -> Option<PathBuf> {
    entries.iter().map(|name| dir.join(name)).find(|path| path.is_file() && has_ending(path, endings))
}

fn has_ending(path: &Path, endings: &[&str]) -> bool {
    let ending = path.extension().and_then(OsStr::to_str).map(str::to_lowercase);
    ending.is_some_and(|ending| endings.contains(&&*ending))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is said of a folder with these entries; those that end in `/` are folders.
    fn said(entries: &[(&str, &str)]) -> String {
        let dir = tempfile::tempdir().unwrap();
        for (entry, content) in entries {
            let path = dir.path().join(entry);
            if entry.ends_with('/') {
                std::fs::create_dir_all(path).unwrap();
            } else {
                std::fs::create_dir_all(path.parent().unwrap()).unwrap();
                std::fs::write(path, content).unwrap();
            }
        }
        unknown(dir.path()).to_string().replace(&*dir.path().to_string_lossy(), "DIR")
    }

    #[test]
    fn a_folder_that_is_no_scene_is_answered_with_what_it_looks_like() {
        for (entries, words) in [
            (&[("notes.txt", "")][..], "DIR is no scene"),
            (
                &[("transform_train.json", "{}")],
                "DIR/transform_train.json is probably a scene's transforms_train.json; rename",
            ),
            (&[("Poses_bounds.npy", "")], "rename it to poses_bounds.npy"),
            (
                &[("cams.json", "{\"frames\": [{\"file_path\": \"a\"}]}")],
                "DIR/cams.json is probably a scene's transforms.json",
            ),
            (
                &[("other.json", "{}"), ("clip.MOV", "")],
                "DIR/clip.MOV is a video; make a scene of its frames with `ns-process-data",
            ),
            (&[("lego.zip", "")], "DIR/lego.zip is an archive; unpack it"),
            (&[("keyframes/images/1.jpg", "")], "`ns-process-data polycam --data DIR --output-dir SCENE`"),
            (&[("EXR_RGBD/rgb/1.jpg", "")], "raw capture of Record3D"),
            (&[("cameras.npz", ""), ("image/1.png", "")], "the layout of DTU"),
            (&[("pose/1.txt", ""), ("intrinsics.txt", ""), ("rgb/1.png", "")], "data.axes=opencv"),
            (&[("cameras.json", "[]"), ("point_cloud/", "")], "name the folder that it was trained on"),
            (&[("database.db", ""), ("images/1.jpg", "")], "`colmap mapper --database_path DIR/database.db"),
            (&[("a.JPG", ""), ("notes.txt", "")], "DIR: 1 photos without cameras; put them into SCENE/images"),
            (
                &[("images/a.JPG", "")],
                "DIR/images: 1 photos without cameras; find the cameras with `colmap automatic_reconstructor \
                 --workspace_path DIR --image_path DIR/images`",
            ),
            (&[("input/a.JPG", "")], "DIR/input: 1 photos without cameras"),
            (&[("images/a.HEIC", "")], "DIR/images: 1 photos in a format that is not read"),
            (
                &[("transforms_test.json", "{}"), ("test/a.png", "")],
                "transforms_train.json is missing beside transforms_test.json",
            ),
            (
                &[("dense/0/sparse/cameras.bin", ""), ("dense/0/sparse/images.bin", ""), ("dense/0/images/a.png", "")],
                "DIR/dense/0/sparse is a COLMAP model, but not where one is looked for; name DIR/dense/0",
            ),
            (
                &[("colmap_text/cameras.txt", ""), ("colmap_text/images.txt", ""), ("images/a.png", "")],
                "move it to DIR/sparse/0, and the photos to DIR/images",
            ),
            (&[("cams/0_cam.txt", ""), ("images/a.png", "")], "the layout of MVSNet"),
            (
                &[("meta_data.json", "{\"frames\": [{\"rgb_path\": \"a\"}]}")],
                "SDFStudio; write its frames into a transforms.json",
            ),
            (
                &[("all.json", "{\"frames\": [{\"image_path\": \"a\", \"w2c\": []}], \"K\": []}")],
                "DIR/all.json lists frames under other keys than a transforms.json: \"image_path\" is there: rename it",
            ),
            (
                &[("color/0.jpg", ""), ("pose/0.txt", ""), ("intrinsic/color.txt", "")],
                "ScanNet; write its matrices (camera",
            ),
            (&[("seq-01/frame-0.color.png", ""), ("seq-01/frame-0.pose.txt", "")], "7-Scenes; write its matrices"),
            (&[("traj.txt", ""), ("results/frame0.jpg", "")], "Replica"),
            (&[("rgb/0.png", ""), ("rgb.txt", ""), ("groundtruth.txt", "")], "TUM RGB-D; turn each line"),
            (&[("train/rgb/0.png", ""), ("train/pose/0.txt", ""), ("train/intrinsics/0.txt", "")], "NeRF++"),
            (
                &[("images/0.jpg", ""), ("my cameras.csv", "#cameras 1\n#name,x,y,alt\n")],
                "`ns-process-data realitycapture --data DIR/images --csv 'DIR/my cameras.csv' --output-dir SCENE`",
            ),
            (&[("images/0.jpg", ""), ("PHOTOS.csv", "#name,x,y,alt\n")], "--csv DIR/PHOTOS.csv --output-dir SCENE`"),
            (&[("my clip.mp4", "")], "--data 'DIR/my clip.mp4' --output-dir SCENE`"),
            (
                &[("config.toml", ""), ("scene.json", ""), ("checkpoints/", ""), ("renders/a.png", "")],
                "DIR looks like a run of augnerf, not a scene; use `augnerf view DIR`, `augnerf eval DIR`",
            ),
            (
                &[("sweep.toml", ""), ("points/", ""), ("a.png", "")],
                "`augnerf sweep status DIR` or `augnerf compare DIR`",
            ),
            (&[("sweep.toml", ""), ("provenance.toml", ""), ("a.png", "")], "`augnerf verify DIR`"),
            (&[("a.jpg", ""), ("scan.nvm", "NVM_V3")], "VisualSFM; write its cameras"),
            (&[("scan.xml", "<?xml?>\n<document><chunk/></document>"), ("a.jpg", "")], "--xml DIR/scan.xml"),
            (
                &[("rgb/0.png", ""), ("cam/0.txt", "1 0 0 0\n0 1 0 0\n0 0 1 0\n")],
                "and cam/0.txt, which may hold their poses",
            ),
            (&[("rgb/0.png", ""), ("path.log", "0.png 1 2 3 0 0 0 1\n")], "and path.log, which may hold their poses"),
            (
                &[("sparse/0/cameras.bin", ""), ("sparse/0/points3D.bin", ""), ("images/a.png", "")],
                "DIR/sparse/0 has cameras.bin of a COLMAP model but no images.bin: copy it",
            ),
            (
                &[("sparse/images.txt", ""), ("sparse/points3D.txt", "")],
                "images.txt of a COLMAP model but no cameras.txt",
            ),
            (
                &[("sparse/cameras.bin", ""), ("sparse/images.txt", "")],
                "cameras.bin and images.txt, but both must end alike",
            ),
            (&[("lego/transforms.json", ""), ("thumbs/a.png", "")], "scenes lie one level deeper: lego"),
        ] {
            let said = said(entries);
            assert!(said.contains(words), "{said}");
        }
    }

    #[test]
    fn a_part_of_a_scene_is_answered_with_the_scene() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::create_dir(dir.path().join("images")).unwrap();
        std::fs::write(dir.path().join("transforms.json"), "{}").unwrap();
        let said = unknown(&dir.path().join("images")).to_string();
        assert!(said.contains("is a part of the scene") && said.ends_with("name that folder"), "{said}");
    }

    #[test]
    fn a_file_is_answered_with_its_folder_or_what_makes_one() {
        let dir = tempfile::tempdir().unwrap();
        for (name, words) in [("clip.mp4", "looks like a video"), ("a.tar", "unpack it"), ("a.txt", "name the folder")]
        {
            let file = dir.path().join(name);
            std::fs::write(&file, "").unwrap();
            let said = check_folder(&file).unwrap_err().to_string();
            assert!(said.contains(words), "{said}");
            assert_eq!(scene_of_file(&file), None);
        }
        let file = dir.path().join("transforms.json");
        std::fs::write(&file, "").unwrap();
        assert_eq!(scene_of_file(&file).as_deref(), Some(dir.path()));
        assert!(check_folder(dir.path()).is_ok());
    }
}
