//! Vectors of x86-64: AVX-512, with its instructions for bf16 or without, and AVX2.

use std::arch::x86_64::*;
use std::mem::transmute;

use super::{Kernel, LANES, Lanes, Simd, dot_pairs, gather};

/// AVX2 and FMA. It exists only on a CPU that has them.
#[derive(Clone, Copy, Debug)]
pub struct Avx2(());

/// AVX-512 (F, BW, DQ, VL), with its instructions for bf16 if `BF16`. It exists only on a CPU that has them.
#[derive(Clone, Copy, Debug)]
pub struct Avx512<const BF16: bool>(());

impl Avx2 {
    pub fn here() -> Option<Avx2> {
        (is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")).then_some(Avx2(()))
    }

    pub fn run(self, kernel: impl Kernel) {
        #[target_feature(enable = "avx2,fma")]
        fn run(simd: Avx2, kernel: impl Kernel) {
            kernel.run(simd);
        }
        // SAFETY: the CPU has the features, as there is an `Avx2`.
        unsafe { run(self, kernel) }
    }
}

impl<const BF16: bool> Avx512<BF16> {
    pub fn here() -> Option<Self> {
        let has = is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512bw")
            && is_x86_feature_detected!("avx512dq")
            && is_x86_feature_detected!("avx512vl")
            && (!BF16 || is_x86_feature_detected!("avx512bf16"));
        (has && Avx2::here().is_some()).then_some(Avx512(()))
    }

    pub fn without_bf16(self) -> Avx512<false> {
        Avx512(())
    }
}

impl Avx512<false> {
    pub fn run(self, kernel: impl Kernel) {
        #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,fma")]
        fn run(simd: Avx512<false>, kernel: impl Kernel) {
            kernel.run(simd);
        }
        // SAFETY: the CPU has the features, as there is an `Avx512`.
        unsafe { run(self, kernel) }
    }
}

impl Avx512<true> {
    pub fn run(self, kernel: impl Kernel) {
        #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx512bf16,avx2,fma")]
        fn run(simd: Avx512<true>, kernel: impl Kernel) {
            kernel.run(simd);
        }
        // SAFETY: the CPU has the features, as there is an `Avx512<true>`.
        unsafe { run(self, kernel) }
    }
}

/// What instructions do to numbers in registers.
macro_rules! operations {
    ($($name:ident($($argument:ident: $kind:ty),*) -> $result:ty = $work:expr;)*) => {$(
        #[inline(always)]
        fn $name(self, $($argument: $kind),*) -> $result {
            // SAFETY: the CPU has the instructions, as there is `self`. What is read is sixteen numbers. What is
            // transmuted has as many bits, all valid.
            unsafe { $work }
        }
    )*};
}

/// Applies an operation to both halves. (A closure would not have the instructions.)
macro_rules! both {
    ($i:ident => $of_half:expr) => {{
        let [$i, other] = [0, 1];
        let low = $of_half;
        let $i = other;
        [low, $of_half]
    }};
}

type Halves = [__m256; 2];
type IntHalves = [__m256i; 2];

impl Simd for Avx2 {
    type Floats = Halves;
    type Ints = IntHalves;
    const WIDE: bool = false;

