//! Figures of a sweep from hand-made points.

use crate::common::assert_says;
use augnerf::base::rng::{Random, Stream};
use augnerf::report::exporters::{Comparable, Points};
use augnerf::report::plots::{Curve, Figure, Style, axes_figure, curves_figure, rows_figure};
use augnerf::report::tables::Table;
use augnerf::report::{AxisValue, Record, RowSpec, Status, TableSpec};

const ROWS: [&str; 14] = [
    "NeRF",
    "+ l1 Reg.",
    "+ Lap. Reg.",
    "+ TV Reg.",
    "+ Random Aug.",
    "+ Input Aug.",
    "+ Feature Aug.",
    "+ Feature & (Pre-) Output Aug.",
    "+ Tri-level Random Noise",
    "Aug-NeRF",
    "+ Output Aug.",
    "Aug-NeRF calibrated",
    "NeRF + second clean pass",
    "NeRF, equal seconds",
];

fn spec(rows: &[&str]) -> TableSpec {
    let row = |(i, name): (usize, &&str)| RowSpec {
        name: name.to_string(),
        baseline: (i > 0).then(|| rows[0].to_string()),
        ..RowSpec::default()
    };
    TableSpec {
        name: "test".into(),
        title: "Ablation of the three levels (paper, table 4)".into(),
        metrics: vec!["psnr".into()],
        rows: rows.iter().enumerate().map(row).collect(),
        ..TableSpec::default()
    }
}

/// The value of an attribute of an element's line.
fn attribute<'a>(line: &'a str, name: &str) -> &'a str {
    line.split(&format!(" {name}=\"")).nth(1).and_then(|rest| rest.split('"').next()).unwrap_or_default()
}

fn number(line: &str, name: &str) -> f64 {
    attribute(line, name).parse().unwrap_or_else(|_| panic!("{name} of {line}"))
}

/// The texts of a figure, each with its element.
fn texts(svg: &str) -> Vec<(&str, &str)> {
    svg.split("<text ")
        .skip(1)
        .map(|rest| rest.split_once('>').unwrap())
        .map(|(element, rest)| (element, rest.split("</text>").next().unwrap().trim()))
        .collect()
}

/// All words of a figure, and its caption.
fn said(figure: &Figure) -> String {
    let texts: String = texts(&figure.svg).into_iter().map(|(_, text)| format!("{text} ")).collect();
    texts + &figure.caption
}

fn record(row: &str, axes: Vec<AxisValue>, seed: u64, psnr: Option<f64>) -> Record {
    let mut record = crate::common::record("fern", row, seed, &[("psnr", psnr)], &[]);
    if row == "Aug-NeRF" {
        record.result.inactive_levels = vec!["rgb".into(), "density".into()];
    }
    let status = if psnr.is_some() { Status::Done } else { Status::Waiting };
    Record { id: format!("{row}{axes:?}{seed}"), axes, status, ..record }
}

/// Three seeds of each row, on no axis.
fn seeds_of(rows: &[&str], psnr: impl Fn(&str, u64) -> f64) -> Vec<Record> {
    let of_row = |row: &&str| [0, 1, 2].map(|seed| record(row, vec![], seed, Some(psnr(row, seed))));
    rows.iter().flat_map(of_row).collect()
}

/// The figure of a table's rows.
fn figure_of_rows(spec: &TableSpec, records: &[Record]) -> Figure {
    let table = Table::new(spec, records, false).unwrap();
    rows_figure(Style { spec }, &table, records, "fern", "psnr").unwrap()
}

/// Of a seed at a place: different for every pair, the same every time.
fn noise(seed: u64, place: u64) -> f64 {
    Random::new(seed, Stream::Search, place).uniform() - 0.5
}

/// All letters have 7 pt, and all words stand within the figure.
#[track_caller]
fn assert_fits(figure: &Figure) {
    assert!(figure.svg.contains(" width=\"17cm\""));
    for (element, text) in texts(&figure.svg) {
        let element = format!(" {element}");
        assert_eq!(attribute(&element, "font-size"), "13", "{text}");
        let length = if text.is_empty() { 0.0 } else { number(&element, "textLength") };
        let left = number(&element, "x")
            - match attribute(&element, "text-anchor") {
                "start" => 0.0,
                "middle" => length / 2.0,
                _ => length,
            };
        assert!(left >= -0.1 && left + length <= 895.1, "{text} from {left} to {}", left + length);
    }
}

