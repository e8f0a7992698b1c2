//! The figures, inline in the page.

use crate::base::{Error, Result};
use crate::report::exporters::File;

/// A figure, with its version against seconds if there is one.
pub struct Figure {
    pub name: String,
    pub svg: String,
    pub seconds: String,
}

const SECONDS: &str = "_seconds";

/// Returns the figures among the files, in order.
pub fn figures(files: &[File]) -> Result<Vec<Figure>> {
    let svgs = files.iter().filter_map(|(name, bytes)| Some((name.strip_suffix(".svg")?, bytes)));
    let mut figures: Vec<Figure> = Vec::new();
    for (name, bytes) in svgs {
        let svg = inline(name, bytes)?;
        let of_steps = |figure: &&mut Figure| name.strip_suffix(SECONDS) == Some(figure.name.as_str());
        match figures.iter_mut().find(of_steps) {
            Some(figure) => figure.seconds = svg,
            None => figures.push(Figure { name: name.into(), svg, seconds: String::new() }),
        }
    }
    Ok(figures)
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
