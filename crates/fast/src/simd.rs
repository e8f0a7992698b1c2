//! Vectors of sixteen numbers in the widest instructions of the CPU, chosen at run time. The bits of all results are
//! the same on every CPU.

#[cfg(target_arch = "x86_64")]
use x86::{Avx2, Avx512};

#[cfg(target_arch = "x86_64")]
mod x86;

/// Numbers in a vector.
pub const LANES: usize = 16;

/// One number per lane, in memory.
pub(crate) type Lanes = [f32; LANES];

/// Calls `work` once, compiled for the widest instructions of this CPU. `work` and everything that it calls must be
/// `#[inline(always)]`.
pub fn vectorized(work: impl FnMut()) {
    Processor::here().run(Work(work));
}

/// A closure with a type of its own. A bare closure is called through `FnOnce::call_once`, which the compiler shares
/// between instruction sets instead of inlining it. Its loops would be compiled for the smallest set.
struct Work<F>(F);

impl<F: FnMut()> Kernel for Work<F> {
    #[inline(always)]
    fn run<S: Simd>(mut self, _: S) {
        (self.0)();
    }
}

/// Work on vectors.
pub(crate) trait Kernel {
    /// Does the work. Implementations and all that they call, closures too, are `#[inline(always)]`, to be compiled with
    /// their caller's instructions.
    fn run<S: Simd>(self, simd: S);
}

/// The instructions of a CPU. It exists only on a CPU that has them.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Processor {
    /// AVX-512 with BF16.
    #[cfg(target_arch = "x86_64")]
    Bf16(Avx512<true>),
    /// AVX-512.
    #[cfg(target_arch = "x86_64")]
    Wide(Avx512<false>),
    /// AVX2 and FMA.
    #[cfg(target_arch = "x86_64")]
    Narrow(Avx2),
    /// Everything for which the program was compiled.
    Any,
}

impl Processor {
    /// Returns the fastest kind of this machine.
    pub fn here() -> Processor {
        #[cfg(test)]
        if let Some(chosen) = tests::CHOSEN.get() {
            return chosen;
        }
        Processor::all().next().unwrap_or(Processor::Any)
    }

    /// Iterates over all kinds of this machine, fastest first.
    pub fn all() -> impl Iterator<Item = Processor> {
        #[cfg(target_arch = "x86_64")]
        let fast = [
            Avx512::<true>::here().map(Processor::Bf16),
            Avx512::<false>::here().map(Processor::Wide),
            Avx2::here().map(Processor::Narrow),
        ];
        #[cfg(not(target_arch = "x86_64"))]
        let fast: [Option<Processor>; 0] = [];
        fast.into_iter().flatten().chain([Processor::Any])
    }

    /// Runs a kernel without pairs of bf16.
    pub fn run(self, kernel: impl Kernel) {
        match self {
            #[cfg(target_arch = "x86_64")]
            Processor::Bf16(avx512) => avx512.without_bf16().run(kernel),
            #[cfg(target_arch = "x86_64")]
            Processor::Wide(avx512) => avx512.run(kernel),
            #[cfg(target_arch = "x86_64")]
            Processor::Narrow(avx2) => avx2.run(kernel),
            Processor::Any => kernel.run(Plain),
        }
    }

    /// Runs a kernel that may use pairs of bf16.
    pub fn run_pairs(self, kernel: impl Kernel) {
        match self {
            #[cfg(target_arch = "x86_64")]
            Processor::Bf16(avx512) => avx512.run(kernel),
            other => other.run(kernel),
        }
    }
}

/// Operations on [`LANES`] numbers. Each is rounded once, lane by lane, in all implementations.
pub(crate) trait Simd: Copy {
    /// Numbers of f32, or as many pairs of bf16: words whose low half is the first.
    type Floats: Copy;
    /// Whole numbers modulo 2^32.
    type Ints: Copy;
    /// Whether there are registers for 24 sums or more.
    const WIDE: bool;

