//! Solutions and products with derivatives through connections at one configuration, for one state per lane of a
//! scalar.

use super::accelerations::KernelArguments;
use super::connected::{self, ConnectedKernel};
use super::factor;
use super::gradients::gradients;
use super::instruction_set::{Target, Vectorized, within_target};
use crate::dynamics::constraints::{ConstraintKernel, Results, RowFault, RowGradients, RowProducts, SolutionGradients};
use crate::dynamics::derivatives::{CoStates, Directions};
use crate::dynamics::forces::Motion;
use crate::dynamics::sweeps::{SweepModel, SweepScratch};
use crate::filter::Form;
use crate::kinematics::placements_base_to_tip;
use crate::model::Model;
use crate::scene::constraint::Constraints;
use crate::spatial::RigidShift;
use nalgebra::Vector3;

/// Scratch memory.
#[derive(Debug)]
pub(crate) struct RowProductScratch<T: Vectorized> {
    /// The model without gravity, in which a right-hand side at rest has no bias, and velocities of zero.
    weightless: Model<T>,
    rest: Vec<T>,
    co_states: CoStates<T>,
    /// phi of every body.
    shifts: Vec<RigidShift<T>>,
    innovations: Vec<T>,
    x: Vec<T>,
}

impl<T: Vectorized> RowProductScratch<T> {
    #[cold]
    pub fn new((model, sweeps): (&Model<T>, &SweepModel<T>)) -> Self {
        let rates = || vec![T::zero(); model.nv()];
        let mut weightless = model.clone();
        weightless.gravity = Vector3::from_element(T::zero());
        Self {
            weightless,
            rest: rates(),
            co_states: CoStates::new(sweeps),
            shifts: vec![RigidShift::identity(); model.bodies.len()],
            innovations: rates(),
            x: rates(),
        }
    }
}

/// All lanes of a result that failed.
pub(crate) fn failed(outcome: Result<(), RowFault>) -> u64 {
    if outcome.is_err() { u64::MAX } else { 0 }
}

/// Scratch memory of the products with derivatives of accelerations, beyond that of the tree.
#[derive(Debug)]
pub(super) struct ConnectedProducts<T: Vectorized> {
    kernel: ConnectedKernel<T>,
    products: RowProductScratch<T>,
    gradients: SolutionGradients<T>,
    forces: Vec<T>,
    of_rows: Vec<T>,
    of_x: Vec<T>,
}

impl<T: Vectorized> ConnectedProducts<T> {
    #[cold]
    pub fn new(scene: (&Model<T>, &SweepModel<T>), constraints: &Constraints) -> Self {
        let of_rows = || vec![T::zero(); constraints.rows];
        Self {
            kernel: ConnectedKernel::new(scene, constraints),
            products: RowProductScratch::new(scene),
            gradients: SolutionGradients::new(scene.0, constraints, false),
            forces: of_rows(),
            of_rows: of_rows(),
            of_x: vec![T::zero(); scene.0.nv()],
        }
    }

    /// Joint accelerations of zero.
    pub fn rest(&self) -> &[T] {
        &self.products.rest
    }

    /// The accelerations of a state, with both factors. Returns the lanes that need the fallback.
    #[inline(always)]
    pub fn accelerations<I: Target>(&mut self, kernels: (I, Form), call: KernelArguments<'_, T>) -> u64 {
        let KernelArguments { scene, scratch, state, wrenches, qdd } = call;
        let doubt = connected::solve(kernels, scene, (scratch, &mut self.kernel), state, wrenches, qdd);
        self.forces.copy_from_slice(&self.kernel.rows.forces_of_rows);
        doubt
    }

    /// All cotangents of the state of these accelerations, for the cotangent of the accelerations. `lanes` are needed.
    /// Returns the lanes that need the fallback.
    #[inline(always)]
    pub fn gradients<I: Target>(
        &mut self,
        kernels: (I, Form),
        (scene, scratch): ((&Model<T>, &SweepModel<T>), &mut SweepScratch<T>),
        (motion, cotangent, lanes): (Motion<'_, T>, &[T], u64),
        results: Results<'_, '_, T>,
    ) -> u64 {
        let Self { kernel, products, gradients, forces, .. } = self;
        let mut at = AtRows::new(kernels, scene, ((scratch, &mut kernel.rows), products), motion.q);
        let open = at.solve(gradients, (cotangent, &[]), lanes);
        open | failed(gradients.of_accelerations(&mut at, (motion, forces), results))
    }

    /// The change of the accelerations along a direction, from the change of the torques of inverse dynamics at
    /// constant accelerations in `out`, in place. `lanes` are needed. Returns the lanes that need the fallback.
    #[inline(always)]
    pub fn along<I: Target>(
        &mut self,
        kernels: (I, Form),
        (scene, scratch): ((&Model<T>, &SweepModel<T>), &mut SweepScratch<T>),
        (motion, direction, lanes): (Motion<'_, T>, &Directions<'_, T>, u64),
        out: &mut [T],
    ) -> u64 {
        let Self { kernel, products, gradients, forces, of_rows, of_x } = self;
        let mut at = AtRows::new(kernels, scene, ((scratch, &mut kernel.rows), products), motion.q);
        of_x.copy_from_slice(out);
        let (shifts, results) = (&at.products.shifts[..], [&mut of_rows[..], &mut of_x[..]]);
        let changed = change_along(kernels.0, gradients, (shifts, motion), (direction, &forces[..]), results);
        let open = at.solve(gradients, (of_x, of_rows), lanes);
        out.copy_from_slice(&gradients.y);
        open | failed(changed)
    }
}

/// Solutions and products at one configuration, with its factors.
pub(crate) struct AtRows<'a, T: Vectorized, I> {
    kernels: (I, Form),
    scene: (&'a Model<T>, &'a SweepModel<T>),
    /// Of M, and of the rows.
    factors: (&'a mut SweepScratch<T>, &'a mut ConstraintKernel<T>),
    products: &'a mut RowProductScratch<T>,
    q: &'a [T],
}

