//! Figures of a sweep from hand-made points. `AUGNERF_PLOTS=DIR` keeps them to look at.

use augnerf::augment::Site;
use augnerf::base::rng::{Random, Stream};
use augnerf::report::exporters::{Collected, EXPORTERS};
use augnerf::report::plots::{
    Curve, Figure, Shifts, axes_figure, curves_figure, heatmap_figures, rows_figure, seconds_figure, shifts_figure,
};
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
        must_match: vec![],
        by_seed: vec![],
        equivalence: vec![],
        varied: false,
        notes: vec![],
    }
}

fn record(row: &str, axes: Vec<AxisValue>, seed: u64, psnr: Option<f64>) -> Record {
    Record {
        id: format!("{row}{axes:?}{seed}"),
        scene: "fern".into(),
        row: row.into(),
        axes,
        seed: Some(seed),
        status: if psnr.is_some() { Status::Done } else { Status::Waiting },
        reason: String::new(),
        metrics: vec![("psnr".into(), psnr)],
        protocol: vec![],
        inactive_levels: if row == "Aug-NeRF" { vec!["rgb".into(), "density".into()] } else { vec![] },
    }
}

/// A table and its points, without logs.
fn collected<'a>(spec: &'a TableSpec, records: &'a [Record], table: &'a Table) -> Collected<'a> {
    Collected {
        spec,
        records,
        timing: &[],
        with_timing: false,
        table: Some(table),
        curves: &[],
        attacks: &[],
        shifts: &[],
        surfaces: &[],
    }
}

/// Of a seed at a place: different for every pair, the same every time.
fn noise(seed: u64, place: u64) -> f64 {
    Random::new(seed, Stream::Search, place).uniform() - 0.5
}

fn keep(name: &str, figure: &Figure) {
    if let Ok(dir) = std::env::var("AUGNERF_PLOTS") {
        std::fs::create_dir_all(&dir).unwrap();
        for (file, bytes) in figure.clone().files(name) {
            std::fs::write(format!("{dir}/{file}"), bytes).unwrap();
        }
    }
    assert_eq!(figure.png.is_some(), cfg!(feature = "png-figures"));
    if let Some(png) = &figure.png {
        let picture = image::load_from_memory(png).unwrap();
        assert!(picture.width() > 800 && picture.height() > 300, "{} x {}", picture.width(), picture.height());
    }
}

fn axis_value(axis: &str, panel: &str, value: &str) -> AxisValue {
    AxisValue { axis: axis.into(), panel: panel.into(), value: value.into() }
}

/// 2 axes of 3 levels and one of 1, 3 seeds; features matter, output does not; one value is missing.
fn figure_records() -> Vec<Record> {
    let mut records: Vec<Record> =
        (0..3).map(|seed| record("NeRF", vec![], seed, Some(19.3 + 0.1 * noise(seed, 1)))).collect();
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
    let figure = axes_figure(&spec, &records, "fern", "psnr").unwrap().unwrap();
    keep("axes", &figure);
    assert_eq!(figure, axes_figure(&spec, &records, "fern", "psnr").unwrap().unwrap());
    for words in ["input coordinates: steps", "features: injection layer", "1e-5", "PSNR (dB)", "Dashed: NeRF"] {
        assert!(figure.svg.contains(words), "{words}");
    }
    // Panels of coordinates and output show nothing; those of features do.
    assert_eq!(figure.svg.matches("3 seeds: no pair passes").count(), 4);
    assert_eq!(figure.svg.matches("differ, p ").count(), 3);
    assert!(figure.svg.contains("output steps = 3 (Aug-NeRF)"), "the missing value is named");
    assert!(axes_figure(&spec, &records, "orchids", "psnr").unwrap().is_none());
    assert!(axes_figure(&spec, &records, "fern", "ssim").unwrap().is_none());
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
    let table = Table::new(&spec, &records, false).unwrap();
    let figure = rows_figure(&table, &records, "fern", "psnr").unwrap().unwrap();
    keep("rows", &figure);
    assert_eq!(figure, rows_figure(&table, &records, "fern", "psnr").unwrap().unwrap());
    for words in [
        "Feature &amp; (Pre-) Output",
        "no data",
        "one seed: no interval",
        "not distinguishable",
        "higher",
        "Aug-NeRF †",
    ] {
        assert!(figure.svg.contains(words), "{words}");
    }
    assert!(rows_figure(&table, &records, "orchids", "psnr").unwrap().is_none());
}

