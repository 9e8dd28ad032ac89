//! Sine and cosine of many states at once in generated code: the constants of [`trigonometry`], and the formulas that C
//! and Rust share.

use super::width::Width;
use crate::scalar::trigonometry;

/// Constants of the reduction to quarter turns and of the polynomials for scalars of one width.
pub(super) struct Sines {
    /// The largest absolute value, in radians, for which the reduction is valid.
    pub largest: f64,
    /// Adding and subtracting this value rounds to an integer, whose lowest bits are in the sum.
    pub rounder: f64,
    /// Quarter turns per radian.
    pub turns: f64,
    /// pi/2 in parts. The products of quarter turns with each part are exact without fused multiply-add.
    pub half_pi: [f64; 3],
    sine: &'static [f64],
    cosine: &'static [f64],
}

impl Sines {
    pub fn new(width: Width) -> Self {
        let turns = std::f64::consts::FRAC_2_PI;
        match width {
            Width::Double => Self {
                largest: trigonometry::LARGEST,
                rounder: trigonometry::ROUNDER,
                turns,
                half_pi: trigonometry::HALF_PI,
                sine: trigonometry::SINE,
                cosine: trigonometry::COSINE,
            },
            // Parts of 8 and 11 bits: their products with 13 bits of turns are exact without fused multiply-add.
            Width::Single => Self {
                largest: 8192.0,
                rounder: 12_582_912.0,
                turns,
                half_pi: [1.570_312_5, 4.837_512_969_970_703e-4, 7.549_789_954_891_88e-8],
                // Minimax fits for |y| <= 0.82 with an error of a tenth of a unit in the last place.
                sine: &[-0.166_666_507_720_947_27, 0.008_331_939_578_056_335, -0.000_194_859_763_723_798_1],
                cosine: &[0.041_666_638_106_107_71, -0.001_388_701_493_851_840_5, 2.439_963_645_883_836e-05],
            },
        }
    }

    /// The polynomials of z, the squared angle, as expressions: the factor of -y^3 without its first coefficient, that
    /// coefficient, and the factor of y^4 in the cosine.
    pub fn polynomials(&self, constant: &dyn Fn(f64) -> String) -> [String; 3] {
        let of_sine = horner(&self.sine[1..], constant);
        [of_sine, constant(-self.sine[0]), horner(self.cosine, constant)]
    }
}

/// The polynomial of z with these coefficients, in ascending order.
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
