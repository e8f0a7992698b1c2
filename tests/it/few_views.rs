//! The script of the comparison over scenes: words as its plan defines them. Python 3 runs it.

use std::path::Path;
use std::process::Command;

use csv::StringRecord;
use tempfile::TempDir;

use crate::common::assert_says;
use crate::common::files::text;
use crate::common::program::demand;

const RESULTS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/results/few_views");
const SCENES: [&str; 6] = ["capture_fruit", "colmap_canclip", "dtu_scan24", "dtu_scan65", "builtin-1", "builtin-2"];

/// The script; `None` without Python.
fn script() -> Option<Command> {
    if Command::new("python3").arg("--version").output().is_err() {
        eprintln!("left out: no python3 is here to run scenes_answer.py");
        return None;
    }
    let mut command = Command::new("python3");
    command.arg(format!("{RESULTS}/scenes_answer.py"));
    Some(command)
}

/// Changes a CSV file's lines; those for which `change` returns false are left out.
fn rewrite(from: &Path, to: &Path, mut change: impl FnMut(&dyn Fn(&str) -> usize, &mut Vec<String>) -> bool) {
    let mut reader = csv::Reader::from_path(from).unwrap();
    let mut head = reader.headers().unwrap().clone();
    // Points that all ended have no reasons.
    let is_added = from.ends_with("points.csv") && !head.iter().any(|name| name == "reason");
    if is_added {
        head.push_field("reason");
    }
    let column = |name: &str| head.iter().position(|known| known == name).unwrap();
    let lines: Vec<StringRecord> = reader.records().map(Result::unwrap).collect();
    let mut writer = csv::Writer::from_path(to).unwrap();
    writer.write_record(&head).unwrap();
    for line in lines {
        let mut cells: Vec<String> = line.iter().chain(is_added.then_some("")).map(String::from).collect();
        if change(&column, &mut cells) {
            writer.write_record(&cells).unwrap();
        }
    }
    writer.flush().unwrap();
}

/// A comparison of some scenes and rows, whose PSNR is a level of the scene and a gain of the row.
struct Trial {
    dir: TempDir,
}

impl Trial {
    fn new() -> Trial {
        let dir = TempDir::new().unwrap();
        let (from, to) = (Path::new(RESULTS).join("scenes"), dir.path().join("scenes"));
        std::fs::create_dir(&to).unwrap();
        for file in ["sweep.toml", "provenance.toml", "points.json"] {
            std::fs::copy(from.join(file), to.join(file)).unwrap();
        }
        let gain = |row: &str| match row {
            "NeRF" | "Draws, as far" | "Smoothing of positions" => Some(0.0),
            "NeRF, fewer steps" => Some(-1.0),
            "+ occlusion" => Some(2.0),
            "+ TV" => Some(2.1),
            "Aug-NeRF calibrated" => Some(1.0),
            _ => None,
        };
        let mut ids = Vec::new();
        rewrite(&from.join("points.csv"), &to.join("points.csv"), |column, cells| {
            let place = SCENES.iter().position(|scene| *scene == cells[column("scene")]);
            let (Some(place), Some(gain)) = (place, gain(&cells[column("row")])) else { return false };
            ids.push(cells[column("id")].clone());
            // Rows differ over scenes, too, or tests would have no spread.
            let spread = 0.05 * ((place as f64 + 1.0) * (gain + 2.0)).sin();
            cells[column("psnr")] = (20.0 + place as f64 + gain + spread).to_string();
            true
        });
        rewrite(&from.join("timing.csv"), &to.join("timing.csv"), |column, cells| ids.contains(&cells[column("id")]));
        rewrite(&from.join("attack.csv"), &to.join("attack.csv"), |column, cells| {
            SCENES.contains(&cells[column("scene")].as_str()) && gain(&cells[column("row")]).is_some()
        });
        Trial { dir }
    }

    fn change(&self, file: &str, change: impl FnMut(&dyn Fn(&str) -> usize, &mut Vec<String>) -> bool) {
        let path = self.dir.path().join("scenes").join(file);
        rewrite(&path, &path, change);
    }

