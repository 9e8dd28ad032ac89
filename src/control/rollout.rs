//! Motions under the law `u = u_0 + length k - K x` for several step lengths, each in a lane.

use super::costs::Motion;
use super::dynamics::{AT_ONCE, Dynamics};
use super::knot::Sizes;
use super::matrices::{Read, add_times};
use crate::batch::instruction_set::within_widest;
use crate::error::Error;

/// The laws of all steps about a motion.
#[derive(Debug, Clone, Copy)]
pub struct Laws<'a> {
    pub about: &'a Motion,
    /// K, (steps x controls x state), and k, (steps x controls).
    pub gains: &'a [f64],
    pub offsets: &'a [f64],
    /// The defects of the motion, (steps x 2 nv); empty if all are zero.
    pub defects: &'a [f64],
    /// Bounds of the efforts, (nv).
    pub bounds: [&'a [f64]; 2],
}

/// Scratch for [`AT_ONCE`] motions.
#[derive(Debug, Default)]
pub struct Rollouts {
    pub motions: Vec<Motion>,
    /// The fault of each motion that ended.
    pub faults: Vec<Option<Error>>,
    deviation: Vec<f64>,
    change: Vec<f64>,
    accelerations: Vec<f64>,
    increment: Vec<f64>,
    moved: Vec<f64>,
}

within_widest! {
    /// Subtracts K x from `change`.
    fn subtract_times<'a>(change: &'a mut [f64], gain: &'a [f64], x: &'a [f64]) {
        add_times(change, Read::rows(gain, x.len()), x, -1.0);
    }
}

impl Rollouts {
    pub fn new(nq: usize, nv: usize, steps: usize) -> Self {
        let nan = |length: usize| vec![f64::NAN; length];
        let motion = || Motion { q: nan((steps + 1) * nq), qd: nan((steps + 1) * nv), tau: nan(steps * nv) };
        Self {
            motions: (0..AT_ONCE).map(|_| motion()).collect(),
            faults: vec![None; AT_ONCE],
            deviation: nan(3 * nv),
            change: nan(nv),
            accelerations: nan(AT_ONCE * nv),
            increment: nan(2 * nv),
            moved: nan(nq),
        }
    }

    /// Runs one motion for each step length; a motion whose dynamics fail has its fault.
    pub fn run(&mut self, dynamics: &mut Dynamics, sizes: Sizes, laws: &Laws<'_>, lengths: &[f64]) {
        let (nq, nv, m, n) = (dynamics.scene().nq(), sizes.nv, sizes.controls, sizes.state());
        let steps = laws.about.tau.len() / nv.max(1);
        let count = lengths.len();
        for (motion, fault) in self.motions.iter_mut().zip(&mut self.faults).take(count) {
            *fault = None;
            motion.q[..nq].copy_from_slice(&laws.about.q[..nq]);
            motion.qd[..nv].copy_from_slice(&laws.about.qd[..nv]);
        }
        for step in 0..steps {
            for (lane, &length) in lengths.iter().enumerate() {
                if self.faults[lane].is_none()
                    && let Err(error) = self.control(dynamics, (sizes, m, n), laws, (step, lane, length))
                {
                    self.faults[lane] = Some(error);
                }
            }
            // A state that fails is replaced by that of the old motion, and the others run again.
            while self.faults[..count].iter().any(Option::is_none) {
                let (motions, faults) = (&self.motions, &self.faults);
                let states = (0..count).map(|lane| {
                    let of = if faults[lane].is_none() { &motions[lane] } else { laws.about };
                    (&of.q[step * nq..][..nq], &of.qd[step * nv..][..nv], &of.tau[step * nv..][..nv])
                });
                match dynamics.accelerations(states, &mut self.accelerations[..count * nv]) {
                    Ok(()) => break,
                    Err(fault) if self.faults[fault.state].is_none() => {
                        self.faults[fault.state] = Some(fault.error);
                    }
                    Err(fault) => {
                        self.faults[..count].iter_mut().for_each(|of| *of = Some(fault.error.clone()));
                    }
                }
            }
            for (lane, &length) in lengths.iter().enumerate() {
                if self.faults[lane].is_none()
                    && let Err(error) = self.advance(dynamics, (nq, nv), laws, (step, lane, length))
                {
                    self.faults[lane] = Some(error);
                }
            }
        }
    }

    /// The efforts of a step.
    fn control(
        &mut self,
        dynamics: &Dynamics,
        (sizes, m, n): (Sizes, usize, usize),
        laws: &Laws<'_>,
        (step, lane, length): (usize, usize, f64),
    ) -> Result<(), Error> {
        let (nq, nv) = (dynamics.scene().nq(), sizes.nv);
        let (motion, about) = (&mut self.motions[lane], laws.about);
        let own = step * nv..(step + 1) * nv;
        let x = &mut self.deviation[..n];
        x.fill(0.0);
        if step > 0 {
            let configurations = step * nq..(step + 1) * nq;
            dynamics.scene().difference(&about.q[configurations.clone()], &motion.q[configurations], &mut x[..nv])?;
            let rates = about.qd[own.clone()].iter().zip(&motion.qd[own.clone()]);
            for (x, (from, to)) in x[nv..].iter_mut().zip(rates) {
                *x = to - from;
            }
            if sizes.has_rate {
                for (x, &row) in x[2 * nv..].iter_mut().zip(&dynamics.driven) {
                    let before = (step - 1) * nv + row;
                    *x = motion.tau[before] - about.tau[before];
                }
            }
        }
        let change = &mut self.change[..m];
        for (change, offset) in change.iter_mut().zip(&laws.offsets[step * m..]) {
            *change = length * offset;
        }
        subtract_times(change, &laws.gains[step * m * n..(step + 1) * m * n], x);
        let tau = &mut motion.tau[own.clone()];
        tau.copy_from_slice(&about.tau[own]);
        for (change, &row) in change.iter().zip(&dynamics.driven) {
            tau[row] = (tau[row] + change).clamp(laws.bounds[0][row], laws.bounds[1][row]);
        }
        Ok(())
    }

    /// The next state, from which the share of the defects that the step length leaves is subtracted.
    fn advance(
        &mut self,
        dynamics: &Dynamics,
        (nq, nv): (usize, usize),
        laws: &Laws<'_>,
        (step, lane, length): (usize, usize, f64),
    ) -> Result<(), Error> {
        let motion = &mut self.motions[lane];
        let (rates, rates_next) = motion.qd.split_at_mut((step + 1) * nv);
        let (before, after) = motion.q.split_at_mut((step + 1) * nq);
        let (v_next, x) = (&mut rates_next[..nv], &mut self.increment[..nv]);
        let state = (&before[step * nq..], &rates[step * nv..], &self.accelerations[lane * nv..][..nv]);
        dynamics.advance(state, x, (&mut after[..nq], v_next))?;
        if !laws.defects.is_empty() && length < 1.0 {
            let defect = &laws.defects[step * 2 * nv..][..2 * nv];
            for i in 0..nv {
                x[i] = (length - 1.0) * defect[i];
                v_next[i] += (length - 1.0) * defect[nv + i];
            }
            self.moved.copy_from_slice(&after[..nq]);
            dynamics.scene().integrate(&self.moved, x, &mut after[..nq])?;
        }
        Ok(())
    }
}
