//! Answers for scripts: one JSON object on standard output and nothing else there, with the keys of docs/scripting.md. And what
//! shells and manual pages get from the command line.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use crate::common::assert_says;
use crate::common::files::{json, text};
use crate::common::program::{Place, augnerf, demand, set};
use serde_json::Value;

/// A run of a second at 16 x 16.
const TINY: &str = "--preset smoke --set data.width=16 --set field.width=16 --set sampling.coarse=8 --set sampling.fine=8 \
                    --set train.rays=64 --set train.chunk=32 --set train.steps=12 --set train.checkpoint_every=5";

const SWEEP: &str = "title = \"tiny\"\npreset = \"smoke\"\nscenes = [\"builtin\"]\nseeds = [0]\nbaseline = \"NeRF\"\n\
    metrics = [\"psnr\"]\nrow = [{ name = \"NeRF\" }, { name = \"+ TV\", set = { \"regularizer.kind\" = \"tv\" } }]\n[set]\n\
    \"data.width\" = 16\n\"field.width\" = 16\n\"sampling.coarse\" = 8\n\"sampling.fine\" = 8\n\"train.rays\" = 64\n\
    \"train.chunk\" = 32\n\"train.steps\" = 4\n\"eval.pictures\" = 0\n\"regularizer.points_per_step\" = 64\n";

/// The commands, in an order in which each finds what it works on; `TINY` stands for the settings of a run.
const COMMANDS: [&str; 21] = [
    "train --out a TINY",
    "train --out b --seed 1 TINY",
    "resume a",
    "eval a",
    "render a --frames 2",
    "import TAR --out c FEW",
    "compare a b",
    "report a b",
    "mesh a --resolution 16 --threshold 0.01",
    "data check --set data.width=16",
    "data corrupt noisy --set data.corruption.kind=pepper --set data.width=16",
    "data export-builtin scene --width 16",
    "settings steps",
    "sweep new fresh.toml",
    "sweep plan tiny.toml",
    "sweep slurm tiny.toml",
    "sweep run tiny.toml",
    "sweep run-point runs/tiny --index 0",
    "sweep status runs/tiny",
    "sweep collect runs/tiny",
    "verify results/tiny",
];

/// Commands that print JSON in any case, or need more than this test sets up.
const ELSEWHERE: [&str; 3] = ["bench", "score", "sweep across"];

/// The settings of a run put in, and the name of the command.
fn of_run(line: &str) -> (String, String) {
    let words: Vec<&str> = line.split(' ').collect();
    let named = if ["data", "sweep"].contains(&words[0]) { 2 } else { 1 };
    let tar = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/nerf_pytorch.tar");
    let small = "--set data.width=16 --set train.rays=32 --set sampling.coarse=8 --set sampling.fine=8";
    (line.replace("TINY", TINY).replace("TAR", tar).replace("FEW", small), words[..named].join(" "))
}

/// The answer of a command, which is all that it prints.
fn answer(place: &Place, line: &str) -> Value {
    let printed = place.printed(&format!("{} --json", of_run(line).0));
    assert_eq!(printed.lines().count(), 1, "{line}: {printed}");
    serde_json::from_str(&printed).unwrap_or_else(|e| panic!("{line}: {e}: {printed}"))
}

