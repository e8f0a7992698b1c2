//! Figures as pixels, which the feature `png-figures` brings: a canvas's marks, with text in the embedded face.

#[cfg(feature = "png-figures")]
pub use drawn::{image, png};
#[cfg(not(feature = "png-figures"))]
pub use undrawn::{image, png};

/// Liberation Sans without hints; where it comes from stands beside it.
pub const FACE: &[u8] = include_bytes!("../../../../assets/fonts/augnerf-sans.ttf");
/// Pixels of the PNG to one of the SVG, unless a canvas has its own.
pub const FINENESS: f64 = 2.0;

const WITHOUT: &str = "figures are SVG alone: this augnerf was built without its feature png-figures";
/// What to tell about figures where they have no PNG.
pub const SVG_ALONE: Option<&str> = if cfg!(feature = "png-figures") { None } else { Some(WITHOUT) };

#[cfg(feature = "png-figures")]
mod drawn {
    use tiny_skia::{
        Color, FillRule, FilterQuality, Paint, Path, PathBuilder, Pattern, Pixmap, Rect, SpreadMode, Stroke,
        StrokeDash, Transform,
    };
    use ttf_parser::Face;

    use super::FACE;
    use crate::base::{Error, Image, Result};
    use crate::draw::canvas::{CENTIMETRES, Canvas, Colour, DASHES, Mark};
    use crate::draw::{disc, letters};

    /// A figure's PNG file.
    pub fn png(canvas: &Canvas) -> Result<Option<Vec<u8>>> {
        let pixels = pixels(canvas)?;
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, pixels.width(), pixels.height());
        encoder.set_color(png::ColorType::Rgb);
        let dots = (100.0 * canvas.fineness / CENTIMETRES).round() as u32;
        encoder.set_pixel_dims(Some(png::PixelDimensions { xppu: dots, yppu: dots, unit: png::Unit::Meter }));
        // The paper is opaque, so that colours are not scaled by any alpha.
        let rgb: Vec<u8> = pixels.data().chunks_exact(4).flat_map(|pixel| [pixel[0], pixel[1], pixel[2]]).collect();
        let written = encoder.write_header().and_then(|mut writer| writer.write_image_data(&rgb));
        written.map_err(|e| failed(&e.to_string()))?;
        Ok(Some(file))
    }

    /// A figure's pixels.
    pub fn image(canvas: &Canvas) -> Result<Image> {
        let pixels = pixels(canvas)?;
        let rgb = pixels.data().chunks_exact(4).flat_map(|pixel| [0, 1, 2].map(|c| f32::from(pixel[c]) / 255.0));
        let (width, height) = (pixels.width() as usize, pixels.height() as usize);
        Ok(Image { width, height, channels: 3, pixels: rgb.collect() })
    }

    fn pixels(canvas: &Canvas) -> Result<Pixmap> {
        let face = Face::parse(FACE, 0).map_err(|e| failed(&e.to_string()))?;
        let (width, height) = canvas.size();
        let side = |length: f64| (length * canvas.fineness).round() as u32;
        let mut pixels = Pixmap::new(side(width), side(height)).ok_or_else(|| failed("it has no size"))?;
        pixels.fill(Color::WHITE);
        let fine = Transform::from_scale(canvas.fineness as f32, canvas.fineness as f32);
        for mark in &canvas.marks {
            if let Mark::Picture { at, size, png } = mark {
                picture(*at, *size, png, fine, &mut pixels)?;
            }
            // A mark without extent draws nothing.
            let _ = draw(mark, &face, fine, &mut pixels);
        }
        Ok(pixels)
    }

    /// Draws a mark, or returns none if it has no extent.
    fn draw(mark: &Mark, face: &Face, fine: Transform, pixels: &mut Pixmap) -> Option<()> {
        match mark {
            Mark::Line { points, colour, width, dashed } => {
                let dash = if *dashed { StrokeDash::new(DASHES.to_vec(), 0.0) } else { None };
                let stroke = Stroke { width: *width as f32, dash, ..Stroke::default() };
                let line = along(points)?.finish()?;
                pixels.stroke_path(&line, &paint(*colour, 1.0), &stroke, fine, None);
                Some(())
            }
            Mark::Area { points, colour, opacity } => {
                let mut around = along(points)?;
                around.close();
                fill(&around.finish()?, *colour, *opacity, fine, pixels)
            }
            Mark::Dot { at, radius, colour, opacity } => {
                fill(&disc::path(*at, *radius)?, *colour, *opacity, fine, pixels)
            }
            Mark::Text { at, text, size, anchor, colour } => {
                fill(&letters::outlines(face, text, *at, *size, *anchor)?, *colour, 1.0, fine, pixels)
            }
            Mark::Picture { .. } => None,
        }
    }

    fn paint(Colour(r, g, b): Colour, opacity: f64) -> Paint<'static> {
        let mut paint = Paint::default();
        paint.set_color_rgba8(r, g, b, (opacity as f32 * 255.0).round() as u8);
        paint
    }

    fn fill(path: &Path, colour: Colour, opacity: f64, fine: Transform, pixels: &mut Pixmap) -> Option<()> {
        let bounds = path.bounds();
        if bounds.width() > 0.0 && bounds.height() > 0.0 {
            pixels.fill_path(path, &paint(colour, opacity), FillRule::Winding, fine, None);
        }
        Some(())
    }

    /// Returns an open path, or none through fewer than two points.
    fn along(points: &[(f64, f64)]) -> Option<PathBuilder> {
        let [first, _, ..] = points else { return None };
        let mut path = PathBuilder::new();
        path.move_to(first.0 as f32, first.1 as f32);
        points[1..].iter().for_each(|(x, y)| path.line_to(*x as f32, *y as f32));
        Some(path)
    }

    /// Draws an image with sharp pixels.
    fn picture((x, y): (f64, f64), size: (f64, f64), png: &[u8], fine: Transform, pixels: &mut Pixmap) -> Result<()> {
        let picture = Pixmap::decode_png(png).map_err(|e| failed(&e.to_string()))?;
        let (width, height) = (picture.width() as f32, picture.height() as f32);
        let (across, down) = (size.0 as f32 / width, size.1 as f32 / height);
        let place = fine.pre_concat(Transform::from_row(across, 0.0, 0.0, down, x as f32, y as f32));
        let shader =
            Pattern::new(picture.as_ref(), SpreadMode::Pad, FilterQuality::Nearest, 1.0, Transform::identity());
        let paint = Paint { shader, ..Paint::default() };
        if let Some(extent) = Rect::from_xywh(0.0, 0.0, width, height) {
            pixels.fill_rect(extent, &paint, place, None);
        }
        Ok(())
    }

    fn failed(why: &str) -> Error {
        Error::Output(format!("cannot draw a figure: {why}"))
    }
}

