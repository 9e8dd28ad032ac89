//! Square root of the inertia of a body, M(k) = L W L^T, and the bias force of its motion in the form b = L y + r.
//!
//! In square-root form the bias is propagated as the coordinates y. If it were added as a force, the rounding error of
//! the bias of a heavy body would dominate the forces of light bodies inboard of it.

use super::body_inertia::BodyInertia;
use super::rigid_shift::RigidShift;
use super::root::{Root6, RootColumns};
use super::symmetric::Symmetric3;
use super::vector::{angular, cross, cross_add, linear};
use crate::decompositions::eigenvalues;
use crate::scalar::Real;
use nalgebra::{Matrix3, Matrix3x6, Scalar, Vector3, Vector6};

/// A negative principal inertia above this, relative to the largest, is a rounding error of zero (a rod, a point mass).
const ROUNDING: f64 = 64.0 * f64::EPSILON;

/// Square root of an inertia in terms of the body parameters: L = [[1, 0], [p~, `L_c`]] with linear rows first, and
/// weights m and `W_c`, where `I_c` = `L_c` `W_c` `L_c`^T is the central inertia.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BodyRoot<T> {
    /// Mass m.
    pub(crate) mass: T,
    /// p, from the joint to the center of mass.
    pub(crate) center: Vector3<T>,
    /// `L_c`.
    pub(crate) central: Matrix3<T>,
    /// `W_c`.
    pub(crate) weights: Vector3<T>,
    /// B, where w x `I_c` w = `L_c` B q(w) + C q(w) for the six products q(w) of the components of w.
    pub(crate) spin: Matrix3x6<T>,
    /// C, which is zero for physical inertias.
    pub(crate) rest: Matrix3x6<T>,
}

impl<T: Real> BodyRoot<T> {
    /// The square root of zero inertia.
    #[must_use]
    pub fn zero() -> Self {
        let o = T::zero();
        Self {
            mass: o,
            center: Vector3::from_element(o),
            central: Matrix3::identity(),
            weights: Vector3::from_element(o),
            spin: Matrix3x6::from_element(o),
            rest: Matrix3x6::from_element(o),
        }
    }

    /// The inertia of this square root.
    pub(crate) fn inertia(&self) -> BodyInertia<T> {
        let (central, weights) = (&self.central, &self.weights);
        let full = central * Matrix3::from_diagonal(weights) * central.transpose();
        BodyInertia::from_central(self.mass, &self.center, &Symmetric3::from_upper(&full))
    }

    /// L and W.
    #[inline(always)]
    #[must_use]
    pub fn to_root(&self) -> Root6<T> {
        let (o, m, [x, y, z]) = (self.mass.constant(0.0), self.mass, [self.center[0], self.center[1], self.center[2]]);
        let (c, w) = (&self.central, &self.weights);
        Root6 {
            weights: [m, m, m, w[0], w[1], w[2]],
            rows: [
                [o; 6],
                [o; 6],
                [o; 6],
                [o, -z, y, o, o, o],
                [z, o, -x, c[(1, 0)], o, o],
                [-y, x, o, c[(2, 0)], c[(2, 1)], o],
            ],
        }
    }

    /// (y, r) of the force L y + r for this velocity and spatial acceleration; linear entries of y first, in the order
    /// of the columns of L. About 90 products.
    #[inline(always)]
    #[must_use]
    pub fn coordinates(&self, velocity: &Vector6<T>, acceleration: &Vector6<T>) -> ([T; 6], Vector3<T>) {
        let (w, u) = (angular(velocity), linear(velocity));
        let (alpha, a) = (angular(acceleration), linear(acceleration));
        // m times the acceleration of the center of mass.
        let moving = cross(&w, &u);
        let center = cross_add(&alpha, &self.center, &cross(&w, &cross(&w, &self.center)));
        let pushed = [
            (a[0] + moving[0] + center[0]) * self.mass,
            (a[1] + moving[1] + center[1]) * self.mass,
            (a[2] + moving[2] + center[2]) * self.mass,
        ];
        let c = &self.central;
        let products = [w[0] * w[0], w[1] * w[1], w[2] * w[2], w[0] * w[1], w[0] * w[2], w[1] * w[2]];
        let turned = [
            c[(2, 0)].mul_add(alpha[2], c[(1, 0)].mul_add(alpha[1], alpha[0])),
            c[(2, 1)].mul_add(alpha[2], alpha[1]),
            alpha[2],
        ];
        let (spin, rest) = (&self.spin, &self.rest);
        let turning = [
            self.weights[0].mul_add(turned[0], form(spin, 0, &products)),
            self.weights[1].mul_add(turned[1], form(spin, 1, &products)),
            self.weights[2].mul_add(turned[2], form(spin, 2, &products)),
        ];
        let rest = Vector3::new(form(rest, 0, &products), form(rest, 1, &products), form(rest, 2, &products));
        ([pushed[0], pushed[1], pushed[2], turning[0], turning[1], turning[2]], rest)
    }
}

