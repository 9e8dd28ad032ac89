//! Sine and cosine without a branch on a value: what one number and the lanes of a register share.
//!
//! Reduction by pi/2 in three parts of 33 bits (the split and the polynomials' coefficients are those of Sun's fdlibm, known for
//! errors below one unit in the last place); what is left beside the reduced argument enters both polynomials. Valid to
//! [`LARGEST`]; beyond, and for what is not finite, the caller asks the standard library. Rounding to whole quadrants and choosing by
//! them is the scalar's own.

use super::Real;

/// The largest absolute value, in radians, that the reduction is good for.
pub const LARGEST: f64 = 1.0e6;

/// pi/2 in parts of 33 bits.
const HALF_PI: [f64; 2] = [1.570_796_326_734_125_6, 6.077_100_506_303_966e-11];
/// What is left of pi/2.
const HALF_PI_REST: f64 = 2.022_266_248_795_950_6e-21;

/// 1.5 * 2^52: added and taken away again, it rounds to an integer.
pub const ROUNDER: f64 = 6_755_399_441_055_744.0;

/// Of sin y = y + y^3 (c0 + c1 y^2 + ...).
const SINE: [f64; 6] = [
    -0.166_666_666_666_666_32,
    0.008_333_333_333_322_49,
    -0.000_198_412_698_298_579_5,
    2.755_731_370_707_006_8e-06,
    -2.505_076_025_340_686_3e-08,
    1.589_690_995_211_55e-10,
];

/// Of cos y = 1 - y^2 / 2 + y^4 (c0 + c1 y^2 + ...).
const COSINE: [f64; 6] = [
    0.041_666_666_666_666_6,
    -0.001_388_888_888_887_411,
    2.480_158_728_947_673e-05,
    -2.755_731_435_139_066_3e-07,
    2.087_572_321_298_175e-09,
    -1.135_964_755_778_819_5e-11,
];

/// Sine and cosine of `x` less `turns` quarter turns, |x| up to [`LARGEST`], to about one unit in the last place.
#[inline(always)]
pub fn of_reduced<T: Real>(x: T, turns: T) -> (T, T) {
    // Products of 20 and 33 bits are exact; each difference is exact or leaves its rounding to the next.
    let first = x.minus_product(turns, x.constant(HALF_PI[0]));
    let second = turns * x.constant(HALF_PI[1]);
    let reduced = first - second;
    let rest = turns * x.constant(HALF_PI_REST) - ((first - reduced) - second);
    let y = reduced - rest;
    let tail = (reduced - y) - rest;

    let z = y * y;
    let v = z * y;
    let of_sine = horner(z, [SINE[5], SINE[4], SINE[3], SINE[2], SINE[1]]);
    let half_tail = (tail * x.constant(0.5)).minus_product(v, of_sine);
    let sine = y - (z.mul_add(half_tail, -tail) - v * x.constant(SINE[0]));
    let (one, half) = (x.constant(1.0), z * x.constant(0.5));
    let whole = one - half;
    let of_cosine = horner(z, [COSINE[5], COSINE[4], COSINE[3], COSINE[2], COSINE[1], COSINE[0]]);
    let cosine = whole + (((one - whole) - half) + z.mul_add(z * of_cosine, -(y * tail)));
    (sine, cosine)
}

/// The polynomial of these coefficients, the highest first.
#[inline(always)]
fn horner<T: Real, const N: usize>(z: T, coefficients: [f64; N]) -> T {
    let mut sum = z.constant(coefficients[0]);
    for &c in &coefficients[1..] {
        sum = sum.mul_add(z, z.constant(c));
    }
    sum
}

/// Overwrites the sines and cosines of those angles that the reduction is not good for.
#[cold]
#[inline(never)]
pub fn far(angles: &[f64], sines: &mut [f64], cosines: &mut [f64]) {
    for ((s, c), &x) in sines.iter_mut().zip(cosines).zip(angles) {
        if !(x.abs() <= LARGEST) {
            (*s, *c) = x.sin_cos();
        }
    }
}