impl<'a, T: Vectorized, I: Target> AtRows<'a, T, I> {
    #[inline(always)]
    pub fn new(
        kernels: (I, Form),
        scene: (&'a Model<T>, &'a SweepModel<T>),
        (factors, products): ((&'a mut SweepScratch<T>, &'a mut ConstraintKernel<T>), &'a mut RowProductScratch<T>),
        q: &'a [T],
    ) -> Self {
        products.weightless.system.noise.copy_from_slice(&scene.0.system.noise);
        placements_base_to_tip(scene.0, q, &mut products.shifts);
        Self { kernels, scene, factors, products, q }
    }

    /// y and r for the cotangents of x and of p (empty for zero): M y + J* r = `of_x`, J y = -`of_p`. `lanes` are
    /// needed. Returns the lanes that need the fallback.
    #[inline(always)]
    pub fn solve(&mut self, to: &mut SolutionGradients<T>, (of_x, of_p): (&[T], &[T]), lanes: u64) -> u64 {
        let Self { kernels: (target, _), scene, factors: (sweeps, rows), products, q } = self;
        let RowProductScratch { weightless, rest, innovations, .. } = &mut **products;
        let at_rest = (weightless as &Model<T>, scene.1);
        factor::innovations(*target, at_rest, sweeps, (q, rest, of_x), (&[], innovations));
        rows.set_biases(of_p);
        let vectors = (of_x, &mut innovations[..], &mut to.y[..]);
        let (_, open) = connected::accelerations(*target, *scene, sweeps, rows, vectors, (lanes, u64::MAX));
        for (r, &p) in to.r.iter_mut().zip(&rows.forces_of_rows) {
            *r = -p;
        }
        open
    }
}

impl<T: Vectorized, I: Target> RowProducts<T> for AtRows<'_, T, I> {
    #[inline(always)]
    fn gradients_of_torques(&mut self, motion: Motion<'_, T>, cotangent: &[T], results: Results<'_, '_, T>) {
        let (constants, out) = results;
        let RowProductScratch { co_states, x, .. } = &mut *self.products;
        let room = (self.scene, (&mut *self.factors.0, co_states));
        gradients(self.kernels.0, None, room, (motion, cotangent), (constants, x, out));
    }

    #[inline(always)]
    fn gradients_of_inertia(&mut self, [rest, qdd]: [&[T]; 2], cotangent: &[T], results: Results<'_, '_, T>) {
        let (constants, out) = results;
        let RowProductScratch { weightless, co_states, x, .. } = &mut *self.products;
        let room = ((&*weightless, self.scene.1), (&mut *self.factors.0, co_states));
        let motion = Motion { q: self.q, qd: rest, qdd: Some(qdd), wrenches: &[] };
        gradients(self.kernels.0, None, room, (motion, cotangent), (constants, x, out));
    }

    #[inline(always)]
    fn add_row_gradients(
        &mut self,
        rows: &mut RowGradients<T>,
        [qd, qdd]: [&[T]; 2],
        multipliers: &[T],
        by: [&mut [T]; 2],
    ) -> Result<(), RowFault> {
        let at = (&self.products.shifts[..], (self.q, qd, qdd));
        add_row_gradients(self.kernels.0, rows, at, multipliers, by)
    }
}

/// phi of every body, and (q, qd, qdd).
type AtMotion<'a, T> = (&'a [RigidShift<T>], (&'a [T], &'a [T], &'a [T]));

within_target! {
    /// Compiled once for all callers.
    #[inline(never)]
    fn add_row_gradients<'a, T>(
        rows: &'a mut RowGradients<T>,
        at: AtMotion<'a, T>,
        multipliers: &'a [T],
        by: [&'a mut [T]; 2],
    ) -> Result<(), RowFault> {
        let (shifts, motion) = at;
        rows.add_acceleration_gradient(shifts, motion, multipliers, by)
    }

    /// [`SolutionGradients::change_along`].
    #[inline(always)]
    fn change_along<'a, T>(
        gradients: &'a mut SolutionGradients<T>,
        at: (&'a [RigidShift<T>], Motion<'a, T>),
        direction: (&'a Directions<'a, T>, &'a [T]),
        results: [&'a mut [T]; 2],
    ) -> Result<(), RowFault> {
        gradients.change_along(at, direction, results)
    }
}
