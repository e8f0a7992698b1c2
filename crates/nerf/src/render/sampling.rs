//! Sample positions along rays: stratified and inverse-CDF.
//!
//! `t_vals` are points, `[rays, samples]`, or edges of intervals (MipNeRF), sorted, in units of the ray direction's
//! length. Nothing here has gradients. A CDF is inverted in f64 on the host; tensors of other devices come there and go back.

use candle_core::{DType, Device, Tensor};

use crate::base::Result;
use crate::render::settings::Spacing;

/// Returns stratified samples: `samples` points evenly spaced from near to far (in t or in 1 / t). Each is moved
/// uniformly within its bin, which ends midway to the neighbours. `jitter` is uniform in 0..1, `[rays, samples]`.
/// Without it the points are repeated for `rays` rays.
pub fn stratified(
    bounds: (f64, f64),
    spacing: Spacing,
    rays: usize,
    samples: usize,
    jitter: Option<&Tensor>,
    like: &Tensor,
) -> Result<Tensor> {
    let points: Vec<f64> = (0..samples).map(|i| spacing.at(bounds, i as f64 / (samples - 1) as f64)).collect();
    let mid = |i: usize| 0.5 * (points[i] + points[i + 1]);
    let lower: Vec<f64> = (0..samples).map(|i| if i == 0 { points[0] } else { mid(i - 1) }).collect();
    let upper: Vec<f64> = (0..samples).map(|i| if i + 1 == samples { points[i] } else { mid(i) }).collect();
    let row = |values: Vec<f64>| Tensor::from_vec(values, (1, samples), like.device())?.to_dtype(like.dtype());
    let Some(jitter) = jitter else {
        return Ok(row(points)?.broadcast_as((rays, samples))?.contiguous()?);
    };
    let width = row(upper.iter().zip(&lower).map(|(u, l)| u - l).collect())?;
    Ok(jitter.broadcast_mul(&width)?.broadcast_add(&row(lower)?)?)
}

/// Returns the fine pass's positions, sorted, `[rays, coarse + fine]`: `t_vals` and new samples. The new samples follow
/// the piecewise-constant density that the coarse pass's interior weights put on the midpoints between coarse samples.
/// `weights` `[rays, coarse]`; `u` `[rays, fine]` in 0..1.
pub fn importance(t_vals: &Tensor, weights: &Tensor, u: &Tensor) -> Result<Tensor> {
    let (rays, coarse) = t_vals.dims2()?;
    let (_, fine) = u.dims2()?;
    let (t, w, u) = (host_rows(t_vals)?, host_rows(weights)?, host_rows(u)?);
    let mut merged = vec![0f64; rays * (coarse + fine)];
    for (ray, out) in merged.chunks_mut(coarse + fine).enumerate() {
        let t = &t[ray * coarse..][..coarse];
        let bins: Vec<f64> = t.windows(2).map(|pair| 0.5 * (pair[0] + pair[1])).collect();
        let interior = &w[ray * coarse + 1..][..coarse - 2];
        out[..coarse].copy_from_slice(t);
        inverse_cdf(&bins, interior, &u[ray * fine..][..fine], &mut out[coarse..]);
        // total_cmp also orders NaN: a broken weight must be reported, not panic here.
        out.sort_unstable_by(f64::total_cmp);
    }
    Ok(Tensor::from_vec(merged, (rays, coarse + fine), &Device::Cpu)?
        .to_dtype(t_vals.dtype())?
        .to_device(t_vals.device())?)
}

