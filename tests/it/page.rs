//! The page of a sweep or of runs: whole, escaped, the same twice.

use augnerf::base::Image;
use augnerf::report::page::{Film, Page, ShownScene, ViewOfRow, ViewOfScene};
use augnerf::report::tables::{AttackLine, Table};
use augnerf::report::{AxisValue, Record, RowSpec, TableSpec};

use crate::common::program::{Place, set};
use crate::common::{assert_says, record, row_against};

const ROOT: &str = env!("CARGO_MANIFEST_DIR");
/// A name that is a script where it is not escaped.
pub const ROW: &str = "<script>document.title = 'run'</script>\" onload=\"x";

/// Three rows with three seeds each: the second better than the first, the third not.
fn table() -> (Table, Vec<Record>) {
    let gains = [("NeRF", [0.0, 0.0, 0.0]), (ROW, [0.5, 0.51, 0.49]), ("TV", [0.1, -0.2, 0.05])];
    let point = |row: &str, seed: u64, psnr: f64| {
        let metrics = [("psnr", Some(psnr)), ("ssim", Some(psnr / 40.0)), ("lpips_vgg", None)];
        let protocol = [("scene", "fern"), ("width", "8"), ("steps", if row == "TV" { "20" } else { "10" })];
        Record { id: format!("{}-{seed}", row.len()), ..record("fern", row, seed, &metrics, &protocol) }
    };
    let of_row = |(row, gains): (&str, [f64; 3])| -> Vec<Record> {
        gains.into_iter().zip(0..).map(|(gain, seed)| point(row, seed, 20.0 + seed as f64 + gain)).collect()
    };
    let records: Vec<Record> = gains.into_iter().flat_map(of_row).collect();
    let row = |name: &str| row_against(name, (name != "NeRF").then_some("NeRF"));
    let spec = TableSpec {
        name: "tiny".into(),
        title: "Tiny & <b>bold</b>".into(),
        metrics: ["psnr", "ssim", "lpips_vgg"].map(String::from).to_vec(),
        rows: gains.iter().map(|(name, _)| row(name)).collect(),
        ..TableSpec::default()
    };
    (Table::new(&spec, &records, false).unwrap(), records)
}

fn value(axis: &str, value: &str) -> AxisValue {
    AxisValue { axis: axis.into(), panel: String::new(), value: value.into() }
}

/// A description of a table of PSNR.
fn spec_of(rows: Vec<RowSpec>) -> TableSpec {
    TableSpec { metrics: vec!["psnr".into()], rows, ..TableSpec::default() }
}

fn page_without_pictures(spec: &TableSpec, records: &[Record]) -> String {
    let table = &Table::new(spec, records, false).unwrap();
    let logged = |column: &str| if column == "shift.view" { vec![0.1] } else { vec![] };
    let page = Page {
        table,
        records,
        files: &[],
        views: vec![],
        films: vec![],
        meshes: vec![],
        attacks: table.lines.iter().filter_map(|line| AttackLine::of(line, |_, column| logged(column))).collect(),
        timing: &[],
        link: &|_| None,
    };
    page.html().unwrap()
}

