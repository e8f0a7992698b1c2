//! `table` environments of parts that fit on a page below one another.

use super::columns::{SEPARATION, width};
use super::escape::escape;

/// Height limit of an environment in points, without its caption: a page with margins of 2 cm has 731.
const HEIGHT: f64 = 610.0;
/// Height of a row of a table, and of a line of the notes, in points.
const ROW: f64 = 9.6;
/// Width of a line of the notes in points.
const LINE: f64 = 470.0;
/// Rows of a part on one page, without its heads.
const ROWS: f64 = 50.0;

/// A part that stays on one page.
pub struct Block {
    text: String,
    height: f64,
}

impl Block {
    /// Returns a tabular with `rows` rows.
    pub fn of_rows(text: String, rows: f64) -> Block {
        Block { text, height: (rows + 1.0) * ROW }
    }

    /// Returns notes, one paragraph each, in blocks of at most half a page unless a note is longer.
    pub fn of_notes(notes: &[String]) -> Vec<Block> {
        let mut blocks: Vec<Block> = Vec::new();
        for note in notes {
            let (text, height) = (format!("{}\\par\n", escape(note)), ROW * (1.05 * width(note) / LINE).ceil());
            match blocks.last_mut().filter(|last| last.height + height < HEIGHT / 2.0) {
                Some(last) => {
                    last.text += &text;
                    last.height += height;
                }
                None => blocks.push(Block { text, height: height + ROW }),
            }
        }
        for block in &mut blocks {
            let text = &block.text;
            block.text = format!("\\begin{{minipage}}{{\\linewidth}}\n\\raggedright\n{text}\\end{{minipage}}\n");
        }
        blocks
    }
}

/// Returns how many lines, each with its number of rows, go on each page.
pub fn pages(rows: &[f64]) -> Vec<usize> {
    let mut pages: Vec<(usize, f64)> = Vec::new();
    for taken in rows {
        match pages.last_mut().filter(|(_, all)| all + taken <= ROWS) {
            Some((count, all)) => (*count, *all) = (*count + 1, *all + taken),
            None => pages.push((1, *taken)),
        }
    }
    pages.into_iter().map(|(count, _)| count).collect()
}

/// Puts the blocks into as many environments as their heights need, each with the caption.
pub fn floats(caption: &str, blocks: Vec<Block>) -> String {
    let mut pages: Vec<Vec<Block>> = Vec::new();
    let mut taken = f64::INFINITY;
    for block in blocks {
        if taken + block.height > HEIGHT {
            pages.push(Vec::new());
            taken = 0.0;
        }
        taken += block.height;
        pages.last_mut().expect("just begun").push(block);
    }
    let environment = |(index, blocks): (usize, Vec<Block>)| {
        let again = if index == 0 { "" } else { " (continued)" };
        let blocks: Vec<String> = blocks.into_iter().map(|block| block.text).collect();
        format!(
            "\\begin{{table}}\n\\centering\n\\setlength{{\\abovecaptionskip}}{{0pt}}\n\\setlength{{\\belowcaptionskip}}{{6pt}}\n\
             \\caption{{{}{again}}}\n\\footnotesize\n\\setlength{{\\tabcolsep}}{{{SEPARATION}pt}}\n\
             {}\\end{{table}}\n",
            escape(caption),
            blocks.join("\n\\medskip\n")
        )
    };
    pages.into_iter().enumerate().map(environment).collect()
}
