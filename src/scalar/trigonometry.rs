//! Sine and cosine of one lane, without a branch on its value, so that a loop over lanes becomes one over vectors.
//!
//! Reduction by pi/2 in three parts of 33 bits (the split and the polynomials' coefficients are those of Sun's fdlibm, known for
//! errors below one unit in the last place); what is left beside the reduced argument enters both polynomials. Valid to
//! [`LARGEST`]; beyond, and for what is not finite, the caller asks the standard library.

/// The largest absolute value, in radians, that the reduction is good for.
pub const LARGEST: f64 = 1.0e6;

/// pi/2 in parts of 33 bits, and what is left after the second.
pub const HALF_PI: [f64; 2] = [1.570_796_326_734_125_6, 6.077_100_506_303_966e-11];
/// What is left of pi/2.
pub const HALF_PI_REST: f64 = 2.022_266_248_795_950_6e-21;

/// 1.5 * 2^52: added and taken away again, it rounds to an integer.
pub const ROUNDER: f64 = 6_755_399_441_055_744.0;

/// Of sin y = y + y^3 (c0 + c1 y^2 + ...).
pub const SINE: [f64; 6] = [
    -0.166_666_666_666_666_32,
    0.008_333_333_333_322_49,
    -0.000_198_412_698_298_579_5,
    2.755_731_370_707_006_8e-06,
    -2.505_076_025_340_686_3e-08,
    1.589_690_995_211_55e-10,
];

/// Of cos y = 1 - y^2 / 2 + y^4 (c0 + c1 y^2 + ...).
pub const COSINE: [f64; 6] = [
    0.041_666_666_666_666_6,
    -0.001_388_888_888_887_411,
    2.480_158_728_947_673e-05,
    -2.755_731_435_139_066_3e-07,
    2.087_572_321_298_175e-09,
    -1.135_964_755_778_819_5e-11,
];

/// a b + c.
#[inline(always)]
fn fma<const FUSED: bool>(a: f64, b: f64, c: f64) -> f64 {
    if FUSED { a.mul_add(b, c) } else { a * b + c }
}

/// Sine and cosine of `x`, |x| up to [`LARGEST`], to about one unit in the last place.
#[inline(always)]
pub fn sin_cos<const FUSED: bool>(x: f64) -> (f64, f64) {
    let shifted = fma::<FUSED>(x, std::f64::consts::FRAC_2_PI, ROUNDER);
    let quadrant = shifted.to_bits();
    let turns = shifted - ROUNDER;
    // Products of 20 and 33 bits are exact; each difference is exact or leaves its rounding to the next.
    let first = x - turns * HALF_PI[0];
    let second = turns * HALF_PI[1];
    let reduced = first - second;
    let rest = turns * HALF_PI_REST - ((first - reduced) - second);
    let y = reduced - rest;
    let tail = (reduced - y) - rest;

    let z = y * y;
    let v = z * y;
    let of_sine = fma::<FUSED>(SINE[5], z, SINE[4]);
    let of_sine = fma::<FUSED>(fma::<FUSED>(fma::<FUSED>(of_sine, z, SINE[3]), z, SINE[2]), z, SINE[1]);
    let sine = y - (fma::<FUSED>(z, fma::<FUSED>(-v, of_sine, 0.5 * tail), -tail) - v * SINE[0]);
    let half = 0.5 * z;
    let whole = 1.0 - half;
    let of_cosine = fma::<FUSED>(fma::<FUSED>(COSINE[5], z, COSINE[4]), z, COSINE[3]);
    let of_cosine = fma::<FUSED>(fma::<FUSED>(fma::<FUSED>(of_cosine, z, COSINE[2]), z, COSINE[1]), z, COSINE[0]);
    let cosine = whole + (((1.0 - whole) - half) + fma::<FUSED>(z, z * of_cosine, -(y * tail)));

    // Quadrants 1 and 3 swap, 2 and 3 turn the sine's sign, 1 and 2 the cosine's.
    let swapped = quadrant & 1 == 1;
    let (s, c) = if swapped { (cosine, sine) } else { (sine, cosine) };
    let (of_sine, of_cosine) = ((quadrant & 2) << 62, (quadrant.wrapping_add(1) & 2) << 62);
    (f64::from_bits(s.to_bits() ^ of_sine), f64::from_bits(c.to_bits() ^ of_cosine))
}

/// The same for any `x`: beyond [`LARGEST`], and for what is not finite, by the standard library.
#[inline(always)]
pub fn sine_and_cosine<const FUSED: bool>(x: f64) -> (f64, f64) {
    if x.abs() <= LARGEST { sin_cos::<FUSED>(x) } else { far(x) }
}

#[cold]
#[inline(never)]
fn far(x: f64) -> (f64, f64) {
    x.sin_cos()
}

/// The same for those of several angles that the reduction is not good for.
#[cold]
#[inline(never)]
pub fn far_lanes(angles: &[f64], sines: &mut [f64], cosines: &mut [f64]) {
    for ((s, c), &x) in sines.iter_mut().zip(cosines).zip(angles) {
        if !(x.abs() <= LARGEST) {
            (*s, *c) = x.sin_cos();
        }
    }
}
