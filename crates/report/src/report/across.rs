//! One comparison in each of several tables, corrected over the tables: the question of a study to all its experiments
//! at once.

use super::statistics::{holm, simultaneous};
use super::tables::text::{interval_text, signed_interval, signed_text};
use super::tables::{Comparison, Judgement, Line, Table, epochs_head, escape, joint};
use crate::base::csv::{csv_number, csv_text};
use crate::metrics::Metric;
use crate::report::distinct;
use crate::report::statistics::p_text;

/// The comparisons, one for each table, scene and axis values.
#[derive(Clone, Debug, PartialEq)]
pub struct Across {
    /// The compared row.
    pub row: String,
    /// The row that it is compared with.
    pub baseline: String,
    /// Key of the metric.
    pub metric: String,
    /// The comparisons, in the order of the tables.
    pub blocks: Vec<Block>,
}

/// One comparison.
#[derive(Clone, Debug, PartialEq)]
pub struct Block {
    /// The table's name, which is the sweep's.
    pub sweep: String,
    /// The scene.
    pub scene: String,
    /// Axis values; usually empty.
    pub axes: String,
    /// Number of training views; empty if it is unknown or differs.
    pub views: String,
    /// Name for readers instead of sweep and scene.
    pub label: Option<String>,
    /// The difference, its p values corrected over the blocks, or `None` if no seed has both rows.
    pub comparison: Option<Comparison>,
    /// Counts of the row's points by status: `done 5`. Those of the baseline follow if it lacks a point.
    pub status: String,
    /// Lowest and highest of how often both rows saw a training pixel; `None` if it is unknown.
    pub epochs: Option<(f64, f64)>,
    /// The row or its baseline lacks a point of its sweep.
    pub unfinished: bool,
    /// Ends of the interval that holds with 95 % for all blocks at once (Bonferroni).
    pub simultaneous: Option<(f64, f64)>,
}

const HOW_TO_READ: &str = "the difference is paired by seed, with its 95 % Student t interval; p is that of the paired t test \
     after Holm's correction over these comparisons, one a block; the simultaneous intervals hold with 95 % for all of them at \
     once (Bonferroni), which is stricter than Holm's p: \"higher\" and \"lower\" go by p";

/// Returns the line of the baseline that `line` is compared with: at the same axis values, or without any.
fn line_of_baseline<'a>(table: &'a Table, line: &Line, baseline: &str) -> Option<&'a Line> {
    let at = |axes: &str| {
        table.lines.iter().find(|other| other.scene == line.scene && other.row == baseline && other.axes == axes)
    };
    at(&line.axes).or_else(|| at(""))
}

impl Across {
    /// Compares in tables whose first metric is the compared one and in which `row` has the baseline `baseline`.
    pub fn new(row: &str, baseline: &str, tables: &[Table]) -> Across {
        let block = |table: &Table, line: &Line| {
            let compared_with = line_of_baseline(table, line, baseline);
            let lacking = compared_with.filter(|other| other.unfinished());
            let status = |other: &Line| format!("{}; {baseline}: {}", line.status, other.status);
            Block {
                sweep: table.name.clone(),
                scene: line.scene.clone(),
                axes: line.axes.clone(),
                views: line.protocol("views_trained").into(),
                label: None,
                comparison: line.cells[0].comparison,
                status: lacking.map_or_else(|| line.status.clone(), status),
                epochs: joint([Some(line), compared_with].into_iter().flatten().filter_map(|line| line.epochs)),
                unfinished: line.unfinished() || lacking.is_some(),
                simultaneous: None,
            }
        };
        let of = |table| -> Vec<Block> {
            let table: &Table = table;
            table.lines.iter().filter(|line| line.row == row).map(|line| block(table, line)).collect()
        };
        let mut across = Across {
            row: row.into(),
            baseline: baseline.into(),
            metric: tables.first().and_then(|table| table.metrics.first()).cloned().unwrap_or_default(),
            blocks: tables.iter().flat_map(of).collect(),
        };
        across.correct();
        across.tell_apart();
        across
    }

    /// Names blocks of one scene and number of views by their sweeps, too.
    fn tell_apart(&mut self) {
        let names: Vec<String> = self.blocks.iter().map(Block::place).collect();
        for (block, name) in self.blocks.iter_mut().zip(&names) {
            if names.iter().filter(|other| *other == name).count() > 1 {
                block.label = Some(format!("{}, {}", block.scene_and_views(), block.sweep));
            }
        }
    }

