//! Where quoted numbers are looked up: the tables of a results' folder, and a small language that names their cells.
//!
//! ```text
//! EXPRESSION = ["-"] TERM [("/" | "-") TERM]
//! TERM       = COLUMN["@"SEED{"+"SEED}] ["of" ROW] ["on" SCENE]
//! CONDITION  = TERM ("is" | "is not") TEXT | EXPRESSION ("<" | ">") NUMBER
//! ```

use std::path::Path;

use super::across::Comparison;
use super::files::Collected;
use crate::base::csv::{column_names, plain_cell};
use crate::base::{Error, Result};
use crate::outputs::optional;
use crate::report::tables::add_repeated;

/// The tables of a results' folder.
pub struct Cells {
    /// The folder's name.
    pub name: String,
    /// `table.csv` with the columns of `attack.csv`, or `summary.csv` of single runs: a line a row.
    rows: Vec<Row>,
    /// `points.csv` with the columns of `timing.csv`: a line a point.
    points: Vec<Row>,
}

/// A line: what it is of, and its cells by their columns.
struct Row {
    label: String,
    scene: String,
    seed: String,
    cells: Vec<(String, String)>,
}

impl Row {
    fn cell(&self, column: &str) -> Option<&str> {
        self.cells.iter().find(|(name, _)| name == column).map(|(_, text)| text.as_str())
    }
}

impl Cells {
    /// Of a sweep: its tables as its points make them, whatever stands in the folder.
    pub fn of_sweep(sweep: &Collected) -> Result<Cells> {
        let mut cells = Cells::of_tables(&sweep.archive.path, |name| sweep.text(name))?;
        let constants = sweep.archive.outputs.constants();
        for row in cells.rows.iter_mut().chain(&mut cells.points) {
            row.cells.extend(constants.iter().cloned());
            add_repeated(&mut row.cells);
        }
        Ok(cells)
    }

    /// Of tables by their names.
    pub(super) fn of_tables(folder: &Path, text: impl Fn(&str) -> Result<Vec<u8>>) -> Result<Cells> {
        let rows = |name: &str| csv_rows(&folder.join(name), &text(name)?);
        let table =
            joined(rows("table.csv")?, &rows("attack.csv")?, |a, b| (&a.label, &a.scene) == (&b.label, &b.scene));
        let points = joined(rows("points.csv")?, &rows("timing.csv")?, |a, b| a.cell("id") == b.cell("id"));
        Ok(Cells { name: name(folder), rows: table, points })
    }

    /// Of a folder of single runs: its summary, or their means.
    pub fn of_runs(folder: &Path) -> Result<Cells> {
        let summary = folder.join("summary.csv");
        let mut rows = csv_rows(&summary, &optional(&summary)?.unwrap_or_default())?;
        if rows.is_empty() {
            let row = |(label, cells)| Row { label, scene: String::new(), seed: String::new(), cells };
            rows.extend(super::runs::means(folder)?.into_iter().map(row));
        }
        Ok(Cells { name: name(folder), rows, points: Vec::new() })
    }

    /// Of a comparison: a line a block, by the sweep's name, or a line a row and one a row and scene.
    pub fn of_comparison(comparison: &Comparison) -> Result<Cells> {
        let path = &comparison.path;
        let tables = comparison.tables().map(|(name, bytes)| csv_rows(&path.join(name), bytes));
        let rows = tables.collect::<Result<Vec<_>>>()?.into_iter().flatten().collect();
        Ok(Cells { name: name(path), rows, points: Vec::new() })
    }

    /// What an expression comes to; `row` stands where it names none. None: the cell is empty.
    pub fn value(&self, expression: &str, row: Option<&str>) -> std::result::Result<Option<f64>, String> {
        let (negative, expression) = match expression.trim().strip_prefix('-') {
            Some(rest) => (true, rest.trim()),
            None => (false, expression.trim()),
        };
        let operator = [" / ", " - "].into_iter().find_map(|op| Some((op, expression.split_once(op)?)));
        let value = match operator {
            None => self.term(expression, row)?,
            Some((operator, (left, right))) => {
                let both = self.term(left, row)?.zip(self.term(right, row)?);
                both.map(|(left, right)| if operator == " / " { left / right } else { left - right })
            }
        };
        Ok(value.map(|value| if negative { -value } else { value }))
    }

