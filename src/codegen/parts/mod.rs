//! A program in parts, one function each. Long programs are split, and the code that equal limbs repeat is one part
//! that is called with different values.
//!
//! The compile time grows by more than a factor of two for a function of twice the length, and code that is repeated
//! for each limb exceeds the instruction cache. Values that later parts read are stored in an array, whose slots are
//! reused after the last read. The values that a compiler could keep in registers across a split are few compared with
//! the values that it spills to the stack in any case.

mod repeats;
mod tables;
#[cfg(test)]
mod tests;
mod work;

pub(super) use tables::{Entry, Tables};

use super::functions::Array;
use super::program::{Program, operands, renumbered};
use crate::scalar::Operation;
use std::collections::HashMap;
use std::ops::Range;
pub(super) use work::is_cut;
use work::{PartCall, Work};

/// A value that a part reads from outside, at each of its calls.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(super) enum Given {
    /// The f64 of these bits.
    Constants(Vec<u64>),
    /// Elements of an argument: the argument, and the indices.
    Arguments(usize, Vec<usize>),
    /// Slots of the array of stored values.
    Kept(Vec<usize>),
}

/// A function of the code.
#[derive(Debug)]
pub(super) struct Part {
    pub given: Vec<Given>,
    /// Its operations. An operand below the number of `given` values is one of these; the others are previous
    /// operations.
    pub operations: Vec<Operation>,
    /// Operations whose values later parts read, each with its slots.
    pub keeps: Vec<(usize, Vec<usize>)>,
    /// Operations whose values are results: the result, and the indices.
    pub writes: Vec<(usize, usize, Vec<usize>)>,
}

/// The source of a result that no part writes.
#[derive(Debug, Clone, Copy)]
pub(super) enum Source {
    /// A constant or an argument, by its place in the program.
    Leaf(usize),
    /// A slot, right after this call.
    Kept { call: usize, slot: usize },
}

/// A program in parts.
#[derive(Debug)]
pub(super) struct Cut {
    pub parts: Vec<Part>,
    /// The part of each call, in order. The values of a part are those of its first call, its second call, and so on.
    pub calls: Vec<usize>,
    /// The results that no part writes: the result, the index in it, and the source.
    pub others: Vec<(usize, usize, Source)>,
    /// Number of stored values.
    pub slots: usize,
}

/// Consecutive calls of one part, and the results that are written after them: the result, the index in it, the slot.
#[derive(Debug)]
pub(super) struct Run {
    pub part: usize,
    /// The range of the part's calls.
    pub rows: Range<usize>,
    pub then: Vec<(usize, usize, usize)>,
}

impl Cut {
    /// All calls in order.
    pub fn runs(&self) -> Vec<Run> {
        let mut then = vec![Vec::new(); self.calls.len()];
        for &(result, index, source) in &self.others {
            if let Source::Kept { call, slot } = source {
                then[call].push((result, index, slot));
            }
        }
        let (mut done, mut runs): (_, Vec<Run>) = (vec![0; self.parts.len()], Vec::new());
        for (&part, then) in self.calls.iter().zip(then) {
            done[part] += 1;
            match runs.last_mut() {
                Some(last) if last.part == part && last.then.is_empty() => {
                    last.rows.end += 1;
                    last.then = then;
                }
                _ => runs.push(Run { part, rows: done[part] - 1..done[part], then }),
            }
        }
        runs
    }

    /// True if 16 bits are sufficient for every index in every array.
    pub fn has_short_places(&self, program: &Program) -> bool {
        let widths = program.arguments.iter().chain(&program.results).map(Array::width);
        widths.chain([self.slots]).all(|width| u16::try_from(width).is_ok())
    }
}

/// The role of an operand in a part.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Role {
    /// The operation of this index in the part, at every call.
    Own(usize),
    /// A value from outside, or one of its own by way of the stored values.
    Outside,
}

