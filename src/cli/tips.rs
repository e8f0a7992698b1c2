//! Tips for command lines with unknown flags, words or commands.

use std::ffi::OsString;
use std::num::IntErrorKind;

use clap::error::{ContextKind, ContextValue, ErrorKind};

use crate::settings::registry::settings_called;

/// What is said of a word that means nothing: it may be a mistake, or of an earlier version.
const REPLACED: &str = "if an earlier version had it, CHANGELOG.md says what takes its place";

/// Adds tips to an error: a setting that an unknown flag names, or a flag for a stray word.
/// `words` is the command line without the program.
pub fn with_tips(mut error: clap::Error, words: &[OsString]) -> clap::Error {
    if error.kind() == ErrorKind::InvalidUtf8 {
        let odd: Vec<String> =
            words.iter().filter(|word| word.to_str().is_none()).map(|word| format!("{word:?}")).collect();
        let text = format!("not UTF-8: {}; only paths may have such bytes\n", odd.join(", "));
        return meant_command(words).error(ErrorKind::InvalidUtf8, text);
    }
    if error.kind() == ErrorKind::ValueValidation
        && let Some(wrong) = wrong_value(&error)
    {
        return clap::Error::raw(ErrorKind::ValueValidation, wrong);
    }
    if error.kind() == ErrorKind::InvalidSubcommand {
        let (root, command) = (super::command(), meant_command(words));
        let named = if command.get_name() == root.get_name() { "" } else { &format!(" {}", command.get_name()) };
        let tip = format!("`augnerf{named} --help` lists the commands; {REPLACED}");
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![tip.into()]));
    }
    if error.kind() != ErrorKind::UnknownArgument {
        return error;
    }
    // Drops "to pass '--rows' as a value, use '-- --rows'", which a mistyped flag does not mean.
    error.remove(ContextKind::Suggested);
    let Some(ContextValue::String(unknown)) = error.get(ContextKind::InvalidArg).cloned() else { return error };
    let command = meant_command(words);
    let has = |flag: &str| command.get_arguments().any(|argument| argument.get_long() == Some(flag));
    let mut tips = match unknown.strip_prefix("--") {
        Some(name) if command.get_name() == super::command().get_name() => after_subcommand(name, words),
        Some(name) if has("set") => setting_tips(name, &value_of(&unknown, words)),
        None if has("data") && !unknown.starts_with('-') => vec![format!("'--data {unknown}' names a scene")],
        _ => Vec::new(),
    };
    if unknown.starts_with("--") && tips.is_empty() && error.get(ContextKind::SuggestedArg).is_none() {
        tips.push(REPLACED.into());
    }
    if tips.is_empty() {
        return error;
    }
    // A similar flag that clap found, such as '--set' for '--steps', is a worse guess.
    error.remove(ContextKind::SuggestedArg);
    let tips = tips.into_iter().map(Into::into).collect();
    error.insert(ContextKind::Suggested, ContextValue::StyledStrs(tips));
    error
}

/// Returns one sentence for a value that a flag cannot have: the flag, the value, and what is allowed.
fn wrong_value(error: &clap::Error) -> Option<String> {
    let told =
        |kind| error.get(kind).and_then(|told| if let ContextValue::String(text) = told { Some(text) } else { None });
    let (flag, value, source) =
        (told(ContextKind::InvalidArg)?, told(ContextKind::InvalidValue)?, std::error::Error::source(error)?);
    let allowed = match source.downcast_ref::<std::num::ParseIntError>().map(|error| error.kind()) {
        Some(IntErrorKind::PosOverflow) => "too large a number".into(),
        Some(_) => "give a whole number from 0".into(),
        None if source.is::<std::num::ParseFloatError>() => "give a number".into(),
        None => source.to_string(),
    };
    Some(format!("{} {value}: {allowed}\n", flag.split(' ').next()?))
}

/// Returns where a flag belongs that stands before the command which has it.
fn after_subcommand(flag: &str, words: &[OsString]) -> Vec<String> {
    let root = super::command();
    let named = words.iter().find_map(|word| root.find_subcommand(word));
    let has = |command: &&clap::Command| command.get_arguments().any(|argument| argument.get_long() == Some(flag));
    named
        .filter(has)
        .map(|named| format!("it belongs after the command: 'augnerf {} --{flag}'", named.get_name()))
        .into_iter()
        .collect()
}

/// Returns how settings of a flag's name are set: `--learning-rate` is `train.learning_rate`.
fn setting_tips(flag: &str, value: &str) -> Vec<String> {
    let called = settings_called(&flag.replace('-', "_"));
    called.into_iter().map(|setting| format!("it is a setting: '--set {setting}={value}'")).collect()
}

/// Returns the value that follows an unknown flag, or `VALUE`.
fn value_of(flag: &str, words: &[OsString]) -> String {
    let words: Vec<_> = words.iter().map(|word| word.to_string_lossy()).collect();
    let joined = words.iter().find_map(|word| word.strip_prefix(flag)?.strip_prefix('='));
    let next = words.iter().skip_while(|word| **word != flag).nth(1).filter(|next| !next.starts_with("--"));
    joined.or(next.map(|next| &**next)).unwrap_or("VALUE").to_string()
}

/// Returns the command that the first words name.
fn meant_command(words: &[OsString]) -> clap::Command {
    let mut command = super::command();
    for word in words {
        let Some(inner) = word.to_str().and_then(|name| command.find_subcommand(name)).cloned() else { break };
        command = inner;
    }
    command
}
