//! Contacts in independent groups: G is block diagonal, and the law of each group is solved alone.

use super::gram::Gram;
use super::law::{Cone, ContactState, Limits};
use super::report::{Effort, SolveReport};
use nalgebra::{DMatrix, DVector};

/// The problems of groups of contacts that do not affect each other, with the contacts of each in ascending order.
#[derive(Debug, Clone)]
pub(crate) struct Cones {
    groups: Vec<(Vec<usize>, Cone)>,
    contacts: usize,
}

impl Cones {
    /// From the contacts and the block of G of each group, and the coefficients of friction of all contacts.
    pub fn new(blocks: Vec<(Vec<usize>, Gram)>, friction: &[f64]) -> Self {
        let of = |(members, g): (Vec<usize>, Gram)| {
            let cone = Cone::new(g, members.iter().map(|&i| friction[i]).collect());
            (members, cone)
        };
        Self { groups: blocks.into_iter().map(of).collect(), contacts: friction.len() }
    }

    /// The groups of contacts between which all blocks of G are zero.
    pub fn split(cone: Cone) -> Self {
        let (n, g) = (cone.len(), cone.g.dense().into_owned());
        let coupled = |i: usize, j: usize| g.fixed_view::<3, 3>(3 * i, 3 * j).iter().any(|&g| g != 0.0);
        let mut left: Vec<usize> = (0..n).collect();
        let mut groups = Vec::new();
        while let Some(&first) = left.first() {
            let mut members = vec![first];
            left.remove(0);
            let mut at = 0;
            while at < members.len() {
                let (more, rest): (Vec<usize>, Vec<usize>) = left.iter().partition(|&&j| coupled(members[at], j));
                left = rest;
                members.extend(more);
                at += 1;
            }
            members.sort_unstable();
            if members.len() == n {
                return Self { groups: vec![(members, cone)], contacts: n };
            }
            let rows = rows_of(&members);
            let g = g.select_rows(&rows).select_columns(&rows);
            groups.push((members.clone(), Cone::new(g, members.iter().map(|&i| cone.friction[i]).collect())));
        }
        Self { groups, contacts: n }
    }

    /// r of each contact.
    pub fn lengths(&self) -> Vec<f64> {
        let mut lengths = vec![0.0; self.contacts];
        for (members, cone) in &self.groups {
            members.iter().zip(&cone.lengths).for_each(|(&i, &r)| lengths[i] = r);
        }
        lengths
    }

    /// State of each contact.
    pub fn states(&self, p: &DVector<f64>, c: &DVector<f64>, limits: &Limits) -> Vec<ContactState> {
        let mut states = vec![ContactState::Open; self.contacts];
        for (members, cone) in &self.groups {
            let of = cone.states(&pick(p, members), &pick(c, members), &limits.of(members));
            members.iter().zip(of).for_each(|(&i, of)| states[i] = of);
        }
        states
    }

    /// All contacts as one problem.
    pub fn whole(&self) -> Cone {
        let mut g = DMatrix::zeros(3 * self.contacts, 3 * self.contacts);
        let (mut friction, lengths) = (vec![0.0; self.contacts], self.lengths());
        for (members, cone) in &self.groups {
            let (rows, own) = (rows_of(members), cone.g.dense());
            for (j, &column) in rows.iter().enumerate() {
                for (i, &row) in rows.iter().enumerate() {
                    g[(row, column)] = own[(i, j)];
                }
            }
            members.iter().zip(&cone.friction).for_each(|(&i, &mu)| friction[i] = mu);
        }
        Cone::with_lengths(g.into(), friction, lengths)
    }

    /// [`Cone::solve`] of each group.
    pub fn solve(&self, c: &DVector<f64>, limits: &Limits, effort: Effort) -> (DVector<f64>, SolveReport) {
        self.each(|members, cone| cone.solve(&pick(c, members), None, &limits.of(members), effort))
    }

    /// The impulses of all groups, and their report: the largest residual, and the iterations of all.
    fn each(&self, solve: impl Fn(&[usize], &Cone) -> (DVector<f64>, SolveReport)) -> (DVector<f64>, SolveReport) {
        let (mut all, mut report) = (DVector::zeros(3 * self.contacts), SolveReport::nothing());
        for (members, cone) in &self.groups {
            let (p, solved) = solve(members, cone);
            put(&p, members, &mut all);
            report = report.with(solved);
        }
        (all, report)
    }

    /// G p.
    pub fn response(&self, p: &DVector<f64>) -> DVector<f64> {
        if let [(_, cone)] = &self.groups[..] {
            return cone.g.times(p);
        }
        let mut all = DVector::zeros(p.len());
        for (members, cone) in &self.groups {
            put(&cone.g.times(&pick(p, members)), members, &mut all);
        }
        all
    }

    /// [`Cone::impulses`] of each group.
    pub fn impulses(
        &self,
        c: &DVector<f64>,
        start: Option<&DVector<f64>>,
        limits: &Limits,
        effort: Effort,
    ) -> (DVector<f64>, SolveReport) {
        if let [(_, cone)] = &self.groups[..] {
            return cone.impulses(c, start, limits, effort);
        }
        self.each(|members, cone| {
            let start = start.map(|start| pick(start, members));
            cone.impulses(&pick(c, members), start.as_ref(), &limits.of(members), effort)
        })
    }

    /// [`Cone::shared_evenly`] of each group.
    pub fn shared_evenly(&self, p: DVector<f64>, c: &DVector<f64>, limits: &Limits) -> DVector<f64> {
        if let [(_, cone)] = &self.groups[..] {
            return cone.shared_evenly(p, c, limits);
        }
        let shared = |members: &[usize], cone: &Cone| {
            let p = cone.shared_evenly(pick(&p, members), &pick(c, members), &limits.of(members));
            (p, SolveReport::nothing())
        };
        self.each(shared).0
    }
}

impl From<Cone> for Cones {
    fn from(cone: Cone) -> Self {
        Self { contacts: cone.len(), groups: vec![((0..cone.len()).collect(), cone)] }
    }
}

impl Limits {
    /// The limits of some contacts.
    fn of(&self, members: &[usize]) -> Self {
        Self { least: members.iter().map(|&i| self.least[i]).collect(), scale: self.scale }
    }
}

/// The rows of some contacts.
fn rows_of(members: &[usize]) -> Vec<usize> {
    members.iter().flat_map(|&i| 3 * i..3 * i + 3).collect()
}

fn pick(all: &DVector<f64>, members: &[usize]) -> DVector<f64> {
    DVector::from_fn(3 * members.len(), |i, _| all[3 * members[i / 3] + i % 3])
}

fn put(p: &DVector<f64>, members: &[usize], all: &mut DVector<f64>) {
    for (at, &i) in members.iter().enumerate() {
        all.fixed_rows_mut::<3>(3 * i).copy_from(&p.fixed_rows::<3>(3 * at));
    }
}
