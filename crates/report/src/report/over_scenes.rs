//! Rows against a baseline over scenes: each scene counts once, with the mean over its seeds.

use super::over_units::{Components, SignTest, components, hodges_lehmann, prediction, sign_test, to_best};
use super::statistics::{holm, mean, paired_differences, simultaneous, standard_deviation};
use super::tables::text::{interval_text, signed_interval, signed_text};
use super::tables::{Comparison, Judgement, epochs_head, escape, joint};
use crate::base::csv::{csv_number, csv_text};
use crate::metrics::{Direction, Metric};
use crate::report::statistics::p_text;
use crate::report::{AxisValue, Record, Status, distinct, label};

/// The comparisons of one metric over scenes.
#[derive(Clone, Debug, PartialEq)]
pub struct OverScenes {
    /// The row that all others are compared with.
    pub baseline: String,
    /// Key of the metric.
    pub metric: String,
    /// The smallest gain that matters, in the metric's unit; `None` if the sweep states none.
    pub margin: Option<f64>,
    /// Names of the scenes.
    pub scenes: Vec<String>,
    /// Lowest and highest of how often a training pixel was seen; `None` if it is unknown.
    pub epochs: Option<(f64, f64)>,
    /// The other rows.
    pub rows: Vec<RowOverScenes>,
    /// As [`RowOverScenes::to_best`], of the baseline.
    pub baseline_to_best: Option<(f64, f64)>,
    /// As [`RowOverScenes::no_better_than_one_colour`], of the baseline.
    pub baseline_of_one_colour: Vec<Option<(usize, usize)>>,
}

/// One row's differences to the baseline.
#[derive(Clone, Debug, PartialEq)]
pub struct RowOverScenes {
    /// The row with its axis values.
    pub row: String,
    /// The differences of each scene, seed by seed, in the order of the scenes.
    pub seeds: Vec<Vec<f64>>,
    /// Mean over the scenes' means, with p values corrected over the rows. `None` if no scene has both rows.
    pub comparison: Option<Comparison>,
    /// Ends of the interval that holds with 95 % for all rows at once (Bonferroni).
    pub simultaneous: Option<(f64, f64)>,
    /// Scenes above and below the baseline.
    pub signs: Option<SignTest>,
    /// Hodges-Lehmann estimate and its 95 % interval.
    pub median: Option<(f64, Option<(f64, f64)>)>,
    /// Ends of the 95 % prediction interval of the same mean on one more scene.
    pub prediction: Option<(f64, f64)>,
    /// How many of each scene's seeds are no better than one colour; `None` where that was not measured.
    pub no_better_than_one_colour: Vec<Option<(usize, usize)>>,
    /// Standard deviations between scenes and, in them, between seeds.
    pub components: Option<Components>,
    /// Ends of the interval of the row's mean minus the best other row's, in the better direction, the baseline among them
    /// (Hsu's). `None` if a row lacks a point.
    pub to_best: Option<(f64, f64)>,
    /// Pairs of scene and seed, of all that any row has, in which the row or the baseline has no number.
    pub lacking: usize,
}

const HOW_TO_READ: [&str; 7] = [
    "a scene counts once: its difference is the mean over its seeds, paired by seed. The difference is the mean over scenes, \
     with its 95 % Student t interval; p is that of the t test over scenes, after Holm's correction over these rows. \
     Simultaneous intervals hold with 95 % for all rows at once (Bonferroni)",
    "not significant: the interval excludes 0, but p is not below 0.05 after the correction",
    "scenes up and down: how many are above and below the baseline, with the p value of the exact sign test, not corrected",
    "median: the Hodges-Lehmann estimate with its 95 % interval from Wilcoxon's distribution, not corrected",
    "a new scene: the 95 % prediction interval of the mean of as many seeds on one more scene of this kind, if differences \
     follow a normal distribution",
    "between, within: standard deviations between scenes and, in a scene, between seeds",
    "minus the best: simultaneous 95 % intervals of a row's mean minus the best other row's, in the better direction (Hsu's, \
     each pair with its own spread and Bonferroni's quantile)",
];