fn page() -> String {
    text(&Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/scripting.md"))
}

/// Keys of each command's answer, as the page has them.
fn documented() -> BTreeMap<String, Vec<String>> {
    let page = page();
    let rows = page.lines().filter(|line| line.starts_with("| `"));
    let codes = |cell: &str| cell.split('`').skip(1).step_by(2).map(String::from).collect::<Vec<_>>();
    rows.map(|row| row.split('|').skip(1).map(codes).collect::<Vec<_>>())
        .map(|cells| (cells[0][0].clone(), cells[1].clone()))
        .collect()
}

#[test]
fn every_answer_as_json_is_one_object_with_the_keys_of_its_page() {
    let place = Place::with("tiny.toml", SWEEP);
    let documented = documented();
    let mut seen = Vec::new();
    for line in COMMANDS {
        let (answer, (_, name)) = (answer(&place, line), of_run(line));
        let keys: Vec<&String> = answer.as_object().unwrap().keys().collect();
        let wanted = documented.get(&name).unwrap_or_else(|| panic!("docs/scripting.md has no row for {name}"));
        assert_eq!(keys, wanted.iter().collect::<Vec<_>>(), "{line}");
        check(&name, &answer, place.path());
        seen.push(name);
    }
    // Flags with which a command answers something else.
    let page = page();
    for (line, keys) in [
        ("eval a --smoothness --lattice 8", "fields"),
        ("train --balance=2 --set regularizer.points_per_step=64 TINY", "scene steps weights"),
        ("compare a --ray 2,2", "folder ray"),
        ("bench --devices", "devices"),
        ("sweep run tiny.toml --create", "folder points"),
    ] {
        let answer = answer(&place, line);
        assert!(answer.as_object().unwrap().keys().eq(keys.split(' ')), "{line}: {answer}");
        let named = |key: &str| page.contains(&format!("`{key}`"));
        assert!(keys.split(' ').all(named), "docs/scripting.md does not name {keys} of {line}");
    }
    seen.extend(ELSEWHERE.map(String::from));
    for (name, command) in crate::common::commands() {
        let takes = command.get_arguments().any(|flag| flag.get_long() == Some("json"));
        let tried = seen.iter().any(|seen| name == format!("augnerf {seen}"));
        assert!(tried || !takes, "{name} takes --json and is not tried");
    }
}

/// What the answers say, beside their keys.
fn check(name: &str, answer: &Value, dir: &Path) {
    match name {
        "train" | "resume" | "eval" => {
            let run = dir.join(answer["run"].as_str().unwrap());
            assert_eq!((&answer["step"], &answer["views"]), (&12.into(), &8.into()));
            assert_eq!(answer["mean"], json(&run.join("metrics.json"))["mean"]);
            assert!(dir.join(answer["metrics"].as_str().unwrap()).is_file());
        }
        "sweep status" => assert!(answer["counts"]["done"] == 2 && answer["points"][1]["psnr"].is_f64(), "{answer}"),
        "sweep run" | "sweep collect" => {
            let rows = answer["rows"].as_array().unwrap();
            assert_eq!((rows.len(), &rows[1]["row"]), (2, &"+ TV".into()), "{answer}");
            assert!(rows[0]["psnr_mean"].is_number() && rows[0]["psnr_difference"].is_null());
        }
        "sweep plan" => assert_eq!((&answer["points"], &answer["ended"]), (&2.into(), &0.into())),
        "verify" => assert_eq!(answer["holds"], true, "{answer}"),
        "data check" => {
            assert_eq!((&answer["width"], answer["training_views"].as_array().unwrap().len()), (&16.into(), 40))
        }
        "settings" => assert_eq!(answer["settings"][0]["changes"], "numbers"),
        _ => {}
    }
}

#[test]
fn a_run_s_folder_is_printed_also_where_nothing_else_is() {
    let place = Place::new();
    let named = place.run(&of_run("train -q TINY --set train.keep_checkpoints=3").0, 0);
    let run = named.strip_suffix('\n').unwrap();
    assert!(place.at(run).join("metrics.json").is_file(), "{named}");

    // Other checkpoints and views leave what the run says of itself.
    let own = place.text(&format!("{run}/metrics.json"));
    let eval = |further: &str| answer(&place, &format!("eval {run} -q {further}"));
    let early = eval("--step 5");
    assert_eq!((&early["step"], &early["split"]), (&5.into(), &"test".into()));
    assert!(place.at(run).join("eval/step_000000005/metrics.csv").is_file());
    let trained = eval("--split train");
    let told = ["split", "views", "training_views"].map(|key| trained[key].clone());
    assert_eq!(told, [Value::from("train"), 40.into(), 0.into()]);
    let val = eval("--split val");
    assert_eq!((&val["split"], &val["step"]), (&"val".into(), &12.into()));
    assert!(val["mean"]["psnr"] != trained["mean"]["psnr"]);
    assert_eq!(place.text(&format!("{run}/metrics.json")), own);
    place.says(&format!("eval {run} --step 6"), 5, &["no checkpoint of step 6", "5, 10, 12"]);
}

/// A script goes on with what a command left, which is all that is printed where it is quiet.
#[test]
fn what_a_command_leaves_is_printed_also_where_nothing_else_is() {
    let place = Place::new();
    let say = |line: &str| {
        let output = place.command(&of_run(line).0).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() && said.is_empty(), "{line}: {said}");
        String::from_utf8(output.stdout).unwrap()
    };
    for (line, left) in [
        ("train -q --out a TINY", "a"),
        ("train -q --out b --seed 1 TINY", "b"),
        ("import -q TAR --out c FEW", "c"),
        ("render -q a --frames 2", "a/renders/path"),
        ("render -q a --write-cameras path.json", "path.json"),
        ("compare -q a b", "a/renders/compare"),
        ("compare -q a b --ray 2,2 --out ray", "ray"),
        ("mesh -q a --resolution 16 --threshold 0.01", "a/mesh"),
    ] {
        assert_eq!(say(line), format!("{left}\n"), "{line}");
        assert!(place.at(left).exists(), "{line}");
    }
}