fn axis_value(axis: &str, panel: &str, value: &str) -> AxisValue {
    AxisValue { axis: axis.into(), panel: panel.into(), value: value.into() }
}

/// 2 axes of 3 levels and one of 1, 3 seeds; features matter, output does not; one value is missing.
fn figure_records() -> Vec<Record> {
    let mut records = seeds_of(&["NeRF"], |_, seed| 19.3 + 0.1 * noise(seed, 1));
    for (axis, values) in [
        ("steps", vec!["0", "1", "3", "5", "10"]),
        ("step size", vec!["1e-5", "1e-4", "1e-3", "1e-2", "1e-1"]),
        ("injection layer", vec!["1", "2", "3", "4", "5", "6", "7", "8"]),
    ] {
        let panels: &[&str] =
            if axis == "injection layer" { &["features"] } else { &["input coordinates", "features", "output"] };
        for panel in panels {
            for (i, value) in values.iter().enumerate() {
                for seed in 0..3 {
                    let effect = if *panel == "features" { i as f64 } else { 0.0 };
                    let psnr = 19.0 + effect + 0.2 * noise(seed, i as u64);
                    let missing = *panel == "output" && *value == "3";
                    let axes = vec![axis_value(axis, panel, value)];
                    records.push(record("Aug-NeRF", axes, seed, (!missing).then_some(psnr)));
                }
            }
        }
    }
    records
}

#[test]
fn the_paper_s_figure() {
    let (spec, records) = (spec(&["NeRF", "Aug-NeRF"]), figure_records());
    let draw = |scene: &str, metric: &str| axes_figure(Style { spec: &spec }, &records, scene, metric);
    let figure = draw("fern", "psnr").unwrap();
    assert_fits(&figure);
    assert_eq!(figure.svg, draw("fern", "psnr").unwrap().svg);
    for words in ["input coordinates", "features", "injection layer", "10⁻⁵", "PSNR (dB)", ">\nNeRF\n<"] {
        assert!(figure.svg.contains(words), "{words}");
    }
    let names = texts(&figure.svg).into_iter().map(|(_, text)| text).filter(|text| ["Aug-NeRF", "NeRF"].contains(text));
    assert_eq!(names.collect::<Vec<&str>>(), ["Aug-NeRF", "NeRF"], "the legend");
    assert!(figure.caption.contains("waiting: output steps = 3 (Aug-NeRF)"), "the missing value is named");
    assert!(draw("orchids", "psnr").is_none() && draw("fern", "ssim").is_none());
}

#[test]
fn a_table_as_points() {
    let spec = spec(&ROWS);
    let mut records = Vec::new();
    for (i, row) in ROWS.iter().enumerate() {
        for seed in 0..3 {
            let effect = if i == 11 { 0.9 } else { 0.02 * i as f64 };
            let missing = i == 4 || (i == 5 && seed > 0);
            let psnr = 19.0 + effect + 0.3 * noise(seed, 99) + 0.1 * noise(seed, i as u64);
            records.push(record(row, vec![], seed, (!missing).then_some(psnr)));
        }
    }
    let figure = figure_of_rows(&spec, &records);
    assert_fits(&figure);
    assert_eq!(figure.svg, figure_of_rows(&spec, &records).svg);
    for words in ["Feature &amp; (Pre-) Output", "waiting", "one seed: no interval", "better", "Aug-NeRF †"] {
        assert!(figure.svg.contains(words), "{words}");
    }
    // A paper has its own caption: title and explanation stand in a file beside the picture.
    assert!(figure.caption.starts_with("PSNR (dB) on fern\nLarge dots") && !figure.svg.contains("Large dots"));
    let names: Vec<String> = figure.files("rows").into_iter().map(|(name, _)| name).collect();
    assert_eq!(names, ["rows.svg", "rows.txt"]);
    let table = Table::new(&spec, &records, false).unwrap();
    assert!(rows_figure(Style { spec: &spec }, &table, &records, "orchids", "psnr").is_none());
}

