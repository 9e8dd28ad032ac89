//! `DoubleDouble` compared with mpmath at 60 digits, and with identities.
//!
//! The tables are the output of this script (Python 3.11, mpmath 1.4.1, `python script.py | rustfmt`):
//!
//! ```python
//! from mpmath import *; from struct import pack; import random
//! mp.dps = 60; random.seed(1)
//! bits = lambda f: "0x" + "_".join([(h := pack(">d", f).hex())[i:i+4] for i in (0, 4, 8, 12)])
//! pair = lambda x: (float(x), float(x - mpf(float(x))))
//! show = lambda x: "(%s, %s)" % tuple(map(bits, pair(x)))
//! value = lambda p: mpf(p[0]) + mpf(p[1])
//! draw = lambda size: value(pair(mpf(random.uniform(-1, 1)) * size * (1 + mpf(random.getrandbits(120)) / 2**140)))
//! for _ in range(6):
//!     a, b = draw(mpf(10) ** random.randint(-9, 9)), draw(mpf(10) ** random.randint(-9, 9))
//!     print("    [" + ", ".join(map(show, (a, b, a + b, a - b, a * b, a / b, sqrt(abs(a))))) + "],")
//! print()
//! for size in ("0.7", "3", "3.15", "100", "1e4", "1e8", "1e12"):
//!     x = draw(mpf(size)); print("    [" + ", ".join(map(show, (x, sin(x), cos(x)))) + "],")
//! x = value(pair(355 * pi)); print("    [" + ", ".join(map(show, (x, sin(x), cos(x)))) + "],")
//! x = mpf(2**40); print("    [" + ", ".join(map(show, (x, sin(x), cos(x)))) + "],")
//! ```

use num_traits::{One, Zero};
use phipsi::scalar::{DoubleDouble, Real};

/// The bits of a high and a low part.
type Bits = (u64, u64);

