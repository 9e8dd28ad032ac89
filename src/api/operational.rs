//! Operational-space inertia of a scene's links, with arguments checked and faults named.

use crate::dynamics;
use crate::dynamics::operational::{Frame, MANY, OperationalScratch};
use crate::error::{Error, check_finite, check_length};
use crate::interrupt;
use crate::scene::Scene;
use crate::spatial::RigidShift;
use crate::workspace::Workspace;
use nalgebra::{DMatrix, Matrix3};

/// How far R^T R of a task frame may be from the identity.
pub const ROTATION_SLACK: f64 = 1e-9;

/// How many times the rounding of its terms an eigenvalue must exceed, a direction.
const EIGENVALUE_MARGIN: f64 = 64.0;

/// A frame on a link, by the link's name; a bare name is the link's own frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TaskFrame<'a> {
    /// Name of the link.
    pub link: &'a str,
    /// From the task frame to the link's frame: its rotation, and its origin in m.
    pub offset: RigidShift<f64>,
}

impl<'a> From<&'a str> for TaskFrame<'a> {
    fn from(link: &'a str) -> Self {
        Self { link, offset: RigidShift::identity() }
    }
}

impl Scene {
    /// Scratch for [`Scene::operational_inverse_inertia`] and [`Scene::operational_inertia`].
    #[must_use]
    pub fn operational_scratch(&self) -> OperationalScratch<f64> {
        OperationalScratch::new(self.model())
    }

    /// The operational-space inverse inertia Omega = J M^-1 J^T of links (names, or [`TaskFrame`]s) at `q`, (6m x 6m) row by row.
    ///
    /// J stacks the links' Jacobians: velocities (angular, linear), each at its frame's origin and in its axes. Forces F on the
    /// frames change their accelerations by Omega F. It is defined in every configuration, singular ones too. O(N + m^2 depth):
    /// see [`dynamics::operational_inverse_inertia`].
    ///
    /// # Errors
    ///
    /// No link, an unknown link, a task frame without a rotation matrix, wrong lengths, numbers that are not finite, and
    /// [`Error::SingularJoint`].
    pub fn operational_inverse_inertia<'a, L: Copy + Into<TaskFrame<'a>>>(
        &self,
        workspace: &mut Workspace<f64>,
        scratch: &mut OperationalScratch<f64>,
        q: &[f64],
        links: &[L],
        out: &mut [f64],
    ) -> Result<(), Error> {
        self.check_configuration("q", q)?;
        some_link(links)?;
        check_length("out", out.len(), 36 * links.len() * links.len())?;
        self.check_workspace(workspace)?;
        self.check_scratch("scratch", scratch.identity, "scene.operational_scratch()")?;
        self.check_form(workspace)?;
        let mut frames = std::mem::take(&mut scratch.frames);
        frames.clear();
        for &link in links {
            frames.push(self.frame(&link.into())?);
        }
        let monitor = dynamics::operational_inverse_inertia(self.model(), workspace, scratch, q, &frames, out);
        let many = frames.len() * frames.len() >= MANY;
        scratch.frames = frames;
        if many {
            interrupt::check()?;
        }
        self.check_pivots(workspace, monitor)?;
        self.check_result("operational inverse inertia", out)
    }

