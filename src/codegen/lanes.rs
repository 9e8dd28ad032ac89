//! C of programs for many states, one state per lane of a vector, by the vector extensions of GCC and Clang.

use super::circle::Sines;
use super::pieces::{self, Form};
use super::program::Program;
use super::syntax;
use super::width::Width;
use std::fmt::Write;

/// The code that all vectorized programs share: vectors, sines with cosines, and loading and storing of states.
///
/// Sines and cosines are accurate to one unit in the last place up to the largest angle of [`Sines`]; larger angles use
/// libm. In float the unit is that of 1.0.
pub(super) fn prelude(width: Width) -> String {
    let (sines, constant) = (Sines::new(width), |x: f64| width.constant(x));
    let [of_sine, first, of_cosine] = sines.polynomials(&constant);
    let [a, b, c] = sines.half_pi.map(constant);
    // In double precision the remainder of the reduction is stored separately.
    let (reduction, in_sine, in_cosine) = match width {
        Width::Double => (
            format!(
                "    const lanes first = x - turns * {a};\n    const lanes y = first - turns * {b};\n    \
                 const lanes tail = ((first - y) - turns * {b}) - turns * {c};\n"
            ),
            "(z * (tail * 0.5 - v * of_sine) - tail) + ",
            " - y * tail",
        ),
        Width::Single => (
            format!("    const lanes y = ((x - turns * {a}) - turns * {b}) - turns * {c};\n"),
            "v * z * -of_sine + ",
            "",
        ),
    };
    let whole = match width {
        Width::Double => ["long long", "0x7fffffffffffffffLL", "0x3ff0000000000000LL", "LL", "62"],
        Width::Single => ["int", "0x7fffffff", "0x3f800000", "", "30"],
    };
    let [bits, magnitude, one, ll, sign] = whole;
    let bytes = if width == Width::Double { 8 } else { 4 };
    // In the largest available registers.
    let most = 64 / bytes;
    let mut replaced = [
        ("@number", width.of_c().to_owned()),
        ("@f", width.suffix().to_owned()),
        ("@bits", bits.to_owned()),
        ("@bytes", bytes.to_string()),
        ("@transposed", transposed(most)),
        ("@most", most.to_string()),
        ("@some", (most / 2).to_string()),
        ("@few", (most / 4).to_string()),
        ("@magnitude", magnitude.to_owned()),
        ("@one", one.to_owned()),
        ("@zero", constant(0.0)),
        ("@whole", constant(1.0)),
        ("@half", constant(0.5)),
        ("@slack", constant(1e-3)),
        ("@LL", ll.to_owned()),
        ("@sign", sign.to_owned()),
        ("@turns", constant(sines.turns)),
        ("@rounder", constant(sines.rounder)),
        ("@reduction", reduction),
        ("@of_sine", of_sine),
        ("@first", first),
        ("@of_cosine", of_cosine),
        ("@in_sine", in_sine.to_owned()),
        ("@in_cosine", in_cosine.to_owned()),
        ("@largest", constant(sines.largest)),
    ];
    // Longer names first, because some names are prefixes of others.
    replaced.sort_by_key(|(name, _)| std::cmp::Reverse(name.len()));
    replaced.iter().fold(PRELUDE.to_owned(), |text, (name, by)| text.replace(name, by))
}

/// The transposition of a square block of vectors, for this number of lanes, half of it and a quarter.
fn transposed(most: usize) -> String {
    let mut text = String::new();
    for (lanes, when) in [(most, "#if"), (most / 2, "#elif"), (most / 4, "#elif")] {
        let _ = writeln!(text, "{when} LANES == {lanes}");
        let steps = || std::iter::successors(Some(1), |step| Some(2 * step)).take_while(|&step| step < lanes);
        for step in steps() {
            // For two vectors at this distance: the lanes that keep their values, and the lanes that take those of the
            // other vector.
            let low = (0..lanes).map(|k| if k & step == 0 { k } else { lanes + k - step });
            let high = (0..lanes).map(|k| if k & step == 0 { k + step } else { lanes + k });
            let listed = |all: Vec<usize>| all.iter().map(usize::to_string).collect::<Vec<_>>().join(", ");
            let _ = writeln!(text, "#define LOW_{step} {}", listed(low.collect()));
            let _ = writeln!(text, "#define HIGH_{step} {}", listed(high.collect()));
        }
        for step in steps() {
            for first in (0..lanes).filter(|first| first & step == 0) {
                let _ = writeln!(text, "    EXCHANGED({first}, {}, LOW_{step}, HIGH_{step})", first + step);
            }
        }
    }
    text + "#endif\n"
}