    fn splat(self, value: f32) -> Self::Floats;
    fn load(self, values: &Lanes) -> Self::Floats;
    fn store(self, v: Self::Floats) -> Lanes;
    fn add(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;
    fn sub(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;
    fn mul(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;
    /// Returns `a b + c`, rounded once.
    fn mul_add(self, a: Self::Floats, b: Self::Floats, c: Self::Floats) -> Self::Floats;
    /// Returns `c - a b`, rounded once.
    fn neg_mul_add(self, a: Self::Floats, b: Self::Floats, c: Self::Floats) -> Self::Floats;
    /// Returns 0 for negative numbers; NaN stays NaN.
    fn relu(self, v: Self::Floats) -> Self::Floats;
    /// Returns a bit for each positive number.
    fn positive(self, v: Self::Floats) -> u16;
    /// Sets numbers without their bit to 0.
    fn keep(self, v: Self::Floats, bits: u16) -> Self::Floats;
    /// Returns 0, with the sign, for subnormal numbers.
    fn flushed(self, v: Self::Floats) -> Self::Floats;
    /// Returns the first of each pair of bf16.
    fn first(self, v: Self::Floats) -> Self::Floats;
    /// Returns the second of each pair of bf16.
    fn second(self, v: Self::Floats) -> Self::Floats;
    /// Returns neighbours as pairs of bf16, rounded to the nearest, ties to even. Subnormals become 0.
    fn rounded(self, v: Self::Floats) -> [f32; LANES / 2];
    /// Returns each number of `a` with that of `b` as a pair of bf16, rounded in the same way.
    fn pair(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;
    /// Returns `values` rounded down, at least 0 and at most `last`, which is below 2^31, and 0 for NaN. Also returns
    /// the same as floats.
    fn floor_within(self, values: Self::Floats, last: Self::Floats) -> (Self::Ints, Self::Floats);
    fn splat_ints(self, value: u32) -> Self::Ints;
    fn store_ints(self, v: Self::Ints) -> [u32; LANES];
    fn add_ints(self, a: Self::Ints, b: Self::Ints) -> Self::Ints;
    fn mul_ints(self, a: Self::Ints, b: Self::Ints) -> Self::Ints;
    fn xor(self, a: Self::Ints, b: Self::Ints) -> Self::Ints;
    fn and(self, a: Self::Ints, b: Self::Ints) -> Self::Ints;

    /// Loads at most [`LANES`] numbers; the others are 0.
    #[inline(always)]
    fn load_first(self, values: &[f32]) -> Self::Floats {
        let mut lanes = [0.0; LANES];
        lanes[..values.len()].copy_from_slice(values);
        self.load(&lanes)
    }

    /// Stores as many of the first numbers as there is room for, at most [`LANES`].
    #[inline(always)]
    fn store_first(self, to: &mut [f32], v: Self::Floats) {
        to.copy_from_slice(&self.store(v)[..to.len()]);
    }

    /// Returns c plus the products of pairs of bf16: two fused multiply-adds, the second of each pair first. Subnormal
    /// results are 0.
    #[inline(always)]
    fn dot_pairs(self, a: Self::Floats, b: Self::Floats, c: Self::Floats) -> Self::Floats {
        dot_pairs(self, a, b, c)
    }

    /// Returns the rows of a table at `indices`, column by column.
    ///
    /// # Safety
    /// Every index must be within the table.
    #[inline(always)]
    unsafe fn gather<const W: usize>(self, table: &[[f32; W]], indices: Self::Ints) -> [Self::Floats; W] {
        gather(self, table, indices)
    }
}

#[inline(always)]
fn dot_pairs<S: Simd>(simd: S, a: S::Floats, b: S::Floats, c: S::Floats) -> S::Floats {
    let half = simd.flushed(simd.mul_add(simd.second(a), simd.second(b), c));
    simd.flushed(simd.mul_add(simd.first(a), simd.first(b), half))
}

#[inline(always)]
fn gather<const W: usize, S: Simd>(simd: S, table: &[[f32; W]], indices: S::Ints) -> [S::Floats; W] {
    let mut columns = [[0.0; LANES]; W];
    for (i, index) in simd.store_ints(indices).into_iter().enumerate() {
        for (column, value) in columns.iter_mut().zip(&table[index as usize]) {
            column[i] = *value;
        }
    }
    let mut features = [simd.splat(0.0); W];
    for (feature, column) in features.iter_mut().zip(&columns) {
        *feature = simd.load(column);
    }
    features
}

/// Returns the nearest bf16, ties to even, as the low half of a word. Subnormals become 0.
#[inline(always)]
pub(crate) fn round(value: f32) -> u32 {
    let bits = value.to_bits();
    let rounded = bits.wrapping_add(0x7fff + ((bits >> 16) & 1)) >> 16;
    let (quiet, zero) = ((bits >> 16) | 0x40, (bits >> 16) & 0x8000);
    let magnitude = bits & 0x7fff_ffff;
    let normal = if magnitude < 0x0080_0000 { zero } else { rounded };
    if magnitude > 0x7f80_0000 { quiet } else { normal }
}

/// Returns two numbers as a word of bf16.
#[inline(always)]
pub(crate) fn word(first: f32, second: f32) -> f32 {
    f32::from_bits(round(first) | round(second) << 16)
}

/// Plain loops, for any CPU.
#[derive(Clone, Copy)]
struct Plain;

#[inline(always)]
fn each<T: Copy + Default, const N: usize>(value: impl Fn(usize) -> T) -> [T; N] {
    let mut values = [T::default(); N];
    for (i, lane) in values.iter_mut().enumerate() {
        *lane = value(i);
    }
    values
}

#[rustfmt::skip]
impl Simd for Plain {
    type Floats = Lanes;
    type Ints = [u32; LANES];
    const WIDE: bool = false;

    #[inline(always)]
    fn splat(self, value: f32) -> Lanes { [value; LANES] }
    #[inline(always)]
    fn load(self, values: &Lanes) -> Lanes { *values }
    #[inline(always)]
    fn store(self, v: Lanes) -> Lanes { v }
    #[inline(always)]
    fn add(self, a: Lanes, b: Lanes) -> Lanes { each(|i| a[i] + b[i]) }
    #[inline(always)]
    fn sub(self, a: Lanes, b: Lanes) -> Lanes { each(|i| a[i] - b[i]) }
    #[inline(always)]
    fn mul(self, a: Lanes, b: Lanes) -> Lanes { each(|i| a[i] * b[i]) }
    #[inline(always)]
    fn mul_add(self, a: Lanes, b: Lanes, c: Lanes) -> Lanes { each(|i| a[i].mul_add(b[i], c[i])) }
    #[inline(always)]
    fn neg_mul_add(self, a: Lanes, b: Lanes, c: Lanes) -> Lanes { each(|i| (-a[i]).mul_add(b[i], c[i])) }
    #[inline(always)]
    fn relu(self, v: Lanes) -> Lanes { each(|i| if v[i] < 0.0 { 0.0 } else { v[i] }) }
    #[inline(always)]
    fn positive(self, v: Lanes) -> u16 {
        v.iter().enumerate().fold(0, |bits, (i, v)| bits | u16::from(*v > 0.0) << i)
    }
    #[inline(always)]
    fn keep(self, v: Lanes, bits: u16) -> Lanes { each(|i| if bits >> i & 1 == 1 { v[i] } else { 0.0 }) }
    #[inline(always)]
    fn flushed(self, v: Lanes) -> Lanes {
        each(|i| if v[i].abs() < f32::MIN_POSITIVE { 0f32.copysign(v[i]) } else { v[i] })
    }
    #[inline(always)]
    fn first(self, v: Lanes) -> Lanes { each(|i| f32::from_bits(v[i].to_bits() << 16)) }
    #[inline(always)]
    fn second(self, v: Lanes) -> Lanes { each(|i| f32::from_bits(v[i].to_bits() & 0xffff_0000)) }
    #[inline(always)]
    fn rounded(self, v: Lanes) -> [f32; LANES / 2] { each(|i| word(v[2 * i], v[2 * i + 1])) }
    #[inline(always)]
    fn pair(self, a: Lanes, b: Lanes) -> Lanes { each(|i| word(a[i], b[i])) }
    #[inline(always)]
    fn floor_within(self, values: Lanes, last: Lanes) -> ([u32; LANES], Lanes) {
        // NaN is greater than nothing.
        let floor = each(|i| (if values[i] > 0.0 { values[i] } else { 0.0 }).min(last[i]) as i32 as u32);
        (floor, each(|i| floor[i] as i32 as f32))
    }
    #[inline(always)]
    fn splat_ints(self, value: u32) -> [u32; LANES] { [value; LANES] }
    #[inline(always)]
    fn store_ints(self, v: [u32; LANES]) -> [u32; LANES] { v }
    #[inline(always)]
    fn add_ints(self, a: [u32; LANES], b: [u32; LANES]) -> [u32; LANES] { each(|i| a[i].wrapping_add(b[i])) }
    #[inline(always)]
    fn mul_ints(self, a: [u32; LANES], b: [u32; LANES]) -> [u32; LANES] { each(|i| a[i].wrapping_mul(b[i])) }
    #[inline(always)]
    fn xor(self, a: [u32; LANES], b: [u32; LANES]) -> [u32; LANES] { each(|i| a[i] ^ b[i]) }
    #[inline(always)]
    fn and(self, a: [u32; LANES], b: [u32; LANES]) -> [u32; LANES] { each(|i| a[i] & b[i]) }
}

#[cfg(test)]
pub(crate) mod tests {
    use std::cell::Cell;

    use candle_core::{DType, Device, Tensor};

    use super::*;

    thread_local! {
        /// Runs kernels, instead of the fastest.
        pub(super) static CHOSEN: Cell<Option<Processor>> = const { Cell::new(None) };
    }

    /// Calls `work` with each kind of this machine in turn for the kernels of this thread.
    pub(crate) fn on_each<T>(work: impl Fn() -> T) -> Vec<(Processor, T)> {
        let run = |processor| {
            CHOSEN.set(Some(processor));
            let found = work();
            CHOSEN.set(None);
            (processor, found)
        };
        Processor::all().map(run).collect()
    }

    /// Against candle's conversion, which keeps subnormals.
    #[test]
    fn bf16_is_the_nearest() {
        let values: Vec<f32> = (0..u32::MAX).step_by(4099).map(f32::from_bits).filter(|v| !v.is_nan()).collect();
        let expected = Tensor::new(&*values, &Device::Cpu).unwrap().to_dtype(DType::BF16).unwrap();
        let expected = expected.to_dtype(DType::F32).unwrap().to_vec1::<f32>().unwrap();
        for (value, expected) in values.into_iter().zip(expected) {
            let expected = if value.is_subnormal() { 0f32.copysign(value) } else { expected };
            assert_eq!(round(value) << 16, expected.to_bits(), "{value:e}");
        }
        assert!(f32::from_bits(round(f32::NAN) << 16).is_nan());
    }
}