/// A row with axes of its own is a line for each of its values; it takes no other row's place.
#[test]
fn rows_with_axes_of_their_own_stand_beside_plain_ones() {
    let spec = spec(&["NeRF", "Aug-NeRF"]);
    let psnr = |seed| 20.0 + noise(seed, 7);
    let mut records = seeds_of(&["NeRF"], |_, seed| psnr(seed));
    for (value, gain) in [("0.1", 0.1), ("0.5", 0.2)] {
        let point = |seed| record("Aug-NeRF", vec![axis_value("lambda", "", value)], seed, Some(psnr(seed) + gain));
        records.extend((0..3).map(point));
    }
    let (table, records) = (Table::new(&spec, &records, false).unwrap(), &records);
    let has_rows = |spec: &TableSpec| {
        let column_of = |_: &str| None;
        let points = Points { spec, records, timing: &[], with_timing: false, constants: Vec::new(), column_of };
        let all = Comparable { points: &points, table: &table, curves: &[], attacks: &[] };
        all.files().iter().any(|(name, _)| name == "rows_fern_psnr.svg")
    };
    assert!(has_rows(&spec) && !has_rows(&TableSpec { varied: true, ..spec.clone() }));
    assert_says(&figure_of_rows(&spec, records).svg, &[">\nNeRF\n<", "lambda = 0.1", "lambda = 0.5"]);
}

#[test]
fn training_curves() {
    let curve = |label: &str, level: f64| Curve {
        label: label.into(),
        seeds: (0..3)
            .map(|seed| (1..=60).map(|i| (50.0 * i as f64, level - 8.0 / i as f64 + noise(seed, i))).collect())
            .collect(),
        ..Curve::default()
    };
    let spec = spec(&ROWS[..10]);
    let curves: Vec<Curve> = ROWS[..10].iter().enumerate().map(|(i, row)| curve(row, 18.0 + 0.3 * i as f64)).collect();
    let figure = curves_figure(Style { spec: &spec }, "fern", &curves).unwrap();
    assert_fits(&figure);
    // The baseline and the four that end highest, named at the ends of their lines.
    for (row, times) in [("NeRF", 1), ("Aug-NeRF", 1), ("+ Feature Aug.", 1), ("+ l1 Reg.", 0)] {
        assert_eq!(texts(&figure.svg).iter().filter(|(_, text)| *text == row).count(), times, "{row}");
    }
    let said = said(&figure);
    for words in ["moving averages", "Of 10 rows: the baseline and the 4 with the highest"] {
        assert!(said.contains(words), "{words}: {said}");
    }
    // Rows share their seeds: the baseline alone has a band.
    assert_eq!(figure.svg.matches("<polygon").count(), 1);
    let empty = Curve { label: "empty".into(), seeds: vec![vec![]], ..Curve::default() };
    // A single log is no curve.
    let single = Curve { label: "single".into(), seeds: vec![vec![(100.0, 16.0)]], ..Curve::default() };
    for curves in [vec![], vec![empty], vec![single]] {
        assert!(curves_figure(Style { spec: &spec }, "fern", &curves).is_none());
    }
}

/// Where views were evaluated during training, a second panel has held-out and training views of each row.
#[test]
fn training_curves_show_seen_and_unseen_views() {
    let evaluated = |level: f64| vec![(1..=4).map(|i| (500.0 * i as f64, level + i as f64)).collect::<Vec<_>>(); 2];
    let spec = spec(&["NeRF"]);
    let rays = Curve { label: "NeRF".into(), seeds: evaluated(17.0), ..Curve::default() };
    let both = Curve { held_out: evaluated(18.0), seen: evaluated(20.0), ..rays.clone() };
    let [without, with] = [rays, both].map(|curve| curves_figure(Style { spec: &spec }, "fern", &[curve]).unwrap().svg);
    for (svg, times) in [(&without, 0), (&with, 1)] {
        assert_eq!(svg.matches("PSNR of whole views (dB): held-out, and training (dashed)").count(), times);
        assert_eq!(svg.matches("stroke-dasharray").count(), times, "training views are dashed");
    }
}

