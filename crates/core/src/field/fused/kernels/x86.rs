//! Vectors of x86-64: AVX-512, with its instructions for bf16 or without, and AVX2.

use std::arch::x86_64::*;

use super::simd::{LANES, Simd};

/// AVX-512 (F, BW, DQ, VL). With `PAIRS`, also its instructions for bf16.
pub struct Avx512<const PAIRS: bool>;

// SAFETY: kernels run on it only where the CPU has AVX-512, with or without BF16 (see `super::Backend`).
unsafe impl<const PAIRS: bool> Simd for Avx512<PAIRS> {
    type V = __m512;
    const PAIRS: bool = PAIRS;
    const WIDE: bool = true;

    #[inline(always)]
    unsafe fn splat(value: f32) -> __m512 {
        // SAFETY: as the trait demands; the same goes for all that follow.
        unsafe { _mm512_set1_ps(value) }
    }

    #[inline(always)]
    unsafe fn load(from: *const f32) -> __m512 {
        unsafe { _mm512_loadu_ps(from) }
    }

    #[inline(always)]
    unsafe fn store(to: *mut f32, v: __m512) {
        unsafe { _mm512_storeu_ps(to, v) }
    }

    #[inline(always)]
    unsafe fn load_first(from: *const f32, count: usize) -> __m512 {
        unsafe { _mm512_maskz_loadu_ps(first_bits(count), from) }
    }

    #[inline(always)]
    unsafe fn store_first(to: *mut f32, v: __m512, count: usize) {
        unsafe { _mm512_mask_storeu_ps(to, first_bits(count), v) }
    }

    #[inline(always)]
    unsafe fn add(a: __m512, b: __m512) -> __m512 {
        unsafe { _mm512_add_ps(a, b) }
    }

    #[inline(always)]
    unsafe fn mul(a: __m512, b: __m512) -> __m512 {
        unsafe { _mm512_mul_ps(a, b) }
    }

    #[inline(always)]
    unsafe fn mul_add(a: __m512, b: __m512, c: __m512) -> __m512 {
        unsafe { _mm512_fmadd_ps(a, b, c) }
    }

    #[inline(always)]
    unsafe fn relu(v: __m512) -> __m512 {
        // The second operand is the result if either is NaN or both are 0.
        unsafe { _mm512_max_ps(_mm512_setzero_ps(), v) }
    }

    #[inline(always)]
    unsafe fn positive(v: __m512) -> u16 {
        unsafe { _mm512_cmp_ps_mask::<_CMP_GT_OQ>(v, _mm512_setzero_ps()) }
    }

    #[inline(always)]
    unsafe fn keep(v: __m512, bits: u16) -> __m512 {
        unsafe { _mm512_maskz_mov_ps(bits, v) }
    }

    #[inline(always)]
    unsafe fn dot_pairs(a: __m512, b: __m512, c: __m512) -> __m512 {
        // SAFETY: the types have the same size and no invalid bits.
        unsafe {
            _mm512_dpbf16_ps(c, std::mem::transmute::<__m512, __m512bh>(a), std::mem::transmute::<__m512, __m512bh>(b))
        }
    }

    #[inline(always)]
    unsafe fn store_rounded(to: *mut f32, v: __m512) {
        // SAFETY: the types have the same size and no invalid bits.
        unsafe {
            let rounded = std::mem::transmute::<__m256bh, __m256i>(_mm512_cvtneps_pbh(v));
            _mm256_storeu_si256(to.cast(), rounded);
        }
    }

    #[inline(always)]
    unsafe fn pair(a: __m512, b: __m512) -> __m512 {
        const ORDER: [u16; 32] = {
            let mut order = [0; 32];
            let mut i = 0;
            while i < LANES {
                order[2 * i] = i as u16;
                order[2 * i + 1] = (LANES + i) as u16;
                i += 1;
            }
            order
        };
        // SAFETY: the types have the same size and no invalid bits.
        unsafe {
            let both = std::mem::transmute::<__m512bh, __m512i>(_mm512_cvtne2ps_pbh(b, a));
            let order = _mm512_loadu_si512(ORDER.as_ptr().cast());
            _mm512_castsi512_ps(_mm512_permutexvar_epi16(order, both))
        }
    }

    #[inline(always)]
    unsafe fn first(v: __m512) -> __m512 {
        unsafe { _mm512_castsi512_ps(_mm512_slli_epi32::<16>(_mm512_castps_si512(v))) }
    }

    #[inline(always)]
    unsafe fn second(v: __m512) -> __m512 {
        unsafe {
            _mm512_castsi512_ps(_mm512_and_si512(_mm512_castps_si512(v), _mm512_set1_epi32(0xffff_0000_u32 as i32)))
        }
    }

