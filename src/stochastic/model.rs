//! Sampling of the model: white forces on the bodies, propagated inward and measured at the joints (1.1 to 1.4).

use super::points::{Coordinates, Points};
use super::sobol::{BLOCK, Lane};
use crate::batch::{Batch, Fault, Pool};
use crate::dynamics::forces::Motion;
use crate::dynamics::inverse::forces_base_to_tip;
use crate::error::Error;
use crate::filter::{HingeMap, System};
use crate::interrupt;
use crate::kinematics::placements_base_to_tip;
use crate::memory;
use crate::scene::Scene;
use crate::spatial::RigidShift;
use crate::workspace::Workspace;
use nalgebra::{Matrix6, Vector6};
use std::ops::Range;

/// Approximate time per normal number and sample, ns, including its propagation.
pub(super) const COST: usize = 8;

/// The spatially random model of a scene at one configuration: w(k) ~ N(b(k), s M(k)), X = phi W, T = H X + v.
///
/// s is the `acceleration_variance`: the variance, (rad/s^2)^2, of the acceleration of one kg m^2. v has the variance s
/// r, with the armature r. Without velocities the model is centered, b = 0.
#[derive(Debug, Clone)]
pub struct RandomModel {
    pub(super) system: System<f64>,
    pub(super) shift: Vec<RigidShift<f64>>,
    pub(super) roots: Vec<Matrix6<f64>>,
    /// b(k); zero in a centered model.
    bias: Vec<Vector6<f64>>,
    /// sqrt(s).
    deviation: f64,
    dimension: usize,
}

/// Samples, one row per sample. States are in body frames, with a block of six per degree of freedom as in
/// [`crate::operators`].
#[derive(Debug, Clone, PartialEq)]
pub struct Samples {
    /// W, (samples x 6nv): the force w(k) at the outermost row of a body, zero at its other rows.
    pub process: Vec<f64>,
    /// X = phi W, (samples x 6nv).
    pub force: Vec<f64>,
    /// T = H X + v, (samples x nv).
    pub torque: Vec<f64>,
}

/// Number of bodies sampled between checks for interruption; the scratch of fewer bodies is small.
const FEW: usize = 1_024;

/// Number of blocks that are distributed to threads at once.
const TOGETHER: u64 = 1 << 14;

/// The outputs of a block: the requested lanes, and their rows of W, X and T.
struct Rows<'a> {
    lanes: Range<usize>,
    parts: [&'a mut [f64]; 3],
}

/// Splits off the first `count` entries of a slice.
#[allow(clippy::mut_mut)] // a slice that becomes shorter
fn taken<'a>(slice: &mut &'a mut [f64], count: usize) -> &'a mut [f64] {
    let (own, rest) = std::mem::take(slice).split_at_mut(count);
    *slice = rest;
    own
}

/// Number of samples.
fn count_of(samples: &Range<u64>) -> Result<usize, Error> {
    let count = samples.end.saturating_sub(samples.start);
    usize::try_from(count).map_err(|_| Error::argument("samples", count.to_string(), "as many as memory has addresses"))
}

/// One block of samples during the inward pass.
pub(super) struct Block {
    /// The normal numbers of the current body.
    normals: Vec<Lane>,
    /// w(k), six lanes per body; only if requested.
    process: Vec<Lane>,
    /// z(k), six lanes per body.
    force: Vec<Lane>,
    /// tau, one lane per row.
    pub torque: Vec<Lane>,
}

