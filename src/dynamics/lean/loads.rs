//! What a body's motion asks of its force, where mass has been moved along joints' axes.
//!
//! A mass on the axis of a joint moves alike whether it is the body's that turns or its parent's, and what it needs has no moment about that axis. So of
//! the ten numbers of a body on a turn about z three can go to its parent: the mass m, the first moment h_z along the axis, and J_zz, J being the second
//! moment of the mass (I = tr J - J). These are all that a distribution of mass along the axis has, and they look the same at every angle. On the base they
//! are gone. The rest is (h_x, h_y) and five numbers of J. Every H phi b is what it was (1.5), whether b belongs to bodies as they are or as
//! they are here, and so are innovations and accelerations: both see b through H phi b alone. P is that of the bodies as they are, for what is left
//! here has no mass and is no covariance.

use super::body::Carrier;
use super::frames::Framed;
use crate::scalar::{DoubleDouble, Real};
use crate::scene::{Body, Model};
use crate::spatial::BodyInertia;
use nalgebra::{Matrix3, Vector3};

/// A body as its force sees it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Load<N> {
    /// Whether mass, h_z and J_zz are its parent's: then they are zero here, and I_zz - I_yy = I_xx, I_xx - I_zz = -I_yy.
    pub is_off_axis: bool,
    /// Mass, first moment, rotational inertia about the origin.
    pub mass: N,
    pub first_moment: [N; 3],
    pub rotational: [N; 6],
    /// I_zz - I_yy, I_xx - I_zz, I_yy - I_xx: what w x I w has of them.
    pub differences: [N; 3],
}

impl<N> Load<N> {
    /// Its numbers.
    pub fn numbers_mut(&mut self) -> impl Iterator<Item = &mut N> {
        let three = self.first_moment.iter_mut().chain(&mut self.differences);
        std::iter::once(&mut self.mass).chain(three).chain(&mut self.rotational)
    }

    /// The same with other numbers.
    pub fn map<M>(&self, number: impl Fn(f64) -> M) -> Load<M>
    where
        N: Copy + Into<f64>,
    {
        Load {
            is_off_axis: self.is_off_axis,
            mass: number(self.mass.into()),
            first_moment: self.first_moment.map(|x| number(x.into())),
            rotational: self.rotational.map(|x| number(x.into())),
            differences: self.differences.map(|x| number(x.into())),
        }
    }
}

/// Moments of the mass of a body, of order zero to two, with about twice the digits: sums of masses far apart are rounded once.
#[derive(Clone, Copy)]
struct Moments {
    mass: DoubleDouble,
    first: Vector3<DoubleDouble>,
    second: Matrix3<DoubleDouble>,
}

impl Moments {
    fn of(body: &Body<f64>) -> Self {
        let exact = |x: f64| DoubleDouble::from_f64(x);
        let half = exact(0.5);
        let [xx, xy, xz, yy, yz, zz] = body.inertia.rotational.entries.map(exact);
        let second = Matrix3::new(
            (yy + zz - xx) * half,
            -xy,
            -xz, //
            -xy,
            (zz + xx - yy) * half,
            -yz, //
            -xz,
            -yz,
            (xx + yy - zz) * half,
        );
        Self { mass: exact(body.inertia.mass), first: body.inertia.first_moment.map(exact), second }
    }

    /// Whether there is a mass like that: what is none would have to cancel again.
    fn is_of_a_mass(&self) -> bool {
        self.mass.high >= 0.0 && (0..3).all(|i| self.second[(i, i)].high >= 0.0)
    }

    /// Takes the mass along z away.
    fn take_axis(&mut self) -> [DoubleDouble; 3] {
        let o = DoubleDouble::from_f64(0.0);
        let of_axis = [self.mass, self.first[2], self.second[(2, 2)]];
        (self.mass, self.first[2], self.second[(2, 2)]) = (o, o, o);
        of_axis
    }

    /// Adds mass along an axis, given as above, that begins at `lever` and has this direction.
    fn add_axis(&mut self, [mass, first, second]: [DoubleDouble; 3], lever: &Vector3<f64>, along: usize) {
        let lever = lever.map(DoubleDouble::from_f64);
        self.mass += mass;
        for i in 0..3 {
            self.first[i] += mass * lever[i];
            self.second[(along, i)] += first * lever[i];
            self.second[(i, along)] += first * lever[i];
            for j in 0..3 {
                self.second[(i, j)] += mass * lever[i] * lever[j];
            }
        }
        self.first[along] += first;
        self.second[(along, along)] += second;
    }

    fn load(&self, is_off_axis: bool) -> Load<f64> {
        let [x, y, z] = [0, 1, 2].map(|i| self.second[(i, i)]);
        let [xy, xz, yz] = [(0, 1), (0, 2), (1, 2)].map(|at| -self.second[at].high);
        Load {
            is_off_axis,
            mass: self.mass.high,
            first_moment: self.first.map(|x| x.high).into(),
            rotational: [(y + z).high, xy, xz, (x + z).high, yz, (x + y).high],
            differences: [(y - z).high, (z - x).high, (x - y).high],
        }
    }
}

impl Load<f64> {
    /// Of a body as it is.
    fn of(body: &Body<f64>) -> Self {
        let BodyInertia { mass, first_moment, rotational } = &body.inertia;
        let [xx, _, _, yy, _, zz] = rotational.entries;
        Self {
            is_off_axis: false,
            mass: *mass,
            first_moment: (*first_moment).into(),
            rotational: rotational.entries,
            differences: [zz - yy, xx - zz, yy - xx],
        }
    }
}

/// The loads of these bodies, in their frames here; what can move does: from a body on a turn that has mass, to a parent that has, or to the base.
pub(super) fn loads(model: &Model<f64>, bodies: &[Body<f64>], carriers: &[Carrier]) -> Vec<Load<f64>> {
    let takes = |k: usize| !bodies[k].needs_no_force;
    // Of those that got some.
    let mut heavier: Vec<Option<Moments>> = vec![None; bodies.len()];
    let mut loads = Vec::with_capacity(bodies.len());
    for (k, stage) in model.system.stages.iter().enumerate().rev() {
        let mut moments = heavier[k].unwrap_or_else(|| Moments::of(&bodies[k]));
        let gives = model.omissions.axis_masses && takes(k) && stage.parent.is_none_or(takes) && moments.is_of_a_mass();
        match carriers[k] {
            Carrier::Turn(axis) if gives => {
                let of_axis = moments.take_axis();
                if let Some(parent) = stage.parent {
                    let outer = heavier[parent].get_or_insert_with(|| Moments::of(&bodies[parent]));
                    outer.add_axis(of_axis, &bodies[k].tree.lever, axis.index());
                }
                loads.push(moments.load(true));
            }
            _ if heavier[k].is_some() => loads.push(moments.load(false)),
            _ => loads.push(Load::of(&bodies[k])),
        }
    }
    loads.reverse();
    loads
}

/// How many bodies leave mass on their joint's axis to another.
pub(crate) fn bodies_off_axis(model: &Model<f64>) -> usize {
    Framed::of(model).loads.iter().filter(|load| load.is_off_axis).count()
}
