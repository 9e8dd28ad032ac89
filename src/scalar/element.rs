//! The element types of registers, f64 and f32: pulp's instructions for both under common names.

use super::{Instructions, Precision};
use pulp::Simd;
use pulp::bytemuck::Pod;
use std::fmt::Debug;

/// An element type of registers.
///
/// The functions on registers are one or a few instructions each, of the instruction set `S`.
pub trait Element: Precision + Pod {
    /// A register of `S` with elements of this type.
    type Register<S: Simd>: Pod + Debug + Send + Sync;

    /// `x` in every lane.
    fn splat<S: Simd>(simd: S, x: f64) -> Self::Register<S>;

    /// a + b.
    fn add<S: Simd>(simd: S, a: Self::Register<S>, b: Self::Register<S>) -> Self::Register<S>;

    /// a - b.
    fn sub<S: Simd>(simd: S, a: Self::Register<S>, b: Self::Register<S>) -> Self::Register<S>;

    /// a b.
    fn mul<S: Simd>(simd: S, a: Self::Register<S>, b: Self::Register<S>) -> Self::Register<S>;

    /// a / b.
    fn div<S: Simd>(simd: S, a: Self::Register<S>, b: Self::Register<S>) -> Self::Register<S>;

    /// a b + c, rounded once.
    fn mul_add<S: Simd>(simd: S, a: Self::Register<S>, b: Self::Register<S>, c: Self::Register<S>)
    -> Self::Register<S>;

    /// c - a b, rounded once.
    fn minus_product<S: Simd>(
        simd: S,
        a: Self::Register<S>,
        b: Self::Register<S>,
        c: Self::Register<S>,
    ) -> Self::Register<S>;

    /// The square root.
    fn sqrt<S: Simd>(simd: S, a: Self::Register<S>) -> Self::Register<S>;

    /// -a, also for zeros.
    fn negated<S: Simd>(simd: S, a: Self::Register<S>) -> Self::Register<S>;

    /// |a|.
    fn absolute<S: Simd>(simd: S, a: Self::Register<S>) -> Self::Register<S>;

    /// The smaller of the two; NaN if either is NaN.
    fn worst<S: Simd>(simd: S, a: Self::Register<S>, b: Self::Register<S>) -> Self::Register<S>;

    /// 1 where a is 0, else 0.
    fn one_if_zero<S: Simd>(simd: S, a: Self::Register<S>) -> Self::Register<S>;

    /// True if no lane exceeds `bound` in magnitude or is NaN.
    fn all_within<S: Simd>(simd: S, a: Self::Register<S>, bound: f64) -> bool;

    /// Sine and cosine of the whole angle from those of the reduced angle. `shifted` is the number of quarter turns
    /// plus [`Circle::ROUNDER`](super::Circle::ROUNDER), whose low-order mantissa bits contain that number.
    fn turned<S: Simd>(
        simd: S,
        shifted: Self::Register<S>,
        sine: Self::Register<S>,
        cosine: Self::Register<S>,
    ) -> (Self::Register<S>, Self::Register<S>);

    /// Transposes a square block of registers: entry j of register i becomes entry i of register j.
    fn transpose<S: Instructions>(simd: S, block: &mut [Self::Register<S>]);

    /// Loads the first entries of `numbers` into the lower half of the lanes and the last ones into the upper half;
    /// `numbers` has at least half as many entries as lanes.
    fn load_ends<S: Instructions>(simd: S, numbers: &[Self]) -> Self::Register<S>;

    /// Stores the lower half of the lanes to the first entries of `numbers`, and the upper half to the last ones.
    fn store_ends<S: Instructions>(simd: S, numbers: &mut [Self], lanes: Self::Register<S>);
}

