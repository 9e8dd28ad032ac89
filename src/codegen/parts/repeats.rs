//! Repeated long sequences of words: equal limbs lead to such sequences in a program.

use std::collections::BinaryHeap;

/// A shorter sequence is not worth a separate function: with a minimum of 64, derivatives of a humanoid took a third
/// longer than without parts.
const SHORTEST: usize = 128;
/// A longer sequence is split.
const LONGEST: usize = 2048;

/// The same words at several places that do not overlap.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Repeat {
    pub length: usize,
    /// The places at which it begins, in order; at least two.
    pub starts: Vec<usize>,
}

/// Sequences that occur more than once, without overlaps, selected one after another by the number of words that each
/// saves.
///
/// The suffixes are sorted, and common prefixes of adjacent suffixes are the candidates. This is repeated without the
/// selected words until no candidate is left. O(n log^2 n) per round, with few rounds.
pub(super) fn repeats(words: &[u32]) -> Vec<Repeat> {
    let mut words = words.to_vec();
    let mut all = Vec::new();
    let mut fresh = words.iter().max().map_or(0, |&word| word + 1);
    loop {
        let found = one_round(&words);
        if found.is_empty() {
            return all;
        }
        // The chosen operations become words that occur once.
        for repeat in &found {
            for &start in &repeat.starts {
                for word in &mut words[start..start + repeat.length] {
                    *word = fresh;
                    fresh += 1;
                }
            }
        }
        all.extend(found);
    }
}

/// A candidate: the number of words that the suffixes of this range share.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    length: usize,
    first: usize,
    end: usize,
}

fn one_round(words: &[u32]) -> Vec<Repeat> {
    let sorted = sorted_suffixes(words);
    let candidates = candidates(&in_common(words, &sorted));
    // An upper bound on the words that it saves; previous selections reduce it.
    let most = |of: &Candidate| of.length * (of.end - of.first - 1);
    let mut queue: BinaryHeap<(usize, usize)> =
        candidates.iter().enumerate().map(|(at, candidate)| (most(candidate), at)).collect();
    let (mut is_taken, mut found) = (vec![false; words.len()], Vec::new());
    while let Some((promised, at)) = queue.pop() {
        let Candidate { length, first, end } = candidates[at];
        let starts = free_places(length, &sorted[first..end], &is_taken);
        let saved = length * starts.len().saturating_sub(1);
        if saved == 0 {
            continue;
        }
        if saved < promised {
            queue.push((saved, at));
            continue;
        }
        for &start in &starts {
            is_taken[start..start + length].fill(true);
        }
        found.push(Repeat { length, starts });
    }
    found
}

/// The places at which `length` words are free, in order, without overlaps.
fn free_places(length: usize, places: &[u32], is_taken: &[bool]) -> Vec<usize> {
    let mut places: Vec<usize> = places.iter().map(|&place| place as usize).collect();
    places.sort_unstable();
    let mut end = 0;
    places.retain(|&place| {
        let is_free = place >= end && !is_taken[place..place + length].contains(&true);
        if is_free {
            end = place + length;
        }
        is_free
    });
    places
}

/// The beginnings of the suffixes, in the order of their first [`LONGEST`] words.
fn sorted_suffixes(words: &[u32]) -> Vec<u32> {
    let mut sorted: Vec<u32> = (0..words.len()).map(|at| u32::try_from(at).unwrap_or(u32::MAX)).collect();
    let mut rank: Vec<u32> = words.iter().map(|&word| word + 1).collect();
    let mut next = vec![0; words.len()];
    let mut width = 0;
    while width < LONGEST {
        // Compares twice the number of words of the previous ranks.
        let key = |at: u32| {
            let at = at as usize;
            let behind = if width == 0 { None } else { rank.get(at + width) };
            (rank[at], behind.copied().unwrap_or(0))
        };
        sorted.sort_unstable_by_key(|&at| key(at));
        let mut last = 0;
        for pair in 0..sorted.len() {
            if pair == 0 || key(sorted[pair - 1]) != key(sorted[pair]) {
                last += 1;
            }
            next[sorted[pair] as usize] = last;
        }
        std::mem::swap(&mut rank, &mut next);
        width = if width == 0 { 1 } else { 2 * width };
    }
    sorted
}

/// Number of words that each sorted suffix shares with its predecessor, at most [`LONGEST`].
fn in_common(words: &[u32], sorted: &[u32]) -> Vec<usize> {
    let same = |pair: &[u32]| {
        let (a, b) = (&words[pair[0] as usize..], &words[pair[1] as usize..]);
        a.iter().zip(b).take(LONGEST).take_while(|(a, b)| a == b).count()
    };
    std::iter::once(0).chain(sorted.windows(2).map(same)).collect()
}

/// The ranges of suffixes that share at least [`SHORTEST`] words, each with the number of words.
fn candidates(in_common: &[usize]) -> Vec<Candidate> {
    let (mut open, mut found): (Vec<Candidate>, Vec<Candidate>) = (Vec::new(), Vec::new());
    for (at, &length) in in_common.iter().chain([&0]).enumerate() {
        let mut first = at.saturating_sub(1);
        while let Some(last) = open.pop_if(|last| last.length > length) {
            first = last.first;
            found.push(Candidate { end: at, ..last });
        }
        if length >= SHORTEST && open.last().is_none_or(|last| last.length < length) {
            open.push(Candidate { length, first, end: at });
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::{LONGEST, Repeat, SHORTEST, repeats};

    /// `count` words that do not occur elsewhere.
    fn once(from: u32, count: usize) -> Vec<u32> {
        (from..).take(count).collect()
    }

    #[test]
    fn what_is_said_once_is_no_repeat() {
        assert!(repeats(&[]).is_empty());
        assert!(repeats(&once(0, 5000)).is_empty());
        let short = once(0, SHORTEST - 1);
        assert!(repeats(&[&short[..], &[7000], &short[..]].concat()).is_empty());
    }

    #[test]
    fn limbs_are_found_side_by_side_and_apart() {
        let limb = once(0, 150);
        let words = [&once(1000, 40), &limb, &limb, &limb, &once(2000, 9), &limb].map(|part| &part[..]).concat();
        assert_eq!(repeats(&words), [Repeat { length: 150, starts: vec![40, 190, 340, 499] }]);
    }

    #[test]
    fn what_is_left_is_looked_through_again() {
        let (long, short) = (once(0, 400), once(500, 200));
        // In the second occurrence the order of the two is different.
        let words = [&long, &short, &once(2000, 3), &short, &long].map(|part| &part[..]).concat();
        let mut found = repeats(&words);
        found.sort_by_key(|repeat| repeat.length);
        let expected = [(200, [400, 603]), (400, [0, 803])];
        assert_eq!(found, expected.map(|(length, starts)| Repeat { length, starts: starts.to_vec() }));
    }

    #[test]
    fn one_word_again_and_again_is_cut_where_it_saves_most() {
        let found = repeats(&vec![3; 1000]);
        let covered: usize = found.iter().map(|repeat| repeat.length * repeat.starts.len()).sum();
        assert!(covered > 900 && covered <= 1000, "{found:?}");
    }

    #[test]
    fn very_long_parts_are_said_in_several() {
        let limb = once(0, 3 * LONGEST / 2);
        let found = repeats(&[&limb[..], &limb[..]].concat());
        assert!(found.iter().all(|repeat| repeat.length <= LONGEST && repeat.starts.len() == 2), "{found:?}");
        assert_eq!(found.iter().map(|repeat| repeat.length).sum::<usize>(), limb.len());
    }
}