    #[inline(always)]
    unsafe fn sums(vectors: &[__m512; LANES]) -> __m512 {
        unsafe {
            let columns = transposed(vectors);
            let mut sum = columns[0];
            for column in &columns[1..] {
                sum = _mm512_add_ps(sum, *column);
            }
            sum
        }
    }
}

/// Transposes in blocks of four by four, then the blocks.
#[inline(always)]
unsafe fn transposed(rows: &[__m512; LANES]) -> [__m512; LANES] {
    let mut out = *rows;
    // SAFETY: callers have AVX-512.
    unsafe {
        for four in out.as_chunks_mut::<4>().0 {
            let [a, b, c, d] = *four;
            let (low, high) = (_mm512_unpacklo_ps(a, b), _mm512_unpackhi_ps(a, b));
            let (low2, high2) = (_mm512_unpacklo_ps(c, d), _mm512_unpackhi_ps(c, d));
            four[0] = _mm512_shuffle_ps::<0b01_00_01_00>(low, low2);
            four[1] = _mm512_shuffle_ps::<0b11_10_11_10>(low, low2);
            four[2] = _mm512_shuffle_ps::<0b01_00_01_00>(high, high2);
            four[3] = _mm512_shuffle_ps::<0b11_10_11_10>(high, high2);
        }
        for i in 0..4 {
            let [a, b, c, d] = [out[i], out[4 + i], out[8 + i], out[12 + i]];
            let (even, odd) =
                (_mm512_shuffle_f32x4::<0b10_00_10_00>(a, b), _mm512_shuffle_f32x4::<0b11_01_11_01>(a, b));
            let (even2, odd2) =
                (_mm512_shuffle_f32x4::<0b10_00_10_00>(c, d), _mm512_shuffle_f32x4::<0b11_01_11_01>(c, d));
            out[i] = _mm512_shuffle_f32x4::<0b10_00_10_00>(even, even2);
            out[8 + i] = _mm512_shuffle_f32x4::<0b11_01_11_01>(even, even2);
            out[4 + i] = _mm512_shuffle_f32x4::<0b10_00_10_00>(odd, odd2);
            out[12 + i] = _mm512_shuffle_f32x4::<0b11_01_11_01>(odd, odd2);
        }
    }
    out
}

#[inline(always)]
fn first_bits(count: usize) -> u16 {
    ((1u32 << count) - 1) as u16
}

/// AVX2 and FMA.
pub struct Avx2;

type Halves = [__m256; 2];

/// Applies an operation to both halves. (A closure would not have the instructions.)
macro_rules! both {
    ($i:ident => $of_half:expr) => {{
        let [$i, other] = [0, 1];
        let low = $of_half;
        let $i = other;
        [low, $of_half]
    }};
}

#[inline(always)]
unsafe fn bits(v: __m256) -> __m256i {
    // SAFETY: callers have AVX2; the same goes for all that follow.
    unsafe { _mm256_castps_si256(v) }
}

/// Sets all bits where the number is subnormal or 0.
#[inline(always)]
unsafe fn tiny(v: __m256) -> __m256 {
    unsafe {
        let magnitude = _mm256_andnot_ps(_mm256_set1_ps(-0.0), v);
        _mm256_cmp_ps::<_CMP_LT_OQ>(magnitude, _mm256_set1_ps(f32::MIN_POSITIVE))
    }
}

/// Returns 0, with the sign, for subnormal numbers.
#[inline(always)]
unsafe fn flushed(v: __m256) -> __m256 {
    unsafe { _mm256_blendv_ps(v, _mm256_and_ps(v, _mm256_set1_ps(-0.0)), tiny(v)) }
}

/// Returns the nearest bf16 in the low half of each word (see [`super::simd::round`]).
#[inline(always)]
unsafe fn rounded(v: __m256) -> __m256i {
    unsafe {
        let u = bits(v);
        let odd = _mm256_and_si256(_mm256_srli_epi32::<16>(u), _mm256_set1_epi32(1));
        let up = _mm256_add_epi32(u, _mm256_add_epi32(odd, _mm256_set1_epi32(0x7fff)));
        let quiet = _mm256_or_si256(u, _mm256_set1_epi32(0x40_0000));
        let zero = _mm256_and_ps(v, _mm256_set1_ps(-0.0));
        let normal = _mm256_blendv_ps(_mm256_castsi256_ps(up), zero, tiny(v));
        let nan = _mm256_cmp_ps::<_CMP_UNORD_Q>(v, v);
        _mm256_srli_epi32::<16>(bits(_mm256_blendv_ps(normal, _mm256_castsi256_ps(quiet), nan)))
    }
}

// SAFETY: kernels run on it only where the CPU has AVX2 and FMA (see `super::Backend`).
unsafe impl Simd for Avx2 {
    type V = Halves;
    const PAIRS: bool = true;
    const WIDE: bool = false;

