//! Rust of programs: a crate without dependencies and without the standard library, generic over its scalars.

use super::c::{Sources, joints, meaning, programs};
use super::case::Case;
use super::circle::Sines;
use super::functions::{Array, Function};
use super::pieces::{self, Form, is_cut, name_of_pair};
use super::program::{Program, operands};
use super::rust_texts::{LANES, LIBRARY, NUMBER, NUMBERS, RESERVED, TEST};
use super::syntax::RUST;
use super::width::Width;
use crate::error::Error;
use crate::scalar::Operation;
use crate::scene::Scene;
use std::collections::{HashMap, HashSet};
use std::fmt::Write;

/// Generates a Rust crate of functions of a scene under this name: Cargo.toml, src/lib.rs, src/dynamics.rs,
/// src/lanes.rs, src/numbers.rs and tests/reference.rs.
///
/// It is safe code that depends on `core` only. src/dynamics.rs has the functions, generic over a trait `Number` that
/// it defines, as straight-line code; functions of more than 8000 operations are split into parts as in C. Arguments
/// are arrays of one state, SI units, radians, and the result is an array, or a tuple of arrays. src/lanes.rs adds
/// `Lanes<T, N>`, vectors of N values, and a version of each function for many states. src/numbers.rs implements
/// `Number` for f64 and f32 by the standard library (feature `std`, enabled by default). Each of the first three can be
/// included in a module of another crate, for instance by a build script. Results agree with those of the scene's
/// methods to rounding, in covariance form.
///
/// # Errors
///
/// As [`Program::new`]; [`Error::Argument`] for a name that is not valid for a crate, and for no functions.
pub fn rust_sources(scene: &Scene, name: &str, functions: &[Function]) -> Result<Sources, Error> {
    if RESERVED.contains(&name) {
        return Err(Error::argument("name", format!("{name:?}"), "a name that Rust does not have for itself"));
    }
    let programs = programs(scene, name, functions, (Width::Double, None))?;
    Ok([
        ("Cargo.toml", manifest(name)),
        ("src/lib.rs", LIBRARY.to_owned()),
        ("src/dynamics.rs", dynamics(scene, &programs)),
        ("src/lanes.rs", lanes(&programs)),
        ("src/numbers.rs", NUMBERS.to_owned()),
        ("tests/reference.rs", test(scene, name, &programs)?),
    ]
    .map(|(file, text)| (file.to_owned(), text))
    .into())
}

fn manifest(name: &str) -> String {
    format!(
        "# Written by phipsi. cargo test: builds and runs the test.\n[package]\nname = \"{name}\"\nversion = \"0.1.0\"\nedition = \"2021\"\nrust-version = \"1.85\"\n\n\
         [features]\ndefault = [\"std\"]\n# f64 and f32 as numbers. Without it, numbers are types of your own.\nstd = []\n"
    )
}

/// The functions of one state.
fn dynamics(scene: &Scene, programs: &[Program]) -> String {
    let mut text =
        "// Written by phipsi; do not edit.\n//\n// SI units, radians. Joints, and where they are in q and in qd:\n"
            .to_owned();
    for line in joints(scene) {
        let _ = writeln!(text, "//   {line}");
    }
    text.push_str(NUMBER);
    let _ = write!(text, "\n/// How many numbers q has.\npub const NQ: usize = {};\n", scene.nq());
    let _ = write!(text, "\n/// How many numbers qd has.\npub const NV: usize = {};\n", scene.nv());
    let mut parts = String::new();
    for program in programs {
        let _ = write!(
            text,
            "\n/// {}\n#[rustfmt::skip]\n#[allow(non_snake_case, clippy::approx_constant, clippy::let_and_return, clippy::many_single_char_names, clippy::needless_range_loop, clippy::similar_names, clippy::too_many_lines, clippy::type_complexity, clippy::unreadable_literal)]\n",
            meaning(program)
        );
        function(program, &mut parts, &mut text);
    }
    text + &parts
}

