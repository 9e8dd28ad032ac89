//! Whether a scene is planar, and its numbers if it is.

use crate::filter::pivots::Scale;
use crate::model::{Body, Model, Motion};
use crate::scalar::Real;
use nalgebra::{Matrix3, Vector3};

/// How far, in any entry, a body's frame may be from what a plane asks of it, seen from its parent's frame.
///
/// 16 units of rounding at 1. A tree rotation is a product of up to four (roll, pitch and yaw, merged fixed joints, the axis turned onto
/// z), each entry of which is off by a unit or two; cos(pi/2) is 6e-17. An axis that is off by more is not in the plane, and is not put
/// there.
pub const TOLERANCE: f64 = 16.0 * f64::EPSILON;

/// How a planar body moves against its parent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Direction<T> {
    /// About the normal, or against it where `reversed`; its frame is parallel to the parent's at q = 0.
    Turns {
        /// Whether the joint's axis points against the normal.
        reversed: bool,
    },
    /// Along the x axis of its frame, which has this cosine and sine in the parent's.
    Slides {
        /// Of the angle between the two frames.
        cosine: T,
        /// Of the same angle.
        sine: T,
    },
}

/// One moving body in the plane; its joint has one coordinate and one row, both with the body's index.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlanarBody<T> {
    /// The body that carries it; none on the base.
    pub parent: Option<usize>,
    /// The joint.
    pub direction: Direction<T>,
    /// Where its origin is at q = 0, in the parent's frame, m.
    pub lever: [T; 2],
    /// kg.
    pub mass: T,
    /// Mass times the centre of mass, kg m.
    pub first_moment: [T; 2],
    /// Inertia about the normal through the body's origin, kg m^2.
    pub inertia: T,
    /// r, kg m^2 or kg.
    pub armature: T,
    /// Whether r = 0.
    pub is_noise_free: bool,
    /// The bound on the terms of M(k).
    pub scale: Scale<T>,
    /// x, y and the normal of the planar frame, in the frame of the model's body: rows.
    pub frame: [[T; 3]; 3],
}

/// The numbers of a planar scene.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanarModel<T> {
    /// As many as the model has, in the same order.
    pub bodies: Vec<PlanarBody<T>>,
    /// Gravity's component in the plane, m/s^2.
    pub gravity: [T; 2],
}

impl<T: Real> PlanarBody<T> {
    /// Whether the joint turns.
    #[inline(always)]
    #[must_use]
    pub fn turns(&self) -> bool {
        matches!(self.direction, Direction::Turns { .. })
    }

    /// Whether the joint counts against the normal.
    #[inline(always)]
    #[must_use]
    pub fn is_reversed(&self) -> bool {
        matches!(self.direction, Direction::Turns { reversed: true })
    }

    /// A coordinate, rate, acceleration or torque of the joint, counted along the normal (or back).
    #[inline(always)]
    #[must_use]
    pub fn along(&self, x: T) -> T {
        if self.is_reversed() { -x } else { x }
    }
}

impl PlanarModel<f64> {
    /// The scene in its plane; none where it has none: a floating base, bodies that do not move, spherical, screw or free joints, axes that
    /// are further than [`TOLERANCE`] from parallel to the normal (turning) or across it (sliding).
    #[must_use]
    pub fn of(model: &Model<f64>) -> Option<Self> {
        if !model.omissions.planar || model.bodies.is_empty() {
            return None;
        }
        let base = base_frame(model)?;
        let mut frames: Vec<Matrix3<f64>> = Vec::with_capacity(model.bodies.len());
        let mut bodies = Vec::with_capacity(model.bodies.len());
        for (k, (body, stage)) in model.bodies.iter().zip(&model.system.stages).enumerate() {
            let parent = stage.parent.map_or(&base, |parent| &frames[parent]);
            let (direction, frame) = frame_on(body, parent)?;
            // Nothing is carried across planes but along them; levers across do not matter.
            let lever = parent.tr_mul(&body.tree.lever);
            let first_moment = frame.tr_mul(&body.inertia.first_moment);
            let normal = frame.column(2);
            bodies.push(PlanarBody {
                parent: stage.parent,
                direction,
                lever: [lever[0], lever[1]],
                mass: body.inertia.mass,
                first_moment: [first_moment[0], first_moment[1]],
                inertia: (normal.transpose() * body.inertia.rotational.to_matrix() * normal)[(0, 0)],
                armature: model.system.noise[k],
                is_noise_free: model.system.is_noise_free(k),
                scale: Scale::of_noise(&body.inertia_terms),
                frame: std::array::from_fn(|i| std::array::from_fn(|j| frame[(j, i)])),
            });
            frames.push(frame);
        }
        let gravity = base.tr_mul(&model.gravity);
        Some(Self { bodies, gravity: [gravity[0], gravity[1]] })
    }

