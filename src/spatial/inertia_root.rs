//! The square root S of a body's inertia, S S^T = M(k): what turns unit white noise into the body's process noise.

use super::body_inertia::BodyInertia;
use super::symmetric::Symmetric3;
use super::vector::skew;
use nalgebra::{Matrix3, Matrix6, SMatrix, Vector3};

/// A principal inertia this far below zero, relative to the largest, is the rounding of a zero (a rod, a point mass).
const ROUNDING: f64 = 64.0 * f64::EPSILON;

/// S of one rigid body from mass, mass centre and central inertia: [[`S_c`, sqrt(m) p~], [0, sqrt(m) 1]], `S_c` `S_c`^T = `I_c`.
///
/// It is not a Cholesky factor of M: from M the central inertia would first have to be found again by a subtraction.
/// None where the central inertia has a negative principal value.
pub(crate) fn inertia_root(mass: f64, centre: &Vector3<f64>, central: &Symmetric3<f64>) -> Option<Matrix6<f64>> {
    let root = mass.sqrt();
    let mut s = Matrix6::zeros();
    s.fixed_view_mut::<3, 3>(0, 0).copy_from(&central_root(central)?);
    s.fixed_view_mut::<3, 3>(0, 3).copy_from(&(skew(centre) * root));
    s.fixed_view_mut::<3, 3>(3, 3).copy_from(&(Matrix3::identity() * root));
    Some(s)
}

/// S of an inertia about the origin of its frame, where it is all that is known: the central inertia by subtraction.
pub(crate) fn root_of_merged(inertia: &BodyInertia<f64>) -> Option<Matrix6<f64>> {
    let (mass, moment) = (inertia.mass, &inertia.first_moment);
    if mass == 0.0 {
        return inertia_root(0.0, &Vector3::zeros(), &inertia.rotational);
    }
    let centre = moment / mass;
    let parallel = Matrix3::identity() * moment.dot(&centre) - moment * centre.transpose();
    inertia_root(mass, &centre, &Symmetric3::from_upper(&(inertia.rotational.to_matrix() - parallel)))
}

/// `S_c` from principal axes and values; from the entries themselves where the inertia is a diagonal.
fn central_root(central: &Symmetric3<f64>) -> Option<Matrix3<f64>> {
    let full = central.to_matrix();
    let [_, xy, xz, _, yz, _] = central.entries;
    let (axes, values) = if xy == 0.0 && xz == 0.0 && yz == 0.0 {
        (Matrix3::identity(), full.diagonal())
    } else {
        let principal = full.symmetric_eigen();
        (principal.eigenvectors, principal.eigenvalues)
    };
    let largest = values.amax();
    if values.iter().any(|&value| !(value >= -ROUNDING * largest)) {
        return None;
    }
    Some(axes * Matrix3::from_diagonal(&values.map(|value| if value > 0.0 { value.sqrt() } else { 0.0 })))
}

/// S of two bodies moving as one: [S1 S2] turned from the right to six columns, which leaves S1 S1^T + S2 S2^T as it is.
pub(crate) fn join_roots(first: &Matrix6<f64>, second: &Matrix6<f64>) -> Matrix6<f64> {
    if *first == Matrix6::zeros() {
        return *second;
    }
    if *second == Matrix6::zeros() {
        return *first;
    }
    let mut stacked = SMatrix::<f64, 12, 6>::zeros();
    stacked.fixed_view_mut::<6, 6>(0, 0).copy_from(&first.transpose());
    stacked.fixed_view_mut::<6, 6>(6, 0).copy_from(&second.transpose());
    stacked.qr().r().transpose()
}

#[cfg(test)]
mod tests {
    use super::*;
    fn body(mass: f64, seed: f64) -> (f64, Vector3<f64>, Symmetric3<f64>) {
        let axes = *nalgebra::Rotation3::new(Vector3::new(seed, 0.3, -seed)).matrix();
        let central = axes * Matrix3::from_diagonal(&Vector3::new(0.3, 0.4, 0.5 * seed)) * axes.transpose();
        (mass, Vector3::new(0.1, -0.2 * seed, 0.3), Symmetric3::from_upper(&central))
    }

    fn off(s: &Matrix6<f64>, inertia: &BodyInertia<f64>) -> f64 {
        (s * s.transpose() - inertia.to_symmetric().to_matrix()).amax()
    }

    #[test]
    fn root_times_its_transpose_is_the_inertia() {
        for (mass, centre, central) in [body(2.0, 1.0), body(0.5, 0.1), (1.0, Vector3::y(), Symmetric3::zero())] {
            let s = inertia_root(mass, &centre, &central).expect("positive");
            assert!(off(&s, &BodyInertia::from_central(mass, &centre, &central)) <= 1e-15);
        }
    }

    #[test]
    fn joined_roots_are_the_root_of_the_sum() {
        let (a, b) = (body(2.0, 1.0), body(0.5, 0.1));
        let both = BodyInertia::from_central(a.0, &a.1, &a.2).add(&BodyInertia::from_central(b.0, &b.1, &b.2));
        let (first, second) = (inertia_root(a.0, &a.1, &a.2), inertia_root(b.0, &b.1, &b.2));
        let s = join_roots(&first.expect("positive"), &second.expect("positive"));
        assert!(off(&s, &both) <= 2e-15);
    }

    #[test]
    fn the_root_of_a_sum_found_by_subtraction() {
        let (mass, centre, central) = body(2.0, 1.0);
        let inertia = BodyInertia::from_central(mass, &centre, &central);
        assert!(off(&root_of_merged(&inertia).expect("positive"), &inertia) <= 1e-15);
    }

    #[test]
    fn a_rod_has_a_root_and_a_negative_inertia_none() {
        let turned = *nalgebra::Rotation3::new(Vector3::new(0.4, -0.9, 0.2)).matrix();
        let rod = turned * Matrix3::from_diagonal(&Vector3::new(0.0, 1.0, 1.0)) * turned.transpose();
        assert!(inertia_root(1.0, &Vector3::zeros(), &Symmetric3::from_upper(&rod)).is_some());
        let wrong = Symmetric3::new([-1e-3, 0.0, 0.0, 1.0, 0.0, 1.0]);
        assert!(inertia_root(1.0, &Vector3::zeros(), &wrong).is_none());
    }
}
