//! Numbers that pages quote: `quotes.toml` says which cells they are, and the pages are held to it.
//!
//! ```toml
//! verdicts = ["helps", "ruled out"]  # words that say what a table says
//!
//! [untraced]                         # numbers with decimals and verdicts on a page that no quote is about
//! "results/study/README.md" = ["0.53", "1.37", "helps"]
//!
//! [[quote]]                          # the numbers of a text that stands on the page once
//! page = "results/paper/ablation.md"
//! text = "neither Aug-NeRF, +0.03 dB [-0.02, +0.09]"
//! folder = "tab4_fern"
//! cells = ["+0.03 = psnr_difference of Aug-NeRF", "-0.02 = psnr_low of Aug-NeRF", "+0.09 = psnr_high of Aug-NeRF"]
//!
//! [[quote]]                          # a verdict in words
//! page = "results/study/README.md"
//! text = "Worst-case augmentation helps on fern."
//! folder = "study_primary"
//! words = ["helps = verdict of study_fern_few is higher"]
//!
//! [[quote]]                          # the table that has this text in its head, or below it
//! page = "results/paper/ablation.md"
//! text = "| row | steps | PSNR (dB) |"
//! folder = "tab4_fern"
//! columns = "row | steps | psnr_mean ± psnr_std"
//! ```

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Component, Path};

use serde::Deserialize;

use super::findings::Findings;
use super::numbers::{Cells, is_quoted_as};
use super::tree::Tree;
use crate::base::input::{TEXT_BYTES, read_text};
use crate::base::{Error, Result};

/// The file's name, in the folder of all results.
pub const QUOTES: &str = "quotes.toml";
/// Comments that traced numbers at an earlier time.
const COMMENTS: [&str; 2] = ["<!-- numbers ", "<!-- table "];

/// What holds, or why not.
type Checked<T> = std::result::Result<T, String>;

/// `quotes.toml`.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Quotes {
    /// Numbers with decimals and verdicts that no quote is about, by page.
    untraced: BTreeMap<String, Untraced>,
    /// Words that say what a table says.
    verdicts: Vec<String>,
    quote: Vec<Quote>,
    #[serde(skip)]
    is_there: bool,
}

/// What no quote is about.
#[derive(Deserialize)]
#[serde(untagged)]
enum Untraced {
    /// How many numbers with decimals.
    Count(usize),
    /// Each number with decimals and each verdict.
    Listed(Vec<String>),
}

/// Numbers of one place of a page.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Quote {
    /// The page, from the folder above that of all results.
    page: String,
    /// Words of the page that stand there once.
    text: String,
    /// The results' folder that the numbers come from, by its name.
    folder: String,
    /// Numbers of the text, each with its cell.
    #[serde(default)]
    cells: Vec<String>,
    /// Words of the text, each with the condition under which they are true.
    #[serde(default)]
    words: Vec<String>,
    /// What the columns of a table show of the row that the first one names.
    #[serde(default)]
    columns: String,
}

impl Quotes {
    /// Those of all results; no quote where there is no such file.
    pub fn read(root: &Path) -> Result<Quotes> {
        let path = root.join(QUOTES);
        if !path.is_file() {
            return Ok(Quotes::default());
        }
        let text = read_text(&path, TEXT_BYTES).map_err(|e| Error::unreadable(&path, &e))?;
        let quotes: Quotes = toml::from_str(&text).map_err(|e| Error::Data(format!("{}: {e}", path.display())))?;
        Ok(Quotes { is_there: true, ..quotes })
    }

    /// Compares the numbers that are quoted from a results' folder.
    pub fn check(&self, root: &Path, cells: &Cells, findings: &mut Findings) {
        let mut pages: Vec<&str> = Vec::new();
        for quote in self.quote.iter().filter(|quote| quote.folder == cells.name) {
            if !pages.contains(&quote.page.as_str()) {
                pages.push(&quote.page);
            }
        }
        for name in pages {
            let page = match Page::read(root, name) {
                Ok(page) => page,
                Err(error) => {
                    findings.wrong(error);
                    continue;
                }
            };
            let (mut count, mut wrong) = (0, Vec::new());
            for quote in self.quote.iter().filter(|quote| quote.folder == cells.name && quote.page == name) {
                let (numbers, reasons) = quote.check(&page, cells);
                count += numbers;
                wrong.extend(reasons);
            }
            findings.of(format!("{name}: {count} quoted numbers"), wrong);
        }
    }