    #[inline(always)]
    unsafe fn splat(value: f32) -> Halves {
        // SAFETY: as the trait demands; the same goes for all that follow.
        unsafe { [_mm256_set1_ps(value); 2] }
    }

    #[inline(always)]
    unsafe fn load(from: *const f32) -> Halves {
        unsafe { [_mm256_loadu_ps(from), _mm256_loadu_ps(from.add(8))] }
    }

    #[inline(always)]
    unsafe fn store(to: *mut f32, v: Halves) {
        unsafe {
            _mm256_storeu_ps(to, v[0]);
            _mm256_storeu_ps(to.add(8), v[1]);
        }
    }

    #[inline(always)]
    unsafe fn load_first(from: *const f32, count: usize) -> Halves {
        unsafe {
            let mut values = [0f32; LANES];
            from.copy_to_nonoverlapping(values.as_mut_ptr(), count);
            Self::load(values.as_ptr())
        }
    }

    #[inline(always)]
    unsafe fn store_first(to: *mut f32, v: Halves, count: usize) {
        unsafe {
            let mut values = [0f32; LANES];
            Self::store(values.as_mut_ptr(), v);
            values.as_ptr().copy_to_nonoverlapping(to, count);
        }
    }

    #[inline(always)]
    unsafe fn add(a: Halves, b: Halves) -> Halves {
        unsafe { both!(i => _mm256_add_ps(a[i], b[i])) }
    }

    #[inline(always)]
    unsafe fn mul(a: Halves, b: Halves) -> Halves {
        unsafe { both!(i => _mm256_mul_ps(a[i], b[i])) }
    }

    #[inline(always)]
    unsafe fn mul_add(a: Halves, b: Halves, c: Halves) -> Halves {
        unsafe { both!(i => _mm256_fmadd_ps(a[i], b[i], c[i])) }
    }

    #[inline(always)]
    unsafe fn relu(v: Halves) -> Halves {
        // The second operand is the result if either is NaN or both are 0.
        unsafe { both!(i => _mm256_max_ps(_mm256_setzero_ps(), v[i])) }
    }

    #[inline(always)]
    unsafe fn positive(v: Halves) -> u16 {
        unsafe {
            let [low, high] =
                both!(i => _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_GT_OQ>(v[i], _mm256_setzero_ps())) as u16);
            low | high << 8
        }
    }

    #[inline(always)]
    unsafe fn keep(v: Halves, kept: u16) -> Halves {
        unsafe {
            let lanes = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
            both!(i => {
                let set = _mm256_and_si256(_mm256_set1_epi32(i32::from(kept >> (8 * i))), lanes);
                _mm256_and_ps(v[i], _mm256_castsi256_ps(_mm256_cmpeq_epi32(set, lanes)))
            })
        }
    }

    #[inline(always)]
    unsafe fn dot_pairs(a: Halves, b: Halves, c: Halves) -> Halves {
        unsafe {
            let ([a_first, a_second], [b_first, b_second]) =
                ([Self::first(a), Self::second(a)], [Self::first(b), Self::second(b)]);
            both!(i => {
                let half = flushed(_mm256_fmadd_ps(a_second[i], b_second[i], c[i]));
                flushed(_mm256_fmadd_ps(a_first[i], b_first[i], half))
            })
        }
    }

    #[inline(always)]
    unsafe fn store_rounded(to: *mut f32, v: Halves) {
        unsafe {
            // Packing works within halves of 128 bits.
            let packed = _mm256_packus_epi32(rounded(v[0]), rounded(v[1]));
            _mm256_storeu_si256(to.cast(), _mm256_permute4x64_epi64::<0b11_01_10_00>(packed));
        }
    }

    #[inline(always)]
    unsafe fn pair(a: Halves, b: Halves) -> Halves {
        unsafe {
            both!(i => {
                let words = _mm256_or_si256(rounded(a[i]), _mm256_slli_epi32::<16>(rounded(b[i])));
                _mm256_castsi256_ps(words)
            })
        }
    }

    #[inline(always)]
    unsafe fn first(v: Halves) -> Halves {
        unsafe { both!(i => _mm256_castsi256_ps(_mm256_slli_epi32::<16>(bits(v[i])))) }
    }

    #[inline(always)]
    unsafe fn second(v: Halves) -> Halves {
        unsafe { both!(i => _mm256_and_ps(v[i], _mm256_castsi256_ps(_mm256_set1_epi32(0xffff_0000_u32 as i32)))) }
    }
    #[inline(always)]
    unsafe fn sums(vectors: &[Halves; LANES]) -> Halves {
        let mut sums = [0f32; LANES];
        for (sum, vector) in sums.iter_mut().zip(vectors) {
            let mut numbers = [0f32; LANES];
            unsafe { Self::store(numbers.as_mut_ptr(), *vector) };
            *sum = numbers.iter().sum();
        }
        unsafe { Self::load(sums.as_ptr()) }
    }
}
