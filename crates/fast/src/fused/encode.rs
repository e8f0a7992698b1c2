//! The encoding of a tile in f32: sines and cosines of eight points at a time.

use std::f64::consts::FRAC_2_PI;

use crate::encoding::{Code, encode_into, encoded_channels, integrated_into};
use crate::simd::vectorized;

/// Points per iteration.
const POINTS: usize = 8;
/// Their numbers: three independent vectors of AVX-512.
const LANES: usize = 3 * POINTS;
/// Largest number of octaves.
const MOST_OCTAVES: usize = 20;
/// Beyond it the range reduction below loses digits.
const LARGEST: f32 = 1e5;

/// Encodes a tile's positions with a field's encoding.
pub fn encode_positions(code: Code, x: &[f32], out: &mut [f32]) {
    match code {
        Code::Positional(octaves) => encode_tile(x, octaves, out),
        Code::Integrated(octaves) => integrated_into(x, octaves, out),
        Code::Features(_) => out.copy_from_slice(x),
    }
}

/// Encodes `[n, 3]` -> `[n, 3 + 6 octaves]`, as `encode` of `augnerf_nerf::field`.
pub fn encode_tile(x: &[f32], octaves: usize, out: &mut [f32]) {
    if octaves == 0 || octaves > MOST_OCTAVES || x.iter().any(|value| value.abs() > LARGEST) {
        return encode_into(x, octaves, out);
    }
    vectorized(
        #[inline(always)]
        || {
            let channels = encoded_channels(octaves);
            for (row, x) in out.chunks_exact_mut(channels).zip(x.chunks_exact(3)) {
                row[..3].copy_from_slice(x);
            }
            let (mut sines, mut cosines) = ([[0f32; LANES]; MOST_OCTAVES], [[0f32; LANES]; MOST_OCTAVES]);
            let (sines, cosines) = (&mut sines[..octaves], &mut cosines[..octaves]);
            for (number, block) in x.chunks(LANES).enumerate() {
                let mut angles = [0f64; LANES];
                angles.iter_mut().zip(block).for_each(|(angle, x)| *angle = f64::from(*x));
                let (mut sin, mut cos) = ([0f64; LANES], [0f64; LANES]);
                for i in 0..LANES {
                    (sin[i], cos[i]) = sin_cos(angles[i]);
                }
                for (sine, cosine) in sines.iter_mut().zip(&mut *cosines) {
                    for i in 0..LANES {
                        (sine[i], cosine[i]) = (sin[i] as f32, cos[i] as f32);
                    }
                    for i in 0..LANES {
                        (sin[i], cos[i]) = (2.0 * sin[i] * cos[i], (cos[i] - sin[i]) * (cos[i] + sin[i]));
                    }
                }
                let rows = out[number * POINTS * channels..].chunks_exact_mut(channels).take(block.len() / 3);
                for (row, three) in rows.zip(0..) {
                    let waves = row[3..].as_chunks_mut::<6>().0;
                    for ((wave, sine), cosine) in waves.iter_mut().zip(&*sines).zip(&*cosines) {
                        let (sine, cosine) = (sine.as_chunks::<3>().0[three], cosine.as_chunks::<3>().0[three]);
                        *wave = [sine[0], sine[1], sine[2], cosine[0], cosine[1], cosine[2]];
                    }
                }
            }
        },
    );
}

/// Returns sine and cosine without branches, for magnitudes up to [`LARGEST`]. It reduces to a quarter turn in two
/// parts of pi / 2, and uses the polynomials of fdlibm (`k_sin.c`, `k_cos.c`).
#[inline(always)]
fn sin_cos(x: f64) -> (f64, f64) {
    // Adding 1.5 * 2^52 rounds to the next integer, which is then in the sum's low bits.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    const HALF_PI: [f64; 2] = [1.570_796_326_734_125_6, 6.077_100_506_506_192e-11];
    const SIN: [f64; 6] = [
        -1.666_666_666_666_663_2e-1,
        8.333_333_333_322_49e-3,
        -1.984_126_982_985_795e-4,
        2.755_731_370_707_006_8e-6,
        -2.505_076_025_340_686_3e-8,
        1.589_690_995_211_55e-10,
    ];
    const COS: [f64; 6] = [
        4.166_666_666_666_66e-2,
        -1.388_888_888_887_411e-3,
        2.480_158_728_947_673e-5,
        -2.755_731_435_139_066_3e-7,
        2.087_572_321_298_175e-9,
        -1.135_964_755_778_819_5e-11,
    ];
    let rounded = x * FRAC_2_PI + ROUND;
    let (quarter, turns) = (rounded.to_bits(), rounded - ROUND);
    let r = (x - turns * HALF_PI[0]) - turns * HALF_PI[1];
    let z = r * r;
    let horner = |c: &[f64; 6]| c[0] + z * (c[1] + z * (c[2] + z * (c[3] + z * (c[4] + z * c[5]))));
    let (sin, cos) = (r + r * z * horner(&SIN), 1.0 - 0.5 * z + z * z * horner(&COS));
    let odd = 0u64.wrapping_sub(quarter & 1);
    let pick = |a: f64, b: f64| (a.to_bits() & !odd) | (b.to_bits() & odd);
    let sign = |negative: u64| (negative & 2) << 62;
    (f64::from_bits(pick(sin, cos) ^ sign(quarter)), f64::from_bits(pick(cos, sin) ^ sign(quarter.wrapping_add(1))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sines_and_cosines_are_the_library_s() {
        for i in -200_000..200_000i32 {
            let x = f64::from(i) * 0.37 + f64::from(i).sin();
            let (sin, cos) = sin_cos(x);
            let (expected_sin, expected_cos) = x.sin_cos();
            assert!((sin - expected_sin).abs() < 1e-11 && (cos - expected_cos).abs() < 1e-11, "{x}: {sin} {cos}");
        }
        let (sin, cos) = sin_cos(f64::NAN);
        assert!(sin.is_nan() && cos.is_nan());
    }

    #[test]
    fn a_tile_equals_the_encoding_of_rows() {
        for n in [0, 1, 2, 3, 8, 85] {
            for octaves in [0, 1, 4, 10] {
                for scale in [3.0, 2e5] {
                    let x: Vec<f32> = (0..3 * n).map(|i| scale * (i as f32 * 0.77).sin()).collect();
                    let mut found = vec![0f32; n * encoded_channels(octaves)];
                    let mut expected = found.clone();
                    encode_tile(&x, octaves, &mut found);
                    encode_into(&x, octaves, &mut expected);
                    let off = found.iter().zip(&expected).fold(0f32, |m, (a, b)| m.max((a - b).abs()));
                    assert!(off <= 1e-7, "{n} {octaves} {scale}: {off}");
                }
            }
        }
    }
}