/// A row with axes of its own is a line for each of its values; it takes no other row's place.
#[test]
fn rows_with_axes_of_their_own_stand_beside_plain_ones() {
    let spec = spec(&["NeRF", "Aug-NeRF"]);
    let weight = |value| vec![axis_value("lambda", "", value)];
    let records: Vec<Record> = (0..3)
        .flat_map(|seed| {
            let psnr = |gain| Some(20.0 + gain + noise(seed, 7));
            [
                record("NeRF", vec![], seed, psnr(0.0)),
                record("Aug-NeRF", weight("0.1"), seed, psnr(0.1)),
                record("Aug-NeRF", weight("0.5"), seed, psnr(0.2)),
            ]
        })
        .collect();
    let table = Table::new(&spec, &records, false).unwrap();
    let names = |spec: &TableSpec| -> Vec<String> {
        let (table, records) = (&table, &records[..]);
        let collected = collected(spec, records, table);
        EXPORTERS.iter().flat_map(|exporter| exporter.export(&collected).unwrap()).map(|(name, _)| name).collect()
    };
    let has_rows = |names: Vec<String>| names.iter().any(|name| name == "rows_fern_psnr.svg");
    assert!(has_rows(names(&spec)));
    assert!(!has_rows(names(&TableSpec { varied: true, ..spec.clone() })));
    let figure = rows_figure(&table, &records, "fern", "psnr").unwrap().unwrap();
    assert!(
        figure.svg.contains(">\nNeRF\n<") && figure.svg.contains("lambda = 0.1") && figure.svg.contains("lambda = 0.5")
    );
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
    let curves: Vec<Curve> = ROWS[..10].iter().enumerate().map(|(i, row)| curve(row, 18.0 + 0.3 * i as f64)).collect();
    let figure = curves_figure("Ablation: training on fern", "PSNR of the step's rays (dB)", &curves).unwrap().unwrap();
    keep("curves", &figure);
    assert!(figure.svg.contains("moving averages") && figure.svg.contains("stroke-dasharray"));
    assert!(curves_figure("t", "u", &[]).unwrap().is_none());
    assert!(
        curves_figure("t", "u", &[Curve { label: "empty".into(), seeds: vec![vec![]], ..Curve::default() }])
            .unwrap()
            .is_none()
    );
}

/// Each row along its own seconds; rows whose seconds are not known are left out.
#[test]
fn training_curves_against_seconds() {
    let curve = |label: &str, seconds_per_step| Curve {
        label: label.into(),
        seeds: vec![(1..=4).map(|i| (500.0 * i as f64, 20.0 + i as f64)).collect(); 2],
        seconds_per_step,
        ..Curve::default()
    };
    let curves = [curve("fast", Some(0.01)), curve("slow", Some(0.04)), curve("unknown", None)];
    let svg = seconds_figure("t", "u", &curves).unwrap().unwrap().svg;
    assert!(svg.contains("seconds of training") && svg.contains("slow") && !svg.contains("unknown"));
    // 2000 steps of the slow one are 80 seconds, which the axis ends at, and of the fast one a quarter of that.
    let ends: Vec<f64> = svg
        .lines()
        .filter(|line| line.starts_with("<polyline") && line.contains("1.8"))
        .map(|line| {
            let points = line.split("points=\"").nth(1).unwrap().split('"').next().unwrap();
            points.split(' ').next_back().unwrap().split(',').next().unwrap().parse().unwrap()
        })
        .collect();
    assert_eq!(ends, [76.0 + 560.0 / 4.0, 76.0 + 560.0]);
    assert!(seconds_figure("t", "u", &curves[2..]).unwrap().is_none());
    assert!(curves_figure("t", "u", &curves).unwrap().unwrap().svg.contains("unknown"));
}

/// Where views were evaluated during training, a second panel has held-out and training views of each row.
#[test]
fn training_curves_show_seen_and_unseen_views() {
    let evaluated = |level: f64| vec![(1..=4).map(|i| (500.0 * i as f64, level + i as f64)).collect::<Vec<_>>(); 2];
    let rays = Curve { label: "NeRF".into(), seeds: evaluated(17.0), ..Curve::default() };
    let both = Curve { held_out: evaluated(18.0), seen: evaluated(20.0), ..rays.clone() };
    let [without, with] = [rays, both].map(|curve| curves_figure("t", "u", &[curve]).unwrap().unwrap().svg);
    let words = |svg: &str, word: &str| svg.matches(&format!(">\n{word}\n<")).count();
    for (svg, times) in [(&without, 0), (&with, 1)] {
        assert_eq!((words(svg, "held-out views"), words(svg, "training views")), (times, times));
        assert_eq!(svg.matches("<circle").count(), 4 * times, "a dot an evaluation");
    }
    assert!(with.contains("PSNR of whole views (dB)"));
}

