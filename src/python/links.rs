//! Methods of `Scene`: where one link is and how it moves, in O(depth).

use super::choice::{choose, names};
use super::input::triple;
use super::object::Object;
use super::scene::PyScene;
use crate::algorithm::KinematicQuantity;
use crate::error::{Error, check_finite};
use crate::kinematics::frame::{ACCELERATION_KINDS, REFERENCE_FRAMES};
use crate::kinematics::{Frame, ReferenceFrame};
use crate::memory;
use crate::spatial::RigidShift;
use nalgebra::Vector3;
use pyo3::prelude::*;
use pyo3::types::PyString;

/// Rough time of one body in one state, ns.
mod cost {
    pub const PLACEMENT: usize = 40;
    pub const MOTION: usize = 60;
    pub const JACOBIAN: usize = 60;
}

#[pymethods]
impl PyScene {
    /// Where a link is, or several: homogeneous matrices, link frame to base frame.
    ///
    /// q: (..., nq). link: a name, or a sequence of L names (links on the base and repeated ones too). Only the joints between the base and these links
    /// are computed: O(depth); placements has all links by name.
    ///
    /// Returns (..., 4, 4) for a name, (..., L, 4, 4) for a sequence: [[R, p], [0, 1]] with p in m.
    ///
    /// errors: as in forward_dynamics. Raises ArgumentError for an unknown link; ShapeError, NotFiniteError, ArgumentError for a bad q, naming the state.
    #[pyo3(signature = (q, link, *, errors="raise"))]
    fn placement<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        link: &Object<'py>,
        errors: &str,
    ) -> PyResult<Object<'py>> {
        if let Ok(name) = link.cast::<PyString>() {
            let frame = self.scene.frame(&name.to_str()?.into())?;
            let cost = cost::PLACEMENT * self.depth(&frame);
            return self.kinematic_quantity(
                py,
                &KinematicQuantity::Placement(&frame),
                [("q", q)],
                (&[4, 4], cost),
                errors,
            );
        }
        let names = names("link", link, "the name of a link, or a sequence of names")?;
        memory::room("link", memory::bytes_of::<f64>(&[names.len(), 16, 3]))?;
        let mut frames = Vec::with_capacity(names.len());
        for name in &names {
            frames.push(self.scene.frame(&name.as_str().into())?);
        }
        let cost = frames.iter().map(|frame| cost::PLACEMENT * self.depth(frame)).sum();
        let shape = [frames.len(), 4, 4];
        self.each(py, [("q", q)], &shape, cost, errors, |scene, scratch, [q], out| {
            scratch.placements.resize(frames.len(), RigidShift::identity());
            scene.placements_of(&mut scratch.workspace, q, &frames, &mut scratch.placements)?;
            for (placement, out) in scratch.placements.iter().zip(out.chunks_exact_mut(16)) {
                placement.homogeneous(out);
            }
            Ok(())
        })
    }

    /// The velocity of a link against the base, (angular, linear): J qd.
    ///
    /// q: (..., nq); qd: (..., nv); leading axes broadcast. link: its name. at: a point (3,) in the link's frame, m, that stays where it is on the link;
    /// the link's origin by default. frame: what the velocity is written in,
    ///
    /// - "local": the point's velocity in the link's axes;
    /// - "local-world-aligned": the same in the base's axes;
    /// - "world": the spatial velocity in the base's frame: the linear half is that of what is on the link at the base's origin, whatever at is.
    ///
    /// They are Pinocchio's LOCAL, LOCAL_WORLD_ALIGNED and WORLD, angular half first. Returns (..., 6), rad/s and m/s. O(depth).
    ///
    /// errors: as in forward_dynamics. Raises ArgumentError for an unknown link or frame; ShapeError, NotFiniteError, ArgumentError, each naming the
    /// argument and the state.
    #[pyo3(signature = (q, qd, link, *, frame="local", at=None, errors="raise"))]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn velocity<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        qd: &Object<'py>,
        link: &str,
        frame: &str,
        at: Option<&Object<'py>>,
        errors: &str,
    ) -> PyResult<Object<'py>> {
        let (reference, frame) = (read_frame(frame)?, self.on_link(link, at)?);
        let cost = cost::MOTION * self.depth(&frame);
        self.kinematic_quantity(
            py,
            &KinematicQuantity::Velocity(&frame, reference),
            [("q", q), ("qd", qd)],
            (&[6], cost),
            errors,
        )
    }

    /// The acceleration of a link against the base, (angular, linear), at joint accelerations qdd; gravity is not in it.
    ///
    /// q: (..., nq); qd, qdd: (..., nv); leading axes broadcast. link, frame, at: as in velocity. kind: "spatial", the rate of the spatial velocity, as
    /// in Newton and Euler's equations of motion; or "classical", whose linear half is the acceleration of the point itself: w x v more.
    ///
    /// Returns (..., 6), rad/s^2 and m/s^2. O(depth).
    ///
    /// errors: as in forward_dynamics. Raises ArgumentError for an unknown link, frame or kind; otherwise as velocity.
    #[pyo3(signature = (q, qd, qdd, link, *, frame="local", at=None, kind="spatial", errors="raise"))]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn acceleration<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        qd: &Object<'py>,
        qdd: &Object<'py>,
        link: &str,
        frame: &str,
        at: Option<&Object<'py>>,
        kind: &str,
        errors: &str,
    ) -> PyResult<Object<'py>> {
        let (reference, frame) = (read_frame(frame)?, self.on_link(link, at)?);
        let kind = choose("kind", kind, &ACCELERATION_KINDS)?;
        let cost = cost::MOTION * self.depth(&frame);
        let given = [("q", q), ("qd", qd), ("qdd", qdd)];
        self.kinematic_quantity(
            py,
            &KinematicQuantity::Acceleration(&frame, reference, kind),
            given,
            (&[6], cost),
            errors,
        )
    }

    /// The Jacobian J of a link: its velocity (angular, linear) is J qd.
    ///
    /// q: (..., nq). link, frame, at: as in velocity; by default at the link's origin and in its own frame. Returns (..., 6, nv), SI units; in frame
    /// "local" a wrench w on the link there gives the joint torques J^T w. Columns of joints that do not move the link are zero.
    ///
    /// errors: as in forward_dynamics. Raises ArgumentError for an unknown link or frame; ShapeError, NotFiniteError, ArgumentError, each naming the
    /// argument and the state.
    #[pyo3(signature = (q, link, *, frame="local", at=None, errors="raise"))]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn jacobian<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        link: &str,
        frame: &str,
        at: Option<&Object<'py>>,
        errors: &str,
    ) -> PyResult<Object<'py>> {
        let (reference, frame) = (read_frame(frame)?, self.on_link(link, at)?);
        let (cost, shape) = (cost::JACOBIAN * self.depth(&frame), [6, self.scene.nv()]);
        self.kinematic_quantity(py, &KinematicQuantity::Jacobian(&frame, reference), [("q", q)], (&shape, cost), errors)
    }

    /// The rate J' of the Jacobian of a link along qd, entry by entry as jacobian writes it in this frame.
    ///
    /// q: (..., nq); qd: (..., nv); leading axes broadcast. link, frame, at: as in velocity. Returns (..., 6, nv), SI units.
    ///
    /// J qdd + J' qd is the spatial acceleration in the frames "local" and "world". The frame "local-world-aligned" moves with the point but does not
    /// turn, so that it is the classical one there. jacobian_rate_product has J' qd alone, in O(depth).
    ///
    /// errors: as in forward_dynamics. Raises as jacobian.
    #[pyo3(signature = (q, qd, link, *, frame="local", at=None, errors="raise"))]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn jacobian_rate<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        qd: &Object<'py>,
        link: &str,
        frame: &str,
        at: Option<&Object<'py>>,
        errors: &str,
    ) -> PyResult<Object<'py>> {
        let (reference, frame) = (read_frame(frame)?, self.on_link(link, at)?);
        let (cost, shape) = (2 * cost::JACOBIAN * self.depth(&frame), [6, self.scene.nv()]);
        let given = [("q", q), ("qd", qd)];
        self.kinematic_quantity(py, &KinematicQuantity::JacobianRate(&frame, reference), given, (&shape, cost), errors)
    }

    /// J' qd of a link, without J': the acceleration that rates alone give, as jacobian_rate @ qd.
    ///
    /// q: (..., nq); qd: (..., nv); leading axes broadcast. link, frame, at: as in velocity. Returns (..., 6), rad/s^2 and m/s^2: spatial in the frames
    /// "local" and "world", classical in "local-world-aligned". O(depth).
    ///
    /// errors: as in forward_dynamics. Raises as jacobian.
    #[pyo3(signature = (q, qd, link, *, frame="local", at=None, errors="raise"))]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn jacobian_rate_product<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        qd: &Object<'py>,
        link: &str,
        frame: &str,
        at: Option<&Object<'py>>,
        errors: &str,
    ) -> PyResult<Object<'py>> {
        let (reference, frame) = (read_frame(frame)?, self.on_link(link, at)?);
        let cost = cost::MOTION * self.depth(&frame);
        let given = [("q", q), ("qd", qd)];
        self.kinematic_quantity(
            py,
            &KinematicQuantity::JacobianRateProduct(&frame, reference),
            given,
            (&[6], cost),
            errors,
        )
    }
}

impl PyScene {
    /// The link's own frame, moved to the point `at`; an error for an unknown link, also where the batch is empty.
    fn on_link(&self, link: &str, at: Option<&Object<'_>>) -> PyResult<Frame<f64>> {
        let mut frame = self.scene.frame(&link.into())?;
        if let Some(at) = at {
            let point = triple("at", at)?;
            check_finite("at", &point)?;
            frame.placement.lever += frame.placement.rotate(&Vector3::from(point));
        }
        Ok(frame)
    }

    /// How many bodies are between the base and a frame, at least one: what the time of a call is counted in.
    fn depth(&self, frame: &Frame<f64>) -> usize {
        let stages = &self.scene.model().system.stages;
        std::iter::successors(frame.body, |&k| stages[k].parent).count().max(1)
    }
}

/// The argument `frame`.
pub(super) fn read_frame(frame: &str) -> Result<ReferenceFrame, Error> {
    choose("frame", frame, &REFERENCE_FRAMES)
}
