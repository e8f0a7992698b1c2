use super::*;
use crate::report::{AxisValue, PointResult, Record, RowSpec, Status, TableSpec};

fn measured(metric: &str, value: Option<f64>) -> PointResult {
    PointResult { metrics: vec![(metric.into(), value)], ..PointResult::default() }
}

fn record(scene: &str, row: &str, seed: u64, psnr: Option<f64>) -> Record {
    Record {
        id: format!("{scene}-{row}-{seed}"),
        scene: scene.into(),
        row: row.into(),
        seed: Some(seed),
        status: if psnr.is_some() { Status::Done } else { Status::Waiting },
        result: measured("psnr", psnr),
        ..Record::default()
    }
}

/// Returns the table of a metric's records, whose rows are compared with NeRF.
fn table_of(name: &str, (metric, margin): (&str, f64), records: &[Record]) -> Table {
    let row = |name: &str| RowSpec {
        name: name.into(),
        baseline: (name != "NeRF").then(|| "NeRF".into()),
        ..RowSpec::default()
    };
    let spec = TableSpec {
        name: name.into(),
        metrics: vec![metric.into()],
        rows: distinct(records.iter().map(|record| record.row.as_str())).into_iter().map(row).collect(),
        equivalence: vec![(metric.into(), margin)],
        ..TableSpec::default()
    };
    Table::new(&spec, records, false).unwrap()
}

/// Returns a sweep with these differences, seed by seed; for `lacking` seeds the baseline has not been trained yet.
fn sweep(name: &str, differences: &[f64], lacking: usize) -> Table {
    let of_seed = |(seed, difference): (usize, &f64)| {
        let baseline = Some(20.0).filter(|_| seed >= lacking);
        [record("fern", "NeRF", seed as u64, baseline), record("fern", "TV", seed as u64, Some(20.0 + difference))]
    };
    let records: Vec<Record> = differences.iter().enumerate().flat_map(of_seed).collect();
    table_of(name, ("psnr", 0.3), &records)
}