    /// Checks what belongs to no one folder: each quote's folder is there, once, and pages in `tree`, of a part of all results or
    /// of `all`, have as many untraced numbers as is said.
    pub fn check_pages(&self, root: &Path, tree: &Tree, all: &Tree, findings: &mut Findings) {
        let mut folders: Vec<&str> = self.quote.iter().map(|quote| quote.folder.as_str()).collect();
        folders.sort_unstable();
        folders.dedup();
        for folder in folders {
            match all.named(folder).len() {
                0 => findings.wrong(format!("{QUOTES}: there is no results folder '{}'", start_of(folder))),
                1 => {}
                _ => findings.wrong(format!("{QUOTES}: several results folders are called '{folder}'")),
            }
        }
        let mut names: Vec<String> = tree.pages.iter().map(|page| name_of(root, page)).collect();
        if tree.leaves.len() == all.leaves.len() {
            // Pages elsewhere, such as the README above.
            let quoted = self.quote.iter().map(|quote| &quote.page).chain(self.untraced.keys());
            names.extend(quoted.cloned());
            let above = root.parent().map(|above| above.join("README.md"));
            names.extend(above.filter(|page| page.is_file()).map(|_| "README.md".into()));
        }
        names.sort();
        names.dedup();
        for name in names {
            match Page::read(root, &name) {
                Ok(page) => self.check_untraced(&page, findings),
                Err(error) => findings.wrong(error),
            }
        }
    }

    fn check_untraced(&self, page: &Page, findings: &mut Findings) {
        let name = &page.name;
        for comment in &page.comments {
            findings.wrong(format!("{name}, line {comment}: {QUOTES} traces numbers; comments no longer do"));
        }
        let quotes = self.quote.iter().filter(|quote| quote.page == *name);
        let found = page.untraced(quotes, &self.verdicts);
        match self.untraced.get(name) {
            Some(Untraced::Listed(listed)) => of_list(page, &found, listed, findings),
            count => {
                let found = found.iter().filter(|(_, word)| word.contains('.')).count();
                let said = match count {
                    Some(Untraced::Count(count)) => *count,
                    _ if self.is_there => 0,
                    _ => found,
                };
                of_count(name, found, said, findings);
            }
        }
    }
}

/// Compares what no quote is about with a list of it.
fn of_list(page: &Page, found: &[(usize, String)], listed: &[String], findings: &mut Findings) {
    let name = &page.name;
    let (mut rest, mut wrong) = (listed.to_vec(), Vec::new());
    for (at, word) in found {
        match rest.iter().position(|listed| listed == word) {
            Some(index) => drop(rest.remove(index)),
            None => wrong.push(format!(
                "{name}, line {}: no quote is about '{word}', and [untraced] of {QUOTES} does not list it. Add a [[quote]] if a \
                 results folder has it; otherwise list it",
                page.line_of(*at) + 1
            )),
        }
    }
    wrong.extend(rest.iter().map(|word| {
        format!("{name}: [untraced] of {QUOTES} lists '{word}', which does not stand there, or not without a quote")
    }));
    match (wrong.is_empty(), found.len()) {
        (false, _) => findings.of("", wrong),
        (true, 0) => {}
        (true, count) => {
            findings.not_checked(format!("{name}: {count} numbers with decimals and verdicts that no quote is about"));
        }
    }
}

/// Compares how many numbers no quote is about with what is said of it.
fn of_count(name: &str, found: usize, said: usize, findings: &mut Findings) {
    if found != said {
        findings.wrong(format!(
            "{name}: no quote is about {found} of its numbers with decimals, [untraced] of {QUOTES} says {said}. Add a \
             [[quote]] for each that a results folder has, and list what is left"
        ));
    } else if found > 0 {
        findings.not_checked(format!("{name}: {found} numbers with decimals that no quote is about"));
    }
}

