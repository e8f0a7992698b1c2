//! The figure of several runs along the same rays.

use super::differences::{difference_text, differences};
use super::parts::{colour_bar, note, trained_on};
use super::profile::{EVEN, Profile, Profiles, Samples};
use super::run_view::RunView;
use super::window::Window;
use crate::base::{Error, Image, Result};
use crate::data::resample;
use crate::draw::canvas::{
    Anchor, BLACK, Canvas, Colour, Figure, GRID, ORANGE, PALETTE, PAPER, Panel, SIDE, TEXT, Width, ticks,
};
use crate::draw::numbers::numbers;
use crate::draw::scale_colour;

const LEFT: f64 = 82.0;
const RIGHT: f64 = 72.0;
const WIDTH: f64 = Width::Page.units() - LEFT - RIGHT;
/// Two pixels of the PNG for each even sample.
const FINENESS: f64 = 2.0 * EVEN as f64 / WIDTH;
/// Height of the view in the corner.
const INSET: f64 = 72.0;
/// Height of a patch's map.
const MAP: f64 = 64.0;
/// Fraction of the positive densities above the map's brightest colour.
const OUTLIERS: f64 = 0.02;

/// Draws curves of the pixel's ray, and maps of the patch's row below, all over the same t.
pub fn draw(profiles: &Profiles) -> Result<Figure> {
    let first = &profiles.runs[0].0;
    let mut canvas = Canvas::new(Width::Page.units(), 0.0);
    canvas.fineness = FINENESS;
    let (x, y) = profiles.pixel;
    let title = format!("Density and colour along the ray of pixel ({x}, {y})");
    let width = draw_inset(&mut canvas, profiles)? - 2.0 * SIDE;
    let y = canvas.lines((SIDE, 20.0), width, &title, BLACK) + 2.0;
    let y = note(&mut canvas, (SIDE, y), width, &first.title());
    let mut y = legend(&mut canvas, profiles, y.max(16.0 + INSET + 16.0)) + 4.0;
    let axis = Axis { bounds: first.bounds };
    y = curves(&mut canvas, profiles, &axis, y);
    y = axis.label(&mut canvas, y, first.depth_unit()) + 16.0;
    canvas.height = maps(&mut canvas, profiles, &axis, first.depth_unit(), y)? + 8.0;
    canvas.caption(&caption(profiles));
    canvas.finish()
}

