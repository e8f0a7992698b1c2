//! The encodings of positions, row by row: sines and cosines of points, and their expectations over Gaussians.
//! Each component needs one sine and cosine (and one exponential). Further octaves follow by the double-angle formulas in
//! f64. Their error doubles with each octave and stays far below f32's. A Gaussian's damping is the fourth power of the
//! octave's below. Gradients need the encoding alone.

use augnerf_base::tensors::{Values, slice};
use candle_core::{CpuStorage, CustomOp1, Layout, Result, Shape, Tensor};

/// Returns the number of channels of the encoding of a 3-vector.
pub fn encoded_channels(octaves: usize) -> usize {
    3 + 6 * octaves
}

/// Returns the number of channels of the integrated encoding of a Gaussian in space.
pub fn integrated_channels(octaves: usize) -> usize {
    6 * octaves
}

/// Encodes 3-vectors row by row.
pub(crate) fn encode_into(x: &[f32], octaves: usize, out: &mut [f32]) {
    let channels = encoded_channels(octaves);
    for (x, out) in x.chunks_exact(3).zip(out.chunks_exact_mut(channels)) {
        out[..3].copy_from_slice(x);
        for (axis, value) in x.iter().enumerate() {
            let (mut sin, mut cos) = f64::from(*value).sin_cos();
            for octave in out[3..].chunks_exact_mut(6) {
                octave[axis] = sin as f32;
                octave[3 + axis] = cos as f32;
                (sin, cos) = (2.0 * sin * cos, (cos - sin) * (cos + sin));
            }
        }
    }
}

/// d/dx of sin(f x) is f cos(f x), of cos(f x) it is -f sin(f x).
pub(crate) fn gradient_into(encoded: &[f32], gradient: &[f32], octaves: usize, out: &mut [f32]) {
    let channels = encoded_channels(octaves);
    let rows = encoded.chunks_exact(channels).zip(gradient.chunks_exact(channels));
    for ((encoded, gradient), out) in rows.zip(out.chunks_exact_mut(3)) {
        for (axis, out) in out.iter_mut().enumerate() {
            let mut sum = f64::from(gradient[axis]);
            let mut frequency = 1.0;
            for (wave, g) in encoded[3..].chunks_exact(6).zip(gradient[3..].chunks_exact(6)) {
                let [s, c, g_s, g_c] = [wave[axis], wave[3 + axis], g[axis], g[3 + axis]].map(f64::from);
                sum += frequency * (c * g_s - s * g_c);
                frequency *= 2.0;
            }
            *out = sum as f32;
        }
    }
}

/// Octaves with a smaller factor are set to 0. It is far below the precision of a sum of numbers near 1, even in f64.
/// Some of them would be subnormal in f32 (below 1e-38), and so could products of the others with weights and
/// gradients. CPUs multiply subnormal numbers many times slower.
const LEAST_KEPT: f64 = 1e-20;

/// Encodes Gaussians row by row.
pub(crate) fn integrated_into(gaussians: &[f32], octaves: usize, out: &mut [f32]) {
    for (gaussian, out) in gaussians.chunks_exact(6).zip(out.chunks_exact_mut(integrated_channels(octaves))) {
        for axis in 0..3 {
            let (mut sin, mut cos) = f64::from(gaussian[axis]).sin_cos();
            let mut kept = (-0.5 * f64::from(gaussian[3 + axis])).exp();
            for octave in out.chunks_exact_mut(6) {
                if kept < LEAST_KEPT {
                    kept = 0.0;
                }
                octave[axis] = (kept * sin) as f32;
                octave[3 + axis] = (kept * cos) as f32;
                (sin, cos) = (2.0 * sin * cos, (cos - sin) * (cos + sin));
                kept = (kept * kept) * (kept * kept);
            }
        }
    }
}

/// With s = k sin(f m), c = k cos(f m), k = exp(-f^2 v / 2): ds/dm = f c, dc/dm = -f s, ds/dv = -f^2 s / 2, dc/dv = -f^2 c / 2.
fn integrated_gradient_into(encoded: &[f32], gradient: &[f32], octaves: usize, out: &mut [f32]) {
    let channels = integrated_channels(octaves);
    let rows = encoded.chunks_exact(channels).zip(gradient.chunks_exact(channels));
    for ((encoded, gradient), out) in rows.zip(out.chunks_exact_mut(6)) {
        for axis in 0..3 {
            let (mut of_mean, mut of_variance, mut frequency) = (0.0, 0.0, 1.0);
            for (wave, g) in encoded.chunks_exact(6).zip(gradient.chunks_exact(6)) {
                let [s, c, g_s, g_c] = [wave[axis], wave[3 + axis], g[axis], g[3 + axis]].map(f64::from);
                of_mean += frequency * (c * g_s - s * g_c);
                of_variance -= 0.5 * frequency * frequency * (s * g_s + c * g_c);
                frequency *= 2.0;
            }
            out[axis] = of_mean as f32;
            out[3 + axis] = of_variance as f32;
        }
    }
}

