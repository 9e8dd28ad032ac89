//! Limbs of like build side by side: one state's legs in the lanes of a register.
//!
//! Two bodies are alike where the same code does for both: joints of a kind, about the same axes, levers and noise where the other has them; their
//! numbers are their own. A *bundle* is as many of them as there are lanes, or fewer. Limbs begin with bodies that hang on one, or on the base; further
//! out each keeps its lane, and a body that only some of them have leaves the others' lanes without meaning. What limbs send to the body that
//! they hang on arrives one after another, in the order that they have as bodies by themselves, so that no bit of a result depends on
//! whether they went side by side.

use super::body::{Carrier, INTERLEAVED};
use super::frames::Framed;
use super::tilt::Axle;
use super::turn::{Axis, Renaming};
use crate::scene::{Model, Motion};
use std::collections::HashMap;
use std::mem::discriminant;

/// As many limbs side by side as any scalar has.
#[cfg(target_arch = "x86_64")]
pub(super) const ABREAST: usize = <crate::scalar::Limbs as crate::scalar::Real>::LIMBS;
#[cfg(not(target_arch = "x86_64"))]
pub(super) const ABREAST: usize = 1;

/// Bodies side by side.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Bundle {
    /// One for each limb; none of a limb that has no such body. There is one at least.
    pub bodies: Vec<Option<usize>>,
    /// The bundle that they hang on.
    pub parent: Option<usize>,
}

impl Bundle {
    /// The first that is there.
    pub fn first(&self) -> usize {
        self.bodies.iter().flatten().copied().min().unwrap_or(0)
    }
}

/// What decides which code a body runs.
#[allow(clippy::struct_excessive_bools)] // facts, each by itself
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
struct Kind {
    /// Of a turn, and where it is tilted whether about z too.
    turn: Option<(Axis, Option<bool>)>,
    motion: std::mem::Discriminant<Motion<f64>>,
    /// Of a slide by constant angles, from which axis they are, and whether about z too.
    slide: Option<(Axis, bool)>,
    from: [u8; 3],
    has_lever: bool,
    needs_no_force: bool,
    is_off_axis: bool,
    is_noise_free: bool,
    is_measured: bool,
}

/// The bodies of a tree, and how they compare.
struct Likeness {
    children: Vec<Vec<usize>>,
    /// None of bodies that have no like.
    kinds: Vec<Option<Kind>>,
    /// The same number for bodies that are alike with all outboard.
    builds: Vec<usize>,
    /// How many bodies there are from each outward.
    sizes: Vec<usize>,
}

impl Likeness {
    fn of(model: &Model<f64>, framed: &Framed) -> Self {
        let (stages, system) = (&model.system.stages, &model.system);
        let kind = |k: usize| {
            let (body, rows) = (&model.bodies[k], &stages[k].rows);
            let row = stages[k].first_row..stages[k].first_row + rows.count();
            // A pitch is part of the system, which has one number for all lanes.
            (!matches!(body.motion, Motion::Screw(_))).then(|| Kind {
                turn: match framed.carriers[k] {
                    Carrier::Turn(Axle::Straight(axis)) => Some((axis, None)),
                    Carrier::Turn(Axle::Tilted(at)) => {
                        Some((framed.tilts[at].axis, Some(framed.tilts[at].turns_about_z)))
                    }
                    Carrier::Shift(_) => None,
                },
                motion: discriminant(&body.motion),
                slide: framed.slide_at[k].map(|at| {
                    let tilt = &framed.slides[at].tilt;
                    (tilt.axis, tilt.turns_about_z)
                }),
                from: Renaming::of(&framed.from_model[k], |x| x).from,
                has_lever: body.tree.lever.iter().any(|&x| x != 0.0),
                needs_no_force: body.needs_no_force,
                is_off_axis: framed.loads[k].is_off_axis,
                is_noise_free: row.clone().all(|row| system.is_noise_free(row)),
                is_measured: row.clone().all(|row| system.is_measured(row)),
            })
        };
        let kinds: Vec<_> = (0..stages.len()).map(kind).collect();
        let (mut children, mut sizes) = (vec![Vec::new(); stages.len()], vec![1; stages.len()]);
        let (mut builds, mut known) = (vec![0; stages.len()], HashMap::new());
        for (k, stage) in stages.iter().enumerate().rev() {
            let outboard: &mut Vec<usize> = &mut children[k];
            outboard.reverse();
            let mut of_children: Vec<_> = outboard.iter().map(|&child| builds[child]).collect();
            of_children.sort_unstable();
            let next = known.len();
            // What has no like is of a build of its own.
            let alone = if kinds[k].is_none() { k + 1 } else { 0 };
            builds[k] = *known.entry((kinds[k], alone, of_children)).or_insert(next);
            if let Some(parent) = stage.parent {
                children[parent].push(k);
                sizes[parent] += sizes[k];
            }
        }
        Self { children, kinds, builds, sizes }
    }

