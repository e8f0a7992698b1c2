//! The image of a comparison.

use super::comparison::{Comparison, metrics_text};
use super::differences::difference_text;
use super::display_size::DisplaySize;
use super::parts::{BAR, colour_bar, lines, note, trained_on};
use super::window::{Window, crop};
use crate::base::{Image, Result};
use crate::draw::canvas::{Anchor, BLACK, Canvas, Figure, LINE_HEIGHT, PAPER, RED, SIDE, TEXT, TITLE, text_width};
use crate::draw::{depth_colour, scale_colour};

/// Gap between two images.
const GAP: f64 = 10.0;

/// Draws one row for the ground truth and one a run: view, box, error, depth.
pub fn draw(comparison: &Comparison) -> Result<Figure> {
    ComparisonFigure { comparison }.draw()
}

struct ComparisonFigure<'a> {
    comparison: &'a Comparison,
}

impl ComparisonFigure<'_> {
    fn draw(&self) -> Result<Figure> {
        let scale = DisplaySize::of(self.comparison.truth());
        let mut canvas = Canvas::new(2.0 * SIDE + 4.0 * scale.width + 3.0 * GAP, 0.0);
        let left = |column: usize| SIDE + column as f64 * (scale.width + GAP);
        let width = canvas.width - 2.0 * SIDE;
        let mut y = lines(&mut canvas, (SIDE, 20.0), width, &self.comparison.first().title(), (TITLE, BLACK)) + 8.0;
        for (column, name) in ["truth", "box", self.spread_name(), self.truth_depth_name()].iter().enumerate() {
            canvas.text((left(column), y), name, TEXT, Anchor::Left, BLACK);
        }
        y += 12.0;
        self.draw_truth(&mut canvas, &scale, y, &left)?;
        y += scale.height + 8.0;
        for (index, side) in self.comparison.sides.iter().enumerate() {
            y = self.draw_label(&mut canvas, index, y + LINE_HEIGHT / 2.0 + 4.0) + 4.0;
            let depth = &side.rendered.depth;
            self.draw_view(&mut canvas, &scale, y, &left, &side.rendered.image)?;
            scale.draw_map(&mut canvas, (left(2), y), &self.error_picture(&side.errors))?;
            scale.draw_map(&mut canvas, (left(3), y), &self.depth_picture(depth, Some(&side.rendered.acc))?)?;
            self.draw_box(&mut canvas, &scale, (left(2), y));
            self.draw_box(&mut canvas, &scale, (left(3), y));
            y += scale.height + 8.0;
        }
        self.draw_bars(&mut canvas, &scale, y, &left)?;
        canvas.height = y + BAR + 8.0;
        canvas.caption(&self.caption(&scale));
        canvas.finish()
    }

    fn spread_name(&self) -> &'static str {
        if self.comparison.sides.len() > 1 { "largest minus smallest error" } else { "" }
    }

    fn truth_depth_name(&self) -> &'static str {
        if self.comparison.truth_depth().is_some() { "depth" } else { "" }
    }

    fn draw_truth(&self, canvas: &mut Canvas, scale: &DisplaySize, y: f64, left: &impl Fn(usize) -> f64) -> Result<()> {
        self.draw_view(canvas, scale, y, left, self.comparison.truth())?;
        if self.comparison.sides.len() > 1 {
            scale.draw_map(canvas, (left(2), y), &self.error_picture(&self.comparison.spread()))?;
            self.draw_box(canvas, scale, (left(2), y));
        }
        if let Some(depth) = self.comparison.truth_depth() {
            scale.draw_map(canvas, (left(3), y), &self.depth_picture(depth, None)?)?;
            self.draw_box(canvas, scale, (left(3), y));
        }
        Ok(())
    }

    /// Draws the view with the box's outline, and the box enlarged.
    fn draw_view(
        &self,
        canvas: &mut Canvas,
        scale: &DisplaySize,
        y: f64,
        left: &impl Fn(usize) -> f64,
        image: &Image,
    ) -> Result<()> {
        scale.draw(canvas, (left(0), y), image)?;
        self.draw_box(canvas, scale, (left(0), y));
        let inside = crop(image, self.comparison.window);
        let Window { width, height, .. } = self.comparison.window;
        let times = (scale.width / width as f64).min(scale.height / height as f64);
        let size = (times * width as f64, times * height as f64);
        canvas.picture((left(1), y), size, &inside)?;
        canvas.outline((left(1), y), size, RED, 1.5);
        Ok(())
    }

    fn draw_box(&self, canvas: &mut Canvas, scale: &DisplaySize, (x, y): (f64, f64)) {
        let Window { x: column, y: row, width, height } = self.comparison.window;
        let units = scale.width / self.comparison.truth().width as f64;
        let place = (x + column as f64 * units, y + row as f64 * units);
        let size = (width as f64 * units, height as f64 * units);
        // White below, so that the outline is visible on every colour.
        canvas.outline(place, size, PAPER, 3.0);
        canvas.outline(place, size, RED, 1.5);
    }

    /// Draws a run's name, metrics and differences; returns where its images start.
    fn draw_label(&self, canvas: &mut Canvas, index: usize, mut y: f64) -> f64 {
        let side = &self.comparison.sides[index];
        let (view, in_box) = (metrics_text(&side.metrics), metrics_text(&side.metrics_in_box));
        let numbers = format!("view: {view}; box: {in_box}");
        let right = canvas.width - SIDE;
        let below = lines(canvas, (SIDE, y), right - SIDE, &side.run.label, (TITLE, BLACK));
        // Next to the name, or below a name that leaves no space.
        if SIDE + text_width(&side.run.label, TITLE) + 20.0 + text_width(&numbers, TEXT) > right {
            y = below;
        }
        canvas.text((right, y), &numbers, TEXT, Anchor::Right, BLACK);
        let below = below.max(y + LINE_HEIGHT);
        note(canvas, (SIDE, below), right - SIDE, &difference_text(&self.comparison.differences, index))
            - LINE_HEIGHT / 2.0
    }

    /// Draws the colour bars below their columns.
    fn draw_bars(&self, canvas: &mut Canvas, scale: &DisplaySize, y: f64, left: &impl Fn(usize) -> f64) -> Result<()> {
        let (near, far) = self.comparison.depths;
        let unit = format!("depth ({})", self.comparison.first().depth_unit());
        colour_bar(
            canvas,
            (left(2), y),
            scale.width,
            (0.0, self.comparison.error_top),
            false,
            "error (1: black for white)",
        )?;
        // Near is bright.
        colour_bar(canvas, (left(3), y), scale.width, (near, far), true, &unit)
    }

    fn caption(&self, scale: &DisplaySize) -> String {
        let Window { x, y, width, height } = self.comparison.window;
        let by = match self.comparison.chosen_by() {
            "hand" => "chosen by hand".to_string(),
            reason => format!("chosen by the {reason}"),
        };
        let mut text = format!(
            "Box: {width} x {height} pixels from ({x}, {y}), {by}. Error: root of the mean squared difference of a \
             pixel's three 8-bit colours to the truth. Scales are the same for all runs; the last colours stand for \
             everything beyond, such as the outermost 2 % of the runs' values. Grey depth: little that stops light in a rendering; in the truth, nothing hit or depth not known."
        );
        if !self.comparison.differences.is_empty() {
            text += " Below names: what these runs differ in.";
        }
        if scale.shrink > 1 {
            text += &format!(" Views are shown at 1/{} of their size.", scale.shrink);
        }
        text + &trained_on(self.comparison.sides.iter().map(|side| &side.run))
    }

    fn error_picture(&self, errors: &[f32]) -> Image {
        let Image { width, height, .. } = *self.comparison.truth();
        let pixels = errors.iter().flat_map(|error| scale_colour(error / self.comparison.error_top)).collect();
        Image { width, height, channels: 3, pixels }
    }

    fn depth_picture(&self, depth: &[f32], acc: Option<&[f32]>) -> Result<Image> {
        let Image { width, height, .. } = *self.comparison.truth();
        depth_colour(depth, width, height, self.comparison.depths.0, self.comparison.depths.1, acc)
    }
}
