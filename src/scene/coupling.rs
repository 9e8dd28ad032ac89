//! Coupled (mimic) joints: the coordinates of the tree from fewer independent ones, q = G q' + o and qd = G qd'.

use super::constraint::{Constraints, Coupled, Tie};
use super::description::{Mimic, MimicJoints};
use super::polynomial::Polynomial;
use super::shared::Shared;
use super::{Joint, Scene};
use crate::algorithm::KinematicQuantity;
use crate::algorithm::table::{self, Array, Axis, Sizes};
use crate::error::{Error, check_length};
use crate::filter::{HingeMap, Rows};
use crate::joints::JointKind;
use crate::model::{Identity, Model};
use crate::scalar::Real;
use std::borrow::Cow;
use std::collections::{HashMap, HashSet};
use std::sync::{Arc, OnceLock};

/// The armature of a joint without inertia that another joint of its group gives, relative to the inertia that this
/// joint moves: small, so that the other pivot stays positive.
const GIVEN: f64 = 1.0 / (1 << 20) as f64;

/// The map of one coordinate of the tree.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Coordinate {
    /// Index of the independent coordinate.
    index: usize,
    multiplier: f64,
    offset: f64,
}

/// Coupling of the joints of a scene, which eliminates dependent coordinates.
///
/// The tree has coordinates for every joint. The scene has only the independent coordinates q': q = G q' + o, qd = G
/// qd', qdd = G qdd'. Torques act on the independent coordinates, tau' = G^T tau, and the mass matrix is G^T M G.
///
/// # Panics
///
/// All methods except [`Coupling::tree`] and [`Coupling::sizes`] panic if an array is too short.
#[derive(Debug)]
pub struct Coupling {
    tree: Scene,
    q: Vec<Coordinate>,
    /// Per velocity of the tree: index of the independent velocity, and multiplier.
    v: Vec<(usize, f64)>,
    /// Index in the tree of each independent velocity.
    independent: Vec<usize>,
    /// Index in the tree of each independent coordinate.
    independent_q: Vec<usize>,
    /// The inertia that each joint of one axis moves, without that of levers, (nv of the tree).
    inertia: Vec<f64>,
    /// For each independent velocity, the row of the tree that moves the most inertia with it. The others follow this
    /// one, so that the forces of the rows do not cancel at a light joint.
    heaviest: Vec<usize>,
    /// Created at first use.
    tied: OnceLock<Scene>,
    weightless: OnceLock<Scene>,
}

impl Coupling {
    /// The scene in which every joint has its own coordinates.
    #[must_use]
    pub fn tree(&self) -> &Scene {
        &self.tree
    }

    /// The tree with one row x = multiplier y + offset per joint that follows another, as if these were connections.
    pub(crate) fn tied(&self) -> &Scene {
        self.tied.get_or_init(|| {
            let (identity, constraints, shared) = (Identity::unique(), self.as_constraints(), Shared::default());
            let mut tied = Scene { identity, constraints, shared, ..self.tree.clone() };
            self.give_armature(&mut tied.model.system.noise);
            tied
        })
    }

    /// The same without gravity: its accelerations at rest are (G^T M G)^-1 times the torques.
    pub(crate) fn weightless(&self) -> &Scene {
        self.weightless.get_or_init(|| {
            let (identity, shared) = (Identity::unique(), Shared::default());
            let mut scene = Scene { identity, shared, ..self.tied().clone() };
            scene.model.gravity.fill(0.0);
            scene
        })
    }

    /// Moves armature (nv of the tree) to joints without inertia and armature from others which move with them: without
    /// an effect on the independent coordinates.
    pub(crate) fn give_armature(&self, armature: &mut [f64]) {
        let given = given_armature(armature, (&self.v, &self.heaviest, &self.inertia));
        armature.iter_mut().zip(given).for_each(|(armature, given)| *armature += given);
    }

    /// Numbers of independent coordinates and velocities.
    #[must_use]
    pub fn sizes(&self) -> (usize, usize) {
        (self.independent_q.len(), self.independent.len())
    }

    /// Names of the joints of the tree that an independent joint moves, beginning with its own name.
    pub(crate) fn moved_by(&self, joint: &Joint) -> Vec<String> {
        let first = joint.v.start;
        let mut names = vec![joint.name.clone()];
        let others = self.tree.joints.iter().filter(|other| other.name != joint.name);
        names.extend(others.filter(|other| self.v[other.v.start].0 == first).map(|other| other.name.clone()));
        names
    }

