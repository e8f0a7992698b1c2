//! Tables of a sweep from hand-made points: 2 scenes, 3 seeds, axes, a failure, an inactive level.

use std::collections::HashMap;

use crate::common::files::rows;
use crate::common::{assert_says, record, row_against};
use augnerf::base::Error;
use augnerf::report::tables::text::warnings;
use augnerf::report::tables::{
    Line, Table, Verdict, constants, points_csv, read_points, table_csv, table_latex, table_markdown, table_terminal,
};
use augnerf::report::{AxisValue, PublishedKey, Record, RowSpec, Status, TableSpec};
use augnerf::settings::columns::column_of_setting;

fn row(name: &str, baseline: Option<&str>, method: &str) -> RowSpec {
    let key = PublishedKey { table: "tab4".into(), condition: "clean".into(), method: method.into() };
    RowSpec {
        name: name.into(),
        baseline: baseline.map(str::to_string),
        ours: method.is_empty(),
        published: (!method.is_empty()).then_some(key),
        ..RowSpec::default()
    }
}

/// The table of some records, which may stand in one.
fn table_of(spec: &TableSpec, records: &[Record]) -> Table {
    Table::new(spec, records, false).unwrap()
}

/// The rows of its CSV file.
fn csv_of(table: &Table) -> Vec<HashMap<String, String>> {
    rows(&table_csv(table, &[], &vec![], column_of_setting))
}

fn spec() -> TableSpec {
    TableSpec {
        name: "tab4".into(),
        title: "Which level helps?".into(),
        metrics: vec!["psnr".into(), "average_vgg".into()],
        rows: vec![
            row("NeRF", None, "NeRF"),
            row("Aug-NeRF", Some("NeRF"), "Aug-NeRF"),
            row("+ TV Reg.", Some("NeRF"), "+ TV Reg."),
            row("output & only", Some("NeRF"), ""),
        ],
        must_match: vec!["width".into(), "code_revision".into()],
        ..TableSpec::default()
    }
}

fn point(scene: &str, row: &str, seed: u64, psnr: f64) -> Record {
    let seed_text = seed.to_string();
    let protocol = [
        ("dataset", "llff"),
        ("scene", scene),
        ("width", "101"),
        ("height", "76"),
        ("steps", "2000"),
        ("seed", seed_text.as_str()),
        ("config_hash", seed_text.as_str()),
        ("code_revision", "abc"),
    ];
    record(scene, row, seed, &[("psnr", Some(psnr)), ("average_vgg", None)], &protocol)
}

fn at_steps(mut record: Record, steps: &str) -> Record {
    record.axes = vec![AxisValue { axis: "steps".into(), panel: "features".into(), value: steps.into() }];
    record.id += steps;
    record
}

fn unmeasured(mut record: Record, status: Status, reason: &str) -> Record {
    (record.status, record.reason) = (status, reason.into());
    record.result.protocol.clear();
    record
}

/// The rows come in another order than the definition's.
fn records() -> Vec<Record> {
    let mut records = vec![
        point("fern", "Aug-NeRF", 0, 25.5),
        point("fern", "Aug-NeRF", 1, 25.25),
        point("fern", "Aug-NeRF", 2, 25.75),
        point("fern", "NeRF", 0, 25.0),
        point("fern", "NeRF", 1, 24.875),
        point("fern", "NeRF", 2, 25.125),
        at_steps(point("fern", "+ TV Reg.", 0, 25.5), "3"),
        at_steps(point("fern", "+ TV Reg.", 1, 24.5), "3"),
        // The metrics of an attempt that failed later must not count.
        at_steps(unmeasured(point("fern", "+ TV Reg.", 2, 99.0), Status::Failed, "collapsed | at step 7"), "3"),
        at_steps(point("fern", "+ TV Reg.", 0, 24.0), "1"),
        point("fern", "output & only", 1, 25.0),
        point("chair", "NeRF", 0, 30.0),
        unmeasured(point("chair", "Aug-NeRF", 0, 0.0), Status::NoData, "chair is not on this machine"),
    ];
    records[1].result.inactive_levels = vec!["rgb".into()];
    records[2].result.inactive_levels = vec!["rgb".into(), "density".into()];
    records[3].result.metrics.push(("lpips_vgg".into(), Some(0.25)));
    records
}

