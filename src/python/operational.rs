//! Methods of `Scene`: operational space.

use super::choice::{names, read_judged, renamed};
use super::input::{one_or_each, rows};
use super::keywords::Keywords;
use super::object::Object;
use super::scene::PyScene;
use super::scratch::Scratch;
use crate::algorithm::Algorithm;
use crate::api::TaskFrame;
use crate::error::{Error, check_finite};
use crate::filter::Form;
use crate::memory;
use crate::scene::Scene;
use crate::spatial::RigidShift;
use nalgebra::{Matrix3, Vector3};
use pyo3::prelude::*;

/// Approximate times per state, ns (see `BatchCall::new`).
mod cost {
    /// Per body: filter, and covariance of the co-states.
    pub const BODY: usize = 200;
    /// Per pair of links, without the paths to their common ancestor.
    pub const PAIR: usize = 200;
    /// Eigenvalues and inverse of a k x k matrix, divided by k^3.
    pub const INVERSE: usize = 20;
}

methods! {
    /// Accelerations of links per wrench on links, J M^-1 J^T, in O(N): operational-space inverse inertia (5.6).
    #[doc = parameters!(q)]
    /// links : str or sequence of str
    ///     Link name or m link names; links on the base and repeated names are allowed.
    #[doc = entries!(task_frames form tolerance models errors)]
    #[doc = section!(Returns)]
    /// inverse : (..., 6m, 6m) ndarray
    ///     Change of the stacked (angular, linear) accelerations of the frames per wrench (moment, force) on them, each
    ///     at the origin and in the axes of its frame; SI units, exactly symmetric, zero for links on the base.
    #[doc = raises!(singular arguments)]
    #[doc = section!(Notes)]
    /// Defined in singular configurations too, unlike operational_inertia. With connections, M^-1 is
    /// loops.mass_matrix_inverse, and with joints that follow others J and M^-1 are those of the independent
    /// joints; both cost O(N^3). Contacts have no effect: the wrenches are the only ones on the links.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> q = [0.3, 0.2, 0.1]
    /// >>> J = scene.jacobian(q, "link2")
    /// >>> np.allclose(scene.operational_inverse_inertia(q, "link2"), J @ scene.mass_matrix_inverse(q) @ J.T)
    /// True
    #[pyo3(text_signature = "($self, q, links, *, at=None, rotation=None, form='auto', tolerance=None, \
                             inertias=None, armature=None, errors='raise')")]
    fn operational_inverse_inertia(q, links; at, rotation, form, tolerance, inertias, armature, errors,
        xyz) |scene, py, keywords| {
        let (form, task) = scene.task(links, keywords)?;
        let frames = task.frames();
        let width = 6 * frames.len();
        memory::room("links", memory::bytes_of::<f64>(&[width, width]))?;
        let call = scene.call_by([scene.configuration("q", q)?], scene.cost_of_task(frames.len()), keywords)?;
        call.array(py, &[width, width], |scene, scratch, [q], out| {
            let Scratch { workspace, operational, .. } = scratch;
            workspace.form = form;
            let operational = operational.get_or_insert_with(|| scene.operational_scratch());
            scene.operational_inverse_inertia(workspace, operational, q, &frames, out)
        }).map(Bound::into_any)
    }

    /// Operational-space inertia (S J M^-1 J^T S^T)^-1 of the task directions S; see operational_inverse_inertia.
    #[doc = parameters!(q)]
    /// links : str or sequence of str
    ///     Link name or m link names.
    #[doc = entries!(task_frames)]
    /// directions : (k, 6m) array_like, optional
    ///     S: each row is a direction in the stacked (angular, linear) velocities of the frames; all 6m by default. The
    ///     same for the whole batch.
    #[doc = entries!(form tolerance models errors)]
    #[doc = section!(Returns)]
    /// inertia : (..., k, k) ndarray
    ///     Inertia, SI units; exactly symmetric and positive definite.
    #[doc = section!(Raises)]
    /// SingularTaskError
    ///     The directions are not independent: an eigenvalue of the scaled inverse inertia is at most 64 k eps. .links,
    ///     .rank, .directions and .state describe the task.
    #[doc = entries!(singular arguments)]
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    /// >>> linear = np.eye(6)[3:]     # the translations, in the link frame
    /// >>> inertia = scene.operational_inertia(scene.neutral(), "flange", directions=linear)
    /// >>> inertia.diagonal().round(1)
    /// array([ 4.3, 25.3, 39. ])
    #[pyo3(text_signature = "($self, q, links, *, at=None, rotation=None, directions=None, form='auto', \
                             tolerance=None, inertias=None, armature=None, errors='raise')")]
    fn operational_inertia(q, links; at, rotation, directions, form, tolerance, inertias, armature, errors,
        xyz) |scene, py, keywords| {
        let (form, task) = scene.task(links, keywords)?;
        let frames = task.frames();
        let width = 6 * frames.len();
        Self::check_task_room("links", [width, width])?;
        let directions = keywords.directions.map(|directions| rows("directions", directions, width)).transpose()?;
        if let Some((_, directions)) = &directions {
            check_finite("directions", directions)?;
        }
        let (k, directions) = match directions {
            Some((k, directions)) => (k, Some(directions)),
            None => (width, None),
        };
        Self::check_task_room(if directions.is_some() { "directions" } else { "links" }, [k, width.max(k)])?;
        let of_inverse = cost::INVERSE.saturating_mul(k.saturating_pow(3));
        let cost = scene.cost_of_task(frames.len()).saturating_add(of_inverse);
        let call = scene.call_by([scene.configuration("q", q)?], cost, keywords)?;
        call.array(py, &[k, k], |scene, scratch, [q], out| {
            let Scratch { workspace, operational, .. } = scratch;
            workspace.form = form;
            let operational = operational.get_or_insert_with(|| scene.operational_scratch());
            scene.operational_inertia(workspace, operational, q, &frames, directions.as_deref(), out)
        }).map(Bound::into_any)
    }
}

