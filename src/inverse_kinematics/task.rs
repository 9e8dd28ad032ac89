//! Tasks: targets for links, their errors, and the derivatives of the errors.

use super::direction::{DirectionError, direction_error};
use super::rotation::{inverse_right_jacobian, nearest_rotation};
use crate::error::{Error, check_finite, check_positive};
use crate::kinematics::{Frame, local_jacobian};
use crate::scene::{JointKind, Scene};
use crate::setters::setters;
use crate::spatial::RigidShift;
use crate::workspace::Workspace;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3, Vector6};
use std::borrow::Cow;

/// The target of a task. Positions, directions and rotations are in the base frame, or in the frame that a [`Task`] is
/// relative to.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Goal {
    /// A frame on a link has a given pose.
    Pose {
        /// Frame on the link.
        frame: Frame<f64>,
        /// Pose of the frame in the base frame.
        target: RigidShift<f64>,
    },
    /// The origin of a frame on a link is at a given point.
    Position {
        /// Frame on the link.
        frame: Frame<f64>,
        /// Point, m.
        target: Vector3<f64>,
    },
    /// A frame on a link has a given orientation.
    Orientation {
        /// Frame on the link.
        frame: Frame<f64>,
        /// Rotation from frame axes to base axes.
        target: Matrix3<f64>,
    },
    /// An axis of a frame on a link has a given direction.
    Direction {
        /// Frame on the link.
        frame: Frame<f64>,
        /// Unit vector in the frame.
        axis: Vector3<f64>,
        /// Unit vector of the direction.
        target: Vector3<f64>,
    },
    /// An axis through the origin of a frame on a link passes through a given point.
    LookAt {
        /// Frame on the link.
        frame: Frame<f64>,
        /// Unit vector in the frame.
        axis: Vector3<f64>,
        /// Point, m.
        target: Vector3<f64>,
    },
    /// The center of mass is at a given point, m.
    CenterOfMass(Vector3<f64>),
    /// A joint with one coordinate has a given position.
    Joint {
        /// Index of the joint.
        joint: usize,
        /// Position, rad or m.
        target: f64,
    },
    /// Two colliders are at least a given distance apart: the error is zero beyond it.
    Distance {
        /// Indices of the colliders, as those of [`Scene::collider_pairs`].
        pair: [usize; 2],
        /// Least distance, m; negative for a largest penetration.
        lower: f64,
    },
}

/// A goal with its standard deviations.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Task {
    /// The target.
    pub goal: Goal,
    /// Standard deviation of positions, distances and prismatic joint coordinates, m.
    pub position: f64,
    /// Standard deviation of rotations and directions, rad.
    pub rotation: f64,
    /// The frame on a link in which targets are expressed; `None` for the base frame. Not allowed for centers of mass,
    /// joints and distances.
    pub relative_to: Option<Frame<f64>>,
}

setters!(Task {
    with_goal: goal: Goal,
    with_position: position: f64,
    with_rotation: rotation: f64,
    with_relative_to: relative_to => Option<Frame<f64>>,
});

impl Task {
    /// A task with standard deviations of 1 mm and 1 mrad.
    #[must_use]
    pub fn new(goal: Goal) -> Self {
        Self { goal, position: 1e-3, rotation: 1e-3, relative_to: None }
    }

    /// The task with the rotation of its target orthonormalized. Returns an error for bodies and joints that do not
    /// exist, deviations that are not positive, values that are not finite, axes that are not unit vectors, and targets
    /// that are not rotations.
    pub(crate) fn checked(mut self, scene: &Scene, at: usize) -> Result<Self, Error> {
        self.check(scene, at)?;
        if let Goal::Pose { target: RigidShift { rotation, .. }, .. } | Goal::Orientation { target: rotation, .. } =
            &mut self.goal
        {
            finite("target", at, rotation.as_slice())?;
            *rotation = nearest_rotation(rotation).map_err(|found| {
                Error::argument(format!("target of task {at}"), found, "a rotation matrix, each entry within 1e-3")
            })?;
        }
        Ok(self)
    }

    /// Checks that the standard deviations are positive.
    pub(crate) fn check_deviations(&self, at: usize) -> Result<(), Error> {
        for (what, value) in [("position", self.position), ("rotation", self.rotation)] {
            check_positive(format_args!("{what} deviation of task {at}"), value)?;
        }
        Ok(())
    }

