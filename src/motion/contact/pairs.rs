//! Contacts whose axes t1, t2, n depend on the configuration: impulses are stored in the fixed axes of the contact.

use crate::scene::contact_point::ContactPoint;
use nalgebra::{DVector, Matrix3};

/// The stored impulses, in the fixed axes of the contacts, in these axes.
pub(super) fn from_fixed_axes(points: &[ContactPoint], axes: &[Matrix3<f64>], kept: &[f64]) -> DVector<f64> {
    let mut impulses = DVector::from_column_slice(&kept[..3 * points.len()]);
    for (i, (point, axes)) in points.iter().zip(axes).enumerate().filter(|(_, (point, _))| point.other.is_some()) {
        let mut impulse = impulses.fixed_rows_mut::<3>(3 * i);
        let turned = axes * point.axes.tr_mul(&impulse);
        impulse.copy_from(&turned);
    }
    impulses
}

/// Impulses of the contacts `near` in these axes, in the fixed axes of the contacts.
pub(super) fn into_fixed_axes<'a>(
    points: &[ContactPoint],
    (axes, near): (&[Matrix3<f64>], &[usize]),
    impulses: impl Iterator<Item = &'a mut DVector<f64>>,
) {
    for impulses in impulses {
        for (at, &i) in near.iter().enumerate() {
            let Some(point) = points.get(i).filter(|point| point.other.is_some()) else { continue };
            let mut impulse = impulses.fixed_rows_mut::<3>(3 * at);
            let turned = point.axes * axes[i].tr_mul(&impulse);
            impulse.copy_from(&turned);
        }
    }
}
