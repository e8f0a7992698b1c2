//! A held-out view as several runs render it, with metrics.

use std::path::Path;

use serde::Serialize;

use super::comparison_figure;
use super::differences::{Difference, File, differences};
use super::run_view::RunView;
use super::window::{Window, crop, crop_mask, most_different};
use crate::base::files::{write_atomic, write_json};
use crate::base::{Error, Image, Result};
use crate::data::View;
use crate::draw::{depth_range, depth_range_of, pixel_errors};
use crate::metrics::{MSE, PSNR, SSIM, ViewMetrics, measure_unmasked, unmasked_or};
use crate::run::RenderedView;

/// Default side of the box, as a divisor of the view's side.
const BOX_SHARE: usize = 5;
/// Runs that render one view, with metrics.
pub struct Comparison {
    pub(super) sides: Vec<Side>,
    pub(super) differences: Vec<Difference>,
    pub(super) window: Window,
    /// The user gave the box.
    pub(super) named_box: bool,
    /// Upper end of the errors' scale, which starts at 0.
    pub(super) error_top: f32,
    /// Ends of the depths' scale.
    pub(super) depths: (f32, f32),
}

pub(super) struct Side {
    pub(super) run: RunView,
    pub(super) rendered: RenderedView,
    /// Per pixel, the root mean square difference over channels of 8-bit values.
    pub(super) errors: Vec<f32>,
    pub(super) metrics: ViewMetrics,
    pub(super) metrics_in_box: ViewMetrics,
}

impl Comparison {
    /// Compares runs that have passed [`RunView::check_alike`], each with its rendering. The box is `window`, or the
    /// place where the runs' squared errors differ most. That box has `box_width` columns (by default a fifth of the
    /// view's) and the view's aspect.
    pub fn new(
        mut runs: Vec<(RunView, RenderedView)>,
        window: Option<Window>,
        box_width: Option<usize>,
    ) -> Result<Comparison> {
        let Some((first, _)) = runs.first() else {
            return Err(Error::Config("no run to compare; name at least one".into()));
        };
        let (truth, mask, bounds) = (first.view.image.clone(), first.view.mask.clone(), first.bounds);
        check_box(window, box_width, &truth)?;
        // Runs without NDC appear next to runs with NDC in scene units.
        if runs.iter().any(|(run, _)| run.ndc.is_none()) {
            runs.iter_mut().for_each(|(run, rendered)| run.leave_ndc(&mut rendered.depth));
        }
        // Masked pixels have no error.
        let counted: Vec<Image> =
            runs.iter().map(|(_, rendered)| unmasked_or(rendered.image.clone(), &truth, mask.as_deref())).collect();
        let images: Vec<&Image> = counted.iter().collect();
        let chosen = match window {
            Some(window) => window,
            None => most_different(&images, &truth, box_size(box_width, truth.width, truth.height)),
        };
        let over = |values: fn(&RenderedView) -> &Vec<f32>| -> Vec<f32> {
            runs.iter().flat_map(|(_, rendered)| values(rendered).iter().copied()).collect()
        };
        // All runs share one scale with the ground truth.
        let (depth, acc) = (over(|r| &r.depth), over(|r| &r.acc));
        let truth_depth = runs[0].0.view.depth.clone().filter(|_| runs[0].0.ndc.is_none()).unwrap_or_default();
        let depths = depth_range_of(&[(&depth, Some(&acc)), (&truth_depth, None)]);
        let named: Vec<&RunView> = runs.iter().map(|(run, _)| run).collect();
        let differences = differences(&named);
        let truth_in_box = crop(&truth, chosen);
        let mask_in_box = mask.as_ref().map(|mask| crop_mask(mask, truth.width, chosen));
        let sides = runs.into_iter().zip(&counted).map(|((run, rendered), counted)| {
            let (name, in_box) = (&run.view.name, crop(&rendered.image, chosen));
            let metrics = measure_unmasked(name, &rendered.image, &truth, mask.as_deref(), &[])?;
            let metrics_in_box = measure_unmasked(name, &in_box, &truth_in_box, mask_in_box.as_deref(), &[])?;
            let errors = pixel_errors(counted, &truth);
            Ok(Side { run, rendered, errors, metrics, metrics_in_box })
        });
        let sides = sides.collect::<Result<Vec<Side>>>()?;
        let errors: Vec<f32> = sides.iter().flat_map(|side| side.errors.iter().copied()).collect();
        // If all pixels equal the ground truth, the scale still needs a length.
        let error_top = depth_range(&errors, None).map_or(1.0, |(_, top)| top).max(1.0 / 255.0);
        Ok(Comparison {
            sides,
            differences,
            window: chosen,
            named_box: window.is_some(),
            error_top,
            depths: depths.unwrap_or((bounds.0 as f32, bounds.1 as f32)),
        })
    }

