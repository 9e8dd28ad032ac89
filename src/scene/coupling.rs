//! Joints that follow others: the coordinates of a tree from fewer, q = G q' + o and qd = G qd'.

use super::description::Mimic;
use super::{Joint, Scene};
use crate::error::{Error, check_length};
use crate::filter::summed::Sums;
use crate::joints::JointKind;
use std::borrow::Cow;
use std::collections::{HashMap, HashSet};
use std::sync::Arc;

/// Where one coordinate of the tree comes from.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Coordinate {
    /// Index among the independent ones.
    index: usize,
    multiplier: f64,
    offset: f64,
}

/// How the joints of a scene follow each other: a true reduction of its coordinates.
///
/// The tree has one coordinate for every joint; the scene's own q' leaves out those of joints that follow another: q = G q' + o, qd = G qd', qdd = G qdd'. Torques are
/// those on the independent coordinates, tau' = G^T tau, and the mass matrix is G^T M G.
///
/// # Panics
///
/// Its methods, but for [`Coupling::tree`] and [`Coupling::sizes`], panic where an array is shorter than they say.
#[derive(Debug)]
pub struct Coupling {
    tree: Scene,
    q: Vec<Coordinate>,
    /// Of each rate of the tree: index among the independent ones, and multiplier.
    v: Vec<(usize, f64)>,
    /// Of each independent rate, the tree's that it is.
    independent: Vec<usize>,
    /// Of each independent coordinate, the tree's that it is.
    independent_q: Vec<usize>,
    sums: Sums,
}

impl Coupling {
    /// The scene with a coordinate for every joint.
    #[must_use]
    pub fn tree(&self) -> &Scene {
        &self.tree
    }

    /// Rows of the tree that are measured together.
    pub(crate) fn sums(&self) -> &Sums {
        &self.sums
    }

    /// Number of independent coordinates and rates.
    #[must_use]
    pub fn sizes(&self) -> (usize, usize) {
        (self.independent_q.len(), self.independent.len())
    }

    /// Names of the tree's joints that an independent one moves, itself the first.
    pub(crate) fn moved_by(&self, joint: &Joint) -> Vec<String> {
        let first = joint.v.start;
        let mut names = vec![joint.name.clone()];
        let others = self.tree.joints.iter().filter(|other| other.name != joint.name);
        names.extend(others.filter(|other| self.v[other.v.start].0 == first).map(|other| other.name.clone()));
        names
    }

    /// q = G q' + o, (nq of the tree), of a configuration that has the scene's length.
    #[must_use]
    pub fn configuration(&self, q: &[f64]) -> Vec<f64> {
        self.q.iter().map(|of| of.multiplier * q[of.index] + of.offset).collect()
    }

    /// G x, (nv of the tree), of rates or accelerations that have the scene's length.
    #[must_use]
    pub fn rates(&self, x: &[f64]) -> Vec<f64> {
        self.v.iter().map(|&(index, multiplier)| multiplier * x[index]).collect()
    }

    /// Torques of the tree, (nv of the tree), that act as `tau` does: on the independent joints.
    #[must_use]
    pub fn torques(&self, tau: &[f64]) -> Vec<f64> {
        let mut full = vec![0.0; self.v.len()];
        for (&row, &value) in self.independent.iter().zip(tau) {
            full[row] = value;
        }
        full
    }

    /// Of each independent rate, the tree's that it is.
    pub(crate) fn independent_rows(&self) -> &[usize] {
        &self.independent
    }

    /// Of each independent coordinate, the tree's that it is.
    #[cfg_attr(not(feature = "python"), allow(dead_code))]
    pub(crate) fn independent_coordinates_at(&self) -> &[usize] {
        &self.independent_q
    }

    /// The independent entries of rates or accelerations of the tree.
    #[must_use]
    pub fn independent_rates(&self, x: &[f64]) -> Vec<f64> {
        self.independent.iter().map(|&row| x[row]).collect()
    }

    /// The independent entries of a configuration of the tree.
    #[must_use]
    pub fn independent_coordinates(&self, q: &[f64]) -> Vec<f64> {
        self.independent_q.iter().map(|&at| q[at]).collect()
    }

