//! Where links of a scene are and how they move, at one state, with arguments checked and faults named.
//!
//! A link is given by its name, as a [`TaskFrame`], which is fixed on it, or as a [`Frame`] that was looked up before: see [`OnLink`]. Motions are (angular, linear), rad and m, against the base.

use super::TaskFrame;
use crate::error::{Error, check_finite, check_length};
use crate::kinematics::{self, AccelerationKind, Frame, FrameMotion, ReferenceFrame};
use crate::scene::Scene;
use crate::spatial::{RigidShift, SpatialVector};
use crate::workspace::Workspace;

/// A frame on a link: of the link's name, or as it was looked up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum OnLink<'a> {
    /// By the link's name.
    Named(TaskFrame<'a>),
    /// By its body, with the link's placement in it: what [`Scene::link`] gives.
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
    /// Where a link, or a frame on it, is: from its frame to the base's.
    ///
    /// `q` (nq). Only the joints between the base and the link are computed: O(depth).
    ///
    /// # Errors
    ///
    /// An unknown link or body, a frame without a rotation matrix, wrong lengths and numbers that are not finite.
    pub fn placement<'a>(&self, q: &[f64], link: impl Into<OnLink<'a>>) -> Result<RigidShift<f64>, Error> {
        let frame = self.on_link(&link.into())?;
        let q = &*self.tree_configuration("q", q)?;
        let placement = kinematics::placement(self.model(), q, &frame);
        self.check_result("placement", placement.lever.as_slice())?;
        Ok(placement)
    }

    /// Where several links are, in their order, into `out`: as [`Scene::placement`] of each, joints that they share computed once.
    ///
    /// # Errors
    ///
    /// As [`Scene::placement`], and a workspace of another scene.
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

    /// The velocity of a link, or of a frame on it, written in `reference`.
    ///
    /// `q` (nq), `qd` (nv). O(depth).
    ///
    /// # Errors
    ///
    /// As [`Scene::placement`].
    pub fn velocity<'a>(
        &self,
        q: &[f64],
        qd: &[f64],
        link: impl Into<OnLink<'a>>,
        reference: ReferenceFrame,
    ) -> Result<SpatialVector<f64>, Error> {
        let velocity = self.frame_motion(q, qd, None, &link.into())?.velocity_in(reference);
        self.check_result("velocity", velocity.as_slice())?;
        Ok(velocity)
    }

    /// The acceleration of a link, or of a frame on it, written in `reference`, at joint accelerations `qdd`; gravity is not in it.
    ///
    /// `q` (nq), `qd`, `qdd` (nv). O(depth).
    ///
    /// # Errors
    ///
    /// As [`Scene::placement`].
    pub fn acceleration<'a>(
        &self,
        q: &[f64],
        qd: &[f64],
        qdd: &[f64],
        link: impl Into<OnLink<'a>>,
        reference: ReferenceFrame,
        kind: AccelerationKind,
    ) -> Result<SpatialVector<f64>, Error> {
        let acceleration = self.frame_motion(q, qd, Some(qdd), &link.into())?.acceleration_in(reference, kind);
        self.check_result("acceleration", acceleration.as_slice())?;
        Ok(acceleration)
    }

    /// The Jacobian J of a link, or of a frame on it, (6 x nv) row by row: its velocity written in `reference` is J qd.
    ///
    /// In [`ReferenceFrame::Local`] a wrench w on the link, at the frame's origin and in its axes, gives the joint torques J^T w. O(depth), beside
    /// the zeros.
    ///
    /// # Errors
    ///
    /// As [`Scene::placement`].
    pub fn jacobian<'a>(
        &self,
        q: &[f64],
        link: impl Into<OnLink<'a>>,
        reference: ReferenceFrame,
        out: &mut [f64],
    ) -> Result<(), Error> {
        let frame = self.on_link(&link.into())?;
        let q = &*self.tree_configuration("q", q)?;
        self.tree_columns(6, out, |out| kinematics::jacobian(self.model(), q, &frame, reference, out))?;
        self.check_result("jacobian", out)
    }

    /// The rate J' of [`Scene::jacobian`] along `qd`, (6 x nv) row by row, entry by entry as J is written in `reference`. O(depth), beside the zeros.
    ///
    /// J qdd + J' qd is the spatial acceleration in the frame itself and in the world, the classical one in the base's axes at the frame's origin.
    ///
    /// # Errors
    ///
    /// As [`Scene::placement`].
    pub fn jacobian_rate<'a>(
        &self,
        q: &[f64],
        qd: &[f64],
        link: impl Into<OnLink<'a>>,
        reference: ReferenceFrame,
        out: &mut [f64],
    ) -> Result<(), Error> {
        let frame = self.on_link(&link.into())?;
        let (q, qd) = (&*self.tree_configuration("q", q)?, &*self.tree_rates("qd", qd)?);
        self.tree_columns(6, out, |out| kinematics::jacobian_rate(self.model(), q, qd, &frame, reference, out))?;
        self.check_result("jacobian rate", out)
    }

    /// J' qd of [`Scene::jacobian_rate`], without J': the acceleration that rates alone give. O(depth).
    ///
    /// # Errors
    ///
    /// As [`Scene::placement`].
    pub fn jacobian_rate_product<'a>(
        &self,
        q: &[f64],
        qd: &[f64],
        link: impl Into<OnLink<'a>>,
        reference: ReferenceFrame,
    ) -> Result<SpatialVector<f64>, Error> {
        let product = self.frame_motion(q, qd, None, &link.into())?.rate_in(reference);
        self.check_result("jacobian rate product", product.as_slice())?;
        Ok(product)
    }

    /// The frame on its body, which the scene has.
    #[inline]
    fn on_link(&self, frame: &OnLink<'_>) -> Result<Frame<f64>, Error> {
        match frame {
            OnLink::Named(frame) => self.frame(frame),
            OnLink::Known(frame) => self.check_frame(frame).map(|()| *frame),
        }
    }

    /// Checks that a frame is on a body of the scene and that its placement is finite.
    #[inline]
    pub(crate) fn check_frame(&self, frame: &Frame<f64>) -> Result<(), Error> {
        let bodies = self.model().bodies.len();
        match frame.body {
            Some(body) if body >= bodies => {
                let expected = format!("one of the scene's {bodies}, or none");
                Err(Error::argument("body of the frame", body.to_string(), expected))
            }
            _ => {
                let RigidShift { rotation, lever } = &frame.placement;
                check_finite("placement of the frame", rotation.as_slice())?;
                check_finite("placement of the frame", lever.as_slice())
            }
        }
    }

    /// The motion of a frame, of checked arguments.
    fn frame_motion(
        &self,
        q: &[f64],
        qd: &[f64],
        qdd: Option<&[f64]>,
        frame: &OnLink<'_>,
    ) -> Result<FrameMotion<f64>, Error> {
        let frame = self.on_link(frame)?;
        let (q, qd) = (&*self.tree_configuration("q", q)?, &*self.tree_rates("qd", qd)?);
        let qdd = qdd.map(|qdd| self.tree_rates("qdd", qdd)).transpose()?;
        Ok(kinematics::frame_motion(self.model(), q, qd, qdd.as_deref(), &frame))
    }
}
