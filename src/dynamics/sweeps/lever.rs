//! From a parent's origin to a body's. Most levers of robots are along one axis of the joint's frame or two: what the other entries would multiply
//! is left out, entry by entry.

use crate::scalar::Real;

/// A constant lever.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Lever<N> {
    pub entries: [N; 3],
    /// Which of them are there: not zero, or not left out.
    pub along: [bool; 3],
}

/// Does `$do` for those of three entries that are there, their places 0 to 2 as constants. Of one state for all three, if any is: to ask once takes
/// less time there.
macro_rules! along_each {
    ($scalar:ty, $lever:expr, $i:ident, $do:expr) => {{
        let [along_x, along_y, along_z] =
            if <$scalar>::SHARES_BRANCHES { $lever.along } else { [$lever.is_there(); 3] };
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

pub(super) use along_each;

impl<N: Copy> Lever<N> {
    pub fn new(entries: [f64; 3], leaves_out: bool, number: impl Fn(f64) -> N) -> Self {
        Self { entries: entries.map(number), along: entries.map(|x| !leaves_out || x != 0.0) }
    }

    /// Whether any entry is there.
    #[inline(always)]
    pub fn is_there(&self) -> bool {
        self.along[0] || self.along[1] || self.along[2]
    }

    /// The same along the axes X, Y and Z of its frame, taken for x, y and z.
    #[inline(always)]
    pub fn in_axes<const X: usize, const Y: usize, const Z: usize>(&self) -> Self {
        let (l, along) = (&self.entries, &self.along);
        Self { entries: [l[X], l[Y], l[Z]], along: [along[X], along[Y], along[Z]] }
    }

    /// n + l x f: the moment about the parent's origin.
    #[inline(always)]
    pub fn moment<T: Real<Parameter = N>>(&self, f: [T; 3], mut n: [T; 3]) -> [T; 3] {
        along_each!(T, self, I, turn_moment::<T, I>(f[0].splat(self.entries[I]), f, &mut n));
        n
    }

    /// v + w x l: the velocity of the body's origin.
    #[inline(always)]
    pub fn velocity<T: Real<Parameter = N>>(&self, w: [T; 3], mut v: [T; 3]) -> [T; 3] {
        along_each!(T, self, I, turn_velocity::<T, I>(w[0].splat(self.entries[I]), w, &mut v));
        v
    }
}

/// A lever with its entries spread over the lanes.
impl<T: Real> Lever<T> {
    /// n + l x f, of entries in the lanes.
    #[inline(always)]
    pub fn moment_in_lanes(&self, f: [T; 3], mut n: [T; 3]) -> [T; 3] {
        along_each!(T, self, I, turn_moment::<T, I>(self.entries[I], f, &mut n));
        n
    }

    /// v + w x l, of entries in the lanes.
    #[inline(always)]
    pub fn velocity_in_lanes(&self, w: [T; 3], mut v: [T; 3]) -> [T; 3] {
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
    use super::Lever;
    use crate::dynamics::forces::Needed;
    use crate::dynamics::sweeps::spin::Spin;
    use crate::scalar::{Counted, Real};
    use nalgebra::Vector3;

    const F: [f64; 3] = [0.7, -1.3, 2.1];
    const N: [f64; 3] = [-0.4, 0.9, 0.2];

    /// n + l x f, v + w x l and a + dw x l + w x (w x l), against nalgebra: l along any axes, for scalars that ask for all entries at once and for each.
    fn check<T: Real<Parameter = T>>() {
        let of = |v: [f64; 3]| v.map(T::from_f64);
        let is_near = |found: [T; 3], expected: Vector3<f64>| {
            found.iter().zip(&expected).all(|(found, expected)| (found.lane(0) - expected).abs() <= 1e-15)
        };
        for mask in 0..8 {
            let l = [0.3, -0.5, 0.2];
            let l = [0, 1, 2].map(|i| if mask >> i & 1 == 1 { l[i] } else { 0.0 });
            for leaves_out in [true, false] {
                let lever = Lever::new(l, leaves_out, T::from_f64);
                assert_eq!(lever.is_there(), mask != 0 || !leaves_out);
                assert_eq!(lever.along.iter().filter(|&&there| there).count() == 3, mask == 7 || !leaves_out);
                let (l, f, n) = (Vector3::from(l), Vector3::from(F), Vector3::from(N));
                assert!(is_near(lever.moment(of(F), of(N)), n + l.cross(&f)), "moment, {mask}");
                assert!(is_near(lever.moment_in_lanes(of(F), of(N)), n + l.cross(&f)), "moment in lanes, {mask}");
                assert!(is_near(lever.velocity(of(F), of(N)), n + f.cross(&l)), "velocity, {mask}");
                assert!(is_near(lever.velocity_in_lanes(of(F), of(N)), n + f.cross(&l)), "velocity in lanes, {mask}");
                let dw = Vector3::new(0.6, 1.1, -0.8);
                for velocity in [true, false] {
                    let spin = Spin::of(of(F), of(dw.into()), Needed { velocity, acceleration: true });
                    let pull = if velocity { f.cross(&f.cross(&l)) } else { Vector3::zeros() };
                    assert!(is_near(spin.at(&lever, of(N)), n + dw.cross(&l) + pull), "acceleration, {mask}");
                }
            }
        }
        let lever = Lever::new([0.3, 0.0, 0.2], true, T::from_f64).in_axes::<1, 2, 0>();
        assert_eq!((lever.along, lever.entries[2].lane(0)), ([false, true, true], 0.3));
    }

    #[test]
    fn entries_that_are_there_do_what_the_whole_does() {
        check::<f64>();
        check::<Counted>();
    }
}
