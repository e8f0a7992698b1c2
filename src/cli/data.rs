//! `augnerf data`.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use crate::config::{build, parse_assignment};
use crate::data::builtin::export;
use crate::error::Result;
use crate::evaluate::split_name;
use crate::job::load_scene;

use super::progress::{Screen, print};

#[derive(Subcommand)]
pub enum DataCommand {
    /// Say what a scene folder holds and how it would be used
    Check(CheckArguments),
    /// Write the embedded scene in Blender format, with exact depth and mesh
    ExportBuiltin(ExportArguments),
}

#[derive(Args)]
pub struct CheckArguments {
    /// Scene folder [default: the embedded scene]
    dir: Option<PathBuf>,
    /// Settings of section data, as in training: --set data.downscale=4
    #[arg(long, value_name = "FIELD=VALUE")]
    set: Vec<String>,
    /// No progress bar
    #[arg(long, short)]
    quiet: bool,
}

#[derive(Args)]
pub struct ExportArguments {
    /// New or empty folder
    dir: PathBuf,
    /// Width and height of the views in pixels
    #[arg(long, default_value_t = export::DEFAULT_WIDTH, value_name = "PIXELS")]
    width: usize,
}

impl DataCommand {
    pub fn run(self) -> Result<()> {
        match self {
            DataCommand::Check(arguments) => arguments.run(),
            DataCommand::ExportBuiltin(arguments) => {
                let exported = export::export(&arguments.dir, arguments.width)?;
                print(&format!(
                    "{}: {} pictures, {} depth maps, a mesh of {} triangles",
                    arguments.dir.display(),
                    exported.pictures,
                    exported.depths,
                    exported.triangles
                ));
                Ok(())
            }
        }
    }
}

impl CheckArguments {
    fn run(self) -> Result<()> {
        let mut assignments = self.set.iter().map(|text| parse_assignment(text)).collect::<Result<Vec<_>>>()?;
        if let Some(dir) = &self.dir {
            let dir = toml::Value::String(dir.to_string_lossy().into_owned());
            assignments.push((vec!["data".into(), "dir".into()], dir));
        }
        let mut config = build(None, None, &assignments)?;
        let scene = load_scene(&mut config, &Screen::new(self.quiet))?;
        let split = ("split".to_string(), split_name(&config));
        for (label, value) in scene.describe().into_iter().chain([split]) {
            print(&format!("{label:>16}  {value}"));
        }
        Ok(())
    }
}
