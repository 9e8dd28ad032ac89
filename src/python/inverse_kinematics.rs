//! The method `Scene.inverse_kinematics`.

use super::call::Call;
use super::cost::Cost;
use super::input::Input;
use super::object::{Object, imported};
use super::output::{self, Output};
use super::scene::PyScene;
use crate::error::Error;
use crate::inverse_kinematics::{Goal, Options, Task};
use crate::kinematics::Frame;
use crate::scene::Scene;
use crate::spatial::RigidShift;
use nalgebra::{Matrix3, Vector3};
use pyo3::prelude::*;

/// Rough time of one state, ns: some tens of steps.
const COST: usize = 50_000;

/// Numbers beside q: reached, errors, starts, steps.
const BESIDE: usize = 5;

/// A task as phipsi.tasks gives it: kind, name, link or joint, point, axis, deviations, target and how many numbers that has.
type Given<'py> = (String, String, String, [f64; 3], [f64; 3], f64, f64, Object<'py>, usize);

/// What of a task does not change with the state.
struct Fixed {
    kind: String,
    frame: Frame<f64>,
    joint: usize,
    axis: Vector3<f64>,
    position: f64,
    rotation: f64,
}

#[pymethods]
impl PyScene {
    /// Joint positions that bring links where they should be, within the limits of the joints; the most probable ones.
    ///
    /// tasks: a task of phipsi.tasks or a list of them: Pose, Position, Orientation, Direction, LookAt, CenterOfMass, JointPosition; targets with leading axes are a batch,
    /// which broadcasts with that of q0. q0: (..., nq), the first start; None: neutral. starts: how many configurations it starts from at the most, those after the first
    /// drawn within the limits. posture: None, or a standard deviation, rad and m: how far joints are expected from q0, for robots that tasks leave free.
    /// limits: whether joints stay within theirs; a q0 beyond them starts at them. tolerance: a task is reached where its error is no larger, m and rad.
    /// iterations: steps from each start at the most. covariance: whether to give it. seed: of the starts.
    ///
    /// Minimises half the squares of all errors over their standard deviations, by Levenberg and Marquardt's steps on the manifold, each the exact minimum of its model
    /// within the limits: no step makes it worse. The same bits for any number of threads. O(tasks depth + nv^3) a step.
    ///
    /// Returns a phipsi.tasks.InverseKinematics: q, reached, errors, starts, iterations and the covariance.
    ///
    /// Raises ArgumentError for what is no task, unknown links and joints, and numbers that cannot be; ShapeError, NotFiniteError, naming the task and the state.
    #[pyo3(signature = (tasks, q0=None, *, starts=20, posture=None, limits=true, tolerance=1e-9, iterations=100, covariance=false, seed=0),
           text_signature = "($self, tasks, q0=None, *, starts=20, posture=None, limits=True, tolerance=1e-9, iterations=100, covariance=False, seed=0)")]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn inverse_kinematics<'py>(
        &self,
        py: Python<'py>,
        tasks: &Object<'py>,
        q0: Option<&Object<'py>>,
        starts: usize,
        posture: Option<f64>,
        limits: bool,
        tolerance: f64,
        iterations: usize,
        covariance: bool,
        seed: u64,
    ) -> PyResult<Object<'py>> {
        let options = Options { starts, iterations, tolerance, limits, posture, seed };
        // Refuses them before anything is read.
        self.scene.inverse_kinematics(&options)?;
        let given = imported!(py, "phipsi.tasks", "unpacked")?.call1((tasks,))?.extract::<Vec<Given<'py>>>()?;
        let neutral = output::from_numbers(py, &self.scene.neutral(), &[self.scene.nq()])?;
        let mut inputs = vec![self.configuration("q0", q0.unwrap_or(&neutral))?];
        let mut fixed = Vec::with_capacity(given.len());
        for (kind, name, on, point, axis, position, rotation, target, width) in given {
            fixed.push(Fixed::of(&self.scene, kind, &name, &on, point, axis, position, rotation)?);
            inputs.push(Input::new(format!("{name}.target"), &target, width)?);
        }
        let (nq, nv) = (self.scene.nq(), self.scene.nv());
        let width = nq + BESIDE + if covariance { nv * nv } else { 0 };
        let call = Call::new(self, inputs, Vec::new(), Cost::of(COST))?;
        let mut results = call.output(py, &[width], None, Output::new)?;
        let numbers = results.numbers()?;
        call.each_state(py, numbers, |scene, scratch, of, out| {
            let tasks: Vec<Task> = fixed.iter().enumerate().map(|(at, task)| task.at(of(at + 1))).collect();
            let (q, rest) = out.split_at_mut(nq);
            let (beside, room) = rest.split_at_mut(BESIDE);
            let mut solver = scene.inverse_kinematics(&options)?;
            let found = solver.solve_with(&mut scratch.workspace, &tasks, of(0), covariance.then_some(room), q)?;
            #[allow(clippy::cast_precision_loss)] // counts
            beside.copy_from_slice(&[
                f64::from(u8::from(found.reached)),
                found.position_error,
                found.rotation_error,
                found.starts as f64,
                found.iterations as f64,
            ]);
            Ok(())
        })?;
        imported!(py, "phipsi.tasks", "gathered")?.call1((results.finish(), nq, nv, covariance))
    }
}

impl Fixed {
    #[allow(clippy::too_many_arguments)] // the fields of a task
    fn of(
        scene: &Scene,
        kind: String,
        name: &str,
        on: &str,
        point: [f64; 3],
        axis: [f64; 3],
        position: f64,
        rotation: f64,
    ) -> Result<Self, Error> {
        let mut joint = 0;
        let mut frame = Frame { body: None, placement: RigidShift::identity() };
        match &*kind {
            "center-of-mass" => {}
            "joint" => {
                scene.joint(on).map_err(|error| error.of_argument(&format!("{name}.joint")))?;
                joint = scene.joints().iter().position(|one| one.name == on).unwrap_or(0);
            }
            _ => {
                let link = scene.link(on).map_err(|error| error.of_argument(&format!("{name}.link")))?;
                let at = RigidShift { rotation: Matrix3::identity(), lever: point.into() };
                frame = Frame { body: link.body, placement: link.placement.compose(&at) };
            }
        }
        Ok(Self { kind, frame, joint, axis: axis.into(), position, rotation })
    }

    /// The task with the target of one state.
    fn at(&self, target: &[f64]) -> Task {
        let frame = self.frame;
        let axis = self.axis;
        let triple = |from: &[f64]| Vector3::new(from[0], from[1], from[2]);
        let goal = match &*self.kind {
            "pose" => {
                let rotation = Matrix3::from_fn(|i, j| target[4 * i + j]);
                Goal::Pose {
                    frame,
                    target: RigidShift { rotation, lever: Vector3::new(target[3], target[7], target[11]) },
                }
            }
            "position" => Goal::Position { frame, target: triple(target) },
            "orientation" => Goal::Orientation { frame, target: Matrix3::from_row_slice(target) },
            "direction" => Goal::Direction { frame, axis, target: triple(target) },
            "look-at" => Goal::LookAt { frame, axis, target: triple(target) },
            "joint" => Goal::Joint { joint: self.joint, target: target[0] },
            _ => Goal::CenterOfMass(triple(target)),
        };
        Task { goal, position: self.position, rotation: self.rotation }
    }
}
