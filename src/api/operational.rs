//! Operational-space inertia of links at one state. Each method checks its arguments before it computes.

use crate::decompositions::eigenvalues;
use crate::dynamics;
use crate::dynamics::operational::{Frame, MANY, OperationalScratch};
use crate::error::{Error, check_finite, check_length};
use crate::interrupt;
use crate::kinematics::local_jacobian;
use crate::scene::Scene;
use crate::spatial::RigidShift;
use crate::workspace::Workspace;
use nalgebra::{DMatrix, Matrix3};

/// Largest accepted entry of R^T R - 1 for the rotation R of a task frame.
pub const ROTATION_SLACK: f64 = 1e-9;

/// An eigenvalue counts as positive if it exceeds this multiple of the rounding error of its terms, per direction.
const EIGENVALUE_MARGIN: f64 = 64.0;

/// A frame fixed to a link, which is given by name. A bare name denotes the link frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TaskFrame<'a> {
    /// Name of the link.
    pub link: &'a str,
    /// Pose of the task frame in the link frame: rotation from task axes to link axes, and origin in m.
    pub offset: RigidShift<f64>,
}

impl<'a> From<&'a str> for TaskFrame<'a> {
    fn from(link: &'a str) -> Self {
        Self { link, offset: RigidShift::identity() }
    }
}

#[cfg(feature = "estimation")]
impl<'a> From<&'a crate::estimation::Mount> for TaskFrame<'a> {
    fn from(mount: &'a crate::estimation::Mount) -> Self {
        Self { link: &mount.link, offset: mount.offset }
    }
}

impl Scene {
    /// Scratch memory for [`Scene::operational_inverse_inertia`] and [`Scene::operational_inertia`].
    #[must_use]
    pub fn operational_scratch(&self) -> OperationalScratch<f64> {
        OperationalScratch::new(self.model())
    }

    /// Operational-space inverse inertia Omega = J M^-1 J^T of links (names or [`TaskFrame`]s) at `q`, (6m x 6m),
    /// row-major.
    ///
    /// J stacks the Jacobians of the m frames: velocities (angular, linear) at the origin of each frame and in its
    /// axes. Spatial forces F on the frames change their accelerations by Omega F. Omega is defined at every
    /// configuration, including singular ones. O(N + m^2 depth): see [`dynamics::operational_inverse_inertia`]. With
    /// connections, M^-1 is that of [`Scene::constrained_mass_matrix_inverse`], and with joints that follow others the
    /// one of the independent joints: O(nv^2 (nv + m)).
    ///
    /// # Errors
    ///
    /// [`Error::Argument`] for no link, an unknown link, or a task frame whose rotation is not a rotation matrix;
    /// [`Error::Shape`], [`Error::NotFinite`], and [`Error::SingularJoint`].
    pub fn operational_inverse_inertia<'a, L: Copy + Into<TaskFrame<'a>>>(
        &self,
        workspace: &mut Workspace<f64>,
        scratch: &mut OperationalScratch<f64>,
        q: &[f64],
        links: &[L],
        out: &mut [f64],
    ) -> Result<(), Error> {
        let q_of_tree = self.tree_configuration("q", q)?;
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
        // With rows too: `operational_inertia` reads the sizes of the terms of the tree, which rows only reduce.
        let monitor = dynamics::operational_inverse_inertia(self.model(), workspace, scratch, &q_of_tree, &frames, out);
        let many = frames.len() * frames.len() >= MANY;
        let done = if self.coupling().is_some() || !self.constraints().is_empty() {
            self.operational_through_rows(workspace, (q, &q_of_tree), &frames, out)
        } else {
            self.check_pivots(workspace, monitor)
        };
        scratch.frames = frames;
        if many {
            interrupt::check()?;
        }
        done?;
        self.check_result("operational inverse inertia", out)
    }

    /// As [`Scene::operational_inverse_inertia`] with connections or joints that follow others.
    fn operational_through_rows(
        &self,
        workspace: &mut Workspace<f64>,
        (q, q_of_tree): (&[f64], &[f64]),
        frames: &[Frame<f64>],
        out: &mut [f64],
    ) -> Result<(), Error> {
        let nv = self.nv();
        // Row-major: the transpose of J in the order of nalgebra.
        let mut transpose = DMatrix::from_element(nv, 6 * frames.len(), f64::NAN);
        for (frame, own) in frames.iter().zip(transpose.as_mut_slice().chunks_exact_mut((6 * nv).max(1))) {
            self.tree_columns(6, own, |out| {
                local_jacobian(self.model(), q_of_tree, frame, out);
            })?;
        }
        self.gram_through_rows(workspace, q, &transpose, out)
    }