    /// Configuration q = G q' + o of the tree, for a configuration of the scene.
    #[must_use]
    pub fn configuration<T: Real>(&self, q: &[T]) -> Vec<T> {
        self.q.iter().map(|of| T::from_f64(of.multiplier) * q[of.index] + T::from_f64(of.offset)).collect()
    }

    /// Velocities or accelerations G x of the tree, for those of the scene.
    #[must_use]
    pub fn rates<T: Real>(&self, x: &[T]) -> Vec<T> {
        self.v.iter().map(|&(index, multiplier)| T::from_f64(multiplier) * x[index]).collect()
    }

    /// Torques of the tree with the same effect as `tau`: they act at the independent joints only.
    #[must_use]
    pub fn torques<T: Real>(&self, tau: &[T]) -> Vec<T> {
        let mut full = vec![T::zero(); self.v.len()];
        for (&row, &value) in self.independent.iter().zip(tau) {
            full[row] = value;
        }
        full
    }

    /// Number of velocities of the tree that move with one of them, itself included.
    pub(crate) fn rows_with(&self, row: usize) -> usize {
        self.v.iter().filter(|(index, _)| *index == self.v[row].0).count()
    }

    /// Index in the tree of each independent velocity.
    pub(crate) fn independent_rows(&self) -> &[usize] {
        &self.independent
    }

    /// Index in the tree of each independent coordinate.
    pub(crate) fn independent_coordinates_at(&self) -> &[usize] {
        &self.independent_q
    }

    /// Torques of the tree with the same effect as `tau`, at the heaviest joints.
    pub(crate) fn acting<T: Real>(&self, tau: &[T]) -> Vec<T> {
        let mut full = vec![T::zero(); self.v.len()];
        for (&row, &value) in self.heaviest.iter().zip(tau) {
            full[row] = value / T::from_f64(self.v[row].1);
        }
        full
    }

    /// The independent accelerations, from those of the tree at the heaviest joints.
    pub(crate) fn accelerations<T: Real>(&self, qdd: &[T]) -> Vec<T> {
        self.heaviest.iter().map(|&row| qdd[row] / T::from_f64(self.v[row].1)).collect()
    }

    /// Armature of the tree with the same effect as that of the independent coordinates, at the heaviest joints.
    pub(crate) fn armature(&self, of_scene: &[f64]) -> Vec<f64> {
        let over: Vec<f64> = self.heaviest.iter().zip(of_scene).map(|(&row, value)| value / self.v[row].1).collect();
        self.acting(&over)
    }

    /// Gradients by the armature of the independent coordinates, from those by the armature of the tree.
    pub(crate) fn by_armature(&self, of_tree: &[f64]) -> impl Iterator<Item = f64> {
        self.heaviest.iter().map(|&row| of_tree[row] / self.v[row].1.powi(2))
    }

    /// Restores G of accelerations of the tree exactly, from the rows that move the most inertia with this armature.
    pub(crate) fn restore_rates(&self, armature: &[f64], x: &mut [f64]) {
        let of = heaviest(&self.v, &self.independent, &self.inertia, armature);
        let independent: Vec<f64> = of.iter().map(|&row| x[row] / self.v[row].1).collect();
        x.copy_from_slice(&self.rates(&independent));
    }

    /// The independent entries of velocities or accelerations of the tree.
    #[must_use]
    pub fn independent_rates<T: Real>(&self, x: &[T]) -> Vec<T> {
        self.independent.iter().map(|&row| x[row]).collect()
    }

    /// The independent entries of a configuration of the tree.
    #[must_use]
    pub fn independent_coordinates(&self, q: &[f64]) -> Vec<f64> {
        self.independent_q.iter().map(|&at| q[at]).collect()
    }

    /// Restores the coupling of a state of the tree exactly, because rounding errors would accumulate over many steps.
    pub(crate) fn restore(&self, q: &mut [f64], qd: &mut [f64]) {
        q.copy_from_slice(&self.configuration(&self.independent_coordinates(q)));
        qd.copy_from_slice(&self.rates(&self.independent_rates(qd)));
    }

