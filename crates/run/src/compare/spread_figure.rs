//! The images of a spread over seeds: maps of one view, and the calibration curve of all.

use super::display_size::DisplaySize;
use super::parts::{colour_bar, striped};
use super::spread_files::Spread;
use crate::base::{Image, Result};
use crate::draw::canvas::{Anchor, BLACK, Canvas, Figure, LINE_HEIGHT, TEXT, Width};
use crate::draw::{depth_colour, depth_range, scale_colour};
use crate::report::plots::calibration_figure;

/// Images side by side.
const COLUMNS: usize = 3;

/// Ends of the colour scales. 2 % of the shown view's values are beyond.
pub(super) struct Scales {
    /// Upper end for spread and error, which start at 0.
    pub colour: f32,
    /// Both ends for depth.
    pub depth: (f32, f32),
    /// Upper end for the spread of depth, which starts at 0.
    pub depth_spread: f32,
}

impl Scales {
    pub fn new(spread: &Spread) -> Scales {
        let (found, bounds) = (&spread.shown.found, spread.runs[0].bounds);
        let colours: Vec<f32> = found.spread.iter().chain(&found.error).copied().collect();
        let top = |values: &[f32], acc| depth_range(values, acc).map(|(_, top)| top).filter(|top| *top > 0.0);
        Scales {
            // A scale needs a length, also if all pixels are equal.
            colour: top(&colours, None).unwrap_or(0.0).max(1.0 / 255.0),
            depth: depth_range(&found.depth, Some(&found.acc)).unwrap_or((bounds.0 as f32, bounds.1 as f32)),
            depth_spread: top(&found.depth_spread, Some(&found.acc)).unwrap_or((bounds.1 - bounds.0) as f32),
        }
    }
}

/// Draws ground truth, mean image and mean depth; below, the standard deviation, the error of the mean, and the standard
/// deviation of depth.
pub(super) fn draw(spread: &Spread) -> Result<Figure> {
    let size = DisplaySize::on_page(&spread.shown.view.image, COLUMNS);
    SpreadFigure { spread, size, scales: Scales::new(spread) }.draw()
}

/// Draws error against spread over all common views.
pub(super) fn draw_calibration(spread: &Spread) -> Result<Figure> {
    let seeds = spread.seeds.len();
    let scene = spread.runs[0].protocol.text("scene");
    let title = format!("{}: error against spread over {seeds} seeds on {scene}", spread.row);
    let caption = format!(
        "{} bins of equal numbers of pixels of {} held-out views, by spread. Both axes are root mean squares over the \
         bin's pixels and channels; colours are 0 to 1. All seeds share the method's bias, which their spread cannot \
         show.{}",
        spread.curve.len(),
        spread.views.len(),
        of_differences(spread)
    );
    calibration_figure(&title, &spread.curve, seeds, &caption)
}

/// Returns a note if the seeds differ in more than the seed.
fn of_differences(spread: &Spread) -> String {
    let names = spread.difference_names();
    names.map_or(String::new(), |names| format!(" The seeds also differ in {names}: the spread includes this."))
}

struct SpreadFigure<'a> {
    spread: &'a Spread,
    size: DisplaySize,
    scales: Scales,
}

