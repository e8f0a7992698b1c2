//! Every metric once: what it is called, how it is printed, which way is better, where it is measured and what it needs.
//! Tables, figures, sweeps and files read it here. Code names a metric by its constant, such as [`PSNR`]; [`Metric::find`] is
//! for keys that users and files give.

use std::sync::LazyLock;

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

impl Direction {
    /// Returns the factor that makes differences gains: 1 or -1, and `None` if the metric has no better direction.
    pub fn sign(self) -> Option<f64> {
        match self {
            Direction::Up => Some(1.0),
            Direction::Down => Some(-1.0),
            Direction::Neither => None,
        }
    }

    /// Returns the ends of an interval of differences as gains, the smallest first. `None` as for [`Direction::sign`].
    pub fn gains(self, (low, high): (f64, f64)) -> Option<(f64, f64)> {
        let sign = self.sign()?;
        Some(if sign < 0.0 { (-high, -low) } else { (low, high) })
    }
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
    /// On a run: the mean of another metric over training views ([`Metric::train`]).
    TrainViews,
    /// On a run: that mean minus the mean over held-out views ([`Metric::gap`]).
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
#[non_exhaustive]
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
}

impl Metric {
    /// A metric by its key.
    pub fn find(key: &str) -> Option<&'static Metric> {
        METRICS.iter().copied().find(|metric| metric.key == key)
    }

    /// Those that a table may be asked for: all but the parts that others are made of.
    pub fn in_tables() -> impl Iterator<Item = &'static Metric> {
        METRICS.iter().copied().filter(|metric| metric.scope != Scope::ViewAlone)
    }

    /// Its mean over training views.
    ///
    /// # Panics
    /// If it is none of [`split_metrics`].
    pub fn train(&self) -> &'static Metric {
        &self.of_training()[0]
    }

    /// Its mean over training views minus that over held-out views.
    ///
    /// # Panics
    /// If it is none of [`split_metrics`].
    pub fn gap(&self) -> &'static Metric {
        &self.of_training()[1]
    }

    fn of_training(&self) -> &'static [Metric; 2] {
        let at = split_metrics().position(|metric| metric.key == self.key);
        &OF_TRAINING[at.expect("a metric that runs have of training views")]
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

/// All metrics, in the order of files: of images, the same of training views, and all others.
pub static METRICS: LazyLock<Vec<&'static Metric>> = LazyLock::new(|| {
    let of_images = IMAGES.iter().copied().chain(&LPIPS).chain(&AVERAGE);
    of_images.chain(OF_TRAINING.iter().flatten()).chain(OTHERS.iter().copied()).collect()
});

/// Those of held-out views that runs have of training views, too.
pub fn split_metrics() -> impl Iterator<Item = &'static Metric> {
    [&PSNR, &SSIM].into_iter().chain(&LPIPS)
}

/// Mean over training views, and gap, of each of [`split_metrics`].
static OF_TRAINING: LazyLock<Vec<[Metric; 2]>> = LazyLock::new(|| split_metrics().map(of_training).collect());

/// Of training views the better number is the better fit, not the better picture of held-out views. So it describes, and
/// so does the gap.
fn of_training(metric: &'static Metric) -> [Metric; 2] {
    let Metric { key, label, .. } = metric;
    let (name, unit) = label.strip_suffix(" (dB)").map_or((*label, ""), |name| (name, " (dB)"));
    let gap = if *key == PSNR.key { "gap".into() } else { format!("gap_{key}") };
    let describes = |scope: Scope, key: String, label: String| {
        // They are made once, and live as long as the program.
        Metric { key: key.leak(), label: label.leak(), direction: Direction::Neither, scope, ..*metric }
    };
    [
        describes(Scope::TrainViews, format!("train_{key}"), format!("{name} of training views{unit}")),
        describes(Scope::Gap, gap, format!("{name}, training minus held-out{unit}")),
    ]
}

