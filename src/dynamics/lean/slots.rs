//! Places for what lives only until the last body that reads it is done.

/// The place of each body's number, and how many places there are.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Slots {
    /// For each body its place; 0 is the base's.
    pub of: Vec<usize>,
    /// How many places, the base's included.
    pub count: usize,
}

impl Slots {
    /// Base to tip: a body's number is written at its own step and read at its children's. A leaf's is not read.
    pub fn outward(parents: &[Option<usize>]) -> Self {
        let last_reader = last_children(parents);
        Self::assign(parents.len(), 0..parents.len(), |k| last_reader[k].map(|last| (k, last)))
    }

    /// Tip to base: a body's number is begun at its last child's step and read at its own.
    pub fn inward(parents: &[Option<usize>]) -> Self {
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
pub(super) struct Places {
    /// Its place and its parent's, outward; 0 is the base's.
    pub outward: usize,
    pub parent_outward: usize,
    /// The place of what arrives at it and at its parent, inward; 0 where nothing does.
    pub inward: usize,
    pub parent_inward: usize,
    /// Whether it is the first to arrive at its parent, inward: outward, the last that reads it.
    pub arrives_first: bool,
    /// One past its parent in that order; 0 is the base.
    pub parent: usize,
}

impl Places {
    /// Of every body, in an order that has parents first; and how many places there are, outward and inward.
    pub fn of(parents: &[Option<usize>], order: &[usize]) -> (Vec<Self>, [usize; 2]) {
        let mut at = vec![0; order.len()];
        for (i, &k) in order.iter().enumerate() {
            at[k] = i;
        }
        let in_order: Vec<_> = order.iter().map(|&k| parents[k].map(|parent| at[parent])).collect();
        let (outward, inward) = (Slots::outward(&in_order), Slots::inward(&in_order));
        let last_child = last_children(&in_order);
        let place = |slots: &Slots, body: Option<usize>| body.map_or(0, |body| slots.of[body]);
        let places = at.iter().map(|&i| Self {
            outward: outward.of[i],
            parent_outward: place(&outward, in_order[i]),
            inward: inward.of[i],
            parent_inward: place(&inward, in_order[i]),
            arrives_first: in_order[i].is_some_and(|parent| last_child[parent] == Some(i)),
            parent: in_order[i].map_or(0, |parent| parent + 1),
        });
        (places.collect(), [outward.count, inward.count])
    }
}

/// The last child of each body.
pub(super) fn last_children(parents: &[Option<usize>]) -> Vec<Option<usize>> {
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
    use super::Slots;

    /// Parents of a tree with branches, and of a chain.
    const TREE: [Option<usize>; 9] = [None, Some(0), Some(1), Some(1), Some(0), Some(4), Some(5), Some(4), None];

    #[test]
    fn no_body_overwrites_what_is_still_read() {
        for parents in [TREE.to_vec(), (0..20_usize).map(|k| k.checked_sub(1)).collect()] {
            let slots = Slots::outward(&parents);
            let mut held = vec![usize::MAX; slots.count];
            for (k, parent) in parents.iter().enumerate() {
                if let Some(parent) = *parent {
                    assert_eq!(held[slots.of[parent]], parent, "body {k} reads its parent's place");
                    assert_ne!(slots.of[parent], slots.of[k]);
                }
                if parents.contains(&Some(k)) {
                    held[slots.of[k]] = k;
                }
            }
            let slots = Slots::inward(&parents);
            let mut held = vec![usize::MAX; slots.count];
            for (k, parent) in parents.iter().enumerate().rev() {
                if parents.contains(&Some(k)) {
                    assert_eq!(held[slots.of[k]], k, "body {k} reads its own place");
                }
                if let Some(parent) = *parent
                    && held[slots.of[parent]] != parent
                {
                    assert_eq!(parents.iter().rposition(|&p| p == Some(parent)), Some(k));
                    held[slots.of[parent]] = parent;
                }
            }
        }
        assert_eq!(Slots::outward(&TREE).count, 3);
        assert_eq!(Slots::inward(&[None, Some(0), Some(1), Some(2)]).count, 3);
    }
}
