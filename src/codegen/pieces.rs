//! Long programs in pieces: compilers take more than twice the time for a function of twice the length.
//!
//! A piece is a function; what later ones read is kept in an array, where a slot is used again once nothing reads it any more. What a compiler would keep in registers across a cut is
//! little beside what it has to put on the stack anyway.

use super::program::{Program, operands};
use crate::scalar::Operation;
use std::collections::HashMap;
use std::fmt::Write;
use std::ops::Range;

/// Programs of so many operations are one function.
///
/// In pieces the 15,500 of the derivatives of forward dynamics of a robot of 18 degrees of freedom took GCC a quarter of the time, and were a quarter slower.
const WHOLE: usize = 8000;
/// Of longer ones each piece has so many.
const PIECE: usize = 2000;

/// What one function of the code does.
struct Piece {
    operations: Range<usize>,
    /// Places of numbers that later pieces read, with their slots.
    keeps: Vec<(usize, usize)>,
    /// Results that are there now: the array, the index in it, the place of the number.
    writes: Vec<(usize, usize, usize)>,
}

/// How a program is written.
pub(super) struct Form<'a> {
    /// The declaration of the function.
    pub head: String,
    /// What the names of its pieces begin with.
    pub name: String,
    /// Its parameters, pointers to arguments and results, and their names.
    pub parameters: String,
    pub names: String,
    /// The type of a number.
    pub number: &'a str,
    /// Whether the caller lets no result overlap an argument: numbers are written then as soon as they are there.
    pub is_apart: bool,
    /// How a constant is written as such a number where it is a result.
    pub constant: fn(&str) -> String,
}

/// What keeps a piece apart.
pub(super) const APART: &str =
    "\n#if defined(__GNUC__)\n#define APART __attribute__((noinline))\n#else\n#define APART\n#endif\n";

/// Whether a program is more than one piece.
pub(super) fn is_cut(program: &Program) -> bool {
    program.operations.len() > WHOLE
}

/// Where it is cut: never between a sine and its cosine, which are computed together.
fn ranges(program: &Program) -> Vec<Range<usize>> {
    let operations = &program.operations;
    let (mut ranges, mut begin) = (Vec::new(), 0);
    let piece = if is_cut(program) { PIECE } else { WHOLE };
    while begin < operations.len() || ranges.is_empty() {
        let mut end = (begin + piece).min(operations.len());
        if matches!(operations.get(end), Some(Operation::Cosine(_))) {
            end += 1;
        }
        ranges.push(begin..end);
        begin = end;
    }
    ranges
}

/// The pieces, and how many slots they need.
fn cut(program: &Program) -> (Vec<Piece>, usize) {
    let ranges = ranges(program);
    let mut of_place = vec![0; program.operations.len()];
    for (piece, range) in ranges.iter().enumerate() {
        of_place[range.clone()].fill(piece);
    }
    // The last piece that reads a number.
    let mut last = of_place.clone();
    for (place, operation) in program.operations.iter().enumerate() {
        for of in operands(operation).into_iter().flatten() {
            last[of as usize] = last[of as usize].max(of_place[place]);
        }
    }
    let (mut free, mut slots, mut held): (Vec<usize>, usize, Vec<(usize, usize)>) = (Vec::new(), 0, Vec::new());
    let mut pieces: Vec<Piece> = Vec::new();
    for (piece, operations) in ranges.into_iter().enumerate() {
        held.retain(|&(until, slot)| {
            if until < piece {
                free.push(slot);
            }
            until >= piece
        });
        let mut keeps = Vec::new();
        for place in operations.clone() {
            let is_there = matches!(program.operations[place], Operation::Constant(_) | Operation::Argument(_));
            if last[place] > piece && !is_there {
                let slot = free.pop().unwrap_or_else(|| {
                    slots += 1;
                    slots - 1
                });
                held.push((last[place], slot));
                keeps.push((place, slot));
            }
        }
        pieces.push(Piece { operations, keeps, writes: Vec::new() });
    }
    for (array, (_, places)) in program.outputs().enumerate() {
        for (index, &place) in places.iter().enumerate() {
            pieces[of_place[place as usize]].writes.push((array, index, place as usize));
        }
    }
    (pieces, slots)
}

/// The names of all parameters of a piece.
fn all(program: &Program) -> impl Iterator<Item = &'static str> {
    program.arguments.iter().chain(&program.results).map(|array| array.name).chain(["kept"])
}

/// Writes the function, after its pieces where there are several. `said`: how each number is named where it is read; `statement` writes what computes the one at a place.
pub(super) fn write(
    program: &Program,
    form: &Form<'_>,
    mut said: Vec<String>,
    mut statement: impl FnMut(usize, &mut [String], &mut String),
    text: &mut String,
) {
    let Form { head, name, parameters, names, number, is_apart, constant } = form;
    let (pieces, slots) = cut(program);
    let is_whole = pieces.len() == 1;
    for (at, piece) in pieces.iter().enumerate() {
        let _ = if is_whole {
            write!(text, "\n{head}\n{{\n")
        } else {
            write!(text, "\nstatic APART void {name}_{at}({parameters}, {number} *restrict kept)\n{{\n")
        };
        // Where numbers go, by their places; what is computed elsewhere comes last.
        let mut goes: HashMap<usize, Vec<String>> = HashMap::new();
        for &(place, slot) in &piece.keeps {
            goes.entry(place).or_default().push(format!("kept[{slot}]"));
        }
        for &(array, index, place) in &piece.writes {
            goes.entry(place).or_default().push(format!("{}[{index}]", program.results[array].name));
        }
        let put = |place: usize, to: Vec<String>, said: &[String], text: &mut String| {
            let is_constant = matches!(program.operations[place], Operation::Constant(_));
            let value = if is_constant { constant(&said[place]) } else { said[place].clone() };
            for to in to {
                let _ = writeln!(text, "    {to} = {value};");
            }
        };
        for place in piece.operations.clone() {
            statement(place, &mut said, text);
            if *is_apart || !is_whole {
                put(place, goes.remove(&place).unwrap_or_default(), &said, text);
            }
        }
        let mut late: Vec<_> = goes.into_iter().collect();
        late.sort_unstable();
        for (place, to) in late {
            put(place, to, &said, text);
        }
        for &(place, slot) in &piece.keeps {
            said[place] = format!("kept[{slot}]");
        }
        // What nothing reads is no fault.
        let unread: Vec<&str> = if is_whole { program.unread().collect() } else { all(program).collect() };
        for name in unread {
            let _ = writeln!(text, "    (void){name};");
        }
        text.push_str("}\n");
    }
    if !is_whole {
        let _ = write!(text, "\n{head}\n{{\n    {number} kept[{}];\n", slots.max(1));
        for at in 0..pieces.len() {
            let _ = writeln!(text, "    {name}_{at}({names}, kept);");
        }
        text.push_str("}\n");
    }
}
