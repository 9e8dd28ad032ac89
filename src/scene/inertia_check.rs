//! Whether a link's inertia is one that a distribution of mass can have.

use super::description::Inertial;
use crate::error::{Error, number};
use crate::spatial::Symmetric3;

/// Slack for the rounding of a file's numbers, relative to the largest principal inertia.
///
/// Most exporters write six significant digits, so every entry is off by up to 5e-6 of itself. For a thin plate, which
/// meets the triangle inequality as an equality, that shifts the largest principal inertia J by up to 5e-6 sqrt(2) J and
/// the sum of the three by up to 1e-5 J, so 2 J - sum by up to (2 sqrt(2) + 2) 5e-6 J = 2.4e-5 J; the smallest of a rod
/// by less. Coarser files get the warning: nothing tells them from wrong ones. In example-robot-data nothing lies near:
/// of its 69 files 18 (17 names, anymal.urdf twice) have 56 links that break the rules, by 1.8e-3 and more; all other
/// links keep them to 1e-15.
const ROUNDING: f64 = 2.5e-5;

/// Refuses NaN, infinities and negative mass.
pub(super) fn check_numbers(link: &str, inertial: &Inertial) -> Result<(), Error> {
    let refuse = |what: &str, value: f64, expected: &str| {
        Err(Error::scene(format!("link {link:?}"), format!("{what} {}", number(value)), expected))
    };
    if !inertial.mass.is_finite() || inertial.mass < 0.0 {
        return refuse("mass", inertial.mass, "a finite mass, zero or positive");
    }
    if let Some(value) = inertial.center.iter().find(|x| !x.is_finite()) {
        return refuse("center of mass with", *value, "finite coordinates");
    }
    if let Some(value) = inertial.central.entries.iter().find(|x| !x.is_finite()) {
        return refuse("inertia with", *value, "finite entries");
    }
    Ok(())
}

/// What is unphysical about an inertia, if anything: a negative principal inertia, or one larger than the other two together.
pub(super) fn unphysical(inertial: &Inertial) -> Option<String> {
    let [low, middle, high] = principal(&inertial.central);
    let slack = ROUNDING * high.abs().max(low.abs());
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