    fn check(&self, scene: &Scene, at: usize) -> Result<(), Error> {
        let name = |what: &str| format!("{what} of task {at}");
        self.check_deviations(at)?;
        let body = |frame: &Frame<f64>| {
            let bodies = scene.model().bodies.len();
            match frame.body {
                Some(body) if body >= bodies => {
                    Err(Error::argument(name("body"), body.to_string(), format!("an index below {bodies}")))
                }
                _ => finite("frame", at, frame.placement.lever.as_slice()),
            }
        };
        let unit = |what: &str, axis: &Vector3<f64>| {
            finite(what, at, axis.as_slice())?;
            if (axis.norm() - 1.0).abs() <= UNIT {
                Ok(())
            } else {
                Err(Error::argument(name(what), format!("{:?}", axis.as_slice()), "a unit vector"))
            }
        };
        self.relative_to.as_ref().map_or(Ok(()), body)?;
        match &self.goal {
            Goal::Pose { frame, target } => {
                body(frame)?;
                finite("target", at, target.lever.as_slice())
            }
            Goal::Position { frame, target } => {
                body(frame)?;
                finite("target", at, target.as_slice())
            }
            Goal::Orientation { frame, .. } => body(frame),
            Goal::Direction { frame, axis, target } => {
                body(frame)?;
                unit("axis", axis)?;
                unit("target", target)
            }
            Goal::LookAt { frame, axis, target } => {
                body(frame)?;
                unit("axis", axis)?;
                finite("target", at, target.as_slice())
            }
            Goal::CenterOfMass(target) => finite("target", at, target.as_slice()),
            Goal::Distance { pair, lower } => {
                finite("lower", at, &[*lower])?;
                scene.check_collider_pair("pair", *pair).map_err(|error| error.of_argument(&name("pair")))
            }
            Goal::Joint { joint, target } => {
                finite("target", at, &[*target])?;
                match scene.joints().get(*joint) {
                    Some(one) if one.q.len() == 1 => Ok(()),
                    Some(one) => Err(Error::argument(
                        name("joint"),
                        format!("{:?}, of {} coordinates", one.name, one.q.len()),
                        "a joint with one coordinate",
                    )),
                    None => Err(Error::argument(
                        name("joint"),
                        joint.to_string(),
                        format!("an index below {}", scene.joints().len()),
                    )),
                }
            }
        }
    }

    /// Number of rows of the error.
    fn rows(&self) -> usize {
        match self.goal {
            Goal::Pose { .. } => 6,
            Goal::Joint { .. } | Goal::Distance { .. } => 1,
            _ => 3,
        }
    }
}

/// True if a coordinate of a joint is an angle, false for a length.
pub fn turns(kind: JointKind, axis: usize) -> bool {
    !(kind == JointKind::Prismatic || kind == JointKind::Planar && axis < 2)
}

/// Largest accepted deviation of axes from unit length.
const UNIT: f64 = 1e-6;
/// Checks that the numbers of a task are finite. The name is formatted only on failure, so that a successful call does
/// not allocate.
fn finite(what: &str, at: usize, values: &[f64]) -> Result<(), Error> {
    if values.iter().all(|value| value.is_finite()) {
        return Ok(());
    }
    check_finite(&format!("{what} of task {at}"), values)
}

/// All terms of the objective F.
pub struct Tasks<'a> {
    pub scene: &'a Scene,
    pub each: &'a [Task],
    /// The posture and its standard deviation.
    pub posture: Option<(&'a [f64], f64)>,
}

/// Errors at a configuration, relative to their standard deviations, and their derivatives.
#[derive(Debug, Clone, Default)]
pub struct Rows {
    /// Task errors relative to their standard deviations.
    pub errors: Vec<f64>,
    /// Their derivatives in the tangent space of q, (rows x nv), row-major.
    pub jacobian: Vec<f64>,
    /// Largest position error, m, and largest rotation error, rad.
    pub position_error: f64,
    pub rotation_error: f64,
    six: Vec<f64>,
    /// The Jacobian of the frame that a task is relative to, (6 x nv).
    reference: Vec<f64>,
    /// Poses of the bodies in the base frame, for distances.
    bodies: Vec<RigidShift<f64>>,
    columns: Vec<f64>,
}

