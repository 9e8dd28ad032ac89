//! Numbers of several states into lanes, and out of them: squares of them, turned over in registers.
//!
//! What does not fill a square at the end is a square that lies over the one before it; or, of at least half as many numbers as there are lanes, one
//! whose upper half lies over its lower half. Steps are as many as the compiler knows: squares would live in memory otherwise.

use super::{Instructions, Lanes, Precision, Real};
use pulp::bytemuck::{cast_slice, cast_slice_mut};
use std::ops::Range;

/// As many lanes as any scalar has.
pub(crate) const MOST_LANES: usize = 16;

/// The last `lanes` of so many numbers, or all where they are fewer; none where whole squares leave none over.
#[inline(always)]
fn last_run(length: usize, lanes: usize) -> Range<usize> {
    if length.is_multiple_of(lanes) { 0..0 } else { length.saturating_sub(lanes)..length }
}

impl<S: Instructions, P: Precision> Lanes<S, P> {
    /// As many lanes as are half of all.
    const HALF: usize = Self::LANES / 2;

    /// A slice of each lane's numbers into lanes; empty slices leave all as it is.
    #[inline(always)]
    pub(crate) fn take_lanes(states: &[&[P]], numbers: &mut [Self]) {
        let Some(&Self { simd, value, .. }) = numbers.first() else { return };
        let length = numbers.len().min(states.iter().map(|state| state.len()).min().unwrap_or(0));
        let whole = length - length % Self::LANES;
        let mut block = [value; MOST_LANES];
        let mut registers: [&[P::Register<S>]; MOST_LANES] = [&[]; MOST_LANES];
        for lane in 0..Self::LANES {
            registers[lane] = cast_slice(&states[lane][..whole]);
        }
        for (at, numbers) in numbers[..whole].chunks_exact_mut(Self::LANES).enumerate() {
            for lane in 0..Self::LANES {
                block[lane] = registers[lane][at];
            }
            P::transpose(simd, &mut block[..Self::LANES]);
            for lane in 0..Self::LANES {
                numbers[lane].value = block[lane];
            }
        }
        let run = last_run(length, Self::LANES);
        let numbers = &mut numbers[run.clone()];
        if numbers.len() < Self::HALF {
            for (lane, state) in states.iter().enumerate() {
                for (number, &value) in numbers.iter_mut().zip(&state[run.clone()]) {
                    number.lanes_mut()[lane] = value;
                }
            }
            return;
        }
        if numbers.len() == Self::LANES {
            for lane in 0..Self::LANES {
                block[lane] = cast_slice(&states[lane][run.clone()])[0];
            }
        } else {
            for lane in 0..Self::LANES {
                block[lane] = P::load_ends(simd, &states[lane][run.clone()]);
            }
        }
        P::transpose(simd, &mut block[..Self::LANES]);
        for lane in 0..Self::HALF {
            numbers[lane].value = block[lane];
        }
        let last = numbers.len() - Self::HALF;
        let last = &mut numbers[last..];
        for lane in 0..Self::HALF {
            last[lane].value = block[Self::HALF + lane];
        }
    }

    /// Each lane's numbers one after another, of as many lanes as `out` has room for.
    #[inline(always)]
    pub(crate) fn put_lanes(numbers: &[Self], out: &mut [P]) {
        let Some(&Self { simd, value, .. }) = numbers.first() else { return };
        let length = numbers.len();
        let states = Self::squares(length, out);
        for (at, numbers) in numbers.chunks_exact(Self::LANES).enumerate() {
            let mut block = [value; MOST_LANES];
            for lane in 0..Self::LANES {
                block[lane] = numbers[lane].value;
            }
            P::transpose(simd, &mut block[..Self::LANES]);
            for lane in 0..Self::LANES {
                if let Some(to) = states[lane].get_mut(at) {
                    *to = block[lane];
                }
            }
        }
        Self::put_last(numbers, length, |at| at, out);
    }

    /// The same of as many numbers as `chosen` says, each by its place in `numbers`, of which number 0 is zero.
    #[inline(always)]
    pub(crate) fn put_chosen(numbers: &[Self], chosen: &[u32], out: &mut [P]) {
        let Some(&Self { simd, value, .. }) = numbers.first() else { return };
        let states = Self::squares(chosen.len(), out);
        for (at, chosen) in chosen.chunks_exact(Self::LANES).enumerate() {
            let mut block = [value; MOST_LANES];
            if chosen.iter().fold(0, |any, &at| any | at) != 0 {
                for lane in 0..Self::LANES {
                    block[lane] = numbers[chosen[lane] as usize].value;
                }
                P::transpose(simd, &mut block[..Self::LANES]);
            }
            for lane in 0..Self::LANES {
                if let Some(to) = states[lane].get_mut(at) {
                    *to = block[lane];
                }
            }
        }
        Self::put_last(numbers, chosen.len(), |at| chosen[at] as usize, out);
    }

