//! Scenes with closed loops, and their accelerations by definition: the KKT system with constraints in the world
//! frame, in about 31 digits.

use super::oracle::{D, Oracle, V, cross, d, ds, inner, solve, vector};
use super::tolerance::to_f64;
use super::{Random, random_inertial};
use nalgebra::{DMatrix, Rotation3, Vector3};
use phipsi::Scene;
use phipsi::scalar::Real;
use phipsi::scene::{
    Connection, ConnectionKind, Inertial, JointDescription, JointKind, LinkDescription, Polynomial, SceneBuilder,
};
use phipsi::spatial::{RigidShift, Symmetric3};

pub fn rod(mass: f64, length: f64) -> Inertial {
    let across = mass * length * length / 12.0;
    Inertial {
        mass,
        center: [0.0, 0.0, 0.5 * length].into(),
        central: Symmetric3::new([across, 0.0, 0.0, across, 0.0, 1e-3 * mass]),
    }
}

fn link(builder: SceneBuilder, name: &str, inertial: Inertial) -> SceneBuilder {
    builder.link(LinkDescription { name: name.into(), inertial: Some(inertial) })
}

fn joint(name: &str, kind: JointKind, parent: &str, at: [f64; 3], axis: [f64; 3]) -> JointDescription {
    let mut joint = JointDescription::new(name, kind, parent, name);
    joint.origin.lever = at.into();
    joint.axis = axis.into();
    joint
}

/// A four-bar linkage about y with rods of these masses, cut between the coupler and the rocker.
pub fn four_bar(kind: ConnectionKind, masses: [f64; 3]) -> Scene {
    let mut builder = SceneBuilder::new().link(LinkDescription { name: "ground".into(), inertial: None });
    for (name, parent, at, length, mass) in [
        ("crank", "ground", [0.0; 3], 0.2, masses[0]),
        ("coupler", "crank", [0.0, 0.0, 0.2], 0.4, masses[1]),
        ("rocker", "ground", [0.3, 0.0, 0.0], 0.3, masses[2]),
    ] {
        builder = link(builder, name, rod(mass, length));
        builder = builder.joint(joint(name, JointKind::Continuous, parent, at, [0.0, 1.0, 0.0]));
    }
    let mut pin = Connection::new("pin", kind, "coupler", Some("rocker"));
    pin.frame.lever = [0.0, 0.0, 0.4].into();
    // The frame of the rocker does not rotate with the coupler: a weld of both locks the linkage.
    pin.other_frame = Some(RigidShift { lever: [0.0, 0.0, 0.3].into(), ..RigidShift::identity() });
    builder.connect(pin).build().expect("a linkage")
}

/// The same linkage as a chain of four hinges whose last link is welded to the ground: 3 of its 6 constraints are in
/// the plane.
pub fn welded_four_bar() -> Scene {
    let mut builder = SceneBuilder::new().link(LinkDescription { name: "ground".into(), inertial: None });
    for (name, parent, at, length) in [
        ("crank", "ground", [0.0; 3], 0.2),
        ("coupler", "crank", [0.0, 0.0, 0.2], 0.4),
        ("rocker", "coupler", [0.0, 0.0, 0.4], 0.3),
        ("foot", "rocker", [0.0, 0.0, 0.3], 0.1),
    ] {
        builder = link(builder, name, rod(1.0, length));
        builder = builder.joint(joint(name, JointKind::Continuous, parent, at, [0.0, 1.0, 0.0]));
    }
    let mut held = Connection::new("held", ConnectionKind::Weld, "foot", None);
    held.other_frame = Some(RigidShift { lever: [0.3, 0.0, 0.0].into(), ..RigidShift::identity() });
    builder.connect(held).build().expect("a linkage")
}

/// A random tree with connections of every kind, which are satisfied in the neutral configuration.
pub fn tangle(seed: u64, kinds: &[JointKind]) -> Scene {
    let mut random = Random::new(1000 + seed);
    let tree = super::Tree { seed, bodies: 12, kinds, branching: 0.4, armature: 0.2, floating: seed % 2 == 1 };
    let mut builder = tree.builder();
    let axis = ConnectionKind::Axis(random.vector());
    for (i, kind) in
        [ConnectionKind::Point, axis, ConnectionKind::Weld, ConnectionKind::Distance(None)].into_iter().enumerate()
    {
        let other = (i % 2 == 0).then(|| format!("link{}", 3 + i));
        let mut connection = Connection::new(kind.name(), kind, format!("link{}", 11 - i), other.as_deref());
        connection.frame = RigidShift { rotation: random.rotation(), lever: random.vector() };
        if let ConnectionKind::Distance(_) = kind {
            connection.other_frame = Some(RigidShift { rotation: random.rotation(), lever: random.vector() });
        }
        builder = builder.connect(connection);
    }
    let one_axis: Vec<String> =
        builder.joints().iter().filter(|joint| joint.kind.nv() == 1).map(|joint| joint.name.clone()).collect();
    if let [.., other, first] = &one_axis[..] {
        let kind = ConnectionKind::Joint(Polynomial::linear(-1.5, 0.0));
        builder = builder.connect(Connection::new("gear", kind, first, Some(other)));
    }
    builder.build().expect("links that can move against each other")
}

