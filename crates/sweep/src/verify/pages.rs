//! Numbers that pages quote: comments in Markdown say which cells they are, and are held to it.
//!
//! Above a table, what each of its columns shows of the rows that its first column names:
//!
//! ```text
//! <!-- table tab4_fern: row | psnr_mean ± psnr_std | psnr_difference [psnr_low, psnr_high] | psnr_p_holm -->
//! ```
//!
//! Behind a paragraph or an item of a list, the numbers in it:
//!
//! ```text
//! <!-- numbers tab4_fern: +0.03 = psnr_difference of Aug-NeRF; 0.129 = ssim_p_holm of Aug-NeRF -->
//! ```

use std::path::Path;

use super::numbers::{Cells, is_quoted_as};
use crate::base::input::{TEXT_BYTES, read_text};
use crate::base::{Error, Result};

const TABLE: &str = "table ";
const NUMBERS: &str = "numbers ";

/// What holds, or why not.
type Checked<T> = std::result::Result<T, String>;

/// A page's comments and what they are about.
pub struct Page {
    /// The file's name, with the folder that it shares with the results.
    pub name: String,
    /// In the page's order.
    pub quotes: Vec<Quote>,
    /// Numbers with decimals that no comment is about.
    pub unmarked: usize,
}

/// One comment.
pub struct Quote {
    /// Line of the page.
    pub line: usize,
    /// The results' folder that the numbers are said to come from.
    pub folder: String,
    about: About,
}

enum About {
    /// Cells of the comment, and the table's lines.
    Table(Vec<String>, Vec<Vec<String>>),
    /// Claims, and the text that makes them.
    Numbers(Vec<String>, String),
}

impl Page {
    /// Reads a page below `root`.
    pub fn read(path: &Path, root: &Path) -> Result<Page> {
        let text = read_text(path, TEXT_BYTES).map_err(|e| Error::unreadable(path, &e))?;
        let name = path.strip_prefix(root).unwrap_or(path).display().to_string();
        Ok(Page::parse(name, &text))
    }

    fn parse(name: String, text: &str) -> Page {
        let lines: Vec<&str> = text.lines().collect();
        let (mut quotes, mut marked) = (Vec::new(), vec![false; lines.len()]);
        let mut at = 0;
        while at < lines.len() {
            let Some(start) = lines[at].find("<!-- ").filter(|_| lines[at].trim_start().starts_with("<!-- ")) else {
                at += 1;
                continue;
            };
            let end = (at..lines.len()).find(|&i| lines[i].contains("-->")).unwrap_or(lines.len() - 1);
            let comment = lines[at..=end].join("\n");
            let comment = comment[start + 5..].split("-->").next().unwrap_or_default().trim().to_string();
            marked[at..=end].iter_mut().for_each(|marked| *marked = true);
            if let Some(quote) = Quote::parse(&comment, &lines, at, end, &mut marked) {
                quotes.push(quote);
            }
            at = end + 1;
        }
        let unmarked = unmarked(&lines, &marked, &quotes);
        Page { name, quotes, unmarked }
    }
}

impl Quote {
    fn parse(comment: &str, lines: &[&str], first: usize, last: usize, marked: &mut [bool]) -> Option<Quote> {
        let (is_table, rest) = match (comment.strip_prefix(TABLE), comment.strip_prefix(NUMBERS)) {
            (Some(rest), _) => (true, rest),
            (_, Some(rest)) => (false, rest),
            _ => return None,
        };
        let (folder, content) = rest.split_once(':').unwrap_or((rest, ""));
        let about = if is_table {
            let from = (last + 1..lines.len()).find(|&i| !lines[i].trim().is_empty()).unwrap_or(lines.len());
            let to = (from..lines.len()).find(|&i| !lines[i].trim_start().starts_with('|')).unwrap_or(lines.len());
            marked[from..to].iter_mut().for_each(|marked| *marked = true);
            About::Table(cells(content), lines[from..to].iter().skip(2).map(|line| cells(line)).collect())
        } else {
            let claims = content.split([';', '\n']).map(str::trim).filter(|claim| !claim.is_empty());
            About::Numbers(claims.map(String::from).collect(), block_before(lines, first))
        };
        Some(Quote { line: first + 1, folder: folder.trim().to_string(), about })
    }

