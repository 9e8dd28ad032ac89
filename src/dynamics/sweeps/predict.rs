//! Tip to base, open loop: the torques that forces need.

use super::axial_rotation::ABOUT_Z;
use super::axial_rotation::{AxialRotation, Axis, about};
use super::carrier::Carrier;
use super::constant_rotation::JointAxis;
use super::lever::Lever;
use super::model::SweepModel;
use super::rotation::{ObliqueRotation, Rotates, rotated};
use super::scratch::{BodyState, SweepScratch};
use super::segment::Segment;
use crate::model::Model;
use crate::scalar::Real;
use nalgebra::Vector6;

/// The torque H z of every row, z carried inward (1.5).
#[inline(always)]
pub(super) fn tip_to_base<T: Real>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    torques: &mut [T],
) {
    let SweepScratch { own, shifts, .. } = scratch;
    let bodies = &sweeps.segments[..];
    let own = &mut own[..bodies.len()];
    for (place, body) in bodies.iter().enumerate().rev() {
        let BodyState { turn, force } = own[place];
        let to = if body.parent > 0 { Some(&mut own[body.parent - 1].force) } else { None };
        match body.carrier {
            Carrier::Axial(axle) => {
                torques[body.row] = force[ABOUT_Z] * force[ABOUT_Z].splat(body.sense);
                if let Some(to) = to {
                    rotated!(axle, turn, sweeps.tilts, rotation, X, Y, Z, {
                        send_force::<T, _, X, Y, Z>(body, &rotation, &force, to);
                    });
                }
            }
            Carrier::Shift(at) => {
                let (force, stage) = (Vector6::from(force), &model.system.stages[body.index]);
                for i in 0..stage.rows.count() {
                    torques[body.row + i] = stage.rows.row(i).project(&force);
                }
                if let Some(to) = to {
                    for (to, &sent) in to.iter_mut().zip(&shifts[at].force_to_parent(&force)) {
                        *to += sent;
                    }
                }
            }
        }
    }
}

/// Adds a force across a revolute joint to what its parent has.
#[inline(always)]
fn send_force<T: Real, R: Rotates<T>, const X: usize, const Y: usize, const Z: usize>(
    body: &Segment<T::Parameter>,
    rotation: &R,
    force: &[T; 6],
    to: &mut [T; 6],
) {
    let like = force[0];
    let Lever { entries: [x, y, z], along } = body.arm.in_axes::<X, Y, Z>();
    let lever = Lever { entries: [like.splat(x), like.splat(y), like.splat(z)], along };
    *to = with_force::<T, R, X, Y, Z>(&lever, rotation, force, to);
}

/// What a parent has and a force across a revolute joint: what was there comes in where the sum begins, so that nothing waits for it.
#[inline(always)]
fn with_force<T: Real, R: Rotates<T>, const X: usize, const Y: usize, const Z: usize>(
    lever: &Lever<T>,
    rotation: &R,
    force: &[T; 6],
    to: &[T; 6],
) -> [T; 6] {
    let AxialRotation { s, c } = rotation.turn();
    let [nx, ny, nz, ..] = *force;
    let f = rotation.rotate([force[3], force[4], force[5]]);
    let n = if R::TILTS {
        let [x, y, z] = rotation.rotate([nx, ny, nz]);
        [x + to[X], y + to[Y], z + to[Z]]
    } else {
        [c.mul_add(nx, to[X]).minus_product(s, ny), s.mul_add(nx, c.mul_add(ny, to[Y])), nz + to[Z]]
    };
    let n = lever.moment_in_lanes(f, n);
    let mut sum = *to;
    (sum[X], sum[Y], sum[Z]) = (n[0], n[1], n[2]);
    (sum[3 + X], sum[3 + Y], sum[3 + Z]) = (f[0] + to[3 + X], f[1] + to[3 + Y], f[2] + to[3 + Z]);
    sum
}
