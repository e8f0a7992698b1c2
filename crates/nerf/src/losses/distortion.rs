//! The distortion loss of mip-NeRF 360 (Barron et al. 2022, equation 15).

use candle_core::{D, DType, Tensor};

use crate::base::Result;

use super::{RayPass, RayTerm};

/// The spread of a ray's weights w over its intervals between s_0 < ... < s_n, normalized to 0..1 between near and far:
///
/// ```text
///     sum over i, j of w_i w_j abs(m_i - m_j) + 1/3 sum over i of w_i^2 (s_(i+1) - s_i),   m_i = (s_i + s_(i+1)) / 2
/// ```
///
/// It is least if the weights are close together, which moves floaters and fog onto one surface. If samples are points,
/// an interval reaches to the next sample, and the last one's to far.
pub struct Distortion;

impl RayTerm for Distortion {
    fn name(&self) -> &str {
        "distortion"
    }

    fn per_group(&self, pass: &RayPass) -> Result<Tensor> {
        distortion(&pass.output.composite.weights, &pass.edges()?)
    }
}

/// Returns the loss of each ray, `[rays]`, of `weights [rays, samples]` between ascending `edges [rays, samples + 1]`.
///
/// With sorted middles the double sum is 2 sum over i of w_i (m_i W_i - M_i). W_i and M_i are the sums of w_j and w_j
/// m_j over j < i. The sums are in f64, because their difference is small at a sharp surface.
fn distortion(weights: &Tensor, edges: &Tensor) -> Result<Tensor> {
    let samples = weights.dim(1)?;
    let (weights, edges) = (weights.to_dtype(DType::F64)?, edges.to_dtype(DType::F64)?);
    let (from, to) = (edges.narrow(1, 0, samples)?, edges.narrow(1, 1, samples)?);
    let middles = ((&from + &to)? * 0.5)?;
    let before = exclusive_sum(samples, &weights)?;
    let weights_before = weights.matmul(&before)?;
    let moments_before = (&weights * &middles)?.matmul(&before)?;
    let between = (&weights * ((&middles * weights_before)? - moments_before)?)?.sum(D::Minus1)?;
    let within = (weights.sqr()? * (to - from)?)?.sum(D::Minus1)?;
    Ok(((between * 2.0)? + (within / 3.0)?)?)
}

/// Returns `[samples, samples]`, with 1 where row < column. Multiplied from the right, it sums over earlier samples.
fn exclusive_sum(samples: usize, like: &Tensor) -> Result<Tensor> {
    let one = |row: usize, column: usize| if row < column { 1.0 } else { 0.0 };
    let values: Vec<f64> = (0..samples).flat_map(|row| (0..samples).map(move |column| one(row, column))).collect();
    Ok(Tensor::from_vec(values, (samples, samples), like.device())?)
}

#[cfg(test)]
mod tests {
    use super::super::edges;
    use super::*;
    use candle_core::Device;

    fn row(values: &[f64]) -> Tensor {
        Tensor::from_slice(values, (1, values.len()), &Device::Cpu).unwrap()
    }

    fn value(weights: &[f64], edges: &[f64]) -> f64 {
        distortion(&row(weights), &row(edges)).unwrap().to_vec1::<f64>().unwrap()[0]
    }

    /// Equation 15 as it stands.
    fn by_pairs(weights: &[f64], edges: &[f64]) -> f64 {
        let middle = |i: usize| (edges[i] + edges[i + 1]) / 2.0;
        let n = weights.len();
        let pairs = (0..n).flat_map(|i| (0..n).map(move |j| (i, j)));
        let between: f64 = pairs.map(|(i, j)| weights[i] * weights[j] * (middle(i) - middle(j)).abs()).sum();
        let within: f64 = (0..n).map(|i| weights[i].powi(2) * (edges[i + 1] - edges[i])).sum();
        between + within / 3.0
    }

    #[test]
    fn closed_forms() {
        // All weight in one interval: a third of its length.
        assert!((value(&[0.0, 1.0, 0.0], &[0.0, 0.2, 0.5, 1.0]) - 0.1).abs() < 1e-15);
        // Two halves in thin intervals a distance apart: half of the distance, and little within.
        let thin = 1e-6;
        let apart = value(&[0.5, 0.0, 0.5], &[0.0, thin, 0.6 - thin, 0.6]);
        assert!((apart - (0.5 * (0.6 - thin) + 2.0 * 0.25 * thin / 3.0)).abs() < 1e-12, "{apart}");
        // A constant weight density over 0..1 in ever more intervals: the mean distance of two uniform points, 1/3.
        for n in [1, 2, 7, 64] {
            let weights = vec![1.0 / n as f64; n];
            let edges: Vec<f64> = (0..=n).map(|i| i as f64 / n as f64).collect();
            assert!((value(&weights, &edges) - 1.0 / 3.0).abs() < 1e-12, "{n}");
        }
    }

    #[test]
    fn sums_equal_pairs() {
        let weights = [0.05, 0.3, 0.0, 0.2, 0.11, 0.07];
        let edges = [0.0, 0.11, 0.12, 0.4, 0.4, 0.77, 1.0];
        assert!((value(&weights, &edges) - by_pairs(&weights, &edges)).abs() < 1e-15);
    }

    #[test]
    fn points_reach_to_the_next_and_the_last_to_far() {
        let edges =
            |t_vals: &[f64], samples| edges(&row(t_vals), samples, (2.0, 6.0)).unwrap().to_vec2::<f64>().unwrap();
        assert_eq!(edges(&[2.0, 3.0, 5.0], 3), [[0.0, 0.25, 0.75, 1.0]]);
        assert_eq!(edges(&[2.0, 3.0, 6.0], 2), [[0.0, 0.25, 1.0]]);
    }
}
