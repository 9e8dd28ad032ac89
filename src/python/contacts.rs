//! What touches planes of the world: a method of `SceneBuilder` that adds contacts, and those of `Scene` that tell of them.

use super::builder::{PySceneBuilder, optional_triple};
use super::cost::WORTH_DETACHING;
use super::interrupts::detached_checked;
use super::object::{Object, imported};
use super::output::{Array, from_numbers};
use super::scene::PyScene;
use crate::motion::ContactReport;
use crate::scene::Contact;
use pyo3::prelude::*;
use pyo3::types::PyTuple;

/// Numbers of one contact in a recorded row.
pub(super) const OF_CONTACT: usize = 11;

/// Rough time of one contact in one state, ns, for each body on its way to the base.
const CONTACT: usize = 20;

#[pymethods]
impl PySceneBuilder {
    /// Adds a contact: a sphere on a link, or a point of it, that does not go through a plane of the world. Simulation only.
    ///
    /// name: of the contact. link: the name of a link, which may come later. xyz: (3,), the sphere's centre in the link's frame, m. radius: m; 0: a
    /// point. normal: (3,), out of the ground, in the base frame, of any length, and offset: m: the plane is where the unit normal times y is offset.
    /// friction: Coulomb's coefficient mu, zero or more. restitution: from 0 (no rebound) to 1 (elastic). Two links do not touch each other, and
    /// nothing is searched: what may touch is what is named.
    ///
    /// Raises ShapeError or ArgumentError for arrays, naming the contact. build() raises SceneError, naming the contact, for a name used twice, a
    /// link that is not there or cannot move, a normal without direction, numbers that are out of range or not finite, and connections beside
    /// contacts.
    #[pyo3(signature = (name, link, *, friction, xyz=None, radius=0.0, normal=None, offset=0.0, restitution=0.0),
           text_signature = "($self, name, link, *, friction, xyz=(0, 0, 0), radius=0.0, normal=(0, 0, 1), offset=0.0, restitution=0.0)")]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn contact<'py>(
        mut slf: PyRefMut<'py, Self>,
        name: String,
        link: String,
        friction: f64,
        xyz: Option<&Object<'py>>,
        radius: f64,
        normal: Option<&Object<'py>>,
        offset: f64,
        restitution: f64,
    ) -> PyResult<PyRefMut<'py, Self>> {
        let of_contact = |argument: &str| format!("{argument} of contact {name:?}");
        let point = optional_triple(&of_contact("xyz"), xyz, [0.0; 3])?.into();
        let normal = optional_triple(&of_contact("normal"), normal, [0.0, 0.0, 1.0])?.into();
        let contact = Contact { name, link, point, radius, normal, offset, friction, restitution };
        slf.change(|builder| builder.contact(contact));
        Ok(slf)
    }
}

#[pymethods]
impl PyScene {
    /// Names of the contacts, in the order they were made: the last axis of contact_gaps, and the keys of Trajectory.contacts.
    #[getter]
    fn contact_names<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, self.scene.contacts().iter().map(|contact| &contact.name).collect::<Vec<_>>())
    }

    /// How far each contact is above its plane, (..., contacts), m; below zero where it is under it.
    ///
    /// q: (..., nq). errors: as in forward_dynamics. O(depth) each.
    ///
    /// Raises ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
    #[pyo3(signature = (q, *, errors="raise"))]
    fn contact_gaps<'py>(&self, py: Python<'py>, q: &Object<'py>, errors: &str) -> Array<'py> {
        let contacts = self.scene.contacts().len();
        let call = self.call([self.configuration("q", q)?], self.cost_of_contacts(), errors)?;
        call.array(py, &[contacts], |scene, _, [q], out| scene.contact_gaps(q, out))
    }

    /// The velocity of the point of each link that is nearest to its contact's plane, (..., contacts, 3), m/s, in the base frame.
    ///
    /// q: (..., nq); qd: (..., nv). errors: as in forward_dynamics. O(depth) each.
    ///
    /// Raises as contact_gaps.
    #[pyo3(signature = (q, qd, *, errors="raise"))]
    fn contact_velocities<'py>(&self, py: Python<'py>, q: &Object<'py>, qd: &Object<'py>, errors: &str) -> Array<'py> {
        let contacts = self.scene.contacts().len();
        let call = self.call(self.inputs([("q", q), ("qd", qd)])?, self.cost_of_contacts(), errors)?;
        call.array(py, &[contacts, 3], |scene, _, [q, qd], out| scene.contact_velocities(q, qd, out))
    }

    /// The same scene without the contacts, for what knows none.
    #[pyo3(signature = ())]
    fn without_contacts(&self, py: Python<'_>) -> PyResult<Self> {
        let make = || self.scene.without_contacts();
        Ok(Self::new(if self.size() < WORTH_DETACHING { make()? } else { detached_checked(py, make)? }))
    }
}

impl PyScene {
    fn cost_of_contacts(&self) -> usize {
        CONTACT.saturating_mul(self.size()).saturating_mul(self.scene.contacts().len())
    }
}

/// What steps told of the contacts of each state of a batch, (..., 8).
pub(super) fn reports<'py>(
    py: Python<'py>,
    batch: &[usize],
    of: impl Fn(usize) -> Option<ContactReport>,
) -> PyResult<Object<'py>> {
    let numbers = |of: ContactReport| {
        [
            of.residual,
            f64::from(u8::from(of.converged)),
            of.iterations,
            of.lost_in_impacts,
            of.lost_in_friction,
            of.expansion_kept,
            of.impulse_kept,
            of.depth,
        ]
    };
    let all: Vec<f64> = (0..batch.iter().product()).filter_map(of).flat_map(numbers).collect();
    from_numbers(py, &all, &[batch, &[8]].concat())
}

/// Recorded rows of contacts, (..., rows, contacts * 11), and what steps told, as a `ContactMotion`.
pub(super) fn contact_motion<'py>(
    scene: &Bound<'py, PyScene>,
    rows: Object<'py>,
    reports: Object<'py>,
) -> PyResult<Object<'py>> {
    let names = scene.get().contact_names(scene.py())?;
    imported!(scene.py(), "phipsi._motion", "contacts_of")?.call1((names, rows, reports))
}
