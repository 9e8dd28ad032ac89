//! The operations of a program without leaves, which of them are equal, and the calls that contain all of them.

use super::repeats::{Repeat, repeats};
use crate::codegen::program::{Program, operands};
use crate::scalar::Operation;
use std::collections::HashMap;
use std::ops::Range;

/// The maximum number of operations of a part that is called once.
const LONGEST: usize = 2000;
/// Operands farther back than this are not distinguished by distance: the operations between may differ between limbs.
const NEAR: usize = 64;

/// Programs of at most this number of operations are one part.
///
/// In parts, the 15,500 operations of the derivatives of forward dynamics of a robot with 18 degrees of freedom compile
/// in half the time with GCC; programs of half that length lose a tenth of their speed.
const WHOLE: usize = 8000;

/// True if a program has more than one part.
pub(in crate::codegen) fn is_cut(program: &Program) -> bool {
    program.operations.len() > WHOLE
}

/// One call: the part, and its operations among those without leaves.
pub(super) struct PartCall {
    pub part: usize,
    pub range: Range<usize>,
}

/// The operations without constants and arguments, and the index of each among them.
pub(super) struct Work<'a> {
    pub program: &'a Program,
    pub places: Vec<usize>,
    /// `usize::MAX` for constants and arguments.
    pub order: Vec<usize>,
}

impl<'a> Work<'a> {
    pub fn new(program: &'a Program) -> Self {
        let mut order = vec![usize::MAX; program.operations.len()];
        let mut places = Vec::new();
        for (place, operation) in program.operations.iter().enumerate() {
            if !matches!(operation, Operation::Constant(_) | Operation::Argument(_)) {
                order[place] = places.len();
                places.push(place);
            }
        }
        Self { program, places, order }
    }

    fn operation(&self, at: usize) -> &'a Operation {
        &self.program.operations[self.places[at]]
    }

    /// The kind of an operand relative to this operation: a constant, a value of some argument, near or far.
    fn kind(&self, at: usize, operand: u32) -> usize {
        match self.program.operations[operand as usize] {
            Operation::Constant(_) => 0,
            Operation::Argument(index) => 1 + self.argument(index).0,
            _ => 1 + self.program.arguments.len() + (at - self.order[operand as usize]).min(NEAR),
        }
    }

    /// The argument, and the index in it.
    pub fn argument(&self, index: u32) -> (usize, usize) {
        let (array, at) = self.program.argument(index);
        (self.program.arguments.iter().position(|other| other.name == array.name).unwrap_or(0), at)
    }

    /// The operation with its two factors or terms in the order of their kind, so that equal operations have the same
    /// order.
    pub fn in_order(&self, at: usize) -> Operation {
        let sorted = |a: u32, b: u32| {
            let (a, b) = ((self.kind(at, a), a), (self.kind(at, b), b));
            (a.min(b).1, a.max(b).1)
        };
        match *self.operation(at) {
            Operation::Sum(a, b) => {
                let (a, b) = sorted(a, b);
                Operation::Sum(a, b)
            }
            Operation::Product(a, b) => {
                let (a, b) = sorted(a, b);
                Operation::Product(a, b)
            }
            Operation::ProductSum(a, b, c) => {
                let (a, b) = sorted(a, b);
                Operation::ProductSum(a, b, c)
            }
            Operation::MinusProduct(a, b, c) => {
                let (a, b) = sorted(a, b);
                Operation::MinusProduct(a, b, c)
            }
            other => other,
        }
    }

    /// A number for each operation, equal for equal operations.
    fn words(&self) -> Vec<u32> {
        let mut known = HashMap::new();
        let mut word = |at: usize| {
            let operation = self.in_order(at);
            let kinds = operands(&operation).map(|operand| operand.map(|operand| self.kind(at, operand)));
            let next = u32::try_from(known.len()).unwrap_or(u32::MAX);
            *known.entry((std::mem::discriminant(&operation), kinds)).or_insert(next)
        };
        (0..self.places.len()).map(&mut word).collect()
    }

    /// True if a cut before this operation separates a sine from its cosine, which are computed together.
    fn parts_a_pair(&self, at: usize) -> bool {
        at > 0
            && at < self.places.len()
            && matches!((self.operation(at - 1), self.operation(at)), (Operation::Sine(a), Operation::Cosine(b)) if a == b)
    }

    /// All calls in order.
    pub fn calls(&self) -> Vec<PartCall> {
        let mut starts: Vec<(usize, usize, usize)> = Vec::new();
        let mut parts = 0;
        if is_cut(self.program) {
            for Repeat { length, starts: mut of_part } in repeats(&self.words()) {
                // They are equal inside; only at their ends can a pair be separated.
                let head = usize::from(of_part.iter().any(|&start| self.parts_a_pair(start)));
                let tail = usize::from(of_part.iter().any(|&start| self.parts_a_pair(start + length)));
                for start in &mut of_part {
                    *start += head;
                }
                starts.extend(of_part.iter().map(|&start| (start, length - head - tail, parts)));
                parts += 1;
            }
            starts.sort_unstable();
        }
        let (mut calls, mut begin) = (Vec::new(), 0);
        for (start, length, part) in starts.into_iter().chain([(self.places.len(), 0, usize::MAX)]) {
            while begin < start {
                let most = if is_cut(self.program) { LONGEST } else { usize::MAX };
                let mut end = begin.saturating_add(most).min(start);
                end += usize::from(end < start && self.parts_a_pair(end));
                calls.push(PartCall { part: parts, range: begin..end });
                parts += 1;
                begin = end;
            }
            if part != usize::MAX {
                calls.push(PartCall { part, range: start..start + length });
                begin = start + length;
            }
        }
        calls
    }
}