fn table() -> Table {
    table_of(&spec(), &records())
}

fn find<'a>(table: &'a Table, scene: &str, label: &str) -> &'a Line {
    table.lines.iter().find(|line| line.scene == scene && line.label == label).unwrap()
}

fn cells<'a>(row: &'a HashMap<String, String>, names: &str) -> Vec<&'a str> {
    names.split_whitespace().map(|name| row.get(name).map_or("", String::as_str)).collect()
}

#[test]
fn lines_are_compared_with_their_baseline_by_seed() {
    let table = table();
    let cell = &find(&table, "fern", "Aug-NeRF").cells[0];
    assert_eq!((cell.n, cell.mean, cell.deviation), (3, Some(25.5), Some(0.25)));
    let comparison = cell.comparison.unwrap();
    // scipy 1.17.1: r = scipy.stats.ttest_rel([25.5, 25.25, 25.75], [25.0, 24.875, 25.125]);
    // r.pvalue, *r.confidence_interval(0.95)
    assert_eq!((comparison.pairs, comparison.difference), (3, 0.5));
    let (low, high) = comparison.interval.unwrap();
    assert!((comparison.p.unwrap() - 0.020204102886728758).abs() < 1e-12);
    assert!((low - 0.18948278603120877).abs() < 1e-9 && (high - 0.8105172139687913).abs() < 1e-9);
    assert_eq!(comparison.verdict(), Some(Verdict::Higher));
    // Two lines of the scene have a p value: this one's, the smaller, is doubled. 0.040 still passes.
    assert_eq!(comparison.p_holm, comparison.p.map(|p| 2.0 * p));

    let unsure = find(&table, "fern", "+ TV Reg., features steps = 3");
    assert_eq!(unsure.baseline.as_deref(), Some("NeRF"));
    assert_eq!(unsure.cells[0].comparison.unwrap().verdict(), Some(Verdict::NotDistinguishable));
    let single = find(&table, "fern", "output & only").cells[0].comparison.unwrap();
    assert_eq!((single.difference, single.interval, single.p, single.p_holm), (0.125, None, None, None));
    assert_eq!(find(&table, "fern", "NeRF").cells[0].comparison, None);
    assert_eq!(find(&table, "chair", "Aug-NeRF").cells[0].comparison, None);
}

#[test]
fn baselines_at_the_same_axis_values_come_first() {
    let mut records = records();
    records.push(at_steps(point("fern", "NeRF", 0, 20.0), "3"));
    let table = table_of(&spec(), &records);
    let line = find(&table, "fern", "+ TV Reg., features steps = 3");
    assert_eq!(line.baseline.as_deref(), Some("NeRF, features steps = 3"));
    assert_eq!(line.cells[0].comparison.map(|c| (c.pairs, c.difference)), Some((1, 5.5)));
    assert_eq!(find(&table, "fern", "+ TV Reg., features steps = 1").baseline.as_deref(), Some("NeRF"));
}

#[test]
fn lines_say_what_is_missing_inactive_and_published() {
    let table = table();
    let failed = find(&table, "fern", "+ TV Reg., features steps = 3");
    assert_eq!((failed.status.as_str(), failed.reason.as_str()), ("done 2, failed 1", "collapsed | at step 7"));
    assert_eq!((failed.points, failed.ids.len(), failed.cells[0].n, failed.cells[0].mean), (3, 2, 2, Some(25.0)));
    let aug = find(&table, "fern", "Aug-NeRF");
    assert_eq!(aug.inactive_levels, [("rgb".to_string(), 2), ("density".to_string(), 1)]);
    assert_eq!((aug.cells[0].published, aug.cells[1].published), (Some(26.51), None));
    assert_eq!((aug.published_lpips, aug.published_average), (None, Some(0.054)));
    assert_eq!((aug.cells[1].n, aug.cells[1].mean), (0, None));
    assert_eq!(aug.protocol_difference, "101x76 instead of 504x378, steps 2000 instead of 500000");
    assert_eq!((aug.protocol("steps"), aug.protocol("seed"), aug.differs.len()), ("2000", "", 0));
    assert_eq!(find(&table, "chair", "NeRF").cells[0].published, None);
}