impl Quote {
    /// How many numbers were compared, and what is wrong.
    fn check(&self, page: &Page, cells: &Cells) -> (usize, Vec<String>) {
        let at = match page.find(&self.text) {
            Ok(at) => at,
            Err(reason) => return (0, vec![format!("{}: {reason}", page.name)]),
        };
        let (mut count, mut wrong) = (self.cells.len() + self.words.len(), Vec::new());
        wrong.extend(self.cells.iter().filter_map(|claim| check_claim(claim, &self.text, cells).err()));
        wrong.extend(self.words.iter().filter_map(|claim| check_words(claim, &self.text, cells).err()));
        if !self.columns.is_empty() {
            let lines: Vec<Vec<String>> =
                page.lines[page.table(at.end - 1)].iter().skip(2).map(|l| cells_of(l)).collect();
            let (numbers, reasons) = check_table(&cells_of(&self.columns), &lines, cells);
            count += numbers;
            wrong.extend(reasons);
        } else if count == 0 {
            wrong.push(format!("'{}' has neither cells, words nor columns in {QUOTES}", start_of(&self.text)));
        }
        let line = page.line_of(at.start) + 1;
        (count, wrong.into_iter().map(|reason| format!("{}, line {line}: {reason}", page.name)).collect())
    }
}

/// A page as quotes are looked for in it.
struct Page {
    /// Its path from the folder above that of all results.
    name: String,
    /// Without what indents them.
    lines: Vec<String>,
    /// All lines in one, each blank a single space.
    flat: String,
    /// Where each line starts in it.
    starts: Vec<usize>,
    /// The same with spaces in place of code and comments.
    prose: String,
    /// Lines of comments that traced numbers at an earlier time.
    comments: Vec<usize>,
}

impl Page {
    /// Reads the page of this name.
    fn read(root: &Path, name: &str) -> Result<Page> {
        if !Path::new(name).components().all(|part| matches!(part, Component::Normal(_))) {
            return Err(Error::Data(format!("{QUOTES}: '{}' is no page of these results", start_of(name))));
        }
        let path = root.parent().unwrap_or(root).join(name);
        let text = read_text(&path, TEXT_BYTES).map_err(|e| Error::unreadable(&path, &e))?;
        Ok(Page::parse(name, &text))
    }

    fn parse(name: &str, text: &str) -> Page {
        let lines: Vec<String> = text.lines().map(one_line).collect();
        let (mut flat, mut prose, mut starts, mut in_code) = (String::new(), String::new(), Vec::new(), false);
        for line in &lines {
            if !flat.is_empty() && !line.is_empty() {
                flat.push(' ');
                prose.push(' ');
            }
            starts.push(flat.len());
            flat += line;
            let is_fence = line.starts_with("```");
            prose += &if in_code || is_fence { " ".repeat(line.len()) } else { without_code(line) };
            in_code ^= is_fence;
        }
        let mut page = Page { name: name.into(), lines, flat, starts, prose, comments: Vec::new() };
        let mut from = 0;
        while let Some(start) = page.prose[from..].find("<!--").map(|at| from + at) {
            let end = page.prose[start..].find("-->").map_or(page.prose.len(), |at| start + at + 3);
            if COMMENTS.iter().any(|comment| page.prose[start..].starts_with(comment)) {
                page.comments.push(page.line_of(start) + 1);
            }
            blank(&mut page.prose, start..end);
            from = end;
        }
        page
    }

    /// Where a text stands.
    fn find(&self, text: &str) -> Checked<Range<usize>> {
        let text = one_line(text);
        let mut places = self.flat.match_indices(&text).filter(|_| !text.is_empty());
        let shown = start_of(&text);
        match (places.next(), places.count()) {
            (Some((at, _)), 0) => Ok(at..at + text.len()),
            (Some(_), more) => Err(format!("'{shown}' stands there {} times: quote more of it in {QUOTES}", more + 1)),
            (None, _) => Err(format!("'{shown}' does not stand there: {QUOTES} quotes it")),
        }
    }

    fn line_of(&self, at: usize) -> usize {
        self.starts.partition_point(|start| *start <= at).saturating_sub(1)
    }