impl Tasks<'_> {
    /// True if a whole turn of a joint changes nothing except the tasks of that joint.
    pub fn is_same_after_turns(&self) -> bool {
        self.posture.is_none() && self.scene.coupling().is_none() && self.scene.constraints().is_empty()
    }

    /// True if there are no tasks.
    pub fn is_without_rows(&self) -> bool {
        self.each.is_empty()
    }

    /// Computes errors and their derivatives at `q`.
    pub fn evaluate(&self, workspace: &mut Workspace<f64>, q: &[f64], rows: &mut Rows) -> Result<(), Error> {
        let nv = self.scene.nv();
        let count: usize = self.each.iter().map(Task::rows).sum();
        rows.errors.resize(count, f64::NAN);
        rows.jacobian.resize(count * nv, f64::NAN);
        rows.six.resize(6 * nv, f64::NAN);
        rows.reference.resize(6 * nv, f64::NAN);
        (rows.position_error, rows.rotation_error) = (0.0, 0.0);
        let mut at = 0;
        if self.each.iter().any(|task| matches!(task.goal, Goal::Distance { .. })) {
            rows.bodies.resize(self.scene.model().bodies.len(), RigidShift::identity());
            self.scene.place_bodies(&self.on_tree(q), &mut rows.bodies);
        }
        for task in self.each {
            self.one(workspace, q, task, at, rows)?;
            at += task.rows();
        }
        Ok(())
    }

    /// Computes the error of one task, beginning at row `at`.
    fn one(
        &self,
        workspace: &mut Workspace<f64>,
        q: &[f64],
        task: &Task,
        at: usize,
        rows: &mut Rows,
    ) -> Result<(), Error> {
        match &task.goal {
            Goal::Pose { frame, target } => {
                let place = self.turn(q, (frame, task), &target.rotation, at, rows);
                rows.position(nv(self), at + 3, &place, &target.lever, task.position);
            }
            Goal::Position { frame, target } => {
                let place = self.local_jacobian(q, (frame, task), rows);
                rows.position(nv(self), at, &place, target, task.position);
            }
            Goal::Orientation { frame, target } => {
                self.turn(q, (frame, task), target, at, rows);
            }
            Goal::Direction { frame, axis, target } => {
                let place = self.local_jacobian(q, (frame, task), rows);
                rows.direction(nv(self), at, &place, axis, target, &Matrix3::zeros(), task.rotation);
            }
            Goal::LookAt { frame, axis, target } => {
                let place = self.local_jacobian(q, (frame, task), rows);
                let way = target - place.lever;
                let distance = way.norm();
                // At the target itself the direction is undefined; the current axis is used.
                let direction = if distance > 0.0 { way / distance } else { place.rotation * axis };
                let sideways =
                    (Matrix3::identity() - direction * direction.transpose()) / distance.max(f64::MIN_POSITIVE);
                rows.direction(nv(self), at, &place, axis, &direction, &sideways, task.rotation);
            }
            Goal::CenterOfMass(target) => {
                let off = self.scene.center_of_mass(workspace, q)? - target;
                self.scene.center_of_mass_jacobian(workspace, q, &mut rows.six[..3 * nv(self)])?;
                for i in 0..3 {
                    rows.errors[at + i] = off[i] / task.position;
                    for j in 0..nv(self) {
                        rows.jacobian[(at + i) * nv(self) + j] = rows.six[i * nv(self) + j] / task.position;
                    }
                }
                rows.position_error = rows.position_error.max(off.norm());
            }
            Goal::Joint { joint, target } => {
                let joint = &self.scene.joints()[*joint];
                let off = q[joint.q.start] - target;
                let turns = turns(joint.kind, 0);
                let deviation = if turns { task.rotation } else { task.position };
                rows.errors[at] = off / deviation;
                rows.jacobian[at * nv(self)..(at + 1) * nv(self)].fill(0.0);
                rows.jacobian[at * nv(self) + joint.v.start] = 1.0 / deviation;
                let largest = if turns { &mut rows.rotation_error } else { &mut rows.position_error };
                *largest = largest.max(off.abs());
            }
            Goal::Distance { pair, lower } => self.distance(q, (*pair, *lower), task.position, at, rows)?,
        }
        Ok(())
    }

    /// The error of a distance: zero with zero derivatives from `lower` on.
    fn distance(
        &self,
        q: &[f64],
        (pair, lower): ([usize; 2], f64),
        deviation: f64,
        at: usize,
        rows: &mut Rows,
    ) -> Result<(), Error> {
        let (scene, nv) = (self.scene, nv(self));
        let row = &mut rows.jacobian[at * nv..(at + 1) * nv];
        rows.errors[at] = 0.0;
        row.fill(0.0);
        let Some(colliders) = scene.tree().placed_colliders() else { return Ok(()) };
        let found = scene.distance_of_pair(colliders, &rows.bodies, pair, lower)?;
        if found.distance < lower {
            rows.errors[at] = (found.distance - lower) / deviation;
            scene.distance_gradient(&self.on_tree(q), pair, &found, &mut rows.columns, row);
            for entry in row {
                *entry /= deviation;
            }
            rows.position_error = rows.position_error.max(lower - found.distance);
        }
        Ok(())
    }

    /// The configuration of the tree.
    fn on_tree<'a>(&self, q: &'a [f64]) -> Cow<'a, [f64]> {
        self.scene.coupling().map_or(Cow::Borrowed(q), |coupling| coupling.configuration(q).into())
    }

    /// Pose of a frame relative to the reference frame of its task, and its Jacobian in its own axes, (6 x nv),
    /// row-major.
    fn local_jacobian(&self, q: &[f64], (frame, task): (&Frame<f64>, &Task), rows: &mut Rows) -> RigidShift<f64> {
        let Rows { six, reference, .. } = rows;
        let place = self.on_base(q, frame, six);
        let Some(other) = &task.relative_to else { return place };
        let nv = nv(self);
        let place = self.on_base(q, other, reference).inverse().compose(&place);
        // Subtracts the motion of the reference frame.
        for j in 0..nv {
            let carried = place.motion_to_child(&Vector6::from_fn(|i, _| reference[i * nv + j]));
            for i in 0..6 {
                six[i * nv + j] -= carried[i];
            }
        }
        place
    }

    /// Pose of a frame in the base frame, and its Jacobian.
    fn on_base(&self, q: &[f64], frame: &Frame<f64>, six: &mut [f64]) -> RigidShift<f64> {
        let model = self.scene.model();
        let Some(coupling) = self.scene.coupling() else { return local_jacobian(model, q, frame, six) };
        let mut columns = vec![f64::NAN; 6 * model.nv()];
        let place = local_jacobian(model, &coupling.configuration(q), frame, &mut columns);
        coupling.reduce_columns(&columns, six);
        place
    }

    /// The rotation vector from the target to the frame, log(Rt^T R). Its time derivative is Jr^-1 w for the angular
    /// velocity w in frame axes.
    fn turn(
        &self,
        q: &[f64],
        (frame, task): (&Frame<f64>, &Task),
        target: &Matrix3<f64>,
        at: usize,
        rows: &mut Rows,
    ) -> RigidShift<f64> {
        let place = self.local_jacobian(q, (frame, task), rows);
        let apart = Rotation3::from_matrix_unchecked(target.transpose() * place.rotation);
        let error = UnitQuaternion::from_rotation_matrix(&apart).scaled_axis();
        rows.put(nv(self), at, &error, &(inverse_right_jacobian(&error)), 0, task.rotation);
        rows.rotation_error = rows.rotation_error.max(error.norm());
        place
    }
}

