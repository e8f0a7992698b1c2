//! Writes corrupted training views to files.

use std::path::Path;

use serde::Serialize;

use crate::base::files::{AtomicDir, write_atomic, write_json};
use crate::base::{Error, Result};
use crate::data::pose::{column, length, sub};
use crate::data::{Scene, View};
use crate::draw::{beside, write_png8};
use crate::metrics::psnr_float;

/// White pixels between a clean and a corrupted view.
const GAP: usize = 4;

/// How one view was corrupted.
#[derive(Debug, Serialize)]
struct Line<'a> {
    view: &'a str,
    /// PSNR of the corrupted view against the clean one in dB; empty if they are equal.
    psnr: Option<f64>,
    /// Angle of the rotation from one camera to the other, degrees.
    turned: f64,
    /// Distance between the origins, scene units.
    moved: f64,
}

#[derive(Serialize)]
struct Note<'a> {
    scene: &'a str,
    corruption: &'a str,
    seed: u64,
    data_hash: &'a str,
    corruption_hash: String,
}

/// Writes the new folder `dir`: a PNG of each training view in `views`, `beside.png` (the first view, clean and
/// corrupted), `views.csv` (how each was corrupted) and `corruption.json`. Both scenes have the same views,
/// `corrupted` after [`corrupt`](crate::data::corruption::corrupt) with `seed`.
///
/// # Errors
/// The folder holds files, or cannot be written.
pub fn write_corrupted(dir: &Path, clean: &Scene, corrupted: &Scene, seed: u64) -> Result<()> {
    let what = corrupted.corrupted.as_ref().expect("the scene is corrupted");
    let folder = AtomicDir::vacant(dir)?;
    let views = folder.path().join("views");
    std::fs::create_dir(&views).map_err(|e| Error::unwritable(&views, &e))?;
    let mut lines = csv::Writer::from_writer(Vec::new());
    for (before, after) in clean.train.iter().zip(&corrupted.train) {
        write_png8(&views.join(format!("{}.png", after.name)), &after.image)?;
        lines.serialize(line(before, after)?).expect("memory holds it");
    }
    let (before, after) = (&clean.train[0].image, &corrupted.train[0].image);
    write_png8(&folder.path().join("beside.png"), &beside(&[before, after], GAP)?)?;
    write_atomic(&folder.path().join("views.csv"), &lines.into_inner().expect("memory holds it"))?;
    let note = Note {
        scene: &clean.name,
        corruption: &what.what,
        seed,
        data_hash: &what.clean_hash,
        corruption_hash: corrupted.hash(),
    };
    write_json(&folder.path().join("corruption.json"), &note)?;
    folder.commit()
}

fn line<'a>(before: &View, after: &'a View) -> Result<Line<'a>> {
    let [a, b] = [before, after].map(|view| &view.camera.pose);
    // The difference of two rotations has the norm 2 sqrt(2) sin(angle / 2). It is exactly 0 for equal rotations, even
    // if rounded.
    let norm = (0..3).map(|axis| length(sub(column(a, axis), column(b, axis))).powi(2)).sum::<f64>().sqrt();
    let half = norm / 8f64.sqrt();
    Ok(Line {
        view: &after.name,
        psnr: psnr_float(&before.image, &after.image)?,
        turned: 2.0 * half.min(1.0).asin().to_degrees(),
        moved: length(sub(column(a, 3), column(b, 3))),
    })
}
