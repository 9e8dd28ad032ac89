//! Bounds on the terms of pivots that hold at all angles.
//!
//! The [monitor](crate::filter::pivots) compares each pivot with a [`Scale`] that follows P inward: some operations a body, and what it is for hardly ever
//! happens. Where no joint slides outward of another body, what a subtree can weigh at most is known beforehand: no measurement adds to P (3.6), so
//! that its traces are at most those of all bodies outward, held still as far out as their levers reach. Such a bound takes the place of one that follows
//! P. Where a pivot comes near it the judge looks at the terms themselves, as ever.

use crate::filter::pivots::{PIVOT_MARGIN, Scale};
use crate::scene::{Model, Motion};
use nalgebra::DMatrix;

/// The bounds are those of exact sums and rotations: what rounding may take off, that of constants in f32 included.
const ROUNDING: f64 = 1.0 + 1e-6;

/// How much clearer of its bound than needed a body's own inertia has to be in each row: it is never in doubt then.
const CLEAR: f64 = 2.0;

/// A body with all outward of it: mass, and the largest second moment about its origin that there can be.
#[derive(Clone, Copy, Default)]
struct Heap {
    mass: f64,
    second_moment: f64,
}

/// The bounds of all bodies; none where there are none (a joint slides outward of another, or a body is no body), or where for a scalar with this unit of rounding
/// a pivot could come near its bound, which would have to be judged each time.
pub(super) fn scales_at_all_angles(model: &Model<f64>, epsilon: f64) -> Option<Vec<Scale<f64>>> {
    if !model.omissions.pivot_bounds || model.inertia_roots.iter().any(Option::is_none) {
        return None;
    }
    let own = |k: usize| Scale::of_noise(&model.bodies[k].inertia_terms);
    let mut scales: Vec<_> = (0..model.bodies.len()).map(own).collect();
    // The trace of an inertia is twice the second moment; of a mass times the identity three times the mass.
    let mut heaps: Vec<_> =
        scales.iter().map(|own| Heap { mass: own.linear / 3.0, second_moment: own.angular / 2.0 }).collect();
    for (k, stage) in model.system.stages.iter().enumerate().rev() {
        let Some(parent) = stage.parent else { continue };
        if !matches!(model.bodies[k].motion, Motion::Revolute | Motion::Spherical | Motion::Fixed) {
            return None;
        }
        let (lever, heap) = (model.bodies[k].tree.lever.norm(), heaps[k]);
        let traces = (2.0 * heap.second_moment, 3.0 * heap.mass);
        scales[parent] = scales[parent].sum(&Scale::sent(traces, lever * lever));
        heaps[parent].mass += heap.mass;
        // The root of a second moment is a norm: no more than the sum of both parts'.
        heaps[parent].second_moment += (heap.second_moment.sqrt() + heap.mass.sqrt() * lever).powi(2);
    }
    for scale in &mut scales {
        (scale.angular, scale.linear) = (scale.angular * ROUNDING, scale.linear * ROUNDING);
    }
    let is_clear = |k: usize| {
        let margin = CLEAR * PIVOT_MARGIN * epsilon;
        own_pivots(model, k).is_some_and(|pivots| {
            pivots
                .iter()
                .enumerate()
                .all(|(i, &pivot)| pivot > margin * scales[k].of_row(&model.system.stages[k].rows.row(i)))
        })
    };
    (0..scales.len()).all(is_clear).then_some(scales)
}

/// What the pivots of a body are at least: the variance of each row given the others', of its own inertia alone. None where that is singular.
fn own_pivots(model: &Model<f64>, k: usize) -> Option<Vec<f64>> {
    let (stage, inertia) = (&model.system.stages[k], model.bodies[k].inertia.to_symmetric().to_matrix());
    let count = stage.rows.count();
    let column = |i: usize| stage.rows.row(i).to_column();
    let covariance = DMatrix::from_fn(count, count, |i, j| {
        let noise = if i == j { model.system.noise[stage.first_row + i] } else { 0.0 };
        (column(i).transpose() * inertia * column(j))[(0, 0)] + noise
    });
    // A row that is not measured has infinite noise: nothing is asked of it.
    if covariance.iter().any(|x| !x.is_finite()) {
        return (count == 1).then(|| vec![f64::INFINITY]);
    }
    let inverse = covariance.try_inverse()?;
    Some((0..count).map(|i| inverse[(i, i)].recip()).collect())
}

/// Whether all pivots of a scene of f64 have such a bound.
pub(crate) fn knows_scales(model: &Model<f64>) -> bool {
    scales_at_all_angles(model, f64::EPSILON).is_some()
}

#[cfg(test)]
mod tests {
    use super::scales_at_all_angles;
    use crate::dynamics;
    use crate::scene::{Inertial, JointDescription, JointKind, LinkDescription, Omissions, Scene, SceneBuilder};
    use crate::spatial::Symmetric3;
    use nalgebra::Vector3;

    fn inertial(mass: f64) -> Inertial {
        let central = Symmetric3::new([0.03 * mass, 0.0, 0.002 * mass, 0.02 * mass, 0.0, 0.025 * mass]);
        Inertial { mass, centre: [0.1, -0.2, 0.3].into(), central }
    }