/// a, b, a + b, a - b, a b, a / b, sqrt |a|. The last row is not from the script: of 12 000 pairs, it is the
/// one whose quotient has the largest error (5.4 u^2) if long division stops after two digits.
const ARITHMETIC: [[Bits; 7]; 7] = [
    [
        (0x3eb7_3891_abd8_362b, 0xbb35_9f56_04d1_74a8),
        (0xbe43_9b2d_383b_6be7, 0x3aee_e616_9fc5_bdb4),
        (0x3eb7_115b_5167_bf53, 0x3b3d_57da_b02c_b946),
        (0x3eb7_5fc8_0648_ad03, 0xbb52_25a1_ae73_e8a5),
        (0xbd0c_7462_9ff7_6d3b, 0xb9a2_164f_6fe8_79f9),
        (0xc062_f32f_6047_5c65, 0xbcf5_fa0c_5251_e8c9),
        (0x3f53_4677_4c02_608e, 0x3be3_4edf_ab3e_72a3),
    ],
    [
        (0xbf4a_9de8_70db_e7e7, 0xbbe3_e199_cfa2_d87c),
        (0x40a0_c985_8c9c_5e15, 0x3d4d_b977_25bf_791f),
        (0x40a0_c985_2224_bc52, 0x3d0d_18fd_6391_1e07),
        (0xc0a0_c985_f713_ffd9, 0x3d29_7a86_2ae8_7e8a),
        (0xbffb_ed26_536b_ae96, 0x3c89_dfbc_71bd_0672),
        (0xbe99_5e62_f61f_8e3b, 0xbb2b_d8f0_e666_08cd),
        (0x3f9d_2f3f_45cc_02df, 0xbc3d_9107_12ff_c091),
    ],
    [
        (0x3fa6_af8a_2291_a3fd, 0x3c2c_c709_20e4_7a26),
        (0xc022_c6c2_34a7_5d1f, 0xbca4_1c52_acaf_feed),
        (0xc022_b012_aa84_cb7b, 0xbca6_ff8b_a38f_1a73),
        (0x4022_dd71_bec9_eec3, 0x3ca1_3919_b5d0_e367),
        (0xbfda_9f4b_0f62_531b, 0x3c7e_546f_3922_7f0c),
        (0xbf73_54cc_8a4b_076b, 0xbc17_6c0e_a6ed_ad20),
        (0x3fca_f17d_5dbc_aa5a, 0x3c5f_455f_11e9_50fc),
    ],
    [
        (0x4077_4f7b_c697_3483, 0xbce5_a5df_2502_c90c),
        (0xc155_3bb6_66fe_9908, 0xbdfb_2412_ae91_7377),
        (0xc155_3b59_290f_7eac, 0x3df9_5ee2_7e7e_fa08),
        (0x4155_3c13_a4ed_b365, 0x3def_4e0f_b743_c1eb),
        (0xc1de_ef51_4b40_5749, 0x3e6d_f42b_00f9_8d0e),
        (0xbf11_90b5_455b_086d, 0xbbb7_910b_88fc_3789),
        (0x4033_4ff7_9f4e_3751, 0xbcd3_53df_886e_ceb6),
    ],
    [
        (0xbf69_47cb_e860_22dd, 0xbc0b_07eb_9bef_b7ef),
        (0x3feb_4be3_6333_0807, 0x3c81_0e05_a37d_f8be),
        (0x3feb_329b_974a_a7e4, 0x3c89_b2fd_b7e2_0906),
        (0xbfeb_652b_2f1b_682a, 0xbc70_d21b_1e33_d0ec),
        (0xbf65_9087_f5a6_a6c2, 0xbbe5_db84_a929_007f),
        (0xbf6d_a2fa_781a_8c8b, 0xbbfb_2d5b_7183_9dd8),
        (0x3fac_7146_3fcb_12e5, 0xbc3c_43be_4576_e5a0),
    ],
    [
        (0xbea5_1417_3ded_a58a, 0xbb3a_fc62_14fa_cf01),
        (0x3ea0_513b_0bfe_91e6, 0xbb32_ac54_bc9c_d983),
        (0xbe83_0b70_c7bc_4e91, 0xbb2b_516d_a32f_5108),
        (0xbeb2_b2a9_24f6_1bb8, 0xbb20_a01a_b0bb_eafc),
        (0xbd55_7f1a_bd7a_0c1d, 0xb98a_453d_1fb9_1d9b),
        (0xbff4_ab28_7a5e_5f1e, 0x3c72_bebc_1157_2d2f),
        (0x3f49_f8aa_cea0_c341, 0xbbc1_e99a_c21b_3285),
    ],
    [
        (0x3d74_c508_29d5_6c41, 0xba1b_3282_e35c_eb0c),
        (0xc133_d05d_d1bd_be49, 0xbddf_22f0_770b_4f3a),
        (0xc133_d05d_d1bd_be49, 0xbdde_cfdc_5663_f989),
        (0x4133_d05d_d1bd_be49, 0x3ddf_7604_97b2_a4eb),
        (0xbeb9_b874_e550_c34b, 0x3b5f_3b53_a07b_c685),
        (0xbc30_c592_0622_b9a6, 0x38a6_871b_73b8_f533),
        (0x3eb2_3ac0_3184_58c5, 0x3b34_0208_ca4a_257a),
    ],
];

