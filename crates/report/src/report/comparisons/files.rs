//! Comparisons as CSV with all digits, and as Markdown for readers.

use super::{Compared, Comparisons, OverScenes, Unit};
use crate::base::csv::{csv_number, csv_of_named};
use crate::report::distinct;
use crate::report::statistics::p_text;
use crate::report::tables::text::{interval_text, signed_interval, signed_text};
use crate::report::tables::{cell_text, epochs_head, escape};

/// A line of a CSV file: each cell with its column.
type Cells = Vec<(&'static str, String)>;

/// How details over scenes are read.
const HOW_TO_READ: [&str; 5] = [
    "scenes up and down: how many are above and below the baseline, with the p value of the exact sign test, not corrected",
    "median: the Hodges-Lehmann estimate with its 95 % interval from Wilcoxon's distribution, not corrected",
    "a new scene: the 95 % prediction interval of the mean of as many seeds on one more scene of this kind, if differences \
     follow a normal distribution",
    "between, within: standard deviations between scenes and, in a scene, between seeds",
    "minus the best: simultaneous 95 % intervals of a row's mean minus the best other row's, in the better direction (Hsu's, \
     each pair with its own spread and Bonferroni's quantile)",
];

impl Comparisons {
    /// Returns one CSV line for each comparison.
    pub fn csv(&self) -> String {
        csv_of_named(self.lines.iter().map(|line| self.csv_cells(line)))
    }

    fn csv_cells(&self, line: &Compared) -> Cells {
        let flag = |flag: Option<bool>| flag.map_or(String::new(), |flag| flag.to_string());
        let cell = |name| (name, line.comparison.map_or(String::new(), |found| cell_text(&found.cell(name))));
        let mut cells = line.place.clone();
        cells.extend(["difference", "low", "high", "p", "p_holm", "simultaneous_low", "simultaneous_high"].map(cell));
        cells.extend(["verdict", "margin", "p_equivalence", "p_equivalence_holm"].map(cell));
        cells.push(match self.unit {
            Unit::Sweep => cell("equivalent"),
            Unit::Scene => ("matters", flag(self.matters(line))),
        });
        cells.push(("ruled_out", flag(self.is_ruled_out(line))));
        cells.extend(line.over.iter().flat_map(OverScenes::csv_cells));
        cells
    }

    /// Returns one CSV line for each scene and row.
    pub fn scenes_csv(&self) -> String {
        let of_row = |line: &Compared| -> Vec<Cells> {
            let Some(over) = &line.over else { return Vec::new() };
            let cells = |(index, scene): (usize, &String)| {
                let (unit, of_one_colour) = (over.units[index], over.no_better_than_one_colour[index]);
                let mut cells = vec![("scene", scene.clone())];
                cells.extend(line.place[..3].iter().cloned());
                cells.push(("seeds", unit.map_or(0, |unit| unit.count).to_string()));
                cells.push(("difference", csv_number(unit.map(|unit| unit.mean))));
                cells.push(("deviation", csv_number(unit.and_then(|unit| unit.deviation))));
                let count = of_one_colour.map_or(String::new(), |(count, _)| count.to_string());
                cells.push(("no_better_than_one_colour", count));
                cells
            };
            self.scenes.iter().enumerate().map(cells).collect()
        };
        csv_of_named(self.lines.iter().flat_map(of_row))
    }

    /// Returns the comparisons for readers.
    pub fn markdown(&self) -> String {
        let (line, observation) = match self.unit {
            Unit::Sweep => ("block", "seeds"),
            Unit::Scene => ("row", "scenes"),
        };
        let mut text = format!("**{}: {}**\n\n", escape(&self.title()), escape(&self.metric));
        text += &epochs_head(self.epochs.into_iter());
        text += &format!(
            "| {line} | {observation} | difference, 95 % interval | simultaneous interval | p (Holm) | said |\n\
             |---|---:|---:|---:|---:|---|\n"
        );
        text.extend(self.lines.iter().map(|line| self.row_text(line)));
        text += "\n";
        if self.unit == Unit::Scene {
            text += &(self.details_text() + &self.scenes_text() + &self.one_colour_notes());
        }
        text + &self.notes(line, observation)
    }

    fn row_text(&self, line: &Compared) -> String {
        let [name, count, difference, simultaneous, p, said] = self.cells(line);
        row(&[escape(&name), count, difference, simultaneous, p, escape(&said)])
    }

    /// Returns name, number of observations, difference with its interval, simultaneous interval, Holm's p, and what is said.
    pub(in crate::report) fn cells(&self, line: &Compared) -> [String; 6] {
        let (name, said) = (line.name.clone(), self.verdict(line));
        let Some(comparison) = &line.comparison else {
            return [name, "0".into(), String::new(), String::new(), String::new(), said];
        };
        [
            name,
            comparison.pairs.to_string(),
            signed_interval(&self.metric, comparison.difference, comparison.interval),
            interval_text(&self.metric, comparison.simultaneous),
            comparison.p_holm.map_or(String::new(), p_text),
            said,
        ]
    }

    fn notes(&self, line: &str, observation: &str) -> String {
        let mut notes = Vec::new();
        if self.unit == Unit::Scene {
            notes.push("a scene counts once: its difference is the mean over its seeds, paired by seed".to_string());
        }
        notes.push(format!(
            "the difference is the mean over {observation}, with its 95 % Student t interval; p is that of the paired t test over \
             {observation}, after Holm's correction over these comparisons, one a {line}; the simultaneous intervals hold with \
             95 % for all of them at once (Bonferroni), which is stricter than Holm's p: \"higher\" and \"lower\" go by p"
        ));
        notes.push("not significant: the interval excludes 0, but p is not below 0.05 after the correction".into());
        if self.unit == Unit::Scene {
            notes.extend(HOW_TO_READ.map(String::from));
        }
        let margins = distinct(self.lines.iter().filter_map(Compared::margin));
        if !margins.is_empty() {
            let margins: Vec<String> = margins.iter().map(f64::to_string).collect();
            let matters = match self.unit {
                Unit::Sweep => "",
                Unit::Scene => "\"matters\" where all of the simultaneous interval is a gain above it, ",
            };
            notes.push(format!(
                "the stated margin is {}: {matters}\"ruled out\" where all of the simultaneous interval is below such a gain, \
                 \"equivalent\" by two one-sided t tests over {observation} (Holm)",
                margins.join(" or ")
            ));
        }
        notes.iter().map(|note| format!("- {note}\n")).collect()
    }

    fn details_text(&self) -> String {
        let mut text =
            "| row | scenes up, down, p | median, 95 % interval | a new scene | between, within | minus the best |\n\
                        |---|---:|---:|---:|---:|---:|\n"
                .to_string();
        let unsigned = |value: f64| signed_text(&self.metric, value).trim_start_matches('+').to_string();
        let best = |ends| interval_text(&self.metric, ends);
        let details = |line: &Compared| {
            let over = line.over.as_ref()?;
            Some(row(&[
                escape(&line.name),
                over.signs.map_or(String::new(), |s| format!("{}, {}, {}", s.above, s.below, p_text(s.p))),
                over.median.map_or(String::new(), |(median, ends)| signed_interval(&self.metric, median, ends)),
                interval_text(&self.metric, over.prediction),
                over.components.map_or(String::new(), |c| format!("{}, {}", unsigned(c.between), unsigned(c.within))),
                best(over.to_best),
            ]))
        };
        text.extend(self.lines.iter().filter_map(details));
        text + &format!("| {} |  |  |  |  | {} |\n\n", escape(&self.baseline), best(self.baseline_to_best))
    }

    /// Returns the differences, a line for each scene.
    fn scenes_text(&self) -> String {
        let heads: Vec<String> = self.lines.iter().map(|line| escape(&line.name)).collect();
        let mut text = format!("| scene | {} |\n|---|{}\n", heads.join(" | "), "---:|".repeat(heads.len()));
        for (index, scene) in self.scenes.iter().enumerate() {
            let of = |line: &Compared| {
                line.units()[index].map_or(String::new(), |unit| signed_text(&self.metric, unit.mean))
            };
            let cells: Vec<String> = std::iter::once(escape(scene)).chain(self.lines.iter().map(of)).collect();
            text += &row(&cells);
        }
        text + "\n"
    }

    /// Returns where which rows are no better than one colour: with most seeds first.
    fn one_colour_notes(&self) -> String {
        let note = |start: &str, most: bool| {
            let rows =
                self.lines.iter().filter_map(|line| Some((&line.name, &line.over.as_ref()?.no_better_than_one_colour)));
            let of_row = |(name, counts): (&String, &Vec<Option<(usize, usize)>>)| {
                let of_scene = |(scene, count): (&String, &Option<(usize, usize)>)| {
                    let (count, seeds) = count.filter(|(count, seeds)| *count > 0 && (2 * count > *seeds) == most)?;
                    Some(format!("{} with {count} of {seeds} seeds", escape(scene)))
                };
                let scenes: Vec<String> = self.scenes.iter().zip(counts).filter_map(of_scene).collect();
                (!scenes.is_empty()).then(|| format!("{} on {}", escape(name), scenes.join(", ")))
            };
            let rows = rows.chain([(&self.baseline, &self.baseline_of_one_colour)]);
            let rows: Vec<String> = rows.filter_map(of_row).collect();
            if rows.is_empty() { String::new() } else { format!("- {start}: {}\n", rows.join("; ")) }
        };
        note("NO BETTER THAN ONE COLOUR on held-out views", true)
            + &note("no better than one colour with at most half of the seeds", false)
    }
}

impl OverScenes {
    fn csv_cells(&self) -> Cells {
        let number = |name, number: Option<f64>| (name, csv_number(number));
        let count = |name, count: Option<usize>| (name, count.map_or(String::new(), |count| count.to_string()));
        let mut cells = vec![
            count("above", self.signs.map(|signs| signs.above)),
            count("below", self.signs.map(|signs| signs.below)),
            number("p_sign", self.signs.map(|signs| signs.p)),
            number("median", self.median.map(|median| median.0)),
        ];
        cells.extend(ends(["median_low", "median_high"], self.median.and_then(|median| median.1)));
        cells.push(number("between", self.components.map(|components| components.between)));
        cells.push(number("within", self.components.map(|components| components.within)));
        cells.extend(ends(["new_scene_low", "new_scene_high"], self.prediction));
        cells.extend(ends(["to_best_low", "to_best_high"], self.to_best));
        cells
    }
}

fn ends(names: [&'static str; 2], ends: Option<(f64, f64)>) -> [(&'static str, String); 2] {
    let [low, high] = names;
    [(low, csv_number(ends.map(|ends| ends.0))), (high, csv_number(ends.map(|ends| ends.1)))]
}

fn row(cells: &[String]) -> String {
    format!("| {} |\n", cells.join(" | "))
}
