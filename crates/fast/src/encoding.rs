//! The encodings of positions, row by row: sines and cosines of points, and their expectations over Gaussians.
//! Each component needs one sine and cosine (and one exponential). Further octaves follow by the double-angle formulas in
//! f64. Their error doubles with each octave and stays far below f32's. A Gaussian's damping is the fourth power of the
//! octave's below. Gradients need the encoding alone.

use augnerf_base::place::is_ours;
use augnerf_base::tensors::slice;
use candle_core::{CpuStorage, CustomOp1, CustomOp2, Layout, Result, Shape, Tensor, WithDType};

/// Returns the number of channels of the encoding of a 3-vector.
pub fn encoded_channels(octaves: usize) -> usize {
    3 + 6 * octaves
}

/// Returns the number of channels of the integrated encoding of a Gaussian in space.
pub fn integrated_channels(octaves: usize) -> usize {
    6 * octaves
}

/// Encodes 3-vectors row by row.
pub(crate) fn encode_into<T: WithDType>(x: &[T], octaves: usize, out: &mut [T]) {
    let channels = encoded_channels(octaves);
    for (x, out) in x.chunks_exact(3).zip(out.chunks_exact_mut(channels)) {
        out[..3].copy_from_slice(x);
        for (axis, value) in x.iter().enumerate() {
            let (mut sin, mut cos) = value.to_f64().sin_cos();
            for octave in out[3..].chunks_exact_mut(6) {
                octave[axis] = T::from_f64(sin);
                octave[3 + axis] = T::from_f64(cos);
                (sin, cos) = (2.0 * sin * cos, (cos - sin) * (cos + sin));
            }
        }
    }
}

/// d/dx of sin(f x) is f cos(f x), of cos(f x) it is -f sin(f x).
pub(crate) fn gradient_into<T: WithDType>(encoded: &[T], gradient: &[T], octaves: usize, out: &mut [T]) {
    let channels = encoded_channels(octaves);
    let rows = encoded.chunks_exact(channels).zip(gradient.chunks_exact(channels));
    for ((encoded, gradient), out) in rows.zip(out.chunks_exact_mut(3)) {
        for (axis, out) in out.iter_mut().enumerate() {
            let mut sum = gradient[axis].to_f64();
            let mut frequency = 1.0;
            for (wave, g) in encoded[3..].chunks_exact(6).zip(gradient[3..].chunks_exact(6)) {
                let turned = wave[3 + axis].to_f64() * g[axis].to_f64() - wave[axis].to_f64() * g[3 + axis].to_f64();
                sum += frequency * turned;
                frequency *= 2.0;
            }
            *out = T::from_f64(sum);
        }
    }
}

/// Octaves with a smaller factor are set to 0. It is far below the precision of a sum of numbers near 1, even in f64.
/// Some of them would be subnormal in f32 (below 1e-38), and so could products of the others with weights and
/// gradients. CPUs multiply subnormal numbers many times slower.
pub const LEAST_KEPT: f64 = 1e-20;

/// Encodes Gaussians row by row.
pub(crate) fn integrated_into<T: WithDType>(gaussians: &[T], octaves: usize, out: &mut [T]) {
    for (gaussian, out) in gaussians.chunks_exact(6).zip(out.chunks_exact_mut(integrated_channels(octaves))) {
        for axis in 0..3 {
            let (mut sin, mut cos) = gaussian[axis].to_f64().sin_cos();
            let mut kept = (-0.5 * gaussian[3 + axis].to_f64()).exp();
            for octave in out.chunks_exact_mut(6) {
                if kept < LEAST_KEPT {
                    kept = 0.0;
                }
                octave[axis] = T::from_f64(kept * sin);
                octave[3 + axis] = T::from_f64(kept * cos);
                (sin, cos) = (2.0 * sin * cos, (cos - sin) * (cos + sin));
                kept = (kept * kept) * (kept * kept);
            }
        }
    }
}