    /// Calls the blocks of a sweep otherwise for readers; those of several scenes keep theirs.
    pub fn call(&mut self, sweep: &str, label: &str) {
        let scenes = distinct(self.blocks.iter().filter(|block| block.sweep == sweep).map(|block| block.scene.clone()));
        for block in self.blocks.iter_mut().filter(|block| block.sweep == sweep) {
            let several = scenes.len() > 1;
            block.label = Some(if several { format!("{label}, {}", block.scene) } else { label.into() });
        }
    }

    fn correct(&mut self) {
        let all = |p: fn(&Comparison) -> Option<f64>| -> Vec<Option<f64>> {
            self.blocks.iter().map(|block| block.comparison.as_ref().and_then(p)).collect()
        };
        let p = all(|comparison| comparison.p);
        let tests = p.iter().flatten().count();
        let (p, equivalence) = (holm(&p), holm(&all(|c| c.equivalence.and_then(|equivalence| equivalence.p))));
        for ((block, p), of_equivalence) in self.blocks.iter_mut().zip(p).zip(equivalence) {
            let Some(comparison) = &mut block.comparison else { continue };
            comparison.p_holm = p;
            comparison.equivalence.iter_mut().for_each(|equivalence| equivalence.p_holm = of_equivalence);
            block.simultaneous = comparison.interval.map(|ends| simultaneous(ends, comparison.pairs, tests));
        }
    }

    /// Returns one line a block, with all digits.
    pub fn csv(&self) -> String {
        const HEAD: [&str; 21] = [
            "sweep",
            "scene",
            "axes",
            "status",
            "compared",
            "baseline",
            "metric",
            "pairs",
            "difference",
            "low",
            "high",
            "p",
            "p_holm",
            "simultaneous_low",
            "simultaneous_high",
            "verdict",
            "margin",
            "p_equivalence",
            "p_equivalence_holm",
            "equivalent",
            "ruled_out",
        ];
        let rows = self.blocks.iter().map(|block| {
            let found = block.comparison.as_ref();
            let number = |of: fn(&Comparison) -> Option<f64>| csv_number(found.and_then(of));
            let equivalence = found.and_then(|comparison| comparison.equivalence);
            vec![
                block.sweep.clone(),
                block.scene.clone(),
                block.axes.clone(),
                block.status.clone(),
                self.row.clone(),
                self.baseline.clone(),
                self.metric.clone(),
                found.map_or(0, |comparison| comparison.pairs).to_string(),
                number(|comparison| Some(comparison.difference)),
                number(|comparison| Some(comparison.interval?.0)),
                number(|comparison| Some(comparison.interval?.1)),
                number(|comparison| comparison.p),
                number(|comparison| comparison.p_holm),
                csv_number(block.simultaneous.map(|ends| ends.0)),
                csv_number(block.simultaneous.map(|ends| ends.1)),
                found.and_then(Comparison::verdict).map_or(String::new(), |verdict| verdict.name().into()),
                csv_number(equivalence.map(|equivalence| equivalence.margin)),
                csv_number(equivalence.and_then(|equivalence| equivalence.p)),
                csv_number(equivalence.and_then(|equivalence| equivalence.p_holm)),
                equivalence.filter(|e| e.p_holm.is_some()).map_or(String::new(), |e| e.holds().to_string()),
                block.ruled_out(&self.metric).map_or(String::new(), |ruled_out| ruled_out.to_string()),
            ]
        });
        csv_text(std::iter::once(HEAD.map(String::from).to_vec()).chain(rows))
    }

    /// Returns the same for readers.
    pub fn markdown(&self) -> String {
        let mut text = format!(
            "**{} against {}, {}: one comparison a block**\n\n",
            escape(&self.row),
            escape(&self.baseline),
            escape(&self.metric)
        );
        text += &epochs_head(self.blocks.iter().filter_map(|block| block.epochs));
        text += "| block | seeds | difference, 95 % interval | simultaneous interval | p (Holm) | said |\n";
        text += "|---|---:|---:|---:|---:|---|\n";
        text.extend(self.blocks.iter().map(|block| self.row_text(block)));
        text += &format!("\n- {HOW_TO_READ}\n");
        if self.blocks.iter().any(|block| block.margin().is_some()) {
            text += "- \"equivalent within\" a margin that the sweep states: two one-sided paired t tests, with Holm's p below 0.05; \
                     \"ruled out\": all of the simultaneous interval is worse than a gain of the margin\n";
        }
        text
    }

