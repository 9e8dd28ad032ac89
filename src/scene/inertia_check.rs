//! Whether a link's inertia is one that a distribution of mass can have.

use super::description::Inertial;
use crate::error::Error;
use crate::spatial::Symmetric3;

/// Slack for the decimal digits that a file rounds its numbers to, relative to the largest principal inertia.
const ROUNDING: f64 = 1e-6;

/// Refuses NaN, infinities and negative mass.
pub(super) fn check_numbers(link: &str, inertial: &Inertial) -> Result<(), Error> {
    let refuse = |what: &str, value: f64, expected: &str| {
        Err(Error::scene(format!("link {link:?}"), format!("{what} {value}"), expected))
    };
    if !inertial.mass.is_finite() || inertial.mass < 0.0 {
        return refuse("mass", inertial.mass, "a finite mass, zero or positive");
    }
    if let Some(value) = inertial.centre.iter().find(|x| !x.is_finite()) {
        return refuse("mass centre with", *value, "finite coordinates");
    }
    if let Some(value) = inertial.central.entries.iter().find(|x| !x.is_finite()) {
        return refuse("inertia with", *value, "finite entries");
    }
    Ok(())
}

/// What is unphysical about an inertia, if anything: a negative principal inertia, or one larger than the other two together.
pub(super) fn unphysical(inertial: &Inertial) -> Option<String> {
    let [low, middle, high] = principal(&inertial.central);
    let slack = ROUNDING * high.abs();
    if low < -slack {
        return Some(format!("principal inertias {low:.3e}, {middle:.3e}, {high:.3e}, one of them negative"));
    }
    if high > low + middle + slack {
        return Some(format!("principal inertias {low:.3e}, {middle:.3e}, {high:.3e} break the triangle inequality"));
    }
    None
}

/// Principal inertias, ascending.
fn principal(inertia: &Symmetric3<f64>) -> [f64; 3] {
    let mut values: [f64; 3] = inertia.to_matrix().symmetric_eigenvalues().into();
    values.sort_by(f64::total_cmp);
    values
}
