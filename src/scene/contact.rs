//! Contacts of points and spheres on links with planes, spheres and boxes: user description and checks.

use super::Scene;
use super::collider::{ColliderRules, check_values};
use super::connection::frame_fault;
use super::contact_point::{ContactPoint, OtherSurface, Shape, plane_axes, probing_rates};
use crate::error::{Error, number};
use crate::kinematics::manifold::advance;
use crate::setters::setters;
use crate::spatial::RigidShift;
use nalgebra::Vector3;
use std::collections::HashSet;

/// The surface that the sphere of a contact touches.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub enum Surface {
    /// The plane of [`Contact::normal`] and [`Contact::offset`].
    #[default]
    Plane,
    /// A sphere about the origin of [`Contact::other_frame`].
    Sphere {
        /// Radius, m; zero for a point.
        radius: f64,
    },
    /// A box about the origin of [`Contact::other_frame`]. The normal is the direction from the nearest point of the
    /// box to the center of the sphere; for a center inside the box, that of the nearest face.
    Box {
        /// Lengths of the edges along the axes of the frame, m.
        size: Vector3<f64>,
    },
}

/// Unilateral contact of a sphere or a point on a link with a surface of the world or of another link, with Coulomb
/// friction.
///
/// The force acts on both links at the point of the sphere that is nearest to the surface. Shapes that touch each other
/// without names of their contacts are [`Collider`](super::Collider)s.
///
/// ```
/// use phipsi::scene::Contact;
/// # fn main() -> Result<(), phipsi::Error> {
/// // The tip of a chain of three rods above a table 0.8 m below the base.
/// let tip = Contact::new("tip", "link2").with_point([0.0, 0.0, 0.3]).with_offset(-0.8).with_friction(0.5);
/// let scene = phipsi::scenes::chain(3)?.source().clone().contact(tip).build()?;
/// let mut gap = [f64::NAN];
/// scene.contact_gaps(&scene.neutral(), &mut gap)?;
/// assert!(gap[0] > 0.0);
///
/// // A point beside the tip, and a box of 0.2 m on the first rod.
/// use phipsi::scene::Surface;
/// let size = [0.2; 3].into();
/// let pair = Contact::new("pair", "link2").with_point([0.05, 0.0, 0.3]).with_other("link0".to_owned());
/// let pair = pair.with_surface(Surface::Box { size });
/// let scene = phipsi::scenes::chain(3)?.source().clone().contact(pair).build()?;
/// scene.contact_gaps(&scene.neutral(), &mut gap)?;
/// // The nearest point of the box is on an edge.
/// assert!((gap[0] - 0.5_f64.hypot(0.2)).abs() < 1e-12);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Contact {
    /// Name, unique among the contacts.
    pub name: String,
    /// Name of the link that carries the sphere, which a joint moves.
    pub link: String,
    /// Center of the sphere in the link frame, m.
    pub point: Vector3<f64>,
    /// Radius of the sphere, m; zero for a point.
    pub radius: f64,
    /// Normal of the plane in [`Contact::other_frame`] (the base frame by default), from the ground to the free side,
    /// of any length.
    pub normal: Vector3<f64>,
    /// Distance of the plane from the origin of that frame along the normal, m.
    pub offset: f64,
    /// Name of the link that carries the surface; `None` for the base.
    pub other: Option<String>,
    /// Pose of the frame of the surface in the frame of that link, or in the base frame.
    pub other_frame: RigidShift<f64>,
    /// The surface.
    pub surface: Surface,
    /// Coefficient of friction mu, zero or positive: |tangential force| <= mu * normal force.
    pub friction: f64,
    /// Coefficient of restitution, from 0 (perfectly inelastic) to 1 (elastic).
    pub restitution: f64,
}

setters!(Contact {
    with_name: name => String,
    with_link: link => String,
    with_point: point => Vector3<f64>,
    with_radius: radius: f64,
    with_normal: normal => Vector3<f64>,
    with_offset: offset: f64,
    with_other: other => Option<String>,
    with_other_frame: other_frame: RigidShift<f64>,
    with_surface: surface: Surface,
    with_friction: friction: f64,
    with_restitution: restitution: f64,
});