    fn row_text(&self, block: &Block) -> String {
        let place = escape(&block.place());
        let Some(comparison) = &block.comparison else {
            return format!(
                "| {place} | 0 |  |  |  | no seed in which both rows have it; {} |\n",
                escape(&block.status)
            );
        };
        format!(
            "| {place} | {} | {} | {} | {} | {} |\n",
            comparison.pairs,
            signed_interval(&self.metric, comparison.difference, comparison.interval),
            interval_text(&self.metric, block.simultaneous),
            comparison.p_holm.map_or(String::new(), p_text),
            escape(&self.words(block, comparison))
        )
    }

    /// Returns the verdict on a block in words.
    fn words(&self, block: &Block, comparison: &Comparison) -> String {
        self.said(block, comparison, comparison.verdict().map_or("", |verdict| verdict.name()))
    }

    /// Returns the same for a figure, whose marks show where no difference is shown.
    pub(super) fn judged(&self, block: &Block, comparison: &Comparison) -> String {
        self.said(block, comparison, Judgement::of(&self.metric, comparison).name())
    }

    fn said(&self, block: &Block, comparison: &Comparison, verdict: &str) -> String {
        let mut words: Vec<String> = Some(verdict.to_string()).filter(|word| !word.is_empty()).into_iter().collect();
        if let Some(margin) = block.margin() {
            let margin = signed_text(&self.metric, margin);
            let margin = margin.trim_start_matches('+');
            words.extend(comparison.is_equivalent().then(|| format!("equivalent within {margin}")));
            words.extend(
                (block.ruled_out(&self.metric) == Some(true)).then(|| format!("a gain of {margin} is ruled out")),
            );
        }
        words.extend(block.unfinished.then(|| format!("UNFINISHED: {}", block.status)));
        words.join(", ")
    }
}

impl Block {
    /// Returns the label, or scene and training views, and axis values: `fern, 8 views`.
    pub(super) fn place(&self) -> String {
        let name = self.label.clone().unwrap_or_else(|| self.scene_and_views());
        if self.axes.is_empty() { name } else { format!("{name}, {}", self.axes) }
    }

    fn scene_and_views(&self) -> String {
        match self.views.as_str() {
            "" => self.scene.clone(),
            "1" => format!("{}, 1 view", self.scene),
            views => format!("{}, {views} views", self.scene),
        }
    }

    /// Returns the margin of equivalence that the sweep states.
    pub(super) fn margin(&self) -> Option<f64> {
        Some(self.comparison?.equivalence?.margin)
    }