    /// The lines of the table at a place, where a text ends, or of the next one.
    fn table(&self, at: usize) -> Range<usize> {
        let is_table = |line: &usize| self.lines[*line].starts_with('|');
        let first = (self.line_of(at)..self.lines.len()).find(is_table).unwrap_or(self.lines.len());
        first..(first..self.lines.len()).find(|line| !is_table(line)).unwrap_or(self.lines.len())
    }

    /// Numbers with decimals and verdicts that no quote is about, outside of code, each with its place in the page.
    fn untraced<'a>(&self, quotes: impl Iterator<Item = &'a Quote>, verdicts: &[String]) -> Vec<(usize, String)> {
        let mut prose = self.prose.clone();
        for quote in quotes {
            let Ok(span) = self.find(&quote.text) else { continue };
            if !quote.columns.is_empty() {
                let table = self.table(span.end - 1);
                let end = |line: usize| self.starts.get(line).copied().unwrap_or(self.flat.len());
                blank(&mut prose, end(table.start)..end(table.end));
            }
            let named = |claims: &'a [String]| claims.iter().filter_map(|claim| Some(claim.split_once(" = ")?.0));
            for number in named(&quote.cells) {
                for at in places_of(&self.flat[span.clone()], number).map(|at| span.start + at) {
                    blank(&mut prose, at..at + number.len());
                }
            }
            for words in named(&quote.words) {
                for at in words_in(&self.flat[span.clone()], words).map(|at| span.start + at) {
                    blank(&mut prose, at..at + words.len());
                }
            }
        }
        let mut found = numbers_in(&prose);
        let lower = prose.to_ascii_lowercase();
        for verdict in verdicts {
            found.extend(words_in(&lower, verdict).map(|at| (at, verdict.clone())));
        }
        found.sort();
        found
    }
}

/// Numbers with decimals and their signs, each with its place.
fn numbers_in(text: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    let is_part = |c: char| c.is_ascii_digit() || c == '.';
    let mut rest = 0;
    while let Some(start) = text[rest..].find(is_part).map(|at| rest + at) {
        let end = text[start..].find(|c| !is_part(c)).map_or(text.len(), |at| start + at);
        rest = end;
        let word = text[start..end].trim_matches('.');
        if word.split_once('.').is_none_or(|(_, decimals)| decimals.contains('.')) {
            continue;
        }
        let mut before = text[..start].chars().rev();
        let sign = before.next().filter(|sign| ['+', '-'].contains(sign) && text[start..].starts_with(word));
        let is_sign = before.next().is_none_or(|c| !c.is_alphanumeric());
        let sign = sign.filter(|_| is_sign).map_or(String::new(), String::from);
        found.push((start, sign + word));
    }
    found
}

/// Where words stand in a text, not as a part of other words.
fn words_in<'a>(text: &'a str, words: &'a str) -> impl Iterator<Item = usize> + 'a {
    text.match_indices(words).map(|(at, _)| at).filter(move |&at| {
        let (before, after) = (text[..at].chars().next_back(), text[at + words.len()..].chars().next());
        !words.is_empty() && ![before, after].into_iter().flatten().any(char::is_alphanumeric)
    })
}

/// How a page is called: by its path from the folder above that of all results.
fn name_of(root: &Path, page: &Path) -> String {
    let page = std::path::absolute(page).unwrap_or_else(|_| page.to_path_buf());
    page.strip_prefix(root.parent().unwrap_or(root)).unwrap_or(&page).display().to_string()
}

/// A text with each blank a single space.
fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// A line with spaces in place of what stands in backticks.
fn without_code(line: &str) -> String {
    let parts = line.split('`').enumerate();
    let plain = parts.map(|(index, part)| if index % 2 == 0 { part.to_string() } else { " ".repeat(part.len()) });
    plain.collect::<Vec<_>>().join(" ")
}

fn blank(text: &mut String, place: Range<usize>) {
    let spaces = " ".repeat(place.len());
    text.replace_range(place, &spaces);
}

/// As much of a text as a message shows.
fn start_of(text: &str) -> String {
    text.chars().take(80).collect()
}

