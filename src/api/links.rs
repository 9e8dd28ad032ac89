//! Forward kinematics, velocities, accelerations and Jacobians of links at one state. Each method checks its arguments
//! before it computes.
//!
//! A link is given by name, as a [`TaskFrame`] fixed to it, or as a resolved [`Frame`]: see [`OnLink`]. Spatial motions
//! are (angular, linear), in rad and m, relative to the base.

use super::TaskFrame;
use super::declared::quantities_of_links;
use crate::algorithm::KinematicQuantity;
use crate::error::{Error, check_finite, check_length};
use crate::kinematics::{self, AccelerationKind, Frame, ReferenceFrame};
use crate::scene::Scene;
use crate::spatial::{RigidShift, SpatialVector};
use crate::workspace::Workspace;

/// A frame on a link, given by name or already resolved.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum OnLink<'a> {
    /// A link name with an offset.
    Named(TaskFrame<'a>),
    /// A body index with the pose of the frame on that body, as [`Scene::link`] returns it.
    Known(Frame<f64>),
}

impl<'a> From<&'a str> for OnLink<'a> {
    fn from(link: &'a str) -> Self {
        Self::Named(link.into())
    }
}

impl<'a> From<&'a String> for OnLink<'a> {
    fn from(link: &'a String) -> Self {
        link.as_str().into()
    }
}

impl<'a> From<TaskFrame<'a>> for OnLink<'a> {
    fn from(frame: TaskFrame<'a>) -> Self {
        Self::Named(frame)
    }
}

impl From<Frame<f64>> for OnLink<'_> {
    fn from(frame: Frame<f64>) -> Self {
        Self::Known(frame)
    }
}

impl Scene {
    /// Forward kinematics: pose of a link, or of a frame on it, from that frame to the base frame.
    ///
    /// `q` (nq). Visits only the joints between the base and the link: O(depth).
    ///
    /// # Errors
    ///
    /// [`Error::Argument`] for an unknown link or body or for a frame without a rotation matrix, [`Error::Shape`], and
    /// [`Error::NotFinite`].
    pub fn placement<'a>(&self, q: &[f64], link: impl Into<OnLink<'a>>) -> Result<RigidShift<f64>, Error> {
        let frame = self.on_link(&link.into())?;
        let q = &*self.tree_configuration("q", q)?;
        let placement = kinematics::placement(self.model(), q, &frame);
        self.check_result("placement", placement.lever.as_slice())?;
        Ok(placement)
    }

    /// Poses of several links, in their order, written to `out`. Computes each joint that they share once.
    ///
    /// # Errors
    ///
    /// As [`Scene::placement`], and [`Error::Argument`] for a workspace of another scene.
    pub fn placements_of<'a, L: Copy + Into<OnLink<'a>>>(
        &self,
        workspace: &mut Workspace<f64>,
        q: &[f64],
        links: &[L],
        out: &mut [RigidShift<f64>],
    ) -> Result<(), Error> {
        let q = &*self.tree_configuration("q", q)?;
        self.check_workspace(workspace)?;
        check_length("out", out.len(), links.len())?;
        let Workspace { needed, store, .. } = workspace;
        let shift = &mut store.shifts;
        needed.fill(false);
        for &link in links {
            if let Some(body) = self.on_link(&link.into())?.body {
                needed[body] = true;
            }
        }
        kinematics::placements_on_the_way(self.model(), q, needed, shift);
        for (&link, out) in links.iter().zip(out) {
            let frame = self.on_link(&link.into())?;
            *out = frame.body.map_or(frame.placement, |body| shift[body].compose(&frame.placement));
            self.check_result("placement", out.lever.as_slice())?;
        }
        Ok(())
    }

    /// Resolves the frame, and checks that the scene has its body.
    #[inline]
    fn on_link(&self, frame: &OnLink<'_>) -> Result<Frame<f64>, Error> {
        match frame {
            OnLink::Named(frame) => self.frame(frame),
            OnLink::Known(frame) => self.check_frame(frame).map(|()| *frame),
        }
    }

    /// Checks that a frame is on a body of the scene and that its pose is finite.
    #[inline]
    pub(crate) fn check_frame(&self, frame: &Frame<f64>) -> Result<(), Error> {
        let bodies = self.model().bodies.len();
        match frame.body {
            Some(body) if body >= bodies => {
                let expected = format!("an index below the number of bodies, {bodies}, or none for the base");
                Err(Error::argument("body of the frame", body.to_string(), expected))
            }
            _ => {
                let RigidShift { rotation, lever } = &frame.placement;
                check_finite("placement of the frame", rotation.as_slice())?;
                check_finite("placement of the frame", lever.as_slice())
            }
        }
    }
}

