//! Vectors of sixteen numbers: AVX-512 if the CPU has it, and plain loops with the same bits otherwise.

#[cfg(target_arch = "x86_64")]
pub use wide::Wide;

/// Numbers in a vector.
pub const LANES: usize = 16;

/// One number per lane, in memory.
pub type Lanes = [f32; LANES];

/// Operations on [`LANES`] numbers. Each operation is rounded once, lane by lane, so that all implementations give the
/// same bits.
pub trait Simd: Copy {
    /// Numbers of f32.
    type Floats: Copy;
    /// Whole numbers modulo 2^32.
    type Ints: Copy;

    fn splat(self, value: f32) -> Self::Floats;
    fn load(self, values: &Lanes) -> Self::Floats;
    fn store(self, values: Self::Floats) -> Lanes;
    fn add(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;
    fn sub(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;
    fn mul(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;
    /// Returns `a b + c`.
    fn mul_add(self, a: Self::Floats, b: Self::Floats, c: Self::Floats) -> Self::Floats;
    /// Returns `c - a b`.
    fn neg_mul_add(self, a: Self::Floats, b: Self::Floats, c: Self::Floats) -> Self::Floats;
    /// Returns `values` rounded down, at least 0 and at most `last`, which is below 2^31, and 0 for NaN. Also returns
    /// the same as floats.
    fn floor_within(self, values: Self::Floats, last: Self::Floats) -> (Self::Ints, Self::Floats);

    fn splat_ints(self, value: u32) -> Self::Ints;
    fn store_ints(self, values: Self::Ints) -> [u32; LANES];
    fn add_ints(self, a: Self::Ints, b: Self::Ints) -> Self::Ints;
    fn mul_ints(self, a: Self::Ints, b: Self::Ints) -> Self::Ints;
    fn xor(self, a: Self::Ints, b: Self::Ints) -> Self::Ints;
    fn and(self, a: Self::Ints, b: Self::Ints) -> Self::Ints;

    /// Returns the entries of a table at `indices`, feature by feature.
    ///
    /// # Safety
    /// Every index must be within the table.
    unsafe fn gather<const F: usize>(self, table: &[[f32; F]], indices: Self::Ints) -> [Self::Floats; F];

    /// Stores indices of corners in memory.
    #[inline(always)]
    fn store_corners(self, corners: [Self::Ints; 8]) -> [[u32; LANES]; 8] {
        let mut stored = [[0; LANES]; 8];
        for (stored, corner) in stored.iter_mut().zip(corners) {
            *stored = self.store_ints(corner);
        }
        stored
    }

    /// Adds each row's features, times its weight at each corner, to the corner's entry: row after row, corner after
    /// corner.
    #[inline(always)]
    fn add_weighted<const F: usize>(
        self,
        table: &mut [[f32; F]],
        corners: &[[u32; LANES]; 8],
        weights: &[Lanes; 8],
        rows: &[[f32; F]],
    ) {
        for (i, row) in rows.iter().enumerate().take(LANES) {
            for (corners, weights) in corners.iter().zip(weights) {
                self.add_to_entry(&mut table[corners[i] as usize], weights[i], row);
            }
        }
    }

    /// Adds features times a weight to an entry.
    #[inline(always)]
    fn add_to_entry<const F: usize>(self, entry: &mut [f32; F], weight: f32, features: &[f32; F]) {
        for (sum, feature) in entry.iter_mut().zip(features) {
            *sum = weight.mul_add(*feature, *sum);
        }
    }

    /// Separates the features of all lanes.
    #[inline(always)]
    fn columns<const F: usize>(self, rows: &[[f32; F]; LANES]) -> [Self::Floats; F] {
        let mut features = [self.splat(0.0); F];
        for (feature, values) in features.iter_mut().enumerate() {
            *values = self.load(&each(|i| rows[i][feature]));
        }
        features
    }

    /// Interleaves the features of each lane.
    #[inline(always)]
    fn rows<const F: usize>(self, features: [Self::Floats; F]) -> [[f32; F]; LANES] {
        let mut rows = [[0.0; F]; LANES];
        for (feature, values) in features.into_iter().enumerate() {
            for (row, value) in rows.iter_mut().zip(self.store(values)) {
                row[feature] = value;
            }
        }
        rows
    }
}

/// Work on slices. The bits of its results do not depend on the CPU.
pub trait Kernel {
    /// Does the work. Implementations are `#[inline(always)]`, to be compiled with their caller's instructions.
    fn run(self, simd: impl Simd);
}

/// The capabilities of a CPU.
#[derive(Clone, Copy, Debug)]
pub enum Processor {
    /// AVX-512 with F and DQ.
    #[cfg(target_arch = "x86_64")]
    Wide(Wide),
    /// Fused multiply-adds, with vectors from the compiler.
    #[cfg(target_arch = "x86_64")]
    Narrow(wide::Narrow),
    /// Everything for which the program was compiled.
    Any,
}

impl Processor {
    /// Returns the best kind of this machine.
    pub fn here() -> Processor {
        #[cfg(target_arch = "x86_64")]
        {
            if let Some(wide) = Wide::here() {
                return Processor::Wide(wide);
            }
            if let Some(narrow) = wide::Narrow::here() {
                return Processor::Narrow(narrow);
            }
        }
        Processor::Any
    }

    /// Returns all kinds of this machine.
    #[cfg(test)]
    pub fn all() -> Vec<Processor> {
        let mut all = vec![Processor::Any];
        #[cfg(target_arch = "x86_64")]
        {
            all.extend(wide::Narrow::here().map(Processor::Narrow));
            all.extend(Wide::here().map(Processor::Wide));
        }
        all
    }

    /// Runs a kernel of single features: by plain loops, of which the compiler makes vectors.
    pub fn run_plain(self, kernel: impl Kernel) {
        match self {
            #[cfg(target_arch = "x86_64")]
            Processor::Wide(wide) => wide.narrow().run(kernel),
            #[cfg(target_arch = "x86_64")]
            Processor::Narrow(narrow) => narrow.run(kernel),
            Processor::Any => kernel.run(Plain),
        }
    }

    /// Runs a kernel with the instructions of this CPU: one of pairs, or one that calls nothing of [`Simd`].
    pub fn run(self, kernel: impl Kernel) {
        match self {
            #[cfg(target_arch = "x86_64")]
            Processor::Wide(wide) => wide.run(kernel),
            #[cfg(target_arch = "x86_64")]
            Processor::Narrow(narrow) => narrow.run(kernel),
            Processor::Any => kernel.run(Plain),
        }
    }
}

/// Plain loops.
#[derive(Clone, Copy, Debug)]
pub struct Plain;

#[inline(always)]
fn each<T: Copy + Default>(value: impl Fn(usize) -> T) -> [T; LANES] {
    let mut values = [T::default(); LANES];
    for (i, lane) in values.iter_mut().enumerate() {
        *lane = value(i);
    }
    values
}

#[rustfmt::skip]
impl Simd for Plain {
    type Floats = Lanes;
    type Ints = [u32; LANES];

    #[inline(always)]
    fn splat(self, value: f32) -> Lanes { [value; LANES] }
    #[inline(always)]
    fn load(self, values: &Lanes) -> Lanes { *values }
    #[inline(always)]
    fn store(self, values: Lanes) -> Lanes { values }
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
    fn floor_within(self, values: Lanes, last: Lanes) -> ([u32; LANES], Lanes) {
        // NaN is greater than nothing.
        let floor = each(|i| (if values[i] > 0.0 { values[i] } else { 0.0 }).min(last[i]) as i32 as u32);
        (floor, each(|i| floor[i] as i32 as f32))
    }

    #[inline(always)]
    fn splat_ints(self, value: u32) -> [u32; LANES] { [value; LANES] }
    #[inline(always)]
    fn store_ints(self, values: [u32; LANES]) -> [u32; LANES] { values }
    #[inline(always)]
    fn add_ints(self, a: [u32; LANES], b: [u32; LANES]) -> [u32; LANES] { each(|i| a[i].wrapping_add(b[i])) }
    #[inline(always)]
    fn mul_ints(self, a: [u32; LANES], b: [u32; LANES]) -> [u32; LANES] { each(|i| a[i].wrapping_mul(b[i])) }
    #[inline(always)]
    fn xor(self, a: [u32; LANES], b: [u32; LANES]) -> [u32; LANES] { each(|i| a[i] ^ b[i]) }
    #[inline(always)]
    fn and(self, a: [u32; LANES], b: [u32; LANES]) -> [u32; LANES] { each(|i| a[i] & b[i]) }

    #[inline(always)]
    unsafe fn gather<const F: usize>(self, table: &[[f32; F]], indices: [u32; LANES]) -> [Lanes; F] {
        gather_plain(table, &indices)
    }
}

#[inline(always)]
fn gather_plain<const F: usize>(table: &[[f32; F]], indices: &[u32; LANES]) -> [Lanes; F] {
    let mut features = [[0.0; LANES]; F];
    for i in 0..LANES {
        let entry = &table[indices[i] as usize];
        for (feature, value) in features.iter_mut().zip(entry) {
            feature[i] = *value;
        }
    }
    features
}

#[cfg(target_arch = "x86_64")]
mod wide {
    use std::arch::x86_64::*;

    use super::{Kernel, LANES, Lanes, Plain, Simd};

    /// AVX-512. It exists only on a CPU that has it.
    #[derive(Clone, Copy, Debug)]
    pub struct Wide(());

    /// AVX2 and FMA. It exists only on a CPU that has them.
    #[derive(Clone, Copy, Debug)]
    pub struct Narrow(());

    impl Wide {
        pub fn here() -> Option<Wide> {
            let has = is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512dq");
            (has && Narrow::here().is_some()).then_some(Wide(()))
        }

        pub fn narrow(self) -> Narrow {
            Narrow(())
        }

        pub fn run(self, kernel: impl Kernel) {
            #[target_feature(enable = "avx2,fma,avx512f,avx512dq")]
            fn run(wide: Wide, kernel: impl Kernel) {
                kernel.run(wide);
            }
            // SAFETY: the CPU has the features, as there is a `Wide`.
            unsafe { run(self, kernel) }
        }
    }

    impl Narrow {
        pub fn here() -> Option<Narrow> {
            let has = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma");
            has.then_some(Narrow(()))
        }

        pub fn run(self, kernel: impl Kernel) {
            #[target_feature(enable = "avx2,fma")]
            fn run(kernel: impl Kernel) {
                kernel.run(Plain);
            }
            // SAFETY: the CPU has the features, as there is a `Narrow`.
            unsafe { run(kernel) }
        }
    }

    /// What AVX-512 does to numbers in registers.
    macro_rules! operations {
        ($($name:ident($($argument:ident: $kind:ty),*) -> $result:ty = $work:expr;)*) => {$(
            #[inline(always)]
            fn $name(self, $($argument: $kind),*) -> $result {
                // SAFETY: the CPU has AVX-512, as there is a `Wide`; what is read and written is sixteen numbers.
                unsafe { $work }
            }
        )*};
    }

    impl Simd for Wide {
        type Floats = __m512;
        type Ints = __m512i;

        operations! {
            splat(value: f32) -> __m512 = _mm512_set1_ps(value);
            load(values: &Lanes) -> __m512 = _mm512_loadu_ps(values.as_ptr());
            store(values: __m512) -> Lanes = std::mem::transmute::<__m512, Lanes>(values);
            add(a: __m512, b: __m512) -> __m512 = _mm512_add_ps(a, b);
            sub(a: __m512, b: __m512) -> __m512 = _mm512_sub_ps(a, b);
            mul(a: __m512, b: __m512) -> __m512 = _mm512_mul_ps(a, b);
            mul_add(a: __m512, b: __m512, c: __m512) -> __m512 = _mm512_fmadd_ps(a, b, c);
            neg_mul_add(a: __m512, b: __m512, c: __m512) -> __m512 = _mm512_fnmadd_ps(a, b, c);
            floor_within(values: __m512, last: __m512) -> (__m512i, __m512) = {
                // The maximum of NaN and 0 is the second.
                let within = _mm512_min_ps(_mm512_max_ps(values, _mm512_setzero_ps()), last);
                let floor = _mm512_cvttps_epi32(within);
                (floor, _mm512_cvtepi32_ps(floor))
            };
            splat_ints(value: u32) -> __m512i = _mm512_set1_epi32(value as i32);
            store_ints(values: __m512i) -> [u32; LANES] = std::mem::transmute::<__m512i, [u32; LANES]>(values);
            add_ints(a: __m512i, b: __m512i) -> __m512i = _mm512_add_epi32(a, b);
            mul_ints(a: __m512i, b: __m512i) -> __m512i = _mm512_mullo_epi32(a, b);
            xor(a: __m512i, b: __m512i) -> __m512i = _mm512_xor_si512(a, b);
            and(a: __m512i, b: __m512i) -> __m512i = _mm512_and_si512(a, b);
        }

        /// Both features of a pair by one load of 64 bits.
        #[inline(always)]
        unsafe fn gather<const F: usize>(self, table: &[[f32; F]], indices: __m512i) -> [__m512; F] {
            const { assert!(F == 2) };
            let mut features = [self.splat(0.0); F];
            // SAFETY: the CPU has AVX-512, as there is a `Wide`; every index lies within the table of pairs.
            let pairs = unsafe {
                let (low, high) = (_mm512_castsi512_si256(indices), _mm512_extracti64x4_epi64::<1>(indices));
                let table = table.as_ptr().cast();
                let (low, high) = (_mm512_i32gather_pd::<8>(low, table), _mm512_i32gather_pd::<8>(high, table));
                let (low, high) = (_mm512_castpd_ps(low), _mm512_castpd_ps(high));
                let even = _mm512_setr_epi32(0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
                let odd = _mm512_add_epi32(even, _mm512_set1_epi32(1));
                [_mm512_permutex2var_ps(low, even, high), _mm512_permutex2var_ps(low, odd, high)]
            };
            for (feature, values) in features.iter_mut().zip(pairs) {
                *feature = values;
            }
            features
        }

        #[inline(always)]
        fn rows<const F: usize>(self, features: [__m512; F]) -> [[f32; F]; LANES] {
            const { assert!(F == 2) };
            let mut rows = [[0.0; F]; LANES];
            // SAFETY: the CPU has AVX-512, as there is a `Wide`.
            let (low, high) = unsafe {
                let low = _mm512_setr_epi32(0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23);
                let high = _mm512_add_epi32(low, _mm512_set1_epi32(8));
                let [a, b] = [features[0], features[1]];
                (_mm512_permutex2var_ps(a, low, b), _mm512_permutex2var_ps(a, high, b))
            };
            let (first, second) = rows.as_flattened_mut().split_at_mut(LANES);
            first.copy_from_slice(&self.store(low));
            second.copy_from_slice(&self.store(high));
            rows
        }

        /// A pair by one load, one operation and one store of 64 bits.
        #[inline(always)]
        fn add_to_entry<const F: usize>(self, entry: &mut [f32; F], weight: f32, features: &[f32; F]) {
            const { assert!(F == 2) };
            // SAFETY: the CPU has FMA, as there is a `Wide`; entry and features are two numbers each.
            unsafe {
                let entry = entry.as_mut_ptr().cast();
                let features = _mm_castsi128_ps(_mm_loadl_epi64(features.as_ptr().cast()));
                let sum = _mm_castsi128_ps(_mm_loadl_epi64(entry));
                let sum = _mm_fmadd_ps(_mm_set1_ps(weight), features, sum);
                _mm_storel_epi64(entry, _mm_castps_si128(sum));
            }
        }
    }
}