impl Scene {
    /// The random model at `q`. With velocities `qd` its mean is the bias force, gravity included.
    ///
    /// # Errors
    ///
    /// Invalid arguments; [`Error::Argument`] with the name of a link whose inertia has no square root, or for an
    /// invalid acceleration variance.
    pub fn random_model(
        &self,
        q: &[f64],
        qd: Option<&[f64]>,
        acceleration_variance: f64,
    ) -> Result<RandomModel, Error> {
        self.model().simplifications.check_every_body_moves("scene")?;
        self.check_configuration("q", q)?;
        if !(acceleration_variance.is_finite()
            && acceleration_variance > 0.0
            && acceleration_variance.recip().is_finite())
        {
            let found = acceleration_variance.to_string();
            return Err(Error::argument("acceleration_variance", found, "a positive number, (rad/s^2)^2"));
        }
        let (model, mut workspace) = (self.model(), Workspace::new(self.model()));
        let mut bias = vec![Vector6::zeros(); model.bodies.len()];
        if let Some(qd) = qd {
            self.check_rates("qd", qd)?;
            forces_base_to_tip(model, &mut workspace, Motion { q, qd, qdd: None, wrenches: &[] });
            bias.copy_from_slice(&workspace.z);
            for force in &bias {
                self.check_result("bias force", force.as_slice())?;
            }
        }
        placements_base_to_tip(model, q, &mut workspace.store.shifts);
        let roots = model.inertia_roots.iter().enumerate().map(|(k, root)| {
            let root = root.as_ref().map(|root| root.to_root().to_matrix());
            root.ok_or_else(|| self.indefinite(k))
        });
        let roots = roots.collect::<Result<Vec<_>, _>>()?;
        let columns: usize = roots.iter().map(|root| used_columns(root).count()).sum();
        let noisy = model.system.noise.iter().filter(|&&r| r > 0.0).count();
        Ok(RandomModel {
            system: model.system.clone(),
            shift: workspace.store.shifts,
            roots,
            bias,
            deviation: acceleration_variance.sqrt(),
            dimension: columns + noisy,
        })
    }
}

/// The columns of a root that are not zero.
pub(super) fn used_columns(root: &Matrix6<f64>) -> impl Iterator<Item = usize> + '_ {
    (0..6).filter(|&column| root.column(column).iter().any(|&entry| entry != 0.0))
}

impl RandomModel {
    /// Number of degrees of freedom.
    #[must_use]
    pub fn nv(&self) -> usize {
        self.system.rows()
    }

    /// Random numbers per sample: six per body (fewer for rods, point masses and frames), one per joint with armature.
    #[must_use]
    pub fn dimension(&self) -> usize {
        self.dimension
    }

    /// s, (rad/s^2)^2 of one kg m^2.
    #[must_use]
    pub fn acceleration_variance(&self) -> f64 {
        self.deviation * self.deviation
    }

    /// W, X and T of the samples with indices `samples`. A sample depends on its index only.
    ///
    /// O(N) per sample; threads share the blocks of 64.
    ///
    /// # Errors
    ///
    /// [`Error::Argument`] for Sobol points with fewer dimensions than [`RandomModel::dimension`]; [`Error::Memory`] if
    /// the samples exceed the available memory; [`Error::Interrupted`] if an [`interrupt`] ends the work.
    pub fn sample(&self, points: &Points, samples: Range<u64>) -> Result<Samples, Error> {
        let (count, nv) = (count_of(&samples)?, self.nv());
        memory::room("samples", self.bytes_of_samples(count))?;
        let unset = |width: usize| memory::filled("samples", count * width, f64::NAN);
        let mut all = Samples { process: unset(6 * nv)?, force: unset(6 * nv)?, torque: unset(nv)? };
        self.sample_into(points, samples, [&mut all.process, &mut all.force, &mut all.torque])?;
        Ok(all)
    }

    /// T alone for the samples with indices `samples`, (samples x nv).
    ///
    /// # Errors
    ///
    /// As [`RandomModel::sample`].
    pub fn sample_torque(&self, points: &Points, samples: Range<u64>) -> Result<Vec<f64>, Error> {
        let mut torque = memory::filled("samples", count_of(&samples)?.saturating_mul(self.nv()), f64::NAN)?;
        self.sample_into(points, samples, [&mut [], &mut [], &mut torque])?;
        Ok(torque)
    }

    /// Number of bytes of W, X and T for this number of samples.
    #[must_use]
    pub(crate) fn bytes_of_samples(&self, count: usize) -> u128 {
        memory::bytes_of::<f64>(&[count, 13, self.nv()])
    }

