//! The covariance form with an error estimate by a test vector: the first form of [`auto`](crate::dynamics::auto).

use super::filter;
use super::joint::{self, with_joint};
use super::model::SweepModel;
use super::motion;
use super::rows::Measures;
use super::scratch::{SweepScratch, TestVector};
use crate::dynamics::forces::Motion;
use crate::filter::cancellation::{Cancellation, StageState};
use crate::filter::pivots::PivotMonitor;
use crate::model::Model;
use crate::scalar::{ColumnsOf, Real};
use crate::spatial::transform::Transform;
use nalgebra::Vector6;

/// The pivots of the covariance form, whether one test vector suffices to accept them, and the error estimate by that
/// vector.
pub(crate) type ErrorTerms<T> = (PivotMonitor<T>, PivotMonitor<T>, Cancellation<T>);

/// [`forward_dynamics`](super::forward_dynamics) with the terms of the error estimate.
#[inline(always)]
pub(crate) fn forward_dynamics_with_estimate<T: Real, C: ColumnsOf<T>>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    (q, qd, tau): (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    qdd: &mut [T],
) -> ErrorTerms<T> {
    let state = Motion { q, qd, qdd: None, wrenches };
    motion::base_to_tip::<T, C, false>((model, sweeps), scratch, state);
    let [monitor, near] = filter::tip_to_base::<T, { filter::ESTIMATE }>((model, sweeps), scratch, tau, qdd);
    (monitor, near, base_to_tip::<T, true>((model, sweeps), scratch, qdd))
}

/// The factor of M, and the error of the solution of one test vector, estimated by the other; `estimates` is scratch,
/// (nv).
#[inline(always)]
pub(crate) fn factor_with_estimate<T: Real, C: ColumnsOf<T>>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    q: &[T],
    estimates: &mut [T],
) -> (PivotMonitor<T>, Cancellation<T>) {
    motion::carriers(sweeps, scratch, C::zero(), q);
    let o = T::zero();
    for own in &mut scratch.own {
        own.force = [o; 6];
    }
    // Moved out and back because it is read while the rest of the scratch is written; this does not allocate.
    let other = std::mem::take(&mut scratch.test.other_vector);
    let [monitor, _] = filter::tip_to_base::<T, { filter::ESTIMATE }>((model, sweeps), scratch, &other, estimates);
    scratch.test.other_vector = other;
    (monitor, base_to_tip::<T, false>((model, sweeps), scratch, estimates))
}

/// The smoother for the right-hand side and the test vector; with `ALLOWS` with the sensitivity of the problem.
#[inline(always)]
pub(super) fn base_to_tip<T: Real, const ALLOWS: bool>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    estimates: &mut [T],
) -> Cancellation<T> {
    let mut seen = Cancellation::new();
    let SweepScratch { own, shifts, measured, test, .. } = scratch;
    let TestVector { own: tested, co_states, innovations, nu: nus, .. } = test;
    // Slices of equal length, which lets the compiler omit bounds checks.
    let rows = measured.len();
    let (estimates, innovations) = (&mut estimates[..rows], &innovations[..rows]);
    for (place, ((body, own), tested)) in sweeps.swept().iter().zip(own).zip(tested).enumerate() {
        let [outer, outer_nu] = &co_states[body.places.parent_outward];
        let o = outer[0].constant(0.0);
        let (mut lambda, mut nu) = ([o; 6], [o; 6]);
        let state_of_stage = StageState { z: &own.force, bias: &tested.bias, terms: &tested.terms, measured };
        with_joint!(body, own.turn, (model, sweeps, shifts), transform, rows, {
            if body.parent.is_some() {
                seen.carried(tested.zeta, &Vector6::from(*outer), transform.offset_square());
                (lambda, nu) = (transform.carry_motion(outer), transform.carry_motion(outer_nu));
            }
            rows.smooth_both::<ALLOWS>(
                &mut seen,
                &state_of_stage,
                (&mut lambda, &mut nu),
                (&mut *estimates, innovations),
            );
        });
        if !ALLOWS {
            nus[place] = nu;
        }
        if !body.is_leaf {
            co_states[body.places.outward] = [lambda, nu];
        }
    }
    seen
}

