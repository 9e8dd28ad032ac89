//! Rigid-body dynamics from the definitions, in about 31 digits: the oracle of the reference tests.
//!
//! It shares only the description of the scene with the recursions of the crate. It works in the world frame with
//! 3-vectors:
//! velocities and accelerations by differentiating positions, Jacobians by column from axes and points,
//! M = sum of m Jv^T Jv + Jw^T I Jw, torques by Newton-Euler for each link, accelerations by elimination.

use super::tolerance::to_f64;
use nalgebra::{DMatrix, Matrix3, Vector3};
use phipsi::scalar::{DoubleDouble, Real};
use phipsi::scene::{Inertial, JointDescription, JointKind, ROOT_JOINT, SceneBuilder};
use phipsi::spatial::RigidShift;

pub type D = DoubleDouble;
pub type V = Vector3<D>;
type R = Matrix3<D>;

pub fn d(x: f64) -> D {
    D::from_f64(x)
}

/// Values of one state in the scalar type of the oracle.
pub fn ds(values: &[f64]) -> Vec<D> {
    values.iter().copied().map(d).collect()
}

pub fn vector(v: &Vector3<f64>) -> V {
    v.map(d)
}

fn zero() -> V {
    V::from_element(d(0.0))
}

pub fn cross(a: &V, b: &V) -> V {
    V::new(a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
}

pub fn inner(a: &V, b: &V) -> D {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross_matrix(a: &V) -> R {
    let o = d(0.0);
    R::new(o, -a[2], a[1], a[2], o, -a[0], -a[1], a[0], o)
}

fn norm(a: &V) -> f64 {
    to_f64(inner(a, a)).sqrt()
}

/// Rodrigues: 1 + sin K + (1 - cos) K K.
fn turn(axis: &V, angle: D) -> R {
    let k = cross_matrix(axis);
    let (sine, cosine) = angle.sin_cos();
    R::identity() + k * sine + k * k * (d(1.0) - cosine)
}

/// The rotation of a quaternion (x, y, z, w) of any length: 1 + 2 (w K + K K)/|q|^2.
fn quaternion_turn(q: &[D]) -> R {
    let imaginary = V::new(q[0], q[1], q[2]);
    let k = cross_matrix(&imaginary);
    let square = inner(&imaginary, &imaginary) + q[3] * q[3];
    R::identity() + (k * q[3] + k * k) * (d(2.0) / square)
}

/// Two axes that span the plane normal to `n`: the first one along the coordinate axis with the smallest component
/// along `n`.
fn plane(n: &V) -> (V, V) {
    let mut least = 0;
    for i in 1..3 {
        if n[i].abs() < n[least].abs() {
            least = i;
        }
    }
    let mut helper = zero();
    helper[least] = d(1.0);
    let u = helper - n * inner(n, &helper);
    let u = u * inner(&u, &u).sqrt().recip();
    (u, cross(n, &u))
}

/// A joint with the indices of its two links and of its coordinates.
struct Hinge {
    joint: JointDescription,
    parent: usize,
    child: usize,
    q: usize,
    v: usize,
}

/// One degree of freedom in the world: per unit of velocity, a point x outboard of it moves at `angular x (x - at) +
/// linear`.
#[derive(Clone)]
struct Column {
    angular: V,
    linear: V,
    at: V,
}

/// One link in the world in a state; accelerations are those without joint accelerations.
#[derive(Clone)]
struct Placed {
    rotation: R,
    position: V,
    omega: V,
    velocity: V,
    alpha: V,
    acceleration: V,
    /// Degrees of freedom between the link and the world.
    path: Vec<usize>,
}

/// A wrench (moment, force) on a link, at its origin and in its frame.
pub type LinkWrench<'a> = (&'a str, [f64; 6]);

pub struct Oracle {
    names: Vec<String>,
    inertials: Vec<Option<Inertial>>,
    hinges: Vec<Hinge>,
    armature: Vec<f64>,
    gravity: V,
    pub nq: usize,
}

/// A scene in a state.
pub struct Instant<'o> {
    oracle: &'o Oracle,
    links: Vec<Placed>,
    columns: Vec<Column>,
    qd: Vec<D>,
}

