//! Transposition of the values of several states into lanes and back, by square blocks in registers.
//!
//! A remainder that does not fill a square block is covered by a block that overlaps the preceding one; or, if it has
//! at least half as many values as there are lanes, by a block whose upper half overlaps its lower half. Loop counts
//! are compile-time constants, because the blocks would otherwise be stored in memory.

use super::{Instructions, Lanes, MOST_LANES, Real};
use pulp::bytemuck::{cast_slice, cast_slice_mut};
use std::ops::Range;

/// The last `lanes` of `length` values, or all if there are fewer; empty if whole blocks cover them.
#[inline(always)]
fn last_run(length: usize, lanes: usize) -> Range<usize> {
    if length.is_multiple_of(lanes) { 0..0 } else { length.saturating_sub(lanes)..length }
}

impl<S: Instructions> Lanes<S> {
    /// Half the number of lanes.
    const HALF: usize = Self::LANES / 2;

    /// Reads the values of each lane into `numbers`. Returns zero in each lane whose values are all finite, else NaN. A
    /// lane with an empty slice is unchanged; a slice that is too short is a fault of every lane.
    #[inline(always)]
    pub(crate) fn take_lanes<'a>(numbers: &mut [Self], of: impl Fn(usize) -> &'a [f64]) -> Self {
        let Some(zero) = numbers.first().map(|number| number.constant(0.0)) else { return Self::filled(0.0) };
        let length = numbers.len();
        // Slices of known equal length let the compiler check bounds once per block instead of once per row.
        let mut states: [&[f64]; MOST_LANES] = [&[]; MOST_LANES];
        for (lane, state) in states.iter_mut().enumerate().take(Self::LANES) {
            let given = of(lane);
            let Some(whole) = given.get(..length) else {
                return if given.is_empty() { zero } else { zero.constant(f64::NAN) };
            };
            *state = whole;
        }
        let mut faults = [zero; 4];
        let (squares, rest) = (length / Self::LANES, length % Self::LANES);
        for at in 0..squares {
            let run = at * Self::LANES..(at + 1) * Self::LANES;
            let block = zero.turned_over(|lane| cast_slice(&states[lane][run.clone()])[0]);
            let numbers = &mut numbers[run];
            for lane in 0..Self::LANES {
                numbers[lane].value = block[lane];
                faults[lane % 4] = numbers[lane].mul_add(zero, faults[lane % 4]);
            }
        }
        let run = last_run(length, Self::LANES);
        let numbers = &mut numbers[run.clone()];
        if rest != 0 && numbers.len() < Self::HALF {
            for (number, at) in numbers.iter_mut().zip(run) {
                for (lane, state) in states.iter().enumerate().take(Self::LANES) {
                    number.lanes_mut()[lane] = state[at];
                }
                faults[0] = number.mul_add(zero, faults[0]);
            }
        } else if rest != 0 {
            let block = if numbers.len() == Self::LANES {
                zero.turned_over(|lane| cast_slice(&states[lane][run.clone()])[0])
            } else {
                zero.turned_over(|lane| zero.simd.load_ends(&states[lane][run.clone()]))
            };
            let last = numbers.len() - Self::HALF;
            for lane in 0..Self::HALF {
                numbers[lane].value = block[lane];
                numbers[last + lane].value = block[Self::HALF + lane];
            }
            for lane in 0..Self::LANES {
                faults[lane % 4] = Self::new(zero.simd, block[lane]).mul_add(zero, faults[lane % 4]);
            }
        }
        (faults[0] + faults[1]) + (faults[2] + faults[3])
    }

    /// A transposed square block; `self` fills missing rows.
    #[inline(always)]
    fn turned_over(self, row: impl Fn(usize) -> S::f64s) -> [S::f64s; MOST_LANES] {
        let mut block = [self.value; MOST_LANES];
        for (lane, register) in block.iter_mut().enumerate().take(Self::LANES) {
            *register = row(lane);
        }
        self.simd.transpose(&mut block[..Self::LANES]);
        block
    }

    /// Writes the values of each lane one after another, for the number of lanes that fit into `out`.
    #[inline(always)]
    pub(crate) fn put_lanes(numbers: &[Self], out: &mut [f64]) {
        let square = |run: Range<usize>| Some(&numbers[run]).map(|numbers| move |lane: usize| numbers[lane].value);
        let Some(zero) = numbers.first().map(|number| number.constant(0.0)) else { return };
        zero.put(numbers.len(), (square, |at| numbers[at]), out);
    }

    /// As `put_lanes`, for the values with the indices `chosen` in `numbers`; index 0 stands for zero.
    #[inline(always)]
    pub(crate) fn put_chosen(numbers: &[Self], chosen: &[u32], out: &mut [f64]) {
        let square = |run: Range<usize>| {
            let chosen = &chosen[run];
            let are_zero = chosen.iter().fold(0, |any, &at| any | at) == 0;
            (!are_zero).then_some(move |lane: usize| numbers[chosen[lane] as usize].value)
        };
        let Some(zero) = numbers.first().map(|number| number.constant(0.0)) else { return };
        zero.put(chosen.len(), (square, |at| numbers[chosen[at] as usize]), out);
    }

    /// Writes `length` values per lane: `square` returns those of a range, or `None` if all are zero (`self`), and
    /// `number` returns a single one.
    #[inline(always)]
    fn put<R: Fn(usize) -> S::f64s>(
        self,
        length: usize,
        (square, number): (impl Fn(Range<usize>) -> Option<R>, impl Fn(usize) -> Self),
        out: &mut [f64],
    ) {
        let mut states: [&mut [f64]; MOST_LANES] = Default::default();
        for (state, out) in states.iter_mut().zip(out.chunks_exact_mut(length.max(1))) {
            *state = out;
        }
        for at in 0..length / Self::LANES {
            let run = at * Self::LANES..(at + 1) * Self::LANES;
            let block = match square(run.clone()) {
                Some(row) => self.turned_over(row),
                None => [self.value; MOST_LANES],
            };
            for lane in 0..Self::LANES {
                if let Some(to) = states[lane].get_mut(run.clone()) {
                    cast_slice_mut(to)[0] = block[lane];
                }
            }
        }
        let run = last_run(length, Self::LANES);
        if run.is_empty() {
            return;
        }
        if run.len() < Self::HALF {
            for (lane, state) in states.iter_mut().enumerate().filter(|(_, state)| !state.is_empty()) {
                for at in run.clone() {
                    state[at] = number(at).lanes()[lane];
                }
            }
            return;
        }
        let block = self.turned_over(|lane| {
            let at = if lane < Self::HALF { run.start + lane } else { run.end + lane - Self::LANES };
            number(at).value
        });
        for lane in 0..Self::LANES {
            let Some(to) = states[lane].get_mut(run.clone()) else { break };
            if to.len() == Self::LANES {
                cast_slice_mut(to)[0] = block[lane];
            } else {
                self.simd.store_ends(to, block[lane]);
            }
        }
    }
}