/// The page of [`table`] with pictures of one view, curves, and an attack.
pub fn page() -> String {
    let (table, records) = table();
    let flat = |value: f32| Image { width: 8, height: 6, channels: 3, pixels: vec![value; 8 * 6 * 3] };
    let row = |(index, label): (usize, &str)| ViewOfRow {
        label: label.into(),
        seed: 0,
        image: flat(0.2 * (index + 1) as f32),
        depth: vec![1.0 + index as f32; 48],
    };
    let view = ViewOfScene {
        scene: "fern".into(),
        view: "image000".into(),
        truth: flat(0.9),
        mask: None,
        rows: ["NeRF", ROW, "TV"].into_iter().enumerate().map(row).collect(),
        left_out: vec![],
    };
    let svg = |text: &str| {
        let start = "<svg height=\"9\" viewBox=\"0 0 9 9\" width=\"9\" xmlns=\"http://www.w3.org/2000/svg\">";
        format!("{start}<text x=\"0\" y=\"9\">{text}</text></svg>").into_bytes()
    };
    let files = [
        ("curves_fern_psnr.svg".to_string(), svg("along steps")),
        ("curves_fern_psnr.txt".into(), b"Training on fern\nLines are means.\n".to_vec()),
    ];
    let attack = AttackLine::of(&table.lines[1], |_, column| match column {
        "gain.xyz" => vec![1e-3, 3e-3],
        "shift.xyz" => vec![0.75],
        _ => vec![],
    });
    let attacks = vec![attack.unwrap()];
    let sites = &attacks[0].sites;
    assert_eq!((sites.len(), sites[0].site, sites[0].whole[0]), (1, "xyz", Some(2e-3)));
    let link = |id: &str| Some(format!("./../points/{id}/run/"));
    let views = vec![ShownScene::new(&view, 1).unwrap()];
    let films = vec![Film::new("TV", 0, "rgb.gif", b"GIF89a")];
    let meshes = vec![Film::new("TV", 0, "mesh.png", b"PNG")];
    Page { table: &table, records: &records, files: &files, views, films, meshes, attacks, timing: &[], link: &link }
        .html()
        .unwrap()
}

/// What stands between two texts of a page.
fn part<'a>(page: &'a str, start: &str, end: &str) -> &'a str {
    page.split(start).nth(1).unwrap().split(end).next().unwrap()
}

/// The texts of an attribute.
fn attributes<'a>(page: &'a str, name: &str) -> Vec<&'a str> {
    page.split(&format!(" {name}=\"")).skip(1).filter_map(|rest| rest.split('"').next()).collect()
}

#[test]
fn the_page_fetches_nothing_and_runs_nothing_but_its_own_script() {
    let page = page();
    assert_eq!(page, self::page(), "the same bytes twice");
    let sources = [attributes(&page, "src"), attributes(&page, "href")].concat();
    assert!(sources.len() > 15, "{sources:?}");
    let own = ["data:image/jpeg;base64,", "data:image/gif;base64,", "data:image/png;base64,", "#", "./"];
    assert!(sources.iter().all(|address| own.iter().any(|start| address.starts_with(start))), "{sources:?}");
    assert!(!sources.iter().any(|address| address.contains("http")), "{sources:?}");
    assert_eq!(page.matches("<script").count(), 1, "names are escaped");
    assert!(!page.contains("\" onload=\"x") && !page.contains("<b>bold"));
    assert_says(&page, &["default-src 'none'", "script-src 'sha256-", "&#60;script&#62;"]);
    // The one rule: the second row's PSNR and SSIM alone are better.
    assert_eq!(page.matches("<b>").count(), 2, "{page}");
    let words =
        ["lpips_vgg: empty, no LPIPS weights", "9 done", "▲ better", "no difference is shown", "+0.50 [+0.48, +0.52]"];
    assert_says(&page, &words);
}

/// Captions are words, and videos play without the network.
#[test]
fn the_page_has_captions_and_shows_videos() {
    let page = page();
    let caption = "<strong>Training on fern</strong> Lines are means. <code>curves_fern_psnr<";
    assert_says(&page, &[caption, "media-src data:", "data:image/gif;base64,R0lGODlh", "TV, seed 0"]);
    // What people look at first stands first, and a mesh is shown as films are.
    let places = ["views", "films", "meshes", "figures"].map(|part| page.find(&format!("id=\"{part}\"")).unwrap());
    assert!(places.is_sorted(), "{places:?}");
    assert_says(&page, &["alt=\"mesh of TV\"", "<code>mesh.png</code>"]);
    // No box scrolls within the page.
    assert!(page.contains("9 points</summary>") && !page.contains("overflow-y"));
    assert_says(&page, &["scroll sideways for more", "rows.length > 2 ? 1 : 0"]);
}

