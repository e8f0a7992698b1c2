//! Vectors of sixteen numbers, and their portable form, whose bits all implementations have.

/// Numbers in a vector.
pub const LANES: usize = 16;

/// Vectors of [`LANES`] f32, or as many pairs of bf16: words whose low half is the first of two neighbours.
///
/// Every implementation gives the same bits. Multiplications and additions are rounded once each, or once together if
/// they are fused. Sums are in the kernels' order.
///
/// # Safety
/// The CPU must have the implementation's instructions, and pointers must be readable or writable.
pub unsafe trait Simd {
    type V: Copy;
    /// Whether it has pairs of bf16.
    const PAIRS: bool;
    /// Whether it has registers for 24 sums or more.
    const WIDE: bool;

    unsafe fn splat(value: f32) -> Self::V;
    unsafe fn load(from: *const f32) -> Self::V;
    unsafe fn store(to: *mut f32, v: Self::V);
    /// Loads the first `count` numbers; the others are 0.
    unsafe fn load_first(from: *const f32, count: usize) -> Self::V;
    unsafe fn store_first(to: *mut f32, v: Self::V, count: usize);
    unsafe fn add(a: Self::V, b: Self::V) -> Self::V;
    unsafe fn mul(a: Self::V, b: Self::V) -> Self::V;
    /// Returns a b + c, rounded once.
    unsafe fn mul_add(a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    /// Returns 0 for negative numbers; NaN stays NaN.
    unsafe fn relu(v: Self::V) -> Self::V;
    /// Returns a bit for each positive number.
    unsafe fn positive(v: Self::V) -> u16;
    /// Sets numbers without their bit to 0.
    unsafe fn keep(v: Self::V, bits: u16) -> Self::V;
    /// Returns c plus the products of pairs of bf16: two fused multiply-adds, the second of each pair first. Subnormal
    /// results are 0.
    unsafe fn dot_pairs(a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    /// Stores neighbours as pairs of bf16, rounded to the nearest, ties to even. Subnormals become 0. It writes
    /// `LANES / 2` words.
    unsafe fn store_rounded(to: *mut f32, v: Self::V);
    /// Returns each number of `a` with that of `b` as a pair of bf16, rounded in the same way.
    unsafe fn pair(a: Self::V, b: Self::V) -> Self::V;
    /// Returns the first of each pair.
    unsafe fn first(v: Self::V) -> Self::V;
    /// Returns the second of each pair.
    unsafe fn second(v: Self::V) -> Self::V;
    /// Returns the sum of each vector's numbers, first to last.
    unsafe fn sums(vectors: &[Self::V; LANES]) -> Self::V;
}

/// Returns the nearest bf16, ties to even, as the low half of a word. Subnormals become 0.
#[inline(always)]
pub fn round(value: f32) -> u32 {
    let bits = value.to_bits();
    let rounded = bits.wrapping_add(0x7fff + ((bits >> 16) & 1)) >> 16;
    let (quiet, zero) = ((bits >> 16) | 0x40, (bits >> 16) & 0x8000);
    let magnitude = bits & 0x7fff_ffff;
    let normal = if magnitude < 0x0080_0000 { zero } else { rounded };
    if magnitude > 0x7f80_0000 { quiet } else { normal }
}

/// Returns two numbers as a word of bf16.
#[inline(always)]
pub fn word(first: f32, second: f32) -> f32 {
    f32::from_bits(round(first) | round(second) << 16)
}

/// Returns the two numbers of a word of bf16.
#[inline(always)]
pub fn numbers(word: f32) -> [f32; 2] {
    let bits = word.to_bits();
    [f32::from_bits(bits << 16), f32::from_bits(bits & 0xffff_0000)]
}

/// Returns 0, with the sign, for subnormal numbers.
#[inline(always)]
fn flushed(value: f32) -> f32 {
    if value.abs() < f32::MIN_POSITIVE { 0f32.copysign(value) } else { value }
}

/// An implementation for any CPU.
pub struct Portable;

#[inline(always)]
fn each(f: impl Fn(usize) -> f32) -> [f32; LANES] {
    let mut out = [0f32; LANES];
    for (i, out) in out.iter_mut().enumerate() {
        *out = f(i);
    }
    out
}

// SAFETY: no instructions beyond the target's.
unsafe impl Simd for Portable {
    type V = [f32; LANES];
    const PAIRS: bool = true;
    const WIDE: bool = false;

    #[inline(always)]
    unsafe fn splat(value: f32) -> Self::V {
        [value; LANES]
    }

    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self::V {
        // SAFETY: as the trait demands; the same goes for all that follow.
        unsafe { from.cast::<Self::V>().read_unaligned() }
    }

    #[inline(always)]
    unsafe fn store(to: *mut f32, v: Self::V) {
        unsafe { to.cast::<Self::V>().write_unaligned(v) }
    }

    #[inline(always)]
    unsafe fn load_first(from: *const f32, count: usize) -> Self::V {
        each(|i| if i < count { unsafe { *from.add(i) } } else { 0.0 })
    }

    #[inline(always)]
    unsafe fn store_first(to: *mut f32, v: Self::V, count: usize) {
        unsafe { v.as_ptr().copy_to_nonoverlapping(to, count) }
    }

    #[inline(always)]
    unsafe fn add(a: Self::V, b: Self::V) -> Self::V {
        each(|i| a[i] + b[i])
    }

    #[inline(always)]
    unsafe fn mul(a: Self::V, b: Self::V) -> Self::V {
        each(|i| a[i] * b[i])
    }

    #[inline(always)]
    unsafe fn mul_add(a: Self::V, b: Self::V, c: Self::V) -> Self::V {
        each(|i| a[i].mul_add(b[i], c[i]))
    }

    #[inline(always)]
    unsafe fn relu(v: Self::V) -> Self::V {
        each(|i| if v[i] < 0.0 { 0.0 } else { v[i] })
    }

    #[inline(always)]
    unsafe fn positive(v: Self::V) -> u16 {
        v.iter().enumerate().fold(0, |bits, (i, v)| bits | u16::from(*v > 0.0) << i)
    }

    #[inline(always)]
    unsafe fn keep(v: Self::V, bits: u16) -> Self::V {
        each(|i| if bits >> i & 1 == 1 { v[i] } else { 0.0 })
    }

    #[inline(always)]
    unsafe fn dot_pairs(a: Self::V, b: Self::V, c: Self::V) -> Self::V {
        each(|i| {
            let ([a_first, a_second], [b_first, b_second]) = (numbers(a[i]), numbers(b[i]));
            flushed(a_first.mul_add(b_first, flushed(a_second.mul_add(b_second, c[i]))))
        })
    }

    #[inline(always)]
    unsafe fn store_rounded(to: *mut f32, v: Self::V) {
        for (i, pair) in v.as_chunks::<2>().0.iter().enumerate() {
            unsafe { *to.add(i) = word(pair[0], pair[1]) };
        }
    }

    #[inline(always)]
    unsafe fn pair(a: Self::V, b: Self::V) -> Self::V {
        each(|i| word(a[i], b[i]))
    }

    #[inline(always)]
    unsafe fn first(v: Self::V) -> Self::V {
        each(|i| numbers(v[i])[0])
    }

    #[inline(always)]
    unsafe fn second(v: Self::V) -> Self::V {
        each(|i| numbers(v[i])[1])
    }

    #[inline(always)]
    unsafe fn sums(vectors: &[Self::V; LANES]) -> Self::V {
        each(|i| vectors[i].iter().sum())
    }
}