    fn answer(&self, code: i32) -> Option<String> {
        let mut command = script()?;
        command.current_dir(self.dir.path()).env("AUGNERF", env!("CARGO_BIN_EXE_augnerf"));
        Some(demand(command.envs([("TRIAL", "1"), ("SCENES", "scenes"), ("OVER", "over")]), code))
    }

    #[track_caller]
    fn assert_words(said: &str, row: &str, words: &str) {
        let line = said.lines().find(|line| line.starts_with(&format!("| {row} |"))).expect(row);
        assert_eq!(line.split('|').map(str::trim).nth(6), Some(words), "{line}");
    }
}

#[test]
fn rows_have_the_words_of_the_plan() {
    let trial = Trial::new();
    let Some(said) = trial.answer(0) else { return };
    Trial::assert_words(&said, "+ occlusion", "helps; matters; recommended; above fewer steps");
    // A tenth of a decibel above occlusion, which costs less.
    Trial::assert_words(&said, "+ TV", "helps; matters; above fewer steps");
    Trial::assert_words(&said, "NeRF, fewer steps", "harms; a gain of 0.3 dB is ruled out");
    // Above both controls, but the draws do not move colours as far.
    Trial::assert_words(&said, "Aug-NeRF calibrated", "helps; matters; above fewer steps");
    Trial::assert_words(&said, "SAM", "not tested");
    trial.change("attack.csv", |column, cells| {
        ["t", "xyz", "feature", "rgb", "density"]
            .iter()
            .for_each(|site| cells[column(&format!("shift.{site}"))] = "1".into());
        true
    });
    let said = trial.answer(0).unwrap();
    Trial::assert_words(&said, "Aug-NeRF calibrated", "helps; matters; the worst case helps; above fewer steps");
    assert!(trial.dir.path().join("over_psnr/over_scenes.svg").exists());
}

#[test]
fn trainings_that_went_non_finite_are_said_and_no_table_is_lost() {
    let trial = Trial::new();
    let fails = |row: &'static str, scene: &'static str, reason: &'static str| {
        trial.change("points.csv", |column, cells| {
            if cells[column("row")] == row && cells[column("scene")] == scene && cells[column("seed")] == "1" {
                cells[column("status")] = "failed".into();
                cells[column("reason")] = reason.into();
                cells[column("psnr")] = String::new();
            }
            true
        });
    };
    fails("+ TV", "dtu_scan24", "run: diverged at step 10: the loss is NaN");
    fails("NeRF", "builtin-2", "run: diverged at step 10: the loss is NaN");
    let Some(said) = trial.answer(0) else { return };
    assert_says(&said, &["5 scenes.", "| + TV | | | | | failed: dtu_scan24 | |", "NeRF failed on builtin-2"]);
    let disagree = "t test and sign test disagree (uncorrected p 5.4e-07 and 0.062)";
    let words = format!("helps; matters; recommended; above fewer steps; {disagree}");
    Trial::assert_words(&said, "+ occlusion", &words);
    // A point that the machine ended says nothing of its row, and the tables stay as they were.
    let table = text(&trial.dir.path().join("over_psnr/over_scenes.csv"));
    fails("+ occlusion", "dtu_scan65", "killed");
    assert_says(&trial.answer(1).unwrap(), &["is failed (killed)", "once all points have ended"]);
    assert_eq!(table, text(&trial.dir.path().join("over_psnr/over_scenes.csv")));
    let mut without = script().unwrap();
    without.current_dir(trial.dir.path()).envs([("AUGNERF", "/nowhere/augnerf"), ("TRIAL", "1"), ("OVER", "over")]);
    assert_says(&demand(without.env("SCENES", format!("{RESULTS}/scenes")), 1), &["/nowhere/augnerf is not there"]);
    assert_eq!(table, text(&trial.dir.path().join("over_psnr/over_scenes.csv")));
}
