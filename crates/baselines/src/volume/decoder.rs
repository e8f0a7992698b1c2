//! The decoder from a code to a volume and its warp.

use candle_core::{D, DType, Device, Tensor};

use crate::base::Result;
use crate::base::tensors::leaky_relu;
use crate::grids::conv3d::Conv3d;
use crate::grids::softplus::softplus;
use crate::grids::trilinear::{Outside, trilinear};
use crate::parameters;

use super::parameters::{NeuralVolume, Pair, SLOPE, WarpSizes, next};

/// Keeps the weights' sum away from 0.
const LEAST_WEIGHT: f64 = 1e-3;
/// Factor on the scaled translations.
const TRANSLATION: f64 = 0.1;
/// Keeps a quaternion's length away from 0.
const QUATERNION: f64 = 1e-5;

/// A decoded volume.
pub(super) struct Decoded {
    /// `[z, y, x, 4]`: red, green and blue from 0 to about 255, opacity per half a side.
    pub(super) template: Tensor,
    /// `[z, y, x, 3]`: the position at which the template is looked up.
    pub(super) warp: Option<Tensor>,
}

impl NeuralVolume {
    /// Decodes `code`.
    pub(super) fn decode(&self, code: &Tensor, frozen: bool) -> Result<Decoded> {
        let layers = self.layers(frozen);
        let mut layers = layers.iter();
        let code = code.unsqueeze(0)?;
        let mut volume =
            leaky_relu(&linear(&code, next(&mut layers))?, SLOPE)?.reshape((1, 1, 1, self.sizes.channels[0]))?;
        let doublings = self.sizes.channels.len() - 1;
        for index in 0..doublings {
            let product = Conv3d::transposed([1 << index; 3]);
            let product = if index + 1 < doublings { product.leaky(SLOPE) } else { product };
            let [weight, bias] = next(&mut layers);
            volume = product.forward(&volume, weight, bias)?;
        }
        let template = softplus(&volume, [25.0, 25.0, 25.0, 1.0], [100.0, 100.0, 100.0, 0.0])?;
        let mut head = || -> Result<Tensor> {
            let hidden = leaky_relu(&linear(&code, next(&mut layers))?, SLOPE)?;
            linear(&hidden, next(&mut layers))
        };
        let warp = match &self.sizes.warp {
            Some(sizes) => Some(warp(sizes, [head()?, head()?, head()?, head()?])?),
            None => None,
        };
        Ok(Decoded { template, warp })
    }
}

fn linear(x: &Tensor, [weight, bias]: &Pair) -> Result<Tensor> {
    Ok(parameters::linear(x, weight, bias)?)
}

/// Returns a mixture of affine maps `A(x) = s R(q) (x - t)`, weighted by their grids at the mapped points.
fn warp(sizes: &WarpSizes, [scale, quaternion, translation, weights]: [Tensor; 4]) -> Result<Tensor> {
    let WarpSizes { maps, side, .. } = *sizes;
    let points = side.pow(3);
    let scale = scale.reshape((maps, 1, 3))?;
    let translation = (translation.reshape((maps, 1, 3))? * TRANSLATION)?;
    let turned = rotations(&quaternion.reshape((maps, 4))?)?.transpose(1, 2)?.contiguous()?;
    let lattice = lattice(side, scale.dtype(), scale.device())?;
    let moved = lattice.broadcast_sub(&translation)?.matmul(&turned)?.broadcast_mul(&scale)?; // [maps, points, 3]
    let weights = weights.exp()?.reshape((maps * side, side, side, 1))?;
    let sampled = (0..maps).map(|map| {
        let grid = weights.narrow(0, map * side, side)?;
        Ok(trilinear(&grid, &moved.get(map)?, Outside::Border)?)
    });
    let weights = Tensor::cat(&sampled.collect::<Result<Vec<_>>>()?, 0)?.reshape((maps, points, 1))?;
    let total = weights.sum(0)?.maximum(LEAST_WEIGHT)?; // [points, 1]
    let mixed = moved.broadcast_mul(&weights)?.sum(0)?.broadcast_div(&total)?;
    Ok(mixed.reshape((side, side, side, 3))?)
}

/// Returns points of a grid over [-1, 1]^3, x fastest, `[1, side^3, 3]`, each x, y, z.
fn lattice(side: usize, dtype: DType, device: &Device) -> Result<Tensor> {
    let at = |i: usize| -1.0 + 2.0 * i as f64 / (side - 1) as f64;
    let points = (0..side.pow(3)).flat_map(|i| [at(i % side), at(i / side % side), at(i / (side * side))]);
    Ok(Tensor::from_vec(points.collect::<Vec<f64>>(), (1, side.pow(3), 3), device)?.to_dtype(dtype)?)
}

/// Returns rotations `[n, 3, 3]` of quaternions `[n, 4]`, x, y, z, w, of any length.
pub(super) fn rotations(quaternions: &Tensor) -> Result<Tensor> {
    let length = (quaternions.sqr()?.sum_keepdim(D::Minus1)? + QUATERNION)?.sqrt()?;
    let unit = quaternions.broadcast_div(&length)?;
    let at = |axis: usize| unit.narrow(1, axis, 1);
    let [x, y, z, w] = [at(0)?, at(1)?, at(2)?, at(3)?];
    let diagonal = |a: &Tensor, b: &Tensor| ((a.sqr()? + b.sqr()?)? * -2.0)? + 1.0;
    let sum = |(a, b): (&Tensor, &Tensor), (c, d): (&Tensor, &Tensor)| ((a * b)? + (c * d)?)? * 2.0;
    let difference = |(a, b): (&Tensor, &Tensor), (c, d): (&Tensor, &Tensor)| ((a * b)? - (c * d)?)? * 2.0;
    let rows = [
        diagonal(&y, &z)?,
        difference((&x, &y), (&z, &w))?,
        sum((&x, &z), (&y, &w))?,
        sum((&x, &y), (&z, &w))?,
        diagonal(&x, &z)?,
        difference((&y, &z), (&x, &w))?,
        difference((&x, &z), (&y, &w))?,
        sum((&x, &w), (&y, &z))?,
        diagonal(&x, &y)?,
    ];
    Ok(Tensor::cat(&rows, 1)?.reshape(((), 3, 3))?)
}