/// Row `i` of a matrix times the products of w.
#[inline(always)]
fn form<T: Real>(m: &Matrix3x6<T>, i: usize, products: &[T; 6]) -> T {
    let mut sum = m[(i, 0)] * products[0];
    for j in 1..6 {
        sum = m[(i, j)].mul_add(products[j], sum);
    }
    sum
}

impl<M: Scalar + Copy> BodyRoot<M> {
    /// Applies a function to every number.
    pub(crate) fn map<N: Scalar>(&self, number: impl Fn(M) -> N + Copy) -> BodyRoot<N> {
        BodyRoot {
            mass: number(self.mass),
            center: self.center.map(number),
            central: self.central.map(number),
            weights: self.weights.map(number),
            spin: self.spin.map(number),
            rest: self.rest.map(number),
        }
    }
}

impl BodyRoot<f64> {
    /// From mass, center of mass and the square root of the central inertia.
    fn new(mass: f64, center: Vector3<f64>, (central, weights): (Matrix3<f64>, Vector3<f64>)) -> Self {
        let (spin, rest) = spin_of(&central, &weights);
        Self { mass, center, central, weights, spin, rest }
    }

    /// The same values in another scalar type; in a wider type B and C are recomputed.
    pub(crate) fn cast<U: Real>(&self) -> BodyRoot<U> {
        let same = self.map(U::from_f64);
        if !(U::epsilon().lane(0) < f64::EPSILON) {
            return same;
        }
        let (spin, rest) = spin_of(&same.central, &same.weights);
        BodyRoot { spin, rest, ..same }
    }

    /// The same body in another frame with the same origin; `frame` rotates from this frame to that one.
    pub(crate) fn turned(&self, frame: &Matrix3<f64>) -> Self {
        if *frame == Matrix3::identity() {
            return *self;
        }
        Self::new(self.mass, frame * self.center, triangular(&(frame * self.central), &self.weights))
    }

    /// True if the inertia is positive definite.
    pub(crate) fn is_definite(&self) -> bool {
        self.mass > 0.0 && self.weights.iter().all(|&weight| weight > 0.0)
    }

    /// True if the inertia is zero.
    fn is_zero(&self) -> bool {
        self.mass == 0.0 && self.weights == Vector3::zeros()
    }
}

/// B and C: w x `I_c` w as a linear map of the products of w, multiplied by the inverse of `L_c`. For a zero weight,
/// the row of B must vanish; the remainder is part of C.
fn spin_of<T: Real>(central: &Matrix3<T>, weights: &Vector3<T>) -> (Matrix3x6<T>, Matrix3x6<T>) {
    let zero = T::zero();
    let inertia = central * Matrix3::from_diagonal(weights) * central.transpose();
    let [x, y, z] = [inertia[(0, 0)], inertia[(1, 1)], inertia[(2, 2)]];
    let [xy, xz, yz] = [inertia[(0, 1)], inertia[(0, 2)], inertia[(1, 2)]];
    // w x I w in the products of w: squares, then xy, xz, yz.
    #[rustfmt::skip]
    let gyroscopic = Matrix3x6::new(
        zero, yz, -yz, xz, -xy, z - y,
        -xz, zero, xz, -yz, x - z, xy,
        xy, -xy, zero, y - x, yz, -xz,
    );
    let mut spin = gyroscopic;
    for i in 1..3 {
        for j in 0..i {
            let above = spin.row(j) * central[(i, j)];
            let mut row = spin.row_mut(i);
            row -= above;
        }
    }
    for i in (0..3).filter(|&i| weights[i] == zero) {
        spin.row_mut(i).fill(zero);
    }
    // Removes rounding errors.
    let size = ROUNDING * inertia.iter().fold(0.0, |largest: f64, entry| largest.max(entry.lane(0).abs()));
    let rest = (gyroscopic - central * spin).map(|entry| if entry.lane(0).abs() > size { entry } else { zero });
    (spin, rest)
}

