//! The figures, inline in the page.

use crate::base::{Error, Result};
use crate::report::tables::Table;

/// A figure with its caption.
pub struct Drawn {
    pub name: String,
    /// What it shows.
    pub title: String,
    /// How it is read.
    pub caption: String,
    pub svg: String,
}

impl Drawn {
    /// Takes an SVG and the lines of a caption; the name is the title of a figure without.
    pub fn new(name: &str, svg: &[u8], caption: &str) -> Result<Drawn> {
        let (title, caption) = caption.split_once('\n').unwrap_or((name, ""));
        let [title, caption] = [title, caption].map(|text| text.trim().to_string());
        Ok(Drawn { name: name.into(), title, caption, svg: inline(name, svg)? })
    }
}

/// Returns the figures among the files, in order, without those of a metric that is the same for all rows.
pub fn figures(table: &Table, files: &[(String, Vec<u8>)]) -> Result<Vec<Drawn>> {
    let file = |file: String| files.iter().find(|(known, _)| *known == file).map(|(_, bytes)| bytes.as_slice());
    let svgs = files.iter().filter_map(|(name, bytes)| Some((name.strip_suffix(".svg")?, bytes)));
    let mut figures = Vec::new();
    let same = same_for_all(table);
    for (name, bytes) in svgs {
        if same.iter().any(|place| name.split_once('_').is_some_and(|(_, rest)| rest == place)) {
            continue;
        }
        let caption = String::from_utf8_lossy(file(format!("{name}.txt")).unwrap_or_default());
        figures.push(Drawn::new(name, bytes, &caption)?);
    }
    Ok(figures)
}

/// Returns `SCENE_METRIC` for metrics of which all rows of a scene have the same number, such as the PSNR of one colour.
fn same_for_all(table: &Table) -> Vec<String> {
    let mut same = Vec::new();
    for (scene, lines) in table.scenes() {
        for (index, metric) in table.metrics.iter().enumerate() {
            let cells = lines.iter().map(|line| &line.cells[index]);
            let known: Vec<(f64, Option<f64>)> = cells
                .filter_map(|cell| Some((cell.mean?, cell.deviation.filter(|deviation| *deviation > 0.0))))
                .collect();
            if known.len() > 1 && known.iter().all(|own| *own == (known[0].0, None)) {
                same.push(format!("{scene}_{metric}"));
            }
        }
    }
    same
}

/// Returns the SVG element of a figure of this program. Other content is not put into a page.
fn inline(name: &str, bytes: &[u8]) -> Result<String> {
    let text = std::str::from_utf8(bytes).ok().map(str::trim).filter(|text| text.starts_with("<svg"));
    let is_plain =
        |text: &&str| !["<script", "<foreignObject", "<style", "<a "].iter().any(|other| text.contains(other));
    let text =
        text.filter(is_plain).ok_or_else(|| Error::Data(format!("{name}.svg is not a figure of this program")))?;
    // Within a page the language is known, and addresses are not allowed.
    Ok(text.replacen(" xmlns=\"http://www.w3.org/2000/svg\"", "", 1))
}
