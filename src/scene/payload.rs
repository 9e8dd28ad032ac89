//! Other inertias: a load on a link, with the mass of the two together, and links with other numbers.

use super::Scene;
use super::description::Inertial;
use crate::error::{Error, check_finite};
use crate::spatial::Symmetric3;
use nalgebra::Matrix3;
use std::collections::HashMap;

impl Scene {
    /// The scene with a rigid body added to a link, given in the link's frame; names and coordinates stay.
    ///
    /// A link on the base carries it without effect on the dynamics, for the base does not move.
    ///
    /// # Errors
    ///
    /// [`Error::Argument`] for an unknown link and for a mass that is negative or not finite, [`Error::NotFinite`] for other numbers (`com`,
    /// `inertia`); with a strict scene [`Error::Scene`] for an inertia that no body can have.
    pub fn with_payload(&self, link: &str, payload: &Inertial) -> Result<Self, Error> {
        self.link(link)?;
        let Inertial { mass, center, central } = payload;
        if !(mass.is_finite() && *mass >= 0.0) {
            return Err(Error::argument("mass", mass.to_string(), "a finite mass, zero or positive"));
        }
        check_finite("com", center.as_slice())?;
        check_finite("inertia", &central.entries)?;
        let mut source = self.source().clone();
        if let Some(carrier) = source.links.iter_mut().find(|carrier| carrier.name == link) {
            carrier.inertial = Some(carrier.inertial.as_ref().map_or(*payload, |own| together(own, payload)));
        }
        source.build()
    }

    /// A new scene whose named links have other inertias; what is fixed onto them keeps its own.
    ///
    /// # Errors
    ///
    /// An unknown link, a mass that is negative, or numbers that are not finite, by the link's name.
    pub fn with_inertias(&self, inertias: &[(&str, Inertial)]) -> Result<Self, Error> {
        let mut source = self.source().clone();
        let places: HashMap<String, usize> =
            source.links.iter().enumerate().map(|(at, link)| (link.name.clone(), at)).collect();
        for (link, inertial) in inertias {
            let Some(&at) = places.get(*link) else {
                self.link(link)?;
                return Err(Error::argument(
                    "links",
                    format!("{link:?}"),
                    "the name of a link that the scene was built with",
                ));
            };
            let Inertial { mass, center, central } = inertial;
            if !(mass.is_finite() && *mass >= 0.0) {
                return Err(Error::argument(
                    format!("mass of link {link:?}"),
                    mass.to_string(),
                    "a finite mass, zero or positive",
                ));
            }
            check_finite(&format!("com of link {link:?}"), center.as_slice())?;
            check_finite(&format!("inertia of link {link:?}"), &central.entries)?;
            // Without mass and inertia it is a mere frame.
            let is_frame = *mass == 0.0 && central.entries.iter().all(|&entry| entry == 0.0);
            source.links[at].inertial = (!is_frame).then_some(*inertial);
        }
        source.build()
    }
}

/// Two bodies as one. The moment of two masses about their common center is that of the reduced mass at their distance, so that
/// nothing cancels however far from the link's frame they are.
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