    /// How many numbers were compared, and what is wrong.
    pub fn check(&self, cells: &Cells) -> (usize, Vec<String>) {
        match &self.about {
            About::Table(template, lines) => check_table(template, lines, cells),
            About::Numbers(claims, block) => {
                let wrong = claims.iter().filter_map(|claim| check_claim(claim, block, cells).err());
                (claims.len(), wrong.collect())
            }
        }
    }
}

/// Longer than any paragraph: more would be kept with each of its comments.
const MOST_LINES: usize = 64;

/// The paragraph or item that ends above a line, comments left out.
fn block_before(lines: &[&str], at: usize) -> String {
    let mut block: Vec<&str> = Vec::new();
    let mut in_comment = false;
    for line in lines[..at].iter().rev().take(MOST_LINES) {
        let text = line.trim_start();
        in_comment |= text.ends_with("-->");
        if in_comment {
            in_comment = !text.starts_with("<!--");
            continue;
        }
        if text.is_empty() || text.starts_with('#') {
            break;
        }
        block.push(text);
        if text.starts_with("- ") {
            break;
        }
    }
    block.reverse();
    block.join(" ")
}

fn cells(line: &str) -> Vec<String> {
    line.trim().trim_start_matches('|').trim_end_matches('|').split('|').map(|cell| cell.trim().to_string()).collect()
}

