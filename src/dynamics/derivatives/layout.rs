//! The layout of the constants of a motion: armature (nv), gravity (3), wrenches (bodies x 6), inertial parameters
//! (bodies x 10).

use super::parameters::Parameters;

/// Number of scalars of all constants.
pub(crate) fn constants_width(nv: usize, bodies: usize) -> usize {
    nv + 3 + 16 * bodies
}

/// Splits constants into armature, gravity, wrenches and parameters.
pub(crate) fn constants_of<T>(all: &[T], nv: usize, bodies: usize) -> [&[T]; 4] {
    let (armature, rest) = all.split_at(nv);
    let (gravity, rest) = rest.split_at(3);
    let (wrenches, parameters) = rest.split_at(6 * bodies);
    [armature, gravity, wrenches, parameters]
}

/// Mutable parts: changes of the constants, or gradients with respect to them.
pub(crate) struct ConstantParts<'a, T> {
    pub armature: &'a mut [T],
    pub gravity: &'a mut [T],
    pub wrenches: &'a mut [[T; 6]],
    pub parameters: &'a mut [Parameters<T>],
}

impl<'a, T> ConstantParts<'a, T> {
    pub fn of(all: &'a mut [T], nv: usize, bodies: usize) -> Self {
        let (armature, rest) = all.split_at_mut(nv);
        let (gravity, rest) = rest.split_at_mut(3);
        let (wrenches, parameters) = rest.split_at_mut(6 * bodies);
        Self { armature, gravity, wrenches: wrenches.as_chunks_mut().0, parameters: parameters.as_chunks_mut().0 }
    }
}

/// All gradients of one state, one after another: by q, qd and the third argument, (3 x nv), then by the constants.
pub(crate) struct GradientParts<'a, T> {
    pub state: &'a mut [T],
    pub constants: ConstantParts<'a, T>,
}

impl<'a, T> GradientParts<'a, T> {
    pub fn of(all: &'a mut [T], nv: usize, bodies: usize) -> Self {
        let (state, rest) = all.split_at_mut(3 * nv);
        Self { state, constants: ConstantParts::of(rest, nv, bodies) }
    }
}