    /// Whether a state of the tree is one of joints that follow, to within 1e-9 of the larger of 1 and the coordinate.
    pub(crate) fn check_followed(&self, q: &[f64], qd: &[f64]) -> Result<(), Error> {
        const SLACK: f64 = 1e-9;
        let followed = self.configuration(&self.independent_coordinates(q));
        let rates = self.rates(&self.independent_rates(qd));
        for (name, given, followed) in [("q", q, followed), ("qd", qd, rates)] {
            let differs = |(x, y): (&f64, &f64)| !((x - y).abs() <= SLACK * y.abs().max(1.0));
            if let Some(at) = given.iter().zip(&followed).position(differs) {
                let found = format!("{} at index {at}", given[at]);
                let expected = format!("{}, for that joint follows another", followed[at]);
                return Err(Error::argument(name, found, expected));
            }
        }
        Ok(())
    }

    /// What the independent coordinates have of armature, damping or stiffness: the sum over the joints that they move, each by the square of its multiplier.
    #[must_use]
    pub fn reduce_squares(&self, x: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; self.independent.len()];
        for (&(index, multiplier), value) in self.v.iter().zip(x) {
            out[index] += multiplier * multiplier * value;
        }
        out
    }

    /// The same of Coulomb friction: each by the size of its multiplier.
    #[must_use]
    pub fn reduce_friction(&self, x: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; self.independent.len()];
        for (&(index, multiplier), value) in self.v.iter().zip(x) {
            out[index] += multiplier.abs() * value;
        }
        out
    }

    /// The limits of each independent coordinate: its own, and those of the joints that follow it.
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

    /// The velocity limit of each independent velocity, of those of the tree: its own, and those of the joints that
    /// follow it.
    pub(crate) fn velocity_limits(&self, limits: &[f64]) -> Vec<f64> {
        let mut out = vec![f64::INFINITY; self.independent.len()];
        for (&(index, multiplier), limit) in self.v.iter().zip(limits).filter(|((_, multiplier), _)| *multiplier != 0.0)
        {
            out[index] = out[index].min(limit / multiplier.abs());
        }
        out
    }

    /// Where the springs of the tree, (nv) and (nq), leave the independent coordinates at rest: at their mean, weighted by stiffness.
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

    /// G^T tau into `out`, of torques of the tree.
    pub fn reduce(&self, tau: &[f64], out: &mut [f64]) {
        out.fill(0.0);
        for (&(index, multiplier), value) in self.v.iter().zip(tau) {
            out[index] += multiplier * value;
        }
    }

    /// X G into `out`, row by row, of a matrix with as many columns as the tree has rates.
    pub fn reduce_columns(&self, x: &[f64], out: &mut [f64]) {
        let (full, nv) = (self.v.len(), self.independent.len());
        if full > 0 {
            for (row, out) in x.chunks_exact(full).zip(out.chunks_exact_mut(nv)) {
                self.reduce(row, out);
            }
        }
    }

    /// G^T X G into `out`, row by row, of a square matrix of the tree.
    pub fn reduce_matrix(&self, x: &[f64], out: &mut [f64]) {
        let (full, nv) = (self.v.len(), self.independent.len());
        let mut columns = vec![0.0; full * nv];
        self.reduce_columns(x, &mut columns);
        out.fill(0.0);
        for (&(index, multiplier), row) in self.v.iter().zip(columns.chunks_exact(nv.max(1))) {
            for (sum, value) in out[index * nv..].iter_mut().zip(row) {
                *sum += multiplier * value;
            }
        }
    }
}

impl Scene {
    /// How its joints follow each other; none where all are independent.
    #[must_use]
    pub fn coupling(&self) -> Option<&Coupling> {
        self.coupling.as_deref()
    }

    /// The same, shared.
    pub(crate) fn shared_coupling(&self) -> Option<Arc<Coupling>> {
        self.coupling.clone()
    }

    /// The scene of which every joint has a coordinate: itself, unless joints follow each other.
    #[must_use]
    pub fn tree(&self) -> &Self {
        self.coupling().map_or(self, Coupling::tree)
    }