/// Draws the view with the patch in the upper right corner; returns its left end.
fn draw_inset(canvas: &mut Canvas, profiles: &Profiles) -> Result<f64> {
    let image = &profiles.runs[0].0.view.image;
    // A small photo is drawn as it is, a larger one at the PNG's resolution.
    let share = (INSET * FINENESS / image.height as f64).min(1.0);
    let [columns, rows] = [image.width, image.height].map(|side| ((side as f64 * share).round() as usize).max(1));
    let unit = INSET / image.height as f64;
    let (left, top) = (canvas.width - SIDE - image.width as f64 * unit, 14.0);
    canvas.picture((left, top), (image.width as f64 * unit, INSET), &resample::shrink(image, columns, rows))?;
    // Large enough to be visible.
    let side = (profiles.patch.width as f64 * unit).max(6.0);
    let middle = |start: usize| (start as f64 + 0.5 * profiles.patch.width as f64) * unit - 0.5 * side;
    let at = (left + middle(profiles.patch.x), top + middle(profiles.patch.y));
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

/// Draws each run's colour, name, smoothness and differences.
fn legend(canvas: &mut Canvas, profiles: &Profiles, mut y: f64) -> f64 {
    const TEXT_LEFT: f64 = SIDE + 34.0;
    let width = canvas.width - TEXT_LEFT - SIDE;
    let named: Vec<&RunView> = profiles.runs.iter().map(|(run, _)| run).collect();
    let differences = differences(&named);
    for (index, (run, profile)) in profiles.runs.iter().enumerate() {
        canvas.line(&[(SIDE, y), (SIDE + 26.0, y)], colour(profiles, index), 3.0);
        y = canvas.lines((TEXT_LEFT, y), width, &run.caption(), BLACK);
        y = note(canvas, (TEXT_LEFT, y), width, &difference_text(&differences, index));
        y = note(canvas, (TEXT_LEFT, y), width, &smoothness(profile)) + 6.0;
    }
    y
}

fn smoothness(profile: &Profile) -> String {
    let smooth = &profile.smoothness;
    let across = smooth.density_tv_across.map_or(String::new(), |tv| format!(", {tv:.3} from ray to ray"));
    format!(
        "patch: mean density {:.3}; total variation of density {:.2} along a ray{across}",
        smooth.density_mean, smooth.density_tv_along
    )
}

/// Returns an error if there are more runs than distinguishable colours.
pub fn check_overlay(runs: usize) -> Result<()> {
    if runs <= PALETTE.len() {
        return Ok(());
    }
    let most = PALETTE.len();
    Err(Error::Config(format!("a profile overlays at most {most} runs, but there are {runs}; name fewer")))
}

/// Returns a run's colour: its row's in the sweep's figures, unless two rows have one.
fn colour(profiles: &Profiles, run: usize) -> Colour {
    let of = |index: usize| profiles.runs[index].0.row.unwrap_or(index) % PALETTE.len();
    let is_clear = (0..profiles.runs.len()).all(|i| (0..i).all(|j| of(i) != of(j)));
    PALETTE[if is_clear { of(run) } else { run }]
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

/// Draws density, weight, red, green and blue over t; returns the foot of the last panel.
fn curves(canvas: &mut Canvas, profiles: &Profiles, axis: &Axis, mut y: f64) -> f64 {
    const GAP: f64 = 14.0;
    let rgb = |name, value| Curves { name, height: 56.0, top: Some(1.0), evaluated: false, value };
    let panels = [
        Curves { name: "density", height: 130.0, top: None, evaluated: false, value: |s, k| s.density[k] },
        Curves { name: "weight", height: 90.0, top: None, evaluated: true, value: |s, k| s.weights[k] },
        rgb("red", |s, k| s.rgb[k][0]),
        rgb("green", |s, k| s.rgb[k][1]),
        rgb("blue", |s, k| s.rgb[k][2]),
    ];
    for panel in panels {
        panel.draw(canvas, profiles, axis, y);
        y += panel.height + GAP;
    }
    y - GAP
}

impl Curves {
    fn points(&self, profiles: &Profiles, profile: &Profile) -> Vec<(f64, f64)> {
        let samples = match (self.evaluated, &profile.fine) {
            (false, _) => profiles.own(profile),
            (true, Some(fine)) => fine,
            (true, None) => &profile.coarse,
        };
        let point = |k: usize| (f64::from(samples.t[k]), f64::from((self.value)(samples, k)));
        (0..samples.t.len()).map(point).collect()
    }

    fn draw(&self, canvas: &mut Canvas, profiles: &Profiles, axis: &Axis, y: f64) {
        let runs: Vec<Vec<(f64, f64)>> =
            profiles.runs.iter().map(|(_, profile)| self.points(profiles, profile)).collect();
        let greatest = runs.iter().flatten().map(|(_, value)| *value).fold(0.0, f64::max);
        // A ray through empty space has no density at all.
        let top = self.top.unwrap_or(if greatest > 0.0 { 1.05 * greatest } else { 1.0 });
        let panel = Panel { left: LEFT, top: y, width: WIDTH, height: self.height, range: (0.0, top) };
        axis.grid(canvas, panel.top, panel.bottom());
        panel.frame(canvas, true);
        canvas.text((panel.right() + 8.0, y + self.height / 2.0), self.name, TEXT, Anchor::Left, BLACK);
        for (index, points) in runs.iter().enumerate() {
            let line: Vec<(f64, f64)> = points.iter().map(|(t, value)| (axis.x(*t), panel.y(*value))).collect();
            canvas.line(&line, colour(profiles, index), 1.3);
            if self.evaluated {
                line.iter().for_each(|at| canvas.dot(*at, 1.7, colour(profiles, index), 0.8));
            }
        }
    }
}

/// Draws, for each run, density and colour of the patch's row through the pixel, and the density's colour bar; returns
/// the foot of all.
fn maps(canvas: &mut Canvas, profiles: &Profiles, axis: &Axis, unit: &str, mut y: f64) -> Result<f64> {
    let top = density_top(profiles);
    for (index, (run, profile)) in profiles.runs.iter().enumerate() {
        canvas.line(&[(LEFT, y), (LEFT + 26.0, y)], colour(profiles, index), 3.0);
        y = canvas.lines((LEFT + 34.0, y), WIDTH - 34.0, &run.caption(), BLACK) - 4.0;
        let density = map(profiles, profile, |ray, k| scale_colour(ray.density[k] / top));
        let rgb = map(profiles, profile, |ray, k| ray.rgb[k]);
        for (name, picture) in [("density", density), ("colour", rgb)] {
            canvas.picture((LEFT, y), (WIDTH, MAP), &picture)?;
            canvas.text((LEFT + WIDTH + 8.0, y + MAP / 2.0), name, TEXT, Anchor::Left, BLACK);
            draw_column_names(canvas, profiles, y);
            y += MAP + 8.0;
        }
        y += 6.0;
    }
    y = axis.label(canvas, y - 14.0, unit) + 14.0;
    colour_bar(canvas, (LEFT, y), WIDTH, (0.0, top), false, "density on the maps")
}

/// Draws the first and last column of the patch next to a map, and a mark at the pixel's own.
fn draw_column_names(canvas: &mut Canvas, profiles: &Profiles, y: f64) {
    let Window { x, width, .. } = profiles.patch;
    let middle = |column: usize| y + MAP * ((column - x) as f64 + 0.5) / width as f64;
    let own = middle(profiles.pixel.0);
    canvas.line(&[(LEFT - 6.0, own), (LEFT, own)], BLACK, 2.0);
    let ends = if width > 1 { vec![x, x + width - 1] } else { vec![x] };
    for column in ends {
        canvas.text((LEFT - 10.0, middle(column)), &format!("x = {column}"), TEXT, Anchor::Right, BLACK);
    }
}

/// Returns the rays of the patch's row through the pixel, one below the other.
fn row<'a>(profiles: &Profiles, profile: &'a Profile) -> &'a [Samples] {
    let Window { y, width, .. } = profiles.patch;
    &profile.even[(profiles.pixel.1 - y) * width..][..width]
}

