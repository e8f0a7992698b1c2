//! `report.html` of a sweep, a view of sweeps, a results folder, or single runs.

use std::path::{Component, Path, PathBuf};

use super::collect::Tables;
use super::outputs::{SweepOutputs, optional};
use crate::base::input::read_bytes;
use crate::base::{Error, Result};
use crate::draw::pictures::encode_png8;
use crate::mesh::{Paint, around, read_mesh};
use crate::report::page::{Film, Page, ShownScene, ViewOfRow, ViewOfScene};
use crate::report::tables::{Line, Table};
use crate::report::{Status, distinct};
use crate::run::{FirstView, RunDir, mesh_picture};

/// Most rows of a scene whose images are shown.
const MOST_ROWS: usize = 24;
/// Videos of a run in `renders/`, the smaller format first, and the limit on the bytes of all in a page.
const FILMS: [&str; 2] = ["path/rgb.mp4", "path/rgb.gif"];
const MOST_FILM_BYTES: u64 = 16 << 20;
/// Meshes of a run, the one with fewer bytes first; and how their images are drawn, in pixels and around the mesh.
const MESHES: [&str; 2] = ["mesh.ply", "mesh.obj"];
const MESH_COLUMNS: usize = 400;
const MESH_EYE: f64 = 0.1;
/// Most folders that a link goes up. Beyond that, page and runs have no common location.
const MOST_UP: usize = 4;

impl Tables<'_> {
    /// Returns the page of a table and its files, for a page in `folder`.
    pub fn page(&self, table: &Table, files: &[(String, Vec<u8>)], folder: &Path) -> Result<String> {
        let outputs = self.outputs;
        let page = Page {
            table,
            records: &outputs.records,
            files,
            views: views(table, outputs)?,
            films: films(table, outputs)?,
            meshes: meshes(table, outputs)?,
            attacks: self.attacks(table),
            timing: if self.options.with_timing { &outputs.timing } else { &[] },
            link: &|id| link(folder, outputs.runs.get(id)?),
        };
        page.html()
    }
}

/// Returns the first held-out view of each scene, as the first seed of each row renders it.
fn views(table: &Table, outputs: &SweepOutputs) -> Result<Vec<ShownScene>> {
    let scenes = table.scenes();
    let mut shown = Vec::new();
    for (scene, lines) in &scenes {
        let measured: Vec<&Line> = lines.iter().copied().filter(|line| !line.ids.is_empty()).collect();
        if let Some(view) = view(scene, &measured, outputs)? {
            shown.push(ShownScene::new(&view, scenes.len())?);
        }
    }
    Ok(shown)
}

/// Returns the video of each row's first point that has one, as far as they fit into a page.
fn films(table: &Table, outputs: &SweepOutputs) -> Result<Vec<Film>> {
    let (mut films, mut room) = (Vec::new(), MOST_FILM_BYTES);
    for line in &table.lines {
        let found = runs(line, outputs).find_map(|(seed, run)| {
            let fits = |path: &PathBuf| path.metadata().is_ok_and(|file| file.is_file() && file.len() <= room);
            Some((seed, FILMS.map(|film| RunDir::renders_in(run).join(film)).into_iter().find(fits)?))
        });
        let Some((seed, path)) = found else { continue };
        let bytes = read_bytes(&path, room).map_err(|e| Error::unreadable(&path, &e))?;
        room = room.saturating_sub(bytes.len() as u64);
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        films.push(Film::new(&line.label, seed, &name, &bytes));
    }
    Ok(films)
}

/// Returns the runs of a row's points with their seeds.
fn runs<'a>(line: &'a Line, outputs: &'a SweepOutputs) -> impl Iterator<Item = (u64, &'a PathBuf)> {
    let points = line.ids.iter().filter_map(|id| outputs.records.iter().find(|record| record.id == *id));
    points.filter_map(|record| Some((record.seed?, outputs.runs.get(&record.id)?)))
}

/// Returns an image of the mesh of each row's first point that has one, drawn like `augnerf mesh RUN --picture`.
fn meshes(table: &Table, outputs: &SweepOutputs) -> Result<Vec<Film>> {
    let mut meshes = Vec::new();
    for line in table.lines.iter().take(MOST_ROWS) {
        let of_run = |(seed, run): (u64, &PathBuf)| {
            let files = MESHES.map(|name| RunDir::mesh_in(run).join(name));
            Some((seed, files.into_iter().find(|file| file.is_file())?))
        };
        let Some((seed, path)) = runs(line, outputs).find_map(of_run) else { continue };
        let mesh = read_mesh(&path)?;
        let image = mesh_picture(&mesh, &[around(&mesh, MESH_EYE, MESH_COLUMNS)], Paint::Clay)?;
        let bytes =
            encode_png8(&image).map_err(|e| Error::Output(format!("{}: cannot be drawn: {e}", path.display())))?;
        let drawn = Film::new(&line.label, seed, "mesh.png", &bytes);
        meshes.push(drawn);
    }
    Ok(meshes)
}

