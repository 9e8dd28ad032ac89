//! The arrays that a program reads and writes, as every language declares them.

use super::program::Program;
use crate::scalar::Operation;

/// One array of a state: what it is called, and how many numbers it has.
#[derive(Debug, Clone, Copy)]
pub(super) struct Array {
    pub name: &'static str,
    pub width: usize,
}

/// The arguments of a program, in order: their numbers one after another are numbered through.
pub(super) fn arguments(program: &Program) -> Vec<Array> {
    let (nq, nv) = program.sizes;
    program.function.arguments().iter().map(|&name| Array { name, width: if name == "q" { nq } else { nv } }).collect()
}

/// The results of a program, in order.
pub(super) fn results(program: &Program) -> Vec<Array> {
    vec![Array { name: program.function.result(), width: program.function.width(program.sizes.1) }]
}

/// The array that has the number of this index, and its place there.
pub(super) fn located(arrays: &[Array], mut index: usize) -> (Array, usize) {
    for &array in arrays {
        if index < array.width {
            return (array, index);
        }
        index -= array.width;
    }
    unreachable!("programs number what their arrays have")
}

/// Every result with its array, its place there and the operation that gives it.
pub(super) fn written(program: &Program) -> impl Iterator<Item = (Array, usize, usize)> {
    let arrays = results(program);
    program.results.iter().enumerate().map(move |(index, &operation)| {
        let (array, at) = located(&arrays, index);
        (array, at, operation as usize)
    })
}

/// The arguments that nothing reads.
pub(super) fn unread(program: &Program) -> Vec<Array> {
    let mut all = arguments(program);
    for operation in &program.operations {
        if let Operation::Argument(index) = *operation {
            let (array, _) = located(&arguments(program), index as usize);
            all.retain(|other| other.name != array.name);
        }
    }
    all
}
