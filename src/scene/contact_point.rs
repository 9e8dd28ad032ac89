//! Contacts in the form that the sweeps read: spheres or rims on bodies, and surfaces on the base or on other bodies,
//! by index.

use crate::kinematics::{Frame, frame_motion, placement};
use crate::model::Model;
use crate::spatial::{RigidShift, angular, linear};
use nalgebra::{Matrix3, Vector3, Vector6};
use std::sync::Arc;

/// A sphere on a body, and the surface that it touches.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ContactPoint {
    /// Its name.
    pub name: Arc<str>,
    /// The body that carries the sphere.
    pub body: usize,
    /// Center of the sphere in the body frame, m.
    pub center: Vector3<f64>,
    /// Radius of the sphere, m; zero for a point.
    pub radius: f64,
    /// The axis of the rim of a disk in the body frame, which touches a plane instead of the sphere.
    pub rim: Option<Vector3<f64>>,
    /// Rows t1, t2, n in the base frame: n is the unit normal of the plane toward the free side, t1 and t2 are
    /// tangents. Those of another surface depend on the configuration, see [`ContactPoint::touch`]; these are then the
    /// axes in which impulses are stored.
    pub axes: Matrix3<f64>,
    /// The plane is n . y = offset, m.
    pub offset: f64,
    /// The surface, if it is not a plane of the base.
    pub other: Option<OtherSurface>,
    /// Coefficient of friction.
    pub friction: f64,
    /// Coefficient of restitution.
    pub restitution: f64,
    /// The bodies from both bodies of the contact to the base, each once, outermost first.
    pub path: Arc<[usize]>,
    /// True for a contact of shapes, which exists for one step.
    pub found: bool,
}

/// A surface on a body or on the base.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct OtherSurface {
    /// The body that carries it; `None` for the base.
    pub body: Option<usize>,
    /// Pose of the frame of the shape in the body frame.
    pub frame: RigidShift<f64>,
    pub shape: Shape,
}

/// A shape in its own frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Shape {
    /// The half space z <= 0.
    Plane,
    /// A sphere about the origin, by its radius, m.
    Sphere(f64),
    /// A box about the origin, by half of the lengths of its edges, with a rounding about it, m. A line is a box
    /// without width.
    Box(Vector3<f64>, f64),
}

/// A contact at one configuration, in the base frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Touch {
    /// Rows t1, t2, n.
    pub axes: Matrix3<f64>,
    /// Distance of the sphere from the surface, m; negative for penetration.
    pub gap: f64,
    /// The point of the sphere nearest to the surface, at which the force acts on both bodies.
    pub at: Vector3<f64>,
}

impl Touch {
    /// The unit normal of the surface.
    pub fn normal(&self) -> Vector3<f64> {
        self.axes.row(2).transpose()
    }
}

impl OtherSurface {
    /// Moves the surface outward.
    pub fn raise(&mut self, by: f64) {
        match &mut self.shape {
            Shape::Plane => self.frame.lever += self.frame.rotation.column(2) * by,
            Shape::Sphere(radius) | Shape::Box(_, radius) => *radius += by,
        }
    }
}

/// A sphere whose center is nearer to the surface of a box than this, relative to the size of the box, has the normal
/// of a face: the direction to the nearest point is then mostly rounding.
const ON_SURFACE: f64 = 1e-9;

impl ContactPoint {
    /// Unit normal of the plane, for a contact with a plane of the base.
    pub fn normal(&self) -> Vector3<f64> {
        self.axes.row(2).transpose()
    }

    /// The body of the other surface; `None` for the base.
    pub fn other_body(&self) -> Option<usize> {
        self.other.and_then(|other| other.body)
    }

    /// The contact for the poses of its body and of the body of the other surface in the base frame. The gap is NaN
    /// between spheres whose centers coincide, because they have no normal.
    pub fn touch(&self, place: &RigidShift<f64>, other: &RigidShift<f64>) -> Touch {
        let center = place.rotate(&self.center) + place.lever;
        let Some(surface) = &self.other else {
            let normal = self.normal();
            let (arm, height) = self.arm(Some(place), &normal);
            return Touch { axes: self.axes, gap: normal.dot(&center) - height - self.offset, at: center + arm };
        };
        let frame = other.compose(&surface.frame);
        let (normal, distance) = surface.shape.nearest(&frame.rotate_back(&(center - frame.lever)));
        let normal = frame.rotate(&normal);
        let (arm, height) = self.arm(Some(place), &normal);
        Touch { axes: plane_axes(&normal), gap: distance - height, at: center + arm }
    }