impl Oracle {
    /// Reads the description: depth first, siblings in the order of their joints. Link 0 is the world.
    pub fn new(source: &SceneBuilder) -> Self {
        let root = source
            .links()
            .iter()
            .find(|link| source.joints().iter().all(|joint| joint.child != link.name))
            .expect("a tree has a root");
        let mut oracle = Self {
            names: vec![String::new()],
            inertials: vec![None],
            hinges: Vec::new(),
            armature: Vec::new(),
            gravity: V::from_fn(|i, _| d(source.gravity_vector()[i])),
            nq: 0,
        };
        let kind = if source.is_floating() { JointKind::Floating } else { JointKind::Fixed };
        let mut stack = vec![(JointDescription::new(ROOT_JOINT, kind, "", root.name.clone()), 0)];
        while let Some((joint, parent)) = stack.pop() {
            let (child, name) = (oracle.names.len(), joint.child.clone());
            let (q, v) = (oracle.nq, oracle.nv());
            oracle.nq += joint.kind.nq();
            oracle.armature.extend(std::iter::repeat_n(joint.armature, joint.kind.nv()));
            oracle.hinges.push(Hinge { joint, parent, child, q, v });
            oracle.inertials.push(source.links().iter().find(|link| link.name == name).and_then(|link| link.inertial));
            stack.extend(source.joints().iter().filter(|j| j.parent == name).rev().map(|j| (j.clone(), child)));
            oracle.names.push(name);
        }
        oracle
    }

    pub fn nv(&self) -> usize {
        self.armature.len()
    }

    /// The scene at rest at `q`.
    pub fn at_rest(&self, q: &[D]) -> Instant<'_> {
        self.at(q, &vec![d(0.0); self.nv()])
    }

    /// The scene at `q`, `qd`.
    pub fn at(&self, q: &[D], qd: &[D]) -> Instant<'_> {
        let world = Placed {
            rotation: R::identity(),
            position: zero(),
            omega: zero(),
            velocity: zero(),
            alpha: zero(),
            acceleration: zero(),
            path: Vec::new(),
        };
        let mut instant = Instant { oracle: self, links: vec![world], columns: Vec::new(), qd: qd.to_vec() };
        for hinge in &self.hinges {
            assert_eq!(hinge.child, instant.links.len());
            let placed = instant.place(hinge, q);
            instant.links.push(placed);
        }
        instant
    }

    /// `q` moved by the velocity `v` for the short time `h`, to first order.
    pub fn moved(&self, q: &[D], v: &[D], h: D) -> Vec<D> {
        let mut out = q.to_vec();
        let spin = |out: &mut [D], w: &[D]| {
            let (imaginary, real) = (V::new(out[0], out[1], out[2]), out[3]);
            let w = V::new(w[0], w[1], w[2]) * (h * d(0.5));
            let turned = imaginary + w * real + cross(&imaginary, &w);
            out[..3].copy_from_slice(turned.as_slice());
            out[3] = real - inner(&imaginary, &w);
        };
        for hinge in &self.hinges {
            let (at, row) = (hinge.q, hinge.v);
            match hinge.joint.kind {
                JointKind::Spherical => spin(&mut out[at..at + 4], &v[row..row + 3]),
                JointKind::Floating => {
                    let step = quaternion_turn(&q[at + 3..at + 7]) * V::new(v[row], v[row + 1], v[row + 2]) * h;
                    for i in 0..3 {
                        out[at + i] += step[i];
                    }
                    spin(&mut out[at + 3..at + 7], &v[row + 3..row + 6]);
                }
                kind => {
                    for i in 0..kind.nv() {
                        out[at + i] += v[row + i] * h;
                    }
                }
            }
        }
        out
    }
}