impl OverScenes {
    /// Compares each other row with `baseline` on all scenes of the records.
    pub fn new(baseline: &str, metric: &str, margin: Option<f64>, records: &[Record]) -> OverScenes {
        let scenes = distinct(records.iter().map(|record| record.scene.clone()));
        let others = records.iter().filter(|record| record.row != baseline);
        let places = distinct(others.map(|record| (record.row.as_str(), record.axes.as_slice())));
        let row = |place: (&str, &[AxisValue])| RowOverScenes::new(place, (baseline, metric), margin, &scenes, records);
        let mut over = OverScenes {
            baseline: baseline.into(),
            metric: metric.into(),
            margin,
            epochs: joint(records.iter().filter_map(Record::epochs).map(|own| (own, own))),
            rows: places.into_iter().map(row).collect(),
            baseline_of_one_colour: of_one_colour(&scenes, records, |record| record.row == baseline),
            scenes,
            baseline_to_best: None,
        };
        over.correct();
        over.find_best();
        over
    }

    fn correct(&mut self) {
        // Rows with the same numbers are one training under several names, and one test.
        let first = |i: usize| self.rows[..i].iter().position(|row| row.seeds == self.rows[i].seeds).unwrap_or(i);
        let firsts: Vec<usize> = (0..self.rows.len()).map(first).collect();
        let all = |p: fn(&Comparison) -> Option<f64>| -> Vec<Option<f64>> {
            let of = |(i, row): (usize, &RowOverScenes)| row.comparison.as_ref().filter(|_| firsts[i] == i).and_then(p);
            self.rows.iter().enumerate().map(of).collect()
        };
        let p = all(|comparison| comparison.p);
        let tests = p.iter().flatten().count();
        let (p, equivalence) = (holm(&p), holm(&all(|c| c.equivalence.and_then(|equivalence| equivalence.p))));
        for (row, &first) in self.rows.iter_mut().zip(&firsts) {
            let Some(comparison) = &mut row.comparison else { continue };
            comparison.p_holm = p[first];
            comparison.equivalence.iter_mut().for_each(|of| of.p_holm = equivalence[first]);
            row.simultaneous = comparison.interval.map(|ends| simultaneous(ends, comparison.pairs, tests));
        }
    }

    fn direction(&self) -> Option<Direction> {
        Some(Metric::find(&self.metric)?.direction)
    }

    fn find_best(&mut self) {
        let Some(sign) = self.direction().and_then(Direction::sign) else { return };
        // Rows that lack points would be ranked by other scenes or seeds than the rest.
        if self.rows.iter().any(|row| row.lacking > 0) {
            return;
        }
        let means = |row: &RowOverScenes| row.seeds.iter().map(|seeds| Some(sign * mean(seeds)?)).collect();
        let Some(mut rows) = self.rows.iter().map(means).collect::<Option<Vec<Vec<f64>>>>() else { return };
        rows.push(vec![0.0; self.scenes.len()]);
        let Some(mut ends) = to_best(&rows) else { return };
        self.baseline_to_best = ends.pop();
        self.rows.iter_mut().zip(ends).for_each(|(row, ends)| row.to_best = Some(ends));
    }

    /// Returns the rows, the best mean first, and those without a difference last.
    pub fn best_first(&self) -> Vec<&RowOverScenes> {
        let sign = self.direction().and_then(Direction::sign).unwrap_or(1.0);
        let gain = |row: &RowOverScenes| row.comparison.map_or(f64::NEG_INFINITY, |found| sign * found.difference);
        let mut rows: Vec<&RowOverScenes> = self.rows.iter().collect();
        rows.sort_by(|a, b| gain(b).total_cmp(&gain(a)));
        rows
    }

    /// Returns one line a row, with all digits.
    pub fn csv(&self) -> String {
        const HEAD: [&str; 31] = [
            "row",
            "baseline",
            "metric",
            "scenes",
            "seeds",
            "lacking",
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
            "matters",
            "ruled_out",
            "above",
            "below",
            "p_sign",
            "median",
            "median_low",
            "median_high",
            "between",
            "within",
            "new_scene_low",
            "new_scene_high",
            "to_best_low",
            "to_best_high",
        ];
        let rows = self.rows.iter().map(|row| self.csv_row(row));
        csv_text(std::iter::once(HEAD.map(String::from).to_vec()).chain(rows))
    }

