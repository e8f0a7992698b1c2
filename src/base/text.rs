//! Text of unknown origin, made fit for a terminal and for people.

use std::borrow::Cow;

/// Longest line that is shown whole; more has nothing to say to a person.
const MOST_LINE: usize = 2000;
/// Most lines that are shown.
const MOST_LINES: usize = 60;

/// The text without what a terminal would take for a command or would write backwards, such characters as their codes
/// (`\u{1b}`), and with the middle of very long lines and the end of very many left out.
pub fn shown(text: &str) -> Cow<'_, str> {
    let plain = |line: &str| line.len() <= MOST_LINE && !line.chars().any(is_command);
    if text.lines().count() <= MOST_LINES && text.split('\n').all(plain) {
        return Cow::Borrowed(text);
    }
    let mut lines: Vec<String> = text.split('\n').take(MOST_LINES).map(line).collect();
    let more = text.split('\n').count() - lines.len();
    if more > 0 {
        lines.push(format!("... ({more} more lines)"));
    }
    Cow::Owned(lines.join("\n"))
}

/// The same as one line.
pub fn line(text: &str) -> String {
    let length = text.chars().count();
    let mut line = String::new();
    let (head, tail) = if length > MOST_LINE { (MOST_LINE * 3 / 4, length - MOST_LINE / 4) } else { (length, length) };
    for (at, character) in text.chars().enumerate() {
        match character {
            _ if at == head => line.push_str(&format!(" ... ({} characters) ... ", tail - head)),
            _ if (head..tail).contains(&at) => {}
            character if is_command(character) || character == '\n' => line.extend(character.escape_default()),
            character => line.push(character),
        }
    }
    line
}

/// Control characters but for the tab, and those that turn the direction of text.
fn is_command(character: char) -> bool {
    let turns = ['\u{200e}', '\u{200f}', '\u{2028}', '\u{2029}'].contains(&character)
        || ('\u{202a}'..='\u{202e}').contains(&character)
        || ('\u{2066}'..='\u{2069}').contains(&character);
    turns || (character.is_control() && !['\t', '\n'].contains(&character))
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
        let text = format!("file: {}: do this\n{}", "x".repeat(5_000_000), "y\n".repeat(100));
        let short = shown(&text);
        assert!(short.len() < 4000 && short.starts_with("file: xx") && short.ends_with("more lines)"), "{short}");
        assert!(short.contains("characters) ...") && short.contains("x: do this\n"), "{short}");
    }
}
