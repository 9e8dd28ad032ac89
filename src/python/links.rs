//! Methods of `Scene`: pose, velocity, acceleration and Jacobian of one link, in O(depth).

use super::choice::{choose, names};
use super::input::triple;
use super::keywords::Keywords;
use super::object::Object;
use super::scene::PyScene;
use crate::algorithm::KinematicQuantity;
use crate::error::{Error, check_finite};
use crate::kinematics::frame::{ACCELERATION_KINDS, REFERENCE_FRAMES};
use crate::kinematics::{AccelerationKind, Frame, ReferenceFrame};
use crate::memory;
use crate::spatial::RigidShift;
use nalgebra::Vector3;
use pyo3::prelude::*;
use pyo3::types::PyString;

typed_methods! {
    in PyScene;

    /// Pose of one link or of several (forward kinematics): homogeneous matrices from link to base frame.
    #[doc = parameters!(q)]
    /// link : str or sequence of str
    ///     Link name or L link names; links on the base and repeated names are allowed.
    #[doc = entries!(errors)]
    #[doc = section!(Returns)]
    /// pose : (..., 4, 4) or (..., L, 4, 4) ndarray
    ///     [[R, p], [0, 1]] with p in m; (..., L, 4, 4) for a sequence of names.
    #[doc = raises!(arguments)]
    #[doc = section!(Notes)]
    /// O(depth): only the joints between the base and these links are evaluated.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    /// >>> scene.placement(scene.neutral(), "flange")[:3, 3].round(3)
    /// array([0.412, 0.15 , 0.488])
    fn placement[&self, py: Python<'py>](
        q: &Object<'py>, link: &Object<'py>; errors: &str = "raise"
    ) -> PyResult<Object<'py>> {
        if let Ok(name) = link.cast::<PyString>() {
            let frame = Frame::from(self.scene.link(name.to_str()?)?);
            return self.kinematic_quantity(
                py,
                &KinematicQuantity::Placement(&frame),
                [q],
                &Keywords { errors, ..Keywords::none() },
            );
        }
        let names = names("link", link, "the name of a link, or a sequence of names")?;
        memory::room("link", memory::bytes_of::<f64>(&[names.len(), 16, 3]))?;
        let mut frames = Vec::with_capacity(names.len());
        for name in &names {
            frames.push(self.scene.frame(&name.as_str().into())?);
        }
        let cost = frames.iter().map(|frame| self.cost_of(&KinematicQuantity::Placement(frame))).sum();
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
}