#[test]
fn odd_input_draws_or_says_that_there_is_nothing() {
    let two = spec(&["NeRF", "Aug-NeRF"]);
    assert!(axes_figure(Style { spec: &two }, &[], "fern", "psnr").is_none());
    let word = |value: &str, seed, psnr| record("Aug-NeRF", vec![axis_value("kind", "", value)], seed, psnr);
    let one = [word("worst-case", 0, Some(20.0))];
    let figure = axes_figure(Style { spec: &two }, &one, "fern", "psnr").unwrap();
    assert!(figure.svg.contains("worst-case"));
    let equal: Vec<Record> = (0..6).map(|i| word(["a", "b"][i as usize % 2], i / 2, Some(20.0))).collect();
    let figure = axes_figure(Style { spec: &two }, &equal, "fern", "psnr").unwrap();
    assert!(["a", "b"].iter().all(|value| texts(&figure.svg).iter().any(|(_, text)| text == value)));
    let broken = [word("a", 0, Some(f64::NAN)), word("b", 0, None)];
    assert!(axes_figure(Style { spec: &two }, &broken, "fern", "psnr").is_none());
    // A row whose points failed has failed; it does not lack data.
    for (status, word) in [(Status::Waiting, "waiting"), (Status::Failed, "failed")] {
        let other = Record { status, ..record("Aug-NeRF", vec![], 0, None) };
        let svg = figure_of_rows(&two, &[record("NeRF", vec![], 0, Some(20.0)), other]).svg;
        assert!(svg.contains(word) && !svg.contains("no data"));
    }
}

/// Long titles and names wrap; changed settings are in the caption.
#[test]
fn no_figure_grows_with_its_words() {
    let long = "a name of many words that says everything about a row, its method, its settings and its seeds, and more than anybody wants to know";
    let mut spec = spec(&["NeRF", long, "unbrokenwordthatislongerthanacolumnofafigurecouldeverbe"]);
    spec.changed = "data.width = 24, train.steps = 20".into();
    spec.title = format!("{long} (with {})", spec.changed);
    let rows: Vec<&str> = spec.rows.iter().map(|row| row.name.as_str()).collect();
    let figure = figure_of_rows(&spec, &seeds_of(&rows, |row, seed| 20.0 + noise(seed, row.len() as u64)));
    assert_fits(&figure);
    assert!(figure.caption.ends_with(" All rows: data.width = 24, train.steps = 20.\n"), "{}", figure.caption);
    assert_eq!(said(&figure).matches("data.width").count(), 1, "not in the title");
}

/// A row has one colour in all figures, and blue and orange are of verdicts alone.
#[test]
fn a_row_has_one_colour_in_all_figures() {
    let rows = ["NeRF", "better", "worse"];
    let spec = spec(&rows);
    let level = |row: &str| 20.0 + f64::from(row == "better") - f64::from(row == "worse");
    let log = |level: f64| vec![(1..9).map(|i| (f64::from(i), level)).collect::<Vec<_>>()];
    let curves = ["worse", "better"].map(|row| Curve { label: row.into(), seeds: log(level(row)), ..Curve::default() });
    let figures = [
        figure_of_rows(&spec, &seeds_of(&rows, |row, seed| level(row) + 0.01 * noise(seed, row.len() as u64))).svg,
        curves_figure(Style { spec: &spec }, "fern", &curves).unwrap().svg,
    ];
    let [of_worse, of_better] = ["rgb(204,121,167)", "rgb(0,158,115)"];
    assert!(figures.iter().all(|svg| svg.contains(of_worse)));
    assert!(figures[0].contains(of_better) && figures[1].contains(of_better));
    assert!(figures[1..].iter().all(|svg| !svg.contains("rgb(0,114,178)") && !svg.contains("rgb(213,94,0)")));
}