    /// The point that touches, from the center, and how far it is below, for the normal of the surface in the frame of
    /// the body or, with its pose, in the base frame.
    pub fn arm(&self, place: Option<&RigidShift<f64>>, normal: &Vector3<f64>) -> (Vector3<f64>, f64) {
        let Some(axis) = self.rim else { return (normal * -self.radius, self.radius) };
        let axis = place.map_or(axis, |place| place.rotate(&axis));
        let across = (normal - axis * axis.dot(normal)).normalize();
        (across * -self.radius, across.dot(normal) * self.radius)
    }

    /// Displacement of the point that touches on the body, for a change -x of the normal in the frame of the body.
    pub fn roll(&self, place: &RigidShift<f64>, normal: &Vector3<f64>, x: &Vector3<f64>) -> Vector3<f64> {
        let Some(axis) = self.rim else { return x * self.radius };
        let along = place.rotate(&axis).cross(normal);
        along * (along.dot(x) * self.radius / along.norm().powi(3))
    }

    /// Derivative of the normal, in the base frame, with respect to the position of the center of the sphere relative
    /// to the surface; zero for planes.
    pub fn bending(&self, place: &RigidShift<f64>, other: &RigidShift<f64>) -> Matrix3<f64> {
        let Some(surface) = &self.other else { return Matrix3::zeros() };
        let (center, frame) = (place.rotate(&self.center) + place.lever, other.compose(&surface.frame));
        let bending = surface.shape.bending(&frame.rotate_back(&(center - frame.lever)));
        frame.rotation * bending * frame.rotation.transpose()
    }

    /// True if the surface is a plane.
    pub fn is_plane(&self) -> bool {
        self.other.is_none_or(|other| other.shape == Shape::Plane)
    }

    /// True if a touch of a surface on a body with this pose is on a plane or on a face of a box.
    pub fn is_on_face(&self, touch: &Touch, other: &RigidShift<f64>) -> bool {
        let is_face = |surface: &OtherSurface| match surface.shape {
            Shape::Plane => true,
            Shape::Sphere(_) => false,
            Shape::Box(half, _) if half.amin() == 0.0 => false,
            Shape::Box(..) => other.compose(&surface.frame).rotate_back(&touch.normal()).amax() > 1.0 - 1e-12,
        };
        self.other.as_ref().is_none_or(is_face)
    }

    /// The contact at `q`. O(depth).
    pub fn touch_at(&self, model: &Model<f64>, q: &[f64]) -> Touch {
        let place = |body| placement(model, q, &frame_of(body));
        self.touch(&place(Some(self.body)), &place(self.other_body()))
    }

    /// Velocity of the material point of the link nearest to the surface, relative to the link of the surface, in the
    /// base frame, m/s, and the sum of the sizes of its terms. O(depth).
    pub fn velocity(&self, model: &Model<f64>, q: &[f64], qd: &[f64]) -> (Vector3<f64>, f64) {
        let motion = |body| frame_motion(model, q, qd, None, &frame_of(body));
        let (own, other) = (motion(Some(self.body)), self.other_body().map(|k| motion(Some(k))));
        let other = other.as_ref().map(|other| (&other.placement, &other.velocity));
        let (_, velocity, terms) = self.moving((&own.placement, &own.velocity), other);
        (velocity, terms)
    }

    /// The contact, and the two results of [`ContactPoint::velocity`], from the poses of its bodies in the base frame
    /// and their velocities in their own frames.
    pub fn moving(
        &self,
        own: (&RigidShift<f64>, &Vector6<f64>),
        other: Option<(&RigidShift<f64>, &Vector6<f64>)>,
    ) -> (Touch, Vector3<f64>, f64) {
        let place = other.map_or_else(RigidShift::identity, |other| *other.0);
        let touch = self.touch(own.0, &place);
        let arm = self.center + self.arm(None, &own.0.rotate_back(&touch.normal())).0;
        let (mut velocity, mut terms) = (Vector3::zeros(), 0.0);
        let arms = [(Some(own), arm, 1.0), (other, place.rotate_back(&(touch.at - place.lever)), -1.0)];
        for ((place, twist), arm, sign) in arms.into_iter().filter_map(|(body, arm, sign)| Some((body?, arm, sign))) {
            let (turning, sliding) = (angular(twist), linear(twist));
            velocity += place.rotate(&(sliding + turning.cross(&arm))) * sign;
            terms += sliding.norm() + turning.norm() * arm.norm();
        }
        (touch, velocity, terms)
    }
}

