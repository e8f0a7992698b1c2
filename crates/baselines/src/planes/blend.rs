//! Blending of several multiplane images' renderings of the same rays.

use candle_core::Tensor;

use crate::base::Result;
use crate::base::tensors::sum;

use super::geometry::Viewpoint;

/// Added to the sum of weights, the divisor of colours (the authors' code).
pub const LEAST: f64 = 1e-10;

/// Accumulation below which a ray shows the background.
pub const EMPTY: f64 = 1e-3;

/// Returns the weight of a view at distance l relative to the nearest: `exp(-(l - nearest) f / (planes near))`, f in
/// pixels. LLFF's own weight has no nearest. It is the same up to a factor that cancels in the blend, and it underflows
/// far away.
pub fn blend_weight(eye: &Viewpoint, distance: f64, nearest: f64, depths: &[f64]) -> f64 {
    let near = depths[depths.len() - 1];
    (-(distance - nearest) * eye.camera.focal[0] / (depths.len() as f64 * near)).exp()
}

/// Blended rays.
pub struct Blended {
    /// `[rays, 3]`.
    pub rgb: Tensor,
    /// Accumulation, `[rays]`.
    pub acc: Tensor,
}

/// Blends weighted renderings `[rays, 4]` (colour times weight, sum of weights). Colours are the weighted sum of
/// colours over that of weights, and the background where accumulation is next to 0.
///
/// # Errors
/// If there is no rendering; those of candle.
pub fn blend(renderings: Vec<(Tensor, f64)>, background: Option<[f32; 3]>) -> Result<Blended> {
    let total: f64 = renderings.iter().map(|(_, weight)| weight).sum();
    let weighted = |(rendering, weight): (Tensor, f64)| -> Result<Tensor> { Ok((rendering * weight)?) };
    let all = renderings.into_iter().map(weighted).try_fold(None, |all, one| sum(all, Some(one?)))?;
    let all = all.ok_or_else(|| candle_core::Error::Msg("blend: there is no rendering".into()))?;
    let of_weights = all.narrow(1, 3, 1)?;
    let acc = (&of_weights / total)?;
    let empty = acc.lt(EMPTY)?;
    let full = empty.where_cond(&acc.ones_like()?, &(of_weights + LEAST)?)?;
    let rgb = all.narrow(1, 0, 3)?.broadcast_div(&full)?;
    let behind = Tensor::new(&background.unwrap_or_default(), all.device())?.to_dtype(all.dtype())?;
    let behind = behind.broadcast_as(rgb.shape())?.contiguous()?;
    let rgb = empty.broadcast_as(rgb.shape())?.contiguous()?.where_cond(&behind, &rgb)?;
    Ok(Blended { rgb, acc: acc.squeeze(1)? })
}