    /// Returns whether all of the simultaneous interval is worse than a gain of the margin. `None` without a margin or
    /// an interval, or if the metric has no better direction.
    pub fn ruled_out(&self, metric: &str) -> Option<bool> {
        let (_, high) = Metric::find(metric)?.direction.gains(self.simultaneous?)?;
        Some(high < self.margin()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::{Record, RowSpec, Status, TableSpec};

    /// Returns a table with these differences, seed by seed.
    fn table(name: &str, differences: &[f64]) -> Table {
        unfinished_table(name, differences, 0)
    }

    /// The same, but for `lacking` seeds the baseline has not been trained yet.
    fn unfinished_table(name: &str, differences: &[f64], lacking: usize) -> Table {
        let row = |name: &str, baseline: Option<&str>| RowSpec {
            name: name.into(),
            baseline: baseline.map(String::from),
            ..RowSpec::default()
        };
        let record = |row: &str, seed: usize, psnr: f64| Record {
            id: format!("{row}-{seed}"),
            scene: "fern".into(),
            row: row.into(),
            axes: vec![],
            seed: Some(seed as u64),
            status: Status::Done,
            reason: String::new(),
            metrics: vec![("psnr".into(), Some(psnr))],
            protocol: vec![],
            inactive_levels: vec![],
        };
        let spec = TableSpec {
            name: name.into(),
            metrics: vec!["psnr".into()],
            rows: vec![row("NeRF", None), row("Aug-NeRF", Some("NeRF"))],
            equivalence: vec![("psnr".into(), 0.3)],
            ..TableSpec::default()
        };
        let of_seed = |(seed, difference): (usize, &f64)| {
            [record("NeRF", seed, 20.0), record("Aug-NeRF", seed, 20.0 + difference)]
        };
        let mut records: Vec<Record> = differences.iter().enumerate().flat_map(of_seed).collect();
        for waiting in records.iter_mut().filter(|record| record.row == "NeRF").take(lacking) {
            (waiting.status, waiting.metrics) = (Status::Waiting, vec![]);
        }
        Table::new(&spec, &records, false).unwrap()
    }

    #[test]
    fn p_values_are_corrected_over_the_blocks_and_intervals_widened() {
        let clear = [0.5, 0.55, 0.45, 0.52];
        let near = [0.01, -0.02, 0.03, -0.01];
        let tables = [table("a", &clear), table("b", &near)];
        let across = Across::new("Aug-NeRF", "NeRF", &tables);
        let [a, b] = &across.blocks[..] else { panic!("two blocks") };
        let (own, of_a) = (tables[0].lines[1].cells[0].comparison.unwrap(), a.comparison.unwrap());
        // The smaller of two p values is doubled, the other stays.
        assert_eq!(of_a.p_holm, Some(2.0 * own.p.unwrap()));
        let of_b = b.comparison.unwrap();
        assert_eq!(of_b.p_holm, of_b.p);
        // t of 3 degrees of freedom: scipy.stats.t.ppf([0.975, 0.9875], 3) = 3.182446305283718, 4.176534846187437
        let ratio = (a.simultaneous.unwrap().1 - of_a.difference) / (of_a.interval.unwrap().1 - of_a.difference);
        assert!((ratio - 4.176534846187437 / 3.182446305283718).abs() < 1e-6, "{ratio}");
        assert_eq!((a.ruled_out("psnr"), b.ruled_out("psnr")), (Some(false), Some(true)));
        // Less is better: a value far above 0 is no gain, and one near 0 is no gain of the margin.
        assert_eq!((a.ruled_out("lpips_squeeze"), b.ruled_out("lpips_squeeze")), (Some(true), Some(true)));
        let text = across.markdown();
        assert!(text.contains("| fern, a | 4 | +0.50 ["), "{text}");
        assert!(
            text.contains("| higher |") && text.contains("equivalent within 0.30, a gain of 0.30 is ruled out |"),
            "{text}"
        );
        let csv = across.csv();
        assert!(csv.starts_with("sweep,scene,") && csv.lines().count() == 3, "{csv}");
    }

    #[test]
    fn a_baseline_that_lacks_a_point_leaves_the_comparison_unfinished() {
        let across = Across::new("Aug-NeRF", "NeRF", &[unfinished_table("a", &[0.5, 0.55, 0.45], 1)]);
        let block = &across.blocks[0];
        assert_eq!((block.comparison.unwrap().pairs, block.unfinished), (2, true));
        assert_eq!(block.status, "done 3; NeRF: waiting 1, done 2");
        assert!(across.markdown().contains("UNFINISHED: done 3; NeRF: waiting 1, done 2"));
        assert!(!Across::new("Aug-NeRF", "NeRF", &[table("a", &[0.5, 0.55])]).blocks[0].unfinished);
    }

    #[test]
    fn one_block_is_itself_and_a_single_seed_claims_nothing() {
        let tables = [table("a", &[0.5, 0.55, 0.45])];
        let across = Across::new("Aug-NeRF", "NeRF", &tables);
        let own = tables[0].lines[1].cells[0].comparison.unwrap();
        let found = across.blocks[0].comparison.unwrap();
        assert_eq!((found.p_holm, found.interval), (own.p, own.interval));
        let (wide, plain) = (across.blocks[0].simultaneous.unwrap(), own.interval.unwrap());
        assert!((wide.0 - plain.0).abs() < 1e-12 && (wide.1 - plain.1).abs() < 1e-12);
        let single = Across::new("Aug-NeRF", "NeRF", &[table("a", &[0.5])]);
        assert_eq!((single.blocks[0].simultaneous, single.blocks[0].ruled_out("psnr")), (None, None));
        assert!(single.csv().lines().nth(1).unwrap().ends_with(",,0.3,,,,"), "{}", single.csv());
    }
}
