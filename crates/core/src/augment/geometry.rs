//! What sets are measured in: a pass's samples and pixels, or those of the paper's.

use candle_core::Tensor;
use serde::{Deserialize, Serialize};

use crate::base::Result;

/// Whose samples, pixels and features an epsilon is measured in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Geometry {
    /// Those of the run: fewer samples, coarser pictures make larger sets, and the step sizes stay.
    #[default]
    Sampling,
    /// Those of the paper's runs, whatever the number of samples, the resolution and the width: [`PaperPass`].
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
    /// Rays are in normalised device coordinates.
    pub ndc: bool,
}

impl PixelScale {
    /// A pixel of the same view in a picture of another width.
    pub fn at_width(self, width: f64) -> PixelScale {
        let scale = width / self.width;
        PixelScale { width, height: self.height * scale, focal: self.focal * scale, ..self }
    }
}

/// What the sets of a pass depend on besides the experiment's numbers.
#[derive(Clone, Copy)]
pub struct PassGeometry<'a> {
    /// The coarse pass, otherwise the fine one.
    pub is_coarse: bool,
    /// Unperturbed sample positions, `[rays, samples]`, or edges of intervals, `[rays, samples + 1]`.
    pub t_vals: &'a Tensor,
    /// Samples of the pass.
    pub samples: usize,
    /// Lengths of the ray directions, `[rays, 1]`.
    pub direction_norm: &'a Tensor,
    /// Near and far, in the units of `t_vals`.
    pub bounds: (f64, f64),
    /// Columns of the coarse pass's `t_vals`.
    pub coarse_samples: usize,
    /// N of the cap (far - near) |d| / (2 (N - 1)) on the radius of `xyz`: `coarse_samples`, or the paper's.
    pub cap_samples: usize,
    /// The field's width.
    pub width: usize,
    /// A pixel's size.
    pub pixel: PixelScale,
    /// How much closer the samples that the set of `t` is measured in lie than those of the pass.
    pub density: SampleDensity,
}

/// Samples of the paper's pass along a stretch of a ray, over the pass's own.
///
/// A fine pass holds the coarse samples, evenly spread over near..far, and `fine` more, drawn from a distribution p over the
/// ray: gaps are 1 / (coarse / S + fine p) wide on average, S = far - near. The paper's pass takes other numbers of both and the
/// same p, so that its samples are `coarse` times as dense where there are only coarse ones, and `drawn` times where
/// nearly all are drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SampleDensity {
    /// Of the coarse samples.
    pub coarse: f64,
    /// Of the drawn ones.
    pub drawn: f64,
}

impl SampleDensity {
    /// The pass's own.
    pub const OWN: SampleDensity = SampleDensity { coarse: 1.0, drawn: 1.0 };

    /// The one number, where the share of coarse samples does not matter.
    pub fn uniform(&self) -> Option<f64> {
        (self.coarse == self.drawn).then_some(self.coarse)
    }

    /// Around each sample: `coarse` s + `drawn` (1 - s), with the share s of coarse samples there. They make gaps of
    /// `coarse_gap`, so that where gaps are g wide they are g / `coarse_gap` of the samples, and at most all.
    ///
    /// # Errors
    /// Those of candle.
    pub fn around(&self, gaps: &Tensor, coarse_gap: f64) -> Result<Tensor> {
        let share = (gaps * (1.0 / coarse_gap))?.minimum(&gaps.ones_like()?)?;
        Ok(share.affine(self.coarse - self.drawn, self.drawn)?)
    }
}

impl<'a> PassGeometry<'a> {
    /// Rays of the pass.
    pub fn rays(&self) -> Result<usize> {
        Ok(self.t_vals.dim(0)?)
    }

    /// Samples are intervals between the `t_vals`, not points at them: the last one ends, too.
    pub fn has_edges(&self) -> Result<bool> {
        Ok(self.t_vals.dim(1)? > self.samples)
    }

    /// `value` in the pass's dtype and place.
    pub fn scalar(&self, value: f64) -> Result<Tensor> {
        Ok(Tensor::new(value, self.t_vals.device())?.to_dtype(self.t_vals.dtype())?)
    }

    /// The same pass, its sets measured in the paper's samples and pixels.
    ///
    /// The samples of a coarse pass are evenly spread, the edges of MipNeRF's fine intervals all drawn: those of the paper's
    /// pass are as much denser everywhere as there are more of them. Other fine passes: [`SampleDensity`].
    ///
    /// # Errors
    /// Those of candle.
    pub fn of_paper(self, paper: &PaperPass) -> Result<PassGeometry<'a>> {
        let columns = self.t_vals.dim(1)?;
        let ratio = |paper: usize, own: usize| paper as f64 / own as f64;
        let density = if self.is_coarse || self.has_edges()? {
            let all = ratio(paper.gaps(self.is_coarse), columns - 1);
            SampleDensity { coarse: all, drawn: all }
        } else {
            SampleDensity {
                coarse: ratio(paper.gaps(true), self.coarse_samples - 1),
                drawn: ratio(paper.fine, columns - self.coarse_samples),
            }
        };
        let pixel = self.pixel.at_width(paper.image_width);
        Ok(PassGeometry { density, cap_samples: paper.coarse, pixel, ..self })
    }
}

/// Samples and pictures of the paper's runs (section 5.1), which its radii and step sizes belong to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PaperPass {
    /// Samples of the coarse pass.
    pub coarse: usize,
    /// Further samples of the fine pass.
    pub fine: usize,
    /// Width of its pictures in pixels.
    pub image_width: f64,
}

impl PaperPass {
    /// Samples of the coarse pass, on scenes of either kind.
    pub const COARSE: usize = 64;
    /// Width of the networks, on scenes of either kind.
    pub const FIELD_WIDTH: usize = 256;

    /// That of scenes seen from the front (LLFF at 1/8: 504 x 378), or from all around (Blender at 1/2: 400 x 400).
    pub fn of_scenes(forward_facing: bool) -> PaperPass {
        let (fine, image_width) = if forward_facing { (64, 504.0) } else { (128, 400.0) };
        PaperPass { coarse: PaperPass::COARSE, fine, image_width }
    }

    /// Gaps between the samples of a pass along a ray.
    fn gaps(&self, is_coarse: bool) -> usize {
        self.coarse - 1 + if is_coarse { 0 } else { self.fine }
    }

    /// What a box over the units of a layer is wider by in a field of `width` than in the paper's: sqrt(256 / width).
    ///
    /// Its corners, which the ascent by the gradient's sign ends in, then have the paper's Euclidean norm, epsilon
    /// sqrt(256). That is what the next layer feels: with weights of variance 1 / width (Glorot) the worst corner moves each
    /// of its units by epsilon * sum |w|, that is in proportion to epsilon * sqrt(width), while the units themselves are of
    /// order 1 at any width. A ball has that norm as it is.
    pub fn box_scale(width: usize) -> f64 {
        (PaperPass::FIELD_WIDTH as f64 / width as f64).sqrt()
    }
}
