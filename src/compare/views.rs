//! A held-out view as several runs render it: one picture, its numbers, and a fade between two.

use std::path::Path;

use serde::Serialize;

use super::zoom::{Window, most_different};
use super::{BAR, Contender, Difference, colour_bar, crop, differences, differences::told, lines, note, trained_on};
use crate::base::files::{write_atomic, write_json};
use crate::base::{Error, Image, Result};
use crate::data::resample;
use crate::draw::canvas::{
    Anchor, BLACK, Drawing, FINENESS, Figure, LINE_HEIGHT, PAPER, RED, SIDE, TEXT, TITLE, text_width, wrapped,
};
use crate::draw::{depth_colour, depth_range, quantise, scale_colour, write_timed_gif};
use crate::metrics::{ViewMetrics, measure};
use crate::run::{Protocol, RenderedView};

/// Share of the view's sides that the box has where nobody says how large it is to be.
const BOX_SHARE: usize = 5;
/// Pixels of the PNG between which the picture of a view is wide where whole factors allow it.
const SHOWN: (usize, usize) = (400, 1024);
/// Between two pictures.
const GAP: f64 = 10.0;
/// Hundredths of a second that each run stays in the fade, and each step between them.
const STAY: u16 = 120;
const STEP: u16 = 8;
/// Steps of the fade from one run to the other.
const STEPS: usize = 9;

/// Runs before one view, rendered and measured.
pub struct Comparison {
    sides: Vec<Side>,
    differences: Vec<Difference>,
    window: Window,
    asked: bool,
    /// End of the errors' scale, which starts at 0.
    error_top: f32,
    /// Ends of the depths' scale.
    depths: (f32, f32),
}

struct Side {
    run: Contender,
    rendered: RenderedView,
    /// Root of the mean squared difference over channels of each pixel's 8-bit values.
    errors: Vec<f32>,
    metrics: ViewMetrics,
    metrics_in_box: ViewMetrics,
}

/// `compare.json`.
#[derive(Serialize)]
struct Report<'a> {
    scene: &'a str,
    view: &'a str,
    index: usize,
    #[serde(rename = "box")]
    window: Window,
    box_chosen_by: &'static str,
    /// What the error's darkest and brightest colours stand for, in colour values of 0..=1.
    error_colours: (f32, f32),
    /// Nearest and farthest colour.
    depth_colours: (f32, f32),
    depth_unit: &'static str,
    differences: &'a [Difference],
    runs: Vec<RunReport<'a>>,
}

#[derive(Serialize)]
struct RunReport<'a> {
    run: &'a str,
    view: &'a ViewMetrics,
    #[serde(rename = "box")]
    in_box: &'a ViewMetrics,
    protocol: &'a Protocol,
}

impl Comparison {
    /// Of runs that have passed [`Contender::check_alike`], each with its rendering. The box is `window`, or the one
    /// of `box_width` columns (a fifth of the view's where not given) and the view's aspect over which the runs'
    /// squared errors differ most.
    pub fn new(
        runs: Vec<(Contender, RenderedView)>,
        window: Option<Window>,
        box_width: Option<usize>,
    ) -> Result<Comparison> {
        let Some((first, _)) = runs.first() else {
            return Err(Error::Config("there is no run to compare; name at least one".into()));
        };
        let (truth, bounds) = (first.view.image.clone(), first.bounds);
        check_box(window, box_width, &truth)?;
        let images: Vec<&Image> = runs.iter().map(|(_, rendered)| &rendered.image).collect();
        let chosen = match window {
            Some(window) => window,
            None => most_different(&images, &truth, box_size(box_width, truth.width, truth.height)),
        };
        let over = |values: fn(&RenderedView) -> &Vec<f32>| -> Vec<f32> {
            runs.iter().flat_map(|(_, rendered)| values(rendered).iter().copied()).collect()
        };
        // One scale for all runs.
        let depths = depth_range(&over(|r| &r.depth), Some(&over(|r| &r.acc)));
        let named: Vec<&Contender> = runs.iter().map(|(run, _)| run).collect();
        let differences = differences(&named);
        let truth_in_box = crop(&truth, chosen);
        let sides = runs.into_iter().map(|(run, rendered)| {
            let metrics = measure(&run.view.name, &rendered.image, &truth, &[])?;
            let metrics_in_box = measure(&run.view.name, &crop(&rendered.image, chosen), &truth_in_box, &[])?;
            let errors = errors(&rendered.image, &truth);
            Ok(Side { run, rendered, errors, metrics, metrics_in_box })
        });
        let sides = sides.collect::<Result<Vec<Side>>>()?;
        let errors: Vec<f32> = sides.iter().flat_map(|side| side.errors.iter().copied()).collect();
        // A scale without length where all is equal to the truth would colour nothing.
        let error_top = depth_range(&errors, None).map_or(1.0, |(_, top)| top).max(1.0 / 255.0);
        Ok(Comparison {
            sides,
            differences,
            window: chosen,
            asked: window.is_some(),
            error_top,
            depths: depths.unwrap_or((bounds.0 as f32, bounds.1 as f32)),
        })
    }