/// With s = k sin(f m), c = k cos(f m), k = exp(-f^2 v / 2): ds/dm = f c, dc/dm = -f s, ds/dv = -f^2 s / 2, dc/dv = -f^2 c / 2.
pub fn integrated_gradient_into<T: WithDType>(encoded: &[T], gradient: &[T], octaves: usize, out: &mut [T]) {
    let channels = integrated_channels(octaves);
    let rows = encoded.chunks_exact(channels).zip(gradient.chunks_exact(channels));
    for ((encoded, gradient), out) in rows.zip(out.chunks_exact_mut(6)) {
        for axis in 0..3 {
            let (mut of_mean, mut of_variance, mut frequency) = (0.0, 0.0, 1.0);
            for (wave, g) in encoded.chunks_exact(6).zip(gradient.chunks_exact(6)) {
                let [s, c, g_s, g_c] = [wave[axis], wave[3 + axis], g[axis], g[3 + axis]].map(T::to_f64);
                of_mean += frequency * (c * g_s - s * g_c);
                of_variance -= 0.5 * frequency * frequency * (s * g_s + c * g_c);
                frequency *= 2.0;
            }
            out[axis] = T::from_f64(of_mean);
            out[3 + axis] = T::from_f64(of_variance);
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
    pub fn rows<T: WithDType>(self, x: &[T]) -> Vec<T> {
        let mut out = vec![T::from_f64(0.0); x.len() / self.inputs() * self.channels()];
        match self {
            Code::Positional(octaves) => encode_into(x, octaves, &mut out),
            Code::Integrated(octaves) => integrated_into(x, octaves, &mut out),
            Code::Features(_) => out.copy_from_slice(x),
        }
        out
    }

    /// Computes the gradient in the positions from the encoding and its gradient.
    pub fn gradient_into<T: WithDType>(self, encoded: &[T], gradient: &[T], out: &mut [T]) {
        match self {
            Code::Positional(octaves) => gradient_into(encoded, gradient, octaves, out),
            Code::Integrated(octaves) => integrated_gradient_into(encoded, gradient, octaves, out),
            Code::Features(_) => out.copy_from_slice(gradient),
        }
    }

    /// Returns the same.
    pub fn gradient_rows<T: WithDType>(self, encoded: &[T], gradient: &[T]) -> Vec<T> {
        let mut out = vec![T::from_f64(0.0); encoded.len() / self.channels() * self.inputs()];
        self.gradient_into(encoded, gradient, &mut out);
        out
    }
}

/// Encodes positions in candle's graph. `None` if candle's own operations have to.
///
/// # Errors
/// The positions are not `[n, inputs]`.
pub fn encode(positions: &Tensor, code: Code) -> Result<Option<Tensor>> {
    if !is_ours(positions) {
        return Ok(None);
    }
    Ok(Some(positions.contiguous()?.apply_op1(Encode(code))?))
}

/// The encodings on the CPU. The backward pass needs only the result.
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
        let out = match x {
            CpuStorage::F32(_) => CpuStorage::F32(self.0.rows(slice(x, layout)?)),
            CpuStorage::F64(_) => CpuStorage::F64(self.0.rows(slice(x, layout)?)),
            _ => candle_core::bail!("encode is for f32 and f64"),
        };
        Ok((out, Shape::from((n, self.0.channels()))))
    }

    fn bwd(&self, _x: &Tensor, encoded: &Tensor, gradient: &Tensor) -> Result<Option<Tensor>> {
        let backward = EncodeBackward(self.0);
        Ok(Some(encoded.detach().contiguous()?.apply_op2_no_bwd(&gradient.contiguous()?, &backward)?))
    }
}

struct EncodeBackward(Code);

impl CustomOp2 for EncodeBackward {
    fn name(&self) -> &'static str {
        "encode-backward"
    }

    fn cpu_fwd(
        &self,
        encoded: &CpuStorage,
        encoded_layout: &Layout,
        gradient: &CpuStorage,
        gradient_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let (n, _) = encoded_layout.shape().dims2()?;
        let out = match encoded {
            CpuStorage::F32(_) => CpuStorage::F32(
                self.0.gradient_rows(slice(encoded, encoded_layout)?, slice(gradient, gradient_layout)?),
            ),
            CpuStorage::F64(_) => CpuStorage::F64(
                self.0.gradient_rows(slice(encoded, encoded_layout)?, slice(gradient, gradient_layout)?),
            ),
            _ => candle_core::bail!("encode is for f32 and f64"),
        };
        Ok((out, Shape::from((n, self.0.inputs()))))
    }
}