/// The type of these arrays; a tuple for several.
fn result_type(results: &[(&str, usize)], number: &str) -> String {
    several(&results.iter().map(|(_, width)| format!("[{number}; {width}]")).collect::<Vec<_>>())
}

/// One statement: an expression that computes some values, with the indices of their operations.
struct Statement {
    right: String,
    /// Each name with the place of its operation, or None if no operation reads it.
    names: Vec<(String, Option<u32>)>,
    reads: Vec<u32>,
}

fn function(program: &Program, parts: &mut String, text: &mut String) {
    let (given, results) = (Array::sized(&program.arguments), Array::sized(&program.results));
    let unread: Vec<&str> = program.unread().collect();
    let declared = given.iter().map(|&(name, width)| {
        // An argument that no result depends on is not an error.
        format!("{}{name}: &[T; {width}]", if unread.contains(&name) { "_" } else { "" })
    });
    let declared: Vec<String> = declared.collect();
    let _ = writeln!(
        text,
        "pub fn {}<T: Number>({}) -> {} {{",
        program.function.symbol(),
        declared.join(", "),
        result_type(&results, "T")
    );
    if is_cut(program) {
        in_parts(program, parts, text);
        return;
    }
    let (statements, said) = statements(program);
    body(program, &statements, text);
    let mut outputs: Vec<Vec<&str>> = vec![Vec::new(); results.len()];
    for (array, _, operation) in program.written() {
        let index = results.iter().position(|result| result.0 == array.name).unwrap_or(0);
        outputs[index].push(&said[operation]);
    }
    let outputs: Vec<String> = outputs.iter().map(|values| format!("[{}]", values.join(", "))).collect();
    let _ = write!(text, "    {}\n}}\n", several(&outputs));
}

/// Writes the body of a long function to `text`, and its parts with their tables to `apart`.
fn in_parts(program: &Program, apart: &mut String, text: &mut String) {
    let (given, results) = (Array::sized(&program.arguments), Array::sized(&program.results));
    let names: Vec<String> = results.iter().map(|(name, _)| (*name).to_owned()).collect();
    let room = results.iter().map(|(name, width)| format!("    let mut {name} = [T::constant(0.0); {width}];\n"));
    let inputs = given.iter().map(|(name, width)| format!("{name}: &[T; {width}]"));
    let outputs = results.iter().map(|(name, width)| format!("{name}: &mut [T; {width}]"));
    let form = Form {
        syntax: &RUST,
        width: Width::Double,
        head: room.collect(),
        tail: format!("    {}\n}}\n", several(&names)),
        name: program.function.symbol(),
        parameters: inputs.chain(outputs).collect::<Vec<_>>().join(", "),
        names: program.named("", "&mut "),
        is_apart: true,
    };
    let [parts, function] = pieces::write(program, &form);
    apart.push_str(&parts);
    text.push_str(&function);
}

/// A single item, or a tuple of several.
fn several(all: &[String]) -> String {
    if all.len() == 1 { all.concat() } else { format!("({})", all.join(", ")) }
}

/// All statements, and the name of each operation where it is read.
fn statements(program: &Program) -> (Vec<Statement>, Vec<String>) {
    let (mut all, mut said) = (Vec::new(), Vec::with_capacity(program.operations.len()));
    let places: HashMap<&Operation, u32> = program.operations.iter().zip(0..).collect();
    let mut turned = HashSet::new();
    for (operation, index) in program.operations.iter().zip(0_u32..) {
        let name = match *operation {
            Operation::Constant(bits) => (RUST.operand)(bits, Width::Double),
            Operation::Argument(index) => {
                let (array, at) = program.argument(index);
                format!("{}[{at}]", array.name)
            }
            Operation::Sine(a) | Operation::Cosine(a) => {
                if turned.insert(a) {
                    let named = |letter: char, operation| match places.get(&operation) {
                        Some(&place) => (format!("{letter}{a}"), Some(place)),
                        None => ("_".to_owned(), None),
                    };
                    let names = vec![named('s', Operation::Sine(a)), named('c', Operation::Cosine(a))];
                    all.push(Statement { right: format!("{}.sin_cos()", said[a as usize]), names, reads: vec![a] });
                }
                name_of_pair(operation, a)
            }
            _ => {
                let right = RUST.right_side(operation, &said, Width::Double).unwrap_or_default();
                let (name, reads) = (format!("x{index}"), operands(operation).into_iter().flatten().collect());
                all.push(Statement { right, names: vec![(name.clone(), Some(index))], reads });
                name
            }
        };
        said.push(name);
    }
    (all, said)
}

