//! `augnerf sweep new`.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use crate::base::quoted;
use crate::base::{Error, Result};
use crate::cli::answer::Answer;
use crate::cli::progress::{print, print_shown};
use crate::sweep::{template, write_new};

pub const EXAMPLES: &str = "Examples:
  augnerf sweep new                             # sweep.toml, with every key explained
  augnerf sweep new fern.toml --from tab4_fern  # a copy of a shipped sweep
  augnerf sweep new study.toml --json";

#[derive(Args)]
pub struct NewArguments {
    /// File to write, or - for standard output
    #[arg(default_value = "sweep.toml")]
    file: PathBuf,
    /// Copy this shipped sweep: smoke, tab4_fern, epsilon, ... [default: a commented example]
    #[arg(long, value_name = "NAME")]
    from: Option<String>,
    #[command(flatten)]
    answer: Answer,
}

impl NewArguments {
    pub fn run(self) -> Result<()> {
        if self.file.as_os_str() == "-" {
            if self.answer.json {
                let message = "--json: - prints the sweep file itself; name a file, or omit --json";
                return Err(Error::Config(message.into()));
            }
            return print(template(self.from.as_deref())?.trim_end());
        }
        let written = write_new(&self.file, self.from.as_deref())?;
        let written: Vec<String> = written.iter().map(|path| path.display().to_string()).collect();
        self.answer.give(&json!({ "files": written }), || {
            written.iter().try_for_each(|path| print_shown(path))?;
            let file = quoted(&self.file.display().to_string());
            print("")?;
            print_shown(&format!("next: augnerf sweep plan {file}\n      augnerf sweep run {file}"))
        })
    }
}
