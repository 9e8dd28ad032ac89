//! The order of the passes, and the slots of their store: reused after the last body that reads them, or one per body.

/// The largest number of bodies that the passes reorder: their data fits in the caches in any order. Larger numbers
/// have not been measured.
const INTERLEAVED: usize = 500;

/// The number of bodies between each body and the base.
pub(in crate::dynamics) fn bodies_inward(parents: &[Option<usize>]) -> Vec<usize> {
    let mut counts: Vec<usize> = Vec::with_capacity(parents.len());
    for parent in parents {
        counts.push(parent.map_or(0, |parent| counts[parent] + 1));
    }
    counts
}

/// The order of the passes, parents first. Bodies at equal depth follow each other: they do not depend on each other,
/// and their parents are some steps back.
pub(in crate::dynamics) fn interleaved(parents: &[Option<usize>]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..parents.len()).collect();
    if parents.len() <= INTERLEAVED {
        let bodies_inward = bodies_inward(parents);
        order.sort_by_key(|&k| bodies_inward[k]);
    }
    order
}

/// The slot of each body, and the number of slots.
#[derive(Debug, Clone, PartialEq)]
struct Slots {
    /// The slot of each body. Slot 0 belongs to the base in the outward pass, and to leaves in the inward pass.
    of: Vec<usize>,
    /// The number of slots, slot 0 included.
    count: usize,
}

impl Slots {
    /// Base to tip: the slot of a body is written at its own step and read at the steps of its children. The slot of a
    /// leaf is not read.
    fn outward(parents: &[Option<usize>]) -> Self {
        let last_reader = last_children(parents);
        Self::assign(parents.len(), 0..parents.len(), |k| last_reader[k].map(|last| (k, last)))
    }

    /// Tip to base: the slot of a body is first written at the step of its last child, and read at its own step.
    fn inward(parents: &[Option<usize>]) -> Self {
        let first_writer = last_children(parents);
        let n = parents.len();
        Self::assign(n, (0..n).rev(), |k| first_writer[k].map(|last| (last, k)))
    }

    /// Assigns slots. `life`: the step at which the slot of a body is taken and the step after which it is free.
    fn assign(n: usize, steps: impl Iterator<Item = usize>, life: impl Fn(usize) -> Option<(usize, usize)>) -> Self {
        let (mut taken_at, mut freed_at) = (vec![Vec::new(); n], vec![Vec::new(); n]);
        for body in 0..n {
            if let Some((first, last)) = life(body) {
                taken_at[first].push(body);
                freed_at[last].push(body);
            }
        }
        let (mut of, mut count, mut free) = (vec![0; n], 1, Vec::new());
        for step in steps {
            // A slot that is assigned at a step is never one that is read at that step.
            for &body in &taken_at[step] {
                of[body] = free.pop().unwrap_or_else(|| {
                    count += 1;
                    count - 1
                });
            }
            free.extend(freed_at[step].iter().map(|&body| of[body]));
        }
        Self { of, count }
    }
}

/// The slots of a body, in one order of the bodies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::dynamics) struct Places {
    /// Its slot and that of its parent, outward; 0 is the base.
    pub outward: usize,
    pub parent_outward: usize,
    /// The slots of the sums over its children and over those of its parent, inward; 0 if there are none.
    pub inward: usize,
    pub parent_inward: usize,
    /// True if it is the first summand at its parent, inward; outward it is the last that reads the parent.
    pub accumulates_first: bool,
    /// One past the place of its parent in that order; 0 is the base.
    pub parent: usize,
}

/// The numbers of slots, slot 0 included.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::dynamics) struct SlotCounts {
    pub outward: usize,
    pub inward: usize,
}

/// The bodies in one order, parents first.
pub(in crate::dynamics) struct Ordered {
    /// The place of each body in the order.
    pub at: Vec<usize>,
    pub places: Vec<Places>,
    pub slots: SlotCounts,
}

impl Ordered {
    /// The bodies in their own order, each with its own slot in both directions, so that the store keeps the results of
    /// every body.
    pub fn keeping_all(parents: &[Option<usize>]) -> Self {
        let last_child = last_children(parents);
        let places = parents.iter().enumerate().map(|(k, &parent)| {
            let parent_slot = parent.map_or(0, |parent| parent + 1);
            Places {
                outward: k + 1,
                parent_outward: parent_slot,
                inward: k + 1,
                parent_inward: parent_slot,
                accumulates_first: parent.is_some_and(|parent| last_child[parent] == Some(k)),
                parent: parent_slot,
            }
        });
        let count = parents.len() + 1;
        let slots = SlotCounts { outward: count, inward: count };
        Self { at: (0..parents.len()).collect(), places: places.collect(), slots }
    }

