//! Derivatives for one state per lane of a scalar.

use super::accelerations::{self, KernelCall};
use super::connected::{self, ConnectedKernel};
use super::factor::{multiplied_out, with_factor};
use super::instruction_set::{Entry, Target, Vectorized, within_target};
use crate::algorithm::Derivatives;
use crate::dynamics::constraints::{RowMatrices, RowSolutions};
use crate::dynamics::derivatives::{DerivativeColumns, Kept, Matrices, Product, in_sweeps};
use crate::dynamics::forces::Motion;
use crate::dynamics::sweeps::{InverseColumns, SweepModel, SweepScratch};
use crate::filter::Form;
use crate::kinematics::placements_base_to_tip;
use crate::model::Model;
use crate::scalar::{ColumnsOf, Real, lanes_but};
use crate::scene::constraint::Constraints;
use crate::spatial::RigidShift;

/// Scratch beyond that of the dynamics, allocated by the first call.
#[derive(Debug)]
pub(super) struct DerivativeKernel<T: Vectorized> {
    kept: Kept<T>,
    columns: DerivativeColumns<T, T::Columns>,
    product: Product<T, T::Columns>,
    /// The accelerations of the state.
    qdd: Vec<T>,
    /// In lanes, or if only some of them are requested: the three matrices.
    matrices: Vec<Entry<T>>,
    /// The index of each of their entries, in order.
    all: Vec<u32>,
    /// For a scene with connections.
    connected: Option<Box<Connected<T>>>,
}

/// Scratch of derivatives through connections.
#[derive(Debug)]
struct Connected<T: Vectorized> {
    kernel: ConnectedKernel<T>,
    matrices: RowMatrices<T>,
    /// phi of every body.
    shifts: Vec<RigidShift<T>>,
}

impl<T: Vectorized> DerivativeKernel<T> {
    #[cold]
    pub fn new(scene @ (model, sweeps): (&Model<T>, &SweepModel<T>), constraints: &Constraints) -> Self {
        let (nv, nan) = (model.nv(), T::from_f64(f64::NAN));
        let is_connected = !constraints.is_empty();
        let mut columns = DerivativeColumns::new();
        columns.prepare(model, sweeps);
        let size = 3 * nv * nv;
        Self {
            kept: Kept::new(sweeps, nv),
            columns,
            product: Product::new(is_connected),
            qdd: vec![nan; nv],
            matrices: vec![T::Columns::kept(nan); size],
            all: (0..).take(size).collect(),
            connected: is_connected.then(|| {
                Box::new(Connected {
                    kernel: ConnectedKernel::new(scene, constraints),
                    matrices: RowMatrices::new((model, constraints)),
                    shifts: vec![RigidShift::identity(); model.bodies.len()],
                })
            }),
        }
    }
}

/// Writes the matrices; returns the lanes that need the fallback (values that are not finite, for instance) as bits.
#[inline(always)]
pub(super) fn run<T: Vectorized, I: Target>(
    target: I,
    which: Derivatives,
    call: KernelCall<'_, T, DerivativeKernel<T>>,
    inverse: &mut InverseColumns<T, T::Columns>,
) -> u64 {
    let KernelCall { scene, scratch, kernel, state: (q, qd, u), wrenches, out } = call;
    let DerivativeKernel { kept, columns, product, qdd, matrices, all, connected } = kernel;
    let (size, form) = (matrices.len(), if let Derivatives::ForwardDynamics(form) = which { Some(form) } else { None });
    let mut connected = connected.as_deref_mut().filter(|_| form.is_some());
    let mut doubt = 0;
    if let Some(form) = form {
        if !matches!(form, Form::Auto | Form::Covariance) || !scene.1.is_shallow() {
            return u64::MAX;
        }
        doubt = if let Some(Connected { kernel, .. }) = &mut connected {
            kernel.rows.compliance.fill(T::zero());
            connected::solve((target, form), scene, (scratch, kernel), (q, qd, u), wrenches, qdd)
        } else {
            let call = accelerations::KernelArguments { scene, scratch, state: (q, qd, u), wrenches, qdd };
            with_factor(target, form, call)
        };
    }
    let (kind, qdd) = match which {
        Derivatives::InverseDynamics => (Matrices::Derivatives, Some(u)),
        Derivatives::ForwardDynamics(_) => (Matrices::Derivatives, Some(&qdd[..])),
        Derivatives::CoriolisMatrix | Derivatives::MassMatrix => (Matrices::Coriolis, None),
    };
    let motion = Motion { q, qd, qdd, wrenches };
    let entries = columns.prepare(scene.0, scene.1);
    let mut numbers = std::mem::take(&mut entries.numbers);
    // For one state, written in place if all matrices are requested.
    let is_whole = which.entry().results.len() == 3;
    let to = if T::LANES > 1 {
        &mut numbers[..]
    } else if is_whole {
        T::entries_in(&mut *matrices, out)
    } else {
        &mut matrices[..]
    };
    of_torques(target, scene, (scratch, kept, columns), (motion, kind), to);
    let mut fault = T::zero();
    if form.is_some() {
        if let Some(tiles) = inverse.prepare(scene.0, scene.1) {
            let mut of_inverse = std::mem::take(&mut tiles.numbers);
            if T::LANES > 1 {
                multiplied_out(target, scene, (scratch, inverse), &mut of_inverse);
                let chosen = columns.chosen();
                for (entry, &at) in matrices.iter_mut().zip(&chosen[..size / 3 * 2]) {
                    *entry = numbers[at as usize];
                }
                if let Some(tiles) = inverse.prepare(scene.0, scene.1) {
                    for (entry, &at) in matrices[size / 3 * 2..].iter_mut().zip(tiles.chosen()) {
                        *entry = of_inverse[at as usize];
                    }
                    tiles.numbers = of_inverse;
                }
            } else {
                let to = T::entries_in(&mut *matrices, out);
                multiplied_out(target, scene, (scratch, inverse), &mut to[size / 3 * 2..]);
            }
        }
        let to = if T::LANES > 1 { &mut matrices[..] } else { T::entries_in(&mut *matrices, out) };
        let states = (q, qd, qdd.unwrap_or(u));
        if let Some(connected) = &mut connected {
            doubt |= reduce(target, scene, (connected, product), states, to);
        }
        let cancels = times_inverse(target, scene, (columns.like(), product, scratch.accepted_of_products), to);
        if let Some(Connected { matrices, .. }) = connected {
            subtract_changes(target, matrices, &mut to[..size / 3 * 2]);
        }
        if form == Some(Form::Auto) {
            doubt |= cancels;
        }
        fault += entries_not_finite::<T>(columns.like(), to);
        if T::LANES > 1 {
            T::put_entries(matrices, all, out);
        }
    } else if T::LANES > 1 {
        fault += entries_not_finite::<T>(columns.like(), &numbers);
        let chosen = columns.chosen();
        T::put_entries(&numbers, if is_whole { chosen } else { &chosen[size / 3..size / 3 * 2] }, out);
    } else if is_whole {
        fault += entries_not_finite::<T>(columns.like(), T::entries_in(&mut *matrices, out));
    } else {
        let asked = &matrices[size / 3..size / 3 * 2];
        fault += entries_not_finite::<T>(columns.like(), asked);
        for (out, &entry) in out.iter_mut().zip(asked) {
            *out = T::Columns::taken(entry).lanes()[0];
        }
    }
    columns.prepare(scene.0, scene.1).numbers = numbers;
    for lane in 0..T::LANES {
        doubt |= u64::from(fault.lane(lane) != 0.0) << lane;
    }
    doubt
}

