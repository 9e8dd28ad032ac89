//! The order of the sweeps, and places for what lives only until the last body that reads it is done.

/// As many bodies are swept in an order of their own: what is kept of them fits in the caches then, whatever the order. Not timed beyond.
const INTERLEAVED: usize = 500;

/// How many bodies there are between each and the base.
pub(in crate::dynamics) fn bodies_inward(parents: &[Option<usize>]) -> Vec<usize> {
    let mut counts: Vec<usize> = Vec::with_capacity(parents.len());
    for parent in parents {
        counts.push(parent.map_or(0, |parent| counts[parent] + 1));
    }
    counts
}

/// The order of the sweeps, parents first: those at equal depth one after another, for they do not wait for each
/// other, and what a body waits for was done a while ago.
pub(in crate::dynamics) fn interleaved(parents: &[Option<usize>]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..parents.len()).collect();
    if parents.len() <= INTERLEAVED {
        let bodies_inward = bodies_inward(parents);
        order.sort_by_key(|&k| bodies_inward[k]);
    }
    order
}

/// The place of each body's number, and how many places there are.
#[derive(Debug, Clone, PartialEq)]
struct Slots {
    /// For each body its place; 0 is the base's outward, and inward that of what nothing hangs on.
    of: Vec<usize>,
    /// How many places, that one included.
    count: usize,
}

impl Slots {
    /// Base to tip: a body's number is written at its own step and read at its children's. A leaf's is not read.
    fn outward(parents: &[Option<usize>]) -> Self {
        let last_reader = last_children(parents);
        Self::assign(parents.len(), 0..parents.len(), |k| last_reader[k].map(|last| (k, last)))
    }

    /// Tip to base: a body's number is begun at its last child's step and read at its own.
    fn inward(parents: &[Option<usize>]) -> Self {
        let first_writer = last_children(parents);
        let n = parents.len();
        Self::assign(n, (0..n).rev(), |k| first_writer[k].map(|last| (last, k)))
    }

    /// Steps in order, with the step at which a body's place is taken and the one after which it is free.
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
            // What is taken at a step never shares a place with what is read at it.
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

/// Where a body's vectors are, in one order of the bodies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::dynamics) struct Places {
    /// Its place and its parent's, outward; 0 is the base's.
    pub outward: usize,
    pub parent_outward: usize,
    /// The place of what arrives at it and at its parent, inward; 0 where nothing does.
    pub inward: usize,
    pub parent_inward: usize,
    /// Whether it is the first that arrives at its parent, inward: outward, the last that reads it.
    pub arrives_first: bool,
    /// One past its parent in that order; 0 is the base.
    pub parent: usize,
}

/// How many slots there are; the first is the base's outward, and nothing's inward.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::dynamics) struct SlotCounts {
    pub outward: usize,
    pub inward: usize,
}

/// The bodies in one order, which has parents first.
pub(in crate::dynamics) struct Ordered {
    /// Where each body is in it.
    pub at: Vec<usize>,
    pub places: Vec<Places>,
    pub slots: SlotCounts,
}

impl Ordered {
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
            arrives_first: of_order[i].is_some_and(|parent| last_child[parent] == Some(i)),
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
    use super::{Ordered, interleaved};

    /// Parents of a tree with branches, and of a chain.
    const TREE: [Option<usize>; 9] = [None, Some(0), Some(1), Some(1), Some(0), Some(4), Some(5), Some(4), None];

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
                        assert_eq!(place.arrives_first, held[place.parent_inward] != parent);
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