/// Returns `None` if no row has an image.
fn view(scene: &str, lines: &[&Line], outputs: &SweepOutputs) -> Result<Option<ViewOfScene>> {
    let mut found: Option<ViewOfScene> = None;
    let (mut without, mut other) = (Vec::new(), Vec::new());
    for line in &lines[..lines.len().min(MOST_ROWS)] {
        let of_line = |id: &&str| outputs.records.iter().find(|record| record.id == *id);
        let ids = line.ids.iter().map(String::as_str);
        let first = ids.filter_map(|id| of_line(&id)).filter(|r| r.status == Status::Done).min_by_key(|r| r.seed);
        let Some((seed, run)) = first.and_then(|first| Some((first.seed?, outputs.runs.get(&first.id)?))) else {
            without.push(line.label.as_str());
            continue;
        };
        let Some(FirstView { name, image, truth, depth, mask }) = FirstView::read(run)? else {
            without.push(line.label.as_str());
            continue;
        };
        let view = found.get_or_insert_with(|| ViewOfScene {
            scene: scene.into(),
            view: name.clone(),
            truth: truth.clone(),
            mask: mask.clone(),
            rows: Vec::new(),
            left_out: Vec::new(),
        });
        // Photos differ if training views are corrupted in other ways, or have other sizes. A view has one mask.
        if (&name, &truth, &mask) != (&view.view, &view.truth, &view.mask) {
            other.push(line.label.as_str());
            continue;
        }
        view.rows.push(ViewOfRow { label: line.label.clone(), seed, image, depth });
    }
    let Some(view) = &mut found else { return Ok(None) };
    let further = lines.len().saturating_sub(MOST_ROWS);
    let said = [
        (!without.is_empty())
            .then(|| format!("without pictures (eval.pictures): {}", distinct(without.into_iter()).join(", "))),
        (!other.is_empty())
            .then(|| format!("of another photograph or mask: {}", distinct(other.into_iter()).join(", "))),
        (further > 0).then(|| format!("{further} further rows are not shown")),
    ];
    view.left_out = said.into_iter().flatten().collect();
    Ok(found)
}

/// Returns a folder's relative address from another, or `None` if they have no common folder nearby.
fn link(from: &Path, to: &Path) -> Option<String> {
    let parts = |path: &Path| -> Option<Vec<String>> {
        // A `..` in the path would count as a folder to leave.
        let path = path.canonicalize().or_else(|_| std::path::absolute(path)).ok()?;
        let part = |component: Component| Some(component.as_os_str().to_str()?.to_string());
        path.components().filter(|component| !matches!(component, Component::CurDir)).map(part).collect()
    };
    let (from, to) = (parts(from)?, parts(to)?);
    let common = from.iter().zip(&to).take_while(|(a, b)| a == b).count();
    let up = from.len() - common;
    // A root, or a drive, is not a common location.
    if up > MOST_UP || common < 2 {
        return None;
    }
    let down = to[common..].iter().map(|part| encoded(part));
    Some(std::iter::repeat_n("..".to_string(), up).chain(down).map(|part| part + "/").fold("./".into(), |a, b| a + &b))
}

/// Encodes a part of a path for an address.
fn encoded(part: &str) -> String {
    let byte = |byte: u8| match byte {
        b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'-' | b'_' | b'.' | b'~' => char::from(byte).to_string(),
        other => format!("%{other:02X}"),
    };
    part.bytes().map(byte).collect()
}

/// Returns the page's path, or an error for a file that is not a page of this program.
///
/// # Errors
/// The name is that of another kind of file; another file or a folder is there.
pub fn check_page_place(path: &Path) -> Result<PathBuf> {
    let shown = path.display();
    const OTHERS: [&str; 12] = ["png", "svg", "jpg", "gif", "mp4", "csv", "json", "md", "tex", "pdf", "gz", "zip"];
    if path.extension().is_some_and(|ending| OTHERS.iter().any(|other| ending.eq_ignore_ascii_case(other))) {
        return Err(Error::Config(format!("--out {shown}: the page is HTML; name a file such as report.html")));
    }
    if path.is_dir() {
        return Err(Error::Output(format!("cannot write {shown}: it is a folder; give another --out")));
    }
    let found = optional(path)?;
    let is_own = |bytes: &Vec<u8>| {
        let head = String::from_utf8_lossy(&bytes[..bytes.len().min(2048)]).into_owned();
        bytes.is_empty() || head.contains("content=\"augnerf report\"")
    };
    match found.is_none_or(|bytes| is_own(&bytes)) {
        true => Ok(path.to_path_buf()),
        false => Err(Error::Output(format!("{shown} is not a page of this program; give another --out"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_lead_from_the_page_to_the_run() {
        let of = |from: &str, to: &str| link(Path::new(from), Path::new(to));
        let text = Some("./../../runs/smoke/points/ab/run/".to_string());
        assert_eq!(of("/home/a/results/smoke", "/home/a/runs/smoke/points/ab/run"), text);
        assert_eq!(of("/home/a/x/results", "/home/a/x/points/a#b c"), Some("./../points/a%23b%20c/".into()));
        assert_eq!(of("/home/a", "/home/a/http:"), Some("./http%3A/".into()));
        assert_eq!(of("/tmp/results", "/home/runs"), None);
        assert_eq!(of("/a/1/2/3/4/5/6", "/a/b"), None);
    }

    #[test]
    fn what_is_no_page_is_kept() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.html");
        assert!(check_page_place(&path).is_ok());
        std::fs::write(&path, "mine").unwrap();
        assert!(check_page_place(&path).unwrap_err().to_string().contains("not a page of this program"));
        assert!(check_page_place(dir.path()).is_err());
        let places =
            ["b.HTM", "page", "b.png", "a.html.gz"].map(|name| check_page_place(&dir.path().join(name)).is_ok());
        assert_eq!(places, [true, true, false, false]);
    }
}