/// A platform on six legs, each with two rods, a prismatic joint between them and spherical joints at the ends;
/// all legs except one are closed by point connections.
pub fn stewart() -> Scene {
    let mut random = Random::new(3);
    let mut builder = SceneBuilder::new().link(LinkDescription { name: "ground".into(), inertial: None });
    let corner = |i: usize, radius: f64, height: f64| {
        let angle = [0.0_f64, 0.5, 2.1, 2.6, 4.2, 4.7][i];
        [radius * angle.cos(), radius * angle.sin(), height]
    };
    for i in 0..6 {
        let (lower, upper) = (format!("lower{i}"), format!("upper{i}"));
        builder = link(builder, &lower, random_inertial(&mut random));
        builder = link(builder, &upper, random_inertial(&mut random));
        let (foot, top) = (Vector3::from(corner(i, 1.0, 0.0)), Vector3::from(corner((i + 5) % 6, 0.5, 1.0)));
        let mut hip = joint(&lower, JointKind::Universal, "ground", foot.into(), [0.0, 0.0, 1.0]);
        let along = Rotation3::rotation_between(&Vector3::z(), &(top - foot)).expect("not down");
        hip.origin.rotation = *along.matrix();
        let slide = joint(&upper, JointKind::Prismatic, &lower, [0.0, 0.0, 0.5], [0.0, 0.0, 1.0]);
        builder = builder.joint(hip).joint(slide);
        let length = (top - foot).norm() - 0.5;
        if i == 0 {
            builder = link(builder, "platform", random_inertial(&mut random));
            let mut ball = joint("platform", JointKind::Spherical, &upper, [0.0, 0.0, length], [0.0, 0.0, 1.0]);
            ball.origin.rotation = along.matrix().transpose();
            builder = builder.joint(ball);
        } else {
            let mut point = Connection::new(format!("leg{i}"), ConnectionKind::Point, &upper, Some("platform"));
            point.frame.lever = [0.0, 0.0, length].into();
            builder = builder.connect(point);
        }
    }
    builder.build().expect("a platform")
}

/// A floating body on two legs with six hinges, each foot connected to the ground by these kinds (the corners
/// `points` of a foot by points, if any).
pub fn biped(points: usize) -> Scene {
    let mut random = Random::new(7);
    let mut builder = SceneBuilder::new().floating_base(true);
    builder = link(builder, "pelvis", random_inertial(&mut random));
    for (side, y) in [("left", 0.2), ("right", -0.2)] {
        let mut parent = "pelvis".to_owned();
        for (i, axis) in [[0, 0, 1], [1, 0, 0], [0, 1, 0], [0, 1, 0], [0, 1, 0], [1, 0, 0]].into_iter().enumerate() {
            let name = format!("{side}{i}");
            let at = if i == 0 { [0.0, y, -0.1] } else { [0.0, 0.02, -0.15] };
            builder = link(builder, &name, random_inertial(&mut random));
            builder = builder.joint(joint(&name, JointKind::Revolute, &parent, at, axis.map(f64::from)));
            parent = name;
        }
        if points == 0 {
            builder = builder.connect(Connection::new(side, ConnectionKind::Weld, &parent, None));
        }
        for i in 0..points {
            let mut corner = Connection::new(format!("{side} {i}"), ConnectionKind::Point, &parent, None);
            let (x, y) = ([0.1, 0.1, -0.1, -0.1][i], [0.05, -0.05, 0.05, -0.05][i]);
            corner.frame.lever = [x, y, -0.05].into();
            builder = builder.connect(corner);
        }
    }
    builder.build().expect("a biped")
}

/// Accelerations and torques of the connections in a state that satisfies them.
pub struct Exact {
    pub qdd: Vec<f64>,
    /// J^T lambda.
    pub torque: Vec<f64>,
    pub rank: usize,
    /// Ratio of the largest to the smallest eigenvalue of G, scaled to unit diagonal.
    pub condition: f64,
}

