//! Adjoints of the joint operations on configurations: they propagate the gradient of a scalar through the methods of
//! [`Motion`].
//!
//! Gradients by a configuration are in its tangent space, in the axes of the joint velocities. With (ad x) y = [x, y],
//!
//! ```text
//! q' = q exp(x):                              q_bar = exp(-ad x)* q'_bar,    x_bar = Jr(x)* q'_bar,
//!                                             Jr(x) = sum (-ad x)^k/(k + 1)!
//! c = v + [x, v]/2 + [x, [x, v]]/12:          v_bar = (1 + ad x/2 + (ad x)^2/12)* c_bar, and x_bar by the product rule
//! r = the rotation vector from rest to q:     q_bar = Jr(r)^-1* r_bar
//! ```

use super::Motion;
use super::quaternion::{exponential, quotient, rotation, turn_between};
use super::vectors::{cross, plus, triple, write};
use crate::scalar::Real;
use nalgebra::Vector3;

/// Number of equal parts of the increment of a free joint: Jr(x)* g = Jr(y)* sum over i of exp(-ad y)*^i g / 16 for x =
/// 16 y.
const PARTS: u32 = 16;

/// Number of terms of the series of Jr(y). The remainder is below (t/16)^20/21! for a rotation by t, which is at
/// rounding level for up to five turns per step.
const TERMS: u32 = 20;

/// A twist or its dual: (linear, angular).
type Pair<T> = [Vector3<T>; 2];

fn pair<T: Real>(x: &[T]) -> Pair<T> {
    [triple(x), triple(&x[3..])]
}

/// -(ad x)* g, for x = (a, w) and g = (f, m): (w x f, a x f + w x m).
#[inline(always)]
fn turned<T: Real>([a, w]: &Pair<T>, [f, m]: &Pair<T>) -> Pair<T> {
    [cross(w, f), plus(&cross(a, f), f[0].constant(1.0), &cross(w, m))]
}

/// a + s b.
#[inline(always)]
fn add<T: Real>(a: &Pair<T>, s: f64, b: &Pair<T>) -> Pair<T> {
    let s = a[0][0].constant(s);
    [plus(&a[0], s, &b[0]), plus(&a[1], s, &b[1])]
}

impl<T: Real> Motion<T> {
    /// Adjoint of q' = q exp(x), [`Motion::advance`]: adds the contributions of the cotangent of q' to those of q and
    /// x.
    #[inline(always)]
    pub(crate) fn advance_cotangents(&self, x: &[T], next: &[T], of_q: &mut [T], of_x: &mut [T]) {
        match self {
            Self::Spherical => {
                let (w, g) = (triple(x), triple(next));
                let (turn, b, c) = exponential(&w);
                let once = cross(&w, &g);
                add_to(of_q, &rotation(&turn).rotate(&g));
                add_to(of_x, &plus(&plus(&g, b, &once), c, &cross(&w, &once)));
            }
            Self::Free => {
                let (of_start, of_increment) = free_advance(&pair(x), &pair(next));
                for half in 0..2 {
                    add_to(&mut of_q[3 * half..], &of_start[half]);
                    add_to(&mut of_x[3 * half..], &of_increment[half]);
                }
            }
            Self::Fixed => {}
            _ => {
                of_q[0] += next[0];
                of_x[0] += next[0];
            }
        }
    }

    /// Adjoint of [`Motion::carry_back`]: replaces the cotangent of the transported velocity by that of v, and adds its
    /// contribution to that of x.
    #[inline(always)]
    pub(crate) fn carry_back_cotangents(&self, (x, v): (&[T], &[T]), carried: &mut [T], of_x: &mut [T]) {
        match self {
            Self::Spherical => {
                let zero = Vector3::from_element(x[0].constant(0.0));
                let seen = [[zero, triple(x)], [zero, triple(v)], [zero, triple(carried)]];
                let [[_, of_v], [_, more]] = carried_back(seen);
                write(carried, &of_v);
                add_to(of_x, &more);
            }
            Self::Free => {
                let [of_v, more] = carried_back([pair(x), pair(v), pair(carried)]);
                for (half, (of_v, more)) in of_v.iter().zip(&more).enumerate() {
                    write(&mut carried[3 * half..], of_v);
                    add_to(&mut of_x[3 * half..], more);
                }
            }
            _ => {}
        }
    }

