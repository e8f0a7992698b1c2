//! Figures of a sweep.

use crate::metrics::Metric;
use crate::report::statistics::{mean, standard_deviation};

mod across;
mod axes;
mod curves;
mod differences;
mod heatmap;
mod pairs;
mod rows;
mod series;
mod shifts;
mod surfaces;

pub use crate::draw::Figure;
pub use across::across_figure;
pub use axes::axes_figure;
pub use curves::{Curve, Seeds, curves_figure, seconds_figure};
pub use heatmap::heatmap_figures;
pub use rows::rows_figure;
pub use shifts::{Shifts, shifts_figure};
pub use surfaces::{Surface, surfaces_figure};

/// Returns the name of a metric in figures.
fn metric_label(key: &str) -> &str {
    Metric::find(key).map_or(key, |metric| metric.label)
}

/// Mean over seeds with their spread: mean ± standard deviation for three or more seeds, the two values for two,
/// nothing for one.
struct Spread {
    mean: f64,
    band: Option<(f64, f64)>,
}

impl Spread {
    fn new(values: &[f64]) -> Option<Spread> {
        let mean = mean(values)?;
        let band = match values {
            [_] => None,
            [a, b] => Some((a.min(*b), a.max(*b))),
            _ => standard_deviation(values).map(|deviation| (mean - deviation, mean + deviation)),
        };
        Some(Spread { mean, band })
    }
}

const SPREAD_NOTE: &str = "Lines and large dots are means over seeds, faint dots the seeds; bands are mean ± standard deviation of three and \
     more seeds, and from end to end of two.";