    fn csv_row(&self, row: &RowOverScenes) -> Vec<String> {
        let found = row.comparison.as_ref();
        let number = |of: fn(&Comparison) -> Option<f64>| csv_number(found.and_then(of));
        let ends =
            |ends: Option<(f64, f64)>| [csv_number(ends.map(|ends| ends.0)), csv_number(ends.map(|ends| ends.1))];
        let flag = |flag: Option<bool>| flag.map_or(String::new(), |flag| flag.to_string());
        let equivalence = found.and_then(|comparison| comparison.equivalence);
        let mut cells = vec![row.row.clone(), self.baseline.clone(), self.metric.clone()];
        cells.push(found.map_or(0, |comparison| comparison.pairs).to_string());
        cells.push(row.seeds.iter().map(Vec::len).sum::<usize>().to_string());
        cells.push(row.lacking.to_string());
        cells.push(number(|comparison| Some(comparison.difference)));
        cells.extend(ends(found.and_then(|comparison| comparison.interval)));
        cells.extend([number(|comparison| comparison.p), number(|comparison| comparison.p_holm)]);
        cells.extend(ends(row.simultaneous));
        cells.push(found.and_then(Comparison::verdict).map_or(String::new(), |verdict| verdict.name().into()));
        cells.push(csv_number(self.margin));
        cells.push(csv_number(equivalence.and_then(|equivalence| equivalence.p)));
        cells.push(csv_number(equivalence.and_then(|equivalence| equivalence.p_holm)));
        cells.extend([flag(self.matters(row)), flag(self.is_ruled_out(row))]);
        let count =
            |of: fn(&SignTest) -> usize| row.signs.as_ref().map_or(String::new(), |signs| of(signs).to_string());
        cells.extend([count(|signs| signs.above), count(|signs| signs.below)]);
        cells.push(csv_number(row.signs.map(|signs| signs.p)));
        cells.push(csv_number(row.median.map(|median| median.0)));
        cells.extend(ends(row.median.and_then(|median| median.1)));
        cells.push(csv_number(row.components.map(|components| components.between)));
        cells.push(csv_number(row.components.map(|components| components.within)));
        cells.extend(ends(row.prediction));
        cells.extend(ends(row.to_best));
        cells
    }

    /// Returns one line for each scene and row, with all digits.
    pub fn scenes_csv(&self) -> String {
        const HEAD: [&str; 8] =
            ["scene", "row", "baseline", "metric", "seeds", "difference", "deviation", "no_better_than_one_colour"];
        let rows = self.rows.iter().flat_map(|row| {
            self.scenes.iter().zip(&row.seeds).zip(&row.no_better_than_one_colour).map(
                |((scene, seeds), of_one_colour)| {
                    let number = |number: Option<f64>| csv_number(number);
                    let mut cells = vec![scene.clone(), row.row.clone(), self.baseline.clone(), self.metric.clone()];
                    cells.extend([seeds.len().to_string(), number(mean(seeds)), number(standard_deviation(seeds))]);
                    cells.push(of_one_colour.map_or(String::new(), |(count, _)| count.to_string()));
                    cells
                },
            )
        });
        csv_text(std::iter::once(HEAD.map(String::from).to_vec()).chain(rows))
    }

    /// Returns the same for readers.
    pub fn markdown(&self) -> String {
        let mut text = format!(
            "**Rows against {} over {} scenes: {}**\n\n",
            escape(&self.baseline),
            self.scenes.len(),
            escape(&self.metric)
        );
        text += &epochs_head(self.epochs.into_iter());
        text += "| row | scenes | difference, 95 % interval | simultaneous interval | p (Holm) | said |\n";
        text += "|---|---:|---:|---:|---:|---|\n";
        text.extend(self.rows.iter().map(|row| self.row_text(row)));
        text +=
            "\n| row | scenes up, down, p | median, 95 % interval | a new scene | between, within | minus the best |\n";
        text += "|---|---:|---:|---:|---:|---:|\n";
        text.extend(self.rows.iter().map(|row| self.details_text(row)));
        text += &format!(
            "| {} |  |  |  |  | {} |\n",
            escape(&self.baseline),
            interval_text(&self.metric, self.baseline_to_best)
        );
        text += &self.scenes_text();
        text += &self.one_colour_notes();
        text.extend(HOW_TO_READ.iter().map(|note| format!("- {note}\n")));
        if let Some(margin) = self.margin {
            text += &format!(
                "- the sweep states a margin of {margin}: \"matters\" where all of the simultaneous interval is a gain above it, \
                 \"ruled out\" where all of it is below such a gain, \"equivalent\" by two one-sided t tests over scenes (Holm)\n"
            );
        }
        text
    }