    /// Adjoint of [`Motion::displacement`]: adds the contribution of its cotangent to that of q.
    #[inline(always)]
    pub(crate) fn displacement_cotangent(&self, (rest, q): (&[T], &[T]), displaced: &[T], of_q: &mut [T]) {
        match self {
            Self::Spherical => {
                let of_turn = of_logarithm(&turn_between(rest, q), &triple(displaced));
                add_to(of_q, &of_turn);
            }
            Self::Free => {
                let moved = plus(&triple(q), q[0].constant(-1.0), &triple(rest));
                let [pushed, along] = [triple(displaced), rotation(&q[3..7]).rotate_back(&moved)];
                let of_turn = of_logarithm(&turn_between(&rest[3..7], &q[3..7]), &triple(&displaced[3..]));
                let of_turn = plus(&of_turn, q[0].constant(1.0), &cross(&pushed, &along));
                add_to(of_q, &pushed);
                add_to(&mut of_q[3..], &of_turn);
            }
            Self::Fixed => {}
            _ => of_q[0] += displaced[0],
        }
    }

    /// As [`Motion::displacement_cotangent`], for the configuration of rest, in its tangent space.
    #[inline(always)]
    pub(crate) fn rest_cotangent(&self, (rest, q): (&[T], &[T]), displaced: &[T], of_rest: &mut [T]) {
        // The rotation from q to rest is the inverse.
        let of_turn = |rest: &[T], q: &[T], turned: &[T]| {
            let inverse = triple(turned) * turned[0].constant(-1.0);
            of_logarithm(&turn_between(q, rest), &inverse)
        };
        match self {
            Self::Spherical => add_to(of_rest, &of_turn(rest, q, displaced)),
            Self::Free => {
                let pushed = rotation(&rest[3..7]).rotate_back(&rotation(&q[3..7]).rotate(&triple(displaced)));
                add_to(of_rest, &(pushed * q[0].constant(-1.0)));
                add_to(&mut of_rest[3..], &of_turn(&rest[3..7], &q[3..7], &displaced[3..]));
            }
            Self::Fixed => {}
            _ => of_rest[0] -= displaced[0],
        }
    }
}

/// exp(-ad x)* g and Jr(x)* g for a twist x.
#[inline(always)]
fn free_advance<T: Real>([a, w]: &Pair<T>, g: &Pair<T>) -> (Pair<T>, Pair<T>) {
    let one = a[0].constant(1.0);
    let zero = Vector3::from_element(one.constant(0.0));
    let part = one.constant(1.0 / f64::from(PARTS));
    let y = [plus(&zero, part, a), plus(&zero, part, w)];
    let (turn, b, c) = exponential(&y[1]);
    let (turned_by, once) = (rotation(&turn), cross(&y[1], &y[0]));
    let moved = plus(&plus(&y[0], b, &once), c, &cross(&y[1], &once));
    let (mut term, mut sum) = (*g, [zero; 2]);
    for _ in 0..PARTS {
        sum = add(&sum, 1.0, &term);
        // exp(-ad y)* (f, m) = (R f, R m + p x R f)
        let pushed = turned_by.rotate(&term[0]);
        term = [pushed, plus(&turned_by.rotate(&term[1]), one, &cross(&moved, &pushed))];
    }
    let of_start = term;
    let (mut term, mut of_increment) = ([plus(&zero, part, &sum[0]), plus(&zero, part, &sum[1])], [zero; 2]);
    for k in 1..=TERMS {
        of_increment = add(&of_increment, 1.0, &term);
        let over = one.constant(1.0 / f64::from(k + 1));
        let next = turned(&y, &term);
        term = [plus(&zero, over, &next[0]), plus(&zero, over, &next[1])];
    }
    (of_start, of_increment)
}

/// Adds a vector to the first three entries of a slice.
#[inline(always)]
fn add_to<T: Real>(sum: &mut [T], x: &Vector3<T>) {
    for i in 0..3 {
        sum[i] += x[i];
    }
}