/// Rates of all joints, for the test whether they can move a point.
#[allow(clippy::cast_precision_loss)] // an index of a few thousand at most
pub(crate) fn probing_rates(nv: usize) -> Vec<f64> {
    (0..nv).map(|i| 0.5 + (i as f64 * 0.618).fract()).collect()
}

fn frame_of(body: Option<usize>) -> Frame<f64> {
    Frame { body, placement: RigidShift::identity() }
}

impl Shape {
    /// The vector to the point x from the nearest point of a box, and its length; `None` inside.
    fn beyond(half: &Vector3<f64>, x: &Vector3<f64>) -> Option<(Vector3<f64>, f64)> {
        let beyond = x - x.zip_map(half, |x, half| x.clamp(-half, half));
        let distance = beyond.norm();
        (distance > ON_SURFACE * half.amax()).then_some((beyond, distance))
    }

    /// Derivative of the normal with respect to the point x, in the frame of the shape: (P - n n*)/d for a distance d
    /// from the nearest point, where P has the coordinates of x that the nearest point does not share.
    fn bending(&self, x: &Vector3<f64>) -> Matrix3<f64> {
        let (offset, distance, apart) = match self {
            Self::Plane => return Matrix3::zeros(),
            Self::Sphere(_) => (*x, x.norm(), Vector3::repeat(1.0)),
            Self::Box(half, _) => match Self::beyond(half, x) {
                Some((beyond, distance)) => (beyond, distance, beyond.map(|beyond| f64::from(u8::from(beyond != 0.0)))),
                None => return Matrix3::zeros(),
            },
        };
        let normal = offset / distance;
        (Matrix3::from_diagonal(&apart) - normal * normal.transpose()) / distance
    }

    /// The unit normal of the surface toward the point x, and the signed distance of x from it, m, in the frame of the
    /// shape.
    fn nearest(&self, x: &Vector3<f64>) -> (Vector3<f64>, f64) {
        match self {
            Self::Plane => (Vector3::z(), x[2]),
            Self::Sphere(radius) => {
                let distance = x.norm();
                (x / distance, if distance > 0.0 { distance - radius } else { f64::NAN })
            }
            Self::Box(half, rounding) => {
                if let Some((beyond, distance)) = Self::beyond(half, x) {
                    return (beyond / distance, distance - rounding);
                }
                // Inside, the nearest face.
                let depths = x.zip_map(half, |x, half| x.abs() - half);
                let face = depths.imax();
                let mut normal = Vector3::zeros();
                normal[face] = 1.0_f64.copysign(x[face]);
                (normal, depths[face] - rounding)
            }
        }
    }
}

/// Rows t1, t2, n for the unit normal n of a plane: t1 = e x n / |e x n|, where e is the base axis least aligned with
/// n, and t2 = n x t1.
pub(crate) fn plane_axes(normal: &Vector3<f64>) -> Matrix3<f64> {
    let mut axis = Vector3::zeros();
    axis[normal.iamin()] = 1.0;
    let first = axis.cross(normal).normalize();
    Matrix3::from_rows(&[first.transpose(), normal.cross(&first).transpose(), normal.transpose()])
}

#[cfg(test)]
mod tests {
    use super::Shape;
    use nalgebra::Vector3;

    /// The distance from a box is that of the nearest of a dense grid of its points; inside, that of the nearest face.
    #[test]
    fn distances_from_a_box() {
        let half = Vector3::new(0.3, 0.2, 0.1);
        let shape = Shape::Box(half, 0.0);
        for (x, normal, distance) in [
            (Vector3::new(0.05, 0.0, 0.15), Vector3::z(), 0.05),
            (Vector3::new(0.05, 0.0, 0.1), Vector3::z(), 0.0),
            (Vector3::new(0.05, 0.0, -0.07), -Vector3::z(), -0.03),
            (Vector3::new(0.33, 0.24, 0.0), Vector3::new(0.6, 0.8, 0.0), 0.05),
            (Vector3::new(-0.31, -0.22, -0.12), -Vector3::new(1.0, 2.0, 2.0) / 3.0, 0.03),
        ] {
            let (n, d) = shape.nearest(&x);
            assert!((n - normal).amax() <= 1e-14 && (d - distance).abs() <= 1e-15, "{x}: {n} {d}");
        }
        // Just outside of an edge the normal is that of a face.
        let (n, _) = shape.nearest(&Vector3::new(0.3 + 1e-13, 0.2 + 2e-13, 0.0));
        assert!(n == Vector3::y());
        assert!(Shape::Sphere(0.1).nearest(&Vector3::zeros()).1.is_nan());
        assert!(Shape::Plane.nearest(&Vector3::new(1.0, 2.0, -3.0)) == (Vector3::z(), -3.0));
    }
}