/// x, sin x, cos x: up to 0.7, 3, 3.15, 100, 1e4, 1e8, 1e12; the pair nearest to 355 pi; and 2^40.
const CIRCULAR: [[Bits; 3]; 9] = [
    [
        (0x3f52_57dd_0a2b_ad5b, 0xbbd7_0791_9b85_3dc7),
        (0x3f52_57dc_c9e0_fd80, 0x3bef_7687_c030_11f8),
        (0x3fef_fffe_af86_c4e4, 0xbc7f_ff44_92d9_18a3),
    ],
    [
        (0x4003_b05b_591f_6a51, 0x3c90_284a_ef2d_890e),
        (0x3fe4_2222_a098_6301, 0xbc6b_c474_01d6_af9a),
        (0xbfe8_df65_d0cd_c0a0, 0xbc8d_e2cc_442e_cbce),
    ],
    [
        (0x4007_dca9_8fc5_c56b, 0x3ca2_35d9_1e29_cbf5),
        (0x3fc4_3f3f_98dd_1a31, 0x3c64_6e5e_444a_d15c),
        (0xbfef_98dd_6885_d713, 0xbc82_1afb_1880_26b1),
    ],
    [
        (0xc035_544b_b71d_4a7a, 0xbca4_8e07_6a45_222e),
        (0xbfe3_aabc_2e94_10a3, 0xbc85_e490_3426_4ebc),
        (0xbfe9_3e38_b3b9_6e10, 0x3c70_e230_97d7_9b62),
    ],
    [
        (0x40b3_0a9d_2937_047c, 0x3d33_98eb_235f_2b19),
        (0xbfed_0c48_e7da_426d, 0xbc41_f4a1_4e88_8609),
        (0x3fda_d94a_83f9_f962, 0x3c65_81e2_1a5f_9853),
    ],
    [
        (0xc179_5819_2cf0_f904, 0xbe18_e07c_76b8_64f2),
        (0x3fc8_16e1_a4a6_9edb, 0xbc3a_645b_0941_9a7f),
        (0xbfef_6d9e_1a25_f1d8, 0xbc73_6c75_577f_8985),
    ],
    [
        (0x425b_bb60_a40a_b424, 0xbef8_3445_c783_7705),
        (0xbfef_9cff_8c5c_4c00, 0xbc73_9dc7_dbeb_f605),
        (0x3fc3_d6f7_5469_a3a7, 0x3c5c_0b76_12de_e3ad),
    ],
    [
        (0x4091_6d0f_c2ed_4544, 0x3d35_3cb3_7c6a_9dcf),
        (0xb9cd_8813_e843_9b94, 0xb664_0907_bd90_94db),
        (0xbff0_0000_0000_0000, 0x339b_8000_0000_0000),
    ],
    [
        (0x4270_0000_0000_0000, 0x0000_0000_0000_0000),
        (0xbfd9_f712_2716_d5d9, 0x3c67_257f_e2bc_a377),
        (0xbfed_3f85_77b3_aa88, 0xbc7d_886b_706b_cc12),
    ],
];

/// 2^-104, about 4.9e-32.
const EPSILON: f64 = f64::EPSILON * f64::EPSILON;

fn pair((high, low): Bits) -> DoubleDouble {
    DoubleDouble { high: f64::from_bits(high), low: f64::from_bits(low) }
}

/// `found - expected`, computed without the arithmetic under test: the high parts nearly agree, so that their
/// difference is exact.
fn difference(found: DoubleDouble, expected: DoubleDouble) -> f64 {
    (found.high - expected.high) + (found.low - expected.low)
}

/// Fails on NaN too.
fn assert_relative(what: &str, found: DoubleDouble, expected: DoubleDouble, tolerance: f64) {
    let error = difference(found, expected).abs() / expected.high.abs();
    assert!(error <= tolerance, "{what}: {found:?} for {expected:?}, off by {error:e}");
}

fn is_nan(x: DoubleDouble) -> bool {
    x.high.is_nan() && x.lane(0).is_nan() && x != x.abs()
}

#[test]
fn arithmetic_agrees_with_mpmath() {
    for row in ARITHMETIC {
        let [a, b, sum, difference, product, quotient, root] = row.map(pair);
        assert_relative("sum", a + b, sum, EPSILON);
        assert_relative("difference", a - b, difference, EPSILON);
        assert_relative("product", a * b, product, EPSILON);
        assert_relative("quotient", a / b, quotient, EPSILON);
        assert_relative("square root", a.abs().sqrt(), root, EPSILON);
        assert_relative("reciprocal", b.recip() * a, quotient, 3.0 * EPSILON);
    }
}

