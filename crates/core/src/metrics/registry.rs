//! Every metric once: what it is called, how it is printed, which way is better, where it is measured and what it needs.
//! Tables, figures, sweeps and files read it here.

use super::Backbone;

/// Which way a metric is better.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// The larger, the better.
    Up,
    /// The smaller, the better.
    Down,
    /// Neither: it describes.
    Neither,
}

/// How a table for readers prints a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Digits {
    /// So many decimals.
    Decimals(usize),
    /// Four figures, with an exponent below 0.001 and from 100,000.
    Figures,
}

/// Where a metric is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scope {
    /// On every view; a run has the mean over its views.
    View,
    /// On every view, in files of views alone.
    ViewAlone,
    /// On a run: made of the means over its views.
    Mean,
    /// On a run: the mean of another metric over training views ([`Metric::of`]).
    Seen,
    /// On a run: that mean minus the mean over held-out views.
    Gap,
    /// On the evaluated field's density over a lattice.
    Lattice,
    /// On the surface of the evaluated field (`eval.mesh`).
    Surface,
    /// On the rows of a sweep side by side: over the pixels that all of them show.
    Common,
}

/// What a metric needs besides a rendered view and its photograph.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Needs {
    /// Nothing.
    Nothing,
    /// Weights of an LPIPS backbone.
    Lpips(Backbone),
    /// Reference depth.
    Depth,
    /// Reference depth that is exact.
    ExactDepth,
    /// Density's derivatives at points, which a field that is queried at Gaussians has not.
    DerivativesAtPoints,
    /// A reference mesh.
    Mesh,
}

/// One metric.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Metric {
    /// The name in files and sweep definitions.
    pub key: &'static str,
    /// The name in figures, with its unit where it has one of its own.
    pub label: &'static str,
    /// The unit; empty for a ratio.
    pub unit: &'static str,
    /// Which way is better.
    pub direction: Direction,
    /// How it is printed.
    pub digits: Digits,
    /// Where it is measured.
    pub scope: Scope,
    /// What it needs.
    pub needs: Needs,
    /// The metric of views that one of [`Scope::Seen`] or [`Scope::Gap`] is made of; empty for others.
    pub of: &'static str,
}

impl Metric {
    /// A metric by its key.
    pub fn find(key: &str) -> Option<&'static Metric> {
        METRICS.iter().find(|metric| metric.key == key)
    }

    /// Those that a table may be asked for: all but the parts that others are made of.
    pub fn in_tables() -> impl Iterator<Item = &'static Metric> {
        METRICS.iter().filter(|metric| metric.scope != Scope::ViewAlone)
    }

    /// The value as a sentence has it: `0.50 dB`.
    pub fn with_unit(&self, value: f64) -> String {
        let space = if self.unit.is_empty() { "" } else { " " };
        format!("{}{space}{}", self.text(value), self.unit)
    }

    /// The value as a table for readers prints it.
    pub fn text(&self, value: f64) -> String {
        match self.digits {
            Digits::Decimals(digits) => format!("{value:.digits$}"),
            Digits::Figures if value != 0.0 && !(1e-3..1e5).contains(&value.abs()) => format!("{value:.3e}"),
            Digits::Figures => {
                let digits = (3.0 - value.abs().max(1e-3).log10().floor()).max(0.0) as usize;
                format!("{value:.digits$}")
            }
        }
    }
}

const DECIBEL: Metric = Metric {
    key: "",
    label: "",
    unit: "dB",
    direction: Direction::Up,
    digits: Digits::Decimals(2),
    scope: Scope::View,
    needs: Needs::Nothing,
    of: "",
};
const LPIPS: Metric = Metric { unit: "", direction: Direction::Down, digits: Digits::Decimals(3), ..DECIBEL };
const LATTICE: Metric = Metric {
    direction: Direction::Down,
    digits: Digits::Figures,
    scope: Scope::Lattice,
    needs: Needs::DerivativesAtPoints,
    ..DECIBEL
};
const DEPTH: Metric =
    Metric { unit: "scene units", direction: Direction::Down, digits: Digits::Figures, needs: Needs::Depth, ..DECIBEL };
