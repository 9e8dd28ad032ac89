//! Modified inertias: a payload on a link, and links with other inertias.

use super::Scene;
use super::description::Inertial;
use crate::error::{Error, check_finite};
use crate::spatial::Symmetric3;
use nalgebra::Matrix3;
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
