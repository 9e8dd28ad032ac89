//! C99 of programs: a source, its header, a test with reference values, and a Makefile.

use super::functions::{Array, Function};
use super::lanes;
use super::pieces::{self, Form};
use super::program::Program;
use crate::error::Error;
use crate::scalar::Operation;
use crate::scene::Scene;
use std::collections::HashMap;
use std::fmt::Write;

/// The numbers of the C code.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Width {
    /// double.
    #[default]
    Double,
    /// float.
    Single,
}

impl Width {
    fn of_c(self) -> &'static str {
        if self == Self::Double { "double" } else { "float" }
    }

    /// What ends names of functions and constants.
    fn suffix(self) -> &'static str {
        if self == Self::Double { "" } else { "f" }
    }

    fn constant(self, x: f64) -> String {
        match self {
            // The shortest that is read as the same number.
            Self::Double => format!("{x:?}"),
            #[allow(clippy::cast_possible_truncation)] // rounded, as asked
            Self::Single => format!("{:?}f", x as f32),
        }
    }
}

/// Files by their names.
pub type Sources = Vec<(String, String)>;

/// C99 of functions of a scene under this name: NAME.c, NAME.h, `test_NAME.c` and a Makefile.
///
/// Each function takes pointers to its arguments, SI units, radians, and then to its results, which it writes; nothing is allocated, and of libm it needs sines, cosines and square roots. Results are those of the
/// scene's methods to rounding, in covariance form: a state that loses digits there is not noticed. The test compares with the scene at a state of its own. Long programs are written in pieces, a function each.
///
/// With `batches` there is a function of many states too for each, as many at once as the processor's registers hold: double, by the vector extensions of GCC and Clang. Those of one state are left out where
/// `NAME_BATCHES_ALONE` is defined.
///
/// # Errors
///
/// As [`Program::new`]; [`Error::Argument`] for a name that is no identifier of C, for no functions, and for two whose names are one in C.
pub fn sources(
    scene: &Scene,
    name: &str,
    functions: &[Function],
    (width, batches): (Width, bool),
) -> Result<Sources, Error> {
    let is_start = |c: char| c.is_ascii_alphabetic() || c == '_';
    if !(name.starts_with(is_start) && name.chars().all(|c| is_start(c) || c.is_ascii_digit())) {
        return Err(Error::argument("name", format!("{name:?}"), "letters, digits and _, the first no digit"));
    }
    if functions.is_empty() {
        return Err(Error::argument("functions", "none", "one or more"));
    }
    if batches && width == Width::Single {
        return Err(Error::argument("batches", "float32", "float64, whose sines there are in lanes"));
    }
    check_symbols(functions)?;
    let programs = functions.iter().map(|function| Program::new(scene, function)).collect::<Result<Vec<_>, _>>()?;
    Ok(vec![
        (format!("{name}.c"), source(name, &programs, (width, batches))),
        (format!("{name}.h"), header(scene, name, &programs, (width, batches))),
        (format!("test_{name}.c"), test(scene, name, &programs, (width, batches))?),
        ("Makefile".to_owned(), makefile(name)),
    ])
}

/// No two functions of one name in the code.
fn check_symbols(functions: &[Function]) -> Result<(), Error> {
    let mut known = HashMap::new();
    for function in functions {
        if let Some(other) = known.insert(function.symbol(), function) {
            let found = format!("{other:?} and {function:?}, which are both {} in the code", function.symbol());
            return Err(Error::argument(
                "functions",
                found,
                "names that differ in letters and digits, or one of the two",
            ));
        }
    }
    Ok(())
}

const WRITTEN_BY: &str = "/* Written by phipsi; do not edit. */\n";

/// The declaration of a function, without what ends it.
fn declaration(name: &str, program: &Program, width: Width) -> String {
    let number = width.of_c();
    let sized = |array: &Array| format!("{number} {}[{}]", array.name, array.width().max(1));
    let arguments = program.arguments.iter().map(|argument| format!("const {}", sized(argument)));
    let all: Vec<String> = arguments.chain(program.results.iter().map(sized)).collect();
    format!("void {name}_{}({})", program.function.symbol(), all.join(", "))
}