/// One end: rotation, position, velocities, their derivatives without joint accelerations, and the Jacobian, in the
/// world frame.
struct End {
    z: V,
    position: V,
    motion: [V; 4],
    jacobian: DMatrix<D>,
}

fn end(oracle: &Oracle, q: &[D], qd: &[D], link: Option<&str>, frame: &RigidShift<f64>, axis: &Vector3<f64>) -> End {
    let nv = oracle.nv();
    let Some(link) = link else {
        let zero = V::from_element(d(0.0));
        let z = vector(&(frame.rotation * axis));
        return End {
            z,
            position: vector(&frame.lever),
            motion: [zero; 4],
            jacobian: DMatrix::from_element(6, nv, d(0.0)),
        };
    };
    let instant = oracle.at(q, qd);
    let place = instant.placement(link);
    let lever = place.rotation * vector(&frame.lever);
    let [w, v, alpha, a] = instant.motion(link);
    let own = instant.jacobian(link);
    let mut jacobian = DMatrix::from_element(6, nv, d(0.0));
    for j in 0..nv {
        let column = |first: usize| place.rotation * V::from_fn(|i, _| own[(first + i, j)]);
        let (angular, linear) = (column(0), column(3));
        let linear = linear + cross(&angular, &lever);
        for i in 0..3 {
            jacobian[(i, j)] = angular[i];
            jacobian[(3 + i, j)] = linear[i];
        }
    }
    let inward = cross(&w, &cross(&w, &lever));
    End {
        z: place.rotation * (frame.rotation.map(d) * vector(axis)),
        position: place.lever + lever,
        motion: [w, v + cross(&w, &lever), alpha, a + cross(&alpha, &lever) + inward],
        jacobian,
    }
}

/// Rows J and gamma, in a state that satisfies the connections.
fn rows(scene: &Scene, oracle: &Oracle, q: &[D], qd: &[D]) -> (Vec<Vec<D>>, Vec<D>) {
    let nv = oracle.nv();
    let (mut j, mut gamma) = (Vec::new(), Vec::new());
    for connection in scene.connections() {
        if let ConnectionKind::Joint(polynomial) = connection.kind {
            let multiplier = polynomial.coefficients()[1];
            let mut row = vec![d(0.0); nv];
            row[scene.joint(&connection.link).unwrap().v.start] = d(1.0);
            if let Some(other) = &connection.other {
                row[scene.joint(other).unwrap().v.start] = d(-multiplier);
            }
            j.push(row);
            gamma.push(d(0.0));
            continue;
        }
        let axis = if let ConnectionKind::Axis(axis) = connection.kind { axis.normalize() } else { Vector3::z() };
        let c = end(oracle, q, qd, Some(&connection.link), &connection.frame, &axis);
        let other = connection.other_frame.expect("written out by the scene");
        let e = end(oracle, q, qd, connection.other.as_deref(), &other, &axis);
        let apart = c.position - e.position;
        let relative = &c.jacobian - &e.jacobian;
        let rate = c.motion[1] - e.motion[1];
        let change = c.motion[3] - e.motion[3];
        let of = |first: usize, row: &V| {
            (0..nv).map(|k| inner(row, &V::from_fn(|i, _| relative[(first + i, k)]))).collect::<Vec<D>>()
        };
        let unit = |i: usize| V::from_fn(|k, _| d(if i == k { 1.0 } else { 0.0 }));
        if let ConnectionKind::Distance(_) = connection.kind {
            j.push(of(3, &apart));
            gamma.push(inner(&apart, &change) + inner(&rate, &rate));
            continue;
        }
        for i in 0..3 {
            j.push(of(3, &unit(i)));
            gamma.push(change[i]);
        }
        match connection.kind {
            ConnectionKind::Weld => {
                for i in 0..3 {
                    j.push(of(0, &unit(i)));
                    gamma.push(c.motion[2][i] - e.motion[2][i]);
                }
            }
            ConnectionKind::Axis(_) => {
                // z' = w x z, z'' = alpha x z + w x (w x z).
                for i in 0..3 {
                    let row = |end: &End| -> Vec<D> {
                        let turned = |k: usize| cross(&V::from_fn(|i, _| end.jacobian[(i, k)]), &end.z)[i];
                        (0..nv).map(turned).collect()
                    };
                    j.push(row(&c).iter().zip(row(&e)).map(|(&a, b)| a - b).collect());
                    let second = |end: &End| {
                        let [w, _, alpha, _] = &end.motion;
                        cross(alpha, &end.z)[i] + cross(w, &cross(w, &end.z))[i]
                    };
                    gamma.push(second(&c) - second(&e));
                }
            }
            _ => {}
        }
    }
    (j, gamma)
}