/// Definitions common to both types, whose pulp functions differ in their suffix.
macro_rules! instructions {
    (
        $registers:ident, $add:ident, $sub:ident, $mul:ident, $div:ident, $mul_add:ident, $negate_mul_add:ident, $sqrt:ident,
        $splat:ident, $xor:ident, $and:ident, $select:ident, $equal:ident, $at_most:ident, $first_true:ident, $not:ident,
        $bits:ident, $splat_bits:ident, $add_bits:ident, $and_bits:ident, $equal_bits:ident, $transpose:ident, $load:ident,
        $store:ident, $min:ident, $or:ident
    ) => {
        type Register<S: Simd> = S::$registers;

        #[inline(always)]
        #[allow(clippy::cast_possible_truncation)] // rounding is the purpose
        fn splat<S: Simd>(simd: S, x: f64) -> S::$registers {
            simd.$splat(x as Self)
        }

        #[inline(always)]
        fn add<S: Simd>(simd: S, a: S::$registers, b: S::$registers) -> S::$registers {
            simd.$add(a, b)
        }

        #[inline(always)]
        fn sub<S: Simd>(simd: S, a: S::$registers, b: S::$registers) -> S::$registers {
            simd.$sub(a, b)
        }

        #[inline(always)]
        fn mul<S: Simd>(simd: S, a: S::$registers, b: S::$registers) -> S::$registers {
            simd.$mul(a, b)
        }

        #[inline(always)]
        fn div<S: Simd>(simd: S, a: S::$registers, b: S::$registers) -> S::$registers {
            simd.$div(a, b)
        }

        #[inline(always)]
        fn mul_add<S: Simd>(simd: S, a: S::$registers, b: S::$registers, c: S::$registers) -> S::$registers {
            simd.$mul_add(a, b, c)
        }

        #[inline(always)]
        fn minus_product<S: Simd>(simd: S, a: S::$registers, b: S::$registers, c: S::$registers) -> S::$registers {
            simd.$negate_mul_add(a, b, c)
        }

        #[inline(always)]
        fn sqrt<S: Simd>(simd: S, a: S::$registers) -> S::$registers {
            simd.$sqrt(a)
        }

        #[inline(always)]
        fn negated<S: Simd>(simd: S, a: S::$registers) -> S::$registers {
            simd.$xor(a, simd.$splat(-0.0))
        }

        #[inline(always)]
        fn absolute<S: Simd>(simd: S, a: S::$registers) -> S::$registers {
            simd.$and(a, simd.$splat(Self::from_bits(!(-0.0 as Self).to_bits())))
        }

        #[inline(always)]
        fn worst<S: Simd>(simd: S, a: S::$registers, b: S::$registers) -> S::$registers {
            // For a NaN and a number, x86 returns the second operand and NEON the NaN: one of the two orders returns
            // the NaN, and OR with the other result preserves it.
            simd.$or(simd.$min(a, b), simd.$min(b, a))
        }

        #[inline(always)]
        fn one_if_zero<S: Simd>(simd: S, a: S::$registers) -> S::$registers {
            let zero = simd.$splat(0.0);
            simd.$select(simd.$equal(a, zero), simd.$splat(1.0), zero)
        }

        #[inline(always)]
        fn all_within<S: Simd>(simd: S, a: S::$registers, bound: f64) -> bool {
            let within = simd.$at_most(Self::absolute(simd, a), Self::splat(simd, bound));
            simd.$first_true(simd.$not(within)) >= size_of::<S::$registers>() / size_of::<Self>()
        }

        #[inline(always)]
        fn turned<S: Simd>(
            simd: S,
            shifted: S::$registers,
            sine: S::$registers,
            cosine: S::$registers,
        ) -> (S::$registers, S::$registers) {
            // Quadrants 1 and 3 swap sine and cosine, 2 and 3 change the sign of the sine, 1 and 2 that of the cosine.
            let quadrant = simd.$bits(shifted);
            let (one, two) = (simd.$splat_bits(1), simd.$splat_bits(2));
            let swapped = simd.$equal_bits(simd.$and_bits(quadrant, one), one);
            let sine_turned = simd.$equal_bits(simd.$and_bits(quadrant, two), two);
            let cosine_turned = simd.$equal_bits(simd.$and_bits(simd.$add_bits(quadrant, one), two), two);
            let (s, c) = (simd.$select(swapped, cosine, sine), simd.$select(swapped, sine, cosine));
            let sine = simd.$select(sine_turned, Self::negated(simd, s), s);
            (sine, simd.$select(cosine_turned, Self::negated(simd, c), c))
        }

        #[inline(always)]
        fn transpose<S: Instructions>(simd: S, block: &mut [S::$registers]) {
            simd.$transpose(block);
        }

        #[inline(always)]
        fn load_ends<S: Instructions>(simd: S, numbers: &[Self]) -> S::$registers {
            simd.$load(numbers)
        }

        #[inline(always)]
        fn store_ends<S: Instructions>(simd: S, numbers: &mut [Self], lanes: S::$registers) {
            simd.$store(numbers, lanes);
        }
    };
}

impl Element for f64 {
    instructions!(
        f64s,
        add_f64s,
        sub_f64s,
        mul_f64s,
        div_f64s,
        mul_add_f64s,
        negate_mul_add_f64s,
        sqrt_f64s,
        splat_f64s,
        xor_f64s,
        and_f64s,
        select_f64s,
        equal_f64s,
        less_than_or_equal_f64s,
        first_true_m64s,
        not_m64s,
        transmute_u64s_f64s,
        splat_u64s,
        add_u64s,
        and_u64s,
        equal_u64s,
        transpose,
        load_ends,
        store_ends,
        min_f64s,
        or_f64s
    );
}

impl Element for f32 {
    instructions!(
        f32s,
        add_f32s,
        sub_f32s,
        mul_f32s,
        div_f32s,
        mul_add_f32s,
        negate_mul_add_f32s,
        sqrt_f32s,
        splat_f32s,
        xor_f32s,
        and_f32s,
        select_f32s,
        equal_f32s,
        less_than_or_equal_f32s,
        first_true_m32s,
        not_m32s,
        transmute_u32s_f32s,
        splat_u32s,
        add_u32s,
        and_u32s,
        equal_u32s,
        transpose_f32,
        load_ends_f32,
        store_ends_f32,
        min_f32s,
        or_f32s
    );
}