#[cfg(test)]
mod tests {
    use super::{SweepModel, SweepScratch, forward_dynamics_with_estimate};
    use crate::filter::cancellation::Margins;
    use crate::scene::{Inertial, JointDescription, JointKind, LinkDescription, SceneBuilder};
    use crate::scenes;
    use crate::spatial::Symmetric3;

    /// Torques that balance the weight of a chain cause accelerations of the size of their rounding errors. The error
    /// is large relative to these accelerations, and within the sensitivity to one unit in the last place of the
    /// forces.
    #[test]
    fn a_state_near_equilibrium_is_accepted_by_its_sensitivity() {
        let scene = scenes::chain(7).expect("a chain");
        let model = scene.model();
        let (q, still) = ([0.3, -0.7, 0.5, 0.9, -0.4, 0.6, 0.2], [0.0; 7]);
        let mut held = [f64::NAN; 7];
        scene.bias_torque(&mut scene.workspace(), &q, &still, &mut held).expect("a state");
        // A relative change of 1e-10 determines the remaining accelerations.
        held[3] *= 1.0 + 1e-10;
        let sweeps = SweepModel::new(model);
        let seen = |torque: &[f64]| {
            let (mut scratch, mut qdd) = (SweepScratch::new(model, &sweeps), [f64::NAN; 7]);
            let state = (&q[..], &still[..], torque);
            forward_dynamics_with_estimate::<_, f64>((model, &sweeps), &mut scratch, state, &[], &mut qdd).2
        };
        let nothing = Margins { of_rest: 0.0, of_bias: 0.0, of_bias_at_most: 0.0 };
        let (size, rest) = (400.0 * 400.0, Margins { of_rest: 4.0, ..nothing });
        let (holding, falling) = (seen(&held), seen(&still));
        assert!(
            holding.relative_error(0) > 1e-6 && holding.slack(size, &nothing) < 0.0 && holding.slack(0.0, &rest) > 0.0
        );
        assert!(falling.relative_error(0) < 1e-13 && falling.slack(size, &nothing) > 0.0);
    }

    /// Two bodies in free fall transmit no force: only the sensitivity to their weights counts.
    #[test]
    fn a_state_in_free_fall_is_not_at_rest() {
        let link = |name: &str| LinkDescription {
            name: name.into(),
            inertial: Some(Inertial {
                mass: 2.0,
                center: [0.1, -0.2, 0.3].into(),
                central: Symmetric3::new([0.3, 0.02, -0.01, 0.2, 0.03, 0.25]),
            }),
        };
        let mut joint = JointDescription::new("joint", JointKind::Revolute, "body", "arm");
        joint.origin.lever = [0.4, 0.1, -0.2].into();
        let scene = SceneBuilder::new().floating_base(true).link(link("body")).link(link("arm")).joint(joint);
        let scene = scene.build().expect("two bodies");
        let (model, still) = (scene.model(), [0.0; 7]);
        let (sweeps, mut q) = (SweepModel::new(model), scene.neutral());
        q[7] = 0.8;
        let (mut scratch, mut qdd) = (SweepScratch::new(model, &sweeps), [f64::NAN; 7]);
        let state = (&q[..], &still[..], &still[..]);
        let seen = forward_dynamics_with_estimate::<_, f64>((model, &sweeps), &mut scratch, state, &[], &mut qdd).2;
        let nothing = Margins { of_rest: 0.0, of_bias: 0.0, of_bias_at_most: 0.0 };
        assert!(seen.relative_error(0) > 0.0 && seen.slack(0.0, &Margins { of_rest: 1e6, ..nothing }) < 0.0);
        assert!(seen.slack(0.0, &Margins { of_bias: 60.0, of_bias_at_most: 1500.0, ..nothing }) > 0.0);
    }
}
