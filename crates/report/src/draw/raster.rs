//! Figures as pixels, which the feature `png-figures` brings: their SVG, drawn in the embedded face.

#[cfg(feature = "png-figures")]
pub use drawn::{image, png};
#[cfg(not(feature = "png-figures"))]
pub use undrawn::{image, png};

/// Ubuntu Light without hints; where it comes from stands beside it.
pub const FACE: &[u8] = include_bytes!("../../../../assets/fonts/ubuntu-light-derivative-augnerf.ttf");
/// Pixels of the PNG to one of the SVG.
pub const FINENESS: f64 = 2.0;

const WITHOUT: &str = "figures are SVG alone: this augnerf was built without its feature png-figures";
/// What to tell about figures where they have no PNG.
pub const SVG_ALONE: Option<&str> = if cfg!(feature = "png-figures") { None } else { Some(WITHOUT) };

#[cfg(feature = "png-figures")]
mod drawn {
    use std::sync::Arc;

    use resvg::tiny_skia::{Pixmap, Transform};
    use resvg::usvg::{Options, Tree, fontdb};

    use super::{FACE, FINENESS};
    use crate::base::{Error, Image, Result};

    /// The face's own name, which by its licence is not that of the whole.
    const FACE_FAMILY: &str = "Ubuntu derivative augnerf";

    /// A figure's PNG file.
    pub fn png(svg: &str) -> Result<Option<Vec<u8>>> {
        pixels(svg)?.encode_png().map(Some).map_err(|e| failed(&e.to_string()))
    }

    /// A figure's pixels.
    pub fn image(svg: &str) -> Result<Image> {
        let pixels = pixels(svg)?;
        // The paper is opaque, so that colours are not scaled by any alpha.
        let rgb = pixels.data().chunks_exact(4).flat_map(|pixel| [0, 1, 2].map(|c| f32::from(pixel[c]) / 255.0));
        let (width, height) = (pixels.width() as usize, pixels.height() as usize);
        Ok(Image { width, height, channels: 3, pixels: rgb.collect() })
    }

    fn pixels(svg: &str) -> Result<Pixmap> {
        let mut fonts = fontdb::Database::new();
        fonts.load_font_data(FACE.to_vec());
        // Figures ask for Ubuntu and else for any face without serifs.
        fonts.set_sans_serif_family(FACE_FAMILY);
        let options = Options { fontdb: Arc::new(fonts), ..Options::default() };
        let tree = Tree::from_str(svg, &options).map_err(|e| failed(&e.to_string()))?;
        let size = tree.size().to_int_size().scale_by(FINENESS as f32).ok_or_else(|| failed("it has no size"))?;
        let mut pixels = Pixmap::new(size.width(), size.height()).ok_or_else(|| failed("it has no size"))?;
        resvg::render(&tree, Transform::from_scale(FINENESS as f32, FINENESS as f32), &mut pixels.as_mut());
        Ok(pixels)
    }

    fn failed(why: &str) -> Error {
        Error::Output(format!("cannot draw a figure: {why}"))
    }
}

#[cfg(not(feature = "png-figures"))]
mod undrawn {
    use super::WITHOUT;
    use crate::base::{Error, Image, Result};

    /// None.
    pub fn png(_svg: &str) -> Result<Option<Vec<u8>>> {
        Ok(None)
    }

    /// Refused.
    pub fn image(_svg: &str) -> Result<Image> {
        Err(Error::Config(WITHOUT.into()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawn(text: &str) -> Vec<f32> {
        let start = r#"<svg xmlns="http://www.w3.org/2000/svg" width="60" height="20"><rect width="60" height="20" fill="white"/>"#;
        let letters = r#"<text x="5" y="15" font-family="Ubuntu, sans-serif" font-size="13">"#;
        image(&format!("{start}{letters}{text}</text></svg>")).unwrap().pixels
    }

    #[test]
    #[cfg_attr(not(feature = "png-figures"), ignore = "needs the feature png-figures")]
    fn the_face_has_the_letters_that_names_may_hold_and_a_box_for_all_others() {
        let (nothing, unknown) = (drawn(" "), drawn("\u{2207}"));
        assert!(unknown != nothing);
        assert_eq!(unknown, drawn("\u{4e00}"));
        for letter in "Aaé€ŁőλεσαΔжЯ±·†×−–…≤≈∞√²".chars().map(String::from) {
            let drawn = drawn(&letter);
            assert!(drawn != unknown && drawn != nothing, "{letter}");
        }
    }
}
