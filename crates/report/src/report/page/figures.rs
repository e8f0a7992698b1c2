//! The figures, inline in the page.

use crate::base::{Error, Result};
use crate::metrics::Metric;
use crate::report::plots::Width;
use crate::report::tables::{Heading, Table};

/// A figure, with its version against seconds if there is one.
pub struct Figure {
    pub name: String,
    pub title: String,
    pub svg: Drawn,
    pub seconds: Option<Drawn>,
}

/// A figure as wide screens and as narrow ones show it.
#[derive(Default)]
pub struct Drawn {
    pub page: String,
    pub column: String,
}

const SECONDS: &str = "_seconds";

/// Returns the figures among the files, in order, without those of a metric that is the same for all rows.
pub fn figures(table: &Table, files: &[(String, Vec<u8>)]) -> Result<Vec<Figure>> {
    let column = Width::Column.suffix();
    let svgs = files.iter().filter_map(|(name, bytes)| Some((name.strip_suffix(".svg")?, bytes)));
    let mut figures: Vec<Figure> = Vec::new();
    let same = same_for_all(table);
    for (name, bytes) in svgs.filter(|(name, _)| !name.ends_with(column)) {
        if same.iter().any(|place| name.split_once('_').is_some_and(|(_, rest)| rest == place)) {
            continue;
        }
        let narrow = format!("{name}{column}.svg");
        let narrow =
            files.iter().find(|(known, _)| *known == narrow).map(|(_, bytes)| inline(name, bytes)).transpose()?;
        let page = inline(name, bytes)?;
        let drawn = Drawn { column: narrow.unwrap_or_else(|| page.clone()), page };
        let of_steps = |figure: &&mut Figure| name.strip_suffix(SECONDS) == Some(figure.name.as_str());
        match figures.iter_mut().find(of_steps) {
            Some(figure) => figure.seconds = Some(drawn),
            None => figures.push(Figure { name: name.into(), title: title(name), svg: drawn, seconds: None }),
        }
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

/// Returns what a figure shows, in words, by its file's name: `rows_fern_psnr` as `Rows: PSNR on fern`.
fn title(name: &str) -> String {
    let (kind, rest) = name.split_once('_').unwrap_or((name, ""));
    let metric = Metric::in_tables().map(|metric| metric.key).filter(|key| rest.ends_with(&format!("_{key}")));
    let Some(key) = metric.max_by_key(|key| key.len()) else {
        return match kind {
            "attack" => format!("Shift of colours by the attack on {rest}"),
            "surfaces" => format!("Surfaces of {rest}"),
            _ => name.into(),
        };
    };
    let (scene, metric) = (&rest[..rest.len() - key.len() - 1], Heading::of(key).name);
    match kind {
        "rows" => format!("{metric} of each row on {scene}"),
        "axes" => format!("{metric} along the axes on {scene}"),
        "heatmap" => format!("{metric} over two axes on {scene}"),
        "curves" => format!("Training on {scene}"),
        _ => name.into(),
    }
}

/// Returns the SVG element of a figure of this program. Other content is not put into a page.
pub fn inline(name: &str, bytes: &[u8]) -> Result<String> {
    let text = std::str::from_utf8(bytes).ok().map(str::trim).filter(|text| text.starts_with("<svg"));
    let is_plain =
        |text: &&str| !["<script", "<foreignObject", "<style", "<a "].iter().any(|other| text.contains(other));
    let text =
        text.filter(is_plain).ok_or_else(|| Error::Data(format!("{name}.svg is not a figure of this program")))?;
    // Within a page the language is known, and addresses are not allowed.
    Ok(text.replacen(" xmlns=\"http://www.w3.org/2000/svg\"", "", 1))
}
