//! The units of constraint sets: the samples and pixels of a pass, or those of the paper's.

use candle_core::Tensor;
use serde::{Deserialize, Serialize};

use crate::base::Result;

/// The samples, pixels and features in which an epsilon is measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Geometry {
    /// Those of the run. Fewer samples and coarser images make larger sets; the step sizes stay.
    #[default]
    Sampling,
    /// Those of the paper's runs, for any number of samples, resolution and width: [`PaperPass`].
    Paper,
}

/// Angular and spatial size of a pixel, for the `xyz` and `view` sets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelScale {
    /// Image width in pixels.
    pub width: f64,
    /// Image height in pixels.
    pub height: f64,
    /// Focal length in pixels.
    pub focal: f64,
    /// Whether rays are in normalized device coordinates.
    pub ndc: bool,
}

impl PixelScale {
    /// Returns a pixel of the same view in an image of another width.
    pub fn at_width(self, width: f64) -> PixelScale {
        let scale = width / self.width;
        PixelScale { width, height: self.height * scale, focal: self.focal * scale, ..self }
    }
}

/// Everything that the sets of a run's passes depend on, except the experiment's numbers and the samples.
#[derive(Clone, Copy, Debug)]
pub struct AttackGeometry {
    /// Near and far, in the units of `t_vals`.
    pub bounds: (f64, f64),
    /// The size of a pixel: the run's, or the paper's.
    pub pixel: PixelScale,
    /// Columns of the `t_vals` that are evenly spread along a ray: the coarse pass's.
    pub coarse_samples: usize,
    /// A pass's samples are some of them, those in occupied cells.
    pub are_even: bool,
    /// The width of the network.
    pub width: usize,
    /// The paper's pass, if sets are measured in its samples and pixels.
    pub paper: Option<PaperPass>,
}

impl AttackGeometry {
    /// Returns the same with sets measured in the paper's samples and pixels.
    pub fn of_paper(self, paper: PaperPass) -> AttackGeometry {
        AttackGeometry { pixel: self.pixel.at_width(paper.image_width), paper: Some(paper), ..self }
    }

    /// Returns N of the cap (far - near) |d| / (2 (N - 1)) on the radius of `xyz`: `coarse_samples`, or the paper's.
    pub fn cap_samples(&self) -> usize {
        self.paper.map_or(self.coarse_samples, |paper| paper.coarse)
    }
}

/// Everything that the sets of a pass depend on, except the experiment's numbers.
#[derive(Clone, Copy)]
pub struct PassGeometry<'a> {
    /// What all passes of the run have.
    pub run: AttackGeometry,
    /// Whether it is the coarse pass, not the fine one.
    pub is_coarse: bool,
    /// Unperturbed sample positions, `[rays, samples]`, or edges of intervals, `[rays, samples + 1]`.
    pub t_vals: &'a Tensor,
    /// Samples of the pass.
    pub samples: usize,
    /// Lengths of the ray directions, `[rays, 1]`.
    pub direction_norm: &'a Tensor,
}

/// Samples of the paper's pass along a part of a ray, over the pass's own.
///
/// A fine pass has the coarse samples, evenly spread over near..far, and `fine` more, drawn from a distribution p over
/// the ray. Its gaps are 1 / (coarse / S + fine p) wide on average, with S = far - near. The paper's pass has other
/// numbers of both, and the same p. Its samples are `coarse` times as dense if all are coarse ones, and `drawn` times
/// if nearly all are drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SampleDensity {
    /// Ratio for the coarse samples.
    pub coarse: f64,
    /// Ratio for the drawn samples.
    pub drawn: f64,
}

impl SampleDensity {
    /// The pass's own density.
    pub const OWN: SampleDensity = SampleDensity { coarse: 1.0, drawn: 1.0 };

    /// Returns the ratio if it does not depend on the fraction of coarse samples.
    pub fn uniform(&self) -> Option<f64> {
        (self.coarse == self.drawn).then_some(self.coarse)
    }