#[test]
fn uncontrolled_settings_are_refused_or_marked() {
    let mut records = records();
    records[1].result.protocol.last_mut().unwrap().1 = "def".into();
    let Err(Error::NotComparable(message)) = Table::new(&spec(), &records, false) else { panic!("not refused") };
    let words = ["fern", "code_revision", "`abc` in NeRF (seed 0)", "`def` in Aug-NeRF (seed 1)", "--force"];
    assert_says(&message, &words);
    let table = Table::new(&spec(), &records, true).unwrap();
    let Line { mixed, differs, .. } = find(&table, "fern", "Aug-NeRF");
    assert_eq!([mixed, differs], [&["code_revision"], &["code_revision"]]);
    assert!(find(&table, "fern", "NeRF").mixed.is_empty());
    assert_eq!(csv_of(&table)[1]["mixed"], "code_revision");
    assert_says(&table_markdown(&table), &["‡ NOT COMPARABLE"]);
    assert_says(&table_terminal(&table, 80), &["‡ NOT COMPARABLE"]);
    assert_says(&table_latex(&table), &["$\\ddagger$ NOT COMPARABLE"]);
}

/// What goes with the seed may differ between seeds, and not between two rows of one seed.
#[test]
fn settings_by_seed_are_controlled_seed_by_seed() {
    let held_out = |row: &str, seed: u64, split: &str| {
        let mut record = point("fern", row, seed, 25.0);
        record.result.protocol.push(("split".into(), split.into()));
        record
    };
    let plain = TableSpec { must_match: vec!["split".into()], ..spec() };
    let by_seed = TableSpec { by_seed: vec!["split".into()], ..plain.clone() };
    let records = |last: &str| {
        [
            held_out("NeRF", 0, "every-8"),
            held_out("Aug-NeRF", 0, "every-8"),
            held_out("NeRF", 1, "every-8-from-3"),
            held_out("Aug-NeRF", 1, last),
        ]
    };
    let same = records("every-8-from-3");
    assert!(matches!(Table::new(&plain, &same, false), Err(Error::NotComparable(_))));
    assert!(table_of(&by_seed, &same).lines.iter().all(|line| line.mixed.is_empty()));
    let other = records("every-8");
    assert!(matches!(Table::new(&by_seed, &other, false), Err(Error::NotComparable(_))));
    assert_eq!(Table::new(&by_seed, &other, true).unwrap().lines[1].mixed, ["split"]);
}

/// A row that names its device may have another than the rest, which have one.
#[test]
fn devices_of_rows_that_name_none_are_the_same() {
    let on = |row: &str, seed: u64, device: &str| {
        let mut record = point("fern", row, seed, 25.0);
        record.result.protocol.push(("device".into(), device.into()));
        record
    };
    let mut spec = TableSpec { must_match: vec!["device".into()], ..spec() };
    spec.rows[0].names_device = true;
    let of =
        |last: &str| [on("NeRF", 0, "cpu"), on("Aug-NeRF", 0, "gpu"), on("NeRF", 1, "cpu"), on("Aug-NeRF", 1, last)];
    let table = table_of(&spec, &of("gpu"));
    assert_says(&table_markdown(&table), &["rows differ in device: cpu (NeRF); gpu (Aug-NeRF)"]);
    assert!(matches!(Table::new(&spec, &of("cpu"), false), Err(Error::NotComparable(_))), "a row on two devices");
    spec.rows[0].names_device = false;
    assert!(matches!(Table::new(&spec, &of("gpu"), false), Err(Error::NotComparable(_))));
}