/// The encoding from a position to a network's input.
#[derive(Clone, Copy, Debug)]
pub enum Code {
    /// Of a point, with this many octaves.
    Positional(usize),
    /// Of a Gaussian, with this many octaves.
    Integrated(usize),
    /// None: this many features of a hash grid are the input.
    Features(usize),
}

impl Code {
    /// Returns the numbers per position: a point's, a Gaussian's mean and variance, or features.
    pub fn inputs(self) -> usize {
        match self {
            Code::Positional(_) => 3,
            Code::Integrated(_) => 6,
            Code::Features(channels) => channels,
        }
    }

    /// Returns the numbers of an encoding.
    pub fn channels(self) -> usize {
        match self {
            Code::Positional(octaves) => encoded_channels(octaves),
            Code::Integrated(octaves) => integrated_channels(octaves),
            Code::Features(channels) => channels,
        }
    }

    /// Encodes positions row by row.
    pub fn rows(self, x: &[f32]) -> Vec<f32> {
        let mut out = vec![0.0; x.len() / self.inputs() * self.channels()];
        match self {
            Code::Positional(octaves) => encode_into(x, octaves, &mut out),
            Code::Integrated(octaves) => integrated_into(x, octaves, &mut out),
            Code::Features(_) => out.copy_from_slice(x),
        }
        out
    }

    /// Computes the gradient in the positions from the encoding and its gradient.
    pub fn gradient_into(self, encoded: &[f32], gradient: &[f32], out: &mut [f32]) {
        match self {
            Code::Positional(octaves) => gradient_into(encoded, gradient, octaves, out),
            Code::Integrated(octaves) => integrated_gradient_into(encoded, gradient, octaves, out),
            Code::Features(_) => out.copy_from_slice(gradient),
        }
    }

    /// Returns the same.
    pub fn gradient_rows(self, encoded: &[f32], gradient: &[f32]) -> Vec<f32> {
        let mut out = vec![0.0; encoded.len() / self.channels() * self.inputs()];
        self.gradient_into(encoded, gradient, &mut out);
        out
    }
}

/// Encodes f32 positions on the CPU in candle's graph.
///
/// # Errors
/// The positions are not `[n, inputs]`.
pub fn encode(positions: &Tensor, code: Code) -> Result<Tensor> {
    positions.contiguous()?.apply_op1(Encode(code))
}

/// The backward pass needs only the result.
struct Encode(Code);

impl CustomOp1 for Encode {
    fn name(&self) -> &'static str {
        "encode"
    }

    fn cpu_fwd(&self, x: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let (n, components) = layout.shape().dims2()?;
        if components != self.0.inputs() {
            candle_core::bail!("encode takes [n, {}], got {:?}", self.0.inputs(), layout.shape());
        }
        Ok((CpuStorage::F32(self.0.rows(slice(x, layout)?)), Shape::from((n, self.0.channels()))))
    }

    fn bwd(&self, x: &Tensor, encoded: &Tensor, gradient: &Tensor) -> Result<Option<Tensor>> {
        let gradient = gradient.contiguous()?;
        let rows = self.0.gradient_rows(Values::of(encoded).slice()?, Values::of(&gradient).slice()?);
        Ok(Some(Tensor::from_vec(rows, x.shape(), x.device())?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Zeros stand for numbers that do not count alone.
    #[test]
    fn integrated_encodings_have_no_subnormal_number() {
        let wave = |i: usize, phase: f64| (i as f64 * 1.3 + phase).sin();
        let gaussian = |i: usize| {
            let variance = |phase: f64| 10f64.powf(-2.5 + 2.0 * wave(i, phase));
            [wave(i, 0.0), wave(i, 1.0), 2.0 * wave(i, 2.0), variance(3.0), variance(4.0), variance(5.0)]
        };
        let gaussians: Vec<f32> = (0..200).flat_map(gaussian).map(|x| x as f32).collect();
        let code = Code::Integrated(16);
        let mut subnormal = 0;
        for (gaussian, row) in gaussians.chunks_exact(6).zip(code.rows(&gaussians).chunks_exact(code.channels())) {
            for (i, found) in row.iter().enumerate() {
                let (octave, axis) = (i / 6, i % 3);
                let [mean, variance] = [gaussian[axis], gaussian[3 + axis]].map(f64::from);
                let (sin, cos) = (2f64.powi(octave as i32) * mean).sin_cos();
                let exact = (-0.5 * 4f64.powi(octave as i32) * variance).exp() * if i % 6 < 3 { sin } else { cos };
                subnormal += usize::from((exact as f32).is_subnormal());
                assert!(!found.is_subnormal() && (*found != 0.0 || exact.abs() <= LEAST_KEPT), "{found} for {exact}");
                assert!((f64::from(*found) - exact).abs() < 1e-6, "{found} for {exact}");
            }
        }
        assert!(subnormal > 0, "these Gaussians do not show it");
    }
}
