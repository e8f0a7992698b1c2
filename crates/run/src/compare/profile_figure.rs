//! The figure of several runs along the same ray.

use super::differences::{difference_text, differences};
use super::parts::{note, trained_on};
use super::profile::{EVEN, Profile, Profiles, Samples};
use super::run_view::RunView;
use crate::base::{Error, Result};
use crate::data::resample;
use crate::draw::canvas::{
    Anchor, BLACK, Canvas, Figure, GRID, ORANGE, PAGE, PALETTE, PAPER, Panel, SIDE, TEXT, ticks,
};
use crate::draw::numbers::numbers;

const LEFT: f64 = 82.0;
const RIGHT: f64 = 96.0;
const WIDTH: f64 = PAGE - LEFT - RIGHT;
/// Height of the view in the corner.
const INSET: f64 = 72.0;

/// Draws curves of the pixel's ray, all over the same t.
pub fn draw(profiles: &Profiles) -> Result<Figure> {
    let first = &profiles.runs[0].0;
    let mut canvas = Canvas::new(PAGE, 0.0);
    let (x, y) = profiles.pixel;
    let title = format!("Density and colour along the ray of pixel ({x}, {y})");
    let width = draw_inset(&mut canvas, profiles)? - 2.0 * SIDE;
    let y = canvas.lines((SIDE, 20.0), width, &title, BLACK) + 2.0;
    let y = note(&mut canvas, (SIDE, y), width, &first.title());
    let y = legend(&mut canvas, profiles, y.max(16.0 + INSET + 16.0)) + 4.0;
    let axis = Axis { bounds: first.bounds };
    let y = curves(&mut canvas, profiles, &axis, y);
    canvas.height = axis.label(&mut canvas, y, first.depth_unit()) + 8.0;
    canvas.caption(&caption(profiles));
    Ok(canvas.finish())
}

/// Draws the view with the pixel in the upper right corner; returns its left end.
fn draw_inset(canvas: &mut Canvas, profiles: &Profiles) -> Result<f64> {
    let image = &profiles.runs[0].0.view.image;
    // A small photo is drawn as it is, a larger one with some pixels to a unit.
    let share = (4.0 * INSET / image.height as f64).min(1.0);
    let [columns, rows] = [image.width, image.height].map(|side| ((side as f64 * share).round() as usize).max(1));
    let unit = INSET / image.height as f64;
    let (left, top) = (canvas.width - SIDE - image.width as f64 * unit, 14.0);
    canvas.picture((left, top), (image.width as f64 * unit, INSET), &resample::shrink(image, columns, rows))?;
    // Large enough to be visible.
    let side = unit.max(6.0);
    let middle = |pixel: usize| (pixel as f64 + 0.5) * unit - 0.5 * side;
    let at = (left + middle(profiles.pixel.0), top + middle(profiles.pixel.1));
    canvas.outline(at, (side, side), PAPER, 3.0);
    canvas.outline(at, (side, side), ORANGE, 1.5);
    Ok(left)
}

/// The horizontal scale.
struct Axis {
    bounds: (f64, f64),
}

impl Axis {
    fn x(&self, t: f64) -> f64 {
        LEFT + WIDTH * (t - self.bounds.0) / (self.bounds.1 - self.bounds.0)
    }

    fn grid(&self, canvas: &mut Canvas, top: f64, bottom: f64) {
        for t in ticks(self.bounds, 6).0 {
            canvas.line(&[(self.x(t), top), (self.x(t), bottom)], GRID, 1.0);
        }
    }

    /// Draws numbers and name below a panel; returns the position after them.
    fn label(&self, canvas: &mut Canvas, y: f64, unit: &str) -> f64 {
        let (values, step) = ticks(self.bounds, 6);
        for (t, text) in values.iter().zip(numbers(&values, step)) {
            canvas.line(&[(self.x(*t), y), (self.x(*t), y + 4.0)], BLACK, 1.0);
            canvas.text((self.x(*t), y + 12.0), &text, TEXT, Anchor::Middle, BLACK);
        }
        canvas.text((LEFT + WIDTH / 2.0, y + 30.0), &format!("t ({unit})"), TEXT, Anchor::Middle, BLACK);
        y + 40.0
    }
}