impl Contact {
    /// A contact of the link origin with the plane z = 0, without friction and restitution.
    pub fn new(name: impl Into<String>, link: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            link: link.into(),
            point: Vector3::zeros(),
            radius: 0.0,
            normal: Vector3::z(),
            offset: 0.0,
            other: None,
            other_frame: RigidShift::identity(),
            surface: Surface::Plane,
            friction: 0.0,
            restitution: 0.0,
        }
    }

    fn fault(&self, found: impl Into<String>, expected: impl Into<String>) -> Error {
        Error::scene(format!("contact {:?}", self.name), found, expected)
    }

    /// Checks the values of the contact.
    fn check_numbers(&self) -> Result<(), Error> {
        let finite = |x: &Vector3<f64>| x.iter().all(|x| x.is_finite());
        if !finite(&self.point) {
            return Err(self.fault(format!("point {:?}", self.point.as_slice()), "finite numbers, m"));
        }
        if !(finite(&self.normal) && self.normal.amax() > 0.0) {
            let found = format!("normal {:?}", self.normal.as_slice());
            return Err(self.fault(found, "finite numbers, not all zero"));
        }
        if !self.offset.is_finite() {
            return Err(self.fault(format!("offset {}", number(self.offset)), "a finite number, m"));
        }
        if !(self.radius.is_finite() && self.radius >= 0.0) {
            return Err(self.fault(format!("radius {}", number(self.radius)), "a finite number, zero or positive"));
        }
        check_values(&format!("contact {:?}", self.name), Some(self.friction), Some(self.restitution))?;
        match self.surface {
            Surface::Sphere { radius } if !(radius.is_finite() && radius >= 0.0) => {
                let expected = "a finite number, zero or positive";
                return Err(self.fault(format!("radius {} of the other sphere", number(radius)), expected));
            }
            Surface::Box { size } if !size.iter().all(|x| x.is_finite() && *x > 0.0) => {
                let found = format!("size {:?} of the box", size.as_slice());
                return Err(self.fault(found, "three finite positive lengths, m"));
            }
            _ => {}
        }
        let Some((found, expected)) = frame_fault(&self.other_frame) else { return Ok(()) };
        Err(self.fault(format!("a second frame {found}"), expected))
    }

    /// The unit normal of the plane in [`Contact::other_frame`].
    pub(crate) fn unit_normal(&self) -> Vector3<f64> {
        (self.normal / self.normal.amax()).normalize()
    }

    /// The surface, unless it is a plane of the base, with its frame in the frame of its link.
    fn other_surface(&self) -> Option<(RigidShift<f64>, Shape)> {
        let shape = match self.surface {
            Surface::Plane if self.other.is_none() => return None,
            Surface::Plane => {
                let normal = self.unit_normal();
                let plane = RigidShift { rotation: plane_axes(&normal).transpose(), lever: normal * self.offset };
                return Some((self.other_frame.compose(&plane), Shape::Plane));
            }
            Surface::Sphere { radius } => Shape::Sphere(radius),
            Surface::Box { size } => Shape::Box(size * 0.5, 0.0),
        };
        Some((self.other_frame, shape))
    }
}

impl Scene {
    /// The contacts, in order of creation.
    #[must_use]
    pub fn contacts(&self) -> &[Contact] {
        self.source().contacts()
    }

    /// The same scene without contacts and colliders.
    ///
    /// # Errors
    ///
    /// Those of [`SceneBuilder::build`](super::SceneBuilder::build), none of which this scene caused.
    pub fn without_contacts(&self) -> Result<Self, Error> {
        let mut source = self.source().clone();
        source.contacts.clear();
        source.collisions = ColliderRules::default();
        source.build()
    }

    /// Adds the contacts to the scene of an assembled tree, after checking them.
    pub(super) fn touching(mut self) -> Result<Self, Error> {
        let contacts = self.source.contacts();
        let mut names = HashSet::new();
        let mut points = Vec::with_capacity(contacts.len());
        for contact in contacts {
            if !names.insert(contact.name.as_str()) {
                return Err(contact.fault("a duplicate name", "unique names of contacts"));
            }
            contact.check_numbers()?;
            points.push(self.contact_point(contact)?);
        }
        self.contact_points = points;
        Ok(self)
    }

    /// Resolves a contact: indices of its bodies, and positions on them.
    pub(super) fn contact_point(&self, contact: &Contact) -> Result<ContactPoint, Error> {
        let find = |name: &String| self.link_of(|| format!("contact {:?}", contact.name), name);
        let link = find(&contact.link)?;
        let other = contact.other.as_ref().map(find).transpose()?;
        let (Some(body), Some(carrier)) = (link.body, self.carrier(link.body)) else {
            let found = format!("link {:?}, which cannot move", contact.link);
            return Err(contact.fault(found, "a link that a joint moves"));
        };
        if let Some(other) = other
            && self.carrier(other.body) == Some(carrier)
        {
            let found =
                format!("links {:?} and {:?}, which are rigidly attached to each other", contact.link, other.name);
            return Err(contact.fault(found, "two links that can move against each other"));
        }
        let other_surface = contact.other_surface().map(|(frame, shape)| {
            let frame = other.map_or(frame, |other| other.placement.compose(&frame));
            OtherSurface { body: other.and_then(|other| other.body), frame, shape }
        });
        let normal = contact.other_frame.rotate(&contact.unit_normal());
        let point = ContactPoint {
            name: contact.name.as_str().into(),
            body,
            center: link.placement.rotate(&contact.point) + link.placement.lever,
            radius: contact.radius,
            rim: None,
            axes: plane_axes(&normal),
            offset: contact.offset + normal.dot(&contact.other_frame.lever),
            other: other_surface,
            friction: contact.friction,
            restitution: contact.restitution,
            path: self.inward_from([Some(body), other.and_then(|other| other.body)]).into(),
            found: false,
        };
        if !self.can_move(&point) {
            let found = format!("a point of link {:?} on the joint axis, which no joint moves", contact.link);
            return Err(contact.fault(found, "a point that a joint moves"));
        }
        Ok(point)
    }

    /// True if joint velocities can move the point of a contact relative to its surface, in some configuration.
    fn can_move(&self, point: &ContactPoint) -> bool {
        let (model, rates) = (self.model(), probing_rates(self.nv()));
        let neutral = self.neutral();
        let mut other = neutral.clone();
        advance(model, &neutral, &rates, &mut other);
        [neutral, other].iter().any(|q| {
            let (velocity, terms) = point.velocity(model, q, &rates);
            velocity.norm() > 1e-12 * terms
        })
    }
}
