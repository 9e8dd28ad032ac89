//! Checks whether the inertia of a link is physical, that is, whether a mass distribution has it.

use super::description::Inertial;
use crate::decompositions::eigenvalues;
use crate::error::{Error, number};
use crate::spatial::Symmetric3;

/// Tolerance for the rounding of values in a file, relative to the largest principal inertia.
///
/// Most exporters write six significant digits, so that every entry has a relative error of up to 5e-6. For a thin
/// plate, which satisfies the triangle inequality with equality, this changes the largest principal inertia J by up to
/// 5e-6 sqrt(2) J and the trace by up to 1e-5 J, hence 2 J - trace by up to (2 sqrt(2) + 2) 5e-6 J = 2.4e-5 J. The
/// smallest principal inertia of a rod changes by less. Files with fewer digits get the warning, because their errors
/// cannot be distinguished from wrong values. No robot of example-robot-data is near the limit: 56 links in 18 of its
/// 69 files (17 names, anymal.urdf twice) violate the conditions by 1.8e-3 or more; all other links satisfy them to
/// 1e-15.
const ROUNDING: f64 = 2.5e-5;

/// Rejects NaN, infinities and a negative mass.
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

/// Describes a nonphysical inertia: a negative principal inertia, or one larger than the sum of the other two.
pub(super) fn unphysical(inertial: &Inertial) -> Option<String> {
    let Some([low, middle, high]) = principal(&inertial.central) else {
        return Some("principal inertias that are not finite".to_owned());
    };
    let slack = ROUNDING * high.abs().max(low.abs());
    if low < -slack {
        return Some(format!("principal inertias {low:.3e}, {middle:.3e}, {high:.3e}, one of them negative"));
    }
    if high > low + middle + slack {
        return Some(format!("principal inertias {low:.3e}, {middle:.3e}, {high:.3e} violate the triangle inequality"));
    }
    None
}

/// Largest radius of gyration of a moving link, relative to the size of the scene. Inertias in kg mm^2 give 1,000 times
/// the radius of those in kg m^2, which is at most 2.5 times the size in the files of example-robot-data.
const LARGEST_GYRATION: f64 = 30.0;

/// The root mean square distance of the mass of a link from its center, m, if that is far beyond the size of the
/// scene, m.
pub(super) fn far_gyration(inertial: &Inertial, size: f64) -> Option<f64> {
    // Half the trace is the integral of the squared distance from the center of mass.
    let [xx, _, _, yy, _, zz] = inertial.central.entries;
    let radius = (0.5 * (xx + yy + zz) / inertial.mass).sqrt();
    (inertial.mass > 0.0 && size > 0.0 && radius > LARGEST_GYRATION * size).then_some(radius)
}

/// Principal inertias in ascending order; None if they are not finite.
fn principal(inertia: &Symmetric3<f64>) -> Option<[f64; 3]> {
    let mut values: [f64; 3] = eigenvalues(inertia.to_matrix())?.eigenvalues.into();
    values.sort_by(f64::total_cmp);
    Some(values)
}