    fn row_text(&self, row: &RowOverScenes) -> String {
        let mut cells = self.cells(row);
        cells[0] = escape(&cells[0]);
        format!("| {} |\n", cells.join(" | "))
    }

    /// Returns row, scenes, difference with its interval, simultaneous interval, Holm's p, and what is said.
    pub(super) fn cells(&self, row: &RowOverScenes) -> [String; 6] {
        let name = row.row.clone();
        let Some(comparison) = &row.comparison else {
            let [scenes, said] = ["0", "no scene has both rows"].map(String::from);
            return [name, scenes, String::new(), String::new(), String::new(), said];
        };
        [
            name,
            comparison.pairs.to_string(),
            signed_interval(&self.metric, comparison.difference, comparison.interval),
            interval_text(&self.metric, row.simultaneous),
            comparison.p_holm.map_or(String::new(), p_text),
            self.said(row, comparison.verdict().map_or(not_significant(comparison), |verdict| verdict.name())),
        ]
    }

    fn details_text(&self, row: &RowOverScenes) -> String {
        let unsigned = |value: f64| signed_text(&self.metric, value).trim_start_matches('+').to_string();
        format!(
            "| {} | {} | {} | {} | {} | {} |\n",
            escape(&row.row),
            row.signs.map_or(String::new(), |s| format!("{}, {}, {}", s.above, s.below, p_text(s.p))),
            row.median.map_or(String::new(), |(median, ends)| signed_interval(&self.metric, median, ends)),
            interval_text(&self.metric, row.prediction),
            row.components.map_or(String::new(), |c| format!("{}, {}", unsigned(c.between), unsigned(c.within))),
            interval_text(&self.metric, row.to_best)
        )
    }

    /// Returns where which rows are no better than one colour: with most seeds first.
    fn one_colour_notes(&self) -> String {
        let note = |start: &str, most: bool| {
            let rows = self.rows.iter().map(|row| (&row.row, &row.no_better_than_one_colour));
            let rows = rows.chain([(&self.baseline, &self.baseline_of_one_colour)]);
            let of_row = |(row, counts): (&String, &Vec<Option<(usize, usize)>>)| {
                let of_scene = |(scene, count): (&String, &Option<(usize, usize)>)| {
                    let (count, seeds) = count.filter(|(count, seeds)| *count > 0 && (2 * count > *seeds) == most)?;
                    Some(format!("{} with {count} of {seeds} seeds", escape(scene)))
                };
                let scenes: Vec<String> = self.scenes.iter().zip(counts).filter_map(of_scene).collect();
                (!scenes.is_empty()).then(|| format!("{} on {}", escape(row), scenes.join(", ")))
            };
            let rows: Vec<String> = rows.filter_map(of_row).collect();
            if rows.is_empty() { String::new() } else { format!("- {start}: {}\n", rows.join("; ")) }
        };
        note("NO BETTER THAN ONE COLOUR on held-out views", true)
            + &note("no better than one colour with at most half of the seeds", false)
    }

    /// Returns the differences, a line for each scene.
    fn scenes_text(&self) -> String {
        let head: Vec<String> = self.rows.iter().map(|row| escape(&row.row)).collect();
        let mut text = format!("\n| scene | {} |\n|---|{}\n", head.join(" | "), "---:|".repeat(head.len()));
        for (index, scene) in self.scenes.iter().enumerate() {
            let of = |row: &RowOverScenes| {
                mean(&row.seeds[index]).map_or(String::new(), |value| signed_text(&self.metric, value))
            };
            let cells: Vec<String> = self.rows.iter().map(of).collect();
            text += &format!("| {} | {} |\n", escape(scene), cells.join(" | "));
        }
        text + "\n"
    }