#[test]
fn what_cannot_be_placed_is_refused() {
    let refusal = |spec: &TableSpec, records: &[Record]| Table::new(spec, records, true).unwrap_err().to_string();
    let twice = [point("fern", "NeRF", 0, 1.0), point("fern", "NeRF", 0, 2.0)];
    assert!(refusal(&spec(), &twice).contains("each seed once"));
    assert!(refusal(&spec(), &[point("fern", "NeRv", 0, 1.0)]).contains("`NeRv`"));
    let mut unknown = spec();
    unknown.rows[1].baseline = Some("MipNeRF".into());
    assert!(refusal(&unknown, &[]).contains("`MipNeRF`"));
    unknown.rows[1] = row("Aug-NeRF", None, "Aug-NeRv");
    assert!(refusal(&unknown, &[]).contains("'Aug-NeRv'"));
}

#[test]
fn table_csv_has_every_line() {
    let timing = [0, 1].map(|seed| (format!("fern-NeRF-{seed}"), vec![("seconds".to_string(), Some(seed as f64))]));
    let rows = rows(&table_csv(&table(), &timing, &vec![], column_of_setting));
    assert_eq!(rows.len(), 7);
    let names = "row ours points psnr_n psnr_mean psnr_std psnr_difference psnr_verdict psnr_published";
    assert_eq!(cells(&rows[0], names), ["NeRF", "false", "3", "3", "25", "0.125", "", "", "25.17"]);
    assert_eq!(cells(&rows[1], names), ["Aug-NeRF", "false", "3", "3", "25.5", "0.25", "0.5", "higher", "26.51"]);
    assert_eq!(cells(&rows[4], names), ["output & only", "true", "1", "1", "25", "", "0.125", "", ""]);
    assert_eq!(cells(&rows[6], names), ["Aug-NeRF", "false", "1", "0", "", "", "", "", ""]);
    assert_eq!(cells(&rows[0], "width height steps seconds_mean"), ["101", "76", "2000", "0.5"]);
    let quoted = "quoted from the NeRF paper, 1008x752, width 256, 8 layers, 64 + 128 samples, 4096 rays a step";
    assert_eq!(rows[0]["published_protocol"], format!("{quoted}, 17 views trained on and 3 evaluated"));
    let low: f64 = rows[1]["psnr_low"].parse().unwrap();
    assert_eq!(low, table().lines[1].cells[0].comparison.unwrap().interval.unwrap().0);
}

