//! Signed permutations of axes: from the frame of a body in the model to the frame that the passes use.

use crate::scalar::Real;
use nalgebra::{Matrix3, Vector6};

/// A signed permutation of axes, from the frame of a body in the model to the frame that the passes use.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::dynamics) struct AxisPermutation<N> {
    /// Entry i in the passes is `sign[i]` times entry `from[i]` in the model.
    pub from: [u8; 3],
    pub sign: [N; 3],
}

impl<N: Copy> AxisPermutation<N> {
    /// The identity.
    pub fn identity(one: N) -> Self {
        Self { from: [0, 1, 2], sign: [one; 3] }
    }

    /// From a rotation with one entry of 1 or -1 in each row and column, and zeros.
    #[allow(clippy::cast_possible_truncation)] // below three
    pub fn of(rotation: &Matrix3<f64>, number: impl Fn(f64) -> N) -> Self {
        Self {
            from: [0, 1, 2].map(|i| rotation.row(i).iter().position(|&x| x != 0.0).unwrap_or(i) as u8),
            sign: [0, 1, 2].map(|i| number(rotation.row(i).sum())),
        }
    }

    /// Converts a motion or a force from the frame of the model.
    #[inline(always)]
    pub fn apply<T: Real<Parameter = N>>(&self, v: &Vector6<T>) -> [T; 6] {
        let mut here: [T; 6] = (*v).into();
        for (i, here) in here.iter_mut().enumerate() {
            let from = v[usize::from(self.from[i % 3]) + i / 3 * 3];
            *here = from * from.splat(self.sign[i % 3]);
        }
        here
    }

    /// Converts a motion or a force back to the frame of the model.
    #[inline(always)]
    pub fn back<T: Real<Parameter = N>>(&self, here: &[T; 6]) -> Vector6<T> {
        let mut there = Vector6::from(*here);
        for (i, &value) in here.iter().enumerate() {
            there[usize::from(self.from[i % 3]) + i / 3 * 3] = value * value.splat(self.sign[i % 3]);
        }
        there
    }

    /// The place and the sign in the model of entry (i, j) of a symmetric matrix.
    #[inline(always)]
    pub fn entry<T: Real<Parameter = N>>(&self, like: T, i: usize, j: usize) -> ([usize; 2], T) {
        ([usize::from(self.from[i]), usize::from(self.from[j])], like.splat(self.sign[i]) * like.splat(self.sign[j]))
    }
}