/// Returns the edges of MipNeRF's fine pass: `fine + 1` new edges of intervals, `[rays, fine + 1]`, drawn from the
/// blurred weights of the coarse intervals. `edges` `[rays, coarse + 1]`, `weights` `[rays, coarse]`,
/// `u` `[rays, fine + 1]` in 0..=1, sorted. A blurred weight is the mean of the larger of itself and either neighbour, plus `padding`
/// (Barron et al. 2021, equation 18).
pub fn resample_intervals(edges: &Tensor, weights: &Tensor, u: &Tensor, padding: f64) -> Result<Tensor> {
    let (rays, coarse) = weights.dims2()?;
    let (_, new) = u.dims2()?;
    let (t, w, u) = (host_rows(edges)?, host_rows(weights)?, host_rows(u)?);
    let mut fine_edges = vec![0f64; rays * new];
    for (ray, out) in fine_edges.chunks_mut(new).enumerate() {
        let blurred = blur(&w[ray * coarse..][..coarse], padding);
        let cdf = cumulative(&blurred);
        invert(&t[ray * (coarse + 1)..][..coarse + 1], &cdf, &u[ray * new..][..new], f64::MIN_POSITIVE, out);
        // Rounding may have exchanged two equal edges.
        out.sort_unstable_by(f64::total_cmp);
    }
    Ok(Tensor::from_vec(fine_edges, (rays, new), &Device::Cpu)?.to_dtype(edges.dtype())?.to_device(edges.device())?)
}

fn blur(weights: &[f64], padding: f64) -> Vec<f64> {
    let larger = |a: f64, b: f64| if a.is_nan() || a > b { a } else { b };
    let weight = |i: usize| weights[i.min(weights.len() - 1)];
    let larger_before = |i: usize| larger(weight(i.saturating_sub(1)), weight(i));
    (0..weights.len()).map(|i| 0.5 * (larger_before(i) + larger_before(i + 1)) + padding).collect()
}

/// Returns one sorted u in each of `count` equal parts of 0..1, from `u [rays, count]` uniform in 0..1.
pub fn stratified_u(u: &Tensor) -> Result<Tensor> {
    let (_, count) = u.dims2()?;
    let lower: Vec<f64> = (0..count).map(|i| i as f64 / count as f64).collect();
    let lower = Tensor::from_vec(lower, (1, count), u.device())?.to_dtype(u.dtype())?;
    Ok((u / count as f64)?.broadcast_add(&lower)?)
}

/// Returns `fine` equally spaced u in 0..=1 for each ray, for sampling at test time.
pub fn even_u(rays: usize, fine: usize, like: &Tensor) -> Result<Tensor> {
    let last = (fine.max(2) - 1) as f64;
    let row: Vec<f64> = (0..fine).map(|i| i as f64 / last).collect();
    let row = Tensor::from_vec(row, (1, fine), like.device())?.to_dtype(like.dtype())?;
    Ok(row.broadcast_as((rays, fine))?.contiguous()?)
}

/// Added to each weight before it counts as a probability.
const FLOOR: f64 = 1e-5;

/// Maps `u` through the inverse of the CDF that `weights + 1e-5` (one per bin, `bins.len() - 1`) define on the edges
/// `bins`. A bin with a probability below 1e-5 counts as of width 1, as in the original implementation. Such u are very
/// rare, and map next to the lower edge.
pub fn inverse_cdf(bins: &[f64], weights: &[f64], u: &[f64], out: &mut [f64]) {
    let floored: Vec<f64> = weights.iter().map(|w| w + FLOOR).collect();
    invert(bins, &cumulative(&floored), u, FLOOR, out);
}

/// Returns the CDF of weights, from 0 to 1 on the edges of their bins.
fn cumulative(weights: &[f64]) -> Vec<f64> {
    let total: f64 = weights.iter().sum();
    let mut cdf = Vec::with_capacity(weights.len() + 1);
    let mut sum = 0.0;
    cdf.push(0.0);
    for w in weights {
        sum += w / total;
        cdf.push(sum);
    }
    cdf
}

/// Maps `u` through the inverse of a CDF given on the edges `bins`. A bin with a probability below `narrowest` counts
/// as of width 1.
fn invert(bins: &[f64], cdf: &[f64], u: &[f64], narrowest: f64, out: &mut [f64]) {
    let last = cdf.len() - 1;
    for (out, &u) in out.iter_mut().zip(u) {
        let next = cdf.partition_point(|&c| c <= u);
        let (lower, upper) = (next.saturating_sub(1), next.min(last));
        let probability = cdf[upper] - cdf[lower];
        let fraction = (u - cdf[lower]) / if probability < narrowest { 1.0 } else { probability };
        *out = bins[lower] + fraction * (bins[upper] - bins[lower]);
    }
}