    /// As much of each lane's `length` numbers as whole squares fill.
    #[inline(always)]
    fn squares(length: usize, out: &mut [P]) -> [&mut [P::Register<S>]; MOST_LANES] {
        let mut states: [&mut [P::Register<S>]; MOST_LANES] = Default::default();
        for (state, out) in states.iter_mut().zip(out.chunks_exact_mut(length)) {
            *state = cast_slice_mut(&mut out[..length - length % Self::LANES]);
        }
        states
    }

    /// What whole squares leave over of `length` numbers, the one at `at` being that at `place(at)` of `numbers`.
    #[inline(always)]
    fn put_last(numbers: &[Self], length: usize, place: impl Fn(usize) -> usize, out: &mut [P]) {
        let run = last_run(length, Self::LANES);
        let Some(&Self { simd, value, .. }) = numbers.first().filter(|_| !run.is_empty()) else { return };
        let states = out.chunks_exact_mut(length);
        if run.len() < Self::HALF {
            for (lane, out) in states.enumerate() {
                for at in run.clone() {
                    out[at] = numbers[place(at)].lanes()[lane];
                }
            }
            return;
        }
        let mut block = [value; MOST_LANES];
        for lane in 0..Self::HALF {
            block[lane] = numbers[place(run.start + lane)].value;
            block[Self::HALF + lane] = numbers[place(run.end - Self::HALF + lane)].value;
        }
        P::transpose(simd, &mut block[..Self::LANES]);
        for (out, &row) in states.zip(&block) {
            let to = &mut out[run.clone()];
            if to.len() == Self::LANES {
                cast_slice_mut(to)[0] = row;
            } else {
                P::store_ends(simd, to, row);
            }
        }
    }
}

#[cfg(all(test, any(target_arch = "x86_64", target_arch = "aarch64")))]
mod tests {
    use super::*;

    /// Number `at` of a lane.
    fn number<P: Precision>(lane: usize, at: usize) -> P {
        P::nearest(f64::from(u32::try_from(1 + at + 1000 * lane).expect("small")))
    }

    fn come_and_go<S: Instructions, P: Precision>() {
        if S::token().is_none() {
            return;
        }
        let lanes = Lanes::<S, P>::LANES;
        for length in 1..=3 * lanes + 1 {
            let states: Vec<Vec<P>> = (0..lanes).map(|lane| (0..length).map(|at| number(lane, at)).collect()).collect();
            let slices: Vec<&[P]> = states.iter().map(Vec::as_slice).collect();
            let mut numbers = vec![Lanes::<S, P>::splat(f64::NAN); length];
            Lanes::take_lanes(&slices, &mut numbers);
            for (at, number_of_all) in numbers.iter().enumerate() {
                for (lane, &found) in number_of_all.lanes().iter().enumerate() {
                    assert_eq!(found, number(lane, at), "{} of {length}, lane {lane}", P::NAME);
                }
            }
            // Backwards, with number 0 put before all; every third number left zero, and where there are three squares all of the first.
            let is_zero = |i: usize| i.is_multiple_of(3) || (length > 2 * lanes && i < lanes);
            let zeros_and = [&[Lanes::splat(0.0)], numbers.as_slice()].concat();
            let place = |i: usize| if is_zero(i) { 0 } else { u32::try_from(length - i).expect("small") };
            let chosen: Vec<u32> = (0..length).map(place).collect();
            for count in [1, lanes / 2 + 1, lanes] {
                let mut out = vec![P::nearest(f64::NAN); count * length];
                Lanes::put_lanes(&numbers, &mut out);
                assert_eq!(out, states[..count].concat(), "{} of {length}", P::NAME);
                out.fill(P::nearest(f64::NAN));
                Lanes::put_chosen(&zeros_and, &chosen, &mut out);
                for (at, &found) in out.iter().enumerate() {
                    let (lane, i) = (at / length, at % length);
                    let expected = if is_zero(i) { P::default() } else { number(lane, length - 1 - i) };
                    assert_eq!(found, expected, "{} chosen of {length}, lane {lane}", P::NAME);
                }
            }
            let before = numbers.clone();
            Lanes::take_lanes(&vec![&[] as &[P]; lanes], &mut numbers);
            assert_eq!(numbers, before, "empty slices leave all as it is");
        }
    }

    #[test]
    fn every_number_comes_to_its_place_and_back() {
        #[cfg(target_arch = "x86_64")]
        {
            come_and_go::<pulp::x86::V3, f64>();
            come_and_go::<pulp::x86::V3, f32>();
            come_and_go::<pulp::x86::V4, f64>();
            come_and_go::<pulp::x86::V4, f32>();
        }
        #[cfg(target_arch = "aarch64")]
        {
            come_and_go::<pulp::aarch64::Neon, f64>();
            come_and_go::<pulp::aarch64::Neon, f32>();
        }
    }
}