    operations! {
        splat(value: f32) -> Halves = [_mm256_set1_ps(value); 2];
        load(values: &Lanes) -> Halves = both!(i => _mm256_loadu_ps(values.as_ptr().add(8 * i)));
        store(v: Halves) -> Lanes = transmute::<Halves, Lanes>(v);
        add(a: Halves, b: Halves) -> Halves = both!(i => _mm256_add_ps(a[i], b[i]));
        sub(a: Halves, b: Halves) -> Halves = both!(i => _mm256_sub_ps(a[i], b[i]));
        mul(a: Halves, b: Halves) -> Halves = both!(i => _mm256_mul_ps(a[i], b[i]));
        mul_add(a: Halves, b: Halves, c: Halves) -> Halves = both!(i => _mm256_fmadd_ps(a[i], b[i], c[i]));
        neg_mul_add(a: Halves, b: Halves, c: Halves) -> Halves = both!(i => _mm256_fnmadd_ps(a[i], b[i], c[i]));
        // The second operand is the result if either is NaN or both are 0.
        relu(v: Halves) -> Halves = both!(i => _mm256_max_ps(_mm256_setzero_ps(), v[i]));
        positive(v: Halves) -> u16 = {
            let [low, high] =
                both!(i => _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_GT_OQ>(v[i], _mm256_setzero_ps())) as u16);
            low | high << 8
        };
        keep(v: Halves, bits: u16) -> Halves = {
            let lanes = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
            both!(i => {
                let set = _mm256_and_si256(_mm256_set1_epi32(i32::from(bits >> (8 * i))), lanes);
                _mm256_and_ps(v[i], _mm256_castsi256_ps(_mm256_cmpeq_epi32(set, lanes)))
            })
        };
        flushed(v: Halves) -> Halves =
            both!(i => _mm256_blendv_ps(v[i], _mm256_and_ps(v[i], _mm256_set1_ps(-0.0)), tiny(v[i])));
        first(v: Halves) -> Halves =
            both!(i => _mm256_castsi256_ps(_mm256_slli_epi32::<16>(_mm256_castps_si256(v[i]))));
        second(v: Halves) -> Halves =
            both!(i => _mm256_and_ps(v[i], _mm256_castsi256_ps(_mm256_set1_epi32(0xffff_0000_u32 as i32))));
        rounded(v: Halves) -> [f32; LANES / 2] = {
            // Packing works within halves of 128 bits.
            let packed = _mm256_packus_epi32(rounded(v[0]), rounded(v[1]));
            transmute::<__m256i, [f32; LANES / 2]>(_mm256_permute4x64_epi64::<0b11_01_10_00>(packed))
        };
        pair(a: Halves, b: Halves) -> Halves = both!(i => {
            _mm256_castsi256_ps(_mm256_or_si256(rounded(a[i]), _mm256_slli_epi32::<16>(rounded(b[i]))))
        });
        floor_within(values: Halves, last: Halves) -> (IntHalves, Halves) = {
            // The maximum of NaN and 0 is the second.
            let within = both!(i => _mm256_min_ps(_mm256_max_ps(values[i], _mm256_setzero_ps()), last[i]));
            let floor = both!(i => _mm256_cvttps_epi32(within[i]));
            (floor, both!(i => _mm256_cvtepi32_ps(floor[i])))
        };
        splat_ints(value: u32) -> IntHalves = [_mm256_set1_epi32(value as i32); 2];
        store_ints(v: IntHalves) -> [u32; LANES] = transmute::<IntHalves, [u32; LANES]>(v);
        add_ints(a: IntHalves, b: IntHalves) -> IntHalves = both!(i => _mm256_add_epi32(a[i], b[i]));
        mul_ints(a: IntHalves, b: IntHalves) -> IntHalves = both!(i => _mm256_mullo_epi32(a[i], b[i]));
        xor(a: IntHalves, b: IntHalves) -> IntHalves = both!(i => _mm256_xor_si256(a[i], b[i]));
        and(a: IntHalves, b: IntHalves) -> IntHalves = both!(i => _mm256_and_si256(a[i], b[i]));
    }
}

/// Sets all bits where the number is subnormal or 0.
#[inline(always)]
unsafe fn tiny(v: __m256) -> __m256 {
    // SAFETY: callers have AVX2.
    unsafe {
        let magnitude = _mm256_andnot_ps(_mm256_set1_ps(-0.0), v);
        _mm256_cmp_ps::<_CMP_LT_OQ>(magnitude, _mm256_set1_ps(f32::MIN_POSITIVE))
    }
}

/// Returns the nearest bf16 in the low half of each word (see [`super::round`]).
#[inline(always)]
unsafe fn rounded(v: __m256) -> __m256i {
    // SAFETY: callers have AVX2.
    unsafe {
        let u = _mm256_castps_si256(v);
        let odd = _mm256_and_si256(_mm256_srli_epi32::<16>(u), _mm256_set1_epi32(1));
        let up = _mm256_add_epi32(u, _mm256_add_epi32(odd, _mm256_set1_epi32(0x7fff)));
        let quiet = _mm256_or_si256(u, _mm256_set1_epi32(0x40_0000));
        let zero = _mm256_and_ps(v, _mm256_set1_ps(-0.0));
        let normal = _mm256_blendv_ps(_mm256_castsi256_ps(up), zero, tiny(v));
        let nan = _mm256_cmp_ps::<_CMP_UNORD_Q>(v, v);
        let rounded = _mm256_blendv_ps(normal, _mm256_castsi256_ps(quiet), nan);
        _mm256_srli_epi32::<16>(_mm256_castps_si256(rounded))
    }
}

impl<const BF16: bool> Simd for Avx512<BF16> {
    type Floats = __m512;
    type Ints = __m512i;
    const WIDE: bool = true;

