//! C99 of programs: a source, its header, a test with reference values, and a Makefile.

use super::case::Case;
use super::functions::{Array, Function};
use super::lanes;
use super::pieces::{self, Form};
use super::program::Program;
use super::syntax;
use super::width::Width;
use crate::algorithm::Algorithm;
use crate::error::Error;
use crate::filter;
use crate::scene::Scene;
use std::collections::HashMap;
use std::fmt::Write;

/// Files by their names.
pub type Sources = Vec<(String, String)>;

/// Generates C99 sources of functions of a scene under this name: NAME.c, NAME.h, `test_NAME.c` and a Makefile.
///
/// Each function takes pointers to its arguments (SI units, radians), then pointers to its results, which it writes. It
/// allocates no memory and needs sines, cosines and square roots of libm. Results agree with those of the scene's
/// methods to rounding, in covariance form: a loss of precision is not detected. The test compares with the scene at
/// one state. Programs of more than 8000 operations are split into one function per part. Equal limbs share one
/// function, which is called in a loop with the constants of each limb from a table.
///
/// With `batches`, each function also has a version for many states, vectorized (SIMD) by the vector extensions of GCC
/// and Clang. If `NAME_BATCHES_ALONE` is defined, the versions for one state are omitted.
///
/// # Errors
///
/// As [`Program::new`]; [`Error::Argument`] for a name that is not an identifier of C, for no functions, and for two
/// functions with the same name in C.
pub fn sources(
    scene: &Scene,
    name: &str,
    functions: &[Function],
    (width, batches): (Width, bool),
) -> Result<Sources, Error> {
    sources_accepting(scene, name, functions, (width, batches), None)
}

/// [`sources`] with another tolerance for the margins than the default. For a scene with connections, an infinite one
/// omits the error estimate of the factor of M from the margins.
///
/// # Errors
///
/// As [`sources`].
pub fn sources_accepting(
    scene: &Scene,
    name: &str,
    functions: &[Function],
    (width, batches): (Width, bool),
    tolerance: Option<f64>,
) -> Result<Sources, Error> {
    // Infinite: the margins of functions with connections omit the error estimate.
    if tolerance != Some(f64::INFINITY) || scene.constraints().is_empty() {
        scene.check_tolerance(Algorithm::ForwardDynamics(filter::Form::Auto), tolerance)?;
    }
    let programs = programs(scene, name, functions, (width, tolerance))?;
    Ok(vec![
        (format!("{name}.c"), source(name, &programs, (width, batches))),
        (format!("{name}.h"), header(scene, name, &programs, (width, batches))),
        (format!("test_{name}.c"), test(scene, name, &programs, (width, batches))?),
        ("Makefile".to_owned(), makefile(name)),
    ])
}

/// The programs of all functions, for a name that is an identifier in all languages, with a tolerance for the margins.
pub(super) fn programs(
    scene: &Scene,
    name: &str,
    functions: &[Function],
    (width, tolerance): (Width, Option<f64>),
) -> Result<Vec<Program>, Error> {
    let is_start = |c: char| c.is_ascii_alphabetic() || c == '_';
    if !(name.starts_with(is_start) && name.chars().all(|c| is_start(c) || c.is_ascii_digit())) {
        return Err(Error::argument("name", format!("{name:?}"), "letters, digits and _, the first no digit"));
    }
    if functions.is_empty() {
        return Err(Error::argument("functions", "none", "one or more"));
    }
    check_symbols(functions)?;
    let checked = |function| {
        let program = Program::accepting(scene, function, tolerance)?;
        program.check_constants(width).map(|()| program)
    };
    functions.iter().map(checked).collect()
}

/// Checks that no two functions have the same name in the code.
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

pub(super) const WRITTEN_BY: &str = "/* Written by phipsi; do not edit. */\n";

/// The declaration of a function, without its terminator.
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
    for line in joints(scene) {
        let _ = writeln!(text, "   {line}");
    }
    text.push_str("*/\n\n#ifdef __cplusplus\nextern \"C\" {\n#endif\n\n");
    for program in programs {
        let apart = if pieces::is_cut(program) { " Results overlap no argument." } else { "" };
        let _ = writeln!(text, "/* {}{apart} */", meaning(program).replace("*/", "* /"));
        let _ = writeln!(text, "{};\n", declaration(name, program, width));
        if batches {
            let _ = writeln!(
                text,
                "/* The same of `count` states, one after another in every array; results overlap no argument. Gives 1 where a number of any is not finite or the\n   squared norm of a quaternion is off by more than 1e-3, else 0. */"
            );
            let _ = writeln!(text, "{};\n", lanes::declaration(name, program, width));
        }
    }
    let _ = write!(text, "#ifdef __cplusplus\n}}\n#endif\n\n#endif\n");
    text
}