    fn are_alike(&self, a: usize, b: usize) -> bool {
        self.kinds[a].is_some() && self.kinds[a] == self.kinds[b]
    }

    /// How many bodies two limbs have in common, if children are matched as [`across`](Self::across) does.
    fn in_common(&self, a: usize, b: usize) -> usize {
        if self.builds[a] == self.builds[b] {
            return self.sizes[a];
        }
        if !self.are_alike(a, b) {
            return 0;
        }
        let groups = self.across(&[Some(a), Some(b)]);
        1 + groups.iter().filter_map(|group| Some(self.in_common(group[0]?, group[1]?))).sum::<usize>()
    }

    /// The children of bodies side by side, side by side: those of equal build, then those alike, each in its limb's lane.
    fn across(&self, bodies: &[Option<usize>]) -> Vec<Vec<Option<usize>>> {
        let mut groups: Vec<Vec<Option<usize>>> = Vec::new();
        for by_build in [true, false] {
            for (limb, body) in bodies.iter().enumerate() {
                for &child in body.map_or(&[][..], |body| &self.children[body]) {
                    if groups.iter().any(|group| group[limb] == Some(child)) {
                        continue;
                    }
                    let with = groups.iter().position(|group| {
                        let like = group.iter().flatten().next().is_some_and(|&first| {
                            if by_build {
                                self.builds[first] == self.builds[child]
                            } else {
                                self.are_alike(first, child)
                            }
                        });
                        group[limb].is_none() && like
                    });
                    if let Some(with) = with {
                        groups[with][limb] = Some(child);
                    } else if limb == 0 || !by_build {
                        // Of another limb, by build, one that is only alike may come yet.
                        let mut group = vec![None; bodies.len()];
                        group[limb] = Some(child);
                        groups.push(group);
                    }
                }
            }
        }
        groups
    }

    /// Bodies that hang on one, or on the base: limbs side by side, as many as may be.
    fn limbs(&self, bodies: &[usize]) -> Vec<Vec<Option<usize>>> {
        let mut groups: Vec<Vec<Option<usize>>> = Vec::new();
        for &body in bodies {
            let with = groups.iter_mut().find(|group| {
                // More than half of both, or what each has alone would be done in vain for the other.
                let in_common =
                    |first: usize| 2 * self.in_common(first, body) > self.sizes[first].max(self.sizes[body]);
                group.len() < ABREAST && group[0].is_some_and(|first| self.are_alike(first, body) && in_common(first))
            });
            match with {
                Some(group) => group.push(Some(body)),
                None => groups.push(vec![Some(body)]),
            }
        }
        groups
    }
}