    /// The bodies in an order, with slots that are reused after the last body that reads them.
    pub fn new(parents: &[Option<usize>], order: &[usize]) -> Self {
        let mut at = vec![0; order.len()];
        for (i, &k) in order.iter().enumerate() {
            at[k] = i;
        }
        let of_order: Vec<_> = order.iter().map(|&k| parents[k].map(|parent| at[parent])).collect();
        let (outward, inward) = (Slots::outward(&of_order), Slots::inward(&of_order));
        let last_child = last_children(&of_order);
        let place = |slots: &Slots, body: Option<usize>| body.map_or(0, |body| slots.of[body]);
        let places = at.iter().map(|&i| Places {
            outward: outward.of[i],
            parent_outward: place(&outward, of_order[i]),
            inward: inward.of[i],
            parent_inward: place(&inward, of_order[i]),
            accumulates_first: of_order[i].is_some_and(|parent| last_child[parent] == Some(i)),
            parent: of_order[i].map_or(0, |parent| parent + 1),
        });
        Self { places: places.collect(), slots: SlotCounts { outward: outward.count, inward: inward.count }, at }
    }
}

/// The last child of each body.
pub(in crate::dynamics) fn last_children(parents: &[Option<usize>]) -> Vec<Option<usize>> {
    let mut last = vec![None; parents.len()];
    for (k, parent) in parents.iter().enumerate() {
        if let Some(parent) = *parent {
            last[parent] = Some(k);
        }
    }
    last
}

#[cfg(test)]
mod tests {
    use super::{Ordered, Places, interleaved};
    use std::collections::BTreeSet;

    /// Parents of a tree with branches, and of a chain.
    const TREE: [Option<usize>; 9] = [None, Some(0), Some(1), Some(1), Some(0), Some(4), Some(5), Some(4), None];

    /// Each body has its own slot in both directions, and reads and adds to that of its parent.
    #[test]
    fn a_store_that_keeps_everything_has_one_slot_per_body() {
        let Ordered { places, slots, .. } = Ordered::keeping_all(&TREE);
        for of in [|places: &Places| places.outward, |places: &Places| places.inward] {
            let taken: BTreeSet<usize> = places.iter().map(of).collect();
            assert!(taken.len() == TREE.len() && !taken.contains(&0) && taken.iter().all(|&slot| slot < slots.inward));
        }
        for (k, parent) in TREE.iter().enumerate() {
            let expected = parent.map_or([0; 3], |parent| [places[parent].outward, places[parent].inward, parent + 1]);
            assert_eq!([places[k].parent_outward, places[k].parent_inward, places[k].parent], expected);
        }
        assert_eq!(slots.outward, slots.inward);
    }

    #[test]
    fn no_body_overwrites_what_is_still_read() {
        for parents in [TREE.to_vec(), (0..20_usize).map(|k| k.checked_sub(1)).collect()] {
            let rows: Vec<usize> = (0..parents.len()).collect();
            for order in [rows, interleaved(&parents)] {
                let Ordered { at, places, slots } = Ordered::new(&parents, &order);
                let mut held = vec![usize::MAX; slots.outward];
                for &k in &order {
                    let place = &places[k];
                    if let Some(parent) = parents[k] {
                        assert_eq!(held[place.parent_outward], parent, "body {k} reads its parent's place");
                        assert_ne!(place.parent_outward, place.outward);
                    }
                    assert_eq!(place.parent, parents[k].map_or(0, |parent| at[parent] + 1));
                    if parents.contains(&Some(k)) {
                        held[place.outward] = k;
                    }
                }
                let mut held = vec![usize::MAX; slots.inward];
                for &k in order.iter().rev() {
                    let place = &places[k];
                    if parents.contains(&Some(k)) {
                        assert_eq!(held[place.inward], k, "body {k} reads its own place");
                    } else {
                        assert_eq!(place.inward, 0, "nothing arrives at {k}");
                    }
                    if let Some(parent) = parents[k] {
                        assert_eq!(place.accumulates_first, held[place.parent_inward] != parent);
                        assert_ne!(place.parent_inward, 0);
                        held[place.parent_inward] = parent;
                    }
                }
            }
        }
        let counts = |parents: &[Option<usize>]| {
            let slots = Ordered::new(parents, &(0..parents.len()).collect::<Vec<_>>()).slots;
            (slots.outward, slots.inward)
        };
        assert_eq!(counts(&TREE).0, 3);
        assert_eq!(counts(&[None, Some(0), Some(1), Some(2)]).1, 3);
        assert_eq!(interleaved(&TREE), [0, 8, 1, 4, 2, 3, 5, 7, 6]);
    }
}