/// One line for each joint, with its indices in q and in qd.
pub(super) fn joints(scene: &Scene) -> Vec<String> {
    let line = |joint: &crate::scene::Joint| {
        // Names must not end the comment.
        let name = joint.name.replace("*/", "* /").replace(['\n', '\r'], " ");
        format!("{name}: q {}..{}, qd {}..{}", joint.q.start, joint.q.end, joint.v.start, joint.v.end)
    };
    scene.joints().iter().map(line).collect()
}

/// The summary of a program, and its number of operations.
pub(super) fn meaning(program: &Program) -> String {
    let (what, size) = (program.function.meaning(), program.operations());
    format!(
        "{what}: {} sums, {} products, {} products with a sum, {} quotients, {} roots, {} sines with cosines.",
        size.additions, size.multiplications, size.fused, size.divisions, size.roots, size.sines
    )
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
        text.push_str(&lanes::prelude(width));
        for program in programs {
            lanes::functions(name, program, width, &mut text);
        }
    }
    text
}

/// The function of one state.
fn one_state(name: &str, program: &Program, width: Width, text: &mut String) {
    let number = width.of_c();
    let form = Form {
        syntax: &syntax::C,
        width,
        head: format!("\n{}\n{{\n", declaration(name, program, width)),
        tail: "}\n".to_owned(),
        name: format!("{name}_{}", program.function.symbol()),
        parameters: program.named(&format!("const {number} *restrict "), &format!("{number} *restrict ")),
        names: program.named("", ""),
        is_apart: false,
    };
    text.extend(pieces::write(program, &form));
}

/// A state of the scene, and the results of the methods there.
fn test(scene: &Scene, name: &str, programs: &[Program], (width, batches): (Width, bool)) -> Result<String, Error> {
    let number = width.of_c();
    let mut text = format!("{WRITTEN_BY}#include \"{name}.h\"\n#include <math.h>\n#include <stdio.h>\n\n");
    text.push_str(&check(width));
    text.push_str("\nint main(void)\n{\n    int faults = 0;\n");
    for program in programs {
        let (case, what) = (Case::new(scene, program)?, program.function.symbol());
        let size = case.size;
        let _ = writeln!(text, "    {{");
        let mut given = Vec::new();
        for (array, values) in program.arguments.iter().zip(&case.given) {
            let _ = writeln!(text, "        {}", constants(array.name, values, width));
            given.push(array.name.to_owned());
        }
        let (mut first, mut checks) = (0, String::new());
        for result in &program.results {
            let (name, count, said) = (result.name, result.width(), program.said_of(result));
            let expected = constants(&format!("expected_{name}"), &case.expected[first..first + count], width);
            let _ = write!(text, "        {expected}\n        static {number} {name}[{}];\n", count.max(1));
            let _ =
                writeln!(checks, "        faults += check(\"{said}\", {name}, expected_{name}, {count}, {size:?});");
            given.push(name.to_owned());
            first += count;
        }
        let _ = write!(text, "        {name}_{what}({});\n{checks}", given.join(", "));
        if batches {
            lanes::test(name, program, (width, size), &mut text);
        }
        let _ = writeln!(text, "    }}");
    }
    text.push_str("    return faults != 0;\n}\n");
    Ok(text)
}

/// The function that compares, in C.
pub(super) fn check(width: Width) -> String {
    let (number, bound) = (width.of_c(), if width == Width::Double { 1e-9 } else { 1e-2 });
    format!(
        "/* Largest difference over the size of such numbers; the bound leaves room for the condition of the mass matrix. */\n\
         static int check(const char *what, const {number} *found, const {number} *expected, int count, double size)\n{{\n    \
         double apart = 0;\n    for (int i = 0; i < count; i++) {{\n        \
         const double difference = fabs((double)found[i] - (double)expected[i]);\n        \
         if (!(difference <= apart)) apart = difference;\n    }}\n    \
         printf(\"%s: %.1e\\n\", what, apart / size);\n    \
         return !(apart <= {bound:e} * size);\n}}\n"
    )
}

/// An array of constants in C.
pub(super) fn constants(name: &str, values: &[f64], width: Width) -> String {
    let values: Vec<String> = values.iter().map(|&x| width.constant(x)).collect();
    let all = if values.is_empty() { "0".to_owned() } else { values.join(", ") };
    format!("static const {} {name}[] = {{{all}}};", width.of_c())
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
