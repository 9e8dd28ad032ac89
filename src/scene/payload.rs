//! Modified inertias: a payload on a link, and links with other inertias.

use super::Scene;
use super::description::Inertial;
use super::shared::Shared;
use crate::algorithm::Arguments;
use crate::error::{Error, check_finite, check_length};
use crate::model::{Identity, StateModel};
use crate::spatial::inertial_parameters::{inertia, parameters};
use crate::spatial::{BodyInertia, RigidShift, Symmetric3};
use nalgebra::{Matrix3, Vector3};
use std::collections::HashMap;

impl Scene {
    /// The scene with a rigid body added to a link, given in the link frame; names and coordinates are unchanged.
    ///
    /// A payload on a link of the base does not affect the dynamics, because the base does not move.
    ///
    /// # Errors
    ///
    /// [`Error::Argument`] for an unknown link and for a mass that is negative or not finite; [`Error::NotFinite`] for
    /// other values (`com`, `inertia`); for a strict scene [`Error::Scene`] for a nonphysical inertia.
    pub fn with_payload(&self, link: &str, payload: &Inertial) -> Result<Self, Error> {
        self.link(link)?;
        check("", payload)?;
        let mut source = self.source().clone();
        if let Some(carrier) = source.links.iter_mut().find(|carrier| carrier.name == link) {
            carrier.inertial = Some(carrier.inertial.as_ref().map_or(*payload, |own| together(own, payload)));
        }
        source.build()
    }

    /// The scene with other inertias for some links. Links fixed to them keep their inertias.
    ///
    /// # Errors
    ///
    /// [`Error::Argument`] for an unknown link or a negative mass, and [`Error::NotFinite`], each naming the link.
    pub fn with_inertias(&self, inertias: &[(&str, Inertial)]) -> Result<Self, Error> {
        let mut source = self.source().clone();
        let places: HashMap<String, usize> =
            source.links.iter().enumerate().map(|(at, link)| (link.name.clone(), at)).collect();
        for (link, inertial) in inertias {
            let Some(&at) = places.get(*link) else {
                self.link(link)?;
                let expected = "the name of a link that the scene was built with";
                return Err(Error::argument("links", format!("{link:?}"), expected));
            };
            check(&format!(" of link {link:?}"), inertial)?;
            // A link without mass and inertia is a massless frame.
            let is_frame = inertial.mass == 0.0 && inertial.central.entries.iter().all(|&entry| entry == 0.0);
            source.links[at].inertial = (!is_frame).then_some(*inertial);
        }
        source.build()
    }

    /// Bodies and poses of the links that joints carry, in the order of the joints.
    pub(crate) fn links_of_joints(&self) -> impl ExactSizeIterator<Item = (usize, RigidShift<f64>)> {
        let tree = self.tree();
        tree.joints.iter().map(|joint| {
            let link = &tree.links[tree.link_index[&joint.child]];
            // A joint carries its link.
            (link.body.unwrap_or_default(), link.placement)
        })
    }

    /// Inertial parameters (m, m c, I about the origin) of each link that a joint carries with the links fixed to it,
    /// in its frame, (joints, 10); kg, kg m and kg m^2. The order of the ten is (m, m cx, m cy, m cz, Ixx, Ixy, Iyy,
    /// Ixz, Iyz, Izz).
    #[must_use]
    pub fn inertial_parameters(&self) -> Vec<f64> {
        let bodies = &self.tree().model.bodies;
        let of = |(body, placement): (usize, RigidShift<f64>)| {
            parameters(&bodies[body].inertia.to_parent(&placement.inverse()))
        };
        self.links_of_joints().flat_map(of).collect()
    }