methods! {
    /// Spatial velocity of a link relative to the base, (angular, linear): J qd.
    #[doc = parameters!(q qd link)]
    /// frame : {"local", "local-world-aligned", "world"}, default "local"
    ///     "local": velocity of the point `at`, in the axes of the link. "local-world-aligned": the same in the axes of
    ///     the base. "world": spatial velocity in the base frame, whose linear half is that of the point of the link
    ///     that coincides with the origin of the base; independent of `at`. They are Pinocchio's LOCAL,
    ///     LOCAL_WORLD_ALIGNED and WORLD, with the angular half first.
    #[doc = entries!(at errors)]
    #[doc = section!(Returns)]
    /// v : (..., 6) ndarray
    ///     (angular, linear), rad/s and m/s.
    #[doc = raises!(arguments)]
    #[doc = section!(Notes)]
    /// O(depth).
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> q, qd = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2]
    /// >>> np.allclose(scene.velocity(q, qd, "link2"), scene.jacobian(q, "link2") @ qd)
    /// True
    fn velocity(q, qd, link; frame, at, errors)
    => on_link(|frame, reference, _| KinematicQuantity::Velocity(frame, reference));

    /// Spatial acceleration of a link relative to the base, (angular, linear): J qdd + J' qd, without gravity.
    #[doc = parameters!(q qd qdd link frame at)]
    /// kind : {"spatial", "classical"}, default "spatial"
    ///     "spatial": time derivative of the spatial velocity, as in the Newton-Euler equations. "classical": the
    ///     linear half is the acceleration of the point, which adds w x v.
    #[doc = entries!(errors)]
    #[doc = section!(Returns)]
    /// a : (..., 6) ndarray
    ///     (angular, linear), rad/s^2 and m/s^2.
    #[doc = raises!(arguments)]
    #[doc = section!(Notes)]
    /// O(depth).
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> q, qd, qdd = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2], [0.0, 1.0, 0.0]
    /// >>> expected = scene.jacobian(q, "link2") @ qdd + scene.jacobian_rate_product(q, qd, "link2")
    /// >>> np.allclose(scene.acceleration(q, qd, qdd, "link2"), expected)
    /// True
    fn acceleration(q, qd, qdd, link; frame, at, kind, errors)
    => on_link(|frame, reference, kind| KinematicQuantity::Acceleration(frame, reference, kind));

    /// Geometric Jacobian J of a link: its spatial velocity (angular, linear) is J qd.
    #[doc = parameters!(q link frame at errors)]
    #[doc = section!(Returns)]
    /// J : (..., 6, nv) ndarray
    ///     Jacobian, SI units, angular rows first. Columns of joints that do not move the link are zero.
    #[doc = raises!(arguments)]
    #[doc = section!(Notes)]
    /// In frame "local", a wrench w = (moment, force) on the link at the point `at` causes the joint torques J^T w.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> J = scene.jacobian([0.3, 0.2, 0.1], "link2", frame="world")
    /// >>> np.allclose(J[:, 0], [0, 0, 1, 0, 0, 0])     # the first joint rotates about z of the base
    /// True
    fn jacobian(q, link; frame, at, errors)
    => on_link(|frame, reference, _| KinematicQuantity::Jacobian(frame, reference));

    /// Time derivative J' of the Jacobian of a link along qd, entry by entry in the given frame.
    #[doc = parameters!(q qd link frame at errors)]
    #[doc = section!(Returns)]
    /// dJ : (..., 6, nv) ndarray
    ///     Derivative of jacobian, SI units.
    #[doc = raises!(arguments)]
    #[doc = section!(Notes)]
    /// J qdd + J' qd is the spatial acceleration in the frames "local" and "world", and the classical acceleration in
    /// "local-world-aligned". jacobian_rate_product computes J' qd alone, in O(depth).
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> q, qd = np.array([0.3, 0.2, 0.1]), np.array([1.0, 0.5, 0.2])
    /// >>> ahead, behind = (scene.jacobian(q + h * qd, "link2") for h in (1e-6, -1e-6))
    /// >>> np.allclose(scene.jacobian_rate(q, qd, "link2"), (ahead - behind) / 2e-6)
    /// True
    fn jacobian_rate(q, qd, link; frame, at, errors)
    => on_link(|frame, reference, _| KinematicQuantity::JacobianRate(frame, reference));

    /// Acceleration J' qd of a link for zero joint accelerations, without forming J', in O(depth).
    #[doc = parameters!(q qd link frame at errors)]
    #[doc = section!(Returns)]
    /// a : (..., 6) ndarray
    ///     (angular, linear), rad/s^2 and m/s^2: spatial in the frames "local" and "world", classical in
    ///     "local-world-aligned".
    #[doc = raises!(arguments)]
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> q, qd = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2]
    /// >>> np.allclose(scene.jacobian_rate_product(q, qd, "link2"), scene.jacobian_rate(q, qd, "link2") @ qd)
    /// True
    fn jacobian_rate_product(q, qd, link; frame, at, errors)
    => on_link(|frame, reference, _| KinematicQuantity::JacobianRateProduct(frame, reference));

    /// Derivatives of the velocity of a link with respect to q and qd; the second is its Jacobian.
    #[doc = parameters!(q qd link frame at errors)]
    #[doc = section!(Returns)]
    /// dv : (..., 2, 6, nv) ndarray
    ///     dv/dq and dv/dqd of velocity, SI units, angular rows first.
    #[doc = raises!(arguments)]
    #[doc = section!(Notes)]
    /// O(depth). Derivatives with respect to q are along its tangent space, as those of the dynamics: column k is the
    /// change of v as q moves by integrate(q, e_k).
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> q, qd = np.array([0.3, 0.2, 0.1]), np.array([1.0, 0.5, 0.2])
    /// >>> by_q, by_qd = scene.velocity_derivatives(q, qd, "link2", frame="world")
    /// >>> np.allclose(by_qd, scene.jacobian(q, "link2", frame="world"))
    /// True
    /// >>> step = 1e-6 * np.array([0.0, 1.0, 0.0])
    /// >>> ahead, behind = (scene.velocity(q + h, qd, "link2", frame="world") for h in (step, -step))
    /// >>> np.allclose(by_q[:, 1], (ahead - behind) / 2e-6)
    /// True
    fn velocity_derivatives(q, qd, link; frame, at, errors)
    => on_link(|frame, reference, _| KinematicQuantity::VelocityDerivatives(frame, reference));

    /// Derivatives of the acceleration of a link with respect to q, qd and qdd; the third is its Jacobian.
    #[doc = parameters!(q qd qdd link frame at)]
    /// kind : {"spatial", "classical"}, default "spatial"
    ///     As in acceleration.
    #[doc = entries!(errors)]
    #[doc = section!(Returns)]
    /// da : (..., 3, 6, nv) ndarray
    ///     da/dq, da/dqd and da/dqdd of acceleration, SI units, angular rows first.
    #[doc = raises!(arguments)]
    #[doc = section!(Notes)]
    /// O(depth). Derivatives with respect to q are along its tangent space, as in velocity_derivatives.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> q, qd, qdd = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2], [0.0, 1.0, 0.0]
    /// >>> by_q, by_qd, by_qdd = scene.acceleration_derivatives(q, qd, qdd, "link2")
    /// >>> expected = scene.jacobian_rate(q, qd, "link2") + scene.velocity_derivatives(q, qd, "link2")[0]
    /// >>> np.allclose(by_qd, expected)
    /// True
    fn acceleration_derivatives(q, qd, qdd, link; frame, at, kind, errors)
    => on_link(|frame, reference, kind| KinematicQuantity::AccelerationDerivatives(frame, reference, kind));

    /// Derivatives of the Jacobian of a link with respect to q: its Hessian.
    #[doc = parameters!(q link frame at errors)]
    #[doc = section!(Returns)]
    /// dJ : (..., 6, nv, nv) ndarray
    ///     Entry [i, j, k] is the derivative of jacobian[i, j] along degree of freedom k, SI units.
    #[doc = raises!(arguments)]
    #[doc = section!(Notes)]
    /// O(depth^2). Derivatives are along the tangent space of q, as in velocity_derivatives; dJ @ qd is jacobian_rate,
    /// and np.einsum("ijk,j", dJ, qd) is the first of velocity_derivatives.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> q, qd = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2]
    /// >>> np.allclose(scene.jacobian_derivatives(q, "link2") @ qd, scene.jacobian_rate(q, qd, "link2"))
    /// True
    fn jacobian_derivatives(q, link; frame, at, errors)
    => on_link(|frame, reference, _| KinematicQuantity::JacobianDerivatives(frame, reference));
}