    /// Ball and turns: a trunk with two arms, on a base that floats.
    fn tree(kind: JointKind, tip: f64, omissions: Omissions) -> Scene {
        let mut builder = SceneBuilder::new().omissions(omissions).floating_base(true);
        let mut link = |name: &str, mass: f64| {
            let link = LinkDescription { name: name.into(), inertial: Some(inertial(mass)) };
            builder = std::mem::take(&mut builder).link(link);
        };
        let joints = [
            ("base", "trunk", JointKind::Spherical),
            ("trunk", "left", JointKind::Revolute),
            ("left", "left hand", kind),
            ("trunk", "right", JointKind::Revolute),
            ("right", "right hand", JointKind::Revolute),
        ];
        link("base", 3.0);
        for (_, name, _) in &joints {
            link(name, if *name == "right hand" { tip } else { 0.7 });
        }
        for (k, (parent, name, kind)) in joints.into_iter().enumerate() {
            let mut joint = JointDescription::new(format!("to {name}"), kind, parent, name);
            joint.axis = [Vector3::z(), Vector3::y(), Vector3::new(1.0, 2.0, 0.5)][k % 3];
            joint.origin.lever = [0.3, -0.2 * f64::from(u8::try_from(k).expect("small")), 0.4].into();
            builder = builder.joint(joint);
        }
        builder.build().expect("a tree")
    }

    /// No bound that follows P is above the one at all angles; nor is that one far above the largest that there is.
    #[test]
    fn no_angle_has_a_larger_bound() {
        let scene = tree(JointKind::Revolute, 40.0, Omissions::all());
        let (model, mut workspace) = (scene.model(), scene.workspace());
        let known = scales_at_all_angles(model, f64::EPSILON).expect("no slide");
        let mut largest = vec![0.0_f64; known.len()];
        let mut draw = 0.1_f64;
        for _ in 0..300 {
            let mut q = scene.neutral();
            for joint in scene.joints() {
                for x in &mut q[joint.q.clone()] {
                    draw = (draw * 997.0 + 0.123).fract();
                    *x = 6.0 * draw - 3.0;
                }
                let quaternion = match joint.q.len() {
                    4 => joint.q.clone(),
                    7 => joint.q.start + 3..joint.q.end,
                    _ => continue,
                };
                let norm = q[quaternion.clone()].iter().map(|x| x * x).sum::<f64>().sqrt();
                q[quaternion].iter_mut().for_each(|x| *x /= norm);
            }
            let zeros = vec![0.0; scene.nv()];
            let mut qdd = zeros.clone();
            dynamics::forward_dynamics(model, &mut workspace, &q, &zeros, &zeros, &[], &mut qdd);
            for (k, (found, known)) in workspace.scale.iter().zip(&known).enumerate() {
                assert!(found.angular <= known.angular && found.linear <= known.linear, "{k}: {found:?} {known:?}");
                largest[k] = largest[k].max(found.angular);
            }
        }
        for (largest, known) in largest.iter().zip(&known) {
            assert!(known.angular < 4.0 * largest, "{largest} {known:?}");
        }
    }

    #[test]
    fn where_something_slides_or_a_turn_is_in_doubt_bounds_follow() {
        let (all, epsilon) = (Omissions::all(), f64::EPSILON);
        let known = |scene: &Scene, epsilon: f64| scales_at_all_angles(scene.model(), epsilon).is_some();
        assert!(known(&tree(JointKind::Revolute, 1.0, all), epsilon));
        assert!(known(&tree(JointKind::Continuous, 1.0, all), epsilon));
        for kind in [JointKind::Prismatic, JointKind::Screw { pitch: 0.1 }, JointKind::Planar] {
            assert!(!known(&tree(kind, 1.0, all), epsilon), "{kind:?}");
        }
        // Arms of a kilogram carry a hand of a thousand million tons; and with few digits one of a hundred tons.
        assert!(!known(&tree(JointKind::Revolute, 1e12, all), epsilon));
        assert!(!known(&tree(JointKind::Revolute, 1e5, all), f64::from(f32::EPSILON)));
        assert!(!known(&tree(JointKind::Revolute, 1.0, Omissions { pivot_bounds: false, ..all }), epsilon));
        // A ball joint or a base that carries what it is nothing beside.
        for (kind, floating) in [(JointKind::Spherical, false), (JointKind::Fixed, true)] {
            let (light, heavy) = (Some(inertial(1e-12)), Some(inertial(1e3)));
            let mut joints = [
                JointDescription::new("ball", kind, "base", "light"),
                JointDescription::new("turn", JointKind::Revolute, "light", "heavy"),
            ];
            joints[1].origin.lever.x = 1.0;
            let mut builder = SceneBuilder::new().floating_base(floating);
            for (name, inertial) in [("base", None), ("light", light), ("heavy", heavy)] {
                builder = builder.link(LinkDescription { name: name.into(), inertial });
            }
            let scene = joints.into_iter().fold(builder, SceneBuilder::joint).build().expect("two bodies");
            assert!(!known(&scene, epsilon), "{kind:?}");
        }
    }
}
