//! The numbers of a scene, ready for the sweeps: what the recursions read, in any scalar.

pub mod omissions;

pub use crate::joints::Motion;
pub use omissions::Omissions;

use crate::filter::{Stage, System};
use crate::scalar::Real;
use crate::spatial::{BodyInertia, BodyRoot, RigidShift, Symmetric3};
use nalgebra::{Vector3, Vector6};
use std::sync::atomic::{AtomicU64, Ordering};

/// The identity of a model in this process: scratch that was made for one model is refused by every other. Copies, also in another scalar, have the same
/// identity; comparisons of models ignore it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Identity(u64);

impl Identity {
    /// An identity that no model had before.
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

/// One moving body: fixed joints are merged unless asked not to be, a planar joint is three of these.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Body<T> {
    /// Shift from the body's frame at zero configuration to its parent's frame.
    pub tree: RigidShift<T>,
    /// M(k) about the body's frame.
    pub inertia: BodyInertia<T>,
    /// Absolute sum of the terms that form each diagonal entry of M(k): what its rounding is measured by.
    pub inertia_terms: Vector6<T>,
    /// The joint to the parent.
    pub motion: Motion<T>,
    /// Index of its first coordinate in q.
    pub q: usize,
}

/// The numbers of a scene: bodies from the base outward, the measurement system, gravity.
#[derive(Debug, Clone, PartialEq)]
pub struct Model<T> {
    /// Bodies, parents before children, one for each stage of the system.
    #[doc(hidden)]
    pub bodies: Vec<Body<T>>,
    /// S with S S^T = M(k), from mass, mass centre and central inertia; none where a body's inertia is not positive.
    #[doc(hidden)]
    pub inertia_roots: Vec<Option<BodyRoot<T>>>,
    /// Tree, measurement rows and armature (as measurement noise).
    pub system: System<T>,
    /// Number of coordinates in q.
    pub nq: usize,
    /// Gravity in the base frame, m/s^2.
    pub gravity: Vector3<T>,
    /// What calls leave out.
    #[doc(hidden)]
    pub omissions: Omissions,
    pub(crate) identity: Identity,
}

impl<T: Real> Model<T> {
    /// A model without bodies.
    #[doc(hidden)]
    pub fn empty(gravity: Vector3<T>, omissions: Omissions) -> Self {
        let system = System { stages: Vec::new(), noise: Vec::new() };
        Self {
            bodies: Vec::new(),
            inertia_roots: Vec::new(),
            system,
            nq: 0,
            gravity,
            omissions,
            identity: Identity::unique(),
        }
    }

    /// The identity of the model, which scratch that is made for it keeps.
    pub(crate) fn identity(&self) -> u64 {
        self.identity.number()
    }

    /// Number of degrees of freedom.
    pub fn nv(&self) -> usize {
        self.system.rows()
    }

    /// Number of rows on the longest path from the base.
    pub(crate) fn longest_path(&self) -> usize {
        let mut lengths: Vec<usize> = Vec::with_capacity(self.bodies.len());
        for stage in &self.system.stages {
            lengths.push(stage.parent.map_or(0, |parent| lengths[parent]) + stage.rows.count());
        }
        lengths.into_iter().max().unwrap_or(0)
    }

    /// Where the quaternions of spherical and free joints begin in q.
    pub(crate) fn quaternions(&self) -> Vec<usize> {
        let of = |body: &Body<T>| body.motion.quaternion().map(|(place, _)| body.q + place);
        self.bodies.iter().filter_map(of).collect()
    }

    /// Appends a massless body; gives its index.
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
    /// The same numbers, exactly where the scalar can hold them, in another scalar.
    ///
    /// In one of more digits rotations are orthonormal to these, and inertias are those of their roots: both are one body there, and not two that differ by the
    /// rounding of either, which a heavy body's light neighbors would notice.
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
            omissions: self.omissions,
            identity: self.identity,
        }
    }
}