    /// Writes `compare.png`, `compare.json` and, if `fade`, `fade.gif` into a folder.
    pub fn write(&self, folder: &Path, fade: bool) -> Result<()> {
        write_atomic(&folder.join("compare.png"), &self.figure()?.png)?;
        write_json(&folder.join("compare.json"), &self.report())?;
        if fade {
            self.write_fade(&folder.join("fade.gif"))?;
        }
        Ok(())
    }

    /// The box that the pictures look into.
    pub fn window(&self) -> Window {
        self.window
    }

    fn first(&self) -> &Contender {
        &self.sides[0].run
    }

    fn truth(&self) -> &Image {
        &self.first().view.image
    }

    fn chosen_by(&self) -> &'static str {
        match (self.asked, self.sides.len()) {
            (true, _) => "hand",
            (_, 1) => "largest squared error",
            _ => "largest difference of the runs' squared errors",
        }
    }

    fn report(&self) -> Report<'_> {
        let first = self.first();
        let runs = self.sides.iter().map(|side| RunReport {
            run: &side.run.label,
            view: &side.metrics,
            in_box: &side.metrics_in_box,
            protocol: &side.run.protocol,
        });
        Report {
            scene: &first.protocol.scene,
            view: &first.view.name,
            index: first.index,
            window: self.window,
            box_chosen_by: self.chosen_by(),
            error_colours: (0.0, self.error_top),
            depth_colours: self.depths,
            depth_unit: first.depth_unit(),
            differences: &self.differences,
            runs: runs.collect(),
        }
    }

    /// One row for the truth and one a run: view, box, error, depth.
    pub fn figure(&self) -> Result<Figure> {
        let scale = Shown::of(self.truth());
        let mut drawing = Drawing::new(2.0 * SIDE + 4.0 * scale.width + 3.0 * GAP, 0.0);
        let left = |column: usize| SIDE + column as f64 * (scale.width + GAP);
        let width = drawing.width - 2.0 * SIDE;
        let mut y = lines(&mut drawing, (SIDE, 20.0), width, &self.first().title(), (TITLE, BLACK)) + 8.0;
        for (column, name) in ["truth", "box", self.spread_name(), self.truth_depth_name()].iter().enumerate() {
            drawing.text((left(column), y), name, TEXT, Anchor::Left, BLACK);
        }
        y += 12.0;
        self.draw_truth(&mut drawing, &scale, y, &left)?;
        y += scale.height + 8.0;
        for (index, side) in self.sides.iter().enumerate() {
            y = self.draw_label(&mut drawing, index, y + LINE_HEIGHT / 2.0 + 4.0) + 4.0;
            let depth = &side.rendered.depth;
            self.draw_view(&mut drawing, &scale, y, &left, &side.rendered.image)?;
            scale.draw_map(&mut drawing, (left(2), y), &self.error_picture(&side.errors))?;
            scale.draw_map(&mut drawing, (left(3), y), &self.depth_picture(depth, Some(&side.rendered.acc))?)?;
            self.draw_box(&mut drawing, &scale, (left(2), y));
            self.draw_box(&mut drawing, &scale, (left(3), y));
            y += scale.height + 8.0;
        }
        self.draw_bars(&mut drawing, &scale, y, &left)?;
        drawing.height = y + BAR + 8.0;
        drawing.caption(&self.caption(&scale));
        drawing.finish()
    }

    fn spread_name(&self) -> &'static str {
        if self.sides.len() > 1 { "largest minus smallest error" } else { "" }
    }

    fn truth_depth_name(&self) -> &'static str {
        if self.truth_depth().is_some() { "depth" } else { "" }
    }

    /// The view's own depth in the units of the runs' depth, where there is any.
    fn truth_depth(&self) -> Option<&Vec<f32>> {
        let first = self.first();
        first.view.depth.as_ref().filter(|_| first.ndc.is_none())
    }

    fn draw_truth(&self, drawing: &mut Drawing, scale: &Shown, y: f64, left: &impl Fn(usize) -> f64) -> Result<()> {
        self.draw_view(drawing, scale, y, left, self.truth())?;
        if self.sides.len() > 1 {
            scale.draw_map(drawing, (left(2), y), &self.error_picture(&self.spread()))?;
            self.draw_box(drawing, scale, (left(2), y));
        }
        if let Some(depth) = self.truth_depth() {
            scale.draw_map(drawing, (left(3), y), &self.depth_picture(depth, None)?)?;
            self.draw_box(drawing, scale, (left(3), y));
        }
        Ok(())
    }

    /// The view with the box's outline, and what is in the box.
    fn draw_view(
        &self,
        drawing: &mut Drawing,
        scale: &Shown,
        y: f64,
        left: &impl Fn(usize) -> f64,
        image: &Image,
    ) -> Result<()> {
        scale.draw(drawing, (left(0), y), image)?;
        self.draw_box(drawing, scale, (left(0), y));
        let inside = crop(image, self.window);
        let Window { width, height, .. } = self.window;
        let times = (scale.width / width as f64).min(scale.height / height as f64);
        let size = (times * width as f64, times * height as f64);
        drawing.picture((left(1), y), size, &inside)?;
        drawing.outline((left(1), y), size, RED, 1.5);
        Ok(())
    }

    fn draw_box(&self, drawing: &mut Drawing, scale: &Shown, (x, y): (f64, f64)) {
        let Window { x: column, y: row, width, height } = self.window;
        let units = scale.width / self.truth().width as f64;
        let place = (x + column as f64 * units, y + row as f64 * units);
        let size = (width as f64 * units, height as f64 * units);
        // White below, so that it is seen on every colour.
        drawing.outline(place, size, PAPER, 3.0);
        drawing.outline(place, size, RED, 1.5);
    }

    /// A run's name, its metrics and what it differs in; returns where its pictures start.
    fn draw_label(&self, drawing: &mut Drawing, index: usize, mut y: f64) -> f64 {
        let side = &self.sides[index];
        let (view, in_box) = (metrics_text(&side.metrics), metrics_text(&side.metrics_in_box));
        let numbers = format!("view: {view}; box: {in_box}");
        let right = drawing.width - SIDE;
        let below = lines(drawing, (SIDE, y), right - SIDE, &side.run.label, (TITLE, BLACK));
        // Beside the name, or below one that leaves no room.
        if SIDE + text_width(&side.run.label, TITLE) + 20.0 + text_width(&numbers, TEXT) > right {
            y = below;
        }
        drawing.text((right, y), &numbers, TEXT, Anchor::Right, BLACK);
        let below = below.max(y + LINE_HEIGHT);
        note(drawing, (SIDE, below), right - SIDE, &told(&self.differences, index)) - LINE_HEIGHT / 2.0
    }

    /// The colours' scales below the columns that they belong to.
    fn draw_bars(&self, drawing: &mut Drawing, scale: &Shown, y: f64, left: &impl Fn(usize) -> f64) -> Result<()> {
        let (near, far) = self.depths;
        let unit = format!("depth ({})", self.first().depth_unit());
        colour_bar(drawing, (left(2), y), scale.width, (0.0, self.error_top), false, "error (1: black for white)")?;
        // Near is bright.
        colour_bar(drawing, (left(3), y), scale.width, (near, far), true, &unit)
    }

    fn caption(&self, scale: &Shown) -> String {
        let Window { x, y, width, height } = self.window;
        let by = match self.chosen_by() {
            "hand" => "chosen by hand".to_string(),
            reason => format!("chosen by the {reason}"),
        };
        let mut text = format!(
            "Box: {width} x {height} pixels from ({x}, {y}), {by}. Error: root of the mean squared difference of a \
             pixel's three 8-bit colours to the truth. Scales are the same for all runs; the last colours stand for \
             everything beyond, such as the outermost 2 % of the runs' values. Grey depth: nothing there."
        );
        if !self.differences.is_empty() {
            text += " Below names: what these runs differ in.";
        }
        if scale.shrink > 1 {
            text += &format!(" Views are shown at 1/{} of their size.", scale.shrink);
        }
        text + &trained_on(self.sides.iter().map(|side| &side.run))
    }

    fn error_picture(&self, errors: &[f32]) -> Image {
        let Image { width, height, .. } = *self.truth();
        let pixels = errors.iter().flat_map(|error| scale_colour(error / self.error_top)).collect();
        Image { width, height, channels: 3, pixels }
    }

    /// For each pixel the largest error of all runs less the smallest.
    fn spread(&self) -> Vec<f32> {
        let over = |pixel: usize, pick: fn(f32, f32) -> f32| {
            self.sides.iter().map(|side| side.errors[pixel]).reduce(pick).unwrap_or(0.0)
        };
        (0..self.sides[0].errors.len()).map(|pixel| over(pixel, f32::max) - over(pixel, f32::min)).collect()
    }

    fn depth_picture(&self, depth: &[f32], acc: Option<&[f32]>) -> Result<Image> {
        let Image { width, height, .. } = *self.truth();
        depth_colour(depth, width, height, self.depths.0, self.depths.1, acc)
    }

    /// Both runs in turn, each under its name, with a fade from one to the other and back.
    fn write_fade(&self, path: &Path) -> Result<()> {
        check_fade(self.sides.len())?;
        let scale = Shown::of(self.truth());
        let texts: Vec<Vec<String>> = self.sides.iter().map(|side| side.fade_text(scale.width)).collect();
        let lines = texts.iter().map(Vec::len).max().unwrap_or(0);
        let names = texts.iter().map(|text| name_strip(text, lines, scale.width)).collect::<Result<Vec<Image>>>()?;
        let views = self.sides.iter().map(|side| scale.raster(&side.rendered.image)).collect::<Result<Vec<Image>>>()?;
        let frame = |step: usize| {
            let share = step as f32 / (STEPS + 1) as f32;
            // Names change at once: two over one another could not be read.
            let name = &names[if share < 0.5 { 0 } else { 1 }];
            let mixed = views[0].pixels.iter().zip(&views[1].pixels).map(|(a, b)| a + share * (b - a));
            let pixels: Vec<f32> = name.pixels.iter().copied().chain(mixed).collect();
            Image { height: name.height + views[0].height, pixels, ..*name }
        };
        let frames: Vec<Image> = (0..=STEPS + 1).chain((1..=STEPS).rev()).map(frame).collect();
        let delays: Vec<u16> = (0..frames.len()).map(|i| if i % (STEPS + 1) == 0 { STAY } else { STEP }).collect();
        write_timed_gif(path, &frames, &delays)
    }
}

