//! Bounds on the terms that form P^-, as they follow it inward.

use super::body::SweepBody;
use super::rotation::Rotates;
use crate::filter::pivots::Scale;
use crate::filter::terms;
use crate::scalar::Real;
use nalgebra::Vector6;

/// Constant bounds, in every lane.
#[inline(always)]
pub(super) fn scale_splat<T: Real>([angular, linear]: [T::Parameter; 2], like: T) -> Scale<T> {
    Scale { angular: like.splat(angular), linear: like.splat(linear) }
}

/// What P^- of a stage can bring to the entries of its parent, as [`Scale::sent_by`] has it.
#[inline(always)]
pub(super) fn sent<T: Real>(body: &SweepBody<T::Parameter>, diagonal: &[T; 6]) -> Scale<T> {
    let [p0, p1, p2, p3, p4, p5] = *diagonal;
    let (like, four) = (p0, p0.constant(4.0));
    let (a, b) = (p0 + p1 + p2, p3 + p4 + p5);
    Scale { angular: four * b.mul_add(like.splat(body.lever_square), a), linear: four * b }
}

/// The terms of the diagonal of M(k).
#[inline(always)]
pub(super) fn terms_of_noise<T: Real>(body: &SweepBody<T::Parameter>, like: T) -> [T; 6] {
    let [a, b, c, d, e, f] = body.terms;
    [like.splat(a), like.splat(b), like.splat(c), like.splat(d), like.splat(e), like.splat(f)]
}

/// As [`terms::sent`] of a stage on a revolute joint with this diagonal of P^+, in the joint's frame: about z, each of x and y takes from both; about a tilted
/// axis each from what is along that and what is across.
#[inline(always)]
pub(super) fn sent_terms<T: Real, R: Rotates<T>>(
    body: &SweepBody<T::Parameter>,
    rotation: &R,
    kept: &Vector6<T>,
) -> [T; 6] {
    let like = kept[0];
    let four = like.constant(terms::SPREAD);
    let [x, y, z] = body.lever_squares;
    let (x, y, z) = (like.splat(x), like.splat(y), like.splat(z));
    let (across, along) = (four * (kept[3].abs() + kept[4].abs()), four * kept[5].abs());
    let (turned, about) = (four * (kept[0].abs() + kept[1].abs()), four * kept[2].abs());
    if R::TILTS {
        let o = like.constant(0.0);
        let axis = rotation.tilt([o, o, like.constant(1.0)]);
        let [turned_x, turned_y, turned_z] = along_axes(axis, turned, about);
        let [moved_x, moved_y, moved_z] = along_axes(axis, across, along);
        return [
            y.mul_add(moved_z, z.mul_add(moved_y, turned_x)),
            z.mul_add(moved_x, x.mul_add(moved_z, turned_y)),
            x.mul_add(moved_y, y.mul_add(moved_x, turned_z)),
            moved_x,
            moved_y,
            moved_z,
        ];
    }
    [
        y.mul_add(along, z.mul_add(across, turned)),
        x.mul_add(along, z.mul_add(across, turned)),
        (x + y).mul_add(across, about),
        across,
        across,
        along,
    ]
}

/// The terms along x, y and z of what has these across and along this axis: the square of a sum of two is below twice the sum of their squares, and
/// below the trace.
#[inline(always)]
fn along_axes<T: Real>([x, y, z]: [T; 3], across: T, along: T) -> [T; 3] {
    let (xx, yy, zz, trace) = (x * x, y * y, z * z, across + along);
    let (across, along) = (across + across, along + along);
    [
        (yy + zz).mul_add(across, xx * along).worst(trace),
        (zz + xx).mul_add(across, yy * along).worst(trace),
        (xx + yy).mul_add(across, zz * along).worst(trace),
    ]
}

#[cfg(test)]
mod tests {
    use super::sent_terms;
    use crate::dynamics::sweeps::SweepModel;
    use crate::dynamics::sweeps::axial_rotation::AxialRotation;
    use crate::dynamics::sweeps::carrier::Carrier;
    use crate::dynamics::sweeps::carry::carried;
    use crate::dynamics::sweeps::constant_rotation::JointAxis;
    use crate::dynamics::sweeps::packed::packed;
    use crate::dynamics::sweeps::rotation::{ObliqueRotation, rotated};
    use crate::dynamics::sweeps::row::Noise;
    use crate::filter::riccati::Measured;
    use crate::filter::terms::SPREAD;
    use crate::scene::{Inertial, JointDescription, JointKind, LinkDescription, SceneBuilder};
    use crate::spatial::{Symmetric3, Symmetric6};
    use nalgebra::{Matrix6, Vector3, Vector6};