impl SpreadFigure<'_> {
    fn draw(&self) -> Result<Figure> {
        let (size, found) = (&self.size, &self.spread.shown.found);
        let mut canvas = Canvas::new(Width::Page.units(), 0.0);
        canvas.fineness = size.fineness;
        let width = canvas.width - 2.0 * size.margin;
        let mut y = canvas.lines((size.margin, 20.0), width, &self.title(), BLACK) + 6.0;
        y = self.heads(&mut canvas, y, ["ground truth", "mean image", "mean depth"]);
        size.draw(&mut canvas, (size.left(0), y), &striped(&self.spread.shown.view))?;
        size.draw(&mut canvas, (size.left(1), y), &found.mean)?;
        size.draw_map(&mut canvas, (size.left(2), y), &self.depth(&found.depth, self.scales.depth)?)?;
        y = self.depth_bar(&mut canvas, y + size.height + 8.0)? + 4.0;
        y = self.heads(
            &mut canvas,
            y,
            ["standard deviation", "error of the mean image", "standard deviation of depth"],
        );
        size.draw_map(&mut canvas, (size.left(0), y), &self.map(&found.spread))?;
        size.draw_map(&mut canvas, (size.left(1), y), &self.map(&found.error))?;
        size.draw_map(&mut canvas, (size.left(2), y), &self.depth_spread()?)?;
        canvas.height = self.spread_bars(&mut canvas, y + size.height + 8.0)? + 4.0;
        canvas.caption(&self.caption());
        canvas.finish()
    }

    fn title(&self) -> String {
        let Spread { row, seeds, views, shown, .. } = self.spread;
        let seeds: Vec<String> = seeds.iter().map(u64::to_string).collect();
        format!(
            "{row} on {}, seeds {}: held-out view {} ({} of {})",
            self.spread.runs[0].protocol.text("scene"),
            seeds.join(", "),
            shown.view.name,
            shown.index + 1,
            views.len()
        )
    }

    /// Writes the names of a row of images; returns where the images start.
    fn heads(&self, canvas: &mut Canvas, y: f64, names: [&str; COLUMNS]) -> f64 {
        for (column, name) in names.into_iter().enumerate() {
            canvas.text((self.size.left(column), y), name, TEXT, Anchor::Left, BLACK);
        }
        y + LINE_HEIGHT / 2.0 + 4.0
    }

    fn depth_bar(&self, canvas: &mut Canvas, y: f64) -> Result<f64> {
        // Near is bright.
        colour_bar(canvas, (self.size.left(2), y), self.size.width, self.scales.depth, true, &self.depth_name("depth"))
    }

    fn spread_bars(&self, canvas: &mut Canvas, y: f64) -> Result<f64> {
        let size = &self.size;
        let (both, colours) = (2.0 * size.width + size.gap, (0.0, self.scales.colour));
        let name = "standard deviation and error (1: black for white)";
        let left = colour_bar(canvas, (size.left(0), y), both, colours, false, name)?;
        let depths = (0.0, self.scales.depth_spread);
        let name = self.depth_name("standard deviation of depth");
        let right = colour_bar(canvas, (size.left(2), y), size.width, depths, false, &name)?;
        Ok(left.max(right))
    }

    fn depth_name(&self, what: &str) -> String {
        format!("{what} ({})", self.spread.runs[0].depth_unit())
    }

    fn map(&self, values: &[f32]) -> Image {
        let Image { width, height, .. } = self.spread.shown.found.mean;
        let pixels = values.iter().flat_map(|value| scale_colour(value / self.scales.colour)).collect();
        Image { width, height, channels: 3, pixels }
    }

    fn depth(&self, values: &[f32], (near, far): (f32, f32)) -> Result<Image> {
        let found = &self.spread.shown.found;
        depth_colour(values, found.mean.width, found.mean.height, near, far, Some(&found.acc))
    }

    /// Draws the standard deviation of depth: bright is large.
    fn depth_spread(&self) -> Result<Image> {
        let top = self.scales.depth_spread;
        // A depth map shows small values bright.
        let turned: Vec<f32> = self.spread.shown.found.depth_spread.iter().map(|value| top - value).collect();
        self.depth(&turned, (0.0, top))
    }

    fn caption(&self) -> String {
        let numbers = &self.spread.shown.found.numbers;
        let text = |key: &str, digits: usize| numbers.get(key).map_or("-".into(), |value| format!("{value:.digits$}"));
        let mut caption = format!(
            "PSNR of the mean image {} dB, of single seeds {} dB. Standard deviation over seeds (n - 1) and error of the \
             mean image: root mean square over red, green and blue; over the view they are {} and {}. Spearman's \
             correlation of the two {}. The last colours stand for everything beyond, such as the highest 2 % of the \
             values. Grey depth: little that stops light.{}",
            text("psnr_of_mean", 2),
            text("psnr_of_seeds", 2),
            text("spread_rms", 4),
            text("error_rms", 4),
            text("spearman", 2),
            of_differences(self.spread)
        );
        if self.size.shrink > 1 {
            caption += &format!(" Views are shown at 1/{} of their size.", self.size.shrink);
        }
        caption
    }
}