impl PyScene {
    /// A kinematic quantity of a link, of its frame translated to the point `at`; an unknown link is an error, even if
    /// the batch is empty.
    fn on_link<'py, const N: usize>(
        &self,
        py: Python<'py>,
        what: impl for<'a> Fn(&'a Frame<f64>, ReferenceFrame, AccelerationKind) -> KinematicQuantity<'a>,
        values: [&Object<'py>; N],
        keywords: &Keywords<'_, 'py>,
    ) -> PyResult<Object<'py>> {
        let reference = read_frame(keywords.frame)?;
        let mut frame = Frame::from(self.scene.link(keywords.link)?);
        if let Some(at) = keywords.at {
            let point = triple("at", at)?;
            check_finite("at", &point)?;
            frame.placement.lever += frame.placement.rotate(&Vector3::from(point));
        }
        let kind = choose("kind", keywords.kind, ACCELERATION_KINDS)?;
        self.kinematic_quantity(py, &what(&frame, reference, kind), values, keywords)
    }

    /// Number of bodies between the base and a frame, at least one, for the estimate of the time of a call.
    pub(super) fn depth(&self, frame: &Frame<f64>) -> usize {
        let stages = &self.scene.model().system.stages;
        std::iter::successors(frame.body, |&k| stages[k].parent).count().max(1)
    }
}

/// Reads the argument `frame`.
pub(super) fn read_frame(frame: &str) -> Result<ReferenceFrame, Error> {
    choose("frame", frame, REFERENCE_FRAMES)
}