    /// Returns the ratio around each sample: `coarse` s + `drawn` (1 - s), with the fraction s of coarse samples there.
    /// Coarse samples make gaps of `coarse_gap`. Gaps of width g have a fraction g / `coarse_gap` of them, at most 1.
    ///
    /// # Errors
    /// Those of candle.
    pub fn around(&self, gaps: &Tensor, coarse_gap: f64) -> Result<Tensor> {
        let share = (gaps * (1.0 / coarse_gap))?.minimum(&gaps.ones_like()?)?;
        Ok(share.affine(self.coarse - self.drawn, self.drawn)?)
    }
}

impl PassGeometry<'_> {
    /// Returns the number of rays of the pass.
    pub fn rays(&self) -> Result<usize> {
        Ok(self.t_vals.dim(0)?)
    }

    /// Returns whether samples are intervals between the `t_vals`, not points at them. Then the last one ends, too.
    pub fn has_edges(&self) -> Result<bool> {
        Ok(self.t_vals.dim(1)? > self.samples)
    }

    /// Returns `value` in the pass's dtype and on its device.
    pub fn scalar(&self, value: f64) -> Result<Tensor> {
        Ok(Tensor::new(value, self.t_vals.device())?.to_dtype(self.t_vals.dtype())?)
    }

    /// Returns the density of the samples in which the set of `t` is measured, relative to the pass's own.
    ///
    /// The samples of a coarse pass are evenly spread, and the edges of MipNeRF's fine intervals are all drawn. The
    /// paper's pass is denser everywhere by the ratio of their numbers. For other fine passes see [`SampleDensity`].
    ///
    /// # Errors
    /// Those of candle.
    pub fn sample_density(&self) -> Result<SampleDensity> {
        let Some(paper) = self.run.paper else { return Ok(SampleDensity::OWN) };
        let (columns, coarse) = (self.t_vals.dim(1)?, self.run.coarse_samples);
        let ratio = |paper: usize, own: usize| paper as f64 / own as f64;
        if self.is_coarse || self.has_edges()? {
            let own = if self.run.are_even { coarse } else { columns };
            let all = ratio(paper.gaps(self.is_coarse), own - 1);
            return Ok(SampleDensity { coarse: all, drawn: all });
        }
        let drawn = ratio(paper.fine, columns - coarse);
        Ok(SampleDensity { coarse: ratio(paper.gaps(true), coarse - 1), drawn })
    }
}

/// Samples and images of the paper's runs (section 5.1), to which its radii and step sizes belong.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PaperPass {
    /// Samples of the coarse pass.
    pub coarse: usize,
    /// Additional samples of the fine pass.
    pub fine: usize,
    /// Width of its images in pixels.
    pub image_width: f64,
}

impl PaperPass {
    /// Samples of the coarse pass, for both kinds of scenes.
    pub const COARSE: usize = 64;
    /// Width of the networks, for both kinds of scenes.
    pub const FIELD_WIDTH: usize = 256;

    /// Returns the pass for forward-facing scenes (LLFF at 1/8: 504 x 378), or others (Blender at 1/2: 400 x 400).
    pub fn of_scenes(forward_facing: bool) -> PaperPass {
        let (fine, image_width) = if forward_facing { (64, 504.0) } else { (128, 400.0) };
        PaperPass { coarse: PaperPass::COARSE, fine, image_width }
    }

    /// Returns the number of gaps between the samples of a pass along a ray.
    fn gaps(&self, is_coarse: bool) -> usize {
        self.coarse - 1 + if is_coarse { 0 } else { self.fine }
    }

    /// Returns the factor on a box over the units of a layer in a network of `width`, relative to the paper's: sqrt(256
    /// / width).
    ///
    /// PGD with the gradient's sign ends in the corners of the box. With the factor they have the paper's Euclidean
    /// norm, epsilon sqrt(256), on which the next layer depends. With weights of variance 1 / width (Glorot) the worst
    /// corner moves each of its units by epsilon * sum |w|, in proportion to epsilon * sqrt(width). The units
    /// themselves are of order 1 at any width. A ball has that norm without a factor.
    pub fn box_scale(width: usize) -> f64 {
        (PaperPass::FIELD_WIDTH as f64 / width as f64).sqrt()
    }
}
