//! Sine and cosine without branches on values, for scalars and lanes.
//!
//! The argument is reduced modulo pi/2 in three parts, and polynomials are evaluated; the rounding error of the reduced
//! argument enters both. In f64 the parts have 33 bits (the split and the coefficients of the polynomials are those of
//! Sun's fdlibm, with errors below one unit in the last place). In f32 they have 24 bits with fused products, and the
//! polynomials are minimax fits for |y| <= 0.82 with an error of a tenth of a unit. Valid up to [`Circle::LARGEST`];
//! beyond, and for values that are not finite, the caller uses the standard library. Each scalar type implements the
//! rounding to quadrants and the selection by quadrant.

use super::{Precision, Real};

/// The constants of one floating-point type.
pub trait Circle: Copy + 'static {
    /// Largest absolute value, in radians, for which the reduction is valid.
    const LARGEST: f64;

    /// 1.5 times 2^(mantissa bits): adding and subtracting it rounds to an integer.
    const ROUNDER: f64;

    /// True if products of the number of quarter turns with the second part of pi/2 are exact, up to
    /// [`Circle::LARGEST`].
    const PRODUCT_IS_EXACT: bool;

    /// pi/2 in parts.
    const HALF_PI: [f64; 3];

    /// Coefficients of sin y = y + y^3 (c0 + c1 y^2 + ...).
    const SINE: &'static [f64];

    /// Coefficients of cos y = 1 - y^2 / 2 + y^4 (c0 + c1 y^2 + ...).
    const COSINE: &'static [f64];
}

impl Circle for f64 {
    const LARGEST: f64 = 1.0e6;
    const ROUNDER: f64 = 6_755_399_441_055_744.0;
    const PRODUCT_IS_EXACT: bool = true;
    const HALF_PI: [f64; 3] = [1.570_796_326_734_125_6, 6.077_100_506_303_966e-11, 2.022_266_248_795_950_6e-21];
    const SINE: &'static [f64] = &[
        -0.166_666_666_666_666_32,
        0.008_333_333_333_322_49,
        -0.000_198_412_698_298_579_5,
        2.755_731_370_707_006_8e-06,
        -2.505_076_025_340_686_3e-08,
        1.589_690_995_211_55e-10,
    ];
    const COSINE: &'static [f64] = &[
        0.041_666_666_666_666_6,
        -0.001_388_888_888_887_411,
        2.480_158_728_947_673e-05,
        -2.755_731_435_139_066_3e-07,
        2.087_572_321_298_175e-09,
        -1.135_964_755_778_819_5e-11,
    ];
}

impl Circle for f32 {
    const LARGEST: f64 = 1.0e5;
    const ROUNDER: f64 = 12_582_912.0;
    const PRODUCT_IS_EXACT: bool = false;
    // Each is a positive f32, so that the sine of -0 is -0.
    const HALF_PI: [f64; 3] = [1.570_796_251_296_997, 7.549_789_415_861_596e-08, 5.390_302_953_474_238e-15];
    const SINE: &'static [f64] = &[-0.166_666_507_720_947_27, 0.008_331_939_578_056_335, -0.000_194_859_763_723_798_1];
    const COSINE: &'static [f64] = &[0.041_666_638_106_107_71, -0.001_388_701_493_851_840_5, 2.439_963_645_883_836e-05];
}

/// Sine and cosine of `x` minus `turns` quarter turns, for |x| up to [`Circle::LARGEST`], to about one unit in the last
/// place of `P`.
#[inline(always)]
pub fn of_reduced<P: Circle, T: Real>(x: T, turns: T) -> (T, T) {
    let part = P::HALF_PI.map(|part| x.constant(part));
    // This difference is exact: by the 33 bits in f64, and by fusion in f32. The other differences are exact or
    // propagate their rounding error to the next.
    let first = x.minus_product(turns, part[0]);
    let (y, tail) = if P::PRODUCT_IS_EXACT {
        let y = first.minus_product(turns, part[1]);
        let slip = (first - y).minus_product(turns, part[1]);
        (y, slip.minus_product(turns, part[2]))
    } else {
        // The product has a rounding error of its own.
        let second = turns * part[1];
        let slip = turns.mul_add(part[1], -second);
        let reduced = first - second;
        let rest = turns.mul_add(part[2], slip) - ((first - reduced) - second);
        let y = reduced - rest;
        (y, (reduced - y) - rest)
    };

    let z = y * y;
    let v = z * y;
    let of_sine = horner(z, &P::SINE[1..]);
    let half_tail = (tail * x.constant(0.5)).minus_product(v, of_sine);
    let sine = y - (z.mul_add(half_tail, -tail) - v * x.constant(P::SINE[0]));
    let (one, half) = (x.constant(1.0), z * x.constant(0.5));
    let whole = one - half;
    let of_cosine = horner(z, P::COSINE);
    let cosine = whole + (((one - whole) - half) + z.mul_add(z * of_cosine, -(y * tail)));
    (sine, cosine)
}

/// The polynomial with these coefficients, lowest first.
#[inline(always)]
fn horner<T: Real>(z: T, coefficients: &[f64]) -> T {
    let mut sum = z.constant(coefficients[coefficients.len() - 1]);
    for &c in coefficients[..coefficients.len() - 1].iter().rev() {
        sum = sum.mul_add(z, z.constant(c));
    }
    sum
}

/// Recomputes sines and cosines of angles outside of the range of the reduction.
#[cold]
#[inline(never)]
pub fn far<P: Precision>(angles: &[P], sines: &mut [P], cosines: &mut [P]) {
    for ((s, c), &x) in sines.iter_mut().zip(cosines).zip(angles) {
        if !(x.widened().abs() <= P::LARGEST) {
            (*s, *c) = x.exact_sin_cos();
        }
    }
}
