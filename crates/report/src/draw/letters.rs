//! Lines of text as outlines of the embedded font, with its kerning.

use tiny_skia::{Path, PathBuilder, Transform};
use ttf_parser::gpos::{PairAdjustment, PositioningSubtable};
use ttf_parser::{Face, GlyphId, OutlineBuilder};

use super::canvas::Anchor;
use super::scripts;

/// Returns the outlines of a line of text, or none if it has only spaces. The point is on the baseline, at the end that
/// the anchor names.
pub fn outlines(face: &Face, text: &str, (x, y): (f64, f64), size: f64, anchor: Anchor) -> Option<Path> {
    let em = size as f32 / f32::from(face.units_per_em());
    let letters = spaced(face, text);
    let width: f32 = letters.iter().map(|letter| letter.advance * em).sum();
    let mut along = match anchor {
        Anchor::Left => 0.0,
        Anchor::Middle => -width / 2.0,
        Anchor::Right => -width,
    };
    let mut line = PathBuilder::new();
    for letter in letters {
        let (scale, foot) = (letter.scale * em, y as f32 - letter.raised * size as f32);
        // In the font y points up, in the figure down.
        let place = Transform::from_translate(x as f32, foot).pre_translate(along, 0.0).pre_scale(scale, -scale);
        if let Some(outline) = outline(face, letter.glyph).and_then(|outline| outline.transform(place)) {
            line.push_path(&outline);
        }
        along += letter.advance * em;
    }
    line.finish()
}

/// A glyph in a line.
struct Letter {
    glyph: GlyphId,
    /// Distance to the next, in font units.
    advance: f32,
    /// Size, relative to the line's.
    scale: f32,
    /// Baseline above that of the line, in em.
    raised: f32,
}

/// Returns the letters of a text. As in SVG, spaces at the ends are dropped and several spaces are one.
fn spaced(face: &Face, text: &str) -> Vec<Letter> {
    let text = text.split(' ').filter(|word| !word.is_empty()).collect::<Vec<&str>>().join(" ");
    let letter = |letter: char| {
        let (plain, scale, raised) = match scripts::plain(letter) {
            Some((plain, raised)) => (plain, scripts::SCALE as f32, raised as f32),
            None => (if letter.is_whitespace() { ' ' } else { letter }, 1.0, 0.0),
        };
        // A letter that the font lacks is drawn as a box, the first glyph.
        let glyph = face.glyph_index(plain).unwrap_or_default();
        Letter { glyph, advance: f32::from(face.glyph_hor_advance(glyph).unwrap_or(0)) * scale, scale, raised }
    };
    let mut letters: Vec<Letter> = text.chars().filter(|letter| !is_invisible(*letter)).map(letter).collect();
    for i in 1..letters.len() {
        if (letters[i - 1].scale, letters[i].scale) == (1.0, 1.0) {
            letters[i - 1].advance += kerning(face, letters[i - 1].glyph, letters[i].glyph) as f32;
        }
    }
    letters
}

/// Returns whether a character only controls how its neighbours are set.
fn is_invisible(letter: char) -> bool {
    matches!(letter, '\u{ad}' | '\u{200b}'..='\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2060}'..='\u{206f}'
        | '\u{fe00}'..='\u{fe0f}' | '\u{feff}')
}

/// Returns the change of the distance between two glyphs, in font units.
fn kerning(face: &Face, first: GlyphId, second: GlyphId) -> i32 {
    let lookups = face.tables().gpos.iter().flat_map(|table| table.lookups);
    let applied = lookups.filter_map(|lookup| {
        lookup.subtables.into_iter::<PositioningSubtable>().find_map(|subtable| match subtable {
            PositioningSubtable::Pair(pairs) => pair(&pairs, first, second),
            _ => None,
        })
    });
    applied.map(i32::from).sum()
}

/// Returns the change that one table of pairs asks for, or none if it does not cover the pair.
fn pair(pairs: &PairAdjustment, first: GlyphId, second: GlyphId) -> Option<i16> {
    let index = pairs.coverage().get(first)?;
    let (value, _) = match pairs {
        PairAdjustment::Format1 { sets, .. } => sets.get(index)?.get(second)?,
        PairAdjustment::Format2 { classes, matrix, .. } => matrix.get((classes.0.get(first), classes.1.get(second)))?,
    };
    Some(value.x_advance)
}

/// Returns a glyph's outline in font units, or none if it is blank.
fn outline(face: &Face, glyph: GlyphId) -> Option<Path> {
    let mut pen = Pen(PathBuilder::new());
    face.outline_glyph(glyph, &mut pen)?;
    pen.0.finish()
}

struct Pen(PathBuilder);

impl OutlineBuilder for Pen {
    fn move_to(&mut self, x: f32, y: f32) {
        self.0.move_to(x, y);
    }

    fn line_to(&mut self, x: f32, y: f32) {
        self.0.line_to(x, y);
    }

    fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
        self.0.quad_to(x1, y1, x, y);
    }

    fn curve_to(&mut self, x1: f32, y1: f32, x2: f32, y2: f32, x: f32, y: f32) {
        self.0.cubic_to(x1, y1, x2, y2, x, y);
    }

    fn close(&mut self) {
        self.0.close();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_are_spaced_as_the_font_asks() {
        let face = Face::parse(crate::draw::raster::FACE, 0).unwrap();
        let advances = |text: &str| -> Vec<f32> { spaced(&face, text).iter().map(|letter| letter.advance).collect() };
        let (alone, pair) = (advances("T"), advances("To"));
        assert!(pair[0] < alone[0], "no kerning: {pair:?} after {alone:?}");
        assert_eq!(pair[1], advances("o")[0]);
        let raised = spaced(&face, "10⁻⁵");
        assert!(raised[2].scale < 1.0 && raised[3].raised > 0.0 && raised[1].raised == 0.0);
        assert_eq!(raised[3].glyph, spaced(&face, "5")[0].glyph);
        assert_eq!(advances("  a   b "), advances("a b"));
        assert_eq!(advances("a\u{200b}b"), advances("ab"));
    }
}
