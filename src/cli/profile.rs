//! `augnerf profile`.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use crate::base::files::AtomicDir;
use crate::base::{Error, Result};
use crate::compare::{Profile, Profiles, RunView, Window, check_overlay, check_profiled, patch_around};
use crate::draw::SVG_ALONE;
use crate::run::{RunDir, Viewer};
use crate::runtime::Runtime;

use super::answer::Answer;
use super::compare::{NamedRun, Runs, pictures_folder};
use super::progress::Console;
use super::{Compute, numbers, whole};

#[derive(Args)]
pub struct ProfileArguments {
    #[command(flatten)]
    runs: Runs,
    /// Column and row of the pixel, from 0 [default: the view's middle]
    #[arg(long, value_name = "X,Y", help_heading = "Experiment")]
    pixel: Option<String>,
    /// Side of the square of pixels around it whose rays are also plotted
    #[arg(
        long,
        value_name = "N",
        default_value_t = 8,
        value_parser = whole::<u8>(1..=16),
        help_heading = "Experiment"
    )]
    patch: u8,
    /// Output folder, new or empty [default: RUN/renders/profile of the first run, replaced]
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    out: Option<PathBuf>,
    #[command(flatten)]
    answer: Answer,
    #[command(flatten)]
    compute: Compute,
}

impl ProfileArguments {
    pub fn run(self) -> Result<()> {
        let runs = self.runs.named()?;
        check_overlay(runs.len())?;
        self.out.as_deref().map_or(Ok(()), AtomicDir::check_vacant)?;
        let pixel = self.pixel.as_deref().map(parse_pixel).transpose()?;
        self.compute.run(|runtime, console| self.profile(&runs, pixel, runtime, console))
    }

    fn profile(
        &self,
        runs: &[NamedRun],
        named: Option<(usize, usize)>,
        runtime: &Runtime,
        console: &Console,
    ) -> Result<()> {
        let place = |run: &RunView| -> Result<((usize, usize), Window)> {
            let size = (run.view.camera.width, run.view.camera.height);
            let pixel = named.unwrap_or((size.0 / 2, size.1 / 2));
            Ok((pixel, patch_around(pixel, usize::from(self.patch), size)?))
        };
        let measure = |viewer: &Viewer, run: &RunView| {
            let (pixel, patch) = place(run)?;
            Profile::measure(viewer, run, pixel, patch)
        };
        // Before anything is rendered.
        for NamedRun { path, label, .. } in runs {
            check_profiled(label, &RunDir::open(path)?.read_config()?)?;
        }
        let (runs, folders) = self.runs.gather(runs, runtime, console, measure)?;
        runs.iter().try_for_each(|(run, _)| run.check_same_interval(&runs[0].0))?;
        let (pixel, patch) = place(&runs[0].0)?;
        let (folder, pictures) = pictures_folder(self.out.as_deref(), folders[0].renders().join("profile"))?;
        let profiles = Profiles { runs, pixel, patch };
        profiles.write(pictures.path())?;
        pictures.commit()?;
        console.say(&format!("profile of pixel ({}, {})", pixel.0, pixel.1));
        SVG_ALONE.into_iter().for_each(|note| console.say(note));
        let answer = json!({ "folder": folder.display().to_string(), "profile": profiles.json() });
        self.answer.give_place(&answer, &folder)
    }
}

fn parse_pixel(text: &str) -> Result<(usize, usize)> {
    let [x, y] = numbers(text).ok_or_else(|| {
        Error::Config(format!("--pixel {text}: not two numbers; give column and row, such as 120,80"))
    })?;
    Ok((x, y))
}