#[test]
fn assignment_is_the_operation() {
    let [a, b, ..] = ARITHMETIC[0].map(pair);
    let assigned = |operation: fn(&mut DoubleDouble, DoubleDouble)| {
        let mut x = a;
        operation(&mut x, b);
        x
    };
    assert_eq!(assigned(|x, y| *x += y), a + b);
    assert_eq!(assigned(|x, y| *x -= y), a - b);
    assert_eq!(assigned(|x, y| *x *= y), a * b);
    assert_eq!(assigned(|x, y| *x /= y), a / b);
}

#[test]
fn sine_and_cosine_agree_with_mpmath() {
    for row in CIRCULAR {
        let [x, sine, cosine] = row.map(pair);
        for (sign, angle) in [(1.0, x), (-1.0, -x)] {
            let (found_sine, found_cosine) = angle.sin_cos();
            let sine_error = difference(found_sine * DoubleDouble::from_f64(sign), sine).abs();
            let cosine_error = difference(found_cosine, cosine).abs();
            assert!(sine_error <= 1e-31, "sin {angle}: off by {sine_error:e}");
            assert!(cosine_error <= 1e-31, "cos {angle}: off by {cosine_error:e}");
        }
    }
}

#[test]
fn sine_and_cosine_stop_at_their_range() {
    let largest = (2f64).powi(40);
    let (sine, cosine) = DoubleDouble::from_f64(-largest).sin_cos();
    assert!(sine.high.is_finite() && cosine.high.is_finite());
    for angle in [2.0 * largest, -2.0 * largest, f64::INFINITY, f64::NAN] {
        let (sine, cosine) = DoubleDouble::from_f64(angle).sin_cos();
        assert!(is_nan(sine) && is_nan(cosine), "angle {angle}");
    }
}

#[test]
fn squares_of_sine_and_cosine_sum_to_one() {
    // Multiples of 1/7 are not representable: both parts of the angle are nonzero.
    let step = DoubleDouble::from_f64(7.0).recip();
    for i in -200..=200 {
        let angle = DoubleDouble::from_f64(f64::from(i)) * step;
        let (sine, cosine) = angle.sin_cos();
        let error = difference(sine * sine + cosine * cosine, DoubleDouble::one()).abs();
        assert!(error <= 1e-31, "angle {angle}: off by {error:e}");
    }
}

#[test]
fn division_and_square_root_undo() {
    for row in ARITHMETIC {
        let [a, b, ..] = row.map(pair);
        assert_relative("(a / b) b", a / b * b, a, 2.0 * EPSILON);
        assert_relative("(a b) / b", a * b / b, a, 2.0 * EPSILON);
        let root = a.abs().sqrt();
        assert_relative("sqrt(a)^2", root * root, a.abs(), 2.0 * EPSILON);
        assert_eq!(a - a, DoubleDouble::zero());
    }
}

#[test]
fn results_are_normalised() {
    for row in ARITHMETIC {
        let [a, b, ..] = row.map(pair);
        let (sine, cosine) = a.sin_cos();
        for x in [a + b, a - b, a * b, a / b, a.abs().sqrt(), sine, cosine, DoubleDouble::from_parts(b.low, b.high)] {
            assert!((x.high + x.low).to_bits() == x.high.to_bits(), "{x:?}");
        }
    }
}

#[test]
fn it_holds_twice_the_digits_of_f64() {
    let one = DoubleDouble::one();
    let small = DoubleDouble::from_f64(2f64.powi(-100));
    assert_eq!((one + small) - one, small);
    assert!(one < one + small && one - small < one);
    assert_eq!(DoubleDouble::epsilon(), DoubleDouble::from_f64(2f64.powi(-104)));
    assert_eq!(DoubleDouble::LANES, 1);
    let third = DoubleDouble::from_f64(3.0).recip();
    assert_eq!(third.lane(0).to_bits(), (1.0_f64 / 3.0).to_bits());
}

