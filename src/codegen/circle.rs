//! Sine and cosine of many states at once, for what is written: the constants of [`Circle`], and the formulas in
//! signs that C and Rust share.

use super::width::Width;
use crate::scalar::Circle;

/// Constants of the reduction to quarter turns and of the polynomials for scalars of one width.
pub(super) struct Sines {
    /// The largest absolute value, in radians, that the reduction is good for.
    pub largest: f64,
    /// Added and taken away again, it rounds to an integer, whose lowest bits the sum has.
    pub rounder: f64,
    /// Quarter turns of a radian.
    pub turns: f64,
    /// pi/2 in parts; whole turns times each of them are numbers, without fused products.
    pub half_pi: [f64; 3],
    sine: &'static [f64],
    cosine: &'static [f64],
}

impl Sines {
    pub fn new(width: Width) -> Self {
        let turns = std::f64::consts::FRAC_2_PI;
        match width {
            Width::Double => Self {
                largest: f64::LARGEST,
                rounder: f64::ROUNDER,
                turns,
                half_pi: f64::HALF_PI,
                sine: f64::SINE,
                cosine: f64::COSINE,
            },
            // Parts of 8 and 11 bits: times 13 bits of turns they are numbers where no product is fused.
            Width::Single => Self {
                largest: 8192.0,
                rounder: f32::ROUNDER,
                turns,
                half_pi: [1.570_312_5, 4.837_512_969_970_703e-4, 7.549_789_954_891_88e-8],
                sine: f32::SINE,
                cosine: f32::COSINE,
            },
        }
    }

    /// The polynomials of z, the squared angle, as expressions: what multiplies -y^3 but its first coefficient, that
    /// coefficient, and what multiplies y^4 in the cosine.
    pub fn polynomials(&self, constant: &dyn Fn(f64) -> String) -> [String; 3] {
        let of_sine = horner(&self.sine[1..], constant);
        [of_sine, constant(-self.sine[0]), horner(self.cosine, constant)]
    }
}

/// The polynomial of z with these coefficients, the lowest first.
fn horner(coefficients: &[f64], constant: &dyn Fn(f64) -> String) -> String {
    let (last, others) = (coefficients[coefficients.len() - 1], &coefficients[..coefficients.len() - 1]);
    let mut text = constant(last);
    for (index, &c) in others.iter().rev().enumerate() {
        let sign = if c < 0.0 { '-' } else { '+' };
        let product = if index == 0 { format!("{text} * z") } else { format!("({text}) * z") };
        text = format!("{product} {sign} {}", constant(c.abs()));
    }
    text
}
