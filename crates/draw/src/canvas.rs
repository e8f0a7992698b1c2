//! Drawings as SVG: a canvas holds a list of marks, which the SVG has as text.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use svg::node::element::{Circle, Image as Raster, Polygon, Polyline, Rectangle, Text};
use svg::{Document, Node};

pub use super::panel::{Panel, range, tick_texts, ticks};
use super::pictures::encode_png8;
pub use super::words::{text_width, wrapped};
use crate::base::{Error, Image, Result};

/// A finished figure.
#[derive(Clone)]
pub struct Figure {
    /// SVG text.
    pub svg: String,
    /// What it shows, and on the next line how it is read; empty if the figure says so itself.
    pub caption: String,
}

/// Name and content of a file.
pub type File = (String, Vec<u8>);

impl Figure {
    /// Returns `NAME.svg`, and the caption as `NAME.txt`.
    pub fn files(self, name: &str) -> Vec<File> {
        let caption = (!self.caption.is_empty()).then(|| (format!("{name}.txt"), self.caption.into_bytes()));
        std::iter::once((format!("{name}.svg"), self.svg.into_bytes())).chain(caption).collect()
    }
}

/// Width of a figure: 17 cm in print, where letters have 7 pt.
pub const PAGE: f64 = 895.0;
/// Centimetres of a canvas's unit.
const CENTIMETRES: f64 = 17.0 / PAGE;

/// Fonts whose letters are as wide as those of the embedded one, by which texts are measured.
const FONT_FAMILY: &str = "Arial, Helvetica, Liberation Sans, sans-serif";
/// Size of letters: 7 pt in print.
pub const TEXT: f64 = 13.0;
/// From one line of text to the next.
pub const LINE_HEIGHT: f64 = 18.0;
/// What a drawing leaves free at its sides.
pub const SIDE: f64 = 20.0;

/// Pixels from the corner beyond which nothing is drawn.
const FAR: f64 = 1e6;

/// Red, green, blue.
#[derive(Clone, Copy)]
pub struct Colour(u8, u8, u8);

impl Colour {
    /// The nearest to one of three shares.
    pub fn of(rgb: [f32; 3]) -> Colour {
        let [r, g, b] = rgb.map(|share| (share.clamp(0.0, 1.0) * 255.0).round() as u8);
        Colour(r, g, b)
    }

    fn text(self) -> String {
        format!("rgb({},{},{})", self.0, self.1, self.2)
    }
}

/// Background of figures.
pub const PAPER: Colour = Colour(255, 255, 255);
/// Axes and text.
pub const BLACK: Colour = Colour(30, 30, 30);
/// Secondary text.
pub const GREY: Colour = Colour(110, 110, 110);
/// Grid lines.
pub const GRID: Colour = Colour(225, 225, 225);
/// What is better.
pub const BLUE: Colour = Colour(0, 114, 178);
/// What is worse.
pub const ORANGE: Colour = Colour(213, 94, 0);
/// Colours of rows, which colour-blind readers tell apart. None is the colour of a verdict.
pub const PALETTE: [Colour; 8] = [
    Colour(60, 60, 60),
    Colour(0, 158, 115),
    Colour(204, 121, 167),
    Colour(86, 180, 233),
    Colour(230, 159, 0),
    Colour(117, 80, 160),
    Colour(140, 81, 40),
    Colour(130, 150, 40),
];

/// Which part of a text stands at its place.
#[derive(Clone, Copy)]
pub enum Anchor {
    /// At the left end of the text.
    Left,
    /// At the middle of the text.
    Middle,
    /// At the right end of the text.
    Right,
}

/// Length of a dash and of the gap after it, in pixels.
const DASHES: [f32; 2] = [6.0, 4.0];

/// One element of a drawing.
enum Mark {
    Line {
        points: Vec<(f64, f64)>,
        colour: Colour,
        width: f64,
        dashed: bool,
    },
    Area {
        points: Vec<(f64, f64)>,
        colour: Colour,
        opacity: f64,
    },
    Dot {
        at: (f64, f64),
        radius: f64,
        colour: Colour,
        opacity: f64,
    },
    /// `at` is on the baseline, at the end that the anchor names.
    Text {
        at: (f64, f64),
        text: String,
        size: f64,
        anchor: Anchor,
        colour: Colour,
    },
    /// `at` is the upper left corner; pixels become rectangles.
    Picture {
        at: (f64, f64),
        size: (f64, f64),
        png: Vec<u8>,
    },
}