impl PyScene {
    /// Checks that the intermediate matrices and the result fit in memory.
    fn check_task_room(argument: &str, [rows, columns]: [usize; 2]) -> Result<(), Error> {
        /// Number of matrices of that size at the same time.
        const AT_ONCE: usize = 6;
        memory::room(argument, memory::bytes_of::<f64>(&[rows, columns, AT_ONCE]))
    }

    /// The form and the frames of a task.
    fn task(&self, links: &Object<'_>, keywords: &Keywords<'_, '_>) -> PyResult<(Form, Task)> {
        let &Keywords { at, rotation, xyz, form, tolerance, errors, .. } = keywords;
        renamed("xyz", xyz, "at")?;
        let form = read_judged(&self.scene, (form, tolerance), Algorithm::MassMatrixInverse)?;
        self.errors(errors, Some(form))?;
        Ok((form, Task::read(&self.scene, links, at, rotation)?))
    }

    fn cost_of_task(&self, frames: usize) -> usize {
        cost::BODY * self.size() + cost::PAIR.saturating_mul(frames.saturating_mul(frames))
    }
}

/// Links of a call by name, and the task frames on them.
struct Task {
    links: Vec<String>,
    offsets: Vec<RigidShift<f64>>,
}

impl Task {
    /// Reads the arguments. Names are checked here too, because a batch can be empty.
    fn read(
        scene: &Scene,
        links: &Object<'_>,
        at: Option<&Object<'_>>,
        rotation: Option<&Object<'_>>,
    ) -> PyResult<Self> {
        let links = names("links", links, "the name of a link, or a sequence of names")?;
        let mut offsets = vec![RigidShift::identity(); links.len()];
        if let Some(at) = at {
            for (offset, at) in offsets.iter_mut().zip(one_or_each("at", at, links.len(), &[3])?) {
                offset.lever = Vector3::from_column_slice(&at);
            }
        }
        if let Some(rotation) = rotation {
            for (offset, rotation) in offsets.iter_mut().zip(one_or_each("rotation", rotation, links.len(), &[3, 3])?) {
                offset.rotation = Matrix3::from_row_slice(&rotation);
            }
        }
        let task = Self { links, offsets };
        scene.check_task(&task.frames())?;
        Ok(task)
    }

    fn frames(&self) -> Vec<TaskFrame<'_>> {
        let links = self.links.iter().zip(&self.offsets);
        links.map(|(link, &offset)| TaskFrame { link, offset }).collect()
    }
}
