//! Forward dynamics through connections, for one state per lane of a scalar.

use super::accelerations::KernelCall;
use super::factor;
use super::finite::any_not_finite;
use super::instruction_set::{Target, Vectorized, within_target};
use crate::dynamics::constraints::ConstraintKernel;
use crate::dynamics::sweeps::{SweepModel, SweepScratch};
use crate::filter::Form;
use crate::model::Model;
use crate::scalar::lanes_but;
use crate::scene::constraint::Constraints;
use nalgebra::Vector6;

/// Largest number of refinements that remove the rounding error of the rows.
const CORRECTIONS: usize = 2;

/// Scratch beyond that of the dynamics, allocated by the first call.
#[derive(Debug)]
pub(super) struct ConnectedKernel<T: Vectorized> {
    pub rows: ConstraintKernel<T>,
    /// e^- of the tree and of the forces of the connections.
    innovations: Vec<T>,
    /// Accelerations, forces of the connections, rank and residual.
    results: Vec<T>,
}

impl<T: Vectorized> ConnectedKernel<T> {
    #[cold]
    pub fn new(scene: (&Model<T>, &SweepModel<T>), constraints: &Constraints) -> Self {
        let (nv, nan) = (scene.0.nv(), T::from_f64(f64::NAN));
        Self {
            rows: ConstraintKernel::new(scene, constraints),
            innovations: vec![nan; nv],
            results: vec![nan; nv + constraints.rows + 2],
        }
    }
}

/// Writes the results; returns the lanes that need the fallback (values that are not finite, for instance) as bits.
#[inline(always)]
pub(super) fn run<T: Vectorized, I: Target>(
    target: I,
    form: Form,
    call: KernelCall<'_, T, ConnectedKernel<T>>,
    states: usize,
) -> u64 {
    let KernelCall { scene, scratch, kernel, state, wrenches, out } = call;
    if form == Form::SquareRoot {
        return u64::MAX;
    }
    let (nv, mut results) = (scene.0.nv(), std::mem::take(&mut kernel.results));
    let doubt = solve((target, form), scene, (scratch, kernel), state, wrenches, &mut results[..nv]);
    let rows = &kernel.rows;
    let m = rows.forces_of_rows.len();
    results[nv..nv + m].copy_from_slice(&rows.forces_of_rows);
    results[nv + m] = rows.rank;
    results[nv + m + 1] = rows.residual;
    let fault = any_not_finite(&results);
    let width = out.len() / states.min(T::LANES);
    T::put_lanes(&results[..width], out);
    kernel.results = results;
    doubt | lanes_but::<T>(|lane| fault.lane(lane) == 0.0)
}