fn header(scene: &Scene, name: &str, programs: &[Program], (width, batches): (Width, bool)) -> String {
    let guard = format!("{}_H", name.to_uppercase());
    let mut text = format!("{WRITTEN_BY}#ifndef {guard}\n#define {guard}\n\n");
    if batches {
        text.push_str("#include <stddef.h>\n\n");
    }
    let _ = writeln!(text, "#define {}_NQ {}", name.to_uppercase(), scene.nq());
    let _ = writeln!(text, "#define {}_NV {}\n", name.to_uppercase(), scene.nv());
    text.push_str("/* SI units, radians. Joints, and where they are in q and in qd:\n");
    for joint in scene.joints() {
        // What would end the comment has no place in it.
        let joint_name = joint.name.replace("*/", "* /");
        let _ = writeln!(
            text,
            "   {joint_name}: q {}..{}, qd {}..{}",
            joint.q.start, joint.q.end, joint.v.start, joint.v.end
        );
    }
    text.push_str("*/\n\n#ifdef __cplusplus\nextern \"C\" {\n#endif\n\n");
    for program in programs {
        let size = program.size();
        let _ = writeln!(
            text,
            "/* {}: {} sums, {} products, {} products with a sum, {} quotients and roots, {} sines and cosines.{} */",
            program.function.meaning().replace("*/", "* /"),
            size.sums,
            size.products,
            size.fused,
            size.quotients,
            size.sines,
            if pieces::is_cut(program) { " Results overlap no argument." } else { "" }
        );
        let _ = writeln!(text, "{};\n", declaration(name, program, width));
        if batches {
            let _ = writeln!(
                text,
                "/* The same of `count` states, one after another in every array; the result overlaps none of them. */"
            );
            let _ = writeln!(text, "{};\n", lanes::declaration(name, program));
        }
    }
    let _ = write!(text, "#ifdef __cplusplus\n}}\n#endif\n\n#endif\n");
    text
}

fn source(name: &str, programs: &[Program], (width, batches): (Width, bool)) -> String {
    let mut text = format!("{WRITTEN_BY}#include \"{name}.h\"\n#include <math.h>\n");
    if programs.iter().any(pieces::is_cut) {
        text.push_str(pieces::APART);
    }
    let alone = format!("{}_BATCHES_ALONE", name.to_uppercase());
    if batches {
        let _ = write!(text, "\n#ifndef {alone}\n");
    }
    for program in programs {
        one_state(name, program, width, &mut text);
    }
    if batches {
        let _ = write!(text, "\n#endif /* {alone} */\n");
        text.push_str(lanes::PRELUDE);
        for program in programs {
            lanes::functions(name, program, &mut text);
        }
    }
    text
}

/// The function of one state.
fn one_state(name: &str, program: &Program, width: Width, text: &mut String) {
    let number = width.of_c();
    let form = Form {
        head: declaration(name, program, width),
        name: format!("{name}_{}", program.function.symbol()),
        parameters: program.named(&format!("const {number} *restrict "), &format!("{number} *restrict ")),
        names: program.named("", ""),
        number,
        is_apart: false,
        constant: str::to_owned,
    };
    let said = (0..program.operations.len()).map(|place| operand(program, place, width)).collect();
    let statement = |place: usize, said: &mut [String], text: &mut String| {
        if let Some(right) = right_side(&program.operations[place], said, width) {
            let _ = writeln!(text, "    const {number} {} = {right};", said[place]);
        }
    };
    pieces::write(program, &form, said, statement, text);
}

/// How a number is named where it is read.
pub(super) fn operand(program: &Program, place: usize, width: Width) -> String {
    match program.operations[place] {
        Operation::Constant(bits) => {
            let x = f64::from_bits(bits);
            if x < 0.0 { format!("({})", width.constant(x)) } else { width.constant(x) }
        }
        Operation::Argument(index) => {
            let (array, at) = program.argument(index);
            format!("{}[{at}]", array.name)
        }
        _ => format!("x{place}"),
    }
}

/// What computes a number; nothing of constants and arguments.
pub(super) fn right_side(operation: &Operation, said: &[String], width: Width) -> Option<String> {
    let (of, f) = (|place: u32| &said[place as usize], width.suffix());
    Some(match *operation {
        Operation::Constant(_) | Operation::Argument(_) => return None,
        Operation::Sum(a, b) => format!("{} + {}", of(a), of(b)),
        Operation::Difference(a, b) => format!("{} - {}", of(a), of(b)),
        Operation::Product(a, b) => format!("{} * {}", of(a), of(b)),
        Operation::ProductSum(a, b, c) => format!("{} * {} + {}", of(a), of(b), of(c)),
        Operation::MinusProduct(a, b, c) => format!("{} - {} * {}", of(c), of(a), of(b)),
        Operation::Quotient(a, b) => format!("{} / {}", of(a), of(b)),
        Operation::Negative(a) => format!("-{}", of(a)),
        Operation::Root(a) => format!("sqrt{f}({})", of(a)),
        Operation::Sine(a) => format!("sin{f}({})", of(a)),
        Operation::Cosine(a) => format!("cos{f}({})", of(a)),
        Operation::Absolute(a) => format!("fabs{f}({})", of(a)),
        Operation::Smaller(a, b) => format!("fmin{f}({}, {})", of(a), of(b)),
        Operation::OneIfZero(a) => format!("{} == 0 ? 1 : 0", of(a)),
    })
}

