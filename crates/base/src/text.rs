//! Text of unknown origin, made safe for a terminal and readable.

use std::borrow::Cow;

use sha2::{Digest, Sha256};

/// Longest line that is shown completely.
const MOST_LINE: usize = 1000;
/// Most characters of the lines after the first.
const MOST_MORE: usize = 6000;

/// Returns the text without what a terminal would execute or write backwards. Such characters become their codes
/// (`\u{1b}`). The middle of very long lines and the end of very long texts are cut.
pub fn shown(text: &str) -> Cow<'_, str> {
    let plain = |line: &str| line.len() <= MOST_LINE && !line.chars().any(is_command);
    if text.len() <= MOST_MORE && text.split('\n').all(plain) {
        return Cow::Borrowed(text);
    }
    let mut lines = text.split('\n');
    let mut shown = lines.next().map(line).unwrap_or_default();
    let most = shown.len() + MOST_MORE;
    for next in lines.by_ref() {
        if shown.len() > most {
            let more = 1 + lines.count();
            return Cow::Owned(format!("{shown}\n... ({more} more lines)"));
        }
        shown.push('\n');
        shown.push_str(&line(next));
    }
    Cow::Owned(shown)
}

/// Returns the same as one line.
pub fn line(text: &str) -> String {
    let plain = |character: char| match character {
        character if is_command(character) || character == '\n' => character.escape_default().collect(),
        character => String::from(character),
    };
    let whole: String = text.chars().map(plain).collect();
    let length = whole.chars().count();
    if length <= MOST_LINE {
        return whole;
    }
    let (head, tail) = (MOST_LINE * 3 / 4, length - MOST_LINE / 4);
    let part = |from: usize, to: usize| whole.chars().skip(from).take(to - from).collect::<String>();
    format!("{} ... ({} characters) ... {}", part(0, head), tail - head, part(tail, length))
}

/// Returns the first `most` names of a list.
pub fn first_names(names: &[impl AsRef<str>], most: usize) -> String {
    let shown: Vec<&str> = names.iter().take(most).map(AsRef::as_ref).collect();
    shown.join(", ") + if names.len() > most { ", ..." } else { "" }
}

/// Returns a number as people write it: a very large or small one with an exponent, such as 1e30.
pub fn number_text(number: f64) -> String {
    let plain = number == 0.0 || !number.is_finite() || (1e-5..1e16).contains(&number.abs());
    if plain { number.to_string() } else { format!("{number:e}") }
}

/// Returns each item once, in the order of first appearance.
pub fn distinct<T: PartialEq>(items: impl Iterator<Item = T>) -> Vec<T> {
    let mut seen = Vec::new();
    for item in items {
        if !seen.contains(&item) {
            seen.push(item);
        }
    }
    seen
}

/// Quotes a word for a shell, and for Slurm's `#SBATCH` lines.
pub fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "_-./:=,@%+".contains(c);
    if !word.is_empty() && word.chars().all(plain) { word.into() } else { format!("'{}'", word.replace('\'', r"'\''")) }
}

/// Returns whether a character is a control character other than tab, or one that changes the direction of text.
fn is_command(character: char) -> bool {
    let turns = ['\u{200e}', '\u{200f}', '\u{2028}', '\u{2029}'].contains(&character)
        || ('\u{202a}'..='\u{202e}').contains(&character)
        || ('\u{2066}'..='\u{2069}').contains(&character);
    turns || (character.is_control() && !['\t', '\n'].contains(&character))
}

/// Returns the first 12 hexadecimal digits of a hash: enough to tell experiments apart, and short enough to read.
pub fn short_hash(hash: Sha256) -> String {
    hash.finalize().iter().take(6).map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plain_text_stays_as_it_is() {
        for text in ["", "a file\n  |\n1 | x = 1\n\tend\n", "\u{394} \u{e9} \u{65e5}"] {
            assert!(matches!(shown(text), Cow::Borrowed(same) if same == text));
        }
    }

    #[test]
    fn commands_to_a_terminal_are_named() {
        assert_eq!(shown("a\u{1b}[31mb\0\r\u{9b}c\u{202e}d"), "a\\u{1b}[31mb\\u{0}\\r\\u{9b}c\\u{202e}d");
        assert_eq!(line("a\nb"), "a\\nb");
    }

    #[test]
    fn long_lines_lose_their_middle_and_long_texts_their_end() {
        let text = format!("file: {}: do this\n{}", "x".repeat(5_000_000), "y\n".repeat(10_000));
        let short = shown(&text);
        assert!(short.len() < 9000 && short.starts_with("file: xx") && short.ends_with("more lines)"), "{short}");
        assert!(short.contains("characters) ...") && short.contains("x: do this\n"), "{short}");
    }
}
