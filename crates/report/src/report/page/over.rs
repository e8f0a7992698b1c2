//! The rows over all scenes, before the table of each scene.

use super::figures::Drawn;
use crate::base::Result;
use crate::report::plots::comparisons_figure;
use crate::report::tables::{Heading, Judgement, Table};
use crate::report::{Compared, Comparisons};

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
    /// `better` or `worse`; empty where no difference is shown.
    pub judgement: &'static str,
}

/// Returns the comparison of the table's first metric, or `None` for tables of few scenes, without a baseline, or of rows
/// that are not comparable.
pub fn over(table: &Table) -> Result<Option<Over>> {
    let compared = table.lines.iter().find_map(|line| Some((line, line.baseline.as_ref()?)));
    let Some((line, label)) = compared.filter(|_| table.lines.iter().all(|line| line.mixed.is_empty())) else {
        return Ok(None);
    };
    let baseline = table.lines.iter().find(|other| other.scene == line.scene && other.label == *label);
    let Some(baseline) = baseline.filter(|_| !table.metrics.is_empty()) else { return Ok(None) };
    let all = Comparisons::over_scenes(&baseline.row, std::slice::from_ref(table));
    if all.scenes.len() < FEWEST_SCENES {
        return Ok(None);
    }
    let figure = comparisons_figure(&all);
    let drawn = figure.map(|figure| Drawn::new("over_scenes", figure.svg.as_bytes(), &figure.caption));
    let row = |line: &Compared| {
        let [label, _, difference, simultaneous, p, said] = all.cells(line);
        let signs = line.over.as_ref().and_then(|over| over.signs);
        let signs = signs.map_or(String::new(), |signs| format!("{}, {}", signs.above, signs.below));
        let judged = line.comparison.map_or(Judgement::NotShown, |found| Judgement::of(&all.metric, &found));
        Row { label, cells: [difference, simultaneous, p, signs], said, judgement: judged.name() }
    };
    Ok(Some(Over {
        baseline: all.baseline.clone(),
        metric: Heading::of(&all.metric).name.to_string(),
        scenes: all.scenes.len(),
        rows: all.best_first().into_iter().map(row).collect(),
        figure: drawn.transpose()?,
    }))
}
