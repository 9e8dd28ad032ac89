//! Roots of the covariances of bodies' inertial parameters.

#[cfg(feature = "python")]
use crate::dynamics::derivatives::parameters;
use crate::dynamics::derivatives::{Parameters, inertia};
use crate::scalar::Real;
use crate::spatial::{BodyInertia, Symmetric6};
use nalgebra::Vector6;

/// Roots L of the covariances L L* of each body's ten parameters; bodies are independent of each other.
///
/// A column is a change of the parameters by one standard deviation, in the body's frame. The number of columns of a
/// body is the rank of its covariance: ten for a full one, one if only the mass is uncertain, none if the body is
/// known.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterRoots<T> {
    columns: Vec<BodyInertia<T>>,
    /// Of each body the end of its columns.
    ends: Vec<usize>,
}

impl<T: Real> ParameterRoots<T> {
    /// From the columns of each body, in the order of the model's bodies and in their frames: see [`Parameters`] for
    /// the order of the ten.
    pub fn new<C: IntoIterator<Item = Parameters<T>>>(bodies: impl IntoIterator<Item = C>) -> Self {
        let (mut columns, mut ends) = (Vec::new(), Vec::new());
        for body in bodies {
            columns.extend(body.into_iter().map(|column| inertia(&column)));
            ends.push(columns.len());
        }
        Self { columns, ends }
    }

    /// The number of bodies.
    #[must_use]
    pub fn bodies(&self) -> usize {
        self.ends.len()
    }

    /// The columns of body `k`.
    #[inline(always)]
    fn of_body(&self, k: usize) -> &[BodyInertia<T>] {
        let begin = k.checked_sub(1).map_or(0, |before| self.ends[before]);
        &self.columns[begin..self.ends[k]]
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
        for (k, out) in out.iter_mut().enumerate() {
            let mut covariance = Symmetric6::zero();
            for column in self.of_body(k) {
                let force = column.bias_force(&velocity[k], &acceleration[k]);
                covariance = covariance.add_rank_one(&force, &force);
            }
            *out = covariance;
        }
    }
}

#[cfg(feature = "python")]
impl ParameterRoots<f64> {
    /// The same in another scalar.
    #[must_use]
    pub(super) fn cast<T: Real>(&self) -> ParameterRoots<T> {
        let columns = self.columns.iter().map(|column| inertia(&parameters(column).map(T::from_f64))).collect();
        ParameterRoots { columns, ends: self.ends.clone() }
    }
}
