//! What a body's motion asks of its force, where mass has been moved along joints' axes.
//!
//! A mass on the axis of a joint moves alike whether it is the body's that turns or its parent's, and what it needs has no moment about that axis. So of
//! the ten numbers of a body on a turn about z three can go to its parent: the mass m, the first moment `h_z` along the axis, and `J_zz`, J being the second
//! moment of the mass (I = tr J - J). These are all that a distribution of mass along the axis has, and they look the same at every angle. On the base they
//! are gone. The rest is (`h_x`, `h_y`) and five numbers of J. Every H phi b is what it was (1.5), whether b belongs to bodies as they are or as
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
    /// Whether mass, `h_z` and `J_zz` are its parent's: then they are zero here, and `I_zz` - `I_yy` is `I_xx`, `I_xx` - `I_zz` is -`I_yy`.
    pub is_off_axis: bool,
    /// Mass, first moment, rotational inertia about the origin.
    pub mass: N,
    pub first_moment: [N; 3],
    pub rotational: [N; 6],
    /// `I_zz` - `I_yy`, `I_xx` - `I_zz`, `I_yy` - `I_xx`: what w x I w has of them.
    pub differences: [N; 3],
}

impl<N> Load<N> {
    /// Its numbers.
    #[cfg(target_arch = "x86_64")]
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
            -xz,
            -xy,
            (zz + xx - yy) * half,
            -yz,
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
    fn add_axis(&mut self, [mass, first, second]: [DoubleDouble; 3], lever: &Vector3<f64>, along: &Vector3<f64>) {
        let (lever, along) = (lever.map(DoubleDouble::from_f64), along.map(DoubleDouble::from_f64));
        self.mass += mass;
        for i in 0..3 {
            self.first[i] += mass * lever[i] + first * along[i];
            for j in 0..3 {
                let across = along[i] * lever[j] + along[j] * lever[i];
                self.second[(i, j)] += mass * lever[i] * lever[j] + first * across + second * along[i] * along[j];
            }
        }
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
    pub fn of(body: &Body<f64>) -> Self {
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
            Carrier::Turn(_) if gives => {
                let of_axis = moments.take_axis();
                if let Some(parent) = stage.parent {
                    let outer = heavier[parent].get_or_insert_with(|| Moments::of(&bodies[parent]));
                    let tree = &bodies[k].tree;
                    outer.add_axis(of_axis, &tree.lever, &tree.rotation.column(2).into());
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

#[cfg(test)]
mod tests {
    use super::{Carrier, Framed, Load, bodies_off_axis};
    use crate::scene::{Inertial, JointDescription, JointKind, LinkDescription, Omissions, Scene, SceneBuilder};
    use crate::spatial::{BodyInertia, RigidShift, Symmetric3};
    use nalgebra::{Rotation3, Vector3};

    fn inertial(mass: f64, squares: [f64; 3]) -> Inertial {
        let [x, y, z] = squares;
        let central = Symmetric3::new([y + z, 0.02, -0.01, x + z, 0.03, x + y]);
        Inertial { mass, centre: [0.1, -0.2, 0.3].into(), central }
    }

    /// A slide, and on it turns about x, -y, z and a tilted axis: of two links each, the second on the first.
    fn tree(masses: [Option<f64>; 7], squares: [f64; 3], omissions: Omissions) -> Scene {
        let mut builder =
            SceneBuilder::new().omissions(omissions).link(LinkDescription { name: "base".into(), inertial: None });
        let joints = [
            (JointKind::Prismatic, "base", Vector3::x()),
            (JointKind::Revolute, "0", Vector3::x()),
            (JointKind::Revolute, "1", -Vector3::y()),
            (JointKind::Revolute, "0", Vector3::new(0.48, -0.6, 0.64)),
            (JointKind::Revolute, "3", Vector3::z()),
            (JointKind::Revolute, "base", Vector3::z()),
            (JointKind::Revolute, "5", Vector3::x()),
        ];
        for (k, ((kind, parent, axis), mass)) in joints.into_iter().zip(masses).enumerate() {
            let mut joint = JointDescription::new(format!("joint{k}"), kind, parent, format!("{k}"));
            joint.axis = axis;
            joint.origin.lever = [0.5, 0.2, -0.4].into();
            let inertial = mass.map(|mass| inertial(mass, squares));
            builder = builder.link(LinkDescription { name: format!("{k}"), inertial }).joint(joint);
        }
        builder.build().expect("a tree")
    }

    const SQUARES: [f64; 3] = [0.3, 0.2, 0.5];
    const ONES: [Option<f64>; 7] = [Some(1.0); 7];

    fn of(load: &Load<f64>) -> BodyInertia<f64> {
        BodyInertia {
            mass: load.mass,
            first_moment: load.first_moment.into(),
            rotational: Symmetric3::new(load.rotational),
        }
    }

    fn numbers(inertia: &BodyInertia<f64>) -> Vec<f64> {
        let three: [f64; 3] = inertia.first_moment.into();
        [&[inertia.mass], &three[..], &inertia.rotational.entries].concat()
    }

    /// At every angle of the joints the bodies on a base that is free to move are together what they were.
    #[test]
    fn all_of_a_tree_is_the_same_at_every_angle() {
        let scene = tree(ONES, SQUARES, Omissions::all());
        let framed = Framed::of(scene.model());
        for angle in [0.0, 0.7, -2.1] {
            let total = |inertia_of: &dyn Fn(usize) -> BodyInertia<f64>| {
                let mut sums: Vec<_> = (0..framed.bodies.len()).map(inertia_of).collect();
                for k in (1..5).rev() {
                    let body = &framed.bodies[k];
                    let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), angle).into_inner();
                    let shift = RigidShift { rotation: body.tree.rotation * turn, lever: body.tree.lever };
                    let parent = scene.model().system.stages[k].parent.expect("the slide's");
                    sums[parent] = sums[parent].add(&sums[k].to_parent(&shift));
                }
                numbers(&sums[0])
            };
            let (here, there) = (total(&|k| of(&framed.loads[k])), total(&|k| framed.bodies[k].inertia));
            for (here, there) in here.iter().zip(&there) {
                assert!((here - there).abs() <= 32.0 * f64::EPSILON * 5.0, "{here} {there} at {angle}");
            }
        }
        let is_off_axis = |load: &Load<f64>| {
            let [xx, _, _, yy, _, _] = load.rotational;
            let [x, y, _] = load.differences;
            let are_zero = [load.mass, load.first_moment[2], x - xx, y + yy].iter().all(|&x| x == 0.0);
            load.is_off_axis && are_zero
        };
        assert!(framed.loads[1..].iter().all(is_off_axis) && !framed.loads[0].is_off_axis);
        assert_eq!(bodies_off_axis(scene.model()), 6);
        assert!(framed.carriers.iter().skip(1).all(|carrier| matches!(carrier, Carrier::Turn(_))));
        assert!((framed.loads[0].mass - 5.0).abs() < 1e-15, "the slide has all, but what turns on the base");
    }

    /// Mass stays with a body that is on one without mass, that no body can be, or where nothing is to be left out.
    #[test]
    fn what_cannot_move_stays() {
        let as_they_are = |scene: &Scene, bodies: &[usize]| {
            let framed = Framed::of(scene.model());
            bodies.iter().all(|&k| of(&framed.loads[k]) == framed.bodies[k].inertia && !framed.loads[k].is_off_axis)
        };
        let all = Omissions::all();
        let mut masses = ONES;
        masses[1] = None;
        let scene = tree(masses, SQUARES, all);
        assert!(as_they_are(&scene, &[2]) && !as_they_are(&scene, &[4]));
        assert!(as_they_are(&tree(ONES, [0.3, 0.2, -0.5], all), &[0, 1, 2, 3, 4, 5, 6]));
        let off = Omissions { axis_masses: false, ..all };
        assert!(as_they_are(&tree(ONES, SQUARES, off), &[0, 1, 2, 3, 4, 5, 6]));
        let off = Omissions { renamed_axes: false, ..all };
        assert!(as_they_are(&tree(ONES, SQUARES, off), &[0, 1, 2, 3, 4, 5, 6]));
    }

    /// Sums are rounded once: where what is heavy cancels, as of a tip whose mass centre is at a light body's origin, what is light is left.
    #[test]
    fn a_heavy_tip_takes_no_digits_from_a_light_body() {
        let heavy = Inertial { mass: 2.0_f64.powi(46), centre: [0.0, -0.25, 0.0].into(), ..inertial(1.0, SQUARES) };
        let mut builder = SceneBuilder::new().link(LinkDescription { name: "base".into(), inertial: None });
        for (k, (parent, axis, inertial)) in
            [("base", Vector3::x(), inertial(1e-3, SQUARES)), ("0", -Vector3::y(), heavy)].into_iter().enumerate()
        {
            let mut joint = JointDescription::new(format!("joint{k}"), JointKind::Revolute, parent, format!("{k}"));
            joint.axis = axis;
            joint.origin.lever = [0.0, 0.25, 0.0].into();
            builder = builder.link(LinkDescription { name: format!("{k}"), inertial: Some(inertial) }).joint(joint);
        }
        let framed = Framed::of(builder.build().expect("two turns").model());
        let (load, own) = (&framed.loads[0], &framed.bodies[0].inertia.first_moment);
        for i in 0..2 {
            let (found, expected) = (load.first_moment[i], own[i]);
            assert!(
                expected != 0.0 && (found - expected).abs() <= 4.0 * f64::EPSILON * expected.abs(),
                "{load:?} {own}"
            );
        }
    }
}