const PRELUDE: &str = include_str!("templates/lanes.c.in");

/// The declaration of the function of many states, without its terminator.
pub(super) fn declaration(name: &str, program: &Program, width: Width) -> String {
    let (function, number) = (program.function.symbol(), width.of_c());
    let all = program.named(&format!("const {number} *"), &format!("{number} *"));
    format!("int {name}_{function}_batch(size_t count, {all})")
}

/// The vectorized program, and the function that applies it to all states.
pub(super) fn functions(name: &str, program: &Program, width: Width, text: &mut String) {
    let function = program.function.symbol();
    let parameters = program.named("const lanes *restrict ", "lanes *restrict ");
    let form = Form {
        syntax: &syntax::LANES,
        width,
        head: format!("\nstatic void {function}_lanes({parameters})\n{{\n"),
        tail: "}\n".to_owned(),
        name: format!("{function}_lanes"),
        parameters,
        names: program.named("", ""),
        is_apart: true,
    };
    text.extend(pieces::write(program, &form));

    let _ = write!(text, "\n{}\n{{\n", declaration(name, program, width));
    text.push_str("    lanes fault = {0};\n    for (size_t first = 0; first < count; first += LANES) {\n");
    text.push_str("        const size_t here = count - first < LANES ? count - first : LANES;\n");
    let all = || program.arguments.iter().chain(&program.results).map(|array| (array.name, array.width()));
    for (array, width) in all() {
        let _ = writeln!(text, "        lanes {array}_[{}];", width.max(1));
    }
    for (array, width) in all().take(program.arguments.len()) {
        let _ = writeln!(text, "        gather({array}_, {array} + first * {width}, {width}, here, &fault);");
    }
    for at in &program.quaternions {
        let _ = writeln!(text, "        check_norm(q_ + {at}, &fault);");
    }
    let names: Vec<String> = all().map(|(array, _)| format!("{array}_")).collect();
    let _ = writeln!(text, "        {function}_lanes({});", names.join(", "));
    for (array, width) in all().skip(program.arguments.len()) {
        let _ = writeln!(text, "        scatter({array} + first * {width}, {array}_, {width}, here, &fault);");
    }
    text.push_str(
        "    }\n    for (int i = 0; i < LANES; i++)\n        if (fault[i] != 0) return 1;\n    return 0;\n}\n",
    );
}

/// A part of the test: some states in a batch, with decreasing arguments, compared with single states.
pub(super) fn test(name: &str, program: &Program, (number, size): (Width, f64), text: &mut String) {
    const STATES: usize = 11;
    let function = program.function.symbol();
    for array in program.arguments.iter().chain(&program.results) {
        let (name, width) = (array.name, array.width());
        let _ = writeln!(text, "        static {} many_{name}[{}];", number.of_c(), STATES * width.max(1));
    }
    let _ = writeln!(text, "        for (int i = 0; i < {STATES}; i++) {{");
    for array in &program.arguments {
        let (name, width) = (array.name, array.width());
        // Quaternions keep their norm.
        let scale = if name == "q" { "" } else { " * (1 - i / (@number)20)" }.replace("@number", number.of_c());
        let _ = writeln!(
            text,
            "            for (int k = 0; k < {width}; k++) many_{name}[i * {width} + k] = {name}[k]{scale};"
        );
    }
    let _ = writeln!(text, "        }}");
    let _ = writeln!(text, "        faults += {name}_{function}_batch({STATES}, {});", program.named("many_", "many_"));
    let _ = writeln!(text, "        for (int i = 0; i < {STATES}; i++) {{");
    let state = program.arguments.iter().map(|array| format!("many_{} + i * {}", array.name, array.width()));
    let state: Vec<String> = state.chain(program.results.iter().map(|array| array.name.to_owned())).collect();
    let _ = writeln!(text, "            {name}_{function}({});", state.join(", "));
    for result in &program.results {
        let (array, count, said) = (result.name, result.width(), program.said_of(result));
        let _ = writeln!(
            text,
            "            faults += check(\"{said}, in lanes\", many_{array} + i * {count}, {array}, {count}, {size:?});"
        );
    }
    let _ = writeln!(text, "        }}");
}
