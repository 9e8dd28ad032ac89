//! What a scene leaves out, switch by switch.

use crate::error::Error;

/// The switches: what is left out wherever a scene or a call does not need it. All are on unless one is turned off, by
/// [`SceneBuilder::simplifications`](crate::SceneBuilder::simplifications); results are the same to rounding either way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(clippy::struct_excessive_bools)] // switches
pub struct Simplifications {
    /// Fixed joints: two links on one are one body. Off, the child is a body of its own, without measurement rows.
    pub fixed_joints: bool,
    /// Links on the base. Off, they are a body that cannot move.
    pub base_links: bool,
    /// The rotation of the tree at a joint that turns about an axis of its parent's frame, where it only renames the axes (the identity is one) or
    /// turns about the joint's own: the angle alone is carried. To rounding: entries within 9e-16 of 0 and 1 are taken for
    /// them, for a right angle has no double. Of a body that slides along such an axis P alone, by the constant, and not in square-root form. Off, a rotation matrix. For one state and lanes, in the algorithms that [`Scene::evaluate`](crate::Scene::evaluate) runs in covariance form, and forward dynamics in square-root form.
    pub permuted_axes: bool,
    /// The rotation of the tree at any other joint that turns, and of P at any other that slides: up to two constant angles more take its place. To rounding, as above (2e-15).
    /// In the same algorithms, and only where `permuted_axes` is on.
    pub oblique_axes: bool,
    /// Velocities, and what they cause, in a call whose rates are all zero.
    pub zero_velocity: bool,
    /// The whole bias, in a call whose rates are all zero in a scene without gravity; needs `zero_velocity`.
    pub zero_gravity: bool,
}

/// One of the switches.
pub type Switch = fn(&mut Simplifications) -> &mut bool;

impl Simplifications {
    /// The switches by name.
    pub const SWITCHES: [(&'static str, Switch); 6] = [
        ("fixed_joints", |of| &mut of.fixed_joints),
        ("base_links", |of| &mut of.base_links),
        ("permuted_axes", |of| &mut of.permuted_axes),
        ("oblique_axes", |of| &mut of.oblique_axes),
        ("zero_velocity", |of| &mut of.zero_velocity),
        ("zero_gravity", |of| &mut of.zero_gravity),
    ];

    /// Every switch on.
    #[must_use]
    pub const fn all() -> Self {
        Self {
            fixed_joints: true,
            base_links: true,
            permuted_axes: true,
            oblique_axes: true,
            zero_velocity: true,
            zero_gravity: true,
        }
    }

    /// Every switch off.
    #[must_use]
    pub const fn none() -> Self {
        Self {
            fixed_joints: false,
            base_links: false,
            permuted_axes: false,
            oblique_axes: false,
            zero_velocity: false,
            zero_gravity: false,
        }
    }

    /// All but one.
    #[must_use]
    pub fn all_but(switch: Switch) -> Self {
        let mut simplifications = Self::all();
        *switch(&mut simplifications) = false;
        simplifications
    }

    /// Whether every body moves: what the operators and the estimation count on, whose states belong to measurement rows.
    #[must_use]
    pub(crate) fn every_body_moves(self) -> bool {
        self.fixed_joints && self.base_links
    }

    /// An error where a body of the scene may have no measurement row.
    pub(crate) fn check_every_body_moves(self, what: &str) -> Result<(), Error> {
        if self.every_body_moves() {
            return Ok(());
        }
        let found = "a scene that keeps bodies which cannot move";
        Err(Error::argument(what, found, "fixed_joints and base_links left out: a state belongs to a row of H"))
    }
}

impl Default for Simplifications {
    fn default() -> Self {
        Self::all()
    }
}