fn nv(tasks: &Tasks<'_>) -> usize {
    tasks.scene.nv()
}

impl Rows {
    /// Writes three rows: an error, and a matrix times the angular (`half` 0) or linear (1) part of the Jacobian of the
    /// frame.
    fn put(&mut self, nv: usize, at: usize, error: &Vector3<f64>, matrix: &Matrix3<f64>, half: usize, deviation: f64) {
        for i in 0..3 {
            self.errors[at + i] = error[i] / deviation;
        }
        for j in 0..nv {
            let entry = |i: usize| self.six[(3 * half + i) * nv + j];
            let column = matrix * Vector3::new(entry(0), entry(1), entry(2)) / deviation;
            for i in 0..3 {
                self.jacobian[(at + i) * nv + j] = column[i];
            }
        }
    }

    /// Position error of the frame origin.
    fn position(&mut self, nv: usize, at: usize, place: &RigidShift<f64>, target: &Vector3<f64>, deviation: f64) {
        let off = place.lever - target;
        self.put(nv, at, &off, &place.rotation, 1, deviation);
        self.position_error = self.position_error.max(off.norm());
    }

    /// The rotation vector between an axis and a direction whose derivative is -`sideways` times the velocity of the
    /// frame origin.
    #[allow(clippy::too_many_arguments)] // position of the rows, and geometry
    fn direction(
        &mut self,
        nv: usize,
        at: usize,
        place: &RigidShift<f64>,
        axis: &Vector3<f64>,
        target: &Vector3<f64>,
        sideways: &Matrix3<f64>,
        deviation: f64,
    ) {
        let six = &self.six;
        let half = |half: usize, j: usize| Vector3::from_fn(|i, _| six[(3 * half + i) * nv + j]);
        let motions = (0..nv).map(|j| place.rotation * half(0, j));
        let DirectionError { error, by_rotation, by_target } =
            direction_error(&(place.rotation * axis), target, motions);
        let (turning, moving) = (by_rotation * place.rotation, by_target * sideways * place.rotation);
        for j in 0..nv {
            let column = (turning * half(0, j) - moving * half(1, j)) / deviation;
            for i in 0..3 {
                self.jacobian[(at + i) * nv + j] = column[i];
            }
        }
        for i in 0..3 {
            self.errors[at + i] = error[i] / deviation;
        }
        self.rotation_error = self.rotation_error.max(error.norm());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Inertial, JointDescription, LinkDescription, SceneBuilder};
    use crate::spatial::Symmetric3;