/// What a figure is made of, in pixels from the upper left corner.
pub struct Canvas {
    /// Width in pixels.
    pub width: f64,
    /// Height in pixels.
    pub height: f64,
    marks: Vec<Mark>,
}

impl Canvas {
    /// Returns an empty canvas of this size in pixels.
    pub fn new(width: f64, height: f64) -> Canvas {
        Canvas { width, height, marks: Vec::new() }
    }

    /// A canvas of a figure's width with its title, which wraps. The height ends below the title.
    pub fn titled(title: &str) -> Canvas {
        let mut canvas = Canvas::new(PAGE, 0.0);
        canvas.height = canvas.lines((SIDE, 20.0), canvas.width - 2.0 * SIDE, title, BLACK);
        canvas
    }

    /// Writes lines of at most `width`, from `(x, y)` down; returns the position after them.
    pub fn lines(&mut self, (x, mut y): (f64, f64), width: f64, text: &str, colour: Colour) -> f64 {
        for line in wrapped(text, width, TEXT) {
            self.text((x, y), &line, TEXT, Anchor::Left, colour);
            y += LINE_HEIGHT;
        }
        y
    }

    /// Writes a name in lines of at most `width` that end at `x`, centred vertically on `y`.
    pub fn name(&mut self, (x, y): (f64, f64), width: f64, text: &str) {
        let lines = wrapped(text, width, TEXT);
        let first = y - LINE_HEIGHT * (lines.len() as f64 - 1.0) / 2.0;
        for (index, line) in lines.iter().enumerate() {
            self.text((x, first + LINE_HEIGHT * index as f64), line, TEXT, Anchor::Right, BLACK);
        }
    }

    /// Draws a line through points.
    pub fn line(&mut self, points: &[(f64, f64)], colour: Colour, width: f64) {
        self.marks.push(Mark::Line { points: drawable(points), colour, width, dashed: false });
    }

    /// Draws a dashed line through points.
    pub fn dashed(&mut self, points: &[(f64, f64)], colour: Colour, width: f64) {
        self.marks.push(Mark::Line { points: drawable(points), colour, width, dashed: true });
    }

    /// Fills the area within points.
    pub fn area(&mut self, points: Vec<(f64, f64)>, colour: Colour, opacity: f64) {
        self.marks.push(Mark::Area { points: drawable(&points), colour, opacity });
    }

    /// Draws a disc.
    pub fn dot(&mut self, at: (f64, f64), radius: f64, colour: Colour, opacity: f64) {
        self.marks.extend(drawable(&[at]).pop().map(|at| Mark::Dot { at, radius, colour, opacity }));
    }

    /// Draws a triangle that points up or down.
    pub fn triangle(&mut self, (x, y): (f64, f64), radius: f64, up: bool, colour: Colour) {
        let tip = if up { -radius } else { radius };
        self.area(vec![(x - radius, y - 0.7 * tip), (x + radius, y - 0.7 * tip), (x, y + tip)], colour, 1.0);
    }

    /// Writes a line of text, centred vertically on `at`.
    pub fn text(&mut self, at: (f64, f64), text: &str, size: f64, anchor: Anchor, colour: Colour) {
        // XML knows no way to write these.
        let text = text.replace(|letter: char| letter.is_control() || matches!(letter, '\u{fffe}' | '\u{ffff}'), " ");
        // From the middle of the letters to their baseline.
        let foot = (at.0, at.1 + 0.34 * size);
        self.marks.extend(drawable(&[foot]).pop().map(|at| Mark::Text { at, text, size, anchor, colour }));
    }

    /// The outline of a rectangle from its upper left corner.
    pub fn outline(&mut self, (x, y): (f64, f64), (width, height): (f64, f64), colour: Colour, thickness: f64) {
        let (right, bottom) = (x + width, y + height);
        // A fourth corner of its own, and beyond it: a line's ends have no mitre.
        self.line(&[(x, y), (right, y), (right, bottom), (x, bottom), (x, y), (right, y)], colour, thickness);
    }