    /// J M^-1 J^T with the inverse mass matrix of the scene with its connections and of its independent joints, for the
    /// transpose of J.
    pub(super) fn gram_through_rows(
        &self,
        workspace: &mut Workspace<f64>,
        q: &[f64],
        transpose: &DMatrix<f64>,
        out: &mut [f64],
    ) -> Result<(), Error> {
        let (nv, rows) = transpose.shape();
        let mut inverse = DMatrix::from_element(nv, nv, f64::NAN);
        if self.constraints().is_empty() {
            self.mass_matrix_inverse(workspace, &mut self.inverse_scratch(), q, inverse.as_mut_slice())?;
        } else {
            let scratch = &mut self.constraint_scratch();
            self.constrained_mass_matrix_inverse(workspace, scratch, q, inverse.as_mut_slice())?;
        }
        let product = transpose.transpose() * inverse * transpose;
        for i in 0..rows {
            for j in 0..rows {
                out[i * rows + j] = product[(i.min(j), i.max(j))];
            }
        }
        Ok(())
    }

    /// Operational-space inertia (S Omega S^T)^-1 of links at `q` for k task directions, (k x k), row-major.
    ///
    /// `directions` is S, (k x 6m), row-major, over the stacked velocities (angular, linear) of the links (or
    /// [`TaskFrame`]s); `None` selects all 6m. The result is symmetric and positive definite. It does not exist if the
    /// directions are linearly dependent or the scene cannot move along one of them. The test for that scales each
    /// direction by the size of its terms and requires that the smallest eigenvalue of S Omega S^T exceed 64 k eps. O(N
    /// + m^2 depth + k^3).
    ///
    /// # Errors
    ///
    /// As [`Scene::operational_inverse_inertia`], and [`Error::SingularTask`], which reports the rank.
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

        // Rounding errors are relative to the sizes of the terms of each direction. The diagonal of Omega is unsuitable
        // as a scale: if an exact entry is zero, scaling would amplify its rounding error to 1 and count it as a
        // direction.
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

        #[allow(clippy::cast_precision_loss)] // a small count
        let margin = EIGENVALUE_MARGIN * k as f64 * f64::EPSILON;
        let rank = eigenvalues(scaled.clone())
            .map_or(0, |found| found.eigenvalues.iter().filter(|&&value| value > margin).count());
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

    /// Checks task frames: at least one, known links, rotation matrices, finite values.
    ///
    /// # Errors
    ///
    /// [`Error::Argument`] or [`Error::NotFinite`], naming the link.
    #[doc(hidden)]
    pub fn check_task(&self, frames: &[TaskFrame<'_>]) -> Result<(), Error> {
        some_link(frames)?;
        frames.iter().try_for_each(|task| self.frame(task).map(|_| ()))
    }

    /// Resolves a task frame: the body that carries the link, and the pose of the frame on it.
    ///
    /// # Errors
    ///
    /// [`Error::Argument`] for an unknown link or an offset that is not a rigid transform, and [`Error::NotFinite`].
    pub fn frame(&self, task: &TaskFrame<'_>) -> Result<Frame<f64>, Error> {
        let link = self.link(task.link)?;
        if task.offset == RigidShift::identity() {
            return Ok(link.into());
        }
        let of_link = |what: &str| format!("{what} of the task frame on link {:?}", task.link);
        let RigidShift { rotation, lever } = &task.offset;
        if !lever.iter().chain(rotation.iter()).all(|x| x.is_finite()) {
            check_finite(&of_link("xyz"), lever.as_slice())?;
            // Row-major, the order in which users write matrices.
            check_finite(&of_link("rotation"), rotation.transpose().as_slice())?;
        }
        let defect = (rotation.transpose() * rotation - Matrix3::identity()).amax();
        if !(defect <= ROTATION_SLACK && rotation.determinant() > 0.0) {
            let found = if defect <= ROTATION_SLACK {
                "a reflection (determinant -1)".to_owned()
            } else {
                format!("a matrix R for which R^T R differs from the identity by {defect:.1e}")
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

/// The selection matrix S, or the identity if no directions are given.
fn task_directions(directions: Option<&[f64]>, width: usize) -> Result<DMatrix<f64>, Error> {
    let Some(directions) = directions else { return Ok(DMatrix::identity(width, width)) };
    if directions.is_empty() || width == 0 || !directions.len().is_multiple_of(width) {
        let expected = format!("(k * {width},), k at least 1");
        return Err(Error::shape("directions", format!("({},)", directions.len()), expected));
    }
    check_finite("directions", directions)?;
    Ok(DMatrix::from_row_slice(directions.len() / width, width, directions))
}
