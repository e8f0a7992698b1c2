//! Tips for command lines with unknown flags, words or commands.

use std::ffi::OsString;

use clap::error::{ContextKind, ContextValue, ErrorKind};

use crate::settings::registry::settings_called;

/// Commands of other programs, and those that do the same here.
const OTHER_COMMANDS: [(&str, &[&str]); 5] = [
    ("evaluate", &["eval"]),
    ("test", &["eval"]),
    ("show", &["view", "render", "report"]),
    ("video", &["render"]),
    ("viewer", &["view", "render"]),
];

/// Adds tips to an error: a setting that an unknown flag names, a flag for a stray word, a command for one of other programs.
/// `words` is the command line without the program.
pub fn with_tips(mut error: clap::Error, words: &[OsString]) -> clap::Error {
    if error.kind() == ErrorKind::InvalidUtf8 {
        let odd: Vec<String> =
            words.iter().filter(|word| word.to_str().is_none()).map(|word| format!("{word:?}")).collect();
        let text = format!("not UTF-8: {}; only paths may have such bytes\n", odd.join(", "));
        return meant_command(words).error(ErrorKind::InvalidUtf8, text);
    }
    if let Some(ContextValue::String(command)) = error.get(ContextKind::InvalidSubcommand)
        && let Some((_, ours)) = OTHER_COMMANDS.iter().find(|(other, _)| other == command)
    {
        error.remove(ContextKind::SuggestedSubcommand);
        let tips = ours.iter().map(|ours| format!("use '{ours}'").into()).collect();
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(tips));
        return error;
    }
    if error.kind() != ErrorKind::UnknownArgument {
        return error;
    }
    // Drops "to pass '--rows' as a value, use '-- --rows'", which a mistyped flag does not mean.
    error.remove(ContextKind::Suggested);
    let Some(ContextValue::String(unknown)) = error.get(ContextKind::InvalidArg).cloned() else { return error };
    let command = meant_command(words);
    let has = |flag: &str| command.get_arguments().any(|argument| argument.get_long() == Some(flag));
    let tips = match unknown.strip_prefix("--") {
        Some(name) if command.get_name() == super::command().get_name() => after_subcommand(name, words),
        Some(name) if has("set") => setting_tips(name, &value_of(&unknown, words)),
        None if has("data") && !unknown.starts_with('-') => vec![format!("'--data {unknown}' names a scene")],
        _ => Vec::new(),
    };
    if !tips.is_empty() {
        // A similar flag that clap found, such as '--set' for '--steps', is a worse guess.
        error.remove(ContextKind::SuggestedArg);
        let tips = tips.into_iter().map(Into::into).collect();
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(tips));
    }
    error
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

#[cfg(test)]
mod tests {
    use super::*;

    fn said(line: &str) -> String {
        let words: Vec<OsString> = line.split(' ').map(OsString::from).collect();
        let program = std::iter::once(OsString::from("augnerf"));
        let error = crate::cli::command().try_get_matches_from(program.chain(words.clone())).unwrap_err();
        with_tips(error, &words).to_string()
    }

    #[test]
    fn a_flag_that_is_a_setting_is_told_how_it_is_set() {
        for (line, tip) in [
            ("train --steps 100", "'--set train.steps=100'"),
            ("train --steps=100 --seed 3", "'--set train.steps=100'"),
            ("train --learning-rate 1e-3", "'--set train.learning_rate=1e-3'"),
            ("train --train.steps", "'--set train.steps=VALUE'"),
            ("sweep run a.toml --width --seeds 1", "'--set data.width=VALUE'"),
            ("train fern", "'--data fern'"),
            ("--threads 1 train", "it belongs after the command: 'augnerf train --threads'"),
        ] {
            let said = said(line);
            assert!(said.contains(tip), "{line}: {said}");
            assert!(!said.contains("-- --") && !said.contains("similar"), "{line}: {said}");
        }
    }

    #[test]
    fn commands_of_other_programs_are_answered_with_those_here() {
        let view = said("viewer runs/a");
        assert!(view.contains("use 'view'") && view.contains("use 'render'") && !view.contains("similar"), "{view}");
        assert!(said("trian").contains("'train'"));
        for (_, ours) in OTHER_COMMANDS {
            assert!(ours.iter().all(|name| crate::cli::command().find_subcommand(name).is_some()), "{ours:?}");
        }
    }

    #[test]
    fn other_flags_are_told_what_is_alike_and_nothing_wrong() {
        assert!(said("train --presett fast").contains("'--preset'"));
        for line in ["sweep status runs/a --rows A", "eval RUN --steps 100", "chamfer A B --rows 1", "train --nothing"]
        {
            let said = said(line);
            assert!(said.contains("unexpected argument") && !said.contains("-- --"), "{line}: {said}");
            assert!(!said.contains("it is a setting"), "{line}: {said}");
        }
    }
}