/// Draws each run's colour, name, differences and variation of density.
fn legend(canvas: &mut Canvas, profiles: &Profiles, mut y: f64) -> f64 {
    const TEXT_LEFT: f64 = SIDE + 34.0;
    let width = canvas.width - TEXT_LEFT - SIDE;
    let named: Vec<&RunView> = profiles.runs.iter().map(|(run, _)| run).collect();
    let differences = differences(&named);
    for (index, (run, profile)) in profiles.runs.iter().enumerate() {
        canvas.line(&[(SIDE, y), (SIDE + 26.0, y)], PALETTE[index], 3.0);
        y = canvas.lines((TEXT_LEFT, y), width, &run.caption(), BLACK);
        y = note(canvas, (TEXT_LEFT, y), width, &difference_text(&differences, index));
        let variation = format!("total variation of density along the ray: {:.2}", profile.density_variation());
        y = note(canvas, (TEXT_LEFT, y), width, &variation) + 6.0;
    }
    y
}

/// Returns an error if there are more runs than distinguishable colours.
pub fn check_overlay(runs: usize) -> Result<()> {
    if runs <= PALETTE.len() {
        return Ok(());
    }
    let most = PALETTE.len();
    Err(Error::Config(format!("--ray overlays at most {most} runs, but there are {runs}; name fewer")))
}

/// One panel of curves.
struct Curves {
    name: &'static str,
    height: f64,
    /// Upper end of the scale, or `None` for the greatest value.
    top: Option<f64>,
    /// Draws the samples of an evaluation, marked, in place of the even ones.
    evaluated: bool,
    value: fn(&Samples, usize) -> f32,
}

/// Draws density, transmittance, weight, red, green and blue over t; returns the foot of the last panel.
fn curves(canvas: &mut Canvas, profiles: &Profiles, axis: &Axis, mut y: f64) -> f64 {
    const GAP: f64 = 14.0;
    let share = |name, value| Curves { name, height: 56.0, top: Some(1.0), evaluated: false, value };
    let panels = [
        Curves { name: "density", height: 130.0, top: None, evaluated: false, value: |s, k| s.density[k] },
        share("transmittance", |s, k| s.transmittance[k]),
        Curves { name: "weight", height: 90.0, top: None, evaluated: true, value: |s, k| s.weights[k] },
        share("red", |s, k| s.rgb[k][0]),
        share("green", |s, k| s.rgb[k][1]),
        share("blue", |s, k| s.rgb[k][2]),
    ];
    for panel in panels {
        panel.draw(canvas, profiles, axis, y);
        y += panel.height + GAP;
    }
    y - GAP
}

impl Curves {
    fn points(&self, profile: &Profile) -> Vec<(f64, f64)> {
        let samples = if self.evaluated { profile.evaluated() } else { &profile.even };
        let point = |k: usize| (f64::from(samples.t[k]), f64::from((self.value)(samples, k)));
        (0..samples.t.len()).map(point).collect()
    }

    fn draw(&self, canvas: &mut Canvas, profiles: &Profiles, axis: &Axis, y: f64) {
        let runs: Vec<Vec<(f64, f64)>> = profiles.runs.iter().map(|(_, profile)| self.points(profile)).collect();
        let greatest = runs.iter().flatten().map(|(_, value)| *value).fold(0.0, f64::max);
        // A ray through empty space has no density at all.
        let top = self.top.unwrap_or(if greatest > 0.0 { 1.05 * greatest } else { 1.0 });
        let panel = Panel { left: LEFT, top: y, width: WIDTH, height: self.height, range: (0.0, top) };
        axis.grid(canvas, panel.top, panel.bottom());
        panel.frame(canvas, true);
        canvas.text((panel.right() + 8.0, y + self.height / 2.0), self.name, TEXT, Anchor::Left, BLACK);
        for (index, points) in runs.iter().enumerate() {
            let line: Vec<(f64, f64)> = points.iter().map(|(t, value)| (axis.x(*t), panel.y(*value))).collect();
            canvas.line(&line, PALETTE[index], 1.3);
            if self.evaluated {
                line.iter().for_each(|at| canvas.dot(*at, 1.7, PALETTE[index], 0.8));
            }
        }
    }
}

fn caption(profiles: &Profiles) -> String {
    let runs = || profiles.runs.iter().map(|(run, _)| run);
    let mut text = format!(
        "Weights are those of an evaluation at its own samples (dots); all else is the evaluated field's at {EVEN} even \
         places along the ray. The smaller the variation of density, the smoother; it counts in units of density."
    );
    if runs().any(|run| run.queries_gaussians) {
        text += " MipNeRF's field is queried at Gaussians of these places' own short intervals, which no evaluation queries.";
    }
    text + &trained_on(runs())
}