    fn turning_about(axis: Vector3<f64>, lever: Vector3<f64>) -> SweepModel<f64> {
        let central = Symmetric3::new([0.3, 0.02, -0.01, 0.2, 0.03, 0.25]);
        let inertial = Some(Inertial { mass: 2.0, centre: [0.1, -0.2, 0.3].into(), central });
        let mut joint = JointDescription::new("joint", JointKind::Revolute, "base", "body");
        (joint.axis, joint.origin.lever) = (axis, lever);
        let builder = SceneBuilder::new().link(LinkDescription { name: "base".into(), inertial: None });
        let scene = builder.link(LinkDescription { name: "body".into(), inertial }).joint(joint).build();
        SweepModel::new(scene.expect("a turn").model())
    }

    /// No entry of the diagonal of what a turn sends is above the bound, and what is small across a tilted axis or along it is seen to be.
    #[test]
    fn nothing_that_a_turn_sends_is_above_the_bound() {
        #[allow(clippy::cast_precision_loss)] // small indices
        let wave = |seed: u32, i: usize| (1.0 + 7.3 * f64::from(seed) + 2.9 * i as f64).sin();
        let axes = [
            Vector3::x(),
            -Vector3::y(),
            Vector3::z(),
            Vector3::new(0.6, 0.0, -0.8),
            Vector3::new(1e-5, 1.0, 0.0),
            Vector3::new(0.48, 0.6, 0.64),
        ];
        for (seed, axis) in (0..240).zip(axes.into_iter().cycle()) {
            let lever = Vector3::from_fn(|i, _| 10_f64.powf(wave(seed, i)) * wave(seed + 3000, i));
            let sweeps = turning_about(axis, lever);
            let (body, angle) = (&sweeps.bodies[0], 3.0 * wave(seed + 2000, 0));
            let turn = AxialRotation { s: angle.sin(), c: angle.cos() };
            let root = Matrix6::from_fn(|i, j| wave(seed, 6 * i + j) * 10_f64.powf(3.0 * wave(seed + 1000, j)));
            let p = root * root.transpose();
            let symmetric = |at: usize| {
                Symmetric3::new([(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)].map(|(i, j)| p[(at + i, at + j)]))
            };
            let coupling = p.fixed_view::<3, 3>(0, 3).into_owned();
            let entries = packed(&Symmetric6 { angular: symmetric(0), coupling, linear: symmetric(3) });
            // Row and column 2 are the gain times this noise.
            let m = Measured { pivot: 1.0, pivot_inverse: 1.0, gain: Vector6::from(p.column(2)) };
            let noise = Noise::of(1.0);
            let Carrier::Axial(axle) = body.carrier else { panic!("a turn") };
            let (sent, bound) = rotated!(axle, turn, sweeps.tilts, rotation, {
                (carried(body, &rotation, &entries, &[0.0; 5], (&m, noise)), sent_terms(body, &rotation, &p.diagonal()))
            });
            for (i, at) in [0, 3, 5, 15, 18, 20].into_iter().enumerate() {
                assert!(sent[at] <= bound[i], "{seed} {i}: {} {}", sent[at], bound[i]);
            }
        }
        // Nothing about the axis, and that next to y of the parent's.
        let sweeps = turning_about(axes[4], Vector3::zeros());
        let (body, kept) = (&sweeps.bodies[0], Vector6::new(1.0, 1.0, 0.0, 1.0, 1.0, 0.0));
        let Carrier::Axial(axle) = body.carrier else { panic!("a turn") };
        let bound = rotated!(
            axle,
            AxialRotation { s: 0.6, c: 0.8 },
            sweeps.tilts,
            rotation,
            sent_terms(body, &rotation, &kept)
        );
        assert!(bound[1] < 1e-8 && bound[4] < 1e-8 && bound[0] >= SPREAD, "{bound:?}");
    }
}
