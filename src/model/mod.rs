//! The numerical model of a scene, which the recursions read, for any scalar type.

mod of_state;
pub mod simplifications;

pub use crate::joints::Motion;
pub use of_state::StateModel;
pub use simplifications::Simplifications;

use crate::filter::{Stage, System};
use crate::scalar::Real;
use crate::spatial::{BodyInertia, BodyRoot, RigidShift, Symmetric3};
use nalgebra::{Vector3, Vector6};
use std::sync::atomic::{AtomicU64, Ordering};

/// The identity of a model in this process. Scratch memory made for one model is rejected by every other. Copies have
/// the same identity, also in another scalar type; comparisons of models ignore it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Identity(u64);

impl Identity {
    /// A new identity, unique in this process.
    pub(crate) fn unique() -> Self {
        static MADE: AtomicU64 = AtomicU64::new(0);
        Self(MADE.fetch_add(1, Ordering::Relaxed))
    }

    /// Its number.
    pub(crate) fn number(self) -> u64 {
        self.0
    }
}

impl PartialEq for Identity {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

/// One moving body. Fixed joints are merged unless that is disabled, and a planar joint consists of three bodies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Body<T> {
    /// Pose of the body frame in the parent's body frame at zero configuration.
    pub tree: RigidShift<T>,
    /// Spatial inertia M(k) about the origin of the body frame.
    pub inertia: BodyInertia<T>,
    /// Sum of the absolute values of the terms of each diagonal entry of M(k), the scale of its rounding error.
    pub inertia_terms: Vector6<T>,
    /// The joint to the parent.
    pub motion: Motion<T>,
    /// Index in q of the first coordinate of the joint.
    pub q: usize,
}

/// The numerical model of a scene: bodies in order from base to tip, the measurement system, gravity.
#[derive(Debug, Clone, PartialEq)]
pub struct Model<T> {
    /// Bodies, parents before children, one per stage of the system.
    #[doc(hidden)]
    pub bodies: Vec<Body<T>>,
    /// Square root S with S S^T = M(k), from mass, center of mass and central inertia; `None` if the inertia is not
    /// positive definite.
    #[doc(hidden)]
    pub inertia_roots: Vec<Option<BodyRoot<T>>>,
    /// Tree structure, measurement rows, and armature as measurement noise.
    pub system: System<T>,
    /// Number of coordinates in q.
    pub nq: usize,
    /// Gravity in the base frame, m/s^2.
    pub gravity: Vector3<T>,
    /// Simplifications that calls apply.
    #[doc(hidden)]
    pub simplifications: Simplifications,
    pub(crate) identity: Identity,
}

impl<T: Real> Model<T> {
    /// A model without bodies.
    #[doc(hidden)]
    pub fn empty(gravity: Vector3<T>, simplifications: Simplifications) -> Self {
        let system = System { stages: Vec::new(), noise: Vec::new() };
        Self {
            bodies: Vec::new(),
            inertia_roots: Vec::new(),
            system,
            nq: 0,
            gravity,
            simplifications,
            identity: Identity::unique(),
        }
    }

    /// The identity of the model, which scratch memory made for it stores.
    pub(crate) fn identity(&self) -> u64 {
        self.identity.number()
    }

    /// Number of degrees of freedom.
    pub fn nv(&self) -> usize {
        self.system.rows()
    }

    /// Largest number of measurement rows on a path from the base to a tip.
    pub(crate) fn longest_path(&self) -> usize {
        let mut lengths: Vec<usize> = Vec::with_capacity(self.bodies.len());
        for stage in &self.system.stages {
            lengths.push(stage.parent.map_or(0, |parent| lengths[parent]) + stage.rows.count());
        }
        lengths.into_iter().max().unwrap_or(0)
    }

    /// Indices in q of the first entries of the quaternions of spherical and free joints.
    pub(crate) fn quaternions(&self) -> Vec<usize> {
        let of = |body: &Body<T>| body.motion.quaternion().map(|(place, _)| body.q + place);
        self.bodies.iter().filter_map(of).collect()
    }

    /// Appends a massless body and returns its index.
    #[doc(hidden)]
    pub fn push(&mut self, parent: Option<usize>, tree: RigidShift<T>, motion: Motion<T>, armature: T) -> usize {
        let rows = motion.rows();
        self.bodies.push(Body {
            tree,
            inertia: BodyInertia::zero(),
            inertia_terms: Vector6::from_element(T::zero()),
            motion,
            q: self.nq,
        });
        self.inertia_roots.push(Some(BodyRoot::zero()));
        self.system.stages.push(Stage { parent, rows, first_row: self.nv() });
        self.system.noise.extend(std::iter::repeat_n(armature, rows.count()));
        self.nq += motion.nq();
        self.bodies.len() - 1
    }
}

impl Model<f64> {
    /// The same model in another scalar type, exact if the type can represent the values.
    ///
    /// In a wider scalar type, rotations are made orthonormal to its precision, and inertias are recomputed from their
    /// square roots. Otherwise an inertia and its square root would differ by their f64 rounding errors, which is
    /// significant for a light body next to a heavy one.
    #[must_use]
    pub fn cast<U: Real>(&self) -> Model<U> {
        let scalar = U::from_f64;
        let is_wider = U::epsilon().lane(0) < f64::EPSILON;
        let vector = |v: &Vector3<f64>| Vector3::new(scalar(v[0]), scalar(v[1]), scalar(v[2]));
        let motion = |motion: &Motion<f64>| motion.cast(scalar);
        let roots: Vec<Option<BodyRoot<U>>> =
            self.inertia_roots.iter().map(|root| root.as_ref().map(BodyRoot::cast)).collect();
        Model {
            bodies: self
                .bodies
                .iter()
                .zip(&roots)
                .map(|(body, root)| Body {
                    tree: body.tree.cast(),
                    inertia: match root {
                        Some(root) if is_wider => root.inertia(),
                        _ => BodyInertia {
                            mass: scalar(body.inertia.mass),
                            first_moment: vector(&body.inertia.first_moment),
                            rotational: Symmetric3::new(body.inertia.rotational.entries.map(scalar)),
                        },
                    },
                    inertia_terms: body.inertia_terms.map(scalar),
                    motion: motion(&body.motion),
                    q: body.q,
                })
                .collect(),
            inertia_roots: roots,
            system: System {
                stages: self
                    .system
                    .stages
                    .iter()
                    .zip(&self.bodies)
                    .map(|(stage, body)| Stage {
                        parent: stage.parent,
                        rows: motion(&body.motion).rows(),
                        first_row: stage.first_row,
                    })
                    .collect(),
                noise: self.system.noise.iter().copied().map(scalar).collect(),
            },
            nq: self.nq,
            gravity: vector(&self.gravity),
            simplifications: self.simplifications,
            identity: self.identity,
        }
    }
}