impl Side {
    /// Name and metrics in lines of at most `width`.
    fn fade_text(&self, width: f64) -> Vec<String> {
        [self.run.label.clone(), metrics_text(&self.metrics)]
            .iter()
            .flat_map(|text| wrapped(text, width - 8.0, TEXT))
            .collect()
    }
}

/// Text on paper of `lines` lines.
fn name_strip(text: &[String], lines: usize, width: f64) -> Result<Image> {
    let mut drawing = Drawing::new(width, lines as f64 * LINE_HEIGHT + 6.0);
    for (index, line) in text.iter().enumerate() {
        let y = 3.0 + (index as f64 + 0.5) * LINE_HEIGHT;
        drawing.text((4.0, y), line, TEXT, Anchor::Left, BLACK);
    }
    drawing.raster()
}

/// Refuses a fade between any other number of runs than two.
pub fn check_fade(runs: usize) -> Result<()> {
    if runs == 2 {
        return Ok(());
    }
    Err(Error::Config(format!("--gif fades between two runs and here is {runs}; name two, or leave --gif out")))
}

/// How a view is brought to a size that can be read: enlarged or made smaller by a whole factor, so
/// that its pixels stay what they are.
struct Shown {
    shrink: usize,
    /// In the drawing's units.
    width: f64,
    height: f64,
}