    /// W, X and T of the samples with indices `samples`, into arrays of the shapes of [`Samples`]. W and X may be empty
    /// and are then skipped.
    ///
    /// # Errors
    ///
    /// [`Error::Shape`] for arrays of other lengths; otherwise as [`RandomModel::sample`].
    pub fn sample_into(
        &self,
        points: &Points,
        samples: Range<u64>,
        [mut process, mut force, mut torque]: [&mut [f64]; 3],
    ) -> Result<(), Error> {
        let (count, nv) = (count_of(&samples)?, self.nv());
        let wide = if process.is_empty() && force.is_empty() { 0 } else { 6 * nv };
        for (name, found, width) in
            [("process", process.len(), wide), ("force", force.len(), wide), ("torque", torque.len(), nv)]
        {
            if Some(found) != count.checked_mul(width) {
                let expected = format!("{count} samples of {width} numbers");
                return Err(Error::Shape { argument: name.to_owned(), found: format!("({found},)"), expected });
            }
        }
        points.check(self.dimension)?;
        self.check_blocks()?;
        let block = BLOCK as u64;
        let pool = Pool::default();
        let mut first = samples.start;
        while first < samples.end {
            // A limited number of blocks at a time, so that their descriptions take little memory.
            let last = samples.end.min((first / block + TOGETHER).saturating_mul(block));
            let (begin, mut rows) = (first / block, Vec::new());
            while first < last {
                let end = last.min((first / block + 1).saturating_mul(block));
                #[allow(clippy::cast_possible_truncation)] // both are within a block
                let lanes = (first % block) as usize..(end - first + first % block) as usize;
                let count = lanes.len();
                let parts = [
                    taken(&mut process, count * wide),
                    taken(&mut force, count * wide),
                    taken(&mut torque, count * nv),
                ];
                rows.push(Rows { lanes, parts });
                first = end;
            }
            let batch =
                Batch { states: rows.len(), cost: COST * BLOCK * self.dimension, pool: &pool, make: || self.block() };
            batch
                .run_pieces(1, &mut rows, |scratch, blocks, rows| {
                    for (i, rows) in blocks.zip(rows) {
                        self.draw(scratch, points.block(begin + i as u64), Wanted::All)
                            .map_err(|error| Fault { state: i, error })?;
                        self.write(scratch, rows);
                    }
                    Ok(())
                })
                .map_err(|fault| fault.error)?;
        }
        Ok(())
    }

    /// Writes the requested samples of a block.
    fn write(&self, block: &Block, Rows { lanes, parts: [process, force, torque] }: &mut Rows<'_>) {
        let (nv, wide) = (self.nv(), 6 * self.nv());
        for (i, lane) in lanes.clone().enumerate() {
            if !process.is_empty() {
                let row = i * wide..(i + 1) * wide;
                self.write_states(block, lane, &mut process[row.clone()], &mut force[row]);
            }
            for (out, of_row) in torque[i * nv..(i + 1) * nv].iter_mut().zip(&block.torque) {
                *out = of_row[lane];
            }
        }
    }

    /// True if there is memory for the blocks of all threads.
    pub(super) fn check_blocks(&self) -> Result<(), Error> {
        #[cfg(feature = "parallel")]
        let threads = if self.shift.len() < FEW { 1 } else { crate::batch::threads() };
        #[cfg(not(feature = "parallel"))]
        let threads = 1;
        memory::room("scene", memory::bytes_of::<Lane>(&[12 * self.shift.len() + self.nv() + 6, threads]))
    }

    /// Scratch for one block.
    pub(super) fn block(&self) -> Block {
        let unset = [f64::NAN; BLOCK];
        let bodies = self.shift.len();
        Block {
            normals: vec![unset; 6],
            process: vec![unset; 6 * bodies],
            force: vec![unset; 6 * bodies],
            torque: vec![unset; self.nv()],
        }
    }