#[test]
fn zero_keeps_its_meaning() {
    let zero = DoubleDouble::zero();
    assert!(zero.is_zero() && (-zero).is_zero());
    assert_eq!(zero.sqrt(), zero);
    assert_eq!((-zero).abs(), zero);
    assert!(!DoubleDouble::from_f64(f64::MIN_POSITIVE).is_zero());
}

#[test]
fn nan_comes_through_every_operation() {
    let nan = DoubleDouble::from_f64(f64::NAN);
    let one = DoubleDouble::one();
    for x in [nan + one, one + nan, nan - one, nan * one, one * nan, nan / one, one / nan] {
        assert!(is_nan(x), "{x:?}");
    }
    for x in [-nan, nan.sqrt(), nan.recip(), nan.abs(), nan * DoubleDouble::zero()] {
        assert!(is_nan(x), "{x:?}");
    }
    assert!(is_nan(one / DoubleDouble::zero()));
    assert!(is_nan((-one).sqrt()));
    assert!(nan.partial_cmp(&one).is_none());
}

#[test]
fn worst_is_the_smaller_one_or_nan() {
    let one = DoubleDouble::one();
    let less = one - DoubleDouble::from_f64(2f64.powi(-100));
    let nan = DoubleDouble::from_f64(f64::NAN);
    let infinity = DoubleDouble::from_f64(f64::INFINITY);
    assert_eq!(one.worst(less), less);
    assert_eq!(less.worst(one), less);
    assert_eq!(infinity.worst(one), one);
    assert_eq!(one.worst(one), one);
    assert!(is_nan(one.worst(nan)) && is_nan(nan.worst(one)) && is_nan(nan.worst(nan)));
}

#[test]
fn matrices_take_it() {
    // nalgebra's product needs exactly the bounds of `Real`.
    let third = DoubleDouble::from_f64(3.0).recip();
    let matrix = nalgebra::Matrix2::new(third, third, -third, third);
    let product = matrix * matrix.transpose();
    assert_relative("diagonal", product[(0, 0)], third * third + third * third, EPSILON);
    assert!(product[(0, 1)].is_zero());
}

#[test]
fn display_shows_the_digits() {
    let number = |x: f64| DoubleDouble::from_f64(x);
    let shown = |x: DoubleDouble| x.to_string();
    assert_eq!(shown(number(1.0)), "1.000000000000000000000000000000e0");
    assert_eq!(shown(number(-0.5)), "-5.000000000000000000000000000000e-1");
    // mp.nstr(mpf(1)/3, 31), mp.nstr(mpf(2)/3, 31), mp.nstr(sqrt(mpf(2)) * 100, 31)
    assert_eq!(shown(number(3.0).recip()), "3.333333333333333333333333333333e-1");
    assert_eq!(shown(number(2.0) / number(3.0)), "6.666666666666666666666666666667e-1");
    assert_eq!(shown(number(2.0).sqrt() * number(100.0)), "1.414213562373095048801688724210e2");
    // mp.nstr(mpf(2)**1000, 29), mp.nstr(mpf(2)**-900, 29): the powers are exact, the scaling costs a digit.
    assert_eq!(format!("{:.28}", number(2f64.powi(1000))), "1.0715086071862673209484250491e301");
    assert_eq!(format!("{:.28}", number(2f64.powi(-900))), "1.1830521861667747109727515975e-271");
    assert_eq!(format!("{:.0}", number(17.0)), "2e1");
    assert_eq!(format!("{:.2}", number(9.999)), "1.00e1");
    assert_eq!(format!("{:.3}", DoubleDouble::from_parts(1.0, -1e-20)), "1.000e0");
    assert_eq!(format!("{:.3}", DoubleDouble::from_parts(10.0, -1e-20)), "1.000e1");
    assert_eq!(shown(DoubleDouble::zero()), "0");
    assert_eq!(shown(number(f64::NAN)), "NaN");
}
