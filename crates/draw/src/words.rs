//! Widths of texts, and lines that fit into one.

use super::scripts;

/// Liberation Sans without hints; where it comes from stands beside it.
const FACE: &[u8] = include_bytes!("../../../assets/fonts/augnerf-sans.ttf");

/// Width of a text in pixels.
pub fn text_width(text: &str, size: f64) -> f64 {
    let face = ttf_parser::Face::parse(FACE, 0).expect("the embedded font is a font");
    let advance = |letter: char| {
        let (letter, scale) = scripts::plain(letter).map_or((letter, 1.0), |plain| (plain, scripts::SCALE));
        let advance = face.glyph_index(letter).and_then(|glyph| face.glyph_hor_advance(glyph)).unwrap_or(500);
        f64::from(advance) * scale
    };
    text.chars().map(advance).sum::<f64>() * size / f64::from(face.units_per_em())
}

/// Lines of at most `width` pixels in letters of `size`, broken at spaces, and within a word where it alone is longer.
pub fn wrapped(text: &str, width: f64, size: f64) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split_whitespace().flat_map(|word| pieces(word, width, size)) {
        let line = lines.last_mut().expect("starts with one");
        let longer = if line.is_empty() { word.clone() } else { format!("{line} {word}") };
        if text_width(&longer, size) <= width || line.is_empty() {
            *line = longer;
        } else {
            lines.push(word);
        }
    }
    lines
}

/// A word in parts of at most `width` pixels, or of one letter.
fn pieces(word: &str, width: f64, size: f64) -> Vec<String> {
    let mut pieces = vec![String::new()];
    for letter in word.chars() {
        let piece = pieces.last_mut().expect("starts with one");
        if !piece.is_empty() && text_width(&format!("{piece}{letter}"), size) > width {
            pieces.push(String::new());
        }
        pieces.last_mut().expect("just seen").push(letter);
    }
    pieces
}
