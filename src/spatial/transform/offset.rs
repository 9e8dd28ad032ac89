//! The offset of a joint: from its parent's origin to the body's. Most offsets of robots are along one axis of the joint's frame or two: what the other
//! entries would multiply is left out, entry by entry.

use crate::scalar::{ColumnsOf, Real};

/// A constant offset l, m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Offset<N> {
    pub entries: [N; 3],
    /// Which of them are there: not zero, or not left out.
    pub along: [bool; 3],
    /// l . l
    pub square: N,
}

/// Does `$do` for those of three entries that are there, their places 0 to 2 as constants. Of one state for all three, if any is: to ask once takes
/// less time there.
macro_rules! along_each {
    ($scalar:ty, $offset:expr, $i:ident, $do:expr) => {{
        let [along_x, along_y, along_z] =
            if <$scalar>::SHARES_BRANCHES { $offset.along } else { [$offset.is_there(); 3] };
        if along_x {
            const $i: usize = 0;
            $do
        }
        if along_y {
            const $i: usize = 1;
            $do
        }
        if along_z {
            const $i: usize = 2;
            $do
        }
    }};
}

pub(crate) use along_each;

impl<N: Copy> Offset<N> {
    pub fn new(entries: [f64; 3], leaves_out: bool, number: impl Fn(f64) -> N) -> Self {
        let [x, y, z] = entries;
        let along = entries.map(|x| !leaves_out || x != 0.0);
        Self { square: number(x * x + y * y + z * z), entries: entries.map(number), along }
    }

    /// Whether any entry is there.
    #[inline(always)]
    pub fn is_there(&self) -> bool {
        self.along[0] || self.along[1] || self.along[2]
    }

    /// The same in every lane.
    #[inline(always)]
    pub fn splat<T: Real<Parameter = N>>(&self, like: T) -> Offset<T> {
        let [x, y, z] = self.entries;
        Offset {
            entries: [like.splat(x), like.splat(y), like.splat(z)],
            along: self.along,
            square: like.splat(self.square),
        }
    }
}

impl<T: Real> Offset<T> {
    /// The same in every column.
    #[inline(always)]
    pub fn spread<C: ColumnsOf<T>>(&self, like: C) -> Offset<C> {
        let [x, y, z] = self.entries;
        Offset {
            entries: [like.spread(x), like.spread(y), like.spread(z)],
            along: self.along,
            square: like.spread(self.square),
        }
    }

    /// n + l x f: the moment about the parent's origin.
    #[inline(always)]
    pub fn moment(&self, f: [T; 3], mut n: [T; 3]) -> [T; 3] {
        along_each!(T, self, I, turn_moment::<T, I>(self.entries[I], f, &mut n));
        n
    }

    /// v + w x l: the velocity of the body's origin.
    #[inline(always)]
    pub fn velocity(&self, w: [T; 3], mut v: [T; 3]) -> [T; 3] {
        along_each!(T, self, I, turn_velocity::<T, I>(self.entries[I], w, &mut v));
        v
    }
}

/// Adds l x f, l along axis I.
#[inline(always)]
fn turn_moment<T: Real, const I: usize>(l: T, f: [T; 3], n: &mut [T; 3]) {
    let (j, k) = ((I + 1) % 3, (I + 2) % 3);
    n[j] = n[j].minus_product(l, f[k]);
    n[k] = l.mul_add(f[j], n[k]);
}

/// Adds w x l, l along axis I.
#[inline(always)]
fn turn_velocity<T: Real, const I: usize>(l: T, w: [T; 3], v: &mut [T; 3]) {
    let (j, k) = ((I + 1) % 3, (I + 2) % 3);
    v[j] = l.mul_add(w[k], v[j]);
    v[k] = v[k].minus_product(l, w[j]);
}

#[cfg(test)]
mod tests {
    use super::Offset;
    use crate::scalar::{Counted, Real};
    use nalgebra::Vector3;

    const F: [f64; 3] = [0.7, -1.3, 2.1];
    const N: [f64; 3] = [-0.4, 0.9, 0.2];

    /// n + l x f and v + w x l, against nalgebra: l along any axes, for scalars that ask for all entries at once and for each.
    fn check<T: Real<Parameter = T>>() {
        let of = |v: [f64; 3]| v.map(T::from_f64);
        let is_near = |found: [T; 3], expected: Vector3<f64>| {
            found.iter().zip(&expected).all(|(found, expected)| (found.lane(0) - expected).abs() <= 1e-15)
        };
        for mask in 0..8 {
            let l = [0.3, -0.5, 0.2];
            let l = [0, 1, 2].map(|i| if mask >> i & 1 == 1 { l[i] } else { 0.0 });
            for leaves_out in [true, false] {
                let offset = Offset::new(l, leaves_out, T::from_f64);
                assert_eq!(offset.is_there(), mask != 0 || !leaves_out);
                assert_eq!(offset.along.iter().filter(|&&there| there).count() == 3, mask == 7 || !leaves_out);
                let (l, f, n) = (Vector3::from(l), Vector3::from(F), Vector3::from(N));
                assert!((offset.square.lane(0) - l.norm_squared()).abs() <= 1e-15);
                assert!(is_near(offset.moment(of(F), of(N)), n + l.cross(&f)), "moment, {mask}");
                assert!(is_near(offset.velocity(of(F), of(N)), n + f.cross(&l)), "velocity, {mask}");
            }
        }
    }

    #[test]
    fn entries_that_are_there_do_what_the_whole_does() {
        check::<f64>();
        check::<Counted>();
    }
}
