//! Figures of a sweep.

use crate::report::statistics::{mean, standard_deviation};

mod axes;
mod curves;
mod rows;

pub use crate::draw::Figure;
pub use axes::axes_figure;
pub use curves::{Curve, curves_figure};
pub use rows::rows_figure;

/// A metric as people write it.
fn metric_name(metric: &str) -> String {
    match metric {
        "psnr" | "psnr_float" | "psnr_of_mean" => format!("{} (dB)", metric.replace("psnr", "PSNR").replace('_', " ")),
        "ssim" => "SSIM".into(),
        "l1" => "l1 of density".into(),
        "tv" => "TV of density".into(),
        "laplacian" => "Laplacian of density".into(),
        "chamfer" => "Chamfer distance".into(),
        "f_score" => "F-score".into(),
        "depth_mae" => "mean depth error".into(),
        other => match other.split_once('_') {
            Some(("lpips", backbone)) => format!("LPIPS ({backbone})"),
            Some(("average", backbone)) => format!("average ({backbone})"),
            _ => other.replace('_', " "),
        },
    }
}

/// Larger is better.
fn rises(metric: &str) -> bool {
    metric.starts_with("psnr") || metric == "ssim" || metric == "f_score"
}

/// Mean over seeds with what they spread over: mean and standard deviation of three and more, the
/// ends of two, nothing of one.
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