/// Fields that all points share, and those that none has, are no columns; with the constants every field is read back.
#[test]
fn csvs_hold_what_varies_and_are_read_back_whole() {
    let mut records = records();
    for (record, number) in records.iter_mut().zip(10..).filter(|(record, _)| record.status == Status::Done) {
        let is_attacked = record.row == "Aug-NeRF";
        for (name, text) in [
            ("data_hash", if record.scene == "fern" { "7797e1855047" } else { "123456789012" }),
            ("lambda", if is_attacked { "0.1" } else { "" }),
            ("attack_numbers", if is_attacked { "t 3/0.01/0.5, feature 1/0.5/2" } else { "" }),
            ("masks", ""),
            ("set.perturb.t.steps", if is_attacked { "3" } else { "" }),
            ("injection_layer", if is_attacked { "4" } else { "" }),
            ("set.perturb.injection_layer", if is_attacked { "4" } else { "" }),
        ] {
            record.result.protocol.push((name.into(), text.into()));
        }
        record.id = format!("{number}e456789012");
    }
    // A point in two lines.
    records[9].id = records[3].id.clone();
    let shared = constants(&records);
    let text_of = |name: &str| shared.iter().find(|(known, _)| known == name).map(|(_, text)| text.as_str());
    assert_eq!([text_of("code_revision"), text_of("steps"), text_of("masks")], [Some("abc"), Some("2000"), None]);
    let csv = points_csv(&records, &[], &shared, column_of_setting);
    let found = rows(&csv);
    let head: Vec<&str> = csv.lines().next().unwrap().split(',').collect();
    let first =
        ["id", "scene", "row", "axes", "set.perturb.t.steps", "set.perturb.injection_layer", "position", "positions"];
    assert_eq!(head[..8], first);
    let absent =
        ["code_revision", "average_vgg", "masks", "lambda", "attack_numbers", "perturb.t.steps", "injection_layer"];
    assert!(!absent.iter().any(|name| head.contains(name)), "{head:?}");
    let names = "id data_hash perturb_lambda perturb.t.epsilon perturb.feature.steps position positions";
    assert_eq!(cells(&found[0], names), ["h10e456789012", "h7797e1855047", "0.1", "0.5", "1", "1", "1"]);
    assert_eq!(cells(&found[3], names), ["h13e456789012", "h7797e1855047", "", "", "", "1", "2"]);
    assert_eq!(cells(&found[9], names)[5..], ["2", "2"]);
    let axes = |text: &str| records.iter().find(|r| r.label() == format!("{}, {text}", r.row)).map(|r| r.axes.clone());
    let read =
        |csv: &str, shared| {
            read_points(csv, shared, &[], column_of_setting, |at| {
                if at.axes.is_empty() { Some(vec![]) } else { axes(at.axes) }
            })
            .unwrap()
        };
    // Columns of constants are read alike.
    for (csv, constants) in [(&csv, &shared), (&points_csv(&records, &[], &vec![], column_of_setting), &vec![])] {
        let again = read(csv, constants);
        assert_eq!(again.len(), records.len());
        for (read, record) in again.iter().zip(&records) {
            let place = |r: &Record| {
                (r.id.clone(), r.label(), r.seed, r.status, r.reason.clone(), r.result.inactive_levels.clone())
            };
            assert_eq!((place(read), read.metric("psnr").is_some()), (place(record), record.status == Status::Done));
            for (name, text) in record.result.protocol.iter().filter(|(name, _)| name != "seed") {
                assert_eq!(read.protocol(name), text, "{name}");
            }
        }
        assert_eq!(points_csv(&again, &[], constants, column_of_setting), **csv);
    }
    let table = table_of(&TableSpec { must_match: vec![], ..spec() }, &records);
    let lines = rows(&table_csv(&table, &[], &shared, column_of_setting));
    assert_eq!(cells(&lines[1], "row set.perturb.t.steps psnr_mean"), ["Aug-NeRF", "3", "25.5"]);
    assert!(!["code_revision", "mixed", "average_vgg_mean", "width"].iter().any(|name| lines[1].contains_key(*name)));
}

/// What holds for few seeds is said of these, and heads no page.
#[test]
fn what_is_said_of_a_row_holds_for_most_of_its_seeds() {
    let by_colour = "sites that move the rendered colours by less than half an 8-bit step on average";
    let few =
        ["- 1 of 4 seeds learned nothing: NeRF (seed 3)", "at most half of the seeds: NeRF (t with 2 of 4 seeds)"];
    let most = ["- ‖ no better than one colour: NeRF (with 3 of 4 seeds)", "average: NeRF (t)"];
    for (lost, inactive, mark, notes, cell) in [(1, 2, "NeRF", few, "t:2/4"), (3, 4, "NeRF †‖", most, "t")] {
        let records = [0, 1, 2, 3].map(|seed| {
            let mut record = point("fern", "NeRF", seed, 20.0);
            let floor = if seed < 4 - lost { 12.0 } else { 20.5 };
            record.result.metrics.push(("floor_psnr".into(), Some(floor)));
            record.result.protocol.push(("inactive_by".into(), "colour".into()));
            record.result.inactive_levels = if seed < inactive { vec!["t".into()] } else { vec![] };
            record
        });
        let table = table_of(&TableSpec { rows: vec![row("NeRF", None, "NeRF")], ..spec() }, &records);
        let markdown = table_markdown(&table);
        assert!(markdown.contains(&format!("| {mark} | ")), "{markdown}");
        assert!(notes.iter().all(|note| markdown.lines().any(|line| line.ends_with(note))), "{notes:?}: {markdown}");
        assert_eq!(csv_of(&table)[0]["inactive_levels"], cell);
        let heads = warnings(&table).join("\n");
        assert_eq!(heads.contains("‖ no better than one colour: 1 row"), lost == 3, "{heads}");
        assert_eq!(heads.contains(by_colour), inactive == 4, "{heads}");
    }
}