/// M qdd + bias = tau + J^T lambda, J qdd + gamma = 0, by elimination with the largest pivot until none is left.
pub fn exact(scene: &Scene, q: &[f64], qd: &[f64], tau: &[f64]) -> Exact {
    let oracle = Oracle::new(scene.source());
    let (wide_q, wide_qd) = (ds(q), ds(qd));
    let instant = oracle.at(&wide_q, &wide_qd);
    let (m, bias) = (instant.mass_matrix(), instant.bias(&[]).0);
    let right: Vec<D> = tau.iter().zip(&bias).map(|(&t, &b)| d(t) - b).collect();
    let free = solve(&m, &right);
    let (j, gamma) = rows(scene, &oracle, &wide_q, &wide_qd);
    let columns: Vec<Vec<D>> = j.iter().map(|row| solve(&m, row)).collect();
    let dot = |a: &[D], b: &[D]| a.iter().zip(b).fold(d(0.0), |sum, (&a, &b)| sum + a * b);
    let count = j.len();
    let mut g: Vec<Vec<D>> = (0..count).map(|i| (0..count).map(|k| dot(&j[i], &columns[k])).collect()).collect();
    let scale: Vec<D> =
        (0..count).map(|i| if to_f64(g[i][i]) > 1e-25 { g[i][i].sqrt().recip() } else { d(0.0) }).collect();
    for i in 0..count {
        for k in 0..count {
            let entry = g[i][k];
            g[i][k] = entry * scale[i] * scale[k];
        }
    }
    let small = DMatrix::from_fn(count, count, |i, k| to_f64(g[i][k]));
    let values = small.symmetric_eigenvalues();
    let kept: Vec<f64> = values.iter().copied().filter(|&v| v > 1e-14).collect();
    let largest = kept.iter().fold(0.0_f64, |a, &b| a.max(b));
    let condition = kept.iter().fold(1.0_f64, |worst, &v| worst.max(largest / v));
    let mut r: Vec<D> = (0..count).map(|i| (dot(&j[i], &free) + gamma[i]) * scale[i]).collect();
    let mut order: Vec<usize> = Vec::new();
    let mut left: Vec<usize> = (0..count).collect();
    while let Some(&pivot) = left.iter().max_by(|&&a, &&b| to_f64(g[a][a]).total_cmp(&to_f64(g[b][b]))) {
        if to_f64(g[pivot][pivot]) < 1e-15 {
            break;
        }
        left.retain(|&i| i != pivot);
        order.push(pivot);
        for &i in &left {
            let factor = g[i][pivot] / g[pivot][pivot];
            for k in left.iter().copied().chain([pivot]) {
                let term = factor * g[pivot][k];
                g[i][k] -= term;
            }
            let term = factor * r[pivot];
            r[i] -= term;
        }
    }
    // Back substitution from the last pivot.
    let mut lambda = vec![d(0.0); count];
    for (at, &i) in order.iter().enumerate().rev() {
        let sum = order[at + 1..].iter().fold(r[i], |sum, &k| sum + g[i][k] * lambda[k]);
        lambda[i] = -(sum / g[i][i]);
    }
    let mut qdd: Vec<D> = free;
    let mut torque = vec![d(0.0); oracle.nv()];
    for i in 0..count {
        let force = lambda[i] * scale[i];
        for k in 0..qdd.len() {
            qdd[k] += columns[i][k] * force;
            torque[k] += j[i][k] * force;
        }
    }
    let back = |x: Vec<D>| x.into_iter().map(to_f64).collect();
    Exact { qdd: back(qdd), torque: back(torque), rank: order.len(), condition }
}

/// A state that satisfies the connections, near a random one.
pub fn state(scene: &Scene, seed: u64, size: f64) -> (Vec<f64>, Vec<f64>, Vec<f64>) {
    let mut random = Random::new(seed);
    let step = random.array(scene.nv(), size);
    let mut q = scene.neutral();
    scene.integrate(&scene.neutral(), &step, &mut q).unwrap();
    let mut qd = random.array(scene.nv(), 1.0);
    let (mut workspace, mut scratch) = (scene.workspace(), scene.constraint_scratch());
    scene.project(&mut workspace, &mut scratch, &mut q, Some(&mut qd)).unwrap();
    (q, qd, random.array(scene.nv(), 5.0))
}