/// The program in parts.
pub(super) fn parts(program: &Program) -> Cut {
    let work = Work::new(program);
    let calls = work.calls();
    // The calls of each part, in the order of their first calls.
    let mut numbers = HashMap::new();
    let mut of_part: Vec<Vec<usize>> = Vec::new();
    for (index, call) in calls.iter().enumerate() {
        let part = *numbers.entry(call.part).or_insert(of_part.len());
        if part == of_part.len() {
            of_part.push(Vec::new());
        }
        of_part[part].push(index);
    }
    let roles: Vec<Vec<[Option<Role>; 3]>> = of_part.iter().map(|own| roles(&work, &calls, own)).collect();

    let mut last = last_reads(&work, &calls, &of_part, &roles);
    let writes = Writes::new(&work, &calls, &of_part);
    for &(_, _, at, call) in &writes.by_caller {
        last[at] = last[at].max(Some(call));
    }
    let (slot_of, slots) = slots(&calls, &of_part, &last);
    let parts = of_part
        .iter()
        .zip(&roles)
        .zip(writes.of_parts)
        .map(|((own, roles), writes)| part(&work, (&calls, own), roles, &slot_of, writes))
        .collect();
    let kept = writes.by_caller.iter().map(|&(result, index, at, call)| {
        (result, index, Source::Kept { call, slot: slot_of[at].unwrap_or_default() })
    });
    let mut part_of = vec![0; calls.len()];
    for (part, own) in of_part.iter().enumerate() {
        for &call in own {
            part_of[call] = part;
        }
    }
    let others = writes.leaves.iter().copied().chain(kept).collect();
    Cut { parts, calls: part_of, others, slots }
}

/// The last call that reads each stored value.
fn last_reads(
    work: &Work<'_>,
    calls: &[PartCall],
    of_part: &[Vec<usize>],
    roles: &[Vec<[Option<Role>; 3]>],
) -> Vec<Option<usize>> {
    let mut last = vec![None; work.places.len()];
    for (own, roles) in of_part.iter().zip(roles) {
        for &call in own {
            for (at, roles) in calls[call].range.clone().zip(roles) {
                for (operand, role) in operands(&work.in_order(at)).into_iter().zip(roles) {
                    let (Some(operand), Some(Role::Outside)) = (operand, role) else { continue };
                    // Constants and arguments are not stored.
                    if let Some(last) = last.get_mut(work.order[operand as usize]) {
                        *last = (*last).max(Some(call));
                    }
                }
            }
        }
    }
    last
}

/// The roles of all operands of the operations of a part.
fn roles(work: &Work<'_>, calls: &[PartCall], own: &[usize]) -> Vec<[Option<Role>; 3]> {
    let inside = |call: usize, operand: u32| {
        let Range { start, .. } = calls[call].range;
        work.order[operand as usize].checked_sub(start).filter(|_| work.order[operand as usize] != usize::MAX)
    };
    let length = calls[own[0]].range.len();
    (0..length)
        .map(|at| {
            let of_call = |call: usize| operands(&work.in_order(calls[call].range.start + at));
            let first = of_call(own[0]);
            std::array::from_fn(|entry| {
                let operand = first[entry]?;
                let index = inside(own[0], operand);
                let is_own = index.is_some()
                    && own.iter().all(|&call| of_call(call)[entry].is_some_and(|o| inside(call, o) == index));
                Some(index.filter(|_| is_own).map_or(Role::Outside, Role::Own))
            })
        })
        .collect()
}

/// The places where results are written.
struct Writes {
    /// By the parts: the operation, the result, the index for each call.
    of_parts: Vec<Vec<(usize, usize, Vec<usize>)>>,
    /// Written by the caller: the result, the index, the operation, the call.
    by_caller: Vec<(usize, usize, usize, usize)>,
    leaves: Vec<(usize, usize, Source)>,
}

impl Writes {
    fn new(work: &Work<'_>, calls: &[PartCall], of_part: &[Vec<usize>]) -> Self {
        let mut of_operation: Vec<Vec<(usize, usize)>> = vec![Vec::new(); work.places.len()];
        let mut leaves = Vec::new();
        for (result, (_, places)) in work.program.outputs().enumerate() {
            for (index, &place) in places.iter().enumerate() {
                match of_operation.get_mut(work.order[place as usize]) {
                    Some(writes) => writes.push((result, index)),
                    None => leaves.push((result, index, Source::Leaf(place as usize))),
                }
            }
        }
        let (mut of_parts, mut by_caller) = (Vec::new(), Vec::new());
        for own in of_part {
            let mut writes = Vec::new();
            for at in 0..calls[own[0]].range.len() {
                let of_call = |call: usize| &of_operation[calls[call].range.start + at];
                let first = of_call(own[0]);
                let is_alike = own
                    .iter()
                    .all(|&call| of_call(call).iter().map(|write| write.0).eq(first.iter().map(|write| write.0)));
                if is_alike {
                    for (entry, &(result, _)) in first.iter().enumerate() {
                        writes.push((at, result, own.iter().map(|&call| of_call(call)[entry].1).collect()));
                    }
                } else {
                    for &call in own {
                        let of = calls[call].range.start + at;
                        by_caller.extend(of_call(call).iter().map(|&(result, index)| (result, index, of, call)));
                    }
                }
            }
            of_parts.push(writes);
        }
        Self { of_parts, by_caller, leaves }
    }
}