/// Two points of one training have one row, and what all rows share is said once.
#[test]
fn a_training_has_one_row_and_a_fact_one_line() {
    let point = |(id, axis): (&str, AxisValue), seed: u64| {
        let protocol = [("inactive_by", "colour"), ("data_hash", &format!("hash {seed}"))];
        let mut record = record("fern", "Aug-NeRF", seed, &[("psnr", Some(20.0 + seed as f64))], &protocol);
        record.result.inactive_levels = vec!["view".into()];
        Record { id: format!("{id}{seed}"), axes: vec![axis], ..record }
    };
    let places =
        [("a", value("steps", "3")), ("a", value("epsilon", "0.06274509803921569")), ("b", value("steps", "1"))];
    let records: Vec<Record> = places.iter().flat_map(|place| [0, 1].map(|seed| point(place.clone(), seed))).collect();
    let page = page_without_pictures(&spec_of(vec![row_against("Aug-NeRF", None)]), &records);
    for table in ["class=\"results", "id=\"attack\""] {
        assert_eq!(part(&page, table, "</table>").matches("<th scope=\"row\">").count(), 2, "{table}");
    }
    assert_says(part(&page, "class=\"results", "</table>"), &["the same training: epsilon = 0.06275"]);
    let first = part(&page, "<h2>Read first</h2>", "</section>");
    assert_says(first, &["on average: 2 of 2 rows", "¶ settings that differ between seeds: 2 of 2 rows"]);
    assert_eq!(first.matches("<li>").count(), 2, "{first}");
}

/// Rows over three scenes: the second gains on all of them.
#[test]
fn rows_are_compared_over_scenes() {
    let page_of = |scenes: &[&str]| {
        let point = |scene: &str, row, seed, psnr| record(scene, row, seed, &[("psnr", Some(psnr))], &[]);
        let of_scene = |(index, scene): (usize, &&str)| {
            let (level, gain) = (20.0 + 4.0 * index as f64, 1.0 + 0.01 * index as f64);
            [0, 1].map(|seed| [point(scene, "NeRF", seed, level), point(scene, "TV", seed, level + gain)]).concat()
        };
        let records: Vec<Record> = scenes.iter().enumerate().flat_map(of_scene).collect();
        page_without_pictures(&spec_of(vec![row_against("NeRF", None), row_against("TV", Some("NeRF"))]), &records)
    };
    let page = page_of(&["a", "b", "c"]);
    let words = ["PSNR over 3 scenes, minus NeRF", "<svg", "+1.01 [+0.99, +1.03]", "3, 0", "class=\"better\">higher"];
    assert_says(part(&page, "id=\"over\"", "</section>"), &words);
    assert!(page.find("id=\"over\"").unwrap() < page.find("id=\"table\"").unwrap());
    assert!(!page_of(&["a", "b"]).contains("id=\"over\""), "two scenes are not compared over");
}

#[test]
fn committed_results_become_a_page_without_their_runs() {
    let place = Place::new();
    let report = format!("report {ROOT}/results/checks/smoke");
    place.says(&format!("{report} --out a.html"), 0, &["page: "]);
    let page = place.text("a.html");
    let words = ["rows_builtin_psnr", "curves_builtin_psnr", "<h2>Attack</h2>", "textLength", "\\begin{table}"];
    assert_says(&page, &words);
    // Written over itself; nothing else is.
    place.run(&format!("{report} --out a.html"), 0);
    assert_eq!(page, place.text("a.html"));
    place.write("a.html", "my notes");
    place.says(&format!("{report} --out a.html"), 4, &["not a page of this program"]);
    place.says("report /nowhere", 5, &["cannot open run /nowhere"]);
    place.says(&format!("{report} /nowhere"), 2, &["smoke: a sweep's results", "name them alone"]);
    place.says(&format!("{report} --out a.png"), 2, &["--out a.png: the page is HTML", "report.html"]);
    assert!(!place.at("report.html").exists() && !place.at("a.png").exists());
}

/// A training of four steps, with settings such as its seed.
fn train(place: &Place, out: &str, settings: &str) {
    let small = "data.width=16 field.width=16 train.rays=32 train.steps=4 train.log_every=2 eval.pictures=1";
    place.run(&format!("train --quiet --preset smoke --out {out}{}{}", set(small), set(settings)), 0);
}

/// Two seeds of NeRF and one of Aug-NeRF.
fn trained() -> Place {
    Place::once("page", |place| {
        for (out, settings) in [("a0", "seed=0"), ("a1", "seed=1"), ("b0", "method=aug-nerf")] {
            train(place, out, settings);
        }
    })
}