/// Depth over a row's own pixels compares rows on different ones.
#[test]
fn a_verdict_on_depth_over_own_pixels_comes_with_a_note() {
    let note = |metric: &str| {
        let spec = TableSpec { metrics: vec![metric.into()], ..spec() };
        let mut records = records();
        records.iter_mut().flat_map(|record| &mut record.result.metrics).for_each(|(name, _)| *name = metric.into());
        table_markdown(&table_of(&spec, &records)).contains("on different pixels")
    };
    assert!(note("depth_mae") && note("depth_rmse"));
    assert!(!note("depth_mae_common") && !note("psnr"));
}

#[test]
fn markdown_tells_everything_beside_the_numbers() {
    let text = table_markdown(&table());
    for line in [
        "**Which level helps?** (tab4)",
        "### fern",
        "All rows: dataset llff, width 101, height 76, steps 2000, code_revision abc",
        "| row | psnr | psnr difference | psnr in the paper | average_vgg | average in the paper, of an unknown backbone |",
        "|---|---:|---:|---:|---:|---:|",
        "| NeRF | 25.00 ± 0.12 (3) |  | 25.17 |  | 0.073 |",
        "| Aug-NeRF † | 25.50 ± 0.25 (3) | +0.50 [+0.19, +0.81], p 0.040, higher | 26.51 |  | 0.054 |",
        "| + TV Reg., features steps = 3 § | 25.00 ± 0.71 (2) | +0.06 [-5.50, +5.62], p 0.910, not distinguishable | \
         26.05 |  | 0.062 |",
        "- baseline: NeRF",
        "| output & only \\* | 25.00 (1) | +0.12, no interval |  |  |  |",
        "- \\* not in the paper: output & only",
        "- † sites without effect on the loss: Aug-NeRF (rgb with 2 of 3 seeds)",
        "- sites that are inactive with at most half of the seeds: Aug-NeRF (density with 1 of 3 seeds)",
        "- § points without numbers: + TV Reg., features steps = 3 (done 2, failed 1: collapsed \\| at step 7)",
        "- in the paper, NeRF: quoted from the NeRF paper, 1008x752, width 256, 8 layers, 64 + 128 samples, 4096 rays \
         a step, 17 views trained on and 3 evaluated; here 101x76 instead of 1008x752",
        "### chair",
        "| Aug-NeRF § |  |  |  |  |  |",
        "- § points without numbers: Aug-NeRF (no data 1: chair is not on this machine)",
    ] {
        assert!(text.lines().any(|found| found == line), "{line}\n\n{text}");
    }
}

#[test]
fn latex_is_escaped_and_closed() {
    let text = table_latex(&table());
    let words = [
        "\\raggedleft PSNR (dB) $\\uparrow$}",
        "\\raggedright Aug-NeRF $\\dagger$ & {\\textbf{\\boldmath 25.50 $\\pm$ 0.25 (3)}} & {26.51} & {} & {0.054} \\\\\n",
        "\\raggedright Aug-NeRF $\\dagger$ & {\\textbf{\\boldmath +0.50 [+0.19, +0.81]}} & {0.040} & {} & {} \\\\\n",
        "\\raggedright output \\& only *",
        "\\midrule\n\\multicolumn{5}{l}{\\emph{chair}} \\\\\n",
        "\\bottomrule\n\\end{tabular}",
        "\\usepackage{booktabs}",
    ];
    assert_says(&text, &words);
    // Nothing but what passes Holm's correction is bold.
    assert_eq!(text.matches("\\textbf").count(), 2, "{text}");
    for environment in ["table", "tabular", "minipage"] {
        let count = |what: &str| text.matches(&format!("\\{what}{{{environment}}}")).count();
        assert_eq!(count("begin"), count("end"), "{environment}");
    }
    assert_eq!(text.matches("\\begin{table}").count(), 2, "means and differences");
}

#[test]
fn terminal_tables_fit_their_width() {
    let text = table_terminal(&table(), 60);
    let drawn = text.lines().filter(|line| line.starts_with(['─', '═', ' ']));
    assert!(drawn.clone().count() > 20 && drawn.into_iter().all(|line| line.chars().count() <= 60), "{text}");
    let text = table_terminal(&table(), 180);
    assert_says(&text, &["25.50 ± 0.25 (3)", "paper 26.51", "Aug-NeRF †", "p 0.910, not distinguishable"]);
    assert_says(&text, &["* not in the paper", "average 0.054", "unknown backbone", "p 0.040, higher"]);
}