impl Shown {
    fn of(image: &Image) -> Shown {
        let times = SHOWN.0.div_ceil(image.width) as f64;
        let shrink = image.width.div_ceil(SHOWN.1);
        let units = |length: usize| (length / shrink).max(1) as f64 * times / FINENESS;
        Shown { shrink, width: units(image.width), height: units(image.height) }
    }

    /// The image's pixels at this size.
    fn raster(&self, image: &Image) -> Result<Image> {
        let mut drawing = Drawing::new(self.width, self.height);
        self.draw(&mut drawing, (0.0, 0.0), image)?;
        drawing.raster()
    }

    fn draw(&self, drawing: &mut Drawing, at: (f64, f64), image: &Image) -> Result<()> {
        if self.shrink == 1 {
            return drawing.picture(at, (self.width, self.height), image);
        }
        let (width, height) = self.shrunk(image);
        drawing.picture(at, (self.width, self.height), &resample::shrink(image, width, height))
    }

    /// A coloured map: every so manieth pixel as it is, for a mean of colours stands for no number.
    fn draw_map(&self, drawing: &mut Drawing, at: (f64, f64), map: &Image) -> Result<()> {
        let (width, height) = self.shrunk(map);
        let middle = |place: usize| self.shrink * place + self.shrink / 2;
        let pixel = |x: usize, y: usize| {
            let (x, y) = (middle(x).min(map.width - 1), middle(y).min(map.height - 1));
            map.pixels[(y * map.width + x) * map.channels..][..map.channels].to_vec()
        };
        let pixels = (0..height).flat_map(|y| (0..width).flat_map(move |x| pixel(x, y))).collect();
        drawing.picture(at, (self.width, self.height), &Image { width, height, channels: map.channels, pixels })
    }

