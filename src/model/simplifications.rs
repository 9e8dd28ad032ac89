//! The switches for the simplifications of a scene.

use crate::error::Error;

/// Simplifications of the computations that a scene or a call does not need, one switch each.
///
/// All are on by default; [`SceneBuilder::simplifications`](crate::SceneBuilder::simplifications) turns them off. They
/// change results by rounding errors only.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(clippy::struct_excessive_bools)] // switches
pub struct Simplifications {
    /// Merge fixed joints: two links on a fixed joint form one body. If off, the child is a body without measurement
    /// rows.
    pub fixed_joints: bool,
    /// Remove links fixed to the base. If off, they form a body that cannot move.
    pub base_links: bool,
    /// Replace the constant rotation to the parent by a permutation of axes.
    ///
    /// Applies to a revolute joint along an axis of its parent frame, and to one whose constant rotation is about the
    /// joint axis: only the angle about the axis is applied. For a prismatic joint it applies to the transform of P
    /// only, and not in square-root form. Entries within 9e-16 of 0 and 1 are rounded to them, because pi/2 has no
    /// exact f64. If off, the rotation matrix is multiplied. Used for single states and vectorized batches by the
    /// algorithms that [`Scene::evaluate`](crate::Scene::evaluate) runs in covariance form, and by forward dynamics in
    /// square-root form.
    pub permuted_axes: bool,
    /// Replace the constant rotation at other revolute joints, and that of P at other prismatic joints, by up to two
    /// constant angles, accurate to 2e-15. Used by the algorithms listed for `permuted_axes`, which must be on.
    pub oblique_axes: bool,
    /// Skip velocities and velocity products in a call with zero joint velocities.
    pub zero_velocity: bool,
    /// Skip the bias in a call with zero joint velocities if gravity is zero; requires `zero_velocity`.
    pub zero_gravity: bool,
}

/// Access to one of the switches.
pub type Switch = fn(&mut Simplifications) -> &mut bool;

impl Simplifications {
    /// The switches with their names.
    pub const SWITCHES: &[(&'static str, Switch)] = &[
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
        Self::each(true)
    }

    /// Every switch off.
    #[must_use]
    pub const fn none() -> Self {
        Self::each(false)
    }

    const fn each(on: bool) -> Self {
        Self {
            fixed_joints: on,
            base_links: on,
            permuted_axes: on,
            oblique_axes: on,
            zero_velocity: on,
            zero_gravity: on,
        }
    }

    /// Every switch on except one.
    #[must_use]
    pub fn all_but(switch: Switch) -> Self {
        let mut simplifications = Self::all();
        *switch(&mut simplifications) = false;
        simplifications
    }

    /// True if every body moves. Operators and estimation require it, because their states belong to measurement rows.
    #[must_use]
    pub(crate) fn every_body_moves(self) -> bool {
        self.fixed_joints && self.base_links
    }

    /// Returns an error if the scene may contain a body without measurement rows.
    pub(crate) fn check_every_body_moves(self, what: &str) -> Result<(), Error> {
        if self.every_body_moves() {
            return Ok(());
        }
        let found = "a scene that keeps bodies which cannot move";
        let expected = "a scene built with the simplifications fixed_joints and base_links, so that every body moves";
        Err(Error::argument(what, found, expected))
    }
}

impl Default for Simplifications {
    fn default() -> Self {
        Self::all()
    }
}
