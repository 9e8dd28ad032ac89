//! Roots of the covariances of bodies' inertial parameters.

use crate::dynamics::derivatives::Parameters;
#[cfg(feature = "python")]
use crate::dynamics::derivatives::parameters;
use crate::scalar::Real;
use crate::spatial::{BodyInertia, Symmetric3, Symmetric6, angular, cross_add, linear, minus, spatial, sum3};
use nalgebra::{Vector3, Vector6};

/// Roots L of the covariances L L* of each body's ten parameters; bodies are independent of each other.
///
/// A column is a change of the parameters by one standard deviation, in the body's frame. The number of columns of a
/// body is the rank of its covariance: ten for a full one, one if only the mass is uncertain, none if the body is
/// known. L is lower trapezoidal: at most four columns change the mass or the first moment, and the rest only I, whose
/// force on the body is a moment.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterRoots<T: Real> {
    columns: Vec<BodyInertia<T::Parameter>>,
    /// Of each body the end of its columns with mass or first moment, and the end of its columns.
    ends: Vec<[usize; 2]>,
}

impl<T: Real> ParameterRoots<T> {
    /// From the columns of each body, in the order of the model's bodies and in their frames: see [`Parameters`] for
    /// the order of the ten.
    pub fn new<C: IntoIterator<Item = Parameters<T>>>(bodies: impl IntoIterator<Item = C>) -> Self {
        let (mut columns, mut ends) = (Vec::new(), Vec::new());
        for body in bodies {
            let (root, massive) = lower_trapezoidal(body.into_iter().collect());
            let begin = columns.len();
            columns.extend(root.into_iter().map(|column| constants::<T>(column.map(Real::to_parameter))));
            ends.push([begin + massive, columns.len()]);
        }
        Self { columns, ends }
    }

    /// The number of bodies.
    #[must_use]
    pub fn bodies(&self) -> usize {
        self.ends.len()
    }

    /// C(k) = Y(k) L L* Y(k)* of every body: the covariance of the force that the parameters' errors are at these
    /// velocities and accelerations, weight included.
    #[inline(always)]
    pub(super) fn force_covariances(
        &self,
        velocity: &[Vector6<T>],
        acceleration: &[Vector6<T>],
        out: &mut [Symmetric6<T>],
    ) {
        let mut begin = 0;
        for (k, (out, &[massive, end])) in out.iter_mut().zip(&self.ends).enumerate() {
            let mut covariance = Symmetric6::zero();
            if begin < end {
                let regressor = Regressor::at(&velocity[k], &acceleration[k]);
                for column in &self.columns[begin..massive] {
                    let force = regressor.force(&in_lanes(column, velocity[k][0]));
                    covariance = covariance.add_rank_one(&force, &force);
                }
                for column in &self.columns[massive..end] {
                    let moment = regressor.moment(&in_lanes(column, velocity[k][0]).rotational);
                    covariance.angular = covariance.angular.add_product(moment, moment);
                }
            }
            *out = covariance;
            begin = end;
        }
    }
}

/// A column of constants, in the order of [`Parameters`].
fn constants<T: Real>(column: Parameters<T::Parameter>) -> BodyInertia<T::Parameter> {
    let [mass, x, y, z, xx, xy, yy, xz, yz, zz] = column;
    let rotational = Symmetric3 { entries: [xx, xy, xz, yy, yz, zz] };
    BodyInertia { mass, first_moment: Vector3::new(x, y, z), rotational }
}

/// A column in the scalar of the lanes, which the numbers of the state have too.
#[inline(always)]
fn in_lanes<T: Real>(column: &BodyInertia<T::Parameter>, like: T) -> BodyInertia<T> {
    let (h, e) = (&column.first_moment, &column.rotational.entries);
    BodyInertia {
        mass: like.splat(column.mass),
        first_moment: Vector3::new(like.splat(h[0]), like.splat(h[1]), like.splat(h[2])),
        rotational: Symmetric3::new([
            like.splat(e[0]),
            like.splat(e[1]),
            like.splat(e[2]),
            like.splat(e[3]),
            like.splat(e[4]),
            like.splat(e[5]),
        ]),
    }
}

