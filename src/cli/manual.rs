//! `augnerf completions` and `augnerf man`, both made from the definition of the command line.

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::builder::PossibleValuesParser;
use clap::{Args, Command, ValueHint};
use clap_complete::Shell;
use clap_mangen::Man;

use crate::base::files::write_atomic;
use crate::base::{Error, Result};
use crate::metrics::Metric;
use crate::settings::registry::REGISTRY;
use crate::settings::{Method, Preset};
use crate::sweep::SHIPPED;

use super::progress::{print, printed};

pub const COMPLETIONS_EXAMPLES: &str = "Examples:
  augnerf completions bash > ~/.local/share/bash-completion/completions/augnerf
  augnerf completions zsh > ~/.zfunc/_augnerf  # with ~/.zfunc in fpath before compinit
  augnerf completions fish > ~/.config/fish/completions/augnerf.fish";

pub const MAN_EXAMPLES: &str = "Examples:
  augnerf man ~/.local/share/man/man1  # then: man augnerf-train
  augnerf man man                      # pages for a package";

#[derive(Args)]
pub struct CompletionsArguments {
    /// Shell
    #[arg(value_enum)]
    shell: Shell,
}

#[derive(Args)]
pub struct ManArguments {
    /// Folder for augnerf.1 and a page for each command; created if missing
    dir: PathBuf,
}

impl CompletionsArguments {
    pub fn run(self) -> Result<()> {
        let mut script = Vec::new();
        clap_complete::generate(self.shell, &mut with_values(super::command()), "augnerf", &mut script);
        let mut out = std::io::stdout();
        printed(out.write_all(&script).and_then(|()| out.flush()))
    }
}

/// Adds the values that flags may have. The parser itself does not know them: its messages are shorter than those of the
/// flags' own checks.
fn with_values(command: Command) -> Command {
    let is_new = command.get_name() == "new";
    command.mut_subcommands(with_values).mut_args(|flag| {
        let values: Vec<&'static str> = match flag.get_long() {
            Some("preset") => Preset::ALL.iter().map(|(name, _)| *name).collect(),
            Some("method") => Method::ALL.iter().map(|method| method.name()).collect(),
            // Once in a process that only prints them.
            Some("set") => REGISTRY.settings.iter().map(|setting| &*format!("{}=", setting.path).leak()).collect(),
            Some("metric" | "metrics") => Metric::in_tables().map(|metric| metric.key).collect(),
            Some("device") => vec!["cpu", "gpu", "cuda", "cuda-tf32", "metal"],
            Some("scenes") => vec!["builtin", "builtin-forward"],
            Some("from") if is_new => SHIPPED.iter().map(|(name, _)| *name).collect(),
            // Names in a folder that is not known yet: no files.
            Some("rows" | "row" | "baseline" | "seeds" | "name") => return flag.value_hint(ValueHint::Other),
            _ => return flag,
        };
        flag.value_parser(PossibleValuesParser::new(values))
    })
}

impl ManArguments {
    pub fn run(self) -> Result<()> {
        std::fs::create_dir_all(&self.dir).map_err(|e| Error::unwritable(&self.dir, &e))?;
        let mut command = super::command().disable_help_subcommand(true);
        command.build();
        let pages = write_pages(&command, &self.dir)?;
        print(&format!("{}: {pages} pages", self.dir.display()))
    }
}

/// Writes the pages of a command and its subcommands, and returns their number.
fn write_pages(command: &Command, dir: &Path) -> Result<usize> {
    let man = Man::new(command.clone());
    write_atomic(&dir.join(man.get_filename()), &page(&man, command).expect("memory takes everything"))?;
    let inner = command.get_subcommands().filter(|inner| !inner.is_hide_set());
    inner.map(|inner| write_pages(inner, dir)).try_fold(1, |pages, further| Ok(pages + further?))
}

/// Returns a page whose examples keep their line breaks, unlike those of [`Man::render`].
fn page(man: &Man, command: &Command) -> std::io::Result<Vec<u8>> {
    let mut page = Vec::new();
    man.render_title(&mut page)?;
    man.render_name_section(&mut page)?;
    write_synopsis(command, &mut page)?;
    man.render_description_section(&mut page)?;
    man.render_options_section(&mut page)?;
    if command.has_subcommands() {
        man.render_subcommands_section(&mut page)?;
    }
    if let Some(text) = command.get_after_long_help().or(command.get_after_help()) {
        let text = text.to_string();
        let (title, rest) = match text.split_once('\n').filter(|(head, _)| head.starts_with("Example")) {
            Some((_, rest)) => ("EXAMPLES", rest),
            None => ("NOTES", text.as_str()),
        };
        writeln!(page, ".SH {title}")?;
        write_text(rest, &mut page)?;
    }
    if command.get_version().is_some() {
        man.render_version_section(&mut page)?;
    }
    Ok(page)
}

/// Writes the synopsis, in which flags have their values, unlike that of [`Man`].
fn write_synopsis(command: &Command, page: &mut Vec<u8>) -> std::io::Result<()> {
    let plain = |text: &str| text.replace('\\', "\\e").replace('-', "\\-");
    writeln!(page, ".SH SYNOPSIS")?;
    write!(page, "\\fB{}\\fR", plain(command.get_bin_name().unwrap_or(command.get_name())))?;
    for flag in command.get_arguments().filter(|flag| !flag.is_hide_set()) {
        let shown = plain(&flag.to_string());
        write!(
            page,
            " {}",
            if flag.is_required_set() { shown } else { format!("[{}]", shown.trim_matches(['[', ']'])) }
        )?;
    }
    if command.has_subcommands() {
        write!(page, " <command>")?;
    }
    writeln!(page)
}

/// Writes indented lines unchanged and prose as paragraphs.
fn write_text(text: &str, page: &mut Vec<u8>) -> std::io::Result<()> {
    let mut filled = true;
    for line in text.lines() {
        let prose = !line.starts_with(' ');
        if prose != filled {
            writeln!(page, "{}", if prose { ".fi" } else { ".nf" })?;
            filled = prose;
        }
        match line.trim() {
            "" => writeln!(page, ".PP")?,
            text => writeln!(page, "\\&{}", text.replace('\\', "\\e").replace('-', "\\-"))?,
        }
    }
    if filled { Ok(()) } else { writeln!(page, ".fi") }
}