    fn shrunk(&self, image: &Image) -> (usize, usize) {
        let side = |length: usize| (length / self.shrink).max(1);
        (side(image.width), side(image.height))
    }
}

/// Refuses a box, or columns of one, that the view has no room for.
pub fn check_box(window: Option<Window>, box_width: Option<usize>, view: &Image) -> Result<()> {
    if let Some(window) = window {
        window.check(view.width, view.height)?;
    }
    match box_width {
        Some(columns) if columns > view.width => Err(Error::Config(format!(
            "--box-width {columns} is more than the {0} columns of the view; give at most {0}",
            view.width
        ))),
        _ => Ok(()),
    }
}

/// Columns and rows of a box of the view's aspect.
fn box_size(asked: Option<usize>, width: usize, height: usize) -> (usize, usize) {
    let columns = asked.unwrap_or((width + BOX_SHARE / 2) / BOX_SHARE).max(1);
    let rows = (columns as f64 * height as f64 / width as f64).round() as usize;
    (columns, rows.clamp(1, height))
}

/// Root of the mean squared difference over channels of the 8-bit values, for each pixel.
fn errors(rendered: &Image, truth: &Image) -> Vec<f32> {
    let (a, b) = (quantise(&rendered.pixels), quantise(&truth.pixels));
    let error = |(a, b): (&[u8], &[u8])| {
        let sum: u32 = a.iter().zip(b).map(|(&a, &b)| u32::from(a.abs_diff(b)).pow(2)).sum();
        (sum as f32 / a.len() as f32).sqrt() / 255.0
    };
    a.chunks_exact(3).zip(b.chunks_exact(3)).map(error).collect()
}

/// PSNR and SSIM as far as they are known.
fn metrics_text(metrics: &ViewMetrics) -> String {
    let psnr = metrics.get("psnr").map_or("equal to the truth".into(), |psnr| format!("PSNR {psnr:.2} dB"));
    metrics.get("ssim").map_or(psnr.clone(), |ssim| format!("{psnr}, SSIM {ssim:.3}"))
}