/// The slot of each stored value, and the number of slots.
fn slots(calls: &[PartCall], of_part: &[Vec<usize>], last: &[Option<usize>]) -> (Vec<Option<usize>>, usize) {
    let mut own: Vec<&[usize]> = vec![&[]; calls.len()];
    for calls in of_part {
        for &call in calls {
            own[call] = calls;
        }
    }
    let mut slot_of = vec![None; last.len()];
    let (mut free, mut slots, mut held): (Vec<usize>, usize, Vec<(usize, usize)>) = (Vec::new(), 0, Vec::new());
    for (index, call) in calls.iter().enumerate() {
        held.retain(|&(until, slot)| {
            if until < index {
                free.push(slot);
            }
            until >= index
        });
        for at in call.range.clone() {
            let offset = at - call.range.start;
            // If one call stores a value, all calls of the part do.
            if own[index].iter().any(|&other| last[calls[other].range.start + offset].is_some()) {
                let slot = free.pop().unwrap_or_else(|| {
                    slots += 1;
                    slots - 1
                });
                slot_of[at] = Some(slot);
                held.push((last[at].unwrap_or(index), slot));
            }
        }
    }
    (slot_of, slots)
}

/// One part, from its operands and the stored values.
fn part(
    work: &Work<'_>,
    (calls, own): (&[PartCall], &[usize]),
    roles: &[[Option<Role>; 3]],
    slot_of: &[Option<usize>],
    writes: Vec<(usize, usize, Vec<usize>)>,
) -> Part {
    let start = |call: usize| calls[call].range.start;
    let mut given: Vec<Given> = Vec::new();
    let mut known: HashMap<Given, usize> = HashMap::new();
    // The source of each operand: given values by their index, the part's own values by the index of the operation.
    let mut found: Vec<[Option<Result<usize, usize>>; 3]> = Vec::new();
    for (at, roles) in roles.iter().enumerate() {
        found.push(std::array::from_fn(|entry| match roles[entry]? {
            Role::Own(index) => Some(Err(index)),
            Role::Outside => {
                let operand = |&call: &usize| operands(&work.in_order(start(call) + at))[entry].unwrap_or_default();
                let of = outside(work, &own.iter().map(operand).collect::<Vec<u32>>(), slot_of);
                let next = given.len();
                let index = *known.entry(of).or_insert_with_key(|of| {
                    given.push(of.clone());
                    next
                });
                Some(Ok(index))
            }
        }));
    }
    let operations = found
        .iter()
        .enumerate()
        .map(|(at, found)| {
            let number = |operand: Result<usize, usize>| {
                u32::try_from(operand.unwrap_or_else(|own| given.len() + own)).unwrap_or(u32::MAX)
            };
            let mut to = found.iter().map(|operand| operand.map_or(0, number));
            renumbered(&work.in_order(start(own[0]) + at), |_| to.next().unwrap_or(0))
        })
        .collect();
    let keeps = (0..roles.len())
        .filter(|&at| slot_of[start(own[0]) + at].is_some())
        .map(|at| (at, own.iter().map(|&call| slot_of[start(call) + at].unwrap_or_default()).collect()))
        .collect();
    Part { given, operations, keeps, writes }
}

/// Values from outside, one per call: all constants, all of one argument, or all stored.
fn outside(work: &Work<'_>, operands: &[u32], slot_of: &[Option<usize>]) -> Given {
    let operation = |&operand: &u32| work.program.operations[operand as usize];
    match operation(&operands[0]) {
        Operation::Constant(_) => Given::Constants(
            operands.iter().map(|o| if let Operation::Constant(bits) = operation(o) { bits } else { 0 }).collect(),
        ),
        Operation::Argument(index) => Given::Arguments(
            work.argument(index).0,
            operands
                .iter()
                .map(|o| if let Operation::Argument(index) = operation(o) { work.argument(index).1 } else { 0 })
                .collect(),
        ),
        _ => Given::Kept(operands.iter().map(|&o| slot_of[work.order[o as usize]].unwrap_or_default()).collect()),
    }
}