/// The statements, in blocks that return the values that others read. Each statement opens a scope, and the compiler
/// does not support thousands of nested scopes.
fn body(program: &Program, statements: &[Statement], text: &mut String) {
    let block = statements.len().isqrt().max(64);
    let count = program.operations.len();
    // The block that computes a value, and the last block that reads it.
    let (mut made, mut last) = (vec![usize::MAX; count], vec![0; count]);
    for (index, statement) in statements.iter().enumerate() {
        for &place in statement.names.iter().filter_map(|(_, place)| place.as_ref()) {
            made[place as usize] = index / block;
        }
        for &place in &statement.reads {
            last[place as usize] = index / block;
        }
    }
    for (_, _, place) in program.written() {
        last[place] = usize::MAX;
    }
    let is_one = statements.len() <= block;
    for statements in statements.chunks(block) {
        let mut inside = String::new();
        let mut given = Vec::new();
        for Statement { right, names, .. } in statements {
            let all: Vec<String> = names.iter().map(|(name, _)| name.clone()).collect();
            let indent = if is_one { "    " } else { "        " };
            let _ = writeln!(inside, "{indent}let {} = {right};", several(&all));
            let is_read = |place: u32| last[place as usize] > made[place as usize];
            given.extend(names.iter().filter(|(_, place)| place.is_some_and(is_read)).map(|(name, _)| name.clone()));
        }
        if is_one {
            text.push_str(&inside);
        } else {
            let given = several(&given);
            let _ = write!(text, "    let {given} = {{\n{inside}        {given}\n    }};\n");
        }
    }
}

/// The type of many states in a register, and the functions for many states.
fn lanes(programs: &[Program]) -> String {
    let mut text = LANES.to_owned();
    for (number, width) in [("f64", Width::Double), ("f32", Width::Single)] {
        text.push_str(&lane(number, width));
    }
    for program in programs {
        batch(program, &mut text);
    }
    text
}

/// Sine and cosine of one scalar of this type, without a branch.
fn lane(number: &str, width: Width) -> String {
    let (sines, constant) = (Sines::new(width), |x: f64| rounded(x, width));
    let [of_sine, first, of_cosine] = sines.polynomials(&constant);
    let [a, b, c] = sines.half_pi.map(constant);
    let (reduction, in_sine, in_cosine) = match width {
        Width::Double => (
            format!(
                "        let first = self - turns * {a};\n        let y = first - turns * {b};\n        \
                 let tail = ((first - y) - turns * {b}) - turns * {c};\n"
            ),
            "(z * (tail * 0.5 - v * of_sine) - tail) + ",
            " - y * tail",
        ),
        Width::Single => (
            format!("        let y = ((self - turns * {a}) - turns * {b}) - turns * {c};\n"),
            "v * z * -of_sine + ",
            "",
        ),
    };
    let sign = if width == Width::Double { 62 } else { 30 };
    let (largest, turns, rounder) = (constant(sines.largest), constant(sines.turns), constant(sines.rounder));
    format!(
        "\nimpl Lane for {number} {{\n    #[inline]\n    fn is_near(self) -> bool {{\n        (-{largest}..={largest}).contains(&self)\n    }}\n\n    \
         #[inline]\n    #[rustfmt::skip]\n    #[allow(clippy::approx_constant, clippy::excessive_precision, clippy::many_single_char_names, clippy::unreadable_literal)]\n    \
         fn near_sin_cos(self) -> (Self, Self) {{\n        \
         // Quarter turns, rounded by a number above which there are only integers; pi/2 in three parts.\n        \
         let shifted = self * {turns} + {rounder};\n        let turns = shifted - {rounder};\n{reduction}        \
         let (z, v) = (y * y, y * y * y);\n        let of_sine = {of_sine};\n        let s = y - ({in_sine}v * {first});\n        \
         let of_cosine = {of_cosine};\n        let half = z * 0.5;\n        let whole = 1.0 - half;\n        \
         let c = whole + (((1.0 - whole) - half) + (z * (z * of_cosine){in_cosine}));\n        \
         // Odd quadrants swap them, and two of four turn each sign.\n        \
         let quadrant = shifted.to_bits();\n        let swapped = (quadrant & 1).wrapping_neg();\n        \
         let (s, c) = (s.to_bits(), c.to_bits());\n        \
         let (sine, cosine) = ((c & swapped) | (s & !swapped), (s & swapped) | (c & !swapped));\n        \
         let (turn_sine, turn_cosine) = ((quadrant & 2) << {sign}, (quadrant.wrapping_add(1) & 2) << {sign});\n        \
         ({number}::from_bits(sine ^ turn_sine), {number}::from_bits(cosine ^ turn_cosine))\n    }}\n}}\n"
    )
}