    /// An argument of a function of the tree, for that of the scene: a configuration (`q`) or rates; with `acts`, in
    /// forward dynamics, also torques and cotangents of accelerations, which act at the heaviest joints.
    pub(crate) fn expanded<T: Real>(&self, name: &str, acts: bool, x: &[T]) -> Vec<T> {
        match name {
            _ if x.is_empty() => Vec::new(),
            "q" => self.configuration(x),
            "tau" | "dtau" | "cotangent" if acts => self.acting(x),
            _ => self.rates(x),
        }
    }

    /// The results of a function of the tree, of these sizes, reduced to the independent velocities; returns the values
    /// after them. `acts` is that of [`Coupling::reduced`].
    pub(crate) fn reduced_all<'x, T: Real>(
        &self,
        arrays: &[Array],
        (sizes, acts): (&Sizes, bool),
        mut x: &'x [T],
        out: &mut Vec<T>,
    ) -> &'x [T] {
        for &array in arrays {
            let (of_tree, others) = x.split_at(table::width(array, sizes));
            self.reduced(array, acts, of_tree, out);
            x = others;
        }
        x
    }

    /// A kinematic quantity of one state, `out`, from that of the tree.
    pub(crate) fn reduce_quantity(&self, what: &KinematicQuantity<'_>, of_tree: &[f64], out: &mut [f64]) {
        let (sizes, mut reduced) = (what.sizes(self.v.len()), Vec::with_capacity(out.len()));
        self.reduced_all(what.entry().results, (&sizes, false), of_tree, &mut reduced);
        out.copy_from_slice(&reduced);
    }

    /// A result of a function of the tree, reduced to the independent velocities; with `acts`, in forward dynamics, the
    /// rows of accelerations and the columns or gradients by torques are those of the heaviest joints.
    pub(crate) fn reduced<T: Real>(&self, (name, axes): Array, acts: bool, x: &[T], out: &mut Vec<T>) {
        let (start, nv) = (out.len(), self.independent.len());
        match axes {
            [Axis::Velocities] if acts && !matches!(name, "gradient_q" | "gradient_qd") => {
                out.append(&mut self.accelerations(x));
            }
            [Axis::Velocities, Axis::Velocities] if acts => {
                let full = self.v.len();
                out.resize(start + nv * nv, T::zero());
                for (&row, to) in self.heaviest.iter().zip(out[start..].chunks_exact_mut(nv.max(1))) {
                    let multiplier = T::from_f64(self.v[row].1);
                    let row: Vec<T> = x[row * full..(row + 1) * full].iter().map(|&x| x / multiplier).collect();
                    if name == "Minv" {
                        to.copy_from_slice(&self.accelerations(&row));
                    } else {
                        self.reduce(&row, to);
                    }
                }
                if name == "Minv" {
                    mirror(nv, &mut out[start..]);
                }
            }
            [Axis::Velocities] => {
                out.resize(start + nv, T::zero());
                self.reduce(x, &mut out[start..]);
            }
            [Axis::Velocities, Axis::Velocities] => {
                out.resize(start + nv * nv, T::zero());
                self.reduce_matrix(x, &mut out[start..]);
            }
            [Axis::Fixed(rows), Axis::Velocities] => {
                out.resize(start + rows * nv, T::zero());
                self.reduce_columns(x, &mut out[start..]);
            }
            [Axis::Fixed(rows), Axis::Velocities, Axis::Velocities] => {
                out.resize(start + rows * nv * nv, T::zero());
                let of_tree = x.chunks_exact((x.len() / rows).max(1));
                for (x, out) in of_tree.zip(out[start..].chunks_exact_mut((nv * nv).max(1))) {
                    self.reduce_matrix(x, out);
                }
            }
            _ => out.extend_from_slice(x),
        }
    }

    /// One row per joint that follows another, x = multiplier y + offset.
    fn as_constraints(&self) -> Constraints {
        let mut constraints = Constraints { neutral: self.tree.neutral(), ..Constraints::default() };
        for joint in self.tree.joints.iter().filter(|joint| joint.q.len() == 1) {
            let (own, (group, _)) = (self.q[joint.q.start], self.v[joint.v.start]);
            let Some(heaviest) = self.tree.joints.iter().find(|other| other.v.start == self.heaviest[group]) else {
                continue;
            };
            if heaviest.v == joint.v {
                continue;
            }
            let of = self.q[heaviest.q.start];
            let multiplier = own.multiplier / of.multiplier;
            let offset = own.offset - multiplier * of.offset;
            let (first, second) = (self.tree.coordinate(joint), Some(self.tree.coordinate(heaviest)));
            let polynomial = Polynomial::linear(multiplier, offset);
            let tie = Tie::Coordinates(Coupled { first, second, polynomial });
            self.tree.constrain(&mut constraints, joint.name.clone(), tie);
        }
        constraints
    }

    /// Checks that a state of the tree satisfies the coupling to within 1e-9, relative to the larger of 1 and the
    /// coordinate.
    pub(crate) fn check_followed(&self, q: &[f64], qd: &[f64]) -> Result<(), Error> {
        const SLACK: f64 = 1e-9;
        let followed = self.configuration(&self.independent_coordinates(q));
        let rates = self.rates(&self.independent_rates(qd));
        for (name, given, followed) in [("q", q, followed), ("qd", qd, rates)] {
            let differs = |(x, y): (&f64, &f64)| !((x - y).abs() <= SLACK * y.abs().max(1.0));
            if let Some(at) = given.iter().zip(&followed).position(differs) {
                let found = format!("{} at index {at}", given[at]);
                let expected = format!("{}, because this joint follows another (mimic)", followed[at]);
                return Err(Error::argument(name, found, expected));
            }
        }
        Ok(())
    }

    /// Armature, damping or stiffness at the independent coordinates: the sum over the joints of the tree, weighted by
    /// the squares of their multipliers.
    #[must_use]
    pub fn reduce_squares(&self, x: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; self.independent.len()];
        for (&(index, multiplier), value) in self.v.iter().zip(x) {
            out[index] += multiplier * multiplier * value;
        }
        out
    }

    /// Coulomb friction at the independent coordinates: the sum weighted by the absolute values of the multipliers.
    #[must_use]
    pub fn reduce_friction(&self, x: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; self.independent.len()];
        for (&(index, multiplier), value) in self.v.iter().zip(x) {
            out[index] += multiplier.abs() * value;
        }
        out
    }

    /// Limits of each independent coordinate: the intersection of its own limits and those of the joints that follow
    /// it.
    pub(crate) fn limits(&self) -> Vec<(f64, f64)> {
        let mut out = vec![(f64::NEG_INFINITY, f64::INFINITY); self.independent_q.len()];
        for joint in self.tree.joints.iter().filter(|joint| joint.q.len() == 1) {
            let Coordinate { index, multiplier, offset } = self.q[joint.q.start];
            if multiplier == 0.0 {
                continue;
            }
            let [a, b] = [joint.limits.lower, joint.limits.upper].map(|bound| (bound - offset) / multiplier);
            let (lower, upper) = out[index];
            out[index] = (lower.max(a.min(b)), upper.min(a.max(b)));
        }
        out
    }

    /// Velocity limit of each independent velocity: the smallest of its own and those of the joints that follow it.
    pub(crate) fn velocity_limits(&self, limits: &[f64]) -> Vec<f64> {
        let mut out = vec![f64::INFINITY; self.independent.len()];
        for (&(index, multiplier), limit) in self.v.iter().zip(limits).filter(|((_, multiplier), _)| *multiplier != 0.0)
        {
            out[index] = out[index].min(limit / multiplier.abs());
        }
        out
    }

    /// Rest positions of the independent coordinates, for stiffness (nv) and rest positions (nq) of the tree: the mean
    /// weighted by stiffness.
    #[must_use]
    pub fn reduce_rest(&self, stiffness: &[f64], rest: &[f64]) -> Vec<f64> {
        let mut out = self.independent_coordinates(rest);
        let one_axis = self.tree.joints.iter().filter(|joint| joint.q.len() == 1);
        let mut sums = vec![(0.0, 0.0); out.len()];
        for joint in one_axis {
            let Coordinate { index, multiplier, offset } = self.q[joint.q.start];
            let k = stiffness[joint.v.start];
            sums[index].0 += k * multiplier * multiplier;
            sums[index].1 += k * multiplier * (rest[joint.q.start] - offset);
        }
        for (out, (stiffness, moment)) in out.iter_mut().zip(sums) {
            if stiffness > 0.0 {
                *out = moment / stiffness;
            }
        }
        out
    }

    /// Writes G^T tau to `out`, for torques of the tree.
    pub fn reduce<T: Real>(&self, tau: &[T], out: &mut [T]) {
        out.fill(T::zero());
        for (&(index, multiplier), &value) in self.v.iter().zip(tau) {
            out[index] += T::from_f64(multiplier) * value;
        }
    }

    /// Writes X G to `out`, row-major, for a matrix with one column per velocity of the tree.
    pub fn reduce_columns<T: Real>(&self, x: &[T], out: &mut [T]) {
        let (full, nv) = (self.v.len(), self.independent.len());
        if full > 0 {
            for (row, out) in x.chunks_exact(full).zip(out.chunks_exact_mut(nv)) {
                self.reduce(row, out);
            }
        }
    }

    /// Writes G^T X to `out`, row-major, for a matrix with one row of `width` entries per velocity of the tree.
    pub fn reduce_rows<T: Real>(&self, x: &[T], width: usize, out: &mut [T]) {
        out.fill(T::zero());
        for (&(index, multiplier), row) in self.v.iter().zip(x.chunks_exact(width.max(1))) {
            for (sum, &value) in out[index * width..].iter_mut().zip(row) {
                *sum += T::from_f64(multiplier) * value;
            }
        }
    }

    /// Writes G^T X G to `out`, row-major, for a square matrix of the tree.
    pub fn reduce_matrix<T: Real>(&self, x: &[T], out: &mut [T]) {
        let (full, nv) = (self.v.len(), self.independent.len());
        let mut columns = vec![T::zero(); full * nv];
        self.reduce_columns(x, &mut columns);
        self.reduce_rows(&columns, nv, out);
    }
}

