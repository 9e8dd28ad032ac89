//! Contacts: the method of `SceneBuilder` that adds them, and the methods of `Scene.contacts` that evaluate them.

use super::builder::{Added, PySceneBuilder, frame_of, optional_triple};
use super::choice::read_judged;
use super::errors::refuse;
use super::groups::PyContacts;
use super::keywords::Keywords;
use super::object::{Object, imported};
use super::output::{Names, from_numbers};
use super::scene::PyScene;
use crate::algorithm::Algorithm;
use crate::memory;
use crate::motion::{ContactReport, ShapeContact};
use crate::scene::{Contact, Surface};
use pyo3::prelude::*;
use pyo3::types::PyTuple;

/// Number of values per contact in a recorded row.
pub(super) const OF_CONTACT: usize = 11;

/// Number of values per contact of shapes.
const OF_SHAPE: usize = 17;

/// Approximate time per contact, state and body on its path to the base, ns.
const CONTACT: usize = 20;

typed_methods! {
    in PySceneBuilder;

    /// Add a contact of a sphere or a point on a link with a plane, sphere or box, with Coulomb friction.
    #[doc = section!(Parameters)]
    /// name : str
    ///     Name of the contact.
    /// link : str
    ///     Name of the link, which a joint moves. It may be added later.
    /// friction : float
    ///     Coefficient of Coulomb friction, not negative.
    /// xyz : (3,) array_like, default (0, 0, 0)
    ///     Center of the sphere in the link frame, m.
    /// radius : float, default 0
    ///     Radius, m; 0: a point.
    /// normal : (3,) array_like, default (0, 0, 1)
    ///     Outward normal of the plane in the second frame (by default the base frame), of any length.
    /// offset : float, default 0
    ///     Distance of the plane from the origin of that frame along the normal, m.
    /// restitution : float, default 0
    ///     Coefficient of restitution, from 0 (no rebound) to 1 (elastic).
    /// other : str, optional
    ///     Name of the link of the surface. None: the base.
    /// other_xyz : (3,) array_like, default (0, 0, 0)
    ///     Origin of the second frame in `other`, m.
    /// other_rpy : (3,) array_like, optional
    ///     Orientation of the second frame in `other`, rad, as in joint.
    /// other_rotation : (3, 3) array_like, optional
    ///     The same as a matrix, instead of other_rpy.
    /// other_radius : float, optional
    ///     The surface is a sphere of this radius about the origin of the second frame, m; 0: a point.
    /// other_size : (3,) array_like, optional
    ///     The surface is a box about the origin of the second frame: lengths of its edges, m, as in shapes.Box.
    #[doc = returns!(builder)]
    #[doc = section!(Raises)]
    /// ShapeError, ArgumentError
    ///     Invalid arrays, or arguments of more than one surface. The message names the contact.
    #[doc = section!(Notes)]
    /// Contacts act in simulations only. collider() adds shapes that touch all others. The normal of
    /// a sphere or box is the direction from its nearest point to the center of the sphere on `link`; for a center
    /// inside of a box, the normal of the nearest face. Forces are those on `link`. build() raises SceneError for
    /// duplicate names, links that are unknown or cannot move, two links that are rigidly attached to each other, a
    /// normal of length zero, and values out of range.
    #[doc = section!(Examples)]
    /// >>> builder = phipsi.SceneBuilder().link("ball", mass=1.0, inertia=0.004 * np.eye(3))
    /// >>> scene = builder.contact("foot", "ball", friction=0.5, radius=0.1).build(floating_base=True)
    /// >>> scene.contacts.gaps([0, 0, 0.3, 0, 0, 0, 1]).round(3)
    /// array([0.2])
    ///
    /// Two balls:
    ///
    /// >>> builder = phipsi.SceneBuilder().link("world")
    /// >>> for name in ("a", "b"):
    /// ...     builder = builder.link(name, mass=1.0, inertia=0.004 * np.eye(3)).joint(name, "floating", "world", name)
    /// >>> builder = builder.contact("balls", "a", friction=0.0, radius=0.1, other="b", other_radius=0.1)
    /// >>> builder.build().contacts.gaps([0, 0, 0.3, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 1]).round(3)
    /// array([0.1])
    fn contact[slf: PyRefMut<'py, Self>](
        name: String, link: String; friction: f64, xyz: Option<&Object<'py>> = None => "(0, 0, 0)", radius: f64 = 0.0,
        normal: Option<&Object<'py>> = None => "(0, 0, 1)", offset: f64 = 0.0, restitution: f64 = 0.0,
        other: Option<String> = None, other_xyz: Option<&Object<'py>> = None => "(0, 0, 0)",
        other_rpy: Option<&Object<'py>> = None, other_rotation: Option<&Object<'py>> = None,
        other_radius: Option<f64> = None, other_size: Option<&Object<'py>> = None
    ) -> Added<'py> {
        let of_contact = |argument: &str| format!("{argument} of contact {name:?}");
        let of_other = |argument: &str| format!("other_{argument} of contact {name:?}");
        let point = optional_triple(&of_contact("xyz"), xyz, [0.0; 3])?.into();
        let given = [normal.is_some() || offset != 0.0, other_radius.is_some(), other_size.is_some()];
        if given.iter().filter(|given| **given).count() > 1 {
            let expected = "one surface: normal and offset, or other_radius, or other_size";
            return refuse(of_contact("surface"), "arguments of several surfaces", expected);
        }
        let surface = match (other_radius, other_size) {
            (Some(radius), _) => Surface::Sphere { radius },
            (None, Some(_)) => Surface::Box { size: optional_triple(&of_other("size"), other_size, [0.0; 3])?.into() },
            (None, None) => Surface::Plane,
        };
        let normal = optional_triple(&of_contact("normal"), normal, [0.0, 0.0, 1.0])?.into();
        let other_frame = frame_of(&of_other, other_xyz, other_rpy, other_rotation)?;
        let contact =
            Contact { name, link, point, radius, normal, offset, other, other_frame, surface, friction, restitution };
        Ok(Self::with(slf, |builder| builder.contact(contact)))
    }
}

