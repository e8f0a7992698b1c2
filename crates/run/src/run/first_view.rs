//! Reads a run's images of its first held-out view.

use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::RunDir;
use crate::base::files::read_json;
use crate::base::{Error, Image, Result};
use crate::data::images;

/// Advice for a damaged file of a run.
const ADVICE: &str = "`augnerf eval` writes metrics again, `augnerf render RUN --what views` images";

/// Images in `renders` of the first evaluated view; the view is not chosen by its content.
#[derive(Clone, Debug, PartialEq)]
pub struct FirstView {
    /// The view.
    pub name: String,
    /// The rendering.
    pub image: Image,
    /// The photo.
    pub truth: Image,
    /// Depth in the run's units; NaN where nothing is solid.
    pub depth: Vec<f32>,
    /// Which pixels of the photo count, row by row. `None` if all do.
    pub mask: Option<Vec<bool>>,
}

#[derive(Deserialize)]
struct Evaluated {
    views: Vec<Named>,
}

#[derive(Deserialize)]
struct Named {
    name: String,
}

#[derive(Deserialize)]
struct Scale {
    max: f32,
}

impl FirstView {
    /// Reads a run folder. Returns `None` if the run was not evaluated or wrote no images (`eval.pictures = 0`).
    ///
    /// # Errors
    /// An image is damaged, or differs in size from the others.
    pub fn read(run: &Path) -> Result<Option<FirstView>> {
        let [metrics, _] = RunDir::metrics_in(run);
        let Some(Evaluated { views }) = read_json(&metrics, ADVICE)? else { return Ok(None) };
        let Some(Named { name }) = views.into_iter().next() else { return Ok(None) };
        if !is_plain(&name) {
            return Err(Error::Data(format!("{}: the view {name:?} is not a file name; {ADVICE}", metrics.display())));
        }
        let folder = RunDir::renders_in(run);
        let file = |what: &str| folder.join(format!("{name}_{what}.png"));
        let Some(scale) = read_json::<Scale>(&folder.join("depth.json"), ADVICE)? else { return Ok(None) };
        if !["rgb", "truth", "depth16"].iter().all(|what| file(what).is_file()) {
            return Ok(None);
        }
        let (image, truth) = (read_picture(&file("rgb"))?, read_picture(&file("truth"))?);
        let (depth, mask) = (read_depth(&file("depth16"), scale.max)?, read_mask(&file("mask"))?);
        let pixels = image.width * image.height;
        let differ = [
            ("truth", (truth.width, truth.height) != (image.width, image.height)),
            ("depth16", depth.len() != pixels),
            ("mask", mask.as_ref().is_some_and(|mask| mask.len() != pixels)),
        ];
        if let Some((other, _)) = differ.into_iter().find(|(_, differs)| *differs) {
            let found = format!("its size differs from that of {}", file("rgb").display());
            return Err(Error::Data(format!("cannot read {}: {found}; {ADVICE}", file(other).display())));
        }
        Ok(Some(FirstView { name, image, truth, depth, mask }))
    }
}

/// Returns whether a name is a file in the folder that it is joined to.
fn is_plain(name: &str) -> bool {
    PathBuf::from(name).file_name().is_some_and(|plain| plain == name)
}

/// Reads an image of a run unchanged.
pub fn read_picture(path: &Path) -> Result<Image> {
    let decoded = images::decode(path)?;
    Ok(images::averaged(&decoded, (decoded.width() as usize, decoded.height() as usize)))
}

/// Reads depth from a 16-bit image, as `write_depth16` writes it.
fn read_depth(path: &Path, max: f32) -> Result<Vec<f32>> {
    let values = images::decode(path)?.into_luma16().into_raw();
    let depth = |value: u16| if value == 0 { f32::NAN } else { f32::from(value) / 65535.0 * max };
    Ok(values.into_iter().map(depth).collect())
}

/// Reads which pixels count, white ones, as `Pictures` writes them. Returns `None` if the view has no mask.
fn read_mask(path: &Path) -> Result<Option<Vec<bool>>> {
    if !path.is_file() {
        return Ok(None);
    }
    let values = images::decode(path)?.into_luma8().into_raw();
    Ok(Some(values.into_iter().map(|value| value > u8::MAX / 2).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::{write_depth16, write_png8};

    fn run() -> (tempfile::TempDir, PathBuf) {
        let dir = tempfile::tempdir().unwrap();
        let renders = dir.path().join("renders");
        std::fs::create_dir(&renders).unwrap();
        std::fs::write(dir.path().join("metrics.json"), r#"{"mean": {}, "views": [{"name": "r_0"}]}"#).unwrap();
        std::fs::write(renders.join("depth.json"), r#"{"max": 6.0, "unit": "NDC", "colours": null}"#).unwrap();
        let image = Image { width: 2, height: 1, channels: 3, pixels: vec![0.2, 0.4, 0.6, 0.0, 1.0, 0.0] };
        write_png8(&renders.join("r_0_rgb.png"), &image).unwrap();
        write_png8(&renders.join("r_0_truth.png"), &image).unwrap();
        write_depth16(&renders.join("r_0_depth16.png"), &[3.0, f32::NAN], 2, 1, 6.0).unwrap();
        (dir, renders)
    }

    #[test]
    fn what_was_drawn_is_read_back() {
        let (dir, renders) = run();
        let view = FirstView::read(dir.path()).unwrap().unwrap();
        assert_eq!((view.name.as_str(), view.image.width, &view.image.pixels), ("r_0", 2, &view.truth.pixels));
        assert!((view.depth[0] - 3.0).abs() < 1e-4 && view.depth[1].is_nan(), "{:?}", view.depth);
        assert_eq!(view.mask, None);
        let mask = Image { width: 2, height: 1, channels: 3, pixels: vec![0.0, 0.0, 0.0, 1.0, 1.0, 1.0] };
        write_png8(&renders.join("r_0_mask.png"), &mask).unwrap();
        assert_eq!(FirstView::read(dir.path()).unwrap().unwrap().mask, Some(vec![false, true]));
        std::fs::remove_file(renders.join("r_0_truth.png")).unwrap();
        assert_eq!(FirstView::read(dir.path()).unwrap(), None);
        std::fs::remove_file(dir.path().join("metrics.json")).unwrap();
        assert_eq!(FirstView::read(dir.path()).unwrap(), None);
    }

    #[test]
    fn what_is_damaged_is_said() {
        let (dir, renders) = run();
        std::fs::write(renders.join("r_0_rgb.png"), "no picture").unwrap();
        assert!(FirstView::read(dir.path()).unwrap_err().to_string().contains("r_0_rgb.png"));
        let (dir, renders) = run();
        write_depth16(&renders.join("r_0_depth16.png"), &[1.0], 1, 1, 6.0).unwrap();
        assert!(FirstView::read(dir.path()).unwrap_err().to_string().contains("r_0_depth16.png"));
        let (dir, renders) = run();
        let small = Image { width: 1, height: 1, channels: 3, pixels: vec![1.0; 3] };
        write_png8(&renders.join("r_0_mask.png"), &small).unwrap();
        assert!(FirstView::read(dir.path()).unwrap_err().to_string().contains("r_0_mask.png"));
        let (dir, _) = run();
        std::fs::write(dir.path().join("metrics.json"), r#"{"views": [{"name": "../../secret"}]}"#).unwrap();
        assert!(FirstView::read(dir.path()).unwrap_err().to_string().contains("not a file name"));
    }
}