/// The square root of one rigid body, from mass, center of mass and central inertia. `rotation` rotates the frame of
/// the central inertia to the body frame.
///
/// This is not a factorization of M, from which the central inertia would have to be recovered by a subtraction. The
/// principal axes are rotated, instead of factoring the rotated inertia. `None` if the central inertia has a negative
/// principal value.
pub(crate) fn inertia_root(
    mass: f64,
    center: Vector3<f64>,
    central: &Symmetric3<f64>,
    rotation: &Matrix3<f64>,
) -> Option<BodyRoot<f64>> {
    let (axes, values) = principal(central)?;
    Some(BodyRoot::new(mass, center, triangular(&(rotation * axes), &values)))
}

/// Principal axes and nonnegative principal values; the coordinate axes if the inertia is diagonal.
fn principal(central: &Symmetric3<f64>) -> Option<(Matrix3<f64>, Vector3<f64>)> {
    let full = central.to_matrix();
    let [_, xy, xz, _, yz, _] = central.entries;
    let (axes, values) = if xy == 0.0 && xz == 0.0 && yz == 0.0 {
        (Matrix3::identity(), Vector3::new(full[(0, 0)], full[(1, 1)], full[(2, 2)]))
    } else {
        let principal = eigenvalues(full)?;
        (principal.eigenvectors, principal.eigenvalues)
    };
    // The zero of a rod is computed as a rounding error of either sign.
    let rounding = ROUNDING * values.amax();
    if values.iter().any(|&value| !(value >= -rounding)) {
        return None;
    }
    let exact = axes == Matrix3::identity();
    Some((axes, values.map(|value| if value > rounding || (exact && value > 0.0) { value } else { 0.0 })))
}

/// Unit lower triangular factor and weights of a weighted sum of outer products of columns.
fn triangular(columns: &Matrix3<f64>, weights: &Vector3<f64>) -> (Matrix3<f64>, Vector3<f64>) {
    let mut all = RootColumns::filled(0.0);
    for j in 0..3 {
        all.weights[j + 3] = weights[j];
        for i in 0..3 {
            all.rows[i + 3][j + 3] = columns[(i, j)];
        }
    }
    let mut root = Root6::zero();
    root.join::<3, false>(&mut all, None);
    angular_part(&root)
}

/// `L_c` and `W_c` of a square root.
fn angular_part(root: &Root6<f64>) -> (Matrix3<f64>, Vector3<f64>) {
    let mut unit = Matrix3::identity();
    for i in 1..3 {
        for j in 0..i {
            unit[(i, j)] = root.rows[i + 3][j + 3];
        }
    }
    (unit, Vector3::new(root.weights[3], root.weights[4], root.weights[5]))
}

/// The square root of an inertia about the origin of its frame if nothing else is known; the central inertia is
/// obtained by a subtraction.
pub(crate) fn root_of_merged(inertia: &BodyInertia<f64>) -> Option<BodyRoot<f64>> {
    let (mass, moment) = (inertia.mass, &inertia.first_moment);
    if mass == 0.0 {
        return inertia_root(0.0, Vector3::zeros(), &inertia.rotational, &Matrix3::identity());
    }
    let center = moment / mass;
    let parallel = Matrix3::identity() * moment.dot(&center) - moment * center.transpose();
    let central = Symmetric3::from_upper(&(inertia.rotational.to_matrix() - parallel));
    inertia_root(mass, center, &central, &Matrix3::identity())
}

/// The square root of two rigidly connected bodies.
pub(crate) fn join_roots(first: &BodyRoot<f64>, second: &BodyRoot<f64>) -> BodyRoot<f64> {
    if first.is_zero() {
        return *second;
    }
    if second.is_zero() {
        return *first;
    }
    let mut both = first.to_root();
    let mut columns = RootColumns::filled(0.0);
    RigidShift::identity().root_to_parent(&second.to_root(), &mut columns);
    both.join::<3, false>(&mut columns, None);
    let mass = first.mass + second.mass;
    let share = if mass == 0.0 { 0.0 } else { second.mass / mass };
    BodyRoot::new(mass, first.center + (second.center - first.center) * share, angular_part(&both))
}

#[cfg(test)]
mod tests {
    use super::*;
    fn body(mass: f64, seed: f64) -> (f64, Vector3<f64>, Symmetric3<f64>) {
        let axes = *nalgebra::Rotation3::new(Vector3::new(seed, 0.3, -seed)).matrix();
        let central = axes * Matrix3::from_diagonal(&Vector3::new(0.3, 0.4, 0.5 * seed)) * axes.transpose();
        (mass, Vector3::new(0.1, -0.2 * seed, 0.3), Symmetric3::from_upper(&central))
    }