getters! {
    in PyContacts;

    /// Names of the contacts in the order of their creation, that of gaps and of Trajectory.contacts.
    names: Names<'py> = |of, py| PyTuple::new(py, of.as_scene().scene.contacts().iter().map(|contact| &contact.name));
}

methods! {
    in PyContacts;

    /// Distance of each contact from its surface; negative below the surface.
    #[doc = parameters!(q errors)]
    #[doc = section!(Returns)]
    /// gaps : (..., contacts) ndarray
    ///     Distance, m, in the order of names.
    #[doc = raises!(arguments)]
    #[doc = section!(Notes)]
    /// O(depth) per contact.
    #[doc = section!(Examples)]
    /// >>> builder = phipsi.SceneBuilder().link("ball", mass=1.0, inertia=0.004 * np.eye(3))
    /// >>> scene = builder.contact("foot", "ball", friction=0.5, radius=0.1).build(floating_base=True)
    /// >>> scene.contacts.gaps([[0, 0, 0.3, 0, 0, 0, 1], [0, 0, 0.05, 0, 0, 0, 1]]).round(3)
    /// array([[ 0.2 ],
    ///        [-0.05]])
    fn gaps(q; errors) |of, py| {
        let shape = [of.scene.contacts().len()];
        of.each(py, [("q", q)], &shape, of.cost_of_contacts(), errors, |scene, _, [q], out| scene.contact_gaps(q, out))
    }

    /// Velocity of each contact relative to its surface, at the point of the link nearest to it, in the base frame.
    #[doc = parameters!(q qd errors)]
    #[doc = section!(Returns)]
    /// v : (..., contacts, 3) ndarray
    ///     Velocity, m/s, in the order of names.
    #[doc = raises!(arguments)]
    #[doc = section!(Notes)]
    /// O(depth) per contact.
    #[doc = section!(Examples)]
    /// >>> builder = phipsi.SceneBuilder().link("ball", mass=1.0, inertia=0.004 * np.eye(3))
    /// >>> scene = builder.contact("foot", "ball", friction=0.5, radius=0.1).build(floating_base=True)
    /// >>> scene.contacts.velocities([0, 0, 0.1, 0, 0, 0, 1], [1, 0, 0, 0, 0, 0])
    /// array([[1., 0., 0.]])
    fn velocities(q, qd; errors) |of, py| {
        let (shape, given) = ([of.scene.contacts().len(), 3], [("q", q), ("qd", qd)]);
        of.each(py, given, &shape, of.cost_of_contacts(), errors, |scene, _, [q, qd], out| {
            scene.contact_velocities(q, qd, out)
        })
    }

    /// J M^-1 J^T of the points of all contacts: their velocities, in the base frame, due to unit impulses on them.
    #[doc = parameters!(q form tolerance models errors)]
    #[doc = section!(Returns)]
    /// gram : (..., contacts, 3, contacts, 3) ndarray
    ///     Velocity of contact i along axis a of the base frame due to a unit impulse on contact j along axis b, 1/kg,
    ///     in the order of names. Symmetric.
    #[doc = raises!(singular arguments)]
    #[doc = section!(Notes)]
    /// J qd are those of velocities. All contacts are included, open ones too. The factor of M and one right-hand side
    /// per row, O(m N + m^2 nv) for m rows. With connections M^-1 is loops.mass_matrix_inverse, with mimic joints that
    /// of the independent joints; then, and for contacts with other links, spheres or boxes, O(nv^2 (nv + m)).
    #[doc = section!(Examples)]
    /// >>> builder = phipsi.SceneBuilder().link("ball", mass=2.0, inertia=0.004 * np.eye(3))
    /// >>> scene = builder.contact("foot", "ball", friction=0.5, radius=0.1).build(floating_base=True)
    /// >>> scene.contacts.gram([0, 0, 0.1, 0, 0, 0, 1])[0, :, 0, :].round(3)
    /// array([[3. , 0. , 0. ],
    ///        [0. , 3. , 0. ],
    ///        [0. , 0. , 0.5]])
    fn gram(q; form, tolerance, inertias, armature, errors) |of, py, keywords| {
        let form = read_judged(&of.scene, (form, tolerance), Algorithm::MassMatrixInverse)?;
        let contacts = of.scene.contacts().len();
        memory::room("q", memory::bytes_of::<f64>(&[3 * contacts, 3 * contacts]))?;
        let cost = of.cost_of_contacts().saturating_add(of.size().saturating_mul(contacts).saturating_mul(200));
        let call = of.call_by([of.configuration("q", q)?], cost, keywords)?.with(of.errors(errors, Some(form))?);
        call.array(py, &[contacts, 3, contacts, 3], |scene, scratch, [q], out| {
            scratch.workspace.form = form;
            scene.contact_gram(&mut scratch.workspace, q, out)
        }).map(Bound::into_any)
    }
}