    /// A configuration of the scene, checked, as the tree's: itself, unless joints follow each other.
    pub(crate) fn tree_configuration<'a>(&self, argument: &str, q: &'a [f64]) -> Result<Cow<'a, [f64]>, Error> {
        self.check_coordinates(argument, q)?;
        Ok(self.coupling().map_or(Cow::Borrowed(q), |coupling| coupling.configuration(q).into()))
    }

    /// Rates or accelerations of the scene, checked, as the tree's.
    pub(crate) fn tree_rates<'a>(&self, argument: &str, x: &'a [f64]) -> Result<Cow<'a, [f64]>, Error> {
        self.check_rates(argument, x)?;
        Ok(self.coupling().map_or(Cow::Borrowed(x), |coupling| coupling.rates(x).into()))
    }

    /// A matrix of so many rows with a column for each degree of freedom, (rows x nv) row by row, from what writes it for the tree.
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

    /// Why a method that has no form for them refuses a scene whose joints follow each other.
    pub(crate) fn check_independent(&self) -> Result<(), Error> {
        let Some(coupling) = self.coupling() else { return Ok(()) };
        let followers = coupling.tree.joints.len() - self.joints.len();
        let found = format!("{followers} joints that follow others (mimic)");
        let expected =
            "independent joints, for this method has no form for coupled ones: build the scene with mimic=\"free\"";
        Err(Error::argument("scene", found, expected))
    }

    /// The scene of a tree whose mimic joints follow: the tree itself where it has none.
    pub(super) fn coupled(tree: Self) -> Result<Self, Error> {
        let Some(follows) = followed(&tree)? else { return Ok(tree) };
        if let Some(connection) = tree.connections().first() {
            let expected = "mimic=\"free\", and a connection of each mimic joint with the one that it follows";
            let found = "joints that follow others (mimic) beside a connection";
            return Err(Error::scene(format!("connection {:?}", connection.name), found, expected));
        }
        if let Some(contact) = tree.contacts().first() {
            let found = "joints that follow others (mimic) beside a contact";
            return Err(Error::scene(format!("contact {:?}", contact.name), found, "mimic=\"free\" for now"));
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
        let mut rows = vec![Vec::new(); independent.len()];
        for (row, &(index, multiplier)) in v.iter().enumerate() {
            rows[index].push((row, multiplier));
        }
        rows.retain(|rows| rows.len() > 1);
        let sums = Sums::new(&tree.model.system, &rows);
        let joint_index = joints.iter().enumerate().map(|(at, joint)| (joint.name.clone(), at)).collect();
        let mut scene = Self::unfilled(tree.source.clone(), tree.warnings.clone());
        scene.model = tree.model.clone();
        scene.links.clone_from(&tree.links);
        scene.link_index.clone_from(&tree.link_index);
        scene.merged.clone_from(&tree.merged);
        scene.joint_of_body = vec![None; tree.joint_of_body.len()];
        (scene.joints, scene.joint_index) = (joints, joint_index);
        scene.coupling = Some(Arc::new(Coupling { tree, q, v, independent, independent_q, sums }));
        Ok(scene)
    }
}

/// Of each joint that follows another: the independent joint that it follows in the end, multiplier and offset; none where no joint does. Each joint is
/// resolved once: linear in the number of joints, however long the chains are.
#[allow(clippy::type_complexity)] // by name
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
        // Along the chain to a joint that follows none, or is resolved.
        let (mut name, mut path) = (joint.name.as_str(), Vec::new());
        let mut seen = HashSet::from([name]);
        while let Some(&mimic) = mimics.get(name).filter(|_| !follows.contains_key(name)) {
            one_axis(tree, name)?;
            path.push((name, mimic));
            name = &mimic.joint;
            if !seen.insert(name) {
                let names: Vec<&str> = path.iter().map(|&(name, _)| name).collect();
                let found = format!("a circle of mimics: {}, {name}", names.join(", "));
                return Err(Error::scene(subject(), found, "a joint to follow that does not follow this one"));
            }
            if !tree.joint_index.contains_key(name) {
                let known = tree.source.joints.iter().any(|other| other.name == name);
                let what = if known { "which does not move" } else { "which is not there" };
                let expected = "a joint that moves, or mimic=\"free\" to have this one independent";
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

/// Joints of several coordinates cannot follow and cannot be followed.
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