    /// L with rows in the usual order.
    fn unit(root: &Root6<f64>) -> nalgebra::Matrix6<f64> {
        Root6 { weights: [1.0; 6], ..*root }.to_matrix()
    }

    fn off(s: &BodyRoot<f64>, inertia: &BodyInertia<f64>) -> f64 {
        let s = s.to_root();
        let matrix = s.to_matrix();
        assert_eq!(s.to_symmetric().to_matrix(), s.to_symmetric().to_matrix().transpose());
        (matrix * matrix.transpose() - inertia.to_symmetric().to_matrix()).amax()
    }

    #[test]
    fn root_times_its_transpose_is_the_inertia() {
        for (mass, center, central) in [body(2.0, 1.0), body(0.5, 0.1), (1.0, Vector3::y(), Symmetric3::zero())] {
            let s = inertia_root(mass, center, &central, &Matrix3::identity()).expect("positive");
            assert!(off(&s, &BodyInertia::from_central(mass, &center, &central)) <= 1e-15);
        }
    }

    #[test]
    fn joined_roots_are_the_root_of_the_sum() {
        let (a, b) = (body(2.0, 1.0), body(0.5, 0.1));
        let both = BodyInertia::from_central(a.0, &a.1, &a.2).add(&BodyInertia::from_central(b.0, &b.1, &b.2));
        let (first, second) =
            (inertia_root(a.0, a.1, &a.2, &Matrix3::identity()), inertia_root(b.0, b.1, &b.2, &Matrix3::identity()));
        let s = join_roots(&first.expect("positive"), &second.expect("positive"));
        assert!(off(&s, &both) <= 2e-15);
    }

    #[test]
    fn the_root_of_a_sum_found_by_subtraction() {
        let (mass, center, central) = body(2.0, 1.0);
        let inertia = BodyInertia::from_central(mass, &center, &central);
        assert!(off(&root_of_merged(&inertia).expect("positive"), &inertia) <= 1e-15);
    }

    #[test]
    fn coordinates_are_newtons_and_eulers() {
        for (mass, center, central) in [body(2.0, 1.0), body(0.5, 0.4), (1.0, Vector3::y(), Symmetric3::zero())] {
            let inertia = BodyInertia::from_central(mass, &center, &central);
            let root = inertia_root(mass, center, &central, &Matrix3::identity()).expect("positive");
            let (v, a) = (Vector6::new(1.0, -2.0, 0.5, 0.3, 0.7, -1.1), Vector6::new(0.2, 0.9, -0.4, 9.0, -3.0, 1.0));
            let (y, rest) = root.coordinates(&v, &a);
            assert_eq!(rest, Vector3::zeros());
            let expected = inertia.mul_motion(&a) + super::super::cross_force(&v, &inertia.mul_motion(&v));
            let l = unit(&root.to_root());
            let found = l * Vector6::from(y);
            assert!((found - expected).amax() <= 4e-15, "{found} {expected}");
        }
    }

    #[test]
    fn an_inertia_that_no_body_has_leaves_a_rest() {
        // Definite in two axes only, violating the triangle inequality.
        let odd = Symmetric3::new([0.0, 0.0, 0.0, 1.0, 0.0, 3.0]);
        let root = inertia_root(1.0, Vector3::zeros(), &odd, &Matrix3::identity()).expect("not negative");
        let w = Vector3::new(0.3, 0.7, -0.4);
        let (y, rest) = root.coordinates(&super::super::spatial(&w, &Vector3::zeros()), &Vector6::zeros());
        let moment = root.central * Vector3::new(y[3], y[4], y[5]) + rest;
        assert!((moment - w.cross(&(odd.to_matrix() * w))).amax() <= 1e-15 && rest.amax() > 0.1);
    }

    #[test]
    fn a_rod_has_a_root_and_a_negative_inertia_none() {
        let turned = *nalgebra::Rotation3::new(Vector3::new(0.4, -0.9, 0.2)).matrix();
        let rod = turned * Matrix3::from_diagonal(&Vector3::new(0.0, 1.0, 1.0)) * turned.transpose();
        assert!(inertia_root(1.0, Vector3::zeros(), &Symmetric3::from_upper(&rod), &Matrix3::identity()).is_some());
        let wrong = Symmetric3::new([-1e-3, 0.0, 0.0, 1.0, 0.0, 1.0]);
        assert!(inertia_root(1.0, Vector3::zeros(), &wrong, &Matrix3::identity()).is_none());
    }
}