    /// A robot with a free base, a spherical joint and joints of one axis, some of them oblique.
    fn robot() -> Scene {
        let mut builder = SceneBuilder::new();
        let kinds = [
            JointKind::Revolute,
            JointKind::Spherical,
            JointKind::Prismatic,
            JointKind::Screw { pitch: 0.2 },
            JointKind::Universal,
        ];
        for k in 0..=kinds.len() {
            let inertial = Inertial {
                mass: 1.0,
                center: Vector3::new(0.1, 0.0, 0.2),
                central: Symmetric3::new([0.1, 0.0, 0.0, 0.1, 0.0, 0.1]),
            };
            builder = builder.link(LinkDescription { name: format!("link{k}"), inertial: Some(inertial) });
        }
        for (k, &kind) in kinds.iter().enumerate() {
            let mut joint =
                JointDescription::new(format!("joint{k}"), kind, format!("link{k}"), format!("link{}", k + 1));
            joint.axis = Vector3::new(0.48, -0.6, 0.64);
            joint.origin = RigidShift {
                rotation: *Rotation3::from_euler_angles(0.3, -0.2, 0.5).matrix(),
                lever: Vector3::new(0.1, 0.2, 0.4),
            };
            builder = builder.joint(joint);
        }
        builder.floating_base(true).build().expect("a robot")
    }

    fn goals(scene: &Scene) -> Vec<Goal> {
        let frame = scene.frame(&"link5".into()).expect("a link");
        let frame = Frame {
            placement: frame
                .placement
                .compose(&RigidShift { rotation: Matrix3::identity(), lever: Vector3::new(0.1, 0.2, 0.3) }),
            ..frame
        };
        let rotation = *Rotation3::from_euler_angles(0.4, 0.9, -1.2).matrix();
        let (target, axis) = (Vector3::new(0.7, -0.4, 1.1), Vector3::new(0.6, 0.0, 0.8));
        vec![
            Goal::Pose { frame, target: RigidShift { rotation, lever: target } },
            Goal::Position { frame, target },
            Goal::Orientation { frame, target: rotation },
            Goal::Direction { frame, axis, target: Vector3::new(0.0, -0.6, 0.8) },
            Goal::LookAt { frame, axis, target },
            Goal::CenterOfMass(target),
            Goal::Joint { joint: 1, target: 0.3 },
        ]
    }

    #[test]
    fn derivatives_are_those_of_the_errors() {
        let scene = robot();
        let (nv, mut workspace) = (scene.nv(), scene.workspace());
        let along = |size: f64| {
            (0..nv).map(|i| size * (1.3 * f64::from(u32::try_from(i).unwrap())).sin()).collect::<Vec<f64>>()
        };
        let mut q = vec![0.0; scene.nq()];
        scene.integrate(&scene.neutral(), &along(0.7), &mut q).unwrap();
        let other = scene.frame(&"link2".into()).expect("a link");
        let each = goals(&scene).into_iter().flat_map(|goal| [(goal, None), (goal, Some(other))]);
        for (goal, relative_to) in each {
            let task = Task { goal, position: 0.5, rotation: 2.0, relative_to };
            let tasks = Tasks { scene: &scene, each: &[task], posture: None };
            let (mut rows, mut aside) = (Rows::default(), Rows::default());
            tasks.evaluate(&mut workspace, &q, &mut rows).unwrap();
            for column in 0..nv {
                let mut errors = Vec::new();
                for h in [1e-5, -1e-5] {
                    let mut step = vec![0.0; nv];
                    step[column] = h;
                    let mut moved = vec![0.0; scene.nq()];
                    scene.integrate(&q, &step, &mut moved).unwrap();
                    tasks.evaluate(&mut workspace, &moved, &mut aside).unwrap();
                    errors.push(aside.errors.clone());
                }
                for (row, (ahead, behind)) in errors[0].iter().zip(&errors[1]).enumerate() {
                    let slope = (ahead - behind) / 2e-5;
                    let found = rows.jacobian[row * nv + column];
                    assert!(
                        (found - slope).abs() < 1e-8,
                        "{goal:?} relative to {relative_to:?}, row {row}, column {column}: {found} beside {slope}"
                    );
                }
            }
        }
    }
}