    /// The scene with other inertial parameters, (joints, 10), in the order of [`Scene::inertial_parameters`]; links
    /// that are fixed to others become massless.
    ///
    /// # Errors
    ///
    /// A wrong length, values that are not finite, a negative mass or moment of inertia, a moment of mass without a
    /// mass, each naming the link; scenes whose bodies are not merged.
    pub fn with_inertial_parameters(&self, parameters: &[f64]) -> Result<Self, Error> {
        self.with_state_model(&StateModel { inertias: parameters, armature: &[] })
    }

    /// Checks inertial parameters of one state, (joints, 10), without a scene of them.
    pub(crate) fn check_inertias(&self, inertias: &[f64]) -> Result<(), Error> {
        let mut links = self.tree().joints.iter().zip(inertias.as_chunks::<10>().0);
        links.try_for_each(|(joint, numbers)| about_center(&joint.child, numbers).map(|_| ()))
    }

    /// Number of contacts and colliders, each with a coefficient of friction and one of restitution.
    pub(crate) fn contact_coefficients(&self) -> usize {
        self.source().contacts.len() + self.source().collisions.colliders.len()
    }

    /// The scene with other coefficients of friction and restitution of its contacts and then its colliders,
    /// (contacts + colliders) each; empty for those of the scene. Pairs of colliders with values of their own keep them.
    ///
    /// # Errors
    ///
    /// Wrong lengths, values that are not finite, a negative friction, a restitution outside of 0 to 1.
    pub fn with_contact_coefficients(&self, friction: &[f64], restitution: &[f64]) -> Result<Self, Error> {
        let mut source = self.source().clone();
        for (name, given) in [("contact_friction", friction), ("contact_restitution", restitution)] {
            if !given.is_empty() {
                check_length(name, given.len(), self.contact_coefficients())?;
            }
        }
        let contacts = source.contacts.iter_mut().map(|of| (&mut of.friction, &mut of.restitution));
        let colliders = source.collisions.colliders.iter_mut().map(|of| (&mut of.friction, &mut of.restitution));
        for (i, (of_friction, of_restitution)) in contacts.chain(colliders).enumerate() {
            *of_friction = friction.get(i).copied().unwrap_or(*of_friction);
            *of_restitution = restitution.get(i).copied().unwrap_or(*of_restitution);
        }
        source.build()
    }

    /// The scene of the model of a state, and the state without its model; `None` if it has the model of this scene.
    ///
    /// # Errors
    ///
    /// Those of [`Scene::with_state_model`].
    pub(crate) fn of_own_model<'a>(&self, state: &Arguments<'a>) -> Result<Option<(Self, Arguments<'a>)>, Error> {
        if state.model.is_of_scene() {
            return Ok(None);
        }
        let own = self.with_state_model(&state.model)?;
        Ok(Some((own, Arguments { model: StateModel::default(), ..*state })))
    }

    /// The scene with the model of one state of a batch: one scene per state, in place of states in lanes.
    ///
    /// # Errors
    ///
    /// Wrong lengths, values that are not finite, negative masses and armatures, mass moments without a mass; each
    /// names the link or the joint. Armatures of a scene with mimic joints, whose states have those of its tree.
    pub(crate) fn with_state_model(&self, state: &StateModel<'_>) -> Result<Self, Error> {
        let mut changed = self.clone();
        changed.identity = Identity::unique();
        // The source of a tree with rows of mimic joints is that of the scene of the independent joints.
        let is_tied = self.connections().is_empty() && !self.constraints().is_empty();
        let mut source = self.source().clone();
        if !state.inertias.is_empty() {
            let tree = self.tree();
            self.model.simplifications.check_every_body_moves("inertias")?;
            check_length("inertias", state.inertias.len(), 10 * tree.joints.len())?;
            check_finite("inertias", state.inertias)?;
            for link in &tree.links {
                // The links that are fixed to others are part of these.
                if link.body.is_some()
                    && let Some(description) = source.links.iter_mut().find(|of| of.name == link.name)
                {
                    description.inertial = None;
                }
            }
            for (joint, numbers) in tree.joints.iter().zip(state.inertias.as_chunks::<10>().0) {
                let inertial = about_center(&joint.child, numbers)?;
                if let Some(description) = source.links.iter_mut().find(|of| of.name == joint.child) {
                    description.inertial = Some(inertial);
                }
            }
        }
        if is_tied || !state.inertias.is_empty() {
            changed = source.build()?;
        }
        let coupling = changed.shared_coupling().filter(|_| is_tied);
        if let Some(coupling) = &coupling {
            changed = Self { identity: Identity::unique(), shared: Shared::default(), ..coupling.tied().clone() };
            changed.model.gravity = self.model.gravity;
        }
        if !state.armature.is_empty() {
            self.check_independent()?;
            self.check_armature(state.armature)?;
            changed.model.system.noise.copy_from_slice(state.armature);
            if let Some(coupling) = &coupling {
                coupling.give_armature(&mut changed.model.system.noise);
            }
            changed.model.identity = Identity::unique();
            changed.shared = Shared::default();
        }
        Ok(changed)
    }

    /// Checks the armature of one state.
    pub(crate) fn check_armature(&self, armature: &[f64]) -> Result<(), Error> {
        check_length("armature", armature.len(), self.nv())?;
        check_finite("armature", armature)?;
        let Some(row) = armature.iter().position(|&armature| armature < 0.0) else { return Ok(()) };
        let joint = self.joints.iter().find(|joint| joint.v.contains(&row));
        let name = joint.map_or("", |joint| &joint.name);
        let found = format!("{} for joint {name:?}", armature[row]);
        Err(Error::argument("armature", found, "values that are zero or positive"))
    }
}