    /// The same numbers in another scalar.
    #[must_use]
    pub fn cast<U: Real>(&self) -> PlanarModel<U> {
        let scalar = U::from_f64;
        let body = |body: &PlanarBody<f64>| PlanarBody {
            parent: body.parent,
            direction: match body.direction {
                Direction::Turns { reversed } => Direction::Turns { reversed },
                Direction::Slides { cosine, sine } => Direction::Slides { cosine: scalar(cosine), sine: scalar(sine) },
            },
            lever: body.lever.map(scalar),
            mass: scalar(body.mass),
            first_moment: body.first_moment.map(scalar),
            inertia: scalar(body.inertia),
            armature: scalar(body.armature),
            is_noise_free: body.is_noise_free,
            scale: Scale { angular: scalar(body.scale.angular), linear: scalar(body.scale.linear) },
            frame: body.frame.map(|row| row.map(scalar)),
        };
        PlanarModel { bodies: self.bodies.iter().map(body).collect(), gravity: self.gravity.map(scalar) }
    }
}

/// x, y and the normal as columns, for a normal of unit length; exact where that is a coordinate axis.
fn frame_of(normal: &Vector3<f64>) -> Matrix3<f64> {
    // The coordinate axis furthest from the normal gives x by projection.
    let helper = Vector3::ith(normal.iamin(), 1.0);
    let x = (helper - normal * normal.dot(&helper)).normalize();
    Matrix3::from_columns(&[x, normal.cross(&x), *normal])
}

/// The plane's frame seen from the base's; none where a joint is of a kind that has no plane.
fn base_frame(model: &Model<f64>) -> Option<Matrix3<f64>> {
    let mut rotations: Vec<Matrix3<f64>> = Vec::with_capacity(model.bodies.len());
    let mut slides: Vec<Vector3<f64>> = Vec::new();
    let mut turning = None;
    for (body, stage) in model.bodies.iter().zip(&model.system.stages) {
        let rotation = match stage.parent {
            Some(parent) => rotations[parent] * body.tree.rotation,
            None => body.tree.rotation,
        };
        let axis: Vector3<f64> = rotation.column(2).into();
        match body.motion {
            Motion::Revolute => turning = turning.or(Some(axis)),
            Motion::Prismatic => slides.push(axis),
            _ => return None,
        }
        rotations.push(rotation);
    }
    let across = || {
        let first = slides[0];
        let crosses = slides.iter().map(|slide| first.cross(slide));
        let widest = crosses.max_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared())).unwrap_or_default();
        // Parallel slides are in many planes.
        if widest.norm() > TOLERANCE { widest } else { frame_of(&first.normalize()).column(0).into() }
    };
    Some(frame_of(&turning.unwrap_or_else(across).normalize()))
}

/// A body's planar frame, as columns in the body's own frame, from its parent's; none where the joint leaves the plane.
fn frame_on(body: &Body<f64>, parent: &Matrix3<f64>) -> Option<(Direction<f64>, Matrix3<f64>)> {
    let to_parent = &body.tree.rotation;
    // The parent's x, y and normal in the body's frame.
    let seen = to_parent.tr_mul(parent);
    let z = Vector3::z();
    let column = |j: usize| -> Vector3<f64> { seen.column(j).into() };
    // `turn` carries the body's planar frame to the parent's.
    let (direction, frame, turn) = if body.motion == Motion::Revolute {
        let reversed = column(2)[2] < 0.0;
        let normal = if reversed { -z } else { z };
        let x = Vector3::new(column(0)[0], column(0)[1], 0.0).normalize();
        let frame = Matrix3::from_columns(&[x, normal.cross(&x), normal]);
        (Direction::Turns { reversed }, frame, Matrix3::identity())
    } else {
        let normal = Vector3::new(column(2)[0], column(2)[1], 0.0).normalize();
        let frame = Matrix3::from_columns(&[z, normal.cross(&z), normal]);
        let (x, y) = (column(0)[2], column(1)[2]);
        let size = x.hypot(y);
        let (cosine, sine) = (x / size, y / size);
        let turn = Matrix3::new(cosine, -sine, 0.0, sine, cosine, 0.0, 0.0, 0.0, 1.0);
        (Direction::Slides { cosine, sine }, frame, turn)
    };
    let off = (to_parent * frame - parent * turn).amax();
    (off <= TOLERANCE).then_some((direction, frame))
}
