//! A load on a link: a new scene with the mass of the two together.

use super::Scene;
use super::description::Inertial;
use crate::error::{Error, check_finite};
use crate::spatial::Symmetric3;
use nalgebra::Matrix3;

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
        let Inertial { mass, centre, central } = payload;
        if !(mass.is_finite() && *mass >= 0.0) {
            return Err(Error::argument("mass", mass.to_string(), "a finite mass, zero or positive"));
        }
        check_finite("com", centre.as_slice())?;
        check_finite("inertia", &central.entries)?;
        let mut source = self.source().clone();
        if let Some(carrier) = source.links.iter_mut().find(|carrier| carrier.name == link) {
            carrier.inertial = Some(carrier.inertial.as_ref().map_or(*payload, |own| together(own, payload)));
        }
        source.build()
    }
}

/// Two bodies as one. The moment of two masses about their common centre is that of the reduced mass at their distance, so that
/// nothing cancels however far from the link's frame they are.
fn together(one: &Inertial, other: &Inertial) -> Inertial {
    let mass = one.mass + other.mass;
    let central = one.central.add(&other.central);
    if mass == 0.0 {
        return Inertial { mass, centre: one.centre, central };
    }
    let apart = other.centre - one.centre;
    let share = other.mass / mass;
    let reduced = one.mass * share;
    let moment = (Matrix3::identity() * apart.norm_squared() - apart * apart.transpose()) * reduced;
    Inertial { mass, centre: one.centre + apart * share, central: central.add(&Symmetric3::from_upper(&moment)) }
}