fn over_sweeps(tables: &[Table]) -> Comparisons {
    Comparisons::over_sweeps("TV", "NeRF", tables, &[])
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

fn over_scenes(records: &[Record]) -> Comparisons {
    Comparisons::over_scenes("NeRF", &[table_of("scenes", ("psnr", 0.3), records)])
}

#[track_caller]
fn says(text: &str, parts: &[&str]) {
    parts.iter().for_each(|part| assert!(text.contains(part), "'{part}' is not in {text}"));
}

#[test]
fn p_values_are_corrected_over_the_sweeps_and_intervals_widened() {
    let tables = [sweep("a", &[0.5, 0.55, 0.45, 0.52], 0), sweep("b", &[0.01, -0.02, 0.03, -0.01], 0)];
    let all = over_sweeps(&tables);
    let [a, b] = &all.lines[..] else { panic!("two lines") };
    let (own, of_a) = (tables[0].lines[1].cells[0].comparison.unwrap(), a.comparison.unwrap());
    // The smaller of two p values is doubled, the other stays.
    assert_eq!(of_a.p_holm, Some(2.0 * own.p.unwrap()));
    assert_eq!(b.comparison.unwrap().p_holm, b.comparison.unwrap().p);
    // t of 3 degrees of freedom: scipy.stats.t.ppf([0.975, 0.9875], 3) = 3.182446305283718, 4.176534846187437
    let ratio = (of_a.simultaneous.unwrap().1 - of_a.difference) / (of_a.interval.unwrap().1 - of_a.difference);
    assert!((ratio - 4.176534846187437 / 3.182446305283718).abs() < 1e-6, "{ratio}");
    assert_eq!((all.is_ruled_out(a), all.is_ruled_out(b)), (Some(false), Some(true)));
    // Less is better: a value far above 0 is no gain, and one near 0 is no gain of the margin.
    let less = Comparisons { metric: "lpips_squeeze".into(), ..all.clone() };
    assert_eq!((less.is_ruled_out(a), less.is_ruled_out(b)), (Some(true), Some(true)));
    let words = ["| fern, a | 4 | +0.50 [", "| higher |", "equivalent within 0.3, a gain of 0.3 is ruled out |"];
    says(&all.markdown(), &words);
    let csv = all.csv();
    assert!(csv.starts_with("sweep,scene,") && csv.lines().count() == 3, "{csv}");
}

#[test]
fn a_baseline_that_lacks_a_point_leaves_the_comparison_unfinished() {
    let all = over_sweeps(&[sweep("a", &[0.5, 0.55, 0.45], 1)]);
    let line = &all.lines[0];
    let status = "done 3; NeRF: waiting 1, done 2";
    assert_eq!((line.comparison.unwrap().pairs, line.unfinished.as_deref()), (2, Some(status)));
    says(&all.markdown(), &["UNFINISHED: done 3; NeRF: waiting 1, done 2"]);
    assert_eq!(over_sweeps(&[sweep("a", &[0.5, 0.55], 0)]).lines[0].unfinished, None);
}

#[test]
fn one_sweep_is_itself_and_a_single_seed_claims_nothing() {
    let tables = [sweep("a", &[0.5, 0.55, 0.45], 0)];
    let own = tables[0].lines[1].cells[0].comparison.unwrap();
    let found = over_sweeps(&tables).lines[0].comparison.unwrap();
    assert_eq!((found.p_holm, found.interval), (own.p, own.interval));
    let (wide, plain) = (found.simultaneous.unwrap(), own.interval.unwrap());
    assert!((wide.0 - plain.0).abs() < 1e-12 && (wide.1 - plain.1).abs() < 1e-12);
    let single = over_sweeps(&[sweep("a", &[0.5], 0)]);
    let line = &single.lines[0];
    assert_eq!((line.comparison.unwrap().simultaneous, single.is_ruled_out(line)), (None, None));
    assert!(single.csv().lines().nth(1).unwrap().ends_with(",,0.3,,,,"), "{}", single.csv());
}

#[test]
fn seeds_that_learned_nothing_are_said() {
    let mut records = records();
    for record in &mut records {
        let lost = record.scene == "b" && (record.row == "NeRF" || (record.row == "TV" && record.seed == Some(1)));
        record.result.metrics.push(("floor_psnr".into(), Some(if lost { 40.0 } else { 5.0 })));
    }
    let found = over_scenes(&records);
    let counts = &found.lines[0].over.as_ref().unwrap().no_better_than_one_colour;
    assert_eq!(counts[..], [Some((0, 2)), Some((1, 2)), Some((0, 2)), Some((0, 2))]);
    let note = "- NO BETTER THAN ONE COLOUR on held-out views: NeRF on b with 2 of 2 seeds\n- no better than one colour with at \
                most half of the seeds: TV on b with 1 of 2 seeds\n";
    says(&found.markdown(), &[note]);
    let ends = |found: &Comparisons, end: &str| {
        found.scenes_csv().lines().any(|line| line.starts_with("b,TV,") && line.ends_with(end))
    };
    assert!(ends(&found, ",1"));
    let unmeasured = over_scenes(&self::records());
    assert!(!unmeasured.markdown().contains("ONE COLOUR") && ends(&unmeasured, ","));
}

#[test]
fn the_best_row_comes_first() {
    let mut found = over_scenes(&records());
    let names = |found: &Comparisons| found.best_first().iter().map(|line| line.name.clone()).collect::<Vec<String>>();
    assert_eq!(names(&found), ["TV", "attack"]);
    found.metric = "lpips_vgg".into();
    assert_eq!(names(&found), ["attack", "TV"]);
    found.lines[1].comparison = None;
    assert_eq!(names(&found), ["TV", "attack"]);
}

#[test]
fn a_scene_counts_once() {
    let all = records();
    let found = over_scenes(&all);
    let comparison = found.lines[0].comparison.unwrap();
    assert_eq!(comparison.pairs, 4);
    assert!((comparison.difference - 1.16).abs() < 1e-12, "{comparison:?}");
    // A third seed of one scene, equal to the mean of its others, changes no mean.
    let third = |row: &str, from: f64| record("b", row, 7, Some(23.0 + from));
    let more = [all, vec![third("NeRF", 0.0), third("TV", 1.11), third("attack", -0.61)]].concat();
    let again = over_scenes(&more).lines[0].comparison.unwrap();
    assert!((again.difference - comparison.difference).abs() < 1e-12);
    assert_eq!(again.pairs, 4);
    // The same training under another name is no further test.
    let twin = records().into_iter().filter(|record| record.row == "TV");
    let twin = twin.map(|record| Record { row: "TV again".into(), ..record });
    let with_twin = over_scenes(&records().into_iter().chain(twin).collect::<Vec<Record>>());
    let p = |line: usize| with_twin.lines[line].comparison.unwrap().p_holm;
    assert_eq!((p(0), p(2)), (comparison.p_holm, comparison.p_holm));
}

#[test]
fn where_less_is_better_the_best_has_the_least() {
    let as_lpips = |record: Record| Record {
        result: measured("lpips_squeeze", record.metric("psnr").map(|psnr| psnr / 100.0)),
        ..record
    };
    let records: Vec<Record> = records().into_iter().map(as_lpips).collect();
    let found = Comparisons::over_scenes("NeRF", &[table_of("scenes", ("lpips_squeeze", 0.003), &records)]);
    let [tv, attack] = &found.lines[..] else { panic!("two rows") };
    // The attack has the least.
    assert_eq!((to_best(attack).0, to_best(tv).1), (0.0, 0.0));
    assert_eq!((found.matters(attack), found.is_ruled_out(tv)), (Some(true), Some(true)));
}

#[test]
fn a_baseline_with_axes_is_that_of_the_same_values() {
    let axes = |value: &str| vec![AxisValue { axis: "steps".into(), panel: String::new(), value: value.into() }];
    let of = |value: &str, more: f64| -> Vec<Record> {
        let raised = |mut record: Record| {
            let psnr = record.metric("psnr").map(|psnr| psnr + if record.row == "NeRF" { more } else { 0.0 });
            record.result = measured("psnr", psnr);
            Record { axes: axes(value), ..record }
        };
        records().into_iter().map(raised).collect()
    };
    let found = over_scenes(&[of("10", 0.0), of("20", 0.5)].concat());
    let names: Vec<&str> = found.lines.iter().map(|line| line.name.as_str()).collect();
    assert_eq!(names, ["TV, steps = 10", "TV, steps = 20", "attack, steps = 10", "attack, steps = 20"]);
    let of = |line: usize| found.lines[line].comparison.unwrap().difference;
    assert!((of(0) - of(1) - 0.5).abs() < 1e-12, "{} {}", of(0), of(1));
}

#[test]
fn words_follow_the_rule() {
    let found = over_scenes(&records());
    let [tv, attack] = &found.lines[..] else { panic!("two rows") };
    assert_eq!((found.matters(tv), found.is_ruled_out(tv)), (Some(true), Some(false)));
    assert_eq!((found.matters(attack), found.is_ruled_out(attack)), (Some(false), Some(true)));
    // Holm: the smaller p is doubled.
    let p: Vec<_> = [tv, attack].map(|line| line.comparison.unwrap()).into();
    assert_eq!(p[0].p_holm, Some(2.0 * p[0].p.unwrap().min(p[1].p.unwrap())));
    let words =
        ["| TV | 4 | +1.16 [", "higher, matters |", "lower, a gain of 0.3 is ruled out |", "| d | +1.31 | -0.81 |"];
    says(&found.markdown(), &words);
    // TV is the best, the others are not.
    assert_eq!((to_best(tv).0, found.baseline_to_best.unwrap().1, to_best(attack).1), (0.0, 0.0, 0.0));
}

fn to_best(line: &Compared) -> (f64, f64) {
    line.over.as_ref().unwrap().to_best.unwrap()
}

#[test]
fn a_missing_scene_is_said_and_ranks_nothing() {
    let mut records = records();
    for record in records.iter_mut().filter(|record| record.scene == "d" && record.row == "TV") {
        *record = self::record("d", "TV", record.seed.unwrap(), None);
    }
    let found = over_scenes(&records);
    let line = &found.lines[0];
    assert_eq!((line.place[5].1.as_str(), line.comparison.unwrap().pairs), ("2", 3));
    assert_eq!((line.over.as_ref().unwrap().to_best, found.baseline_to_best), (None, None));
    says(&found.markdown(), &["UNFINISHED: 2 pairs of scene and seed lack a number", "| d |  | -0.81 |"]);
    says(&found.scenes_csv(), &["d,TV,NeRF,psnr,0,,"]);
}