/// Motion of a joint relative to its parent link: displacement, its two derivatives (without joint accelerations),
/// rotation, and the degrees of freedom as (angular, linear) directions; `in_child` if these are constant in the
/// child frame.
struct Local {
    displacement: V,
    speed: V,
    change: V,
    rotation: R,
    directions: Vec<(V, V)>,
    /// Derivative of the angular velocity of the joint if its directions are constant neither in the parent nor in
    /// the child frame.
    turning: V,
}

impl Local {
    fn new(joint: &JointDescription, q: &[D], qd: &[D]) -> Self {
        let axis = vector(&joint.axis);
        let axis = axis * inner(&axis, &axis).sqrt().recip();
        let still = Self {
            displacement: zero(),
            speed: zero(),
            change: zero(),
            rotation: R::identity(),
            directions: Vec::new(),
            turning: zero(),
        };
        match joint.kind {
            JointKind::Fixed => still,
            JointKind::Revolute | JointKind::Continuous => {
                Self { rotation: turn(&axis, q[0]), directions: vec![(axis, zero())], ..still }
            }
            JointKind::Prismatic => {
                Self { displacement: axis * q[0], speed: axis * qd[0], directions: vec![(zero(), axis)], ..still }
            }
            JointKind::Screw { pitch } => Self {
                displacement: axis * (d(pitch) * q[0]),
                speed: axis * (d(pitch) * qd[0]),
                rotation: turn(&axis, q[0]),
                directions: vec![(axis, axis * d(pitch))],
                ..still
            },
            JointKind::Planar => {
                let (u, v) = plane(&axis);
                Self {
                    displacement: u * q[0] + v * q[1],
                    speed: u * qd[0] + v * qd[1],
                    rotation: turn(&axis, q[2]),
                    directions: vec![(zero(), u), (zero(), v), (axis, zero())],
                    ..still
                }
            }
            JointKind::Spherical => {
                let rotation = quaternion_turn(q);
                let directions = (0..3).map(|i| (rotation.column(i).into_owned(), zero())).collect();
                Self { rotation, directions, ..still }
            }
            JointKind::Floating => {
                let rotation = quaternion_turn(&q[3..]);
                let linear = V::new(qd[0], qd[1], qd[2]);
                let angular = V::new(qd[3], qd[4], qd[5]);
                let column = |i: usize| rotation.column(i).into_owned();
                let directions = (0..6).map(|i| if i < 3 { (zero(), column(i)) } else { (column(i - 3), zero()) });
                Self {
                    displacement: V::new(q[0], q[1], q[2]),
                    speed: rotation * linear,
                    change: rotation * cross(&angular, &linear),
                    rotation,
                    directions: directions.collect(),
                    ..still
                }
            }
            JointKind::Universal => {
                let (x, y) = (V::new(d(1.0), d(0.0), d(0.0)), V::new(d(0.0), d(1.0), d(0.0)));
                let first = turn(&x, q[0]);
                let second = first * y;
                Self {
                    rotation: first * turn(&y, q[1]),
                    directions: vec![(x, zero()), (second, zero())],
                    turning: cross(&(x * qd[0]), &(second * qd[1])),
                    ..still
                }
            }
            other => unreachable!("{other:?}: a kind without an oracle"),
        }
    }
}