/// The accelerations of a state, (nv) into `qdd`, with both factors for further right-hand sides, and the forces of the
/// rows. Returns the lanes that need the fallback.
#[inline(always)]
pub(super) fn solve<T: Vectorized, I: Target>(
    kernels @ (target, _): (I, Form),
    scene: (&Model<T>, &SweepModel<T>),
    (scratch, kernel): (&mut SweepScratch<T>, &mut ConnectedKernel<T>),
    state: (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    qdd: &mut [T],
) -> u64 {
    let ConnectedKernel { rows, innovations, .. } = kernel;
    let doubt = factors(kernels, scene, (&mut *scratch, rows), (state.0, state.1), qdd);
    factor::innovations(target, scene, scratch, state, (wrenches, innovations));
    let vectors = (state.2, &mut innovations[..], qdd);
    let (_, open) = accelerations(target, scene, scratch, rows, vectors, (!doubt, u64::MAX));
    doubt | open
}

/// The factors of M, in form auto with an error estimate, and of the rows at (q, qd); `estimates` is scratch. Returns
/// the lanes that need the fallback.
#[inline(always)]
pub(crate) fn factors<T: Vectorized, I: Target>(
    (target, form): (I, Form),
    scene: (&Model<T>, &SweepModel<T>),
    (scratch, rows): (&mut SweepScratch<T>, &mut ConstraintKernel<T>),
    (q, qd): (&[T], &[T]),
    estimates: &mut [T],
) -> u64 {
    let doubt = match form {
        Form::Auto => factor::watched(target, scene, scratch, (q, estimates)),
        _ => factor::unwatched(target, scene, scratch, q),
    };
    doubt | factor_rows(target, scene, scratch, rows, (q, qd))
}

within_target! {
    /// The rows and the factor of G, with the factor of M in the scratch. Returns the lanes that need the fallback.
    #[inline(never)]
    pub(crate) fn factor_rows<'a, T>(
        scene: (&'a Model<T>, &'a SweepModel<T>),
        scratch: &'a SweepScratch<T>,
        rows: &'a mut ConstraintKernel<T>,
        at: (&'a [T], &'a [T]),
    ) -> u64 {
        let regular = rows.factor(scene, scratch, at);
        lanes_but::<T>(|lane| regular.lane(lane) > 0.0)
    }

    /// The first forces.
    #[inline(always)]
    fn first_step<'a, T>(
        scratch: &'a SweepScratch<T>,
        rows: &'a mut ConstraintKernel<T>,
        vectors: (&'a [T], &'a [T]),
        is_watched: bool,
    ) -> () {
        rows.first_step(scratch, vectors.0, vectors.1, is_watched);
    }

    /// The accelerations due to the forces.
    #[inline(always)]
    fn take<'a, T>(rows: &'a mut ConstraintKernel<T>, innovations: &'a mut [T]) -> () {
        rows.take(innovations);
    }

    /// The residual of the rows; the allowed lanes in which it exceeds the usual rounding error, and all in which it
    /// cannot be rounding.
    #[inline(always)]
    fn residual<'a, T>(
        scene: (&'a Model<T>, &'a SweepModel<T>),
        scratch: &'a SweepScratch<T>,
        rows: &'a mut ConstraintKernel<T>,
        qdd: &'a [T],
        allowed: u64,
    ) -> [u64; 2] {
        let [near, far] = rows.look(scene, scratch, qdd);
        let [is_left, is_open] = [near, far].map(|margin| lanes_but::<T>(|lane| margin.lane(lane) >= 0.0));
        let is_left = is_left & allowed;
        if is_left != 0 {
            // Each lane independently: the needs of other lanes do not change its result.
            rows.mask(ones_in(is_left, near));
        }
        [is_left, is_open]
    }
}

/// The accelerations of a state from its torques and the innovations of the tree, with both factors. The residual is
/// corrected in the lanes `allowed` while it exceeds the usual rounding error in one of the lanes `needed`; it is not
/// computed if no lane is allowed. Returns the allowed lanes that needed a correction, and those whose residual cannot
/// be rounding.
#[inline(always)]
pub(crate) fn accelerations<T: Vectorized, I: Target>(
    target: I,
    scene: (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    rows: &mut ConstraintKernel<T>,
    (tau, innovations, qdd): (&[T], &mut [T], &mut [T]),
    (needed, allowed): (u64, u64),
) -> (u64, u64) {
    first_step(target, scratch, rows, (tau, innovations), allowed != 0);
    let mut corrected = 0;
    for correction in 0..=CORRECTIONS {
        take(target, rows, innovations);
        qdd.copy_from_slice(innovations);
        factor::smooth(target, scene, scratch, qdd);
        if allowed == 0 {
            break;
        }
        let [is_left, is_open] = residual(target, scene, scratch, rows, qdd, allowed);
        if is_left & needed == 0 || correction == CORRECTIONS {
            return (corrected, is_open & allowed);
        }
        corrected |= is_left;
    }
    (corrected, 0)
}

/// One in the lanes given as bits, zero in others; `like` determines only the type.
#[inline(always)]
fn ones_in<T: Vectorized>(lanes: u64, like: T) -> T {
    let mut ones = like.constant(0.0);
    for (lane, one) in ones.lanes_mut().iter_mut().enumerate() {
        *one = if lanes >> lane & 1 == 1 { 1.0 } else { 0.0 };
    }
    ones
}