#[cfg(all(test, any(target_arch = "x86_64", target_arch = "aarch64")))]
mod tests {
    use super::*;
    use std::cmp::Ordering;

    /// Value `at` of a lane.
    fn number(lane: usize, at: usize) -> f64 {
        f64::from(u32::try_from(1 + at + 1000 * lane).expect("small"))
    }

    fn come_and_go<S: Instructions>() {
        if S::token().is_none() {
            return;
        }
        let lanes = Lanes::<S>::LANES;
        for length in 1..=3 * lanes + 1 {
            let states: Vec<Vec<f64>> =
                (0..lanes).map(|lane| (0..length).map(|at| number(lane, at)).collect()).collect();
            let slices: Vec<&[f64]> = states.iter().map(Vec::as_slice).collect();
            let mut numbers = vec![Lanes::<S>::filled(f64::NAN); length];
            let fault = Lanes::take_lanes(&mut numbers, |lane| slices[lane]);
            assert!(fault.lanes().iter().all(|&fault| fault == 0.0));
            for (at, number_of_all) in numbers.iter().enumerate() {
                for (lane, &found) in number_of_all.lanes().iter().enumerate() {
                    assert_eq!(found.to_bits(), number(lane, at).to_bits(), "{at} of {length}, lane {lane}");
                }
            }
            // Reversed, with value 0 inserted at the front; every third value is zero, and for three blocks the whole
            // first block.
            let is_zero = |i: usize| i.is_multiple_of(3) || (length > 2 * lanes && i < lanes);
            let zeros_and = [&[Lanes::filled(0.0)], numbers.as_slice()].concat();
            let place = |i: usize| if is_zero(i) { 0 } else { u32::try_from(length - i).expect("small") };
            let chosen: Vec<u32> = (0..length).map(place).collect();
            for count in [1, lanes / 2 + 1, lanes] {
                let mut out = vec![f64::NAN; count * length];
                Lanes::put_lanes(&numbers, &mut out);
                assert_eq!(out, states[..count].concat(), "{count} of {length}");
                out.fill(f64::NAN);
                Lanes::put_chosen(&zeros_and, &chosen, &mut out);
                for (at, &found) in out.iter().enumerate() {
                    let (lane, i) = (at / length, at % length);
                    let expected = if is_zero(i) { 0.0 } else { number(lane, length - 1 - i) };
                    assert_eq!(found.to_bits(), expected.to_bits(), "{at} chosen of {length}, lane {lane}");
                }
            }
            let before = numbers.clone();
            Lanes::take_lanes(&mut numbers, |_| &[]);
            assert_eq!(numbers, before, "empty slices leave all as it is");
            // A value that is not finite is reported for its lane, at any position.
            for at in 0..length {
                for odd in [f64::INFINITY, f64::NEG_INFINITY, f64::NAN] {
                    let mut states = states.clone();
                    states[lanes - 1][at] = odd;
                    let fault = Lanes::take_lanes(&mut numbers, |lane| &states[lane]);
                    for (lane, &fault) in fault.lanes().iter().enumerate() {
                        assert_eq!(fault == 0.0, lane != lanes - 1, "{odd} at {at} of {length}, lane {lane}");
                    }
                }
            }
        }
    }