impl Scene {
    /// The coupling of its joints; `None` if all joints are independent.
    #[must_use]
    pub fn coupling(&self) -> Option<&Coupling> {
        self.coupling.as_deref()
    }

    /// A shared reference to the coupling.
    pub(crate) fn shared_coupling(&self) -> Option<Arc<Coupling>> {
        self.coupling.clone()
    }

    /// The scene in which every joint has its own coordinates: this scene, unless joints are coupled.
    #[must_use]
    pub fn tree(&self) -> &Self {
        self.coupling().map_or(self, Coupling::tree)
    }

    /// Checks a configuration of the scene and returns that of the tree.
    pub(crate) fn tree_configuration<'a>(&self, argument: &str, q: &'a [f64]) -> Result<Cow<'a, [f64]>, Error> {
        self.check_coordinates(argument, q)?;
        Ok(self.coupling().map_or(Cow::Borrowed(q), |coupling| coupling.configuration(q).into()))
    }

    /// Checks velocities or accelerations of the scene and returns those of the tree.
    pub(crate) fn tree_rates<'a>(&self, argument: &str, x: &'a [f64]) -> Result<Cow<'a, [f64]>, Error> {
        self.check_rates(argument, x)?;
        Ok(self.coupling().map_or(Cow::Borrowed(x), |coupling| coupling.rates(x).into()))
    }

    /// A matrix (rows x nv), row-major, with a column per degree of freedom of the scene, from `write`, which computes
    /// it for the tree.
    pub(crate) fn tree_columns(
        &self,
        rows: usize,
        out: &mut [f64],
        write: impl FnOnce(&mut [f64]),
    ) -> Result<(), Error> {
        check_length("out", out.len(), rows * self.nv())?;
        let Some(coupling) = self.coupling() else {
            write(out);
            return Ok(());
        };
        let mut columns = vec![f64::NAN; rows * coupling.tree().nv()];
        write(&mut columns);
        coupling.reduce_columns(&columns, out);
        Ok(())
    }

    /// Returns an error for a scene with coupled joints, for methods that do not support them.
    pub(crate) fn check_independent(&self) -> Result<(), Error> {
        let Some(coupling) = self.coupling() else { return Ok(()) };
        let followers = coupling.tree.joints.len() - self.joints.len();
        let found = format!("{followers} joints that follow others (mimic)");
        let expected = format!(
            "independent joints, which this method requires: build the scene with {}",
            MimicJoints::Free.text()
        );
        Err(Error::argument("scene", found, expected))
    }

    /// Reduces the scene of a tree with mimic joints; returns the tree itself if it has none.
    pub(super) fn coupled(tree: Self) -> Result<Self, Error> {
        let Some(follows) = followed(&tree)? else { return Ok(tree) };
        if let Some(connection) = tree.connections().first() {
            let expected = format!(
                "{}, and a connection of each mimic joint with the one that it follows",
                MimicJoints::Free.text()
            );
            let found = "joints that follow others (mimic) in a scene with a connection";
            return Err(Error::scene(format!("connection {:?}", connection.name), found, expected));
        }
        let mut joints = Vec::with_capacity(tree.joints.len());
        let (mut q, mut v) = (vec![], vec![]);
        let (mut independent_q, mut independent) = (Vec::new(), Vec::new());
        let mut place = HashMap::new();
        for joint in tree.joints.iter().filter(|joint| !follows.contains_key(joint.name.as_str())) {
            place.insert(joint.name.as_str(), (independent_q.len(), independent.len()));
            let own = Joint {
                q: independent_q.len()..independent_q.len() + joint.q.len(),
                v: independent.len()..independent.len() + joint.v.len(),
                ..joint.clone()
            };
            independent_q.extend(joint.q.clone());
            independent.extend(joint.v.clone());
            joints.push(own);
        }
        for joint in &tree.joints {
            let (name, multiplier, offset) = match follows.get(joint.name.as_str()) {
                Some(&follows) => follows,
                None => (joint.name.as_str(), 1.0, 0.0),
            };
            let (first_q, first_v) = place[name];
            q.extend((0..joint.q.len()).map(|i| Coordinate { index: first_q + i, multiplier, offset }));
            v.extend((0..joint.v.len()).map(|i| (first_v + i, multiplier)));
        }
        let inertia = moved_inertia(&tree.model);
        let heaviest = heaviest(&v, &independent, &inertia, &tree.model.system.noise);
        let joint_index = joints.iter().enumerate().map(|(at, joint)| (joint.name.clone(), at)).collect();
        let mut scene = Self::unfilled(tree.source.clone(), tree.warnings.clone());
        scene.model = tree.model.clone();
        scene.links.clone_from(&tree.links);
        scene.link_index.clone_from(&tree.link_index);
        scene.merged.clone_from(&tree.merged);
        scene.joint_of_body = vec![None; tree.joint_of_body.len()];
        (scene.joints, scene.joint_index) = (joints, joint_index);
        let (tied, weightless) = (OnceLock::new(), OnceLock::new());
        let coupling = Coupling { tree, q, v, independent, independent_q, inertia, heaviest, tied, weightless };
        scene.coupling = Some(Arc::new(coupling));
        Ok(scene)
    }
}