/// Declares metrics: each has a constant and is in the list.
macro_rules! metrics {
    ($list:ident: $($(#[$doc:meta])* $name:ident = $metric:expr;)*) => {
        $($(#[$doc])* pub static $name: Metric = $metric;)*
        static $list: &[&Metric] = &[$(&$name),*];
    };
}

const DECIBEL: Metric = Metric {
    key: "",
    label: "",
    unit: "dB",
    direction: Direction::Up,
    digits: Digits::Decimals(2),
    scope: Scope::View,
    needs: Needs::Nothing,
};
const RATIO: Metric = Metric { unit: "", direction: Direction::Down, digits: Digits::Decimals(3), ..DECIBEL };
/// Less variation of density is smoother, not better: an empty field has none.
const LATTICE: Metric = Metric {
    direction: Direction::Neither,
    digits: Digits::Figures,
    scope: Scope::Lattice,
    needs: Needs::DerivativesAtPoints,
    ..DECIBEL
};
const DEPTH: Metric =
    Metric { unit: "scene units", direction: Direction::Down, digits: Digits::Figures, needs: Needs::Depth, ..DECIBEL };
/// The reference's own value, with which ours is compared.
const TRUTH: Metric = Metric { direction: Direction::Neither, needs: Needs::ExactDepth, ..DEPTH };

metrics! { IMAGES:
    /// PSNR of the image rounded to 8 bits.
    PSNR = Metric { key: "psnr", label: "PSNR (dB)", ..DECIBEL };
    /// PSNR of the image as it is.
    PSNR_FLOAT = Metric { key: "psnr_float", label: "PSNR float (dB)", ..DECIBEL };
    /// Mean squared error of the image as it is.
    MSE = Metric {
        key: "mse",
        label: "mean squared error",
        unit: "",
        direction: Direction::Down,
        digits: Digits::Figures,
        scope: Scope::ViewAlone,
        ..DECIBEL
    };
    /// PSNR of the mean of [`MSE`] over views.
    PSNR_OF_MEAN =
        Metric { key: "psnr_of_mean", label: "PSNR of mean (dB)", scope: Scope::Mean, ..DECIBEL };
    /// PSNR of the best single colour of the training views ([`super::Floor`]): below it nothing was learned.
    FLOOR_PSNR =
        Metric { key: "floor_psnr", label: "PSNR of one colour (dB)", direction: Direction::Neither, ..DECIBEL };
    /// SSIM of the image rounded to 8 bits.
    SSIM = Metric { key: "ssim", label: "SSIM", direction: Direction::Up, ..RATIO };
}

/// LPIPS of the image rounded to 8 bits, by backbone.
static LPIPS: [Metric; Backbone::ALL.len()] = [
    lpips(Backbone::Alex, "lpips_alex", "LPIPS (alex)"),
    lpips(Backbone::Vgg, "lpips_vgg", "LPIPS (vgg)"),
    lpips(Backbone::Squeeze, "lpips_squeeze", "LPIPS (squeeze)"),
];

const fn lpips(backbone: Backbone, key: &'static str, label: &'static str) -> Metric {
    Metric { key, label, needs: Needs::Lpips(backbone), ..RATIO }
}

/// The geometric mean of three errors ([`super::average`]), by backbone.
static AVERAGE: [Metric; Backbone::ALL.len()] = [
    average(Backbone::Alex, "average_alex", "average (alex)"),
    average(Backbone::Vgg, "average_vgg", "average (vgg)"),
    average(Backbone::Squeeze, "average_squeeze", "average (squeeze)"),
];

const fn average(backbone: Backbone, key: &'static str, label: &'static str) -> Metric {
    Metric { scope: Scope::Mean, ..lpips(backbone, key, label) }
}

impl Backbone {
    /// LPIPS with this backbone.
    pub fn lpips(self) -> &'static Metric {
        &LPIPS[self as usize]
    }

    /// The average of PSNR, SSIM and this LPIPS.
    pub fn average(self) -> &'static Metric {
        &AVERAGE[self as usize]
    }
}

metrics! { OTHERS:
    /// Mean absolute density.
    L1 = Metric { key: "l1", label: "l1 of density", unit: "scene units^2", ..LATTICE };
    /// Total variation of density.
    TV = Metric { key: "tv", label: "TV of density", unit: "scene units", ..LATTICE };
    /// Mean absolute Laplacian of density.
    LAPLACIAN = Metric { key: "laplacian", label: "Laplacian of density", unit: "", ..LATTICE };
    /// The largest density on the lattice.
    LARGEST_DENSITY = Metric {
        key: "largest_density",
        label: "largest density",
        unit: "1 / scene unit",
        direction: Direction::Neither,
        ..LATTICE
    };
    /// The fraction of the lattice with density.
    OCCUPIED =
        Metric { key: "occupied", label: "occupied", unit: "", direction: Direction::Neither, ..LATTICE };
    /// Mean absolute error of depth.
    DEPTH_MAE = Metric { key: "depth_mae", label: "mean depth error", ..DEPTH };
    /// Root of the mean squared error of depth.
    DEPTH_RMSE = Metric { key: "depth_rmse", label: "depth rmse", ..DEPTH };
    /// The fraction of pixels with reference depth that has no rendered depth.
    DEPTH_LEFT_OUT = Metric { key: "depth_left_out", label: "depth left out", unit: "", ..DEPTH };
    /// [`DEPTH_MAE`] over the pixels that all rows of a sweep show.
    DEPTH_MAE_COMMON = Metric {
        key: "depth_mae_common",
        label: "mean depth error, common pixels",
        scope: Scope::Common,
        ..DEPTH
    };
    /// [`DEPTH_RMSE`] over the pixels that all rows of a sweep show.
    DEPTH_RMSE_COMMON =
        Metric { key: "depth_rmse_common", label: "depth rmse, common pixels", scope: Scope::Common, ..DEPTH };
    /// The fraction of pixels with reference depth that some row of a sweep does not show.
    DEPTH_LEFT_OUT_COMMON = Metric {
        key: "depth_left_out_common",
        label: "depth left out by any row",
        unit: "",
        scope: Scope::Common,
        ..TRUTH
    };
    /// Roughness of the rendered depth.
    DEPTH_ROUGHNESS = Metric { key: "depth_roughness", label: "depth roughness", ..DEPTH };
    /// Roughness of the reference depth.
    DEPTH_ROUGHNESS_TRUTH =
        Metric { key: "depth_roughness_truth", label: "depth roughness truth", ..TRUTH };
    /// Roughness of the normals of the rendered depth.
    NORMAL_ROUGHNESS =
        Metric { key: "normal_roughness", label: "normal roughness", unit: "degrees", ..DEPTH };
    /// Roughness of the normals of the reference depth.
    NORMAL_ROUGHNESS_TRUTH =
        Metric { key: "normal_roughness_truth", label: "normal roughness truth", unit: "degrees", ..TRUTH };
    /// Distance between the field's surface and the reference mesh.
    CHAMFER =
        Metric { key: "chamfer", label: "Chamfer distance", scope: Scope::Surface, needs: Needs::Mesh, ..DEPTH };
    /// The F-score of the field's surface at the first distance of `eval.mesh.at`.
    F_SCORE = Metric {
        key: "f_score",
        label: "F-score",
        unit: "",
        direction: Direction::Up,
        scope: Scope::Surface,
        needs: Needs::Mesh,
        ..DEPTH
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gains_are_differences_in_the_better_direction() {
        let of = |direction: Direction| direction.gains((-1.0, 3.0));
        assert_eq!(
            [Direction::Up, Direction::Down, Direction::Neither].map(of),
            [Some((-1.0, 3.0)), Some((-3.0, 1.0)), None]
        );
    }

    /// All that a reader of files sees, in the order of columns: key, label, unit, digits, direction, scope and needs.
    const ALL: &str = "\
psnr | PSNR (dB) | dB | Decimals(2) Up View Nothing
psnr_float | PSNR float (dB) | dB | Decimals(2) Up View Nothing
mse | mean squared error |  | Figures Down ViewAlone Nothing
psnr_of_mean | PSNR of mean (dB) | dB | Decimals(2) Up Mean Nothing
floor_psnr | PSNR of one colour (dB) | dB | Decimals(2) Neither View Nothing
ssim | SSIM |  | Decimals(3) Up View Nothing
lpips_alex | LPIPS (alex) |  | Decimals(3) Down View Lpips(Alex)
lpips_vgg | LPIPS (vgg) |  | Decimals(3) Down View Lpips(Vgg)
lpips_squeeze | LPIPS (squeeze) |  | Decimals(3) Down View Lpips(Squeeze)
average_alex | average (alex) |  | Decimals(3) Down Mean Lpips(Alex)
average_vgg | average (vgg) |  | Decimals(3) Down Mean Lpips(Vgg)
average_squeeze | average (squeeze) |  | Decimals(3) Down Mean Lpips(Squeeze)
train_psnr | PSNR of training views (dB) | dB | Decimals(2) Neither TrainViews Nothing
gap | PSNR, training minus held-out (dB) | dB | Decimals(2) Neither Gap Nothing
train_ssim | SSIM of training views |  | Decimals(3) Neither TrainViews Nothing
gap_ssim | SSIM, training minus held-out |  | Decimals(3) Neither Gap Nothing
train_lpips_alex | LPIPS (alex) of training views |  | Decimals(3) Neither TrainViews Lpips(Alex)
gap_lpips_alex | LPIPS (alex), training minus held-out |  | Decimals(3) Neither Gap Lpips(Alex)
train_lpips_vgg | LPIPS (vgg) of training views |  | Decimals(3) Neither TrainViews Lpips(Vgg)
gap_lpips_vgg | LPIPS (vgg), training minus held-out |  | Decimals(3) Neither Gap Lpips(Vgg)
train_lpips_squeeze | LPIPS (squeeze) of training views |  | Decimals(3) Neither TrainViews Lpips(Squeeze)
gap_lpips_squeeze | LPIPS (squeeze), training minus held-out |  | Decimals(3) Neither Gap Lpips(Squeeze)
l1 | l1 of density | scene units^2 | Figures Neither Lattice DerivativesAtPoints
tv | TV of density | scene units | Figures Neither Lattice DerivativesAtPoints
laplacian | Laplacian of density |  | Figures Neither Lattice DerivativesAtPoints
largest_density | largest density | 1 / scene unit | Figures Neither Lattice DerivativesAtPoints
occupied | occupied |  | Figures Neither Lattice DerivativesAtPoints
depth_mae | mean depth error | scene units | Figures Down View Depth
depth_rmse | depth rmse | scene units | Figures Down View Depth
depth_left_out | depth left out |  | Figures Down View Depth
depth_mae_common | mean depth error, common pixels | scene units | Figures Down Common Depth
depth_rmse_common | depth rmse, common pixels | scene units | Figures Down Common Depth
depth_left_out_common | depth left out by any row |  | Figures Neither Common ExactDepth
depth_roughness | depth roughness | scene units | Figures Down View Depth
depth_roughness_truth | depth roughness truth | scene units | Figures Neither View ExactDepth
normal_roughness | normal roughness | degrees | Figures Down View Depth
normal_roughness_truth | normal roughness truth | degrees | Figures Neither View ExactDepth
chamfer | Chamfer distance | scene units | Figures Down Surface Mesh
f_score | F-score |  | Figures Up Surface Mesh
";

    #[test]
    fn keys_labels_and_order_are_those_of_files() {
        let line = |metric: &&Metric| {
            let Metric { key, label, unit, digits, direction, scope, needs } = metric;
            format!("{key} | {label} | {unit} | {digits:?} {direction:?} {scope:?} {needs:?}\n")
        };
        assert_eq!(METRICS.iter().map(line).collect::<String>(), ALL);
    }

    #[test]
    fn handles_are_the_metrics_of_their_names() {
        for backbone in Backbone::ALL {
            let lpips = backbone.lpips();
            let keys = [lpips, backbone.average(), lpips.train(), lpips.gap()].map(|metric| metric.key);
            let expected =
                ["lpips", "average", "train_lpips", "gap_lpips"].map(|key| format!("{key}_{}", backbone.name()));
            assert_eq!(keys.to_vec(), expected);
            assert_eq!(lpips.needs, Needs::Lpips(backbone));
        }
        assert_eq!((PSNR.key, PSNR.train().key, PSNR.gap().key), ("psnr", "train_psnr", "gap"));
        for metric in METRICS.iter() {
            assert!(Metric::find(metric.key).is_some_and(|found| std::ptr::eq(found, *metric)), "{}", metric.key);
        }
        assert_eq!(Metric::find("pnsr"), None);
    }

    #[test]
    fn numbers_have_the_digits_of_their_metric() {
        let texts =
            [PSNR_FLOAT.text(25.318), Backbone::Vgg.lpips().text(0.21049), TV.text(123456.0), CHAMFER.text(0.061)];
        assert_eq!(texts, ["25.32", "0.210", "1.235e5", "0.06100"]);
    }
}