    /// Whether a condition holds, and if not, what the cell is.
    pub fn holds(&self, condition: &str) -> std::result::Result<(), String> {
        let operators = [" is not ", " is ", " < ", " > "];
        let found = operators.into_iter().find_map(|op| Some((op, condition.rsplit_once(op)?)));
        let Some((operator, (left, right))) = found else {
            return Err(format!(
                "'{condition}' is no condition; write COLUMN of ROW is TEXT, is not TEXT, < NUMBER or > NUMBER"
            ));
        };
        let (holds, cell) = if operator.contains("is") {
            let cell = self.text(left)?;
            ((cell == right) == (operator == " is "), cell.to_string())
        } else {
            let bound: f64 = right.parse().map_err(|_| format!("'{right}' is no number"))?;
            let value = self.value(left, None)?.ok_or_else(|| format!("{} has no {left}", self.name))?;
            (if operator == " < " { value < bound } else { value > bound }, value.to_string())
        };
        if holds { Ok(()) } else { Err(format!("{left} is '{cell}' in {}, not{operator}{right}", self.name)) }
    }

    /// The text of a cell, which may be empty.
    fn text(&self, term: &str) -> std::result::Result<&str, String> {
        let (column, place) = term.trim().split_once(" of ").unwrap_or((term.trim(), ""));
        let (column, seed) = column.split_once('@').unwrap_or((column, ""));
        let (line, _) = self.line(place, seed)?;
        line.cell(column).ok_or_else(|| format!("{} has no column '{column}'", self.name))
    }

    /// The mean over the seeds that it names.
    fn term(&self, term: &str, row: Option<&str>) -> std::result::Result<Option<f64>, String> {
        let (column, place) = term.trim().split_once(" of ").unwrap_or((term.trim(), row.unwrap_or_default()));
        let (column, seeds) = column.split_once('@').unwrap_or((column, ""));
        let (mut sum, mut count) = (0.0, 0);
        for seed in seeds.split('+') {
            let Some(value) = self.number(column, place, seed)? else { return Ok(None) };
            sum += value;
            count += 1;
        }
        Ok(Some(sum / f64::from(count)))
    }

    fn number(&self, column: &str, place: &str, seed: &str) -> std::result::Result<Option<f64>, String> {
        let (line, what) = self.line(place, seed)?;
        let cell = line.cell(column).ok_or_else(|| format!("{} has no column '{column}'", self.name))?;
        if cell.is_empty() {
            return Ok(None);
        }
        cell.parse().map(Some).map_err(|_| format!("{column} of {what} in {} is '{cell}', no number", self.name))
    }

    /// The one line of a row, or with a seed of a point, and what it is called.
    fn line(&self, place: &str, seed: &str) -> std::result::Result<(&Row, String), String> {
        let lines = if seed.is_empty() { &self.rows } else { &self.points };
        // A row's own name may have the word: "NeRF on a hash grid".
        let is_row = lines.iter().any(|line| line.label == place);
        let (label, scene) = if is_row { (place, "") } else { place.rsplit_once(" on ").unwrap_or((place, "")) };
        let fits = |row: &&Row| {
            row.label == label && (scene.is_empty() || row.scene == scene) && (seed.is_empty() || row.seed == seed)
        };
        // A line over all scenes is meant where no scene is named.
        let is_over_all = scene.is_empty() && lines.iter().any(|line| fits(&line) && line.scene.is_empty());
        let mut found = lines.iter().filter(fits).filter(|line| !is_over_all || line.scene.is_empty());
        let what = format!("'{label}'{}", if seed.is_empty() { String::new() } else { format!(" with seed {seed}") });
        let line = found.next().ok_or_else(|| format!("{} has no row {what}", self.name))?;
        if found.next().is_some() {
            return Err(format!("{} has several rows {what}: name the scene (`on SCENE`)", self.name));
        }
        Ok((line, what))
    }
}