/// Copies the upper triangle of a matrix (nv x nv) to the lower one.
pub(crate) fn mirror<T: Copy>(nv: usize, matrix: &mut [T]) {
    for row in 0..nv {
        for column in 0..row {
            matrix[row * nv + column] = matrix[column * nv + row];
        }
    }
}

/// The inertia that each joint of one axis moves, without that of levers.
fn moved_inertia(model: &Model<f64>) -> Vec<f64> {
    let stages = &model.system.stages;
    let mut outboard: Vec<_> = model.bodies.iter().map(|body| body.inertia_terms).collect();
    for (k, stage) in stages.iter().enumerate().rev() {
        if let Some(parent) = stage.parent {
            let own = outboard[k];
            outboard[parent] += own;
        }
    }
    let mut inertia = vec![0.0; model.nv()];
    for (stage, terms) in stages.iter().zip(&outboard) {
        if let Rows::One(hinge) = stage.rows {
            let first = if matches!(hinge, HingeMap::Axis(3..)) { 3 } else { 0 };
            inertia[stage.first_row] = terms.fixed_rows::<3>(first).sum();
        }
    }
    inertia
}

/// For each group of rows in `v`, the row that moves the most inertia; the independent row if none moves more.
fn heaviest(v: &[(usize, f64)], independent: &[usize], inertia: &[f64], armature: &[f64]) -> Vec<usize> {
    let size = |row: usize| v[row].1 * v[row].1 * (inertia[row] + armature[row]);
    let mut heaviest = independent.to_vec();
    for (row, &(group, _)) in v.iter().enumerate() {
        if size(row) > size(heaviest[group]) {
            heaviest[group] = row;
        }
    }
    heaviest
}

