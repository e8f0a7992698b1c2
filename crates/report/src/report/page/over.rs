//! The rows over all scenes, before the table of each scene.

use super::figures::Drawn;
use crate::base::Result;
use crate::report::plots::{Width, over_scenes_figure};
use crate::report::tables::{Heading, Judgement, Table};
use crate::report::{OverScenes, Record, RowOverScenes};

/// Fewest scenes over which rows are compared.
const FEWEST_SCENES: usize = 3;

/// The comparison of one metric over scenes.
pub struct Over {
    pub baseline: String,
    pub metric: String,
    pub scenes: usize,
    pub rows: Vec<Row>,
    pub figure: Option<Drawn>,
}

/// A row's difference to the baseline.
pub struct Row {
    pub label: String,
    /// Difference, simultaneous interval, Holm's p, scenes up and down.
    pub cells: [String; 4],
    pub said: String,
    pub better: bool,
    pub worse: bool,
}

/// Returns the comparison of the table's first metric, or `None` for tables of few scenes, without a baseline, or of rows
/// that are not comparable.
pub fn over(table: &Table, records: &[Record]) -> Result<Option<Over>> {
    let compared = table.lines.iter().find_map(|line| Some((line, line.baseline.as_ref()?)));
    let Some((line, label)) = compared.filter(|_| table.lines.iter().all(|line| line.mixed.is_empty())) else {
        return Ok(None);
    };
    let baseline = table.lines.iter().find(|other| other.scene == line.scene && other.label == *label);
    let (Some(baseline), Some(metric)) = (baseline, table.metrics.first()) else { return Ok(None) };
    let cells = table.lines.iter().map(|line| &line.cells[0]);
    let margin = cells.filter_map(|cell| cell.comparison?.equivalence).map(|equivalence| equivalence.margin).next();
    let over = OverScenes::new(&baseline.row, metric, margin, records);
    if over.scenes.len() < FEWEST_SCENES {
        return Ok(None);
    }
    let [page, column] = Width::ALL.map(|width| over_scenes_figure(&over, width));
    let drawn =
        page?.zip(column?).map(|(a, b)| Drawn::new("over_scenes", a.svg.as_bytes(), b.svg.as_bytes(), &a.caption));
    let row = |row: &RowOverScenes| {
        let [label, _, difference, simultaneous, p, said] = over.cells(row);
        let signs = row.signs.map_or(String::new(), |signs| format!("{}, {}", signs.above, signs.below));
        let judged = row.comparison.as_ref().map(|comparison| Judgement::of(metric, comparison));
        Row {
            label,
            cells: [difference, simultaneous, p, signs],
            said,
            better: judged == Some(Judgement::Better),
            worse: judged == Some(Judgement::Worse),
        }
    };
    Ok(Some(Over {
        baseline: over.baseline.clone(),
        metric: Heading::of(metric).name.to_string(),
        scenes: over.scenes.len(),
        rows: over.best_first().into_iter().map(row).collect(),
        figure: drawn.transpose()?,
    }))
}
