//! Products with Jacobians, for one state per lane of a scalar.

use super::accelerations::{self, KernelCall};
use super::factor::with_factor;
use super::finite::any_not_finite;
use super::gradients::gradients;
use super::instruction_set::{Target, Vectorized, within_target};
use super::row_products::ConnectedProducts;
use crate::algorithm::{Products, constants_width};
use crate::dynamics::derivatives::{
    Changes, CoStates, ConstantParts, Constants, Directions, GradientParts, tangent_in_sweeps,
};
use crate::dynamics::forces::Motion;
use crate::dynamics::sweeps::{SweepModel, SweepScratch};
use crate::filter::Form;
use crate::model::Model;
use crate::scalar::lanes_but;
use crate::scene::constraint::Constraints;
use nalgebra::Vector6;

/// Scratch beyond that of the dynamics, allocated by the first call.
#[derive(Debug)]
pub(super) struct ProductKernel<T: Vectorized> {
    co_states: CoStates<T>,
    changes: Changes<T>,
    /// The direction, whose third vector has the length that the algorithm reads; or the cotangent in the first.
    pub seeds: [Vec<T>; 3],
    /// The accelerations of the state, and x.
    qdd: Vec<T>,
    x: Vec<T>,
    results: Vec<T>,
    /// Changes of the wrenches on the bodies, or gradients with respect to the wrenches; empty without wrenches.
    of_wrenches: Vec<Vector6<T>>,
    /// For accelerations through connections.
    connected: Option<Box<ConnectedProducts<T>>>,
}

impl<T: Vectorized> ProductKernel<T> {
    #[cold]
    pub fn new(scene @ (model, sweeps): (&Model<T>, &SweepModel<T>), constraints: &Constraints) -> Self {
        let (nv, nan) = (model.nv(), T::from_f64(f64::NAN));
        let connected = (!constraints.is_empty()).then(|| Box::new(ConnectedProducts::new(scene, constraints)));
        Self {
            co_states: CoStates::new(sweeps),
            changes: Changes::new(sweeps),
            seeds: [vec![nan; nv], vec![nan; nv], vec![nan; nv]],
            qdd: vec![nan; nv],
            x: vec![nan; nv],
            results: vec![nan; 3 * nv],
            of_wrenches: Vec::new(),
            connected,
        }
    }
}

/// Writes the product; returns the lanes that need the fallback (values that are not finite, for instance) as bits.
#[inline(always)]
pub(super) fn run<T: Vectorized, I: Target>(
    target: I,
    which: Products,
    call: KernelCall<'_, T, ProductKernel<T>>,
) -> u64 {
    let KernelCall { scene, scratch, kernel, state, wrenches, out } = call;
    let ((q, qd, u), mut doubt) = (state, 0);
    let ProductKernel { co_states, changes, seeds: [first, second, third], qdd, x, results, of_wrenches, connected } =
        kernel;
    let (nv, bodies, zero) =
        (first.len(), scene.0.bodies.len(), first.first().map_or_else(T::zero, |x| x.constant(0.0)));
    let constants = if which.gives_constants() { constants_width(nv, bodies) } else { 0 };
    results.resize(which.entry().results.len() * nv + constants, zero);
    if let Some(form) = which.form() {
        if form == Form::SquareRoot {
            return u64::MAX;
        }
        let call = accelerations::KernelArguments { scene, scratch: &mut *scratch, state, wrenches, qdd: &mut *qdd };
        doubt = match connected {
            Some(connected) => connected.accelerations((target, form), call),
            None => with_factor(target, form, call),
        };
    }
    let mut through = connected.as_mut().zip(which.form());
    let qdd = if which.form().is_some() { &qdd[..] } else { u };
    let motion = Motion { q, qd, qdd: Some(qdd), wrenches };
    if which.is_gradient() {
        let (by_state, constants) = if constants == 0 {
            (&mut results[..], None)
        } else {
            of_wrenches.resize(bodies, Vector6::from_element(zero));
            let parts = GradientParts::of(results, nv, bodies);
            (parts.state, Some(parts.constants))
        };
        let mut asked = Constants::default();
        let mut forces = None;
        if let Some(ConstantParts { armature, gravity, wrenches, parameters }) = constants {
            asked = Constants { wrenches: of_wrenches, parameters, armature, gravity };
            forces = Some(wrenches);
        }
        doubt |= if let Some((connected, form)) = &mut through {
            let state = (motion, &first[..], !doubt);
            connected.gradients((target, *form), (scene, scratch), state, (&mut asked, by_state))
        } else {
            let room = (scene, (scratch, co_states));
            gradients(target, which.form(), room, (motion, &first[..]), (&mut asked, x, by_state))
        };
        for (to, wrench) in forces.into_iter().flatten().zip(&*of_wrenches) {
            *to = (*wrench).into();
        }
    } else {
        let direction = Directions::of_seed([first, second, third], bodies, of_wrenches);
        if let Some((connected, form)) = through {
            let at_constant = Directions { u: connected.rest(), ..direction };
            along(target, scene, (&mut *scratch, changes), (motion, at_constant), None, (x, &mut *results));
            doubt |= connected.along((target, form), (scene, scratch), (motion, &direction, !doubt), results);
        } else {
            let lost = along(target, scene, (scratch, changes), (motion, direction), which.form(), (x, &mut *results));
            doubt |= lanes_but::<T>(|lane| lost.lane(lane) <= 0.0);
        }
    }
    let fault = any_not_finite(results);
    T::put_lanes(results, out);
    for lane in 0..T::LANES {
        doubt |= u64::from(fault.lane(lane) != 0.0) << lane;
    }
    doubt
}

within_target! {
    /// Along a direction.
    #[inline(always)]
    fn along<'a, T>(
        scene: (&'a Model<T>, &'a SweepModel<T>),
        scratch: (&'a mut SweepScratch<T>, &'a mut Changes<T>),
        state: (Motion<'a, T>, Directions<'a, T>),
        form: Option<Form>,
        results: (&'a mut [T], &'a mut [T]),
    ) -> T {
        let is_solved = (form.is_some(), form == Some(Form::Auto));
        tangent_in_sweeps::<T, T::Columns>(scene, scratch, state, is_solved, results)
    }
}