/// A panel a site that any row has, on one scale from a power of ten to another, with the bound of inactive sites.
#[test]
fn shifts_of_the_attack() {
    let seeds = |level: f64| -> Vec<Vec<(f64, f64)>> {
        let shift = |seed, i: u64| (50.0 * i as f64, level * (1.0 + 0.5 * noise(seed, i)));
        (0..3).map(|seed| (1..=20).map(|i| shift(seed, i)).collect()).collect()
    };
    let row = |label: &str, share: f64| {
        let levels = [3.0, 2.0, 0.1, 0.2, 2e-3, 1.2e-4];
        let sites = Site::ALL.into_iter().zip(levels).map(|(site, level)| (site, seeds(level * share)));
        Shifts { label: label.into(), sites: sites.collect() }
    };
    let all = [row("Aug-NeRF", 1.0), row("Uniform draws, paper's geometry", 0.1)];
    let figure = shifts_figure("Ablation: shift of colours by the attack on fern", &all).unwrap().unwrap();
    keep("attack", &figure);
    let says = |svg: &str, word: &str| svg.contains(&format!(">\n{word}\n<"));
    for word in ["t", "density", "Aug-NeRF", "1e-5", "0.001", "10", "1/2: inactive below"] {
        assert!(says(&figure.svg, word), "{word}");
    }
    assert!(!figure.svg.contains("Shifts of 0"));
    // A shift is drawn at its logarithm: 5 is at 0.699 of the decade, as the bound of 0.5 is in that below.
    let flat = |value: f64| {
        let sites = vec![(Site::Feature, vec![vec![(1.0, value), (2.0, value)]])];
        shifts_figure("t", &[Shifts { label: "flat".into(), sites }]).unwrap()
    };
    let svg = flat(5.0).unwrap().svg;
    let height = |width: &str| -> f64 {
        let line = svg.lines().find(|line| line.contains(&format!("stroke-width=\"{width}\""))).unwrap();
        let points = line.split("points=\"").nth(1).unwrap().split(' ').next().unwrap();
        points.split(',').nth(1).unwrap().trim_end_matches('"').parse().unwrap()
    };
    // Two decades of 95 pixels each.
    assert!((height("1.2") - height("1.8") - 95.0).abs() < 0.11, "{} {}", height("1.2"), height("1.8"));
    assert!(says(&svg, "feature") && !says(&svg, "rgb") && says(&svg, "0.1") && says(&svg, "10"));
    // What moves no colour has nothing to draw.
    assert!(flat(0.0).is_none() && shifts_figure("t", &[]).unwrap().is_none());
    let half = vec![(Site::Feature, vec![vec![(1.0, 0.0), (2.0, 1.0), (3.0, 2.0)]])];
    let svg = shifts_figure("t", &[Shifts { label: "half".into(), sites: half }]).unwrap().unwrap().svg;
    assert!(svg.contains("Shifts of 0 have no place on this scale."));
}

#[test]
fn odd_input_draws_or_says_that_there_is_nothing() {
    let two = spec(&["NeRF", "Aug-NeRF"]);
    assert!(axes_figure(&two, &[], "fern", "psnr").unwrap().is_none());
    let word = |value: &str, seed, psnr| record("Aug-NeRF", vec![axis_value("kind", "", value)], seed, psnr);
    let one = [word("worst-case", 0, Some(20.0))];
    let figure = axes_figure(&two, &one, "fern", "psnr").unwrap().unwrap();
    assert!(figure.svg.contains("one seed: no spread known") && figure.svg.contains("worst-case"));
    let equal: Vec<Record> = (0..6).map(|i| word(["a", "b"][i as usize % 2], i / 2, Some(20.0))).collect();
    assert!(axes_figure(&two, &equal, "fern", "psnr").unwrap().unwrap().svg.contains("3 seeds: no pair passes"));
    let broken = [word("a", 0, Some(f64::NAN)), word("b", 0, None)];
    assert!(axes_figure(&two, &broken, "fern", "psnr").unwrap().is_none());
    let plain = [record("NeRF", vec![], 0, Some(20.0)), record("Aug-NeRF", vec![], 0, None)];
    let table = Table::new(&two, &plain, false).unwrap();
    assert!(rows_figure(&table, &plain, "fern", "psnr").unwrap().unwrap().svg.contains("no data"));
    let flat = Curve { label: "flat".into(), seeds: vec![vec![(1.0, 20.0)]], ..Curve::default() };
    assert!(curves_figure("t", "u", &[flat]).unwrap().is_some());
}

