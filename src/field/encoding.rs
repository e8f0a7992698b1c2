//! Positional encoding (NeRF paper, section 5.1, with the identity kept).

use candle_core::{CpuStorage, CustomOp1, CustomOp2, Layout, Result, Shape, Tensor, WithDType};

use super::contiguous;

/// Channels of the encoding of a 3-vector.
pub fn encoded_channels(octaves: usize) -> usize {
    3 + 6 * octaves
}

/// `[n, 3]` -> `[n, 3 + 6 octaves]`: x, then for each frequency 2^0..2^(octaves-1) the sines and
/// the cosines of its three components.
pub fn encode(x: &Tensor, octaves: usize) -> Result<Tensor> {
    if !x.device().is_cpu() {
        return encode_reference(x, octaves);
    }
    x.contiguous()?.apply_op1(Encode { octaves })
}

/// The same in plain candle operations.
pub fn encode_reference(x: &Tensor, octaves: usize) -> Result<Tensor> {
    let (n, components) = x.dims2()?;
    if octaves == 0 {
        return Ok(x.clone());
    }
    let frequencies: Vec<f64> = (0..octaves).map(|octave| 2f64.powi(octave as i32)).collect();
    let frequencies = Tensor::from_vec(frequencies, (1, octaves, 1), x.device())?.to_dtype(x.dtype())?;
    let scaled = x.reshape((n, 1, components))?.broadcast_mul(&frequencies)?; // [n, octaves, 3]
    let waves = Tensor::cat(&[scaled.sin()?, scaled.cos()?], 2)?; // [n, octaves, 6]
    Tensor::cat(&[x, &waves.reshape((n, octaves * 2 * components))?], 1)
}

/// The encoding on a processor: one sine and cosine a component, further octaves by the
/// double-angle formulas in f64 (their error doubles with each octave and stays far below f32's),
/// and a backward pass that finds its sines and cosines in the result.
struct Encode {
    octaves: usize,
}

/// Encodes 3-vectors row by row.
pub(super) fn encode_into<T: WithDType>(x: &[T], octaves: usize, out: &mut [T]) {
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
pub(super) fn gradient_into<T: WithDType>(encoded: &[T], gradient: &[T], octaves: usize, out: &mut [T]) {
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

fn encode_rows<T: WithDType>(x: &[T], octaves: usize) -> Vec<T> {
    let mut out = vec![T::from_f64(0.0); x.len() / 3 * encoded_channels(octaves)];
    encode_into(x, octaves, &mut out);
    out
}

fn gradient_rows<T: WithDType>(encoded: &[T], gradient: &[T], octaves: usize) -> Vec<T> {
    let mut out = vec![T::from_f64(0.0); encoded.len() / encoded_channels(octaves) * 3];
    gradient_into(encoded, gradient, octaves, &mut out);
    out
}

impl CustomOp1 for Encode {
    fn name(&self) -> &'static str {
        "encode"
    }

    fn cpu_fwd(&self, x: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let (n, components) = layout.shape().dims2()?;
        if components != 3 {
            candle_core::bail!("encode takes [n, 3], got {:?}", layout.shape());
        }
        let out = match x {
            CpuStorage::F32(x) => CpuStorage::F32(encode_rows(contiguous(x, layout)?, self.octaves)),
            CpuStorage::F64(x) => CpuStorage::F64(encode_rows(contiguous(x, layout)?, self.octaves)),
            _ => candle_core::bail!("encode is for f32 and f64"),
        };
        Ok((out, Shape::from((n, encoded_channels(self.octaves)))))
    }

    fn bwd(&self, _x: &Tensor, encoded: &Tensor, gradient: &Tensor) -> Result<Option<Tensor>> {
        let backward = EncodeBackward { octaves: self.octaves };
        Ok(Some(encoded.detach().contiguous()?.apply_op2_no_bwd(&gradient.contiguous()?, &backward)?))
    }
}

struct EncodeBackward {
    octaves: usize,
}

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
        let out = match (encoded, gradient) {
            (CpuStorage::F32(e), CpuStorage::F32(g)) => CpuStorage::F32(gradient_rows(
                contiguous(e, encoded_layout)?,
                contiguous(g, gradient_layout)?,
                self.octaves,
            )),
            (CpuStorage::F64(e), CpuStorage::F64(g)) => CpuStorage::F64(gradient_rows(
                contiguous(e, encoded_layout)?,
                contiguous(g, gradient_layout)?,
                self.octaves,
            )),
            _ => candle_core::bail!("encode is for f32 and f64"),
        };
        Ok((out, Shape::from((n, 3))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{DType, Device, Var};

    #[test]
    fn value_and_gradient_equal_plain_candle() {
        let values: Vec<f64> = (0..60).map(|i| (i as f64 * 0.37).sin() * 2.0).collect();
        let weights: Vec<f64> = (0..20 * 63).map(|i| (i as f64 * 0.11).cos()).collect();
        let weights = Tensor::from_vec(weights, (20, 63), &Device::Cpu).unwrap();
        // Errors of the argument grow with the top frequency, 512.
        for (dtype, tolerance) in [(DType::F64, 1e-11), (DType::F32, 1e-4)] {
            let x = Tensor::from_slice(&values, (20, 3), &Device::Cpu).unwrap().to_dtype(dtype).unwrap();
            let x = Var::from_tensor(&x).unwrap();
            let weights = weights.to_dtype(dtype).unwrap();
            let both = [encode(&x, 10).unwrap(), encode_reference(&x, 10).unwrap()];
            let gradients = both.clone().map(|out| {
                let loss = (out * &weights).unwrap().sum_all().unwrap();
                loss.backward().unwrap().get(&x).unwrap().clone()
            });
            let largest = |[a, b]: [Tensor; 2]| {
                let difference = (a - b).unwrap().abs().unwrap().max_all().unwrap();
                difference.to_dtype(DType::F64).unwrap().to_scalar::<f64>().unwrap()
            };
            assert!(largest(both) < tolerance, "{dtype:?}");
            // Up to 512 times 20 terms.
            assert!(largest(gradients) < 5e3 * tolerance, "{dtype:?}");
        }
    }

    #[test]
    fn no_octaves_is_the_identity() {
        let x = Tensor::new(&[[1f32, -2.0, 0.5]], &Device::Cpu).unwrap();
        assert_eq!(encode(&x, 0).unwrap().to_vec2::<f32>().unwrap(), x.to_vec2::<f32>().unwrap());
    }
}
