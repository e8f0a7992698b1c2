//! How often a table's training pixels were seen.

use super::Line;
use crate::report::distinct;

/// Meaning of the number, for readers.
const MEANING: &str = "epochs: steps x rays of a step / training pixels";
/// Most groups of rows that have a number of their own.
const GROUPS: usize = 3;

/// Returns a number of epochs with two digits, or all digits before the point: `0.32`, `1.4`, `158`.
pub fn epochs_text(epochs: f64) -> String {
    let decimals = if epochs > 0.0 { (1.0 - epochs.log10().floor()).clamp(0.0, 6.0) } else { 0.0 };
    format!("{epochs:.*}", decimals as usize)
}

/// Returns lowest and highest number, as one if they look alike: `1.4 to 1.9`.
fn range((low, high): (f64, f64)) -> String {
    let (low, high) = (epochs_text(low), epochs_text(high));
    if low == high { low } else { format!("{low} to {high}") }
}

/// Returns the range that holds all ranges.
pub(in crate::report) fn joint(ranges: impl Iterator<Item = (f64, f64)>) -> Option<(f64, f64)> {
    ranges.reduce(|all, own| (all.0.min(own.0), all.1.max(own.1)))
}

/// Returns how often the training pixels of lines were seen in one number or range; `None` if it is unknown of all.
pub fn epochs_of<'a>(lines: impl IntoIterator<Item = &'a Line>) -> Option<String> {
    joint(lines.into_iter().filter_map(|line| line.epochs)).map(range)
}

/// Returns the paragraph of Markdown above numbers of several tables; empty if it is unknown of all how often pixels were seen.
pub(in crate::report) fn epochs_head(all: impl Iterator<Item = (f64, f64)>) -> String {
    let head = |seen| format!("Each training pixel was seen {} times ({MEANING}).\n\n", range(seen));
    joint(all).map_or_else(String::new, head)
}

/// Returns whether a line's training pixels were seen less than once.
pub fn is_brief(line: &Line) -> bool {
    line.epochs.is_some_and(|(low, _)| low < 1.0)
}

/// Returns how often the training pixels of a scene's lines were seen, as most lines, and then of those that differ. Of more
/// lines than `most`, it says how many they are. `None` if it is unknown of all.
pub fn epochs_note(lines: &[&Line], most: usize) -> Option<String> {
    let known: Vec<(&Line, String)> = lines.iter().filter_map(|line| Some((*line, range(line.epochs?)))).collect();
    let of = |text: &str| known.iter().filter(|(_, own)| own == text).map(|(line, _)| *line).collect::<Vec<&Line>>();
    let mut groups: Vec<(String, Vec<&Line>)> = distinct(known.iter().map(|(_, text)| text.clone()))
        .into_iter()
        .map(|text| (text.clone(), of(&text)))
        .collect();
    groups.sort_by_key(|(_, own)| std::cmp::Reverse(own.len()));
    if groups.len() > GROUPS {
        let others: Vec<&Line> = groups.drain(1..).flat_map(|(_, own)| own).collect();
        groups.push((epochs_of(others.iter().copied())?, others));
    }
    let unknown: Vec<&Line> =
        lines.iter().filter(|line| line.epochs.is_none() && !line.ids.is_empty()).copied().collect();
    let labels = |own: &[&Line]| match own.len() {
        many if many > most => format!("{many} other rows"),
        _ => own.iter().map(|line| line.label.as_str()).collect::<Vec<&str>>().join(", "),
    };
    let (first, others) = groups.split_first()?;
    let mut text = format!("each training pixel was seen {} times", first.0);
    others.iter().for_each(|(seen, own)| text += &format!(", {seen} times in {}", labels(own)));
    if let Some(paper) = joint(lines.iter().filter_map(|line| line.published_epochs).map(|paper| (paper, paper))) {
        text += &format!(", {} times in the paper", range(paper));
    }
    if !unknown.is_empty() {
        text += &format!("; unknown of {}", labels(&unknown));
    }
    Some(format!("{text} ({MEANING})"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_digits_say_how_often() {
        let texts = [0.0, 0.0128, 0.316, 0.998, 1.44, 32.0, 158.1].map(epochs_text);
        assert_eq!(texts, ["0", "0.013", "0.32", "1.00", "1.4", "32", "158"]);
    }
}