fn map(profiles: &Profiles, profile: &Profile, colour: impl Fn(&Samples, usize) -> [f32; 3]) -> Image {
    let rays = row(profiles, profile);
    let pixels = rays.iter().flat_map(|ray| (0..EVEN).flat_map(|k| colour(ray, k)).collect::<Vec<f32>>()).collect();
    Image { width: EVEN, height: rays.len(), channels: 3, pixels }
}

/// Returns the density of the brightest colour: of the positive densities on all maps, 98 % are below it.
fn density_top(profiles: &Profiles) -> f32 {
    let rays = profiles.runs.iter().flat_map(|(_, profile)| row(profiles, profile));
    let mut positive: Vec<f32> = rays.flat_map(|ray| &ray.density).copied().filter(|&density| density > 0.0).collect();
    positive.sort_by(f32::total_cmp);
    positive.get((positive.len() as f64 * (1.0 - OUTLIERS)) as usize).copied().unwrap_or(1.0)
}

fn caption(profiles: &Profiles) -> String {
    let Window { x, y, width, .. } = profiles.patch;
    let runs = || profiles.runs.iter().map(|(run, _)| run);
    let mut text = format!(
        "Density and colour are the evaluated field's at {EVEN} even places along the ray, weights those of an \
         evaluation at its own samples (dots). Maps: the rays of pixels {x} to {} in row {}; the mark is the ray \
         above. The highest 2 % of the positive densities have the last colour. Patch: {width} x {width} pixels from \
         ({x}, {y}). The smaller the variation, the smoother; it counts in units of density.",
        x + width - 1,
        profiles.pixel.1
    );
    if runs().any(|run| run.queries_gaussians) {
        text += " MipNeRF's field is queried at Gaussians of these places' own short intervals, which no evaluation queries.";
    }
    text + &trained_on(runs())
}