#[test]
fn training_says_what_it_trains_and_when_it_evaluates() {
    let place = Place::new();
    let train = |further: &str| place.run(&format!("{} {further}", of_run("train TINY").0), 0);
    let said = train("");
    let first = said.lines().next().unwrap();
    assert_eq!(first, "nerf on builtin: 40 views of 16 x 16 pixels, 8 held out; 12 steps of 64 rays");
    let at = |words: &str| said.find(words).unwrap_or_else(|| panic!("{words}: {said}"));
    let places = ["step 12/12", "evaluating: 8 views", "held-out views: PSNR"].map(at);
    assert!(places.is_sorted(), "{said}");
    let with_term = train("--set regularizer.kind=occlusion --out term");
    assert!(with_term.starts_with("nerf + occlusion 0.01 on builtin: "), "{with_term}");
    // Settings without effect, and terms that are far too strong, are named.
    let idle = "perturb.lambda=0.5 regularizer.weight=[] data.corruption.severity=5 data.validation=3 train.steps=13";
    let said = train(&format!("{} --out idle", set(idle)));
    let (before, _) = said.split_once("step 13/13").unwrap();
    assert_says(before, &["--set perturb.lambda has no effect: method nerf has no perturbed pass"]);
    assert_says(before, &["--set data.validation has no effect: the scene has splits of its own"]);
    assert_eq!(said.matches("has no effect").count(), 4, "{said}");
    assert!(!said.contains("times the photometric loss"), "{said}");
    let strong = "regularizer.kind=l1 regularizer.weight=1000 train.learning_rate=1e-9";
    let said = train(&format!("{} --out strong", set(strong)));
    assert_says(&said, &["regularizer l1: weight 1e3 x value is ", "augnerf train --balance"]);
    assert!(!said.contains("has no effect"), "{said}");
}

#[test]
fn a_scene_that_is_not_here_is_looked_for_below_the_data_folder() {
    let place = Place::new();
    for scene in ["synthetic/small", "near"] {
        place.run(&format!("data export-builtin data/{scene} --width 16"), 0);
    }
    let below = |root: &str, line: &str, code| demand(place.command(line).env("AUGNERF_DATA", place.at(root)), code);
    let check =
        |name: &str, code, words: &[&str]| assert_says(&below("data", &format!("data check {name}"), code), words);
    check("near", 0, &["data/near (AUGNERF_DATA)"]);
    check("synthetic/small", 0, &["data/synthetic/small (AUGNERF_DATA)"]);
    check("small", 0, &["data/synthetic/small (AUGNERF_DATA)"]);
    check("nowhere", 3, &["nowhere: no such folder, here or in AUGNERF_DATA"]);
    let words = ["--data nowhere: no such folder", "omit --data for the built-in scene"];
    place.says("train --data nowhere", 3, &words);
    std::fs::create_dir_all(place.at("data/other/small")).unwrap();
    check("small", 3, &["other/small", "synthetic/small"]);
    // What is here comes first.
    std::fs::create_dir(place.at("near")).unwrap();
    assert!(!below("data", "data check near", 3).contains("AUGNERF_DATA"));
    let printed = below("data/synthetic", "train --data small --print-config", 0);
    assert_says(&printed, &["kind = \"blender\"", "(AUGNERF_DATA)"]);
}

#[test]
fn the_version_says_what_was_built() {
    let short = Place::new().printed("-V");
    assert!(short.starts_with("augnerf ") && short.contains(augnerf::base::revision()), "{short}");
    assert_says(&Place::new().printed("--version"), &[augnerf::base::revision(), "features: ", "instructions: "]);
}

#[test]
fn completions_come_from_the_definition() {
    for shell in ["bash", "elvish", "fish", "powershell", "zsh"] {
        let script = Place::new().printed(&format!("--completions {shell}"));
        assert!(script.contains("print-config") && script.contains("export-builtin"), "{shell}");
    }
    assert!(demand(&mut augnerf(&["--completions", "bash", "train"]), 2).contains("cannot be used with"));
    let place = Place::with("augnerf.bash", &Place::new().printed("--completions bash"));
    // What bash does when the tabulator is pressed.
    let ask = |line: &str| {
        let program = format!(
            "source ./augnerf.bash; COMP_WORDS=({line}); COMP_CWORD=$((${{#COMP_WORDS[@]}} - 1)); \
             _augnerf augnerf \"${{COMP_WORDS[COMP_CWORD]}}\" \"${{COMP_WORDS[COMP_CWORD-1]}}\"; echo \"${{COMPREPLY[*]}}\""
        );
        let output = Command::new("bash").args(["-c", &program]).current_dir(place.path()).output();
        output.ok().map(|output| String::from_utf8(output.stdout).unwrap())
    };
    for (line, values) in [
        ("tr", "train"),
        ("train --print", "--print-config"),
        ("train --preset fa", "fast"),
        ("train --set train.eval_s", "train.eval_stride="),
        ("train --method aug-m", "aug-mip-nerf"),
        ("sweep new --from tab4_f", "tab4_fern"),
    ] {
        let Some(answer) = ask(&format!("augnerf {line}")) else { return };
        assert_eq!(answer.trim(), values, "{line}");
    }
}