/// Two axes varied together: the first is drawn along, each value of the second is a line.
#[test]
fn a_product_of_two_axes_is_drawn_too() {
    let values = |down: usize, across: usize| {
        let axes = vec![
            axis_value("steps", "features", ["0", "1", "3", "5"][across]),
            axis_value("epsilon", "features", ["1e-3", "1e-2", "1e-1", "1"][down]),
        ];
        let psnr = 19.0 + 0.2 * across as f64 - 0.15 * (down * across) as f64;
        (0..3).map(move |seed| {
            let place = (10 * down + across) as u64;
            record("Aug-NeRF", axes.clone(), seed, Some(psnr + 0.1 * noise(seed, place)))
        })
    };
    let mut records: Vec<Record> = (0..3).map(|seed| record("NeRF", vec![], seed, Some(19.1))).collect();
    records.extend((0..16).flat_map(|i| values(i / 4, i % 4)));
    let figure = axes_figure(&spec(&["NeRF", "Aug-NeRF"]), &records, "fern", "psnr").unwrap().expect("a figure");
    keep("product", &figure);
    for value in ["1e-3", "1e-2", "1e-1", "1"] {
        assert!(figure.svg.contains(&format!("features epsilon = {value}: 3 seeds")), "{value}");
    }
    // The same as a heatmap: a cell for each of the 16 places, one of which is not measured.
    records.iter_mut().filter(|record| record.axes.len() == 2).last().unwrap().status = Status::Waiting;
    let last = records.iter().rposition(|record| record.axes.len() == 2).unwrap();
    records[last - 2..=last].iter_mut().for_each(|record| record.status = Status::Waiting);
    let spec = spec(&["NeRF", "Aug-NeRF"]);
    let table = Table::new(&spec, &records, false).unwrap();
    let maps = heatmap_figures(&table, &records, "fern", "psnr").unwrap();
    let [map] = maps.as_slice() else { panic!("{} heatmaps", maps.len()) };
    keep("heatmap", map);
    let differ =
        table.lines.iter().filter_map(|line| line.cells[0].comparison?.verdict()).filter(|v| v.is_difference());
    // A frame is a line, and what differs has one; the grey one is of the cell without data.
    assert_eq!(map.svg.matches("<polyline").count(), 1 + differ.count());
    assert_eq!((map.svg.matches("no data").count(), map.svg.matches("± 0.").count()), (1, 15));
    for words in ["features: epsilon", "features: steps", "1e-3", "PSNR (dB) on fern, Aug-NeRF"] {
        assert!(map.svg.contains(words), "{words}");
    }
    assert!(heatmap_figures(&table, &records, "fern", "ssim").unwrap().is_empty());
    let single = figure_records();
    let table = Table::new(&spec, &single, false).unwrap();
    assert!(heatmap_figures(&table, &single, "fern", "psnr").unwrap().is_empty(), "one axis at a time has none");
    let (table, records) = (&table, &single[..]);
    let collected = collected(&spec, records, table);
    let files = EXPORTERS.iter().flat_map(|exporter| exporter.export(&collected).unwrap());
    assert_eq!(files.filter(|(name, _)| name.starts_with("heatmap_")).count(), 0);
}

/// Numbers at the ends of what a computer holds, and letters that XML does not: figures are drawn all the same.
#[test]
#[ignore = "slow"]
fn the_smallest_and_largest_numbers_and_odd_letters_are_drawn() {
    let odd = ["NeRF", "A\u{1}u\u{fffe}g <&> λ 中"];
    let spec = spec(&odd);
    let extremes = [5e-324, -5e-324, 0.0, 1e308, f64::MAX, f64::MIN, 1.0, 1.0 + f64::EPSILON, f64::NAN, f64::INFINITY];
    for a in extremes {
        for b in extremes {
            let at = |value: &str| vec![axis_value("steps", "", value)];
            let mut records: Vec<Record> =
                [a, b].into_iter().zip(0..).map(|(x, seed)| record(odd[0], vec![], seed, Some(x))).collect();
            records.extend([b, a].into_iter().zip(0..).map(|(x, seed)| record(odd[1], vec![], seed, Some(x))));
            records.extend([a, b].into_iter().zip(0..).map(|(x, seed)| record(odd[1], at("1"), seed, Some(x))));
            records.extend([1.0, b].into_iter().zip(0..).map(|(x, seed)| record(odd[1], at("2"), seed, Some(x))));
            let table = Table::new(&spec, &records, false).unwrap();
            rows_figure(&table, &records, "fern", "psnr").unwrap();
            axes_figure(&spec, &records, "fern", "psnr").unwrap();
            heatmap_figures(&table, &records, "fern", "psnr").unwrap();
            let seeds = vec![vec![(0.0, a), (1.0, b)], vec![(0.0, b), (a, b)]];
            let curve = Curve {
                label: odd[1].into(),
                held_out: seeds.clone(),
                seen: seeds.clone(),
                seeds,
                seconds_per_step: Some(b),
            };
            curves_figure("t\u{0}", "u", std::slice::from_ref(&curve)).unwrap();
            let sites = vec![(Site::T, curve.seeds.clone()), (Site::Rgb, curve.held_out.clone())];
            shifts_figure("t\u{0}", &[Shifts { label: odd[1].into(), sites }]).unwrap();
            seconds_figure("t\u{0}", "u", &[curve]).unwrap();
        }
    }
}
