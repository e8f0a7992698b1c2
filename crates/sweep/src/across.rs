//! One comparison of each of several sweeps, corrected over the sweeps, and the folder that keeps it.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::base::files::write_atomic;
use crate::base::input::{TEXT_BYTES, read_text};
use crate::base::{Error, Result};
use crate::report::Across;
use crate::report::exporters::Content;
use crate::report::plots::{Width, across_figure};

use super::collect::holds_files;
use super::folder::DEFINITION;
use super::over_scenes::OVER_SCENES;
use super::view::{Origin, Selection, Source, VIEW, View};
use super::words::{check_name, check_text, quoted};

/// What a folder of such comparisons has instead of a sweep's definition.
pub const ACROSS: &str = "across.toml";
/// For readers; a page of the folder that is made.
pub const ACROSS_PAGE: &str = "across.md";
/// A line a block.
pub const ACROSS_CSV: &str = "across.csv";
/// The figure's name, without its ending.
const FIGURE: &str = "across";

/// The question to every sweep, and the sweeps: `across.toml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AcrossRequest {
    /// The row that is compared.
    pub row: String,
    /// What it is compared with.
    pub baseline: String,
    /// Key of the metric.
    pub metric: String,
    /// The sweeps, in the order of the blocks.
    pub sweep: Vec<Origin>,
}

impl AcrossRequest {
    /// Asks sweeps whether `row` differs from `baseline` in a metric. `labels` are what some are called instead of their names.
    ///
    /// # Errors
    /// A sweep that is named twice, or has not both rows; a label of another sweep.
    pub fn new(
        row: &str,
        baseline: &str,
        metric: &str,
        sources: &[Source],
        labels: &[(String, String)],
    ) -> Result<(AcrossRequest, Across)> {
        if row == baseline {
            return Err(Error::Config(format!("--row and --baseline are both '{row}'; name two rows")));
        }
        if sources.is_empty() {
            return Err(Error::Config("no sweep is named: a comparison across sweeps needs at least one".into()));
        }
        let mut tables = Vec::new();
        for (index, source) in sources.iter().enumerate() {
            if sources[..index].iter().any(|other| other.name == source.name) {
                return Err(Error::Config(format!("sweep '{}' is named twice: each is one block", source.name)));
            }
            [row, baseline].into_iter().try_for_each(|name| has_row(source, name))?;
            let selection = Selection {
                baseline: Some(baseline.into()),
                rows: vec![baseline.into(), row.into()],
                metrics: vec![metric.into()],
            };
            // Metrics over common pixels are the sweep's own, of all its rows: its results have no others.
            let source = Source { folder: None, ..source.clone() };
            let view = View::new(&source.name, std::slice::from_ref(&source), selection);
            let table = view.and_then(|view| view.table());
            tables.push(table.map_err(|error| error.within(&format!("sweep '{}'", source.name)))?);
        }
        let mut across = Across::new(row, baseline, &tables);
        let mut sweep: Vec<Origin> = sources.iter().map(Origin::of).collect();
        for (name, label) in labels {
            check_name("a label", label).and_then(|()| check_text("--label", label)).map_err(Error::Config)?;
            let Some(origin) = sweep.iter_mut().find(|origin| origin.name == *name) else {
                let names: Vec<&str> = sources.iter().map(|source| source.name.as_str()).collect();
                return Err(Error::Config(format!("--label {name}: the sweeps are {}", names.join(", "))));
            };
            origin.label = Some(label.clone());
            across.call(name, label);
        }
        let mut unlabelled = sweep.iter().filter(|origin| origin.label.is_none());
        let named = unlabelled.try_for_each(|origin| check_text("the sweep's name", &origin.name));
        named.map_err(Error::Config)?;
        let request = AcrossRequest { row: row.into(), baseline: baseline.into(), metric: metric.into(), sweep };
        Ok((request, across))
    }

    /// What sweeps are called instead of their names.
    pub fn labels(&self) -> Vec<(String, String)> {
        self.sweep.iter().filter_map(|sweep| Some((sweep.name.clone(), sweep.label.clone()?))).collect()
    }

    /// Reads a folder's.
    pub fn read(folder: &Path) -> Result<AcrossRequest> {
        let path = folder.join(ACROSS);
        let text = read_text(&path, TEXT_BYTES).map_err(|e| Error::unreadable(&path, &e))?;
        toml::from_str(&text).map_err(|e| Error::Data(format!("{}: {e}", path.display())))
    }

    /// The files of the folder, by their names.
    pub fn files(&self, across: &Across) -> Result<Vec<(String, Content)>> {
        let request = toml::to_string(self).expect("plain data");
        let texts = [(ACROSS, request), (ACROSS_CSV, across.csv()), (ACROSS_PAGE, across.markdown())];
        let texts = texts.into_iter().map(|(name, text)| (name.to_string(), Content::Bytes(text.into_bytes())));
        let mut files: Vec<(String, Content)> = texts.collect();
        for width in Width::ALL {
            let name = format!("{FIGURE}{}", width.suffix());
            files.extend(across_figure(across, width)?.into_iter().flat_map(|figure| figure.files(&name)));
        }
        Ok(files)
    }

    /// Writes them into a folder, which may hold pages beside them.
    ///
    /// # Errors
    /// A folder with tables of a sweep, with other folders, or with files that are not such a comparison.
    pub fn write(&self, across: &Across, folder: &Path) -> Result<()> {
        write_folder(folder, (ACROSS, OVER_SCENES), &self.files(across)?)
    }
}

/// Writes the files of a comparison into a folder, which may hold pages beside them. `own` is the first file, the
/// request of this kind of comparison, and `other` that of the other kind.
///
/// # Errors
/// A folder with tables of a sweep, with `other`, with other folders, or with files but without `own`.
pub(super) fn write_folder(folder: &Path, (own, other): (&str, &str), files: &[(String, Content)]) -> Result<()> {
    let refuse =
        |holds: &str| Err(Error::Output(format!("{} holds {holds}: name another folder with --out", folder.display())));
    if [DEFINITION, VIEW].iter().any(|name| folder.join(name).exists()) {
        return refuse("tables of a sweep");
    }
    if folder.join(other).exists() {
        return refuse(&format!("another comparison ({other})"));
    }
    let mut entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    if entries.any(|entry| entry.path().is_dir()) {
        return refuse("other folders");
    }
    if !folder.join(own).exists() && holds_files(folder, &[]) {
        return refuse("files that are not a comparison of sweeps");
    }
    std::fs::create_dir_all(folder).map_err(|e| Error::unwritable(folder, &e))?;
    files.iter().try_for_each(|(name, content)| write_atomic(&folder.join(name), &content.bytes()?))
}

fn has_row(source: &Source, name: &str) -> Result<()> {
    let scored = source.outputs.scored.iter().map(|scored| scored.row.as_str());
    let rows: Vec<&str> = source.definition.row.iter().map(|row| row.name.as_str()).chain(scored).collect();
    if rows.contains(&name) {
        return Ok(());
    }
    Err(Error::Config(format!("sweep '{}' has no row '{name}'; its rows are {}", source.name, quoted(&rows))))
}