#[pymethods]
impl PyScene {
    /// Point of each contact at which its force acts, (..., contacts, 3), in the base frame, m.
    fn _contact_points<'py>(&self, py: Python<'py>, q: &Object<'py>) -> PyResult<Object<'py>> {
        let (shape, cost) = ([self.scene.contacts().len(), 3], self.cost_of_contacts());
        self.each(py, [("q", q)], &shape, cost, "raise", |scene, _, [q], out| scene.contact_positions(q, out))
    }

    /// Create the same scene without the contacts, for methods that do not support contacts.
    #[doc = section!(Returns)]
    /// scene : Scene
    ///     The scene without contacts.
    #[doc = section!(Examples)]
    /// >>> builder = phipsi.SceneBuilder().link("ball", mass=1.0, inertia=0.004 * np.eye(3))
    /// >>> scene = builder.contact("foot", "ball", friction=0.5).build(floating_base=True)
    /// >>> scene.without_contacts().contacts.names
    /// ()
    fn without_contacts(&self, py: Python<'_>) -> PyResult<Self> {
        self.derived(py, || self.scene.without_contacts())
    }
}

impl PyScene {
    fn cost_of_contacts(&self) -> usize {
        CONTACT.saturating_mul(self.size()).saturating_mul(self.scene.contacts().len())
    }
}

/// Reports of the steps about the contacts of each state of a batch, (..., 11).
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
            of.bias,
            of.hover,
            of.creep,
        ]
    };
    let all: Vec<f64> = (0..batch.iter().product()).filter_map(of).flat_map(numbers).collect();
    from_numbers(py, &all, &[batch, &[11]].concat())
}

/// Creates a `ContactMotion` from the recorded rows of contacts, (..., rows, contacts * 11), the reports of the steps,
/// and the contacts of shapes in every `every`th step.
pub(super) fn contact_motion<'py>(
    scene: &Bound<'py, PyScene>,
    (rows, reports): (Object<'py>, Object<'py>),
    (shapes, every): (&[ShapeContact], usize),
) -> PyResult<Object<'py>> {
    let (py, of) = (scene.py(), scene.get());
    let contacts = of.scene.contacts().iter().map(|contact| &contact.name);
    let names = (PyTuple::new(py, contacts.collect::<Vec<_>>())?, of.collider_names(py)?);
    let recorded: Vec<&ShapeContact> = shapes.iter().filter(|of| of.step % every == 0).collect();
    #[allow(clippy::cast_precision_loss)] // indices
    let numbers = recorded.iter().flat_map(|of| {
        let indices = [of.state, of.step / every, of.colliders[0], of.colliders[1]].map(|i| i as f64);
        let vectors = [of.point, of.normal, of.force, of.impulse].map(<[f64; 3]>::from);
        indices.into_iter().chain([of.gap]).chain(vectors.into_iter().flatten())
    });
    let numbers: Vec<f64> = numbers.collect();
    let shapes = from_numbers(py, &numbers, &[recorded.len(), OF_SHAPE])?;
    imported!(py, "phipsi._motion", "contacts_of")?.call1((names, rows, reports, shapes))
}