    /// Returns what is said of a row whose difference has a verdict of this name.
    fn said(&self, row: &RowOverScenes, verdict: &str) -> String {
        let mut words: Vec<String> = Some(verdict.to_string()).filter(|word| !word.is_empty()).into_iter().collect();
        if let Some(margin) = self.margin {
            let equivalent = row.comparison.is_some_and(|comparison| comparison.is_equivalent());
            words.extend((self.matters(row) == Some(true)).then(|| "matters".to_string()));
            words.extend((self.is_ruled_out(row) == Some(true)).then(|| format!("a gain of {margin} is ruled out")));
            words.extend(equivalent.then(|| format!("equivalent within {margin}")));
        }
        words.extend(
            (row.lacking > 0).then(|| format!("UNFINISHED: {} pairs of scene and seed lack a number", row.lacking)),
        );
        words.join(", ")
    }

    /// Returns the same for a figure, whose marks show where no difference is shown.
    pub(super) fn judged(&self, row: &RowOverScenes) -> String {
        let Some(comparison) = &row.comparison else { return "no scene has both rows".into() };
        self.said(row, Judgement::of(&self.metric, comparison).name())
    }

    /// Returns whether all of a row's simultaneous interval is a gain above the margin. `None` without a margin or an interval,
    /// or if the metric has no better direction.
    pub fn matters(&self, row: &RowOverScenes) -> Option<bool> {
        let (low, _) = self.direction()?.gains(row.simultaneous?)?;
        Some(low > self.margin?)
    }

    /// Returns whether all of a row's simultaneous interval is worse than a gain of the margin. `None` as for
    /// [`OverScenes::matters`].
    pub fn is_ruled_out(&self, row: &RowOverScenes) -> Option<bool> {
        let (_, high) = self.direction()?.gains(row.simultaneous?)?;
        Some(high < self.margin?)
    }
}

impl RowOverScenes {
    fn new(
        place: (&str, &[AxisValue]),
        (baseline, metric): (&str, &str),
        margin: Option<f64>,
        scenes: &[String],
        records: &[Record],
    ) -> RowOverScenes {
        // The baseline at the same axis values, or the one without.
        let at_same = (baseline, place.1);
        let baseline = if records.iter().any(|record| is_at(record, at_same)) { at_same } else { (baseline, &[][..]) };
        let of = |scene: &str, place: (&str, &[AxisValue])| -> Vec<(u64, f64)> {
            let own = records.iter().filter(|record| record.scene == scene && is_at(record, place));
            own.filter_map(|record| Some((record.seed?, value(record, metric)?))).collect()
        };
        let seeds: Vec<Vec<f64>> =
            scenes.iter().map(|scene| paired_differences(&of(scene, place), &of(scene, baseline))).collect();
        let means: Vec<f64> = seeds.iter().filter_map(|seeds| mean(seeds)).collect();
        let expected = distinct(records.iter().filter_map(|record| Some((&record.scene, record.seed?)))).len();
        RowOverScenes {
            row: label(place.0, place.1),
            comparison: Comparison::new(&means, margin),
            simultaneous: None,
            signs: sign_test(&means),
            median: hodges_lehmann(&means),
            prediction: prediction(&means),
            components: components(&seeds),
            to_best: None,
            no_better_than_one_colour: of_one_colour(scenes, records, |record| is_at(record, place)),
            lacking: expected - seeds.iter().map(Vec::len).sum::<usize>(),
            seeds,
        }
    }
}

fn is_at(record: &Record, (row, axes): (&str, &[AxisValue])) -> bool {
    record.row == row && record.axes == axes
}

/// Returns how many of a row's trainings on each scene are no better than one colour, and how many there are; `None` where that was measured of none.
fn of_one_colour(
    scenes: &[String],
    records: &[Record],
    is_of_row: impl Fn(&Record) -> bool,
) -> Vec<Option<(usize, usize)>> {
    let of = |scene: &String| {
        let own = records.iter().filter(|record| record.scene == *scene && is_of_row(record));
        let measured: Vec<bool> = own.filter_map(Record::is_no_better_than_one_colour).collect();
        let count = measured.iter().filter(|of_one_colour| **of_one_colour).count();
        (!measured.is_empty()).then_some((count, measured.len()))
    };
    scenes.iter().map(of).collect()
}

