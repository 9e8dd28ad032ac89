//! Instruction sets: alignment of their registers in memory, and transposition of square blocks of registers.

use pulp::Simd;
#[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
use pulp::cast;
use std::fmt::Debug;

/// An instruction set, and the alignment of its registers in memory.
pub trait Instructions: Simd {
    /// A zero-sized type with that alignment.
    type Alignment: Debug + Copy + Send + Sync + 'static;

    /// The instruction set, if this processor supports it.
    fn token() -> Option<Self>;

    /// Transposes a square block of registers: entry j of register i becomes entry i of register j.
    fn transpose(self, block: &mut [Self::f64s]);

    /// Loads the first entries of `numbers` into the lower half of the lanes and the last ones into the upper half;
    /// `numbers` has at least half as many entries as lanes.
    fn load_ends(self, numbers: &[f64]) -> Self::f64s;

    /// Stores the lower half of the lanes to the first entries of `numbers`, and the upper half to the last ones.
    fn store_ends(self, numbers: &mut [f64], lanes: Self::f64s);
}

/// Definitions common to all instruction sets, for half as many entries as lanes.
#[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
macro_rules! ends {
    ($half:literal) => {
        #[inline(always)]
        fn load_ends(self, numbers: &[f64]) -> Self::f64s {
            let [low, high]: [[f64; $half]; 2] = match (numbers.first_chunk(), numbers.last_chunk()) {
                (Some(&low), Some(&high)) => [low, high],
                _ => Default::default(),
            };
            cast([low, high])
        }

        #[inline(always)]
        fn store_ends(self, numbers: &mut [f64], lanes: Self::f64s) {
            let [low, high]: [[f64; $half]; 2] = cast(lanes);
            if let Some(first) = numbers.first_chunk_mut() {
                *first = low;
            }
            if let Some(last) = numbers.last_chunk_mut() {
                *last = high;
            }
        }
    };
}

/// 16 bytes.
#[cfg(target_arch = "aarch64")]
#[derive(Debug, Clone, Copy)]
#[repr(align(16))]
pub struct Align16;

/// 32 bytes.
#[cfg(target_arch = "x86_64")]
#[derive(Debug, Clone, Copy)]
#[repr(align(32))]
pub struct Align32;

/// 64 bytes.
#[cfg(target_arch = "x86_64")]
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub struct Align64;

#[cfg(target_arch = "x86_64")]
impl Instructions for pulp::x86::V3 {
    type Alignment = Align32;

    #[inline(always)]
    fn token() -> Option<Self> {
        Self::try_new()
    }

    #[inline(always)]
    fn transpose(self, block: &mut [Self::f64s]) {
        let [a, b, c, d] = block else { return };
        let s = self.avx;
        let [ra, rb, rc, rd] = [cast(*a), cast(*b), cast(*c), cast(*d)];
        // Entries 0 and 2, and 1 and 3, of two registers.
        let (ab, ab_odd) = (s._mm256_unpacklo_pd(ra, rb), s._mm256_unpackhi_pd(ra, rb));
        let (cd, cd_odd) = (s._mm256_unpacklo_pd(rc, rd), s._mm256_unpackhi_pd(rc, rd));
        *a = cast(s._mm256_permute2f128_pd::<0x20>(ab, cd));
        *b = cast(s._mm256_permute2f128_pd::<0x20>(ab_odd, cd_odd));
        *c = cast(s._mm256_permute2f128_pd::<0x31>(ab, cd));
        *d = cast(s._mm256_permute2f128_pd::<0x31>(ab_odd, cd_odd));
    }

    ends!(2);
}

/// Quarters 0 of four registers in one register, then quarters 1, 2 and 3.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn quarters(set: pulp::x86::V4, [a, b, c, d]: [std::arch::x86_64::__m512d; 4]) -> [std::arch::x86_64::__m512d; 4] {
    /// Quarters 0 and 2, and 1 and 3, of two registers.
    const EVEN: i32 = 0b10_00_10_00;
    const ODD: i32 = 0b11_01_11_01;
    let s = set.avx512f;
    let (ab, cd) = (s._mm512_shuffle_f64x2::<EVEN>(a, b), s._mm512_shuffle_f64x2::<EVEN>(c, d));
    let (ab_odd, cd_odd) = (s._mm512_shuffle_f64x2::<ODD>(a, b), s._mm512_shuffle_f64x2::<ODD>(c, d));
    [
        s._mm512_shuffle_f64x2::<EVEN>(ab, cd),
        s._mm512_shuffle_f64x2::<EVEN>(ab_odd, cd_odd),
        s._mm512_shuffle_f64x2::<ODD>(ab, cd),
        s._mm512_shuffle_f64x2::<ODD>(ab_odd, cd_odd),
    ]
}

#[cfg(target_arch = "x86_64")]
impl Instructions for pulp::x86::V4 {
    type Alignment = Align64;

    #[inline(always)]
    fn token() -> Option<Self> {
        Self::try_new()
    }

    #[inline(always)]
    fn transpose(self, block: &mut [Self::f64s]) {
        let Ok(block) = <&mut [_; 8]>::try_from(block) else { return };
        let s = self.avx512f;
        let [a, b, c, d, e, f, g, h] = *block;
        let [a, b, c, d, e, f, g, h] = [cast(a), cast(b), cast(c), cast(d), cast(e), cast(f), cast(g), cast(h)];
        // Closures of `map` are not necessarily inlined, and would then be compiled without these instructions.
        let even = [
            s._mm512_unpacklo_pd(a, b),
            s._mm512_unpacklo_pd(c, d),
            s._mm512_unpacklo_pd(e, f),
            s._mm512_unpacklo_pd(g, h),
        ];
        let odd = [
            s._mm512_unpackhi_pd(a, b),
            s._mm512_unpackhi_pd(c, d),
            s._mm512_unpackhi_pd(e, f),
            s._mm512_unpackhi_pd(g, h),
        ];
        let (even, odd) = (quarters(self, even), quarters(self, odd));
        for quarter in 0..4 {
            block[2 * quarter] = cast(even[quarter]);
            block[2 * quarter + 1] = cast(odd[quarter]);
        }
    }

    ends!(4);
}

#[cfg(target_arch = "aarch64")]
impl Instructions for pulp::aarch64::Neon {
    type Alignment = Align16;

    #[inline(always)]
    fn token() -> Option<Self> {
        Self::try_new()
    }

    #[inline(always)]
    fn transpose(self, block: &mut [Self::f64s]) {
        let [a, b] = block else { return };
        let (x, y): ([f64; 2], [f64; 2]) = (cast(*a), cast(*b));
        (*a, *b) = (cast([x[0], y[0]]), cast([x[1], y[1]]));
    }

    ends!(1);
}