#[test]
fn methods_that_are_not_run_carry_the_paper_s_numbers_alone() {
    let mut spec = spec();
    let key = PublishedKey { table: "tab1".into(), condition: "clean".into(), method: "SRN".into() };
    let srn = RowSpec { name: "SRN".into(), quoted: true, published: Some(key), ..RowSpec::default() };
    spec.rows.insert(0, srn);
    let table = table_of(&spec, &records());
    let line = find(&table, "fern", "SRN");
    assert_eq!((line.cells[0].mean, line.cells[0].n, line.cells[0].published), (None, 0, Some(21.37)));
    // The paper has no such row for the other scene.
    assert_eq!(table.lines.iter().filter(|line| line.quoted).count(), 1);
    let rows = csv_of(&table);
    assert_eq!(cells(&rows[0], "row source psnr_mean psnr_published"), ["SRN", "published", "", "21.37"]);
    assert_eq!(cells(&rows[1], "source"), ["run"]);
    let markdown = table_markdown(&table);
    assert!(markdown.contains("SRN #") && markdown.contains("not run here"), "{markdown}");
}

/// One rule in every format: "higher" and "lower" by Holm's p, nothing where the interval alone leaves out 0.
#[test]
fn words_are_the_same_in_every_format_and_follow_holm() {
    // The second is sure; of the others the interval leaves out 0 and three comparisons are too many for that.
    let gains = [
        ("NeRF", [0.0, 0.0, 0.0]),
        ("Aug-NeRF", [0.5, 0.51, 0.49]),
        ("+ TV Reg.", [0.1, 0.14, 0.18]),
        ("output & only", [-0.1, -0.14, -0.18]),
    ];
    let of_row = |(row, gains): (&str, [f64; 3])| {
        [0, 1, 2].map(|seed| point("fern", row, seed, 25.0 + seed as f64 + gains[seed as usize]))
    };
    let mut records: Vec<Record> = gains.into_iter().flat_map(of_row).collect();
    let table = table_of(&spec(), &records);
    let csv = csv_of(&table);
    let verdicts: Vec<&str> = csv.iter().map(|row| row["psnr_verdict"].as_str()).collect();
    assert_eq!(verdicts, ["", "higher", "", ""]);
    assert!(!csv[0].contains_key("psnr_equivalent"), "no equivalence without a margin");
    // LaTeX says it by bold numbers: the mean and the difference.
    assert_eq!(table_latex(&table).matches("\\textbf").count(), 2, "{}", table_latex(&table));
    for text in [table_markdown(&table), table_terminal(&table, 200)] {
        let differences: Vec<&str> = text.lines().filter(|line| line.contains("[+") || line.contains("[-")).collect();
        let said = ["higher", "lower", "not distinguishable"]
            .map(|word| differences.iter().filter(|line| line.contains(word)).count());
        assert_eq!(said, [1, 0, 0], "{text}");
    }
    // A margin is stated: what lies within is equivalent, whether it differs or not.
    let mut spec = spec();
    spec.equivalence = vec![("psnr".into(), 0.6)];
    records.retain(|record| record.row != "+ TV Reg.");
    let table = table_of(&spec, &records);
    let csv = csv_of(&table);
    let names = "psnr_margin psnr_verdict psnr_equivalent";
    assert_eq!(cells(&csv[0], names), ["", "", ""]);
    assert_eq!(cells(&csv[1], names), ["0.6", "higher", "true"]);
    // Of two comparisons the second passes, too.
    assert_eq!(cells(&csv[2], names), ["0.6", "lower", "true"]);
    assert!(csv[1]["psnr_p_equivalence_holm"].parse::<f64>().unwrap() < 0.05);
    let latex = table_latex(&table);
    assert_eq!(latex.matches(" $\\approx$} ").count(), 2, "{latex}");
    // The difference down is sure, and none that is better.
    assert_eq!(latex.matches("\\textbf").count(), 3, "{latex}");
    for text in [table_markdown(&table), table_terminal(&table, 200)] {
        assert_eq!(text.matches("higher, equivalent within 0.60").count(), 1, "{text}");
        assert_eq!(text.matches("equivalent within 0.60").count(), 2, "{text}");
    }
}