fn check_table(template: &[String], lines: &[Vec<String>], cells: &Cells) -> (usize, Vec<String>) {
    let (mut count, mut wrong) = (0, Vec::new());
    if lines.is_empty() {
        wrong.push("there is no table below the comment".into());
    }
    for line in lines {
        let row = line[0].trim_end_matches(|c: char| "†*\\ ".contains(c));
        if line.len() != template.len() {
            wrong.push(format!("row '{row}' has {} cells, the comment {}", line.len(), template.len()));
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
        return Err(format!("'{quoted}' does not stand in the text above"));
    }
    let value = cells.value(expression, None)?.ok_or_else(|| format!("{} has no {expression}", cells.name))?;
    match is_quoted_as(value, quoted)? {
        true => Ok(()),
        false => Err(format!("'{quoted}' is quoted as {expression}, which is {value} in {}", cells.name)),
    }
}

/// Whether a number stands in a text, not as a part of another.
fn has_number(text: &str, number: &str) -> bool {
    text.match_indices(number).any(|(at, _)| {
        let before = text[..at].chars().next_back();
        let mut after = text[at + number.len()..].chars();
        let (next, second) = (after.next(), after.next());
        let is_digit = |c: Option<char>| c.is_some_and(|c| c.is_ascii_digit());
        let decimals_follow = matches!(next, Some('.' | ',')) && is_digit(second);
        !(is_digit(before) || before == Some('.') || is_digit(next) || decimals_follow)
    })
}

/// Numbers with decimals outside of code, links, marked tables and the claims of their blocks.
fn unmarked(lines: &[&str], marked: &[bool], quotes: &[Quote]) -> usize {
    let claimed = |line: &str, number: &str| {
        quotes.iter().any(|quote| match &quote.about {
            About::Numbers(claims, block) => {
                let names = |claim: &String| {
                    claim.split_once(" = ").is_some_and(|(quoted, _)| {
                        quoted.trim_end_matches('%').trim().trim_start_matches(['+', '-']) == number
                    })
                };
                block.contains(line.trim_start()) && claims.iter().any(names)
            }
            About::Table(..) => false,
        })
    };
    let (mut count, mut in_code) = (0, false);
    for (line, _) in lines.iter().zip(marked).filter(|(_, marked)| !**marked) {
        if line.trim_start().starts_with("```") {
            in_code = !in_code;
        }
        if in_code {
            continue;
        }
        let plain: String = line.split('`').step_by(2).collect::<Vec<_>>().join(" ");
        let numbers = plain.split(|c: char| !(c.is_ascii_digit() || c == '.')).map(|word| word.trim_matches('.'));
        let decimals = numbers.filter(|word| word.split_once('.').is_some_and(|(_, rest)| !rest.contains('.')));
        count += decimals.filter(|number| !claimed(line, number)).count();
    }
    count
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

    fn check(page: &str) -> (usize, Vec<String>, usize) {
        let made = [("table.csv", TABLE_CSV), ("points.csv", POINTS_CSV), ("attack.csv", ATTACK_CSV)]
            .map(|(name, text)| (name.into(), text.into()));
        let cells = Cells::of_sweep(Path::new("x"), &made.into()).unwrap();
        let page = Page::parse("page.md".into(), page);
        let (mut count, mut wrong) = (0, Vec::new());
        for quote in &page.quotes {
            let (numbers, reasons) = quote.check(&cells);
            count += numbers;
            wrong.extend(reasons);
        }
        (count, wrong, page.unmarked)
    }

    fn table(row: &str) -> (usize, Vec<String>, usize) {
        check(&format!(
            "<!-- table x: row | psnr_mean ± psnr_std | psnr_difference [psnr_low, psnr_high] | \
             psnr_mean / psnr_mean of NeRF -->\n\n| row | PSNR | difference | share |\n|---|---:|---:|---:|\n{row}\n"
        ))
    }

    #[test]
    fn tables_are_held_to_their_cells() {
        let (count, wrong, unmarked) = table("| + l1 Reg. \\* | 18.75 ± 0.15 | -0.23 [-0.52, +0.06] | 0.99 |");
        assert_eq!((count, wrong, unmarked), (6, vec![], 0));
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
    fn numbers_of_a_paragraph_are_held_to_their_claims() {
        let page = |claims: &str| {
            check(&format!(
                "Another.\n\n- l1 costs 0.23 dB, NeRF's\n  seed 2 has 0.138 and 7.5.\n  <!-- numbers x: {claims} -->\n"
            ))
        };
        let (count, wrong, unmarked) = page("0.23 = -psnr_difference of + l1 Reg.; 0.138 = chamfer@2 of NeRF");
        assert_eq!((count, wrong, unmarked), (2, vec![], 1));
        for (claims, reason) in [
            ("0.23 = psnr_difference of + l1 Reg.", "which is -0.2262"),
            ("0.24 = psnr_difference of + l1 Reg.", "does not stand in the text"),
            ("0.13 = chamfer@2 of NeRF", "does not stand in the text"),
            ("0.138 = chamfer@0 of NeRF", "which is 0.061"),
            ("0.138 = chamfer@1 of NeRF", "no row 'NeRF' with seed 1"),
            ("0.23 = psnr of NeRF", "no column 'psnr'"),
            ("0.23", "is not `NUMBER"),
        ] {
            let (_, wrong, _) = page(claims);
            assert!(wrong.iter().any(|text| text.contains(reason)), "{claims}: {wrong:?}");
        }
    }

    /// Of what the attack did, rows that were not attacked have nothing.
    #[test]
    fn columns_of_the_attack_stand_beside_those_of_the_table() {
        let table = |row: &str| {
            let comment = "<!-- table x: row | psnr_mean (shift.xyz) | last.shift.xyz -->";
            let (count, wrong, _) = check(&format!("{comment}\n\n| row | PSNR | last |\n|---|---|---|\n{row}\n"));
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
        let claim =
            |claim: &str| check(&format!("It moves colours by 0.75.\n<!-- numbers x: {claim} -->\n")).1.join("; ");
        assert_eq!(claim("0.75 = shift.xyz of + l1 Reg."), "");
        assert!(claim("0.75 = last.shift.xyz of + l1 Reg.").contains("x has no last.shift.xyz"));
        assert!(claim("0.75 = shift.t of + l1 Reg.").contains("no column 'shift.t'"));
    }

    #[test]
    fn numbers_without_a_comment_are_counted() {
        assert_eq!(check("# 1.5\n\nA 2.5 `3.5` 4 5.5.\n\n```\n6.5\n```\n").2, 3);
    }
}
