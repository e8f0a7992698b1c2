//! All randomness: a counter-based generator split into named streams.
//!
//! A random number is a function of (seed, stream, index), where index is the training step or another counter. No
//! state passes from step to step. A resumed run needs no generator state, and switching off one stream's user changes
//! no other stream. Numbers are made on the host, so that every device gets the same ones.

use std::collections::HashMap;

use candle_core::{DType, Device, Tensor};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::Result;

/// The purpose of a stream of random numbers. The number is a word of the generator's key, and does not change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub enum Stream {
    /// Initial weights.
    Init = 1,
    /// The rays of a training step.
    Batches = 2,
    /// Sample jitter, inverse-CDF positions and density noise of the clean pass.
    Jitter = 3,
    /// Random starts of PGD, random deltas, and the second clean pass.
    Search = 4,
    /// The same for diagnostics at log steps, which must not change the search's numbers.
    Diagnostics = 5,
    /// Corruption of training images and poses.
    Corruption = 6,
    /// Cells of explicit regularizers, and points in them.
    Regularizer = 7,
    /// Points on meshes that are compared.
    Surface = 8,
    /// Starts of marched rays, and their steps.
    March = 9,
    /// Codes for decoders.
    Code = 10,
    /// Choices among a scene's views.
    Views = 12,
    /// Random displacements of weights.
    Sharpness = 13,
    /// Rays of cameras without photographs, with the random numbers of their passes.
    Unseen = 14,
    /// Which ray gets which ray's deltas.
    Permutation = 15,
    /// Built-in scenes by seed.
    Scene = 16,
    /// Rays to known points, with the random numbers of their passes.
    Points = 17,
    /// Points in cells of empty space, and starts of PGD, on the page of a run.
    View = 18,
    /// Points of a sweep that are trained again.
    Retrain = 19,
    /// Cells that a look at occupancy asks about, and points in them.
    Occupancy = 20,
}

/// A generator at the start of one (seed, stream, index).
pub struct Random {
    chacha: ChaCha8Rng,
}

impl Random {
    /// Creates the generator of `stream` at `index` under `seed`.
    pub fn new(seed: u64, stream: Stream, index: u64) -> Random {
        Random::part(seed, stream, index, 0)
    }

    /// Creates the generator of one part of `stream` at `index`, such as a chunk of rays.
    pub fn part(seed: u64, stream: Stream, index: u64, part: u64) -> Random {
        let mut key = [0u8; 32];
        key[..8].copy_from_slice(&seed.to_le_bytes());
        key[8..16].copy_from_slice(&(stream as u64).to_le_bytes());
        key[16..24].copy_from_slice(&index.to_le_bytes());
        key[24..].copy_from_slice(&part.to_le_bytes());
        Random { chacha: ChaCha8Rng::from_seed(key) }
    }

    /// Returns a uniform number in 0..1 (24 bits, exact in f32).
    pub fn uniform(&mut self) -> f64 {
        f64::from(self.chacha.next_u32() >> 8) * (1.0 / f64::from(1u32 << 24))
    }

    /// Returns a pair of standard normal numbers (Box-Muller).
    pub fn normal_pair(&mut self) -> (f64, f64) {
        // 1 - u is in (0, 1], where the logarithm is finite.
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        let (sin, cos) = (std::f64::consts::TAU * self.uniform()).sin_cos();
        (radius * cos, radius * sin)
    }

    /// Returns a Poisson number of moderate mean (below 700), by inversion.
    pub fn poisson(&mut self, mean: f64) -> u32 {
        // 48 bits. With fewer, counts far below the mean would come too often.
        let u = self.uniform() + self.uniform() / f64::from(1u32 << 24);
        let (mut count, mut probability) = (0, (-mean).exp());
        let mut below = probability;
        // Once the terms have run out, only rounding keeps the sum below u.
        while u >= below && probability > f64::MIN_POSITIVE {
            count += 1;
            probability *= mean / f64::from(count);
            below += probability;
        }
        count
    }

    /// Returns a uniform integer in 0..bound, without bias (multiply and reject).
    pub fn below(&mut self, bound: u32) -> u32 {
        debug_assert!(bound > 0);
        let threshold = bound.wrapping_neg() % bound;
        loop {
            let product = u64::from(self.chacha.next_u32()) * u64::from(bound);
            if product as u32 >= threshold {
                return (product >> 32) as u32;
            }
        }
    }

    /// Returns `count` distinct integers of 0..bound in random order (partial Fisher-Yates).
    pub fn distinct(&mut self, count: usize, bound: u32) -> Vec<u32> {
        // For a few of many, only the differences from 0..bound are stored.
        if count < bound as usize / 8 { self.distinct_few(count, bound) } else { self.distinct_many(count, bound) }
    }

    fn distinct_many(&mut self, count: usize, bound: u32) -> Vec<u32> {
        let mut pool: Vec<u32> = (0..bound).collect();
        let count = count.min(pool.len());
        for i in 0..count {
            let j = i + self.below(bound - i as u32) as usize;
            pool.swap(i, j);
        }
        pool.truncate(count);
        pool
    }