impl Instant<'_> {
    fn place(&mut self, hinge: &Hinge, q: &[D]) -> Placed {
        let parent = &self.links[hinge.parent];
        let joint = &hinge.joint;
        let rows = hinge.v..hinge.v + joint.kind.nv();
        let local = Local::new(joint, &q[hinge.q..hinge.q + joint.kind.nq()], &self.qd[rows.clone()]);

        // The frame of the joint on the parent, then the displacement in it.
        let frame = parent.rotation * joint.origin.rotation.map(d);
        let lever = parent.rotation * vector(&joint.origin.lever);
        let (moved, speed, change) = (frame * local.displacement, frame * local.speed, frame * local.change);
        let reach = lever + moved;
        let w = &parent.omega;
        let position = parent.position + reach;
        let velocity = parent.velocity + cross(w, &reach) + speed;
        let acceleration = parent.acceleration
            + cross(&parent.alpha, &reach)
            + cross(w, &cross(w, &reach))
            + cross(w, &speed) * d(2.0)
            + change;

        let mut path = parent.path.clone();
        path.extend(rows.clone());
        let mut relative = zero();
        for (row, (angular, linear)) in rows.zip(&local.directions) {
            let column = Column { angular: frame * angular, linear: frame * linear, at: position };
            relative += column.angular * self.qd[row];
            self.columns.push(column);
        }
        Placed {
            rotation: frame * local.rotation,
            position,
            omega: w + relative,
            velocity,
            // Directions are constant either in the parent or in the child frame; the derivative is w x relative in
            // both cases, plus the term above.
            alpha: parent.alpha + cross(w, &relative) + frame * local.turning,
            acceleration,
            path,
        }
    }

    /// Moving links with mass: link, its inertial, its center of mass relative to its origin, its inertia; in the
    /// world frame.
    fn masses(&self) -> impl Iterator<Item = (&Placed, D, V, R)> {
        self.links.iter().zip(&self.oracle.inertials).filter(|(link, _)| !link.path.is_empty()).filter_map(
            |(link, inertial)| {
                let inertial = inertial.as_ref()?;
                let central = inertial.central.to_matrix().map(d);
                let inertia = link.rotation * central * link.rotation.transpose();
                Some((link, d(inertial.mass), link.rotation * vector(&inertial.center), inertia))
            },
        )
    }

    /// Angular and linear velocity of the point `x`, per unit of velocity of `row`.
    fn column(&self, row: usize, x: &V) -> (V, V) {
        let column = &self.columns[row];
        (column.angular, cross(&column.angular, &(x - column.at)) + column.linear)
    }

    /// M, including armature.
    pub fn mass_matrix(&self) -> DMatrix<D> {
        let nv = self.oracle.nv();
        let mut m = DMatrix::from_fn(nv, nv, |i, j| d(if i == j { self.oracle.armature[i] } else { 0.0 }));
        for (link, mass, center, inertia) in self.masses() {
            let columns: Vec<_> =
                link.path.iter().map(|&row| (row, self.column(row, &(link.position + center)))).collect();
            for (i, (w, v)) in &columns {
                let (angular, linear) = (inertia * w, v * mass);
                for (j, (other_w, other_v)) in &columns {
                    m[(*i, *j)] += inner(&angular, other_w) + inner(&linear, other_v);
                }
            }
        }
        m
    }

    /// Torque without joint accelerations, and the magnitude of the terms of its sum.
    pub fn bias(&self, wrenches: &[LinkWrench<'_>]) -> (Vec<D>, f64) {
        let mut torque = vec![d(0.0); self.oracle.nv()];
        let mut terms = vec![0.0; self.oracle.nv()];
        let mut add = |link: &Placed, point: &V, moment: &V, force: &V, size: (f64, f64)| {
            for &row in &link.path {
                let (w, v) = self.column(row, point);
                torque[row] += inner(&w, moment) + inner(&v, force);
                terms[row] += norm(&w) * size.0 + norm(&v) * size.1;
            }
        };
        for (link, mass, center, inertia) in self.masses() {
            let w = &link.omega;
            let inward = cross(w, &cross(w, &center));
            let acceleration = link.acceleration + cross(&link.alpha, &center) + inward;
            let moment = inertia * link.alpha + cross(w, &(inertia * w));
            let force = (acceleration - self.oracle.gravity) * mass;
            let largest = inertia.iter().fold(0.0, |m: f64, x| m.max(to_f64(x.abs())));
            let size = (
                largest * (norm(&link.alpha) + norm(w).powi(2)),
                to_f64(mass) * (norm(&link.acceleration) + norm(&inward) + norm(&self.oracle.gravity)),
            );
            add(link, &(link.position + center), &moment, &force, size);
        }
        for (name, wrench) in wrenches {
            let link = self.link(name);
            let part = |first: usize| link.rotation * V::from_fn(|i, _| d(wrench[first + i]));
            let (moment, force) = (part(0), part(3));
            add(link, &link.position, &-moment, &-force, (norm(&moment), norm(&force)));
        }
        let scale = terms.into_iter().fold(0.0, f64::max);
        (torque, scale)
    }

    /// Kinetic and potential energy.
    pub fn energy(&self) -> (D, D) {
        let (mut kinetic, mut potential) = (d(0.0), d(0.0));
        for (link, mass, center, inertia) in self.masses() {
            let velocity = link.velocity + cross(&link.omega, &center);
            kinetic += mass * inner(&velocity, &velocity) + inner(&link.omega, &(inertia * link.omega));
            potential += -(mass * inner(&self.oracle.gravity, &(link.position + center)));
        }
        for (&armature, &rate) in self.oracle.armature.iter().zip(&self.qd) {
            kinetic += d(armature) * rate * rate;
        }
        (kinetic * d(0.5), potential)
    }

    /// Angular momentum about the origin of the world, and linear momentum.
    pub fn momentum(&self) -> [D; 6] {
        let (mut angular, mut linear) = (zero(), zero());
        for (link, mass, center, inertia) in self.masses() {
            let momentum = (link.velocity + cross(&link.omega, &center)) * mass;
            angular += inertia * link.omega + cross(&(link.position + center), &momentum);
            linear += momentum;
        }
        [angular[0], angular[1], angular[2], linear[0], linear[1], linear[2]]
    }

    fn link(&self, name: &str) -> &Placed {
        let index = self.oracle.names.iter().position(|known| known == name);
        &self.links[index.expect("the link is there")]
    }

    /// Pose of a link in the world.
    pub fn placement(&self, link: &str) -> RigidShift<D> {
        let link = self.link(link);
        RigidShift { rotation: link.rotation, lever: link.position }
    }

    /// Motion of a link without joint accelerations, in the world frame: angular velocity, velocity of its origin,
    /// and the derivatives of both.
    pub fn motion(&self, link: &str) -> [V; 4] {
        let link = self.link(link);
        [link.omega, link.velocity, link.alpha, link.acceleration]
    }

    /// Jacobian of the (angular, linear) velocity of a link at its origin and in its frame.
    pub fn jacobian(&self, link: &str) -> DMatrix<D> {
        let link = self.link(link);
        let mut jacobian = DMatrix::from_element(6, self.oracle.nv(), d(0.0));
        for &row in &link.path {
            let (w, v) = self.column(row, &link.position);
            let back = link.rotation.transpose();
            jacobian.fixed_view_mut::<3, 1>(0, row).copy_from(&(back * w));
            jacobian.fixed_view_mut::<3, 1>(3, row).copy_from(&(back * v));
        }
        jacobian
    }
}

/// Solution of `m x = b` for symmetric positive definite `m`, by elimination.
pub fn solve(m: &DMatrix<D>, b: &[D]) -> Vec<D> {
    let (mut m, mut x, n) = (m.clone(), b.to_vec(), b.len());
    for k in 0..n {
        for i in k + 1..n {
            let factor = m[(i, k)] / m[(k, k)];
            for j in k..n {
                let term = factor * m[(k, j)];
                m[(i, j)] -= term;
            }
            let term = factor * x[k];
            x[i] -= term;
        }
    }
    for k in (0..n).rev() {
        for j in k + 1..n {
            let term = m[(k, j)] * x[j];
            x[k] -= term;
        }
        x[k] /= m[(k, k)];
    }
    x
}
