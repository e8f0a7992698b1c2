//! The image of a comparison.

use super::comparison::{Comparison, metrics_text};
use super::differences::difference_text;
use super::display_size::DisplaySize;
use super::parts::{colour_bar, note, striped, trained_on};
use super::window::{Window, crop};
use crate::base::{Image, Result};
use crate::draw::canvas::{Anchor, BLACK, Canvas, Figure, GREY, LINE_HEIGHT, ORANGE, PAGE, PAPER, TEXT, text_width};
use crate::draw::{depth_colour, scale_colour};

/// Heads of the columns.
const HEADS: [&str; 4] = ["view", "box", "error", "depth"];
const SPREAD: &str = "largest minus smallest error";

/// Draws one row for the ground truth and one a run: view, box, error, depth.
pub fn draw(comparison: &Comparison) -> Result<Figure> {
    let scale = DisplaySize::on_page(comparison.truth(), HEADS.len());
    ComparisonFigure { comparison, scale }.draw()
}

struct ComparisonFigure<'a> {
    comparison: &'a Comparison,
    scale: DisplaySize,
}

impl ComparisonFigure<'_> {
    fn draw(&self) -> Result<Figure> {
        let scale = &self.scale;
        let mut canvas = Canvas::new(PAGE, 0.0);
        let width = canvas.width - 2.0 * scale.margin;
        let mut y = canvas.lines((scale.margin, 20.0), width, &self.comparison.first().title(), BLACK) + 4.0;
        for (column, name) in HEADS.iter().enumerate() {
            canvas.text((scale.left(column), y), name, TEXT, Anchor::Left, GREY);
        }
        y += LINE_HEIGHT + 4.0;
        canvas.text((scale.margin, y), "ground truth", TEXT, Anchor::Left, BLACK);
        y += 12.0;
        self.draw_truth(&mut canvas, y)?;
        y += scale.height + 8.0;
        for (index, side) in self.comparison.sides.iter().enumerate() {
            y = self.draw_label(&mut canvas, index, y + LINE_HEIGHT / 2.0 + 4.0) + 4.0;
            let depth = &side.rendered.depth;
            self.draw_view(&mut canvas, y, &side.rendered.image)?;
            self.draw_map(&mut canvas, (2, y), &self.error_picture(&side.errors))?;
            self.draw_map(&mut canvas, (3, y), &self.depth_picture(depth, Some(&side.rendered.acc))?)?;
            y += scale.height + 8.0;
        }
        canvas.height = self.draw_bars(&mut canvas, y)? + 4.0;
        canvas.caption(&self.caption());
        Ok(canvas.finish())
    }

    /// Draws the view and, if there are any, the differences between the runs' errors and the depth.
    fn draw_truth(&self, canvas: &mut Canvas, y: f64) -> Result<()> {
        self.draw_view(canvas, y, &striped(&self.comparison.first().view))?;
        if self.comparison.sides.len() > 1 {
            canvas.text((self.scale.left(2), y - 12.0), SPREAD, TEXT, Anchor::Left, BLACK);
            self.draw_map(canvas, (2, y), &self.error_picture(&self.comparison.spread()))?;
        }
        match self.comparison.truth_depth() {
            Some(depth) => self.draw_map(canvas, (3, y), &self.depth_picture(depth, None)?),
            None => Ok(()),
        }
    }

    /// Draws a coloured map with the box's outline.
    fn draw_map(&self, canvas: &mut Canvas, (column, y): (usize, f64), map: &Image) -> Result<()> {
        self.scale.draw_map(canvas, (self.scale.left(column), y), map)?;
        self.draw_box(canvas, (self.scale.left(column), y));
        Ok(())
    }

    /// Draws the view with the box's outline, and the box enlarged.
    fn draw_view(&self, canvas: &mut Canvas, y: f64, image: &Image) -> Result<()> {
        let scale = &self.scale;
        scale.draw(canvas, (scale.left(0), y), image)?;
        self.draw_box(canvas, (scale.left(0), y));
        let inside = crop(image, self.comparison.window);
        let Window { width, height, .. } = self.comparison.window;
        let times = (scale.width / width as f64).min(scale.height / height as f64);
        let size = (times * width as f64, times * height as f64);
        canvas.picture((scale.left(1), y), size, &inside)?;
        canvas.outline((scale.left(1), y), size, ORANGE, 1.5);
        Ok(())
    }

    fn draw_box(&self, canvas: &mut Canvas, (x, y): (f64, f64)) {
        let Window { x: column, y: row, width, height } = self.comparison.window;
        let units = self.scale.width / self.comparison.truth().width as f64;
        let place = (x + column as f64 * units, y + row as f64 * units);
        let size = (width as f64 * units, height as f64 * units);
        // White below, so that the outline is visible on every colour.
        canvas.outline(place, size, PAPER, 3.0);
        canvas.outline(place, size, ORANGE, 1.5);
    }

    /// Draws a run's name, metrics and differences; returns where its images start.
    fn draw_label(&self, canvas: &mut Canvas, index: usize, mut y: f64) -> f64 {
        let side = &self.comparison.sides[index];
        let (view, in_box) = (metrics_text(&side.metrics), metrics_text(&side.metrics_in_box));
        let numbers = format!("view: {view}; box: {in_box}");
        let (left, right) = (self.scale.margin, canvas.width - self.scale.margin);
        let name = side.run.caption();
        let below = canvas.lines((left, y), right - left, &name, BLACK);
        // Next to the name, or below a name that leaves no space.
        if left + text_width(&name, TEXT) + 20.0 + text_width(&numbers, TEXT) > right {
            y = below;
        }
        canvas.text((right, y), &numbers, TEXT, Anchor::Right, BLACK);
        let below = below.max(y + LINE_HEIGHT);
        note(canvas, (left, below), right - left, &difference_text(&self.comparison.differences, index))
            - LINE_HEIGHT / 2.0
    }

    /// Draws the colour bars below their columns; returns the position after them.
    fn draw_bars(&self, canvas: &mut Canvas, y: f64) -> Result<f64> {
        let scale = &self.scale;
        let unit = format!("depth ({})", self.comparison.first().depth_unit());
        let errors = (0.0, self.comparison.error_top);
        let left = colour_bar(canvas, (scale.left(2), y), scale.width, errors, false, "error (1: black for white)")?;
        // Near is bright.
        let right = colour_bar(canvas, (scale.left(3), y), scale.width, self.comparison.depths, true, &unit)?;
        Ok(left.max(right))
    }

    fn caption(&self) -> String {
        let Window { x, y, width, height } = self.comparison.window;
        let by = match self.comparison.chosen_by() {
            "hand" => "chosen by hand".to_string(),
            reason => format!("chosen by the {reason}"),
        };
        let mut text = format!(
            "Box: {width} x {height} pixels from ({x}, {y}), {by}. Error: root of the mean squared difference of a \
             pixel's three 8-bit colours to the ground truth. Scales are the same for all runs; the last colours stand for \
             everything beyond, such as the outermost 2 % of the runs' values. Grey depth: little that stops light in a rendering; in the ground truth, nothing hit or depth not known."
        );
        if !self.comparison.differences.is_empty() {
            text += " Below names: the first settings that these runs differ in; compare.json has all.";
        }
        if self.scale.shrink > 1 {
            text += &format!(" Views are shown at 1/{} of their size.", self.scale.shrink);
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