/// Columns with the same sum L L*, of which each row of L has at most one nonzero entry beyond those of the rows
/// before, and the number of columns that change mass or first moment.
///
/// A reflection of the columns makes each row so; its errors are of the size of rounding relative to the norm of each
/// row of L, which is the standard deviation of a parameter.
fn lower_trapezoidal<T: Real>(mut columns: Vec<Parameters<T>>) -> (Vec<Parameters<T>>, usize) {
    let is_zero = |x: T| x.lane(0) == 0.0;
    let (mut done, mut massive) = (0, 0);
    for row in 0..10 {
        let rest = &mut columns[done..];
        let mut filled = rest.iter().enumerate().filter(|(_, column)| !is_zero(column[row])).map(|(at, _)| at);
        match (filled.next(), filled.next()) {
            (Some(_), Some(_)) => reflect(rest, row),
            (Some(only), None) => rest.swap(0, only),
            _ => continue,
        }
        done += 1;
        if row < 4 {
            massive = done;
        }
    }
    columns.truncate(done);
    (columns, massive)
}

/// Householder's reflection of the columns that leaves, in `row`, only the entry of the first.
fn reflect<T: Real>(columns: &mut [Parameters<T>], row: usize) {
    let mut square = T::zero();
    for column in &*columns {
        square = column[row].mul_add(column[row], square);
    }
    let (norm, first) = (square.sqrt(), columns[0][row]);
    // v = x + sign(x_0) |x| e_0, the sign without cancellation.
    let pivot = if first.lane(0) < 0.0 { first - norm } else { first + norm };
    let mut direction: Vec<T> = columns.iter().map(|column| column[row]).collect();
    direction[0] = pivot;
    // 2 / v*v
    let factor = (norm * pivot.abs()).recip();
    for i in 0..10 {
        let mut along = T::zero();
        for (column, &v) in columns.iter().zip(&direction) {
            along = v.mul_add(column[i], along);
        }
        along *= factor;
        for (column, &v) in columns.iter_mut().zip(&direction) {
            column[i] -= v * along;
        }
    }
    for column in &mut columns[1..] {
        column[row] = T::zero();
    }
}

/// Y: the force of a body on the joint as a linear function of its parameters, at one velocity and acceleration.
struct Regressor<T> {
    /// Acceleration of the origin as a point, weight included: the force of a unit of mass.
    at_origin: Vector3<T>,
    /// alpha~ + w~ w~, rows: the force of the first moment.
    of_moment: [[T; 3]; 3],
    /// Moment I alpha + w x I w, rows, of xx, xy, xz, yy, yz, zz.
    of_inertia: [[T; 6]; 3],
}

impl<T: Real> Regressor<T> {
    #[inline(always)]
    fn at(velocity: &Vector6<T>, acceleration: &Vector6<T>) -> Self {
        let (w, a) = (angular(velocity), angular(acceleration));
        let at_origin = cross_add(&w, &linear(velocity), &linear(acceleration));
        let (xy, xz, yz) = (w[0] * w[1], w[0] * w[2], w[1] * w[2]);
        let across = [minus(w[1], w[1], w[2], w[2]), minus(w[2], w[2], w[0], w[0]), minus(w[0], w[0], w[1], w[1])];
        let (xx, yy, zz) = (-(w[0] * w[0]), -(w[1] * w[1]), -(w[2] * w[2]));
        Self {
            at_origin,
            of_moment: [
                [yy + zz, xy - a[2], xz + a[1]],
                [xy + a[2], xx + zz, yz - a[0]],
                [xz - a[1], yz + a[0], xx + yy],
            ],
            of_inertia: [
                [a[0], a[1] - xz, a[2] + xy, -yz, across[0], yz],
                [xz, a[0] + yz, across[1], a[1], a[2] - xy, -xz],
                [-xy, across[2], a[0] - yz, xy, a[1] + xz, a[2]],
            ],
        }
    }

    /// I alpha + w x I w.
    #[inline(always)]
    fn moment(&self, inertia: &Symmetric3<T>) -> [T; 3] {
        let e = &inertia.entries;
        let [x, y, z] = &self.of_inertia;
        [sum6(x, e), sum6(y, e), sum6(z, e)]
    }