    /// Returns the view's own depth in the units of the runs' depth, if it has one.
    pub(super) fn truth_depth(&self) -> Option<&Vec<f32>> {
        let first = self.first();
        first.view.depth.as_ref().filter(|_| first.ndc.is_none())
    }

    /// Returns, for each pixel, the largest error of all runs minus the smallest.
    pub(super) fn spread(&self) -> Vec<f32> {
        let over = |pixel: usize, pick: fn(f32, f32) -> f32| {
            self.sides.iter().map(|side| side.errors[pixel]).reduce(pick).unwrap_or(0.0)
        };
        (0..self.sides[0].errors.len()).map(|pixel| over(pixel, f32::max) - over(pixel, f32::min)).collect()
    }

    /// Returns the box that the images zoom into.
    pub fn window(&self) -> Window {
        self.window
    }

    /// Returns the held-out view.
    pub fn view(&self) -> &View {
        &self.first().view
    }

    pub(super) fn first(&self) -> &RunView {
        &self.sides[0].run
    }

    pub(super) fn truth(&self) -> &Image {
        &self.first().view.image
    }

    pub(super) fn chosen_by(&self) -> &'static str {
        match (self.named_box, self.sides.len()) {
            (true, _) => "hand",
            (_, 1) => "largest squared error",
            _ => "largest difference of the runs' squared errors",
        }
    }
}

/// What `compare.json` says of all runs, and of each.
#[derive(Serialize)]
struct ViewFacts {
    #[serde(rename = "box")]
    window: Window,
    box_chosen_by: &'static str,
    /// Ends of the errors' colour scale, in colour values of 0..=1.
    error_colours: (f32, f32),
    /// Nearest and farthest depth of the colour scale.
    depth_colours: (f32, f32),
    depth_unit: &'static str,
}

#[derive(Serialize)]
struct RunFacts<'a> {
    view: &'a ViewMetrics,
    #[serde(rename = "box")]
    in_box: &'a ViewMetrics,
}

impl Comparison {
    /// Writes `compare.svg`, which holds the pixels of images, and `compare.json` into a folder.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let figure = comparison_figure::draw(self)?;
        write_atomic(&folder.join("compare.svg"), figure.svg.as_bytes())?;
        write_json(&folder.join("compare.json"), &self.file())
    }

    /// Returns the content of `compare.json`.
    pub fn json(&self) -> serde_json::Value {
        serde_json::to_value(self.file()).expect("plain data")
    }

    fn file(&self) -> File<'_, ViewFacts, RunFacts<'_>> {
        let facts = ViewFacts {
            window: self.window,
            box_chosen_by: self.chosen_by(),
            error_colours: (0.0, self.error_top),
            depth_colours: self.depths,
            depth_unit: self.first().depth_unit(),
        };
        let runs =
            self.sides.iter().map(|side| (&side.run, RunFacts { view: &side.metrics, in_box: &side.metrics_in_box }));
        File::new(facts, runs)
    }
}

/// Returns an error if a box, or a box of some columns, does not fit into the view.
pub fn check_box(window: Option<Window>, box_width: Option<usize>, view: &Image) -> Result<()> {
    if let Some(window) = window {
        window.check(view.width, view.height)?;
    }
    match box_width {
        Some(columns) if columns > view.width => Err(Error::Config(format!(
            "--box-width {columns} exceeds the {0} columns of the view; give at most {0}",
            view.width
        ))),
        _ => Ok(()),
    }
}

/// Returns columns and rows of a box of the view's aspect.
fn box_size(columns: Option<usize>, width: usize, height: usize) -> (usize, usize) {
    let columns = columns.unwrap_or((width + BOX_SHARE / 2) / BOX_SHARE).max(1);
    let rows = (columns as f64 * height as f64 / width as f64).round() as usize;
    (columns, rows.clamp(1, height))
}

/// Returns PSNR and SSIM as text, as far as they are known.
pub(super) fn metrics_text(metrics: &ViewMetrics) -> String {
    // A PSNR is infinite, and so has no number, where nothing differs.
    let psnr = match (metrics.get(&PSNR), metrics.get(&MSE)) {
        (Some(psnr), _) => format!("PSNR {psnr:.2} dB"),
        (None, Some(_)) => "equal to the ground truth".into(),
        (None, None) => "masked: not measured".into(),
    };
    metrics.get(&SSIM).map_or(psnr.clone(), |ssim| format!("{psnr}, SSIM {ssim:.3}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_was_measured_is_called_equal_to_the_truth() {
        let grey = |value: f32| Image { width: 2, height: 1, channels: 3, pixels: vec![value; 6] };
        let said = |rendered: f32, counts: bool| {
            let mask = [counts; 2];
            metrics_text(&measure_unmasked("view", &grey(rendered), &grey(0.5), Some(&mask), &[]).unwrap())
        };
        assert_eq!(said(0.6, true), "PSNR 20.17 dB");
        assert_eq!(said(0.5, true), "equal to the ground truth");
        assert_eq!(said(0.6, false), "masked: not measured");
    }
}
