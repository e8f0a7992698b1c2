//! `augnerf --completions`, made from the definition of the command line.

use std::io::Write;

use clap::builder::PossibleValuesParser;
use clap::{Command, ValueHint};
use clap_complete::Shell;

use crate::base::Result;
use crate::metrics::Metric;
use crate::settings::registry::REGISTRY;
use crate::settings::{Method, Preset};
use crate::sweep::SHIPPED;

use super::progress::printed;

/// Prints a script for a shell.
pub fn print(shell: Option<Shell>) -> Result<()> {
    let shell = shell.expect("clap asks for a command or a shell");
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut with_values(super::command()), "augnerf", &mut script);
    let mut out = std::io::stdout();
    printed(out.write_all(&script).and_then(|()| out.flush()))
}

/// Adds the values that flags may have. The parser itself does not know them: its messages are shorter than those of the
/// flags' own checks.
fn with_values(command: Command) -> Command {
    let is_new = command.get_name() == "new";
    command.mut_subcommands(with_values).mut_args(|flag| {
        let values: Vec<&'static str> = match flag.get_long() {
            Some("preset") => Preset::all().map(|(name, _)| name).collect(),
            Some("method") => Method::ALL.iter().map(|method| method.name()).collect(),
            // Once in a process that only prints them.
            Some("set") => REGISTRY.settings.iter().map(|setting| &*format!("{}=", setting.path).leak()).collect(),
            Some("metric" | "metrics") => Metric::in_tables().map(|metric| metric.key).collect(),
            Some("device") => vec!["cpu", "gpu", "cuda", "cuda-tf32", "metal"],
            Some("scenes") => vec!["builtin", "builtin-forward"],
            Some("from") if is_new => SHIPPED.iter().map(|(name, ..)| *name).collect(),
            // Names in a folder that is not known yet: no files.
            Some("rows" | "row" | "baseline" | "seeds" | "name") => return flag.value_hint(ValueHint::Other),
            _ => return flag,
        };
        flag.value_parser(PossibleValuesParser::new(values))
    })
}
