//! Sine and cosine without branches on values, for scalars and lanes.
//!
//! The argument is reduced modulo pi/2 in three parts, and polynomials are evaluated; the rounding error of the reduced
//! argument enters both. The parts have 33 bits (the split and the coefficients of the polynomials are those of Sun's
//! fdlibm, with errors below one unit in the last place). Valid up to [`LARGEST`]; beyond, and for values that are not
//! finite, the caller uses the standard library. Each scalar type implements the rounding to quadrants and the
//! selection by quadrant.

use super::Real;

/// Largest absolute value, in radians, for which the reduction is valid.
pub(crate) const LARGEST: f64 = 1.0e6;

/// 1.5 times 2^(mantissa bits): adding and subtracting it rounds to an integer.
pub(crate) const ROUNDER: f64 = 6_755_399_441_055_744.0;

/// pi/2 in parts.
pub(crate) const HALF_PI: [f64; 3] = [1.570_796_326_734_125_6, 6.077_100_506_303_966e-11, 2.022_266_248_795_950_6e-21];

/// Coefficients of sin y = y + y^3 (c0 + c1 y^2 + ...).
pub(crate) const SINE: &[f64] = &[
    -0.166_666_666_666_666_32,
    0.008_333_333_333_322_49,
    -0.000_198_412_698_298_579_5,
    2.755_731_370_707_006_8e-06,
    -2.505_076_025_340_686_3e-08,
    1.589_690_995_211_55e-10,
];

/// Coefficients of cos y = 1 - y^2 / 2 + y^4 (c0 + c1 y^2 + ...).
pub(crate) const COSINE: &[f64] = &[
    0.041_666_666_666_666_6,
    -0.001_388_888_888_887_411,
    2.480_158_728_947_673e-05,
    -2.755_731_435_139_066_3e-07,
    2.087_572_321_298_175e-09,
    -1.135_964_755_778_819_5e-11,
];

/// Sine and cosine of `x` minus `turns` quarter turns, for |x| up to [`LARGEST`], to about one unit in the last place.
#[inline(always)]
pub fn of_reduced<T: Real>(x: T, turns: T) -> (T, T) {
    let part = HALF_PI.map(|part| x.constant(part));
    // This difference is exact, by the 33 bits. The other differences are exact or propagate their rounding error to
    // the next.
    let first = x.minus_product(turns, part[0]);
    let y = first.minus_product(turns, part[1]);
    let slip = (first - y).minus_product(turns, part[1]);
    let tail = slip.minus_product(turns, part[2]);

    let z = y * y;
    let v = z * y;
    let of_sine = horner(z, &SINE[1..]);
    let half_tail = (tail * x.constant(0.5)).minus_product(v, of_sine);
    let sine = y - (z.mul_add(half_tail, -tail) - v * x.constant(SINE[0]));
    let (one, half) = (x.constant(1.0), z * x.constant(0.5));
    let whole = one - half;
    let of_cosine = horner(z, COSINE);
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
pub fn far(angles: &[f64], sines: &mut [f64], cosines: &mut [f64]) {
    for ((s, c), &x) in sines.iter_mut().zip(cosines).zip(angles) {
        if !(x.abs() <= LARGEST) {
            (*s, *c) = x.sin_cos();
        }
    }
}