fn host_rows(tensor: &Tensor) -> Result<Vec<f64>> {
    Ok(tensor.detach().to_device(&Device::Cpu)?.to_dtype(DType::F64)?.flatten_all()?.to_vec1()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stratified_samples_stay_in_their_bins_and_are_sorted() {
        let like = Tensor::zeros(1, DType::F64, &Device::Cpu).unwrap();
        let jitter = Tensor::new(&[[0.0, 0.0, 0.0, 0.0], [0.999, 0.999, 0.999, 0.999]], &Device::Cpu).unwrap();
        let t = stratified((2.0, 5.0), Spacing::Depth, 2, 4, Some(&jitter), &like).unwrap().to_vec2::<f64>().unwrap();
        assert_eq!(t[0], [2.0, 2.5, 3.5, 4.5]);
        assert!(t[1].iter().zip([2.5, 3.5, 4.5, 5.0]).all(|(a, b)| (a - b).abs() < 2e-3 && *a < b));
        let still = stratified((2.0, 5.0), Spacing::Depth, 1, 4, None, &like).unwrap().to_vec2::<f64>().unwrap();
        assert_eq!(still[0], [2.0, 3.0, 4.0, 5.0]);
        let near = stratified((0.5, 8.0), Spacing::Disparity, 1, 6, None, &like).unwrap().to_vec2::<f64>().unwrap();
        let expected = [2.0, 1.625, 1.25, 0.875, 0.5, 0.125].map(|disparity: f64| 1.0 / disparity);
        assert!(near[0].iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{near:?}");
    }

    /// Weights blurred, padded and inverted by hand, one u at a time along the piecewise-linear CDF.
    #[test]
    fn intervals_are_drawn_from_blurred_weights() {
        let edges = [1.0, 1.5, 3.0, 3.5, 6.0];
        let weights = [0.2, 0.0, 0.7, 0.1];
        // Means of the larger of each weight and its left, and its right neighbour.
        let blurred = [0.2, 0.45, 0.7, 0.4].map(|w| w + 0.01);
        let total: f64 = blurred.iter().sum();
        let u = [0.0, 0.05, 0.3, 0.31, 0.77, 1.0];
        let expected = u.map(|u| {
            let mut cdf = 0.0;
            for (i, w) in blurred.iter().enumerate() {
                let probability = w / total;
                if u <= cdf + probability {
                    return edges[i] + (u - cdf) / probability * (edges[i + 1] - edges[i]);
                }
                cdf += probability;
            }
            edges[4]
        });
        let tensor = |values: &[f64]| Tensor::new(values, &Device::Cpu).unwrap().unsqueeze(0).unwrap();
        let edges_drawn = resample_intervals(&tensor(&edges), &tensor(&weights), &tensor(&u), 0.01).unwrap();
        for (a, b) in edges_drawn.to_vec2::<f64>().unwrap()[0].iter().zip(expected) {
            assert!((a - b).abs() < 1e-9, "{a} {b}");
        }
        let empty = resample_intervals(&tensor(&edges), &tensor(&[0.0; 4]), &tensor(&[0.0, 0.5, 1.0]), 0.01).unwrap();
        assert_eq!(empty.to_vec2::<f64>().unwrap()[0], [1.0, 3.0, 6.0], "evenly over intervals where nothing is seen");
        let even = stratified_u(&tensor(&[0.5, 0.0, 0.999])).unwrap().to_vec2::<f64>().unwrap().remove(0);
        assert!(even[0] == 0.5 / 3.0 && even[1] == 1.0 / 3.0 && even[2] < 1.0, "{even:?}");
    }

    #[test]
    fn inverse_cdf_puts_samples_where_the_weight_is() {
        let bins = [0.0, 1.0, 2.0, 3.0];
        let u: Vec<f64> = (0..1000).map(|i| (i as f64 + 0.5) / 1000.0).collect();
        let mut out = vec![0.0; 1000];
        inverse_cdf(&bins, &[1.0, 0.0, 3.0], &u, &mut out);
        let count = |lo: f64, hi: f64| out.iter().filter(|t| **t >= lo && **t < hi).count();
        assert!(count(0.0, 1.0).abs_diff(250) <= 1 && count(2.0, 3.1).abs_diff(750) <= 1);
        assert!(out.windows(2).all(|pair| pair[0] <= pair[1]));
    }
}
