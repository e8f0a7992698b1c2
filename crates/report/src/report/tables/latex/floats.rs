//! `table` environments of parts that fit a page below one another.

use super::columns::{SEPARATION, width};
use super::escape::escape;

/// Points that an environment may be high, its caption not counted: a page with margins of 2 cm has 731.
const HEIGHT: f64 = 610.0;
/// Points from row to row, and from line to line of the notes.
const ROW: f64 = 9.6;
/// Points that a line of the notes is long.
const LINE: f64 = 470.0;
/// Rows of a part on one page, besides its heads.
const ROWS: f64 = 50.0;

/// Something that is not divided between pages.
pub struct Block {
    text: String,
    height: f64,
}

impl Block {
    /// A tabular with so many rows.
    pub fn of_rows(text: String, rows: f64) -> Block {
        Block { text, height: (rows + 1.0) * ROW }
    }

    /// Notes, a paragraph each, in blocks of half a page at most where no note is longer.
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

/// How many of the lines that take so many rows each go on each page.
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

/// The blocks in as many environments as their heights ask for, each under the caption.
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
            "\\begin{{table}}\n\\centering\n\\caption{{{}{again}}}\n\\footnotesize\n\\setlength{{\\tabcolsep}}{{{SEPARATION}pt}}\n\
             {}\\end{{table}}\n",
            escape(caption),
            blocks.join("\n\\medskip\n")
        )
    };
    pages.into_iter().enumerate().map(environment).collect()
}
