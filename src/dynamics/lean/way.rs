//! The way of several columns outward across a turn.

use super::body::LeanBody;
use super::columns::Block;
use super::motion::cross;
use super::turn::{Renaming, Turn};
use crate::scalar::{ColumnsOf, Real};
use nalgebra::Vector6;

/// phi* across a turn and the row there, with the signs of the renaming and the angle in its coefficients.
pub(super) struct Way<C> {
    /// Which entry of the parent's vector becomes each.
    from: [usize; 3],
    /// The rotation: what x and y become of two entries, and z of one.
    turn: [[C; 2]; 2],
    z: C,
    /// The lever in the body's frame.
    lever: [C; 3],
    has_lever: bool,
    gain: [C; 6],
}

impl<C: Real> Way<C> {
    #[inline(always)]
    pub fn new<T: Real>(
        body: &LeanBody<T::Parameter>,
        renaming: &Renaming<T::Parameter>,
        Turn { s, c }: Turn<T>,
        gain: &Vector6<T>,
        like: C,
    ) -> Self
    where
        C: ColumnsOf<T>,
    {
        let (from, [x, y, z]) = renaming.entries_back();
        let (x, y) = (s.everywhere(x), s.everywhere(y));
        let [lx, ly, lz] = body.lever;
        let (lx, ly, lz) = (s.everywhere(lx), s.everywhere(ly), s.everywhere(lz));
        let [g0, g1, g2, g3, g4, g5]: [T; 6] = (*gain).into();
        Self {
            from,
            turn: [[like.spread(c * x), like.spread(s * y)], [like.spread(-s * x), like.spread(c * y)]],
            z: like.spread(s.everywhere(z)),
            lever: [like.spread(c.mul_add(lx, s * ly)), like.spread((c * ly).minus_product(s, lx)), like.spread(lz)],
            has_lever: body.has_lever,
            gain: [
                like.spread(g0),
                like.spread(g1),
                like.spread(g2),
                like.spread(g3),
                like.spread(g4),
                like.spread(g5),
            ],
        }
    }

    /// phi* y.
    #[inline(always)]
    pub fn carried(&self, y: &Block<C>) -> Block<C> {
        let w = self.turned([y[self.from[0]], y[self.from[1]], y[self.from[2]]]);
        let v = self.turned([y[3 + self.from[0]], y[3 + self.from[1]], y[3 + self.from[2]]]);
        let v = if self.has_lever { cross(w, self.lever, v) } else { v };
        [w[0], w[1], w[2], v[0], v[1], v[2]]
    }

    #[inline(always)]
    fn turned(&self, v: [C; 3]) -> [C; 3] {
        let [[xx, xy], [yx, yy]] = self.turn;
        [xx.mul_add(v[0], xy * v[1]), yx.mul_add(v[0], yy * v[1]), self.z * v[2]]
    }

    /// g* y.
    #[inline(always)]
    pub fn entry(&self, y: &Block<C>) -> C {
        let g = &self.gain;
        let turning = g[0].mul_add(y[0], g[1].mul_add(y[1], g[2] * y[2]));
        let moving = g[3].mul_add(y[3], g[4].mul_add(y[4], g[5] * y[5]));
        turning + moving
    }
}