/// Ten step sizes that all land on the set's corners are one experiment, which Holm's correction counts once.
#[test]
fn the_same_training_under_two_names_is_one_comparison() {
    let gains = |name: &str| if name == "3" { [0.3, 0.2, 0.25] } else { [0.5, 0.52, 0.45] };
    let mut records: Vec<Record> = (0..3).map(|seed| point("fern", "NeRF", seed, 25.0)).collect();
    for name in ["1", "2", "3"] {
        let at = |(gain, seed)| at_steps(point("fern", "Aug-NeRF", seed, 25.0 + gain), name);
        records.extend(gains(name).into_iter().zip(0..).map(at));
    }
    let table = table_of(&spec(), &records);
    let p = |index: usize| table.lines[index].cells[0].comparison.map(|c| (c.p.unwrap(), c.p_holm.unwrap())).unwrap();
    assert_eq!(p(1), p(2));
    assert_eq!(p(1).1, 2.0 * p(1).0);
}

/// Not only what captions tell: two rows whose fields differ in nothing but octaves, or rates, are not alike.
#[test]
fn what_training_differs_in_is_said_and_the_rate_stands_in_the_caption() {
    let mut records = records();
    for record in records.iter_mut().filter(|record| record.status == Status::Done) {
        let octaves = if record.row == "Aug-NeRF" { "16" } else { "6" };
        record.result.protocol.push(("learning_rate".into(), "0.0005 to 0.000005".into()));
        record.result.protocol.push(("position_octaves".into(), octaves.into()));
        record.result.protocol.push(("lambda".into(), octaves.into()));
    }
    let markdown = table_markdown(&table_of(&spec(), &records));
    assert!(markdown.contains("rows differ in position_octaves: 6 (NeRF"), "{markdown}");
    assert!(markdown.contains("learning_rate 0.0005 to 0.000005"), "{markdown}");
    // What rows are named for is not told again, nor what all of them share.
    assert!(!markdown.contains("rows differ in lambda") && !markdown.contains("view_octaves"), "{markdown}");
}

/// The manipulation check of a noise sweep, whichever of both rows is compared with the other.
#[test]
fn tables_say_what_a_corruption_costs_the_baseline() {
    let noisy = |mut record: Record| {
        record.result.protocol.push(("corruption".into(), "gaussian-noise 3 (std 0.18)".into()));
        record
    };
    let records = || -> Vec<Record> {
        let seeds = (0..3).zip([25.0, 24.875, 25.125]).zip([24.5, 24.375, 24.75]);
        let pair = |((seed, clean), corrupted)| {
            [point("fern", "clean", seed, clean), noisy(point("fern", "NeRF", seed, corrupted))]
        };
        seeds.flat_map(pair).chain([noisy(point("fern", "Aug-NeRF", 0, 24.0))]).collect()
    };
    let note = |rows: Vec<RowSpec>| -> Vec<String> {
        let spec = TableSpec { rows, metrics: vec!["psnr".into()], must_match: vec![], ..spec() };
        let text = table_markdown(&table_of(&spec, &records()));
        text.lines().filter(|line| line.contains("cost of")).map(String::from).collect()
    };
    // Differences 0.5, 0.5 and 0.375: mean 0.4583, standard error 0.0417, Student t of two degrees of freedom 4.303.
    let cost = "- cost of gaussian-noise 3 (std 0.18) to NeRF: psnr +0.46 [+0.28, +0.64] (clean minus corrupted, paired by seed, 95 % interval)";
    let rows = |of_clean| {
        vec![row_against("clean", of_clean), row_against("NeRF", None), row_against("Aug-NeRF", Some("NeRF"))]
    };
    assert_eq!(note(rows(Some("NeRF"))), [cost]);
    assert!(note(rows(None)).is_empty());
}