/// The verdict on a difference whose own interval excludes 0, and whose p is not significant after the correction.
fn not_significant(comparison: &Comparison) -> &'static str {
    if comparison.p_holm.is_some() { "not significant" } else { "" }
}

fn value(record: &Record, metric: &str) -> Option<f64> {
    record.metric(metric).filter(|value| value.is_finite() && record.status == Status::Done)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(scene: &str, row: &str, seed: u64, psnr: Option<f64>) -> Record {
        Record {
            id: format!("{scene}-{row}-{seed}"),
            scene: scene.into(),
            row: row.into(),
            axes: vec![],
            seed: Some(seed),
            status: if psnr.is_some() { Status::Done } else { Status::Waiting },
            reason: String::new(),
            metrics: vec![("psnr".into(), psnr)],
            protocol: vec![],
            inactive_levels: vec![],
        }
    }

    /// Four scenes, each with two seeds of its own level; TV gains, the attack loses.
    fn records() -> Vec<Record> {
        let mut records = Vec::new();
        for (index, scene) in ["a", "b", "c", "d"].into_iter().enumerate() {
            for seed in 0..2 {
                let (level, spread) = (20.0 + 3.0 * index as f64, 0.1 * index as f64 + 0.02 * seed as f64);
                records.push(record(scene, "NeRF", seed, Some(level)));
                records.push(record(scene, "TV", seed, Some(level + 1.0 + spread)));
                records.push(record(scene, "attack", seed, Some(level - 0.5 - spread)));
            }
        }
        records
    }

    fn over(records: &[Record]) -> OverScenes {
        OverScenes::new("NeRF", "psnr", Some(0.3), records)
    }

    #[test]
    fn seeds_that_learned_nothing_are_said() {
        let mut records = records();
        for record in &mut records {
            let lost = record.scene == "b" && (record.row == "NeRF" || (record.row == "TV" && record.seed == Some(1)));
            record.metrics.push(("floor_psnr".into(), Some(if lost { 40.0 } else { 5.0 })));
        }
        let found = over(&records);
        assert_eq!(found.rows[0].no_better_than_one_colour, [Some((0, 2)), Some((1, 2)), Some((0, 2)), Some((0, 2))]);
        let note = "- NO BETTER THAN ONE COLOUR on held-out views: NeRF on b with 2 of 2 seeds\n- no better than one colour with \
                    at most half of the seeds: TV on b with 1 of 2 seeds\n";
        assert!(found.markdown().contains(note), "{}", found.markdown());
        assert!(found.scenes_csv().lines().any(|line| line.starts_with("b,TV,") && line.ends_with(",1")));
        let unmeasured = over(&self::records());
        assert!(!unmeasured.markdown().contains("ONE COLOUR"));
        assert!(unmeasured.scenes_csv().lines().any(|line| line.starts_with("b,TV,") && line.ends_with(',')));
    }

    #[test]
    fn the_best_row_comes_first() {
        let mut found = over(&records());
        let names = |found: &OverScenes| found.best_first().iter().map(|row| row.row.clone()).collect::<Vec<String>>();
        assert_eq!(names(&found), ["TV", "attack"]);
        found.metric = "lpips_vgg".into();
        assert_eq!(names(&found), ["attack", "TV"]);
        found.rows[1].comparison = None;
        assert_eq!(names(&found), ["TV", "attack"]);
    }

    #[test]
    fn a_scene_counts_once() {
        let all = records();
        let found = over(&all);
        let tv = &found.rows[0];
        let comparison = tv.comparison.unwrap();
        assert_eq!(comparison.pairs, 4);
        assert!((comparison.difference - 1.16).abs() < 1e-12, "{comparison:?}");
        // A third seed of one scene, equal to the mean of its others, changes no mean.
        let third = |row: &str, from: f64| record("b", row, 7, Some(23.0 + from));
        let more = [all, vec![third("NeRF", 0.0), third("TV", 1.11), third("attack", -0.61)]].concat();
        let again = over(&more).rows[0].comparison.unwrap();
        assert!((again.difference - comparison.difference).abs() < 1e-12);
        assert_eq!(again.pairs, 4);
        // The same training under another name is no further test.
        let twin = records().into_iter().filter(|record| record.row == "TV");
        let twin = twin.map(|record| Record { row: "TV again".into(), ..record });
        let with_twin = over(&records().into_iter().chain(twin).collect::<Vec<Record>>());
        let p = |row: &RowOverScenes| row.comparison.unwrap().p_holm;
        assert_eq!((p(&with_twin.rows[0]), p(&with_twin.rows[2])), (p(tv), p(tv)));
    }

    #[test]
    fn where_less_is_better_the_best_has_the_least() {
        let as_lpips = |record: Record| Record {
            metrics: vec![("lpips_squeeze".into(), record.metric("psnr").map(|psnr| psnr / 100.0))],
            ..record
        };
        let records: Vec<Record> = records().into_iter().map(as_lpips).collect();
        let found = OverScenes::new("NeRF", "lpips_squeeze", Some(0.003), &records);
        let [tv, attack] = &found.rows[..] else { panic!("two rows") };
        // The attack has the least.
        assert_eq!((attack.to_best.unwrap().0, tv.to_best.unwrap().1), (0.0, 0.0));
        assert_eq!((found.matters(attack), found.is_ruled_out(tv)), (Some(true), Some(true)));
    }

    #[test]
    fn a_baseline_with_axes_is_that_of_the_same_values() {
        let axes = |value: &str| vec![AxisValue { axis: "steps".into(), panel: String::new(), value: value.into() }];
        let of = |value: &str, more: f64| -> Vec<Record> {
            let raised = |mut record: Record| {
                let psnr = record.metric("psnr").map(|psnr| psnr + if record.row == "NeRF" { more } else { 0.0 });
                record.metrics = vec![("psnr".into(), psnr)];
                Record { axes: axes(value), ..record }
            };
            records().into_iter().map(raised).collect()
        };
        let found = over(&[of("10", 0.0), of("20", 0.5)].concat());
        let labels: Vec<&str> = found.rows.iter().map(|row| row.row.as_str()).collect();
        assert_eq!(labels, ["TV, steps = 10", "attack, steps = 10", "TV, steps = 20", "attack, steps = 20"]);
        let of = |row: usize| found.rows[row].comparison.unwrap().difference;
        assert!((of(0) - of(2) - 0.5).abs() < 1e-12, "{} {}", of(0), of(2));
    }

    #[test]
    fn words_follow_the_rule() {
        let found = over(&records());
        let [tv, attack] = &found.rows[..] else { panic!("two rows") };
        assert_eq!((found.matters(tv), found.is_ruled_out(tv)), (Some(true), Some(false)));
        assert_eq!((found.matters(attack), found.is_ruled_out(attack)), (Some(false), Some(true)));
        // Holm: the smaller p is doubled.
        let p: Vec<_> = [tv, attack].map(|row| row.comparison.unwrap()).into();
        assert_eq!(p[0].p_holm, Some(2.0 * p[0].p.unwrap().min(p[1].p.unwrap())));
        let text = found.markdown();
        assert!(text.contains("| TV | 4 | +1.16 [") && text.contains("higher, matters |"), "{text}");
        assert!(
            text.contains("lower, a gain of 0.3 is ruled out |") && text.contains("| d | +1.31 | -0.81 |"),
            "{text}"
        );
        // TV is the best, the others are not.
        assert_eq!((tv.to_best.unwrap().0, found.baseline_to_best.unwrap().1), (0.0, 0.0));
        assert_eq!(attack.to_best.unwrap().1, 0.0);
    }

    #[test]
    fn a_missing_scene_is_said_and_ranks_nothing() {
        let mut records = records();
        for record in records.iter_mut().filter(|record| record.scene == "d" && record.row == "TV") {
            *record = self::record("d", "TV", record.seed.unwrap(), None);
        }
        let found = over(&records);
        assert_eq!((found.rows[0].lacking, found.rows[0].comparison.unwrap().pairs), (2, 3));
        assert_eq!((found.rows[0].to_best, found.baseline_to_best), (None, None));
        let text = found.markdown();
        assert!(
            text.contains("UNFINISHED: 2 pairs of scene and seed lack a number") && text.contains("| d |  | -0.81 |"),
            "{text}"
        );
        let csv = found.scenes_csv();
        assert!(csv.contains("d,TV,NeRF,psnr,0,,"), "{csv}");
    }
}