/// A scalar of this width, in Rust.
fn rounded(x: f64, width: Width) -> String {
    #[allow(clippy::cast_possible_truncation)] // rounded, as asked
    if width == Width::Double { format!("{x:?}") } else { format!("{:?}", x as f32) }
}

/// The function of many states.
fn batch(program: &Program, text: &mut String) {
    let (function, given, results) =
        (program.function.symbol(), Array::sized(&program.arguments), Array::sized(&program.results));
    let inputs = given.iter().map(|&(name, width)| format!("{name}: &[[T; {width}]]"));
    let outputs = results.iter().map(|&(name, width)| format!("{name}: &mut [[T; {width}]]"));
    let parameters: Vec<String> = inputs.chain(outputs).collect();
    let first = given[0].0;
    let _ = write!(
        text,
        "\n/// The same of many states, N at once.\n///\n/// # Panics\n///\n/// Where the slices are not all of one length.\n#[rustfmt::skip]\n#[allow(non_snake_case)]\n\
         pub fn {function}_batch<T: Number + Lane, const N: usize>({}) {{\n    let count = {first}.len();\n",
        parameters.join(", ")
    );
    for array in given[1..].iter().chain(&results) {
        let _ = writeln!(text, "    assert_eq!({}.len(), count, \"{} has one entry a state\");", array.0, array.0);
    }
    text.push_str("    for first in (0..count).step_by(N) {\n        let here = first..count.min(first + N);\n");
    let lanes: Vec<String> =
        given.iter().map(|array| format!("&gather::<T, {}, N>(&{}[here.clone()])", array.1, array.0)).collect();
    let found: Vec<String> = results.iter().map(|array| format!("found_{}", array.0)).collect();
    let pattern = several(&found);
    let _ = writeln!(text, "        let {pattern} = super::{function}({});", lanes.join(", "));
    for (index, array) in results.iter().enumerate() {
        let here = if index + 1 == results.len() { "here" } else { "here.clone()" };
        let _ = writeln!(text, "        scatter(&found_{}, &mut {}[{here}]);", array.0, array.0);
    }
    text.push_str("    }\n}\n");
}