    /// The operational-space inertia (S Omega S^T)^-1 of links at `q`, for k task directions, (k x k) row by row.
    ///
    /// `directions` is S, (k x 6m) row by row over the stacked (angular, linear) velocities of the links (or [`TaskFrame`]s); none
    /// stands for all 6m. The result is symmetric and positive definite. Where the directions depend on each other, or the
    /// scene cannot move in one of them, there is none: the smallest eigenvalue of S Omega S^T, each direction scaled to the
    /// size of the terms that it is formed from, is not above 64 k eps. O(N + m^2 depth + k^3).
    ///
    /// # Errors
    ///
    /// As [`Scene::operational_inverse_inertia`]; and [`Error::SingularTask`] with the rank that there is.
    pub fn operational_inertia<'a, L: Copy + Into<TaskFrame<'a>>>(
        &self,
        workspace: &mut Workspace<f64>,
        scratch: &mut OperationalScratch<f64>,
        q: &[f64],
        links: &[L],
        directions: Option<&[f64]>,
        out: &mut [f64],
    ) -> Result<(), Error> {
        let width = 6 * links.len();
        let s = task_directions(directions, width)?;
        let k = s.nrows();
        check_length("out", out.len(), k * k)?;
        let mut omega = DMatrix::from_element(width, width, f64::NAN);
        self.operational_inverse_inertia(workspace, scratch, q, links, omega.as_mut_slice())?;

        // The terms of each direction, which are what rounding is relative to. Omega's own diagonal will not do: where the exact
        // entry is zero, rounding would be scaled to one and pass for a direction of its own.
        let mut sizes = vec![0.0; k];
        for (at, frame) in scratch.frames.iter().enumerate() {
            let of_frame = scratch.term_sizes(self.model(), frame);
            for (row, size) in sizes.iter_mut().enumerate() {
                for (half, part) in of_frame.iter().enumerate() {
                    *size += s.view((row, 6 * at + 3 * half), (1, 3)).norm() * part;
                }
            }
        }
        let product = &s * omega * s.transpose();
        self.check_result("operational inertia", product.as_slice())?;
        self.check_result("operational inertia", &sizes)?;
        let scaled = DMatrix::from_fn(k, k, |i, j| {
            let entry = product[(i.min(j), i.max(j))];
            if entry == 0.0 { 0.0 } else { entry / sizes[i] / sizes[j] }
        });
        self.check_result("operational inertia", scaled.as_slice())?;

        #[allow(clippy::cast_precision_loss)] // a count of directions
        let margin = EIGENVALUE_MARGIN * k as f64 * f64::EPSILON;
        let rank = scaled.symmetric_eigenvalues().iter().filter(|&&value| value > margin).count();
        let inverse = if rank == k { scaled.cholesky().map(|factor| factor.inverse()) } else { None };
        let Some(inverse) = inverse else {
            let names = links.iter().map(|&link| link.into().link.to_owned()).collect();
            return Err(Error::SingularTask { links: names, rank, directions: k, state: None });
        };
        for i in 0..k {
            for j in i..k {
                let entry = inverse[(i, j)] / sizes[i] / sizes[j];
                out[i * k + j] = entry;
                out[j * k + i] = entry;
            }
        }
        self.check_result("operational inertia", out)
    }

    /// Checks task frames as the methods above do: at least one, known links, rotation matrices, finite numbers.
    ///
    /// # Errors
    ///
    /// [`Error::Argument`] or [`Error::NotFinite`], naming the link.
    #[doc(hidden)]
    pub fn check_task(&self, frames: &[TaskFrame<'_>]) -> Result<(), Error> {
        some_link(frames)?;
        frames.iter().try_for_each(|task| self.frame(task).map(|_| ()))
    }

    /// A frame on a link, looked up: on which body it is, and where.
    ///
    /// # Errors
    ///
    /// An unknown link, and an offset that is no finite shift.
    pub fn frame(&self, task: &TaskFrame<'_>) -> Result<Frame<f64>, Error> {
        let link = self.link(task.link)?;
        if task.offset == RigidShift::identity() {
            return Ok(Frame { body: link.body, placement: link.placement });
        }
        let of_link = |what: &str| format!("{what} of the task frame on link {:?}", task.link);
        let RigidShift { rotation, lever } = &task.offset;
        if !lever.iter().chain(rotation.iter()).all(|x| x.is_finite()) {
            check_finite(&of_link("xyz"), lever.as_slice())?;
            // Row by row, as it is written.
            check_finite(&of_link("rotation"), rotation.transpose().as_slice())?;
        }
        let defect = (rotation.transpose() * rotation - Matrix3::identity()).amax();
        if !(defect <= ROTATION_SLACK && rotation.determinant() > 0.0) {
            let found = if defect <= ROTATION_SLACK {
                "a reflection (determinant -1)".to_owned()
            } else {
                format!("a matrix R with R^T R off the identity by {defect:.1e}")
            };
            return Err(Error::argument(of_link("rotation"), found, "a rotation matrix, to within 1e-9"));
        }
        Ok(Frame { body: link.body, placement: link.placement.compose(&task.offset) })
    }
}

fn some_link<L>(links: &[L]) -> Result<(), Error> {
    if links.is_empty() {
        return Err(Error::argument("links", "none", "at least one link"));
    }
    Ok(())
}

/// S as a matrix; the identity where none are given.
fn task_directions(directions: Option<&[f64]>, width: usize) -> Result<DMatrix<f64>, Error> {
    let Some(directions) = directions else { return Ok(DMatrix::identity(width, width)) };
    if directions.is_empty() || width == 0 || !directions.len().is_multiple_of(width) {
        return Err(Error::Shape {
            argument: "directions".to_owned(),
            found: format!("({},)", directions.len()),
            expected: format!("(k * {width},), k at least 1"),
        });
    }
    check_finite("directions", directions)?;
    Ok(DMatrix::from_row_slice(directions.len() / width, width, directions))
}