/// The bodies of a scene in bundles, parents first; each by itself in a large scene.
pub(super) fn bundles(model: &Model<f64>, framed: &Framed) -> Vec<Bundle> {
    let stages = &model.system.stages;
    if stages.len() > INTERLEAVED || ABREAST == 1 {
        let alone =
            |(k, stage): (usize, &crate::filter::Stage<f64>)| Bundle { bodies: vec![Some(k)], parent: stage.parent };
        return stages.iter().enumerate().map(alone).collect();
    }
    let likeness = Likeness::of(model, framed);
    let roots: Vec<_> = (0..stages.len()).filter(|&k| stages[k].parent.is_none()).collect();
    let mut bundles: Vec<_> =
        likeness.limbs(&roots).into_iter().map(|bodies| Bundle { bodies, parent: None }).collect();
    let mut at = 0;
    while at < bundles.len() {
        let groups = match bundles[at].bodies[..] {
            [Some(one)] => likeness.limbs(&likeness.children[one]),
            _ => likeness.across(&bundles[at].bodies),
        };
        bundles.extend(groups.into_iter().map(|bodies| Bundle { bodies, parent: Some(at) }));
        at += 1;
    }
    // A parent's first body comes before any of its children.
    let mut order: Vec<_> = (0..bundles.len()).collect();
    order.sort_by_key(|&i| bundles[i].first());
    let mut place = vec![0; order.len()];
    for (to, &from) in order.iter().enumerate() {
        place[from] = to;
    }
    let placed =
        |&i: &usize| Bundle { bodies: bundles[i].bodies.clone(), parent: bundles[i].parent.map(|at| place[at]) };
    order.iter().map(placed).collect()
}

/// The rank of each body among those at equal depth: limbs side by side follow each other.
pub(super) fn ranks(model: &Model<f64>, framed: &Framed) -> Vec<(usize, usize)> {
    let mut ranks = vec![(0, 0); model.bodies.len()];
    for (i, bundle) in bundles(model, framed).iter().enumerate() {
        for (limb, body) in bundle.bodies.iter().enumerate() {
            if let Some(body) = *body {
                ranks[body] = (i, limb);
            }
        }
    }
    ranks
}

#[cfg(all(test, target_arch = "x86_64"))]
mod tests {
    use super::{Framed, bundles};
    use crate::scene::{Inertial, JointDescription, JointKind, LinkDescription, SceneBuilder};
    use crate::spatial::Symmetric3;

    /// The bodies of each bundle of a tree of turns about x, y, z or (0) slides, each of a parent and a kind; parents count from 1.
    fn of(tree: &[(usize, usize)]) -> Vec<Vec<Option<usize>>> {
        let inertial = Inertial {
            mass: 1.0,
            centre: [0.1, 0.2, 0.3].into(),
            central: Symmetric3::new([1.0, 0.0, 0.0, 1.0, 0.0, 1.0]),
        };
        let link = |name: String| LinkDescription { name, inertial: Some(inertial) };
        let mut builder = SceneBuilder::new().link(LinkDescription { name: "0".into(), inertial: None });
        for (k, &(parent, kind)) in tree.iter().enumerate() {
            let kind_of = if kind == 0 { JointKind::Prismatic } else { JointKind::Revolute };
            let mut joint =
                JointDescription::new(format!("joint{k}"), kind_of, format!("{parent}"), format!("{}", k + 1));
            joint.axis = [0.0; 3].into();
            joint.axis[kind % 3] = 1.0;
            joint.origin.lever = [0.3, 0.1, 0.2].into();
            builder = builder.link(link(format!("{}", k + 1))).joint(joint);
        }
        let scene = builder.build().expect("a tree");
        bundles(scene.model(), &Framed::of(scene.model())).into_iter().map(|bundle| bundle.bodies).collect()
    }

    #[test]
    fn limbs_of_like_build_go_together() {
        let both = |a, b| vec![Some(a), Some(b)];
        let alone = |a| vec![Some(a)];
        // Two legs of three, numbered one after another.
        assert_eq!(
            of(&[(0, 1), (1, 2), (2, 1), (3, 0), (1, 2), (5, 1), (6, 0)]),
            [alone(0), both(1, 4), both(2, 5), both(3, 6)]
        );
        // The same by turns, one of them longer.
        let by_turns = of(&[(0, 1), (1, 2), (1, 2), (2, 1), (3, 1), (5, 0)]);
        assert_eq!(by_turns, [alone(0), both(1, 3), both(2, 4), vec![None, Some(5)]]);
        // Others than the first few have nothing in common; limbs on the base; six of a kind go four and two.
        assert_eq!(of(&[(0, 1), (1, 2), (2, 1), (3, 0), (1, 2), (5, 0), (6, 0)]).len(), 7);
        assert_eq!(of(&[(0, 1), (0, 1)]), [both(0, 1)]);
        assert_eq!(of(&[(0, 1); 6]).iter().map(Vec::len).collect::<Vec<_>>(), [4, 2]);
    }
}