quantities_of_links! {
    /// Spatial velocity of a link, or of a frame on it, expressed in `reference`.
    ///
    /// `q` (nq), `qd` (nv). O(depth).
    ///
    /// # Errors
    ///
    /// As [`Scene::placement`].
    fn velocity(q, qd; reference: ReferenceFrame) -> SpatialVector = Velocity;

    /// Spatial acceleration of a link, or of a frame on it, for the joint accelerations `qdd`, expressed in
    /// `reference`. Gravity is excluded.
    ///
    /// `q` (nq), `qd`, `qdd` (nv). O(depth).
    ///
    /// # Errors
    ///
    /// As [`Scene::placement`].
    fn acceleration(q, qd, qdd; reference: ReferenceFrame, kind: AccelerationKind) -> SpatialVector = Acceleration;

    /// Jacobian J of a link, or of a frame on it, (6 x nv), row-major: its velocity expressed in `reference` is J qd.
    ///
    /// In [`ReferenceFrame::Local`], a wrench w on the link, at the origin of the frame and in its axes, causes the
    /// joint torques J^T w. O(depth), plus clearing `out`.
    ///
    /// ```
    /// use phipsi::kinematics::ReferenceFrame::Local;
    /// # fn main() -> Result<(), phipsi::Error> {
    /// let scene = phipsi::scenes::chain(3)?;
    /// let (q, qd, mut jacobian) = ([0.1, -0.4, 0.7], [0.2, 0.5, -0.3], [f64::NAN; 18]);
    /// scene.jacobian(&q, "link2", Local, &mut jacobian)?;
    /// let velocity = scene.velocity(&q, &qd, "link2", Local)?;
    /// for (row, v) in jacobian.chunks(3).zip(velocity.iter()) {
    ///     assert!((row.iter().zip(&qd).map(|(j, qd)| j * qd).sum::<f64>() - v).abs() < 1e-14);
    /// }
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    ///
    /// As [`Scene::placement`].
    fn jacobian(q; reference: ReferenceFrame) -> _ = Jacobian;

    /// Time derivative J' of [`Scene::jacobian`] for the joint velocities `qd`, (6 x nv), row-major: the derivative of
    /// every entry of J as expressed in `reference`. O(depth), plus clearing `out`.
    ///
    /// J qdd + J' qd is the spatial acceleration in the references local and world, and the classical acceleration in
    /// the local-world-aligned reference.
    ///
    /// # Errors
    ///
    /// As [`Scene::placement`].
    fn jacobian_rate(q, qd; reference: ReferenceFrame) -> _ = JacobianRate;

    /// Product J' qd of [`Scene::jacobian_rate`] with qd: the acceleration for zero joint accelerations. Does not form
    /// J'. O(depth).
    ///
    /// # Errors
    ///
    /// As [`Scene::placement`].
    fn jacobian_rate_product(q, qd; reference: ReferenceFrame) -> SpatialVector = JacobianRateProduct;
    /// Derivatives of [`Scene::velocity`] with respect to q and qd, (2 x 6 x nv) row by row; the second is
    /// [`Scene::jacobian`].
    ///
    /// Derivatives by q are along the tangent space, as those of the dynamics. O(depth), plus clearing `out`.
    ///
    /// # Errors
    ///
    /// As [`Scene::placement`].
    fn velocity_derivatives(q, qd; reference: ReferenceFrame) -> _ = VelocityDerivatives;

    /// Derivatives of [`Scene::acceleration`] with respect to q, qd and qdd, (3 x 6 x nv) row by row; the third is
    /// [`Scene::jacobian`]. O(depth), plus clearing `out`.
    ///
    /// # Errors
    ///
    /// As [`Scene::velocity_derivatives`].
    fn acceleration_derivatives(q, qd, qdd; reference: ReferenceFrame, kind: AccelerationKind) -> _
        = AccelerationDerivatives;

    /// Derivatives of [`Scene::jacobian`] with respect to q, (6 x nv x nv) row by row: entry (i, j, k) is that of
    /// J(i, j) along degree of freedom k. O(depth^2), plus clearing `out`.
    ///
    /// # Errors
    ///
    /// As [`Scene::velocity_derivatives`].
    fn jacobian_derivatives(q; reference: ReferenceFrame) -> _ = JacobianDerivatives;
}