fn name(folder: &Path) -> String {
    folder.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Rows with the columns of a further table, empty where that has no such row.
fn joined(mut rows: Vec<Row>, further: &[Row], is_same: impl Fn(&Row, &Row) -> bool) -> Vec<Row> {
    let columns = further.first().map_or(&[][..], |row| &row.cells);
    for row in &mut rows {
        let same = further.iter().find(|other| is_same(row, other));
        for (column, _) in columns {
            if row.cell(column).is_none() {
                let cell = same.and_then(|other| other.cell(column)).unwrap_or_default().to_string();
                row.cells.push((column.clone(), cell));
            }
        }
    }
    rows
}

fn csv_rows(path: &Path, bytes: &[u8]) -> Result<Vec<Row>> {
    let bad = |e: String| Error::Data(format!("{}: {e}", path.display()));
    let mut reader = csv::Reader::from_reader(bytes);
    let head = column_names(&mut reader).map_err(bad)?;
    let rows = reader.records().map(|record| {
        let record = record.map_err(|e| bad(e.to_string()))?;
        let cells: Vec<(String, String)> =
            head.iter().zip(&record).map(|(name, cell)| (name.to_string(), plain_cell(cell).to_string())).collect();
        let cell = |name: &str| {
            cells.iter().find(|(known, _)| known == name).map(|(_, text)| text.clone()).unwrap_or_default()
        };
        let name = ["row", "run", "sweep"].map(cell).into_iter().find(|name| !name.is_empty()).unwrap_or_default();
        let axes = cell("axes");
        let label = if axes.is_empty() { name } else { format!("{name}, {axes}") };
        Ok(Row { label, scene: cell("scene"), seed: cell("seed"), cells })
    });
    rows.collect()
}

/// Of the smallest number, all digits.
const MOST_DECIMALS: usize = 1074;

/// Numbers in words. A fraction is quoted for the value that it is nearest to.
const IN_WORDS: [(&str, f64); 16] = [
    ("a tenth", 0.1),
    ("a fifth", 0.2),
    ("a quarter", 0.25),
    ("a third", 1.0 / 3.0),
    ("half", 0.5),
    ("two thirds", 2.0 / 3.0),
    ("three quarters", 0.75),
    ("one", 1.0),
    ("two", 2.0),
    ("twice", 2.0),
    ("three", 3.0),
    ("four", 4.0),
    ("five", 5.0),
    ("six", 6.0),
    ("seven", 7.0),
    ("eight", 8.0),
];

/// Whether a number as it is quoted is this one, to the digits that are quoted: `-0.10`, `+1.95`, `8,657`, `4.1e5`, `-9 %`, or in
/// words: `a third`, `seven`.
pub fn is_quoted_as(value: f64, quoted: &str) -> std::result::Result<bool, String> {
    if let Some((_, meant)) = IN_WORDS.iter().find(|(word, _)| *word == quoted) {
        let distance = |number: f64| (number / value).ln().abs();
        return Ok(value > 0.0 && IN_WORDS.iter().all(|(_, other)| distance(*meant) <= distance(*other)));
    }
    let (text, value) = match quoted.strip_suffix('%') {
        Some(text) => (text.trim_end(), value * 100.0),
        None => (quoted, value),
    };
    let text = text.replace(',', "");
    let digits = text.trim_start_matches(['+', '-']);
    let (mantissa, is_scientific) = digits.split_once(['e', 'E']).map_or((digits, false), |(m, _)| (m, true));
    let parsed: f64 = text.parse().map_err(|_| format!("'{quoted}' is no number"))?;
    let decimals = mantissa.split_once('.').map_or(0, |(_, decimals)| decimals.len());
    if decimals > MOST_DECIMALS {
        return Err(format!("'{quoted}' has {decimals} decimals, a number has at most {MOST_DECIMALS}"));
    }
    let rounded = if is_scientific { format!("{value:.decimals$e}") } else { format!("{value:.decimals$}") };
    let rounded: f64 = rounded.parse().expect("printed");
    Ok(rounded == parsed)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::{Cells, csv_rows, is_quoted_as};

    #[test]
    fn a_row_is_named_with_its_scene_or_has_the_word_in_its_own_name() {
        let csv = "row,scene,psnr_mean\nNeRF,chair,23.3\nNeRF,fern,19.2\nNeRF on a hash grid,chair,29.8\nNeRF on a hash grid,fern,21.0\n\
                   NV on a grid,chair,22.8\n";
        let rows = csv_rows(Path::new("table.csv"), csv.as_bytes()).unwrap();
        let cells = Cells { name: "grids".into(), rows, points: Vec::new() };
        let value = |place: &str| cells.value(&format!("psnr_mean of {place}"), None);
        assert_eq!(value("NeRF on chair"), Ok(Some(23.3)));
        assert_eq!(value("NeRF on a hash grid on fern"), Ok(Some(21.0)));
        assert_eq!(value("NV on a grid"), Ok(Some(22.8)));
        assert!(value("NeRF on a hash grid").unwrap_err().contains("several rows"));
        assert!(value("NeRF on drums").unwrap_err().contains("no row 'NeRF'"));
    }

    #[test]
    fn seconds_and_verdicts_are_cells_too() {
        let of = |name: &str| match name {
            "table.csv" => "row,scene,psnr_verdict,psnr_p\nNeRF,fern,,\nTV,fern,higher,0.006\n",
            "points.csv" => "id,row,scene,seed\na,NeRF,fern,1\nb,NeRF,fern,2\nc,TV,fern,1\nd,TV,fern,2\n",
            "timing.csv" => "id,point,seconds_training\na,,10\nb,,20\nc,,30\nd,,60\n",
            _ => "",
        };
        let cells = Cells::of_tables(Path::new("x"), |name| Ok(of(name).into())).unwrap();
        assert_eq!(cells.value("seconds_training@1+2 of TV / seconds_training@1+2 of NeRF", None), Ok(Some(3.0)));
        assert_eq!(cells.value("seconds_training@2 of NeRF", None), Ok(Some(20.0)));
        for holds in ["psnr_verdict of TV is higher", "psnr_verdict of NeRF is not higher", "psnr_p of TV < 0.05"] {
            assert_eq!(cells.holds(holds), Ok(()), "{holds}");
        }
        for (wrong, why) in [
            ("psnr_verdict of NeRF is higher", "is '' in x, not is higher"),
            ("psnr_p of TV > 0.05", "is '0.006' in x, not > 0.05"),
            ("psnr_p of NeRF > 0.05", "x has no psnr_p of NeRF"),
            ("psnr_verdict of Aug is higher", "no row 'Aug'"),
            ("psnr_verdict of TV", "is no condition"),
        ] {
            let said = cells.holds(wrong).unwrap_err();
            assert!(said.contains(why), "{wrong}: {said}");
        }
    }

    #[test]
    fn numbers_are_compared_to_the_digits_that_are_quoted() {
        let is = |value, quoted| is_quoted_as(value, quoted).unwrap();
        assert!(is(0.1264, "0.13") && is(0.1264, "+0.13") && !is(0.1264, "0.12") && !is(0.1264, "-0.13"));
        assert!(is(-0.003, "-0.00") && is(-0.003, "0.00") && is(8657.0, "8,657") && !is(8657.4, "8,658"));
        assert!(is(413_275.0, "4.13e5") && !is(413_275.0, "4.14e5"));
        assert!(is(-0.0904, "-9 %") && !is(-0.0904, "-9.1 %"));
        assert!(is(0.326, "a third") && is(0.3, "a third") && !is(0.163, "a third") && !is(0.65, "a third"));
        assert!(is(7.34, "seven") && !is(3.67, "seven") && is(2.1, "twice") && !is(-2.0, "twice"));
        assert!(is_quoted_as(1.0, "many").is_err());
        assert!(is_quoted_as(0.1, &format!("0.{}", "1".repeat(100_000))).unwrap_err().contains("100000 decimals"));
    }
}