within_target! {
    /// dtau/dq, dtau/dqd and M, or the Coriolis matrix; compiled once for all callers.
    #[inline(never)]
    fn of_torques<'a, T>(
        scene: (&'a Model<T>, &'a SweepModel<T>),
        scratch: (&'a mut SweepScratch<T>, &'a mut Kept<T>, &'a mut DerivativeColumns<T, T::Columns>),
        state: (Motion<'a, T>, Matrices),
        out: &'a mut [Entry<T>],
    ) -> () {
        in_sweeps(scene, scratch, state.0, state.1, out);
    }

    /// Subtracts d(J* lambda)/dq from dtau/dq, and replaces M^-1 by that through the connections. Returns the lanes
    /// that need the fallback.
    #[inline(never)]
    fn reduce<'a, T>(
        scene: (&'a Model<T>, &'a SweepModel<T>),
        scratch: (&'a mut Connected<T>, &'a mut Product<T, T::Columns>),
        state: (&'a [T], &'a [T], &'a [T]),
        out: &'a mut [Entry<T>],
    ) -> u64 {
        let (Connected { kernel: ConnectedKernel { rows, .. }, matrices, shifts }, product) = scratch;
        placements_base_to_tip(scene.0, state.0, shifts);
        if matrices.compute(scene.0, shifts, state, &rows.forces_of_rows).is_err() {
            return u64::MAX;
        }
        let (both, inverse) = out.split_at_mut(out.len() / 3 * 2);
        matrices.subtract_forces::<T::Columns>(both);
        let RowSolutions { response, solved } = matrices.respond::<T::Columns>(inverse, product.terms_of_inverse(scene));
        rows.times_gram_inverse(response, solved);
        matrices.reduce::<T::Columns>(inverse);
        0
    }

    /// Subtracts the effect of the changes of the rows from both derivatives.
    #[inline(never)]
    fn subtract_changes<'a, T>(matrices: &'a RowMatrices<T>, both: &'a mut [Entry<T>]) -> () {
        matrices.subtract_changes::<T::Columns>(both);
    }

    /// -M^-1 times both derivatives, in place. Returns the lanes that lose precision, as bits.
    #[inline(never)]
    fn times_inverse<'a, T>(
        scene: (&'a Model<T>, &'a SweepModel<T>),
        product: (T::Columns, &'a mut Product<T, T::Columns>, T),
        out: &'a mut [Entry<T>],
    ) -> u64 {
        let (like, product, accepted) = product;
        let margin = product.in_place(scene, (like, accepted), out);
        lanes_but::<T>(|lane| margin.lane(lane) >= 0.0)
    }
}

/// Zero if all entries of matrices are finite, otherwise NaN; one block at a time.
#[inline(always)]
fn entries_not_finite<T: Vectorized>(like: T::Columns, entries: &[Entry<T>]) -> T {
    let (mut sums, zero, width) = ([like; 4], like.constant(0.0), T::Columns::COLUMNS);
    let (whole, mut fault) = (entries.chunks_exact(width), T::zero());
    for &entry in whole.remainder() {
        fault = T::Columns::taken(entry).mul_add(T::zero(), fault);
    }
    for (i, block) in whole.enumerate() {
        sums[i % 4] = like.load(block).mul_add(zero, sums[i % 4]);
    }
    let [a, b, c, d] = sums;
    let all = (a + b) + (c + d);
    for column in 0..width {
        fault += all.column(column);
    }
    fault
}