/// A state of the scene, and the results of the methods there.
fn test(scene: &Scene, name: &str, programs: &[Program]) -> Result<String, Error> {
    let mut text = TEST.to_owned();
    for program in programs {
        let (case, function) = (Case::new(scene, program)?, program.function.symbol());
        let (given, results, size) = (Array::sized(&program.arguments), Array::sized(&program.results), case.size);
        let _ = write!(text, "\n#[test]\nfn {function}() {{\n    on_a_large_stack(|| {{\n");
        for (&(name, width), values) in given.iter().zip(&case.given) {
            let _ = writeln!(text, "    let {name}: [f64; {width}] = {values:?};");
        }
        let call =
            |suffix: &str| given.iter().map(|array| format!("&{}{suffix}", array.0)).collect::<Vec<_>>().join(", ");
        let names: Vec<&str> = results.iter().map(|array| array.0).collect();
        let pattern = |prefix: &str| several(&names.iter().map(|name| format!("{prefix}{name}")).collect::<Vec<_>>());
        let _ = writeln!(text, "    let {} = {name}::{function}({});", pattern("found_"), call(""));
        let single: Vec<String> = given.iter().map(|array| format!("&single(&{})", array.0)).collect();
        let _ = writeln!(text, "    let {} = {name}::{function}({});", pattern("single_"), single.join(", "));
        let mut first = 0;
        for &(name, width) in &results {
            let expected = &case.expected[first..first + width];
            let _ = writeln!(text, "    let expected: [f64; {width}] = {expected:?};");
            let _ = writeln!(text, "    check(\"{name}\", &found_{name}, &expected, {size:?} * 1e-9);");
            let _ = writeln!(
                text,
                "    check(\"{name} of f32\", &single_{name}.map(f64::from), &expected, {size:?} * 1e-2);"
            );
            first += width;
        }
        text.push_str("    });\n}\n");
        many(name, program, &case, &mut text);
    }
    Ok(text)
}

/// Some states in lanes, with decreasing arguments, compared with single states.
fn many(name: &str, program: &Program, case: &Case, text: &mut String) {
    const STATES: usize = 11;
    let (function, given, results) =
        (program.function.symbol(), Array::sized(&program.arguments), Array::sized(&program.results));
    let _ = write!(text, "\n#[test]\nfn {function}_of_many_states() {{\n    on_a_large_stack(|| {{\n");
    for (&(name, width), values) in given.iter().zip(&case.given) {
        let _ = writeln!(text, "    let {name}: [f64; {width}] = {values:?};");
        // Quaternions keep their norm.
        let scaled = if name == "q" { format!("[{name}; {STATES}]") } else { format!("smaller({name})") };
        let _ = writeln!(text, "    let many_{name}: [[f64; {width}]; {STATES}] = {scaled};");
    }
    for &(name, width) in &results {
        let _ = writeln!(text, "    let mut many_{name} = [[f64::NAN; {width}]; {STATES}];");
        let _ = writeln!(text, "    let mut single_{name} = [[f32::NAN; {width}]; {STATES}];");
    }
    let inputs: Vec<String> = given.iter().map(|array| format!("&many_{}", array.0)).collect();
    let singles: Vec<String> =
        given.iter().map(|array| format!("&many_{}.map(|state| single(&state))", array.0)).collect();
    let outputs = |prefix: &str| results.iter().map(|array| format!("&mut {prefix}{}", array.0)).collect::<Vec<_>>();
    let all = [inputs, outputs("many_")].concat().join(", ");
    let _ = writeln!(text, "    {name}::{function}_batch::<f64, 4>({all});");
    let all = [singles, outputs("single_")].concat().join(", ");
    let _ = writeln!(text, "    {name}::{function}_batch::<f32, 8>({all});");
    let _ = writeln!(text, "    for i in 0..{STATES} {{");
    let one: Vec<String> = given.iter().map(|array| format!("&many_{}[i]", array.0)).collect();
    let found: Vec<String> = results.iter().map(|array| array.0.to_owned()).collect();
    let pattern = several(&found);
    let _ = writeln!(text, "        let {pattern} = {name}::{function}({});", one.join(", "));
    for &(name, _) in &results {
        let size = case.size;
        let _ = writeln!(text, "        check(\"{name}\", &many_{name}[i], &{name}, {size:?} * 1e-9);");
        let _ = writeln!(
            text,
            "        check(\"{name} of f32\", &single_{name}[i].map(f64::from), &{name}, {size:?} * 1e-2);"
        );
    }
    text.push_str("    }\n    });\n}\n");
}