    /// The smaller of two numbers in either order, and NaN with any operand.
    fn smaller_or_nan<S: Instructions>() {
        if S::token().is_none() {
            return;
        }
        let numbers = [f64::NEG_INFINITY, -1.5, -0.0, 0.0, 2.0, f64::INFINITY, f64::NAN, -f64::NAN];
        for a in numbers {
            for b in numbers {
                let expected = if a.is_nan() || b.is_nan() { f64::NAN } else { a.min(b) };
                for &found in Lanes::<S>::filled(a).worst(Lanes::filled(b)).lanes() {
                    // Both zeros are equal.
                    let same = found.partial_cmp(&expected) == Some(Ordering::Equal);
                    assert!(same || (found.is_nan() && expected.is_nan()), "{a} {b}: {found}");
                }
            }
        }
    }

    #[test]
    fn numbers_come_to_their_places_and_back_and_the_smaller_of_two_is_found() {
        #[cfg(target_arch = "x86_64")]
        {
            come_and_go::<pulp::x86::V3>();
            come_and_go::<pulp::x86::V4>();
            smaller_or_nan::<pulp::x86::V3>();
            smaller_or_nan::<pulp::x86::V4>();
        }
        #[cfg(target_arch = "aarch64")]
        {
            come_and_go::<pulp::aarch64::Neon>();
            smaller_or_nan::<pulp::aarch64::Neon>();
        }
    }
}