/// A page shows no run under the numbers of another, or of other views.
#[test]
fn a_run_is_shown_with_its_own_numbers() {
    let place = trained();
    let metrics = |run: &str| place.text(&format!("{run}/metrics.json"));
    let own = metrics("a1");
    for (further, words) in [
        ("--out a1", "--out a1: another run"),
        ("--out a0 --split train", "--out a0: the run itself"),
        ("--out ./a0/ --step 4", "--out ./a0/: the run itself"),
    ] {
        place.says(&format!("eval a0 -q {further}"), 4, &[words, "name another folder"]);
    }
    let before = metrics("a0");
    place.run("eval a0 -q --out a0", 0);
    place.run("eval a0 -q --split train --out elsewhere", 0);
    assert_eq!((metrics("a0"), metrics("a1")), (before.clone(), own.clone()));
    // As earlier versions left them.
    for (forged, words) in [
        (before, "its seed is 0, that of config.toml is 1"),
        (own.replace("\"config_hash\": \"", "\"config_hash\": \"0"), "its config_hash is 0"),
        (own.replace("\"split\": \"test\"", "\"split\": \"train\""), "it is of training views"),
    ] {
        assert!(forged != own, "{words}");
        place.write("a1/metrics.json", forged);
        let said = ["a1/metrics.json: not the run's own evaluation", words, "`augnerf eval a1`"];
        place.says("report a0 a1", 5, &said);
    }
    place.run("eval a1 -q", 0);
    assert_eq!(metrics("a1"), own);
    place.run("report a0 a1", 0);
}

/// Runs of one configuration and two seeds are one row; its view, and seconds where asked for.
#[test]
fn runs_become_a_page() {
    let place = trained();
    let report = |further: &str| {
        let said = place.run(&format!("report {further} --out page.html"), 0);
        (said, place.text("page.html"))
    };
    let (_, page) = report("a0 a1 b0");
    let words = ["3 done", "data-name=\"nerf\"", "data-name=\"aug-nerf\"", "href=\"./b0/\"", "<h2>Attack</h2>"];
    assert_says(&page, &words);
    assert!(!page.contains("data-name=\"a0\"") && !page.contains("seconds training"));
    assert_eq!(page, report("a0 a1 b0").1, "the same bytes twice");
    let (_, timed) = report("a0 a1 b0 --with-timing --label NeRF --label NeRF --label Ours");
    assert_says(&timed, &["seconds training", "data-name=\"NeRF\"", "data-name=\"Ours\""]);
    // PSNR of one colour is the same for all rows: its figure says nothing.
    assert_says(&page, &["rows_builtin_psnr", "Below each mean: the difference"]);
    assert!(!page.contains("rows_builtin_floor_psnr"));
    // A run alone is beside nothing: no figure of rows, no word of differences.
    let (_, alone) = report("a0");
    assert!(!alone.contains("rows_builtin_psnr") && !alone.contains("difference to the baseline"));
    // Other settings of one method are told; what nothing tells apart goes by its folder. Terms have short names.
    train(&place, "c0", "train.learning_rate=0.002");
    train(&place, "d0", "seed=0");
    train(&place, "tv", "regularizer.kind=tv regularizer.weight=8e-5");
    let (said, _) = report("a0 c0");
    assert_says(&said, &["nerf (train.learning_rate 0.005)", "nerf (train.learning_rate 0.002)"]);
    let (said, page) = report("a0 d0 b0");
    assert_says(&page, &["data-name=\"a0\"", "data-name=\"d0\"", "data-name=\"aug-nerf\""]);
    assert!(!said.contains("(train."), "{said}");
    // A run's mesh is shown.
    place.run("mesh tv -q --resolution 16 --threshold 0.01", 0);
    let (said, page) = report("a0 tv");
    assert_says(&said, &["nerf + tv 8e-5"]);
    assert!(!said.contains("regularizer.") && said.find("page: page.html") < said.find("psnr"), "{said}");
    assert_says(&page, &["alt=\"mesh of nerf + tv 8e-5\""]);
    place.says("report a0 a1 --label x", 2, &["--label: 1 labels for 2 runs"]);
}
