//! Lines of text as outlines of the embedded font, with its ligatures and kerning.

use tiny_skia::{Path, PathBuilder, Transform};
use ttf_parser::gpos::{PairAdjustment, PositioningSubtable};
use ttf_parser::{Face, GlyphId, OutlineBuilder};

use super::canvas::Anchor;

/// Letters with a common glyph, the longest first.
const LIGATURES: [(&str, &str); 5] =
    [("ffi", "\u{fb03}"), ("ffl", "\u{fb04}"), ("ff", "\u{fb00}"), ("fi", "\u{fb01}"), ("fl", "\u{fb02}")];

/// Returns the outlines of a line of text, or none if it has only spaces. The point is on the baseline, at the end that
/// the anchor names.
pub fn outlines(face: &Face, text: &str, (x, y): (f64, f64), size: f64, anchor: Anchor) -> Option<Path> {
    let scale = size as f32 / f32::from(face.units_per_em());
    let letters: Vec<(GlyphId, f32)> =
        spaced(face, text).into_iter().map(|(glyph, advance)| (glyph, advance as f32 * scale)).collect();
    let width: f32 = letters.iter().map(|(_, advance)| advance).sum();
    let mut along = match anchor {
        Anchor::Left => 0.0,
        Anchor::Middle => -width / 2.0,
        Anchor::Right => -width,
    };
    let mut line = PathBuilder::new();
    for (glyph, advance) in letters {
        // In the font y points up, in the figure down.
        let place = Transform::from_translate(x as f32, y as f32).pre_translate(along, 0.0).pre_scale(scale, -scale);
        if let Some(outline) = outline(face, glyph).and_then(|outline| outline.transform(place)) {
            line.push_path(&outline);
        }
        along += advance;
    }
    line.finish()
}

/// Returns the glyphs of a text, each with the distance to the next in font units. As in SVG, spaces at the ends are
/// dropped and several spaces are one.
fn spaced(face: &Face, text: &str) -> Vec<(GlyphId, i32)> {
    let mut text = text.split(' ').filter(|word| !word.is_empty()).collect::<Vec<&str>>().join(" ");
    for (letters, ligature) in LIGATURES {
        text = text.replace(letters, ligature);
    }
    let visible = text.chars().filter(|letter| !is_invisible(*letter));
    // A letter that the font lacks is drawn as a box, the first glyph.
    let glyph = |letter: char| face.glyph_index(if letter.is_whitespace() { ' ' } else { letter }).unwrap_or_default();
    let glyphs: Vec<GlyphId> = visible.map(glyph).collect();
    let advance = |i: usize| {
        let kerning = glyphs.get(i + 1).map_or(0, |next| kerning(face, glyphs[i], *next));
        i32::from(face.glyph_hor_advance(glyphs[i]).unwrap_or(0)) + kerning
    };
    (0..glyphs.len()).map(|i| (glyphs[i], advance(i))).collect()
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
        let advances =
            |text: &str| -> Vec<i32> { spaced(&face, text).into_iter().map(|(_, advance)| advance).collect() };
        let (alone, pair) = (advances("T"), advances("To"));
        assert!(pair[0] < alone[0], "no kerning: {pair:?} after {alone:?}");
        assert_eq!(pair[1], advances("o")[0]);
        assert_eq!(advances("efficient").len(), "e\u{fb03}cient".chars().count());
        assert_eq!(advances("  a   b "), advances("a b"));
        assert_eq!(advances("a\u{200b}b"), advances("ab"));
    }
}
