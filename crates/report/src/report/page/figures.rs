//! The figures, inline.

use crate::base::{Error, Result};
use crate::report::exporters::File;

/// A figure, and the same against seconds where there is such a one.
pub struct Figure {
    pub name: String,
    pub svg: String,
    pub seconds: String,
}

const SECONDS: &str = "_seconds";

/// Those among the files, in their order.
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

/// The element of a figure of this program. What else a file may hold is not put into a page.
fn inline(name: &str, bytes: &[u8]) -> Result<String> {
    let text = std::str::from_utf8(bytes).ok().map(str::trim).filter(|text| text.starts_with("<svg"));
    let is_plain =
        |text: &&str| !["<script", "<foreignObject", "<style", "<a "].iter().any(|other| text.contains(other));
    let text = text.filter(is_plain).ok_or_else(|| Error::Data(format!("{name}.svg is no figure of this program")))?;
    // Within a page the language is known, and no address stands in it.
    Ok(text.replacen(" xmlns=\"http://www.w3.org/2000/svg\"", "", 1))
}