    /// Y of all ten parameters: M a + v x* M v.
    #[inline(always)]
    fn force(&self, body: &BodyInertia<T>) -> Vector6<T> {
        let (h, m, p) = (&body.first_moment, body.mass, &self.at_origin);
        let turned = self.moment(&body.rotational);
        let moment = cross_add(h, p, &Vector3::new(turned[0], turned[1], turned[2]));
        let [x, y, z] = self.of_moment;
        let v = [h[0], h[1], h[2]];
        let force = Vector3::new(m.mul_add(p[0], sum3(x, v)), m.mul_add(p[1], sum3(y, v)), m.mul_add(p[2], sum3(z, v)));
        spatial(&moment, &force)
    }
}

/// The sum of six products, as two chains.
#[inline(always)]
fn sum6<T: Real>(a: &[T; 6], b: &[T; 6]) -> T {
    sum3([a[0], a[1], a[2]], [b[0], b[1], b[2]]) + sum3([a[3], a[4], a[5]], [b[3], b[4], b[5]])
}

#[cfg(feature = "python")]
impl ParameterRoots<f64> {
    /// The same in another scalar.
    #[must_use]
    pub(super) fn cast<T: Real>(&self) -> ParameterRoots<T> {
        let columns = self.columns.iter().map(|column| constants::<T>(parameters(column).map(T::parameter))).collect();
        ParameterRoots { columns, ends: self.ends.clone() }
    }
}

#[cfg(test)]
mod tests {
    use super::{ParameterRoots, lower_trapezoidal};
    use crate::dynamics::derivatives::{Parameters, inertia};
    use crate::spatial::Symmetric6;
    use nalgebra::Vector6;

    fn number(i: usize) -> f64 {
        (f64::from(u32::try_from(i).unwrap_or(0)) * 0.618_034).fract() - 0.5
    }

    /// C of trapezoidal roots is the sum over the given columns, each by the force of the body.
    #[test]
    fn forces_have_the_covariance_of_the_columns_given() {
        let v = Vector6::from_fn(|i, _| 3.0 * number(i + 5));
        let a = Vector6::from_fn(|i, _| 9.0 * number(i + 50));
        for count in [1, 3, 7, 10, 13] {
            // The second block has columns of I alone, of the mass alone, and of zeros.
            let dense: Vec<Parameters<f64>> = (0..count).map(|c| std::array::from_fn(|i| number(10 * c + i))).collect();
            let of_one = |c: usize, i: usize| if i == [9, 0, 4][c % 3] && c > 0 { number(c + 7) } else { 0.0 };
            let sparse: Vec<Parameters<f64>> = (0..count).map(|c| std::array::from_fn(|i| of_one(c, i))).collect();
            let roots = ParameterRoots::new([dense.clone(), sparse.clone(), Vec::new()]);
            let mut found = [Symmetric6::zero(); 3];
            roots.force_covariances(&[v; 3], &[a; 3], &mut found);
            for (found, columns) in found.iter().zip([&dense, &sparse, &Vec::new()]) {
                let mut expected = Symmetric6::zero();
                for column in columns {
                    let force = inertia(column).bias_force(&v, &a);
                    expected = expected.add_rank_one(&force, &force);
                }
                let scale = expected.to_matrix().amax();
                assert!((found.to_matrix() - expected.to_matrix()).amax() <= 1e-14 * scale, "{count} columns");
            }
        }
    }

    #[test]
    fn few_columns_have_mass_or_moment_and_rank_is_not_exceeded() {
        let dense: Vec<Parameters<f64>> = (0..25).map(|c| std::array::from_fn(|i| number(10 * c + i))).collect();
        let (root, massive) = lower_trapezoidal(dense);
        assert_eq!((root.len(), massive), (10, 4));
        assert!(root.iter().enumerate().all(|(c, column)| column[..c].iter().all(|&x| x == 0.0)));
        let mass = [1.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        assert_eq!(lower_trapezoidal(vec![mass, [0.0; 10]]), (vec![mass], 1));
    }
}
