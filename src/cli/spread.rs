//! `augnerf compare --spread`.

use std::path::PathBuf;

use serde_json::json;

use crate::base::{Error, Result};
use crate::compare::{SeedSet, Spread};
use crate::draw::SVG_ALONE;
use crate::report::{distinct, label};
use crate::runtime::Runtime;
use crate::sweep::{Point, SweepFolder, split_names};

use super::answer::Answer;
use super::compare::{Runs, pictures_folder};
use super::progress::{Console, duration, open_next};

/// The finished seeds of a sweep's row.
pub struct RowSeeds {
    row: String,
    /// Run folders, in the order of the seeds.
    runs: Vec<PathBuf>,
    /// Seeds without a result.
    unfinished: Vec<u64>,
}

impl RowSeeds {
    /// Finds the seeds of the one row that the command line names.
    pub fn of(runs: &Runs) -> Result<RowSeeds> {
        let [folder] = runs.runs.as_slice() else { return Err(no_sweep(&format!("{} folders", runs.runs.len()))) };
        let sweep = SweepFolder::new(folder);
        if !sweep.is_begun() {
            return Err(no_sweep(&folder.display().to_string()));
        }
        let points = sweep.points(None)?.unwrap_or_default();
        let scene = runs.scene_of(&points)?;
        let of_scene = || points.iter().filter(|point| point.scene == scene);
        let rows = distinct(of_scene().flat_map(|point| &point.places).map(|place| label(&place.row, &place.axes)));
        let row = one_row(&runs.rows, &rows)?;
        let is_of_row = |point: &&Point| point.places.iter().any(|place| label(&place.row, &place.axes) == row);
        let mut found = RowSeeds { row: row.clone(), runs: Vec::new(), unfinished: Vec::new() };
        for point in of_scene().filter(is_of_row) {
            let folder = sweep.point(&point.id);
            match folder.result()? {
                Some(_) => found.runs.push(folder.run()),
                None => found.unfinished.push(point.config.seed),
            }
        }
        let (finished, all) = (found.runs.len(), found.runs.len() + found.unfinished.len());
        if finished < 2 {
            return Err(Error::Config(format!(
                "row '{row}': {finished} of its {all} seeds {} finished, and a spread needs at least two; train more with \
                 `augnerf sweep run`, or see `augnerf sweep status {}`",
                if finished == 1 { "is" } else { "are" },
                sweep.path().display()
            )));
        }
        Ok(found)
    }

    /// Renders the seeds, and writes images and numbers.
    pub fn compare(&self, runs: &Runs, out: Option<PathBuf>, answer: Answer, on: (&Runtime, &Console)) -> Result<()> {
        let (runtime, console) = on;
        if !self.unfinished.is_empty() {
            let seeds: Vec<String> = self.unfinished.iter().map(u64::to_string).collect();
            console.say(&format!("not finished, and not included: seeds {}", seeds.join(", ")));
        }
        let set = SeedSet::open(self.row.clone(), &self.runs, runs.data.as_deref(), runtime, console)?;
        let shown = set.find(&runs.view)?;
        let seconds = set.estimate_seconds()?.map_or(String::new(), |it| format!(": about {}", duration(it)));
        let views = if set.views() == 1 { "view" } else { "views" };
        console.say(&format!("{} held-out {views} of {} seeds{seconds}", set.views(), self.runs.len()));
        let spread = set.measure(shown, console)?;
        let (folder, pictures) = pictures_folder(out.as_deref(), set.first().renders().join("spread"))?;
        spread.write(pictures.path())?;
        pictures.commit()?;
        SVG_ALONE.into_iter().for_each(|note| console.say(note));
        summary(&spread).iter().for_each(|line| console.say(line));
        answer.give_place(&json!({ "folder": folder.display().to_string(), "spread": spread.json() }), &folder)?;
        let files = ["spread.png", "spread.svg", "calibration.png"].map(|name| folder.join(name));
        open_next(console, &files, &format!("augnerf sweep collect {}", runs.runs[0].display()));
        Ok(())
    }
}

fn no_sweep(given: &str) -> Error {
    Error::Config(format!(
        "--spread: needs the folder of one sweep, not {given}; name a folder such as runs/NAME, and a row with --row"
    ))
}

/// Returns the only row that is named, or that there is.
fn one_row(named: &[String], rows: &[String]) -> Result<String> {
    let known: Vec<&str> = rows.iter().map(String::as_str).collect();
    match (split_names("--row", named, &known)?.as_slice(), known.as_slice()) {
        ([row], _) => Ok(row.clone()),
        ([], [only]) => Ok(only.to_string()),
        (chosen, _) => {
            let given = if chosen.is_empty() { "none is".to_string() } else { format!("{} are", chosen.len()) };
            let rows: Vec<String> = rows.iter().map(|row| format!("'{row}'")).collect();
            Err(Error::Config(format!(
                "--spread: needs one row, and {given} named; name one with --row: {}",
                rows.join(", ")
            )))
        }
    }
}

/// Returns the result in two lines, and what the spread includes apart from the seed.
fn summary(spread: &Spread) -> Vec<String> {
    let number =
        |key: &str, digits: usize| spread.mean.get(key).map_or("-".into(), |value| format!("{value:.digits$}"));
    let mut lines = vec![
        format!(
            "PSNR: mean image {} dB, single seeds {} dB; SSIM: {} and {}",
            number("psnr_of_mean", 2),
            number("psnr_of_seeds", 2),
            number("ssim_of_mean", 3),
            number("ssim_of_seeds", 3)
        ),
        format!(
            "spread {}, error of the mean image {}; Spearman's correlation {}; AUSE {} (constant spread: {})",
            number("spread_rms", 4),
            number("error_rms", 4),
            number("spearman", 2),
            number("ause", 3),
            number("ause_constant", 3)
        ),
    ];
    if let Some(names) = spread.difference_names() {
        lines.push(format!("the seeds also differ in {names}: the spread includes this"));
    }
    if !spread.skipped_views.is_empty() {
        lines.push(format!(
            "not rendered: {} views that not all seeds hold out; spread.json lists them",
            spread.skipped_views.len()
        ));
    }
    lines
}