    /// Tip to base: one block of samples (1.1 to 1.4); fails at an interruption.
    pub(super) fn draw(
        &self,
        block: &mut Block,
        mut coordinates: Coordinates<'_>,
        wanted: Wanted,
    ) -> Result<(), Error> {
        block.force.iter_mut().for_each(|lane| lane.fill(0.0));
        for (k, stage) in self.system.stages.iter().enumerate().rev() {
            interrupt::check_at(k, FEW)?;
            let (outboard, here) = block.force.split_at_mut(6 * k);
            let force = &mut here[..6];
            // 1.1: the propagated forces of the bodies outboard, plus w(k) = b(k) + S n.
            let root = &self.roots[k];
            for (used, column) in used_columns(root).enumerate() {
                coordinates.next(&mut block.normals[used]);
                for (i, lane) in force.iter_mut().enumerate() {
                    add_scaled(lane, self.deviation * root[(i, column)], &block.normals[used]);
                }
            }
            if wanted == Wanted::All {
                let process = &mut block.process[6 * k..6 * k + 6];
                for (i, lane) in process.iter_mut().enumerate() {
                    lane.fill(self.bias[k][i]);
                    for (normal, column) in block.normals.iter().zip(used_columns(root)) {
                        add_scaled(lane, self.deviation * root[(i, column)], normal);
                    }
                }
                for (i, lane) in force.iter_mut().enumerate() {
                    for x in lane {
                        *x += self.bias[k][i];
                    }
                }
            }
            // 1.4, with the armature's noise.
            for i in 0..stage.rows.count() {
                let row = stage.first_row + i;
                let torque = &mut block.torque[row];
                measure(&stage.rows.row(i), force, torque);
                if self.system.noise[row] > 0.0 {
                    coordinates.next(&mut block.normals[0]);
                    add_scaled(torque, self.deviation * self.system.noise[row].sqrt(), &block.normals[0]);
                }
            }
            if let Some(parent) = stage.parent {
                carry(&self.shift[k], force, &mut outboard[6 * parent..6 * parent + 6]);
            }
        }
        Ok(())
    }

    fn write_states(&self, block: &Block, lane: usize, process: &mut [f64], force: &mut [f64]) {
        for (k, stage) in self.system.stages.iter().enumerate() {
            let count = stage.rows.count();
            for i in 0..count {
                let at = 6 * (stage.first_row + i);
                let outermost = i + 1 == count;
                for j in 0..6 {
                    process[at + j] = if outermost { block.process[6 * k + j][lane] } else { 0.0 };
                    force[at + j] = block.force[6 * k + j][lane];
                }
            }
        }
    }
}

/// The requested part of a block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Wanted {
    /// W, X and T, with their mean.
    All,
    /// T without its mean.
    CentredTorque,
}

/// y += scale x, nothing where the scale is zero.
fn add_scaled(y: &mut Lane, scale: f64, x: &Lane) {
    if scale != 0.0 {
        for (y, x) in y.iter_mut().zip(x) {
            *y += scale * x;
        }
    }
}

/// tau = H z.
fn measure(hinge: &HingeMap<f64>, force: &[Lane], torque: &mut Lane) {
    match *hinge {
        HingeMap::Axis(i) => torque.copy_from_slice(&force[i]),
        HingeMap::Screw(pitch) => {
            torque.copy_from_slice(&force[2]);
            add_scaled(torque, pitch, &force[5]);
        }
    }
}

/// z(parent) += phi z.
fn carry(shift: &RigidShift<f64>, force: &[Lane], parent: &mut [Lane]) {
    let (r, l) = (&shift.rotation, &shift.lever);
    let [n0, n1, n2, f0, f1, f2] = force else { return };
    let [p0, p1, p2, p3, p4, p5] = parent else { return };
    for s in 0..BLOCK {
        let turn = |v: [f64; 3], i: usize| r[(i, 0)] * v[0] + r[(i, 1)] * v[1] + r[(i, 2)] * v[2];
        let (n, f) = ([n0[s], n1[s], n2[s]], [f0[s], f1[s], f2[s]]);
        let g = [turn(f, 0), turn(f, 1), turn(f, 2)];
        p0[s] += turn(n, 0) + (l[1] * g[2] - l[2] * g[1]);
        p1[s] += turn(n, 1) + (l[2] * g[0] - l[0] * g[2]);
        p2[s] += turn(n, 2) + (l[0] * g[1] - l[1] * g[0]);
        p3[s] += g[0];
        p4[s] += g[1];
        p5[s] += g[2];
    }
}