fn cells_of(line: &str) -> Vec<String> {
    line.trim().trim_start_matches('|').trim_end_matches('|').split('|').map(|cell| cell.trim().to_string()).collect()
}

fn check_table(template: &[String], lines: &[Vec<String>], cells: &Cells) -> (usize, Vec<String>) {
    let (mut count, mut wrong) = (0, Vec::new());
    if lines.is_empty() {
        wrong.push("no table stands below it".into());
    }
    for line in lines {
        let row = line[0].trim_end_matches(|c: char| "†*\\ ".contains(c));
        if line.len() != template.len() {
            wrong.push(format!("row '{row}' has {} cells, columns name {}", line.len(), template.len()));
            continue;
        }
        for (pattern, cell) in template.iter().zip(line).skip(1) {
            match check_cell(pattern, cell, row, cells) {
                Ok(numbers) => count += numbers,
                Err(reason) => wrong.push(format!("row '{row}': {reason}")),
            }
        }
    }
    (count, wrong)
}

/// Compares a cell with its pattern, in which names of columns stand for numbers and everything else for itself. Returns
/// how many numbers it has.
fn check_cell(pattern: &str, cell: &str, row: &str, cells: &Cells) -> Checked<usize> {
    if pattern == "-" {
        return Ok(0);
    }
    let parts = if pattern.contains(" of ") { vec![Part::Column(pattern)] } else { parts(pattern) };
    let values: Vec<Option<f64>> = parts
        .iter()
        .filter_map(|part| match part {
            Part::Column(expression) => Some(cells.value(expression, Some(row))),
            Part::Text(_) => None,
        })
        .collect::<Checked<_>>()?;
    if values.iter().all(Option::is_none) {
        return if cell.is_empty() { Ok(0) } else { Err(format!("'{cell}' stands where {} has nothing", cells.name)) };
    }
    let (mut rest, mut values) = (cell, values.into_iter());
    for part in &parts {
        match part {
            Part::Text(text) => {
                rest = rest.strip_prefix(text).ok_or_else(|| format!("'{cell}' is not of the form '{pattern}'"))?;
            }
            Part::Column(column) => {
                let end = rest.find(|c: char| !(c.is_ascii_digit() || "+-.e".contains(c))).unwrap_or(rest.len());
                let quoted = &rest[..end];
                let value = values.next().flatten().ok_or_else(|| format!("{} has no {column}", cells.name))?;
                if !is_quoted_as(value, quoted)? {
                    return Err(format!("'{quoted}' is quoted as {column}, which is {value} in {}", cells.name));
                }
                rest = &rest[end..];
            }
        }
    }
    match rest.trim() {
        "" => Ok(parts.iter().filter(|part| matches!(part, Part::Column(_))).count()),
        more => Err(format!("'{cell}' has more than '{pattern}': '{more}'")),
    }
}

enum Part<'a> {
    Column(&'a str),
    Text(&'a str),
}

/// Columns (small letters, digits, `_`, a `.` between them, and `@` with a seed) and what stands between them.
fn parts(pattern: &str) -> Vec<Part<'_>> {
    let is_name = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_' || c == '@';
    let (mut parts, mut rest) = (Vec::new(), pattern);
    while let Some(first) = rest.chars().next() {
        let named = is_name(first);
        let ends = |(at, c): (usize, char)| {
            let joins = named && c == '.' && rest[at + 1..].starts_with(is_name);
            (is_name(c) != named && !joins).then_some(at)
        };
        let end = rest.char_indices().find_map(ends).unwrap_or(rest.len());
        let (part, after) = rest.split_at(end);
        parts.push(if named { Part::Column(part) } else { Part::Text(part) });
        rest = after;
    }
    parts
}

/// A claim names a number of the text and what it is.
fn check_claim(claim: &str, block: &str, cells: &Cells) -> Checked<()> {
    let (quoted, expression) =
        claim.split_once(" = ").ok_or_else(|| format!("'{claim}' is not `NUMBER = COLUMN of ROW`"))?;
    if !has_number(block, quoted) {
        return Err(format!("'{quoted}' does not stand in the text"));
    }
    let value = cells.value(expression, None)?.ok_or_else(|| format!("{} has no {expression}", cells.name))?;
    match is_quoted_as(value, quoted)? {
        true => Ok(()),
        false => Err(format!("'{quoted}' is quoted as {expression}, which is {value} in {}", cells.name)),
    }
}