/// The cotangent of v, and the contribution to that of x, from the cotangent of c.
#[inline(always)]
fn carried_back<T: Real>([x, v, c]: [Pair<T>; 3]) -> [Pair<T>; 2] {
    let one = x[0][0].constant(1.0);
    // y = [x, v]; `once` and `twice` are -(ad x)* c and (ad x)* (ad x)* c.
    let y = [plus(&cross(&x[1], &v[0]), one, &cross(&x[0], &v[1])), cross(&x[1], &v[1])];
    let once = turned(&x, &c);
    let twice = turned(&x, &once);
    let of_v = add(&add(&c, -0.5, &once), 1.0 / 12.0, &twice);
    let second = add(&turned(&y, &c), -1.0, &turned(&v, &once));
    let zero = [Vector3::from_element(one.constant(0.0)); 2];
    [of_v, add(&add(&zero, 0.5, &turned(&v, &c)), 1.0 / 12.0, &second)]
}

/// Jr(r)^-1* g = g - r x g/2 + d r x (r x g), with d = (1 - (t/2) cot(t/2))/t^2 for the length t of r.
#[inline(always)]
fn of_logarithm<T: Real>(r: &Vector3<T>, g: &Vector3<T>) -> Vector3<T> {
    let one = r[0].constant(1.0);
    let square = r[0] * r[0] + r[1] * r[1] + r[2] * r[2];
    let half = one.constant(0.5) * square.sqrt();
    let (sine, cosine) = half.sin_cos();
    // The cancellation in d for small t is harmless, because d is multiplied by t^2.
    let d = quotient(one - quotient(half * cosine, sine, 1.0), square, 1.0 / 12.0);
    let once = cross(r, g);
    plus(&plus(g, one.constant(-0.5), &once), d, &cross(r, &once))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::Dual;

    type Number = Dual<f64>;

    const X: [f64; 6] = [0.7, -0.4, 1.1, 0.5, 1.2, -0.8];
    const V: [f64; 6] = [-0.3, 0.9, 0.2, 1.4, -0.6, 0.35];
    const REST: [f64; 7] = [0.2, 0.1, -0.4, 0.1, -0.3, 0.2, 0.9];
    const Q: [f64; 7] = [0.5, -0.8, 0.3, 0.4, 0.5, -0.1, 0.7];
    const BAR: [f64; 6] = [0.31, -0.22, 0.57, 0.84, -0.65, 0.19];

    /// Each kind with its numbers of coordinates and velocities, and their offset in the arrays above.
    const KINDS: [(Motion<Number>, usize, usize, usize); 3] =
        [(Motion::Free, 7, 6, 0), (Motion::Spherical, 4, 3, 3), (Motion::Revolute, 1, 1, 0)];

    fn unit(mut q: [f64; 7]) -> [f64; 7] {
        let norm = q[3..].iter().map(|x| x * x).sum::<f64>().sqrt();
        q[3..].iter_mut().for_each(|x| *x /= norm);
        q
    }

    /// q displaced along d, to first order.
    fn tangent(motion: &Motion<Number>, q: &[Number], d: &[f64]) -> Vec<Number> {
        let along: Vec<Number> = d.iter().map(|&tangent| Dual { value: 0.0, tangent }).collect();
        let mut out = q.to_vec();
        // The increment is zero with a nonzero tangent, so that the derivative is given by the coordinate velocities.
        let mut rates = vec![Dual::constant_of(0.0); q.len()];
        motion.coordinate_rates(q, &along, &mut rates);
        out.iter_mut().zip(&rates).for_each(|(out, rate)| *out = Dual { value: out.value, tangent: rate.tangent });
        out
    }

    /// The tangent vector at q that corresponds to the tangents of the coordinates.
    fn rates_of(motion: &Motion<Number>, q: &[Number], nv: usize) -> Vec<f64> {
        let plain: Vec<Number> = q.iter().map(|x| Dual::constant_of(x.value)).collect();
        let columns: Vec<Vec<f64>> = (0..nv)
            .map(|i| {
                let unit: Vec<f64> = (0..nv).map(|j| f64::from(u8::from(i == j))).collect();
                tangent(motion, &plain, &unit).iter().map(|x| x.tangent).collect()
            })
            .collect();
        // Columns are orthogonal, of norm 1 for positions and 1/2 for quaternions.
        columns
            .iter()
            .map(|c| c.iter().zip(q).map(|(c, x)| c * x.tangent).sum::<f64>() / c.iter().map(|c| c * c).sum::<f64>())
            .collect()
    }

    fn pairing(a: &[f64], b: &[f64]) -> f64 {
        a.iter().zip(b).map(|(a, b)| a * b).sum()
    }

    fn value(x: &[f64]) -> Vec<Number> {
        x.iter().map(|&x| Dual::constant_of(x)).collect()
    }

    /// Compares adjoints with dual numbers along every direction, for rotations from zero to nearly pi.
    #[test]
    fn gradients_are_the_adjoint_of_derivatives() {
        for (motion, nq, nv, at) in KINDS {
            for scale in [0.0, 0.03, 0.3, 1.0, 1.9, 7.0, 16.0] {
                let [x, v, bar] = [X.map(|x| x * scale), V, BAR].map(|all| all[at..at + nv].to_vec());
                let (q, rest) = (&unit(Q)[at..at + nq], &unit(REST)[at..at + nq]);
                let [mut of_q, mut of_x, mut of_carried, mut of_q_by_spring] = [[Dual::constant_of(0.0); 6]; 4];
                motion.advance_cotangents(&value(&x), &value(&bar), &mut of_q, &mut of_x);
                let mut of_v = value(&bar);
                motion.carry_back_cotangents((&value(&x), &value(&v)), &mut of_v, &mut of_carried);
                motion.displacement_cotangent((&value(rest), &value(q)), &value(&bar), &mut of_q_by_spring);
                let mut of_rest = [Dual::constant_of(0.0); 6];
                motion.rest_cotangent((&value(rest), &value(q)), &value(&bar), &mut of_rest);
                let plain = |x: &[Number]| x[..nv].iter().map(|x| x.value).collect::<Vec<_>>();
                for i in 0..nv {
                    let d: Vec<f64> = (0..nv).map(|j| f64::from(u8::from(i == j))).collect();
                    let moving = |x: &[f64]| -> Vec<Number> {
                        x.iter().zip(&d).map(|(&value, &tangent)| Dual { value, tangent }).collect()
                    };
                    let mut next = vec![Dual::constant_of(f64::NAN); nq];
                    if scale > 0.0 {
                        motion.advance(&tangent(&motion, &value(q), &d), &value(&x), &mut next);
                        near(plain(&of_q)[i], pairing(&bar, &rates_of(&motion, &next, nv)), (scale, "q of advance"));
                        motion.advance(&value(q), &moving(&x), &mut next);
                        near(plain(&of_x)[i], pairing(&bar, &rates_of(&motion, &next, nv)), (scale, "x of advance"));
                    } else {
                        // At zero, the norm of x has no derivative.
                        near(plain(&of_q)[i], bar[i], (scale, "q of advance"));
                        near(plain(&of_x)[i], bar[i], (scale, "x of advance"));
                    }
                    let mut carried = moving(&v);
                    motion.carry_back(&value(&x), &mut carried);
                    let change = |x: &[Number]| x.iter().map(|x| x.tangent).collect::<Vec<_>>();
                    near(plain(&of_v)[i], pairing(&bar, &change(&carried)), (scale, "v of carry_back"));
                    let mut carried = value(&v);
                    motion.carry_back(&moving(&x), &mut carried);
                    near(plain(&of_carried)[i], pairing(&bar, &change(&carried)), (scale, "x of carry_back"));
                    let mut displaced = vec![Dual::constant_of(f64::NAN); nv];
                    motion.displacement(&value(rest), &tangent(&motion, &value(q), &d), &mut displaced);
                    near(plain(&of_q_by_spring)[i], pairing(&bar, &change(&displaced)), (scale, "q of displacement"));
                    motion.displacement(&tangent(&motion, &value(rest), &d), &value(q), &mut displaced);
                    near(plain(&of_rest)[i], pairing(&bar, &change(&displaced)), (scale, "rest of displacement"));
                }
            }
        }
    }

    /// Compares sums of a few values of magnitude 1, or of the square of x if that is larger.
    fn near(found: f64, expected: f64, (scale, what): (f64, &str)) {
        let bound = 1e-13 * (scale * scale / 4.0).max(1.0);
        assert!((found - expected).abs() <= bound, "{what}, {scale}: {found} and {expected}");
    }
}