/// Mass, center and central inertia from inertial parameters about the origin of a link.
fn about_center(link: &str, numbers: &[f64; 10]) -> Result<Inertial, Error> {
    let BodyInertia { mass, first_moment, rotational } = inertia(numbers);
    let least = rotational.entries[0].min(rotational.entries[3]).min(rotational.entries[5]);
    if mass < 0.0 || least < 0.0 {
        let found = format!("mass {mass} and a moment of inertia of {least} for link {link:?}");
        return Err(Error::argument("inertias", found, "masses and moments of inertia that are zero or positive"));
    }
    if mass == 0.0 && first_moment != Vector3::zeros() {
        let found = format!("a mass moment without a mass for link {link:?}");
        return Err(Error::argument("inertias", found, "m c = 0 for a link without mass"));
    }
    let center = if mass == 0.0 { first_moment } else { first_moment / mass };
    let moment = Matrix3::identity() * center.dot(&first_moment) - center * first_moment.transpose();
    let central = Symmetric3::from_upper(&(rotational.to_matrix() - moment));
    Ok(Inertial { mass, center, central })
}

/// Checks the numbers of a body; `of` is the end of their names in messages.
fn check(of: &str, Inertial { mass, center, central }: &Inertial) -> Result<(), Error> {
    if !(mass.is_finite() && *mass >= 0.0) {
        return Err(Error::argument(format!("mass{of}"), mass.to_string(), "a finite mass, zero or positive"));
    }
    check_finite(&format!("com{of}"), center.as_slice())?;
    check_finite(&format!("inertia{of}"), &central.entries)
}

/// Combines two rigid bodies. Uses the reduced mass at the distance of the two centers of mass, so that no terms cancel
/// for bodies far from the origin of the link frame.
fn together(one: &Inertial, other: &Inertial) -> Inertial {
    let mass = one.mass + other.mass;
    let central = one.central.add(&other.central);
    if mass == 0.0 {
        return Inertial { mass, center: one.center, central };
    }
    let apart = other.center - one.center;
    let share = other.mass / mass;
    let reduced = one.mass * share;
    let moment = (Matrix3::identity() * apart.norm_squared() - apart * apart.transpose()) * reduced;
    Inertial { mass, center: one.center + apart * share, central: central.add(&Symmetric3::from_upper(&moment)) }
}