/// A claim names words of the text and when they are true.
fn check_words(claim: &str, block: &str, cells: &Cells) -> Checked<()> {
    let (words, condition) =
        claim.split_once(" = ").ok_or_else(|| format!("'{claim}' is not `WORDS = COLUMN of ROW is TEXT`"))?;
    if words_in(block, words).next().is_none() {
        return Err(format!("'{words}' does not stand in the text"));
    }
    cells.holds(condition).map_err(|reason| format!("'{words}' is said, and {reason}"))
}

/// Whether a number stands in a text, not as a part of another.
fn has_number(text: &str, number: &str) -> bool {
    places_of(text, number).next().is_some()
}

/// Where a number stands in a text, not as a part of another.
fn places_of<'a>(text: &'a str, number: &'a str) -> impl Iterator<Item = usize> + 'a {
    let places = text.match_indices(number).map(|(at, _)| at);
    places.filter(move |&at| {
        let before = text[..at].chars().next_back();
        let mut after = text[at + number.len()..].chars();
        let (next, second) = (after.next(), after.next());
        let is_digit = |c: Option<char>| c.is_some_and(|c| c.is_ascii_digit());
        let decimals_follow = matches!(next, Some('.' | ',')) && is_digit(second);
        !(is_digit(before) || before == Some('.') || is_digit(next) || decimals_follow)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const TABLE_CSV: &str = "\
scene,row,axes,psnr_mean,psnr_std,psnr_difference,psnr_low,psnr_high
fern,NeRF,,18.9735,0.0466,,,
fern,+ l1 Reg.,,18.7473,0.1548,-0.2262,-0.5160,0.0635
";
    const ATTACK_CSV: &str =
        "scene,source,row,axes,n,shift.xyz,last.shift.xyz\nfern,run,+ l1 Reg.,,3,0.7512,\nchair,run,NeRF,,3,9,9\n";
    const POINTS_CSV: &str = "scene,row,axes,seed,chamfer\nfern,NeRF,,0,0.061\nfern,NeRF,,2,0.138\n";

    /// Numbers that were compared, what is wrong, and how many no quote is about.
    fn check(page: &str, quotes: &str) -> (usize, Vec<String>, usize) {
        let of = |name: &str| match name {
            "table.csv" => TABLE_CSV,
            "points.csv" => POINTS_CSV,
            _ => ATTACK_CSV,
        };
        let cells = Cells::of_tables(Path::new("x"), |name| Ok(of(name).into())).unwrap();
        let quotes: Quotes = toml::from_str(quotes).unwrap();
        let page = Page::parse("page.md", page);
        let (mut count, mut wrong) = (0, Vec::new());
        for quote in &quotes.quote {
            let (numbers, reasons) = quote.check(&page, &cells);
            count += numbers;
            wrong.extend(reasons);
        }
        (count, wrong, page.untraced(quotes.quote.iter(), &quotes.verdicts).len())
    }

    /// A quote of the text, with one more line.
    fn quote(text: &str, line: &str) -> String {
        format!("[[quote]]\npage = \"page.md\"\nfolder = \"x\"\ntext = \"{text}\"\n{line}\n")
    }

    fn claims(text: &str, claims: &[&str]) -> String {
        quote(text, &format!("cells = {claims:?}"))
    }

    fn table(row: &str) -> (usize, Vec<String>, usize) {
        let columns =
            "row | psnr_mean ± psnr_std | psnr_difference [psnr_low, psnr_high] | psnr_mean / psnr_mean of NeRF";
        check(
            &format!("Of 1.5:\n\n| row | PSNR | difference | share |\n|---|---:|---:|---:|\n{row}\n"),
            &quote("| row | PSNR |", &format!("columns = \"{columns}\"")),
        )
    }

    #[test]
    fn tables_are_held_to_their_cells() {
        let (count, wrong, unmarked) = table("| + l1 Reg. \\* | 18.75 ± 0.15 | -0.23 [-0.52, +0.06] | 0.99 |");
        assert_eq!((count, wrong, unmarked), (6, vec![], 1));
        assert_eq!(table("| NeRF † | 18.97 ± 0.05 |  | 1.00 |").1, [""; 0]);
        for (row, reason) in [
            (
                "| + l1 Reg. | 18.76 ± 0.15 | -0.23 [-0.52, +0.06] | 0.99 |",
                "'18.76' is quoted as psnr_mean, which is 18.7473",
            ),
            ("| + l1 Reg. | 18.75 ± 0.15 | +0.23 [-0.52, +0.06] | 0.99 |", "'+0.23'"),
            ("| + l1 Reg. | 18.75 ± 0.15 | -0.23 (-0.52, +0.06) | 0.99 |", "not of the form"),
            ("| + l2 Reg. | 18.75 ± 0.15 | -0.23 [-0.52, +0.06] | 0.99 |", "no row '+ l2 Reg.'"),
            ("| NeRF | 18.97 ± 0.05 | -0.23 [-0.52, +0.06] | 1.00 |", "has nothing"),
            ("| NeRF | 18.97 ± 0.05 |", "cells"),
        ] {
            let (_, wrong, _) = table(row);
            assert!(wrong.iter().any(|text| text.contains(reason)), "{row}: {wrong:?}");
        }
    }

    #[test]
    fn numbers_of_a_text_are_held_to_their_cells() {
        let page = "Another.\n\n- l1 costs 0.23 dB, NeRF's\n  seed 2 has 0.138 and 7.5.\n";
        let of = |cells: &[&str]| check(page, &claims("costs 0.23 dB, NeRF's seed 2 has 0.138", cells));
        let (count, wrong, unmarked) = of(&["0.23 = -psnr_difference of + l1 Reg.", "0.138 = chamfer@2 of NeRF"]);
        assert_eq!((count, wrong, unmarked), (2, vec![], 1));
        for (claim, reason) in [
            (
                "0.23 = psnr_difference of + l1 Reg.",
                "page.md, line 3: '0.23' is quoted as psnr_difference of + l1 Reg., which is -0.2262",
            ),
            ("0.24 = psnr_difference of + l1 Reg.", "does not stand in the text"),
            ("0.13 = chamfer@2 of NeRF", "does not stand in the text"),
            ("7.5 = chamfer@2 of NeRF", "does not stand in the text"),
            ("0.138 = chamfer@0 of NeRF", "which is 0.061"),
            ("0.138 = chamfer@1 of NeRF", "no row 'NeRF' with seed 1"),
            ("0.23 = psnr of NeRF", "no column 'psnr'"),
            ("0.23", "is not `NUMBER"),
        ] {
            let (_, wrong, _) = of(&[claim]);
            assert!(wrong.iter().any(|text| text.contains(reason)), "{claim}: {wrong:?}");
        }
    }

    #[test]
    fn a_text_stands_on_its_page_once() {
        let of = |page: &str, text: &str| check(page, &claims(text, &["0.138 = chamfer@2 of NeRF"]));
        assert_eq!(of("It is 0.138 here.\n\nAnd 0.138 there.", "0.138 there"), (1, vec![], 1));
        for (page, text, reason) in [
            ("It is 0.138 here, and 0.138 there.", "0.138", "'0.138' stands there 2 times"),
            ("It is 0.139 here.", "is 0.138", "'is 0.138' does not stand there"),
            ("It is 0.138 here.", "", "'' does not stand there"),
        ] {
            let (count, wrong, _) = of(page, text);
            assert!(count == 0 && wrong.iter().any(|text| text.contains(reason)), "{text}: {wrong:?}");
        }
        let neither = check("It is 0.138.", &quote("It is 0.138", ""));
        assert!(neither.1[0].contains("neither cells, words nor columns"), "{neither:?}");
    }

    /// Of what the attack did, rows that were not attacked have nothing.
    #[test]
    fn columns_of_the_attack_stand_beside_those_of_the_table() {
        let table = |row: &str| {
            let columns = quote("# Attack", "columns = \"row | psnr_mean (shift.xyz) | last.shift.xyz\"");
            let page = format!("# Attack\n\n| row | PSNR | last |\n|---|---|---|\n{row}\n");
            let (count, wrong, _) = check(&page, &columns);
            (count, wrong.join("; "))
        };
        assert_eq!(table("| + l1 Reg. | 18.75 (0.75) |  |"), (2, String::new()));
        for (row, reason) in [
            ("| + l1 Reg. | 18.75 (0.76) |  |", "'0.76' is quoted as shift.xyz, which is 0.7512"),
            ("| + l1 Reg. | 18.75 (0.75) | 0.75 |", "'0.75' stands where x has nothing"),
            ("| NeRF | 18.97 (0.75) |  |", "x has no shift.xyz"),
        ] {
            assert!(table(row).1.contains(reason), "{row}: {}", table(row).1);
        }
        let claim = |claim: &str| check("It moves colours by 0.75.\n", &claims("by 0.75", &[claim])).1.join("; ");
        assert_eq!(claim("0.75 = shift.xyz of + l1 Reg."), "");
        assert!(claim("0.75 = last.shift.xyz of + l1 Reg.").contains("x has no last.shift.xyz"));
        assert!(claim("0.75 = shift.t of + l1 Reg.").contains("no column 'shift.t'"));
    }

    /// A verdict is held to its table, and one that loses its quote is missed.
    #[test]
    fn verdicts_are_held_to_their_tables() {
        let page = "TV helps, l1 is inconclusive; nothing helps more.\n";
        let of = |claim: &str| {
            let quote = quote("TV helps, l1 is inconclusive", &format!("words = [{claim:?}]"));
            check(page, &format!("verdicts = [\"helps\", \"inconclusive\"]\n{quote}"))
        };
        assert_eq!(of("inconclusive = psnr_low of + l1 Reg. < 0"), (1, vec![], 2));
        for (claim, reason) in [
            (
                "inconclusive = psnr_low of + l1 Reg. > 0",
                "'inconclusive' is said, and psnr_low of + l1 Reg. is '-0.516'",
            ),
            ("no gain = psnr_low of + l1 Reg. < 0", "'no gain' does not stand in the text"),
            ("help = psnr_low of + l1 Reg. < 0", "'help' does not stand in the text"),
            ("helps", "is not `WORDS ="),
        ] {
            let (_, wrong, _) = of(claim);
            assert!(wrong.iter().any(|text| text.contains(reason)), "{claim}: {wrong:?}");
        }
    }

    #[test]
    fn what_no_quote_is_about_is_listed_one_by_one() {
        let page = Page::parse("page.md", "It is +0.53 to 1.37,\nid a-2.5, and helps.\n");
        let found = page.untraced(std::iter::empty(), &["helps".into()]);
        let words: Vec<&str> = found.iter().map(|(_, word)| word.as_str()).collect();
        assert_eq!(words, ["+0.53", "1.37", "2.5", "helps"]);
        let said = |listed: &[&str]| {
            let mut findings = Findings::default();
            of_list(&page, &found, &listed.iter().map(ToString::to_string).collect::<Vec<_>>(), &mut findings);
            findings.lines.into_iter().map(|line| line.text).collect::<Vec<_>>().join("; ")
        };
        assert!(said(&["+0.53", "1.37", "2.5", "helps"]).contains("4 numbers with decimals and verdicts"));
        let changed = said(&["+0.53", "1.38", "2.5", "helps"]);
        assert!(changed.contains("page.md, line 1: no quote is about '1.37'") && changed.contains("lists '1.38'"));
        assert!(said(&["+0.53", "1.37", "2.5"]).contains("line 2: no quote is about 'helps'"));
    }

    #[test]
    fn numbers_that_no_quote_is_about_are_counted() {
        assert_eq!(check("# 1.5\n\nA 2.5 `3.5` 4 5.5.\n<!-- 7.5 -->\n\n```\n6.5\n```\n", "").2, 3);
        assert_eq!(Page::parse("page.md", "2.5\n\n<!-- numbers x: 2.5 = a of b -->\n`<!-- table `").comments, [3]);
    }
}