    fn distinct_few(&mut self, count: usize, bound: u32) -> Vec<u32> {
        let mut moved: HashMap<u32, u32> = HashMap::with_capacity(2 * count);
        let mut drawn = Vec::with_capacity(count);
        for i in 0..count as u32 {
            let j = i + self.below(bound - i);
            let displaced = moved.get(&i).copied().unwrap_or(i);
            // Entry i is never read again.
            drawn.push(if j == i { displaced } else { moved.insert(j, displaced).unwrap_or(j) });
        }
        drawn
    }

    /// Returns `count` uniform numbers in 0..1, as [`Random::uniform`] draws them.
    pub fn uniform_values(&mut self, count: usize) -> Vec<f32> {
        self.uniform_map(count, |unit| unit)
    }

    /// Returns `map` of `count` uniform numbers in 0..1.
    pub fn uniform_map(&mut self, count: usize, map: impl Fn(f32) -> f32) -> Vec<f32> {
        let mut bytes = [0u8; 1024];
        let mut values = Vec::with_capacity(count);
        while values.len() < count {
            let bytes = &mut bytes[..1024.min(4 * (count - values.len()))];
            self.chacha.fill_bytes(bytes);
            let words = bytes.as_chunks::<4>().0.iter().map(|bytes| u32::from_le_bytes(*bytes) >> 8);
            values.extend(words.map(|word| map(word as f32 * (1.0 / (1u32 << 24) as f32))));
        }
        values
    }

    /// Returns `count` standard normal numbers, drawn in pairs.
    pub fn normal_values(&mut self, count: usize) -> Vec<f32> {
        let mut values = Vec::with_capacity(count + 1);
        while values.len() < count {
            let (a, b) = self.normal_pair();
            values.extend([a as f32, b as f32]);
        }
        values.truncate(count);
        values
    }

    /// Returns a tensor of uniform numbers in 0..1.
    pub fn uniform_tensor(&mut self, shape: &[usize], dtype: DType, device: &Device) -> Result<Tensor> {
        let values = self.uniform_values(shape.iter().product());
        Ok(Tensor::from_vec(values, shape, device)?.to_dtype(dtype)?)
    }

    /// Returns a tensor of standard normal numbers.
    pub fn normal_tensor(&mut self, shape: &[usize], dtype: DType, device: &Device) -> Result<Tensor> {
        let values = self.normal_values(shape.iter().product());
        Ok(Tensor::from_vec(values, shape, device)?.to_dtype(dtype)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_and_indices_are_independent_and_repeat() {
        let first = |stream, index| Random::new(7, stream, index).uniform();
        assert_eq!(first(Stream::Jitter, 3), first(Stream::Jitter, 3));
        assert_ne!(first(Stream::Jitter, 3), first(Stream::Jitter, 4));
        assert_ne!(first(Stream::Jitter, 3), first(Stream::Search, 3));
    }

    /// Numbers that are drawn many at once are those that are drawn one by one, whatever came before.
    #[test]
    fn blocks_of_numbers_are_the_numbers_one_by_one() {
        for (before, count) in [(0, 1), (3, 255), (1, 256), (7, 1000)] {
            let (mut blocks, mut single) = (Random::new(1, Stream::Jitter, 2), Random::new(1, Stream::Jitter, 2));
            (0..before).for_each(|_| assert_eq!(blocks.uniform(), single.uniform()));
            let expected: Vec<f32> = (0..count).map(|_| single.uniform() as f32).collect();
            assert_eq!(blocks.uniform_values(count), expected);
            assert_eq!(blocks.uniform(), single.uniform());
        }
    }

    #[test]
    fn moments_are_those_of_the_distributions() {
        let mut random = Random::new(0, Stream::Init, 0);
        let n = 200_000;
        let uniform: Vec<f64> = (0..n).map(|_| random.uniform()).collect();
        let normal: Vec<f64> = (0..n / 2).map(|_| random.normal_pair()).flat_map(|(a, b)| [a, b]).collect();
        let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
        let var = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>() / v.len() as f64 - mean(v).powi(2);
        // Five standard errors.
        assert!((mean(&uniform) - 0.5).abs() < 5.0 * (1.0 / 12.0 / n as f64).sqrt());
        assert!((var(&uniform) - 1.0 / 12.0).abs() < 1e-3);
        assert!(mean(&normal).abs() < 5.0 / (n as f64).sqrt());
        assert!((var(&normal) - 1.0).abs() < 5.0 * (2.0 / n as f64).sqrt());
    }

    #[test]
    fn distinct_is_a_permutation_and_reaches_every_value_equally() {
        let mut counts = [0u32; 5];
        for index in 0..5000 {
            let drawn = Random::new(1, Stream::Batches, index).distinct(2, 5);
            assert_ne!(drawn[0], drawn[1]);
            drawn.iter().for_each(|&d| counts[d as usize] += 1);
        }
        // 2000 expected, standard deviation about 35.
        assert!(counts.iter().all(|c| c.abs_diff(2000) < 200), "{counts:?}");
        for (count, bound) in [(1, 1), (10, 10), (40, 50), (50, 4000)] {
            let [few, many] = [Random::distinct_few, Random::distinct_many]
                .map(|draw| draw(&mut Random::new(3, Stream::Batches, 0), count, bound));
            assert_eq!(few, many, "{count} of {bound}");
        }
        let mut all = Random::new(1, Stream::Batches, 0).distinct(100, 100);
        all.sort_unstable();
        assert_eq!(all, (0..100).collect::<Vec<u32>>());
    }
}