    operations! {
        splat(value: f32) -> __m512 = _mm512_set1_ps(value);
        load(values: &Lanes) -> __m512 = _mm512_loadu_ps(values.as_ptr());
        store(v: __m512) -> Lanes = transmute::<__m512, Lanes>(v);
        add(a: __m512, b: __m512) -> __m512 = _mm512_add_ps(a, b);
        sub(a: __m512, b: __m512) -> __m512 = _mm512_sub_ps(a, b);
        mul(a: __m512, b: __m512) -> __m512 = _mm512_mul_ps(a, b);
        mul_add(a: __m512, b: __m512, c: __m512) -> __m512 = _mm512_fmadd_ps(a, b, c);
        neg_mul_add(a: __m512, b: __m512, c: __m512) -> __m512 = _mm512_fnmadd_ps(a, b, c);
        // The second operand is the result if either is NaN or both are 0.
        relu(v: __m512) -> __m512 = _mm512_max_ps(_mm512_setzero_ps(), v);
        positive(v: __m512) -> u16 = _mm512_cmp_ps_mask::<_CMP_GT_OQ>(v, _mm512_setzero_ps());
        keep(v: __m512, bits: u16) -> __m512 = _mm512_maskz_mov_ps(bits, v);
        flushed(v: __m512) -> __m512 = {
            let tiny = _mm512_cmp_ps_mask::<_CMP_LT_OQ>(_mm512_abs_ps(v), _mm512_set1_ps(f32::MIN_POSITIVE));
            _mm512_mask_and_ps(v, tiny, v, _mm512_set1_ps(-0.0))
        };
        first(v: __m512) -> __m512 = _mm512_castsi512_ps(_mm512_slli_epi32::<16>(_mm512_castps_si512(v)));
        second(v: __m512) -> __m512 = _mm512_castsi512_ps(_mm512_and_si512(
            _mm512_castps_si512(v),
            _mm512_set1_epi32(0xffff_0000_u32 as i32),
        ));
        rounded(v: __m512) -> [f32; LANES / 2] = match BF16 {
            true => transmute::<__m256bh, [f32; LANES / 2]>(_mm512_cvtneps_pbh(v)),
            false => Avx2(()).rounded(transmute::<__m512, Halves>(v)),
        };
        pair(a: __m512, b: __m512) -> __m512 = match BF16 {
            true => {
                let both = transmute::<__m512bh, __m512i>(_mm512_cvtne2ps_pbh(b, a));
                let order = _mm512_loadu_si512(INTERLEAVED.as_ptr().cast());
                _mm512_castsi512_ps(_mm512_permutexvar_epi16(order, both))
            }
            false => {
                let [a, b] = [transmute::<__m512, Halves>(a), transmute::<__m512, Halves>(b)];
                transmute::<Halves, __m512>(Avx2(()).pair(a, b))
            }
        };
        dot_pairs(a: __m512, b: __m512, c: __m512) -> __m512 = match BF16 {
            true => _mm512_dpbf16_ps(c, transmute::<__m512, __m512bh>(a), transmute::<__m512, __m512bh>(b)),
            false => dot_pairs(Avx512::<BF16>(()), a, b, c),
        };
        floor_within(values: __m512, last: __m512) -> (__m512i, __m512) = {
            // The maximum of NaN and 0 is the second.
            let within = _mm512_min_ps(_mm512_max_ps(values, _mm512_setzero_ps()), last);
            let floor = _mm512_cvttps_epi32(within);
            (floor, _mm512_cvtepi32_ps(floor))
        };
        splat_ints(value: u32) -> __m512i = _mm512_set1_epi32(value as i32);
        store_ints(v: __m512i) -> [u32; LANES] = transmute::<__m512i, [u32; LANES]>(v);
        add_ints(a: __m512i, b: __m512i) -> __m512i = _mm512_add_epi32(a, b);
        mul_ints(a: __m512i, b: __m512i) -> __m512i = _mm512_mullo_epi32(a, b);
        xor(a: __m512i, b: __m512i) -> __m512i = _mm512_xor_si512(a, b);
        and(a: __m512i, b: __m512i) -> __m512i = _mm512_and_si512(a, b);
    }

    #[inline(always)]
    fn load_first(self, values: &[f32]) -> __m512 {
        // SAFETY: the CPU has AVX-512, as there is `self`; the mask has a bit for each number at most.
        unsafe { _mm512_maskz_loadu_ps(first_bits(values.len()), values.as_ptr()) }
    }

    #[inline(always)]
    fn store_first(self, to: &mut [f32], v: __m512) {
        // SAFETY: as in `load_first`.
        unsafe { _mm512_mask_storeu_ps(to.as_mut_ptr(), first_bits(to.len()), v) }
    }

    /// Both numbers of a pair by one load of 64 bits.
    #[inline(always)]
    unsafe fn gather<const W: usize>(self, table: &[[f32; W]], indices: __m512i) -> [__m512; W] {
        if W != 2 {
            return gather(self, table, indices);
        }
        let mut columns = [self.splat(0.0); W];
        // SAFETY: the CPU has AVX-512, as there is `self`; every index lies within the table of pairs.
        unsafe {
            let (low, high) = (_mm512_castsi512_si256(indices), _mm512_extracti64x4_epi64::<1>(indices));
            let table = table.as_ptr().cast();
            let (low, high) = (_mm512_i32gather_pd::<8>(low, table), _mm512_i32gather_pd::<8>(high, table));
            let (low, high) = (_mm512_castpd_ps(low), _mm512_castpd_ps(high));
            let even = _mm512_setr_epi32(0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
            let odd = _mm512_add_epi32(even, _mm512_set1_epi32(1));
            for (column, order) in columns.iter_mut().zip([even, odd]) {
                *column = _mm512_permutex2var_ps(low, order, high);
            }
        }
        columns
    }
}

/// The order that interleaves the halves of a vector of bf16.
const INTERLEAVED: [u16; 2 * LANES] = {
    let mut order = [0; 2 * LANES];
    let mut i = 0;
    while i < LANES {
        order[2 * i] = i as u16;
        order[2 * i + 1] = (LANES + i) as u16;
        i += 1;
    }
    order
};

#[inline(always)]
fn first_bits(count: usize) -> u16 {
    ((1u32 << count) - 1) as u16
}