/// The armature that joints without inertia get from the heaviest joint of their group: r for the former, -r (w / w')^2
/// for the latter, where w and w' are their multipliers in `v`. Without it they have no pivot of their own.
fn given_armature(armature: &[f64], (v, heaviest, inertia): (&[(usize, f64)], &[usize], &[f64])) -> Vec<f64> {
    let mut given = vec![0.0; v.len()];
    for (row, &(group, multiplier)) in v.iter().enumerate() {
        let giver = heaviest[group];
        if row != giver && inertia[row] + armature[row] == 0.0 {
            let ratio = (multiplier / v[giver].1).powi(2);
            given[row] = GIVEN * (inertia[giver] + armature[giver]) / ratio.max(1.0);
            given[giver] -= given[row] * ratio;
        }
    }
    given
}

/// For each joint that follows another: the independent joint at the end of the chain, multiplier and offset; `None` if
/// no joint follows another. Resolves each joint once, in time linear in the number of joints for chains of any length.
#[allow(clippy::type_complexity)] // a map from joint names
fn followed(tree: &Scene) -> Result<Option<HashMap<&str, (&str, f64, f64)>>, Error> {
    let mimics: HashMap<&str, &Mimic> = tree
        .source
        .joints
        .iter()
        .filter(|joint| joint.kind != JointKind::Fixed)
        .filter_map(|joint| joint.mimic.as_ref().map(|mimic| (joint.name.as_str(), mimic)))
        .collect();
    if mimics.is_empty() {
        return Ok(None);
    }
    let mut follows: HashMap<&str, (&str, f64, f64)> = HashMap::new();
    for joint in &tree.joints {
        let subject = || format!("joint {:?}", joint.name);
        // Follows the chain to a joint that is independent or already resolved.
        let (mut name, mut path) = (joint.name.as_str(), Vec::new());
        let mut seen = HashSet::from([name]);
        while let Some(&mimic) = mimics.get(name).filter(|_| !follows.contains_key(name)) {
            one_axis(tree, name)?;
            path.push((name, mimic));
            name = &mimic.joint;
            if !seen.insert(name) {
                let names: Vec<&str> = path.iter().map(|&(name, _)| name).collect();
                let found = format!("a cycle of mimics: {}, {name}", names.join(", "));
                return Err(Error::scene(subject(), found, "a joint to follow that does not follow this one"));
            }
            if !tree.joint_index.contains_key(name) {
                let known = tree.source.joints.iter().any(|other| other.name == name);
                let what = if known { "which does not move" } else { "which does not exist" };
                let expected =
                    format!("a joint that moves, or {} to have this one independent", MimicJoints::Free.text());
                return Err(Error::scene(subject(), format!("a mimic of joint {name:?}, {what}"), expected));
            }
        }
        if path.is_empty() {
            continue;
        }
        let (source, mut multiplier, mut offset) = follows.get(name).copied().unwrap_or((name, 1.0, 0.0));
        one_axis(tree, source)?;
        for &(name, mimic) in path.iter().rev() {
            offset = mimic.multiplier * offset + mimic.offset;
            multiplier *= mimic.multiplier;
            if !(multiplier.is_finite() && offset.is_finite()) {
                let found = format!("{multiplier} and {offset} of joint {source:?}, over all joints between");
                let expected = "multipliers and offsets whose products are finite";
                return Err(Error::scene(format!("joint {name:?}"), format!("a mimic with {found}"), expected));
            }
            follows.insert(name, (source, multiplier, offset));
        }
    }
    Ok(Some(follows))
}

/// Checks that the joint has one coordinate; others cannot follow or be followed.
fn one_axis(tree: &Scene, name: &str) -> Result<(), Error> {
    match tree.joint_index.get(name).map(|&at| &tree.joints[at]) {
        Some(joint) if joint.q.len() != 1 => Err(Error::scene(
            format!("joint {name:?}"),
            format!("a mimic between joints of several coordinates ({})", joint.kind.name()),
            "revolute, continuous, prismatic or screw joints",
        )),
        _ => Ok(()),
    }
}