/// Numbers between -1 and 1 that depend on their place only.
fn draw(place: usize) -> f64 {
    #[allow(clippy::cast_precision_loss)] // small
    let angle = (place as f64).mul_add(2.399_963, 0.7);
    angle.sin()
}

/// What arguments are called in the test, in their order.
pub(super) const GIVEN: [&str; 6] = ["given_q", "given_qd", "given_u", "given_first", "given_second", "given_third"];

/// A state of the scene, and what the methods give there.
fn test(scene: &Scene, name: &str, programs: &[Program], (width, batches): (Width, bool)) -> Result<String, Error> {
    let nv = scene.nv();
    let numbers = |first: usize| (first..first + nv).map(draw).collect::<Vec<f64>>();
    let mut given = vec![vec![f64::NAN; scene.nq()]];
    scene.integrate(&scene.neutral(), &numbers(0), &mut given[0])?;
    let most = programs.iter().map(|program| program.arguments.len()).max().unwrap_or(0);
    given.extend((1..most).map(|argument| numbers(argument * nv)));
    let number = width.of_c();
    let array = |kind: &str, name: &str, values: &[f64]| {
        let values: Vec<String> = values.iter().map(|&x| width.constant(x)).collect();
        let all = if values.is_empty() { "0".to_owned() } else { values.join(", ") };
        format!("{kind} {name}[] = {{{all}}};\n")
    };
    let mut text = format!("{WRITTEN_BY}#include \"{name}.h\"\n#include <math.h>\n#include <stdio.h>\n\n");
    for (name, values) in GIVEN.into_iter().zip(&given) {
        text.push_str(&array(&format!("static const {number}"), name, values));
    }
    let bound = if width == Width::Double { 1e-9 } else { 1e-2 };
    let _ = write!(
        text,
        "\n/* Largest difference over the size of such numbers; the bound leaves room for the condition of the mass matrix. */\n\
         static int check(const char *what, const {number} *found, const {number} *expected, int count, double size)\n{{\n    \
         double apart = 0;\n    for (int i = 0; i < count; i++) {{\n        \
         const double difference = fabs((double)found[i] - (double)expected[i]);\n        \
         if (!(difference <= apart)) apart = difference;\n    }}\n    \
         printf(\"%s: %.1e\\n\", what, apart / size);\n    \
         return !(apart <= {bound:e} * size);\n}}\n\nint main(void)\n{{\n    int faults = 0;\n"
    );
    for program in programs {
        let function = &program.function;
        let given: Vec<&[f64]> = given.iter().map(|values| &values[..]).collect();
        let expected = function.by_scene(scene, &given[..program.arguments.len()])?;
        // A bias can be nothing but rounding.
        let beside = match function {
            Function::BiasTorque => Function::InverseDynamics.by_scene(scene, &[given[0], given[1], given[1]])?,
            _ => Vec::new(),
        };
        let size = expected.iter().chain(&beside).fold(0.0, |size: f64, x| size.max(x.abs()));
        let size = if size > 0.0 { size } else { 1.0 };
        let what = function.symbol();
        let _ = writeln!(text, "    {{");
        let mut rest = &expected[..];
        for result in &program.results {
            let (own, others) = rest.split_at(result.width());
            rest = others;
            let expected = format!("expected_{}", result.name);
            let _ = write!(text, "        {}", array(&format!("static const {number}"), &expected, own));
            let _ = writeln!(text, "        static {number} {}[{}];", result.name, own.len().max(1));
        }
        let results = program.results.iter().map(|result| result.name);
        let all: Vec<&str> = GIVEN.into_iter().take(program.arguments.len()).chain(results).collect();
        let _ = writeln!(text, "        {name}_{what}({});", all.join(", "));
        for result in &program.results {
            let (result, count, said) = (result.name, result.width(), program.said_of(result));
            let _ =
                writeln!(text, "        faults += check(\"{said}\", {result}, expected_{result}, {count}, {size:?});");
        }
        if batches {
            lanes::test(name, program, size, &mut text);
        }
        let _ = writeln!(text, "    }}");
    }
    text.push_str("    return faults != 0;\n}\n");
    Ok(text)
}

fn makefile(name: &str) -> String {
    format!(
        "# Written by phipsi. make test: builds and runs the test.\n\
         CFLAGS ?= -std=c99 -O2 -march=native -ffp-contract=fast\n\n\
         {name}.o: {name}.c {name}.h\n\t$(CC) $(CFLAGS) -c {name}.c -o $@\n\n\
         test_{name}: test_{name}.c {name}.o\n\t$(CC) $(CFLAGS) $^ -lm -o $@\n\n\
         test: test_{name}\n\t./test_{name}\n\n.PHONY: test\n"
    )
}