/// Of training views: better is the fit, not the picture of what was not seen. So it describes, and so does the gap.
const SEEN: Metric = Metric { direction: Direction::Neither, scope: Scope::Seen, ..DECIBEL };
const SEEN_LPIPS: Metric = Metric { direction: Direction::Neither, scope: Scope::Seen, ..LPIPS };
/// The reference's own, beside which a number of ours is read.
const TRUTH: Metric = Metric { direction: Direction::Neither, needs: Needs::ExactDepth, ..DEPTH };

const fn seen_lpips(backbone: Backbone, scope: Scope, key: &'static str, label: &'static str) -> Metric {
    let of = match backbone {
        Backbone::Alex => "lpips_alex",
        Backbone::Vgg => "lpips_vgg",
        Backbone::Squeeze => "lpips_squeeze",
    };
    Metric { key, label, scope, of, needs: Needs::Lpips(backbone), ..SEEN_LPIPS }
}

/// All metrics, in the order of files.
pub static METRICS: [Metric; 38] = [
    Metric { key: "psnr", label: "PSNR (dB)", ..DECIBEL },
    Metric { key: "psnr_float", label: "PSNR float (dB)", ..DECIBEL },
    Metric {
        key: "mse",
        label: "mean squared error",
        unit: "",
        direction: Direction::Down,
        digits: Digits::Figures,
        scope: Scope::ViewAlone,
        ..DECIBEL
    },
    Metric { key: "psnr_of_mean", label: "PSNR of mean (dB)", scope: Scope::Mean, ..DECIBEL },
    Metric { key: "ssim", label: "SSIM", direction: Direction::Up, ..LPIPS },
    Metric { key: "lpips_alex", label: "LPIPS (alex)", needs: Needs::Lpips(Backbone::Alex), ..LPIPS },
    Metric { key: "lpips_vgg", label: "LPIPS (vgg)", needs: Needs::Lpips(Backbone::Vgg), ..LPIPS },
    Metric { key: "lpips_squeeze", label: "LPIPS (squeeze)", needs: Needs::Lpips(Backbone::Squeeze), ..LPIPS },
    Metric {
        key: "average_alex",
        label: "average (alex)",
        scope: Scope::Mean,
        needs: Needs::Lpips(Backbone::Alex),
        ..LPIPS
    },
    Metric {
        key: "average_vgg",
        label: "average (vgg)",
        scope: Scope::Mean,
        needs: Needs::Lpips(Backbone::Vgg),
        ..LPIPS
    },
    Metric {
        key: "average_squeeze",
        label: "average (squeeze)",
        scope: Scope::Mean,
        needs: Needs::Lpips(Backbone::Squeeze),
        ..LPIPS
    },
    Metric { key: "train_psnr", label: "PSNR of training views (dB)", of: "psnr", ..SEEN },
    Metric { key: "gap", label: "PSNR, training minus held-out (dB)", of: "psnr", scope: Scope::Gap, ..SEEN },
    Metric { key: "train_ssim", label: "SSIM of training views", of: "ssim", ..SEEN_LPIPS },
    Metric { key: "gap_ssim", label: "SSIM, training minus held-out", of: "ssim", scope: Scope::Gap, ..SEEN_LPIPS },
    seen_lpips(Backbone::Alex, Scope::Seen, "train_lpips_alex", "LPIPS (alex) of training views"),
    seen_lpips(Backbone::Alex, Scope::Gap, "gap_lpips_alex", "LPIPS (alex), training minus held-out"),
    seen_lpips(Backbone::Vgg, Scope::Seen, "train_lpips_vgg", "LPIPS (vgg) of training views"),
    seen_lpips(Backbone::Vgg, Scope::Gap, "gap_lpips_vgg", "LPIPS (vgg), training minus held-out"),
    seen_lpips(Backbone::Squeeze, Scope::Seen, "train_lpips_squeeze", "LPIPS (squeeze) of training views"),
    seen_lpips(Backbone::Squeeze, Scope::Gap, "gap_lpips_squeeze", "LPIPS (squeeze), training minus held-out"),
    Metric { key: "l1", label: "l1 of density", unit: "scene units^2", ..LATTICE },
    Metric { key: "tv", label: "TV of density", unit: "scene units", ..LATTICE },
    Metric { key: "laplacian", label: "Laplacian of density", unit: "", ..LATTICE },
    Metric {
        key: "largest_density",
        label: "largest density",
        unit: "1 / scene unit",
        direction: Direction::Neither,
        ..LATTICE
    },
    Metric { key: "occupied", label: "occupied", unit: "", direction: Direction::Neither, ..LATTICE },
    Metric { key: "depth_mae", label: "mean depth error", ..DEPTH },
    Metric { key: "depth_rmse", label: "depth rmse", ..DEPTH },
    Metric { key: "depth_left_out", label: "depth left out", unit: "", ..DEPTH },
    Metric { key: "depth_mae_common", label: "mean depth error, common pixels", scope: Scope::Common, ..DEPTH },
    Metric { key: "depth_rmse_common", label: "depth rmse, common pixels", scope: Scope::Common, ..DEPTH },
    Metric {
        key: "depth_left_out_common",
        label: "depth left out by any row",
        unit: "",
        scope: Scope::Common,
        ..TRUTH
    },
    Metric { key: "depth_roughness", label: "depth roughness", ..DEPTH },
    Metric { key: "depth_roughness_truth", label: "depth roughness truth", ..TRUTH },
    Metric { key: "normal_roughness", label: "normal roughness", unit: "degrees", ..DEPTH },
    Metric { key: "normal_roughness_truth", label: "normal roughness truth", unit: "degrees", ..TRUTH },
    Metric { key: "chamfer", label: "Chamfer distance", scope: Scope::Surface, needs: Needs::Mesh, ..DEPTH },
    Metric {
        key: "f_score",
        label: "F-score",
        unit: "",
        direction: Direction::Up,
        scope: Scope::Surface,
        needs: Needs::Mesh,
        ..DEPTH
    },
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_the_digits_of_their_metric() {
        let texts = [("psnr_float", 25.318), ("lpips_vgg", 0.21049), ("tv", 123456.0), ("chamfer", 0.061)]
            .map(|(key, value)| Metric::find(key).unwrap().text(value));
        assert_eq!(texts, ["25.32", "0.210", "1.235e5", "0.06100"]);
    }

    #[test]
    fn what_describes_has_no_better_way() {
        let roughness = ["normal_roughness_truth", "depth_roughness_truth", "depth_left_out_common"];
        for key in [&["occupied", "largest_density", "train_psnr", "gap", "gap_lpips_vgg"], &roughness[..]].concat() {
            assert_eq!(Metric::find(key).unwrap().direction, Direction::Neither, "{key}");
        }
        let up: Vec<&str> = METRICS.iter().filter(|m| m.direction == Direction::Up).map(|m| m.key).collect();
        assert_eq!(up, ["psnr", "psnr_float", "psnr_of_mean", "ssim", "f_score"]);
    }

    #[test]
    fn what_is_measured_on_training_views_is_measured_on_every_view() {
        for metric in &METRICS {
            let of_training = matches!(metric.scope, Scope::Seen | Scope::Gap);
            assert_eq!(of_training, !metric.of.is_empty(), "{}", metric.key);
            let of = Metric::find(metric.of).filter(|of| of.scope == Scope::View && of.needs == metric.needs);
            assert!(of.is_some() == of_training, "{}", metric.key);
        }
    }

    #[test]
    fn keys_are_distinct() {
        for (index, metric) in METRICS.iter().enumerate() {
            assert!(METRICS[..index].iter().all(|other| other.key != metric.key), "{}", metric.key);
            assert!(!metric.key.is_empty() && !metric.label.is_empty());
        }
    }
}