    /// A picture, stretched to `size`; its pixels stay sharp.
    pub fn picture(&mut self, at: (f64, f64), size: (f64, f64), picture: &Image) -> Result<()> {
        let png = encode_png8(picture).map_err(|e| Error::Output(format!("cannot draw a figure: {e}")))?;
        self.marks.push(Mark::Picture { at, size, png });
        Ok(())
    }

    /// Wrapped text below everything; the drawing grows by its height.
    pub fn caption(&mut self, text: &str) {
        for line in wrapped(text, self.width - 2.0 * SIDE, TEXT) {
            self.text((SIDE, self.height + LINE_HEIGHT / 2.0), &line, TEXT, Anchor::Left, GREY);
            self.height += LINE_HEIGHT;
        }
        self.height += LINE_HEIGHT / 2.0;
    }

    /// Returns the figure, without a caption.
    pub fn finish(self) -> Figure {
        Figure { svg: self.svg(), caption: String::new() }
    }

    fn svg(&self) -> String {
        let (width, height) = (self.width.ceil(), self.height.ceil());
        let [wide, high] = [width, height].map(|units| format!("{}cm", (units * CENTIMETRES * 100.0).round() / 100.0));
        let mut document = Document::new().set("viewBox", (0, 0, width, height)).set("width", wide).set("height", high);
        document.append(Rectangle::new().set("width", width).set("height", height).set("fill", "white"));
        self.marks.iter().for_each(|mark| mark.write(&mut document));
        document.to_string()
    }
}

impl Mark {
    fn write(&self, document: &mut Document) {
        let points = |points: &[(f64, f64)]| {
            points.iter().map(|(x, y)| format!("{x:.1},{y:.1}")).collect::<Vec<String>>().join(" ")
        };
        match self {
            Mark::Line { points: along, colour, width, dashed } => {
                let line = Polyline::new().set("points", points(along)).set("fill", "none");
                let line = line.set("stroke", colour.text()).set("stroke-width", *width);
                let [dash, gap] = DASHES;
                document.append(if *dashed { line.set("stroke-dasharray", format!("{dash} {gap}")) } else { line });
            }
            Mark::Area { points: around, colour, opacity } => {
                let area = Polygon::new().set("points", points(around)).set("fill", colour.text());
                document.append(area.set("fill-opacity", *opacity));
            }
            Mark::Dot { at: (x, y), radius, colour, opacity } => {
                let dot = Circle::new().set("cx", format!("{x:.1}")).set("cy", format!("{y:.1}")).set("r", *radius);
                document.append(dot.set("fill", colour.text()).set("fill-opacity", *opacity));
            }
            Mark::Text { at: (x, y), text, size, anchor, colour } => {
                let anchor = match anchor {
                    Anchor::Left => "start",
                    Anchor::Middle => "middle",
                    Anchor::Right => "end",
                };
                let element = Text::new(text.as_str()).set("x", format!("{x:.1}")).set("y", format!("{y:.1}"));
                let element = element.set("font-family", FONT_FAMILY).set("font-size", *size);
                let element = element.set("text-anchor", anchor).set("fill", colour.text());
                let width = text_width(text, *size);
                // A browser without this font scales its own to this width, so that no text leaves the figure.
                document.append(match width > 0.0 {
                    true => element.set("textLength", format!("{width:.1}")).set("lengthAdjust", "spacingAndGlyphs"),
                    false => element,
                });
            }
            Mark::Picture { at: (x, y), size: (width, height), png } => {
                let raster = Raster::new().set("x", *x).set("y", *y).set("width", *width).set("height", *height);
                let raster = raster.set("preserveAspectRatio", "none");
                // As an attribute it would not be known: SVG 2 has this value in styles alone.
                let raster = raster.set("style", "image-rendering:pixelated");
                document.append(raster.set("href", format!("data:image/png;base64,{}", STANDARD.encode(png))));
            }
        }
    }
}

/// Returns the finite points, clamped to [`FAR`].
fn drawable(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let finite = points.iter().filter(|(x, y)| x.is_finite() && y.is_finite());
    finite.map(|(x, y)| (x.clamp(-FAR, FAR), y.clamp(-FAR, FAR))).collect()
}