#[cfg(not(feature = "png-figures"))]
mod undrawn {
    use super::WITHOUT;
    use crate::base::{Error, Image, Result};
    use crate::draw::canvas::Canvas;

    /// None.
    pub fn png(_canvas: &Canvas) -> Result<Option<Vec<u8>>> {
        Ok(None)
    }

    /// Refused.
    pub fn image(_canvas: &Canvas) -> Result<Image> {
        Err(Error::Config(WITHOUT.into()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::canvas::{Anchor, BLACK, Canvas};

    fn drawn(text: &str) -> Vec<f32> {
        let mut canvas = Canvas::new(60.0, 20.0);
        canvas.text((5.0, 10.0), text, 13.0, Anchor::Left, BLACK);
        image(&canvas).unwrap().pixels
    }

    #[test]
    #[cfg(feature = "png-figures")]
    fn a_png_is_as_wide_in_print_as_its_svg() {
        use crate::draw::canvas::Width;
        for (width, centimetres) in [(Width::Page, 17.0), (Width::Column, 8.3)] {
            let figure = Canvas::titled(width, "A title").finish().unwrap();
            assert!(figure.svg.contains(&format!(" width=\"{centimetres}cm\"")), "{}", figure.svg);
            let png = figure.png().unwrap().unwrap();
            let reader = ::png::Decoder::new(std::io::Cursor::new(png)).read_info().unwrap();
            let (info, dots) = (reader.info(), reader.info().pixel_dims.unwrap());
            let printed = 100.0 * f64::from(info.width) / f64::from(dots.xppu);
            assert!((printed - centimetres).abs() < 0.01, "{printed}");
        }
    }

    #[test]
    #[cfg_attr(not(feature = "png-figures"), ignore = "needs the feature png-figures")]
    fn the_face_has_the_letters_that_names_may_hold_and_a_box_for_all_others() {
        let (nothing, unknown) = (drawn(" "), drawn("\u{2207}"));
        assert!(unknown != nothing);
        assert_eq!(unknown, drawn("\u{4e00}"));
        for letter in "Aaé€ŁőλεσαΔжЯ±·†×−–…≤≈∞√²⁻⁰₂↑↓".chars().map(String::from)
        {
            let drawn = drawn(&letter);
            assert!(drawn != unknown && drawn != nothing, "{letter}");
        }
    }
}
