//! Contacts of a scene at one state.

use crate::dynamics::contacts;
use crate::error::{Error, check_length};
use crate::scene::Scene;

impl Scene {
    /// How far each contact is above its plane at `q`, into `out` (contacts), m; below zero where it is under it. O(depth) each.
    ///
    /// # Errors
    ///
    /// Wrong lengths, numbers that are not finite, quaternions that are not unit.
    pub fn contact_gaps(&self, q: &[f64], out: &mut [f64]) -> Result<(), Error> {
        self.check_configuration("q", q)?;
        check_length("out", out.len(), self.contact_points().len())?;
        contacts::gaps(self.model(), self.contact_points(), q, out);
        self.check_result("contact gaps", out)
    }

    /// The velocity of the point of each link that is nearest to its contact's plane, into `out` (contacts x 3), m/s, in the base frame. O(depth)
    /// each.
    ///
    /// # Errors
    ///
    /// As [`Scene::contact_gaps`].
    pub fn contact_velocities(&self, q: &[f64], qd: &[f64], out: &mut [f64]) -> Result<(), Error> {
        self.check_configuration("q", q)?;
        self.check_rates("qd", qd)?;
        check_length("out", out.len(), 3 * self.contact_points().len())?;
        for (point, out) in self.contact_points().iter().zip(out.chunks_exact_mut(3)) {
            out.copy_from_slice(contacts::velocity(self.model(), point, q, qd).as_slice());
        }
        self.check_result("contact velocities", out)
    }

    /// What knows no contacts is refused for scenes that have some.
    pub(crate) fn check_no_contacts(&self, what: &str) -> Result<(), Error> {
        if self.contact_points().is_empty() {
            return Ok(());
        }
        let names: Vec<String> = self.contacts().iter().take(8).map(|of| format!("{:?}", of.name)).collect();
        Err(Error::argument(
            what,
            format!("a scene with contacts ({})", names.join(", ")),
            "a scene without: scene.without_contacts() is the same one without them",
        ))
    }
}
