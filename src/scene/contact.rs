//! Contacts of points and spheres on links with planes of the world: user description and checks.

use super::Scene;
use super::contact_point::{ContactPoint, plane_axes};
use crate::error::{Error, number};
use crate::kinematics::{Frame, frame_motion};
use crate::setters::setters;
use crate::spatial::{angular, linear};
use nalgebra::Vector3;
use std::collections::HashSet;

/// Unilateral contact of a sphere or a point on a link with a plane of the world, with Coulomb friction.
///
/// There is no collision detection: only the contacts in the scene are active, and links do not contact each other.
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
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Contact {
    /// Name, unique among the contacts.
    pub name: String,
    /// Name of the link that carries the sphere.
    pub link: String,
    /// Center of the sphere in the link frame, m.
    pub point: Vector3<f64>,
    /// Radius of the sphere, m; zero for a point.
    pub radius: f64,
    /// Normal of the plane in the base frame, from the ground to the free side, of any length.
    pub normal: Vector3<f64>,
    /// Distance of the plane from the base origin along the normal, m.
    pub offset: f64,
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
        for (what, value) in [("radius", self.radius), ("friction", self.friction)] {
            if !(value.is_finite() && value >= 0.0) {
                return Err(self.fault(format!("{what} {}", number(value)), "a finite number, zero or positive"));
            }
        }
        if !(0.0..=1.0).contains(&self.restitution) {
            return Err(self.fault(format!("restitution {}", number(self.restitution)), "a number from 0 to 1"));
        }
        Ok(())
    }
}

impl Scene {
    /// The contacts, in order of creation.
    #[must_use]
    pub fn contacts(&self) -> &[Contact] {
        self.source().contacts()
    }

    /// The same scene without contacts.
    ///
    /// # Errors
    ///
    /// Those of [`SceneBuilder::build`](super::SceneBuilder::build), none of which this scene caused.
    pub fn without_contacts(&self) -> Result<Self, Error> {
        let mut source = self.source().clone();
        source.contacts.clear();
        source.build()
    }

    /// Adds the contacts to the scene of an assembled tree, after checking them.
    pub(super) fn touching(mut self) -> Result<Self, Error> {
        let contacts = self.source.contacts();
        let Some(first) = contacts.first() else { return Ok(self) };
        if let Some(connection) = self.source.connections().first() {
            let found = format!("a scene with connections (connection {:?})", connection.name);
            return Err(first.fault(found, "a scene without connections (both are not supported together)"));
        }
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

    /// Resolves a contact: index of its body, and position on it.
    pub(super) fn contact_point(&self, contact: &Contact) -> Result<ContactPoint, Error> {
        let Some(&at) = self.link_index.get(&contact.link) else {
            let found = format!("link {:?}, which does not exist", contact.link);
            return Err(contact.fault(found, self.source.known_links(&contact.link)));
        };
        let link = &self.links()[at];
        let axes = plane_axes(&(contact.normal / contact.normal.amax()).normalize());
        let (Some(body), Some(_)) = (link.body, self.carrier(link.body)) else {
            return Err(
                contact.fault(format!("link {:?}, which cannot move", contact.link), "a link that a joint moves")
            );
        };
        let stages = &self.model().system.stages;
        let point = ContactPoint {
            name: contact.name.clone(),
            body,
            center: link.placement.rotate(&contact.point) + link.placement.lever,
            radius: contact.radius,
            axes,
            offset: contact.offset,
            friction: contact.friction,
            restitution: contact.restitution,
            path: std::iter::successors(Some(body), |&k| stages[k].parent).collect(),
        };
        if !self.can_move(&point) {
            let found = format!("a point of link {:?} on the joint axis, which no joint moves", contact.link);
            return Err(contact.fault(found, "a point that a joint moves"));
        }
        Ok(point)
    }

    /// True if joint velocities can move the point of a contact, in some configuration.
    fn can_move(&self, point: &ContactPoint) -> bool {
        let (model, nv) = (self.model(), self.nv());
        #[allow(clippy::cast_precision_loss)] // an index of a few thousand at most
        let rates: Vec<f64> = (0..nv).map(|i| 0.5 + (i as f64 * 0.618).fract()).collect();
        let neutral = self.neutral();
        let mut other = neutral.clone();
        for (body, stage) in model.bodies.iter().zip(&model.system.stages) {
            body.motion.advance(&neutral[body.q..], &rates[stage.first_row..], &mut other[body.q..]);
        }
        let frame = Frame { body: Some(point.body), placement: crate::spatial::RigidShift::identity() };
        [neutral, other].iter().any(|q| {
            let motion = frame_motion(model, q, &rates, None, &frame);
            let arm = point.center - motion.placement.rotate_back(&point.normal()) * point.radius;
            let (turning, sliding) = (angular(&motion.velocity), linear(&motion.velocity));
            let speed = (sliding + turning.cross(&arm)).norm();
            speed > 1e-12 * (sliding.norm() + turning.norm() * arm.norm())
        })
    }
}
