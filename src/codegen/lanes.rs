//! C of programs for many states: one number of each in a lane of a vector, by the vector extensions of GCC and Clang.

use super::c::{GIVEN, Width, operand};
use super::pieces::{self, Form};
use super::program::Program;
use crate::scalar::Operation;
use std::collections::HashSet;
use std::fmt::Write;

/// What all programs in lanes use: vectors, sines with their cosines, and the way of states into lanes and out.
///
/// The reduction and the polynomials are those of [`trigonometry`](crate::scalar), good to one unit in the last place up to a million radians; beyond, libm's.
pub(super) const PRELUDE: &str = r"
#if defined(__AVX512F__)
#define LANES 8
#elif defined(__AVX__)
#define LANES 4
#else
#define LANES 2
#endif

typedef double lanes __attribute__((vector_size(8 * LANES)));
typedef double loose __attribute__((vector_size(8 * LANES), aligned(8), may_alias));
typedef long long bits __attribute__((vector_size(8 * LANES)));

static inline lanes root(lanes x)
{
    lanes y;
    for (int i = 0; i < LANES; i++) y[i] = sqrt(x[i]);
    return y;
}

static inline lanes absolute(lanes x)
{
    return (lanes)((bits)x & 0x7fffffffffffffffLL);
}

static inline lanes smaller(lanes x, lanes y)
{
    lanes z;
    for (int i = 0; i < LANES; i++) z[i] = fmin(x[i], y[i]);
    return z;
}

static inline lanes one_if_zero(lanes x)
{
    return (lanes)((x == 0.0) & 0x3ff0000000000000LL);
}

static inline void sine_and_cosine(lanes x, lanes *sine, lanes *cosine)
{
    /* Quarter turns, rounded by a number above which there are only integers; pi/2 in three parts. */
    const lanes shifted = x * 0.6366197723675814 + 6755399441055744.0;
    const lanes turns = shifted - 6755399441055744.0;
    const lanes first = x - turns * 1.5707963267341256;
    const lanes y = first - turns * 6.077100506303966e-11;
    const lanes tail = ((first - y) - turns * 6.077100506303966e-11) - turns * 2.0222662487959506e-21;
    const lanes z = y * y, v = z * y;
    const lanes of_sine =
        ((((1.58969099521155e-10 * z - 2.5050760253406863e-08) * z + 2.7557313707070068e-06) * z - 0.0001984126982985795) * z + 0.00833333333332249);
    const lanes s = y - ((z * (tail * 0.5 - v * of_sine) - tail) + v * 0.16666666666666632);
    const lanes of_cosine =
        (((((-1.1359647557788195e-11 * z + 2.087572321298175e-09) * z - 2.7557314351390663e-07) * z + 2.480158728947673e-05) * z - 0.001388888888887411) * z
         + 0.0416666666666666);
    const lanes half = z * 0.5, whole = 1.0 - half;
    const lanes c = whole + (((1.0 - whole) - half) + (z * (z * of_cosine) - y * tail));
    /* Odd quadrants swap them, and two of four turn each sign. */
    const bits quadrant = (bits)shifted, swapped = -(quadrant & 1LL);
    const bits of_s = ((bits)c & swapped) | ((bits)s & ~swapped), of_c = ((bits)s & swapped) | ((bits)c & ~swapped);
    *sine = (lanes)(of_s ^ ((quadrant & 2LL) << 62));
    *cosine = (lanes)(of_c ^ (((quadrant + 1LL) & 2LL) << 62));
    const bits near = (bits)(absolute(x) <= 1e6);
    for (int i = 0; i < LANES; i++)
        if (!near[i]) {
            (*sine)[i] = sin(x[i]);
            (*cosine)[i] = cos(x[i]);
        }
}

/* States into lanes and out: blocks of LANES numbers of LANES states, transposed by exchanging parts of every two of them. */
#if defined(__clang__) || __GNUC__ >= 12
#define MIXED(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else
#define MIXED(a, b, ...) __builtin_shuffle(a, b, (bits){__VA_ARGS__})
#endif
#define EXCHANGED(i, k, low, high) { const lanes a = x[i], b = x[k]; x[i] = MIXED(a, b, low); x[k] = MIXED(a, b, high); }

static inline void transpose(lanes *x)
{
#if LANES == 8
#define LOW_1 0, 8, 2, 10, 4, 12, 6, 14
#define HIGH_1 1, 9, 3, 11, 5, 13, 7, 15
#define LOW_2 0, 1, 8, 9, 4, 5, 12, 13
#define HIGH_2 2, 3, 10, 11, 6, 7, 14, 15
#define LOW_4 0, 1, 2, 3, 8, 9, 10, 11
#define HIGH_4 4, 5, 6, 7, 12, 13, 14, 15
    EXCHANGED(0, 1, LOW_1, HIGH_1) EXCHANGED(2, 3, LOW_1, HIGH_1) EXCHANGED(4, 5, LOW_1, HIGH_1) EXCHANGED(6, 7, LOW_1, HIGH_1)
    EXCHANGED(0, 2, LOW_2, HIGH_2) EXCHANGED(1, 3, LOW_2, HIGH_2) EXCHANGED(4, 6, LOW_2, HIGH_2) EXCHANGED(5, 7, LOW_2, HIGH_2)
    EXCHANGED(0, 4, LOW_4, HIGH_4) EXCHANGED(1, 5, LOW_4, HIGH_4) EXCHANGED(2, 6, LOW_4, HIGH_4) EXCHANGED(3, 7, LOW_4, HIGH_4)
#elif LANES == 4
#define LOW_1 0, 4, 2, 6
#define HIGH_1 1, 5, 3, 7
#define LOW_2 0, 1, 4, 5
#define HIGH_2 2, 3, 6, 7
    EXCHANGED(0, 1, LOW_1, HIGH_1) EXCHANGED(2, 3, LOW_1, HIGH_1)
    EXCHANGED(0, 2, LOW_2, HIGH_2) EXCHANGED(1, 3, LOW_2, HIGH_2)
#else
#define LOW_1 0, 2
#define HIGH_1 1, 3
    EXCHANGED(0, 1, LOW_1, HIGH_1)
#endif
}

/* Where the block begins that holds number i: the last one ends with the state, and shares numbers with the one before. */
static inline size_t block(size_t i, size_t width)
{
    return i + LANES <= width ? i : width < LANES ? 0 : width - LANES;
}

/* Lanes beyond the last state repeat it. */
static inline void gather(lanes *to, const double *from, size_t width, size_t count)
{
    if (count == LANES) {
        for (size_t i = 0; i < width; i += LANES) {
            lanes x[LANES];
            const size_t first = block(i, width);
            for (size_t lane = 0; lane < LANES; lane++) {
                const double *state = from + lane * width + first;
                /* Of narrow states what follows is the next one's, and that of the last is left alone. */
                if (lane * width + first + LANES <= LANES * width) {
                    x[lane] = *(const loose *)state;
                } else {
                    lanes last = {0};
                    for (size_t k = 0; k < LANES && k < width; k++) last[k] = state[k];
                    x[lane] = last;
                }
            }
            transpose(x);
            for (size_t k = 0; k < LANES && k < width; k++) to[first + k] = x[k];
        }
        return;
    }
    for (size_t i = 0; i < width; i++) {
        lanes x = {0};
        for (size_t lane = 0; lane < LANES; lane++) x[lane] = from[(lane < count ? lane : count - 1) * width + i];
        to[i] = x;
    }
}

static inline void scatter(double *to, const lanes *from, size_t width, size_t count)
{
    if (count == LANES) {
        for (size_t i = 0; i < width; i += LANES) {
            lanes x[LANES];
            const size_t first = block(i, width);
            for (size_t k = 0; k < LANES; k++) x[k] = from[k < width ? first + k : 0];
            transpose(x);
            for (size_t lane = 0; lane < LANES; lane++) {
                double *state = to + lane * width + first;
                if (lane * width + first + LANES <= LANES * width) *(loose *)state = x[lane];
                else for (size_t k = 0; k < LANES && k < width; k++) state[k] = x[lane][k];
            }
        }
        return;
    }
    for (size_t lane = 0; lane < count; lane++)
        for (size_t i = 0; i < width; i++) to[lane * width + i] = from[i][lane];
}
";

/// The declaration of the function of many states, without what ends it.
pub(super) fn declaration(name: &str, program: &Program) -> String {
    let (function, all) = (program.function.symbol(), program.named("const double *", "double *"));
    format!("void {name}_{function}_batch(size_t count, {all})")
}

/// The program in lanes, and the function that takes all states through it.
pub(super) fn functions(name: &str, program: &Program, text: &mut String) {
    let function = program.function.symbol();
    let parameters = program.named("const lanes *restrict ", "lanes *restrict ");
    let form = Form {
        head: format!("static void {function}_lanes({parameters})"),
        name: format!("{function}_lanes"),
        parameters,
        names: program.named("", ""),
        number: "lanes",
        is_apart: true,
        // A number by itself is no vector.
        constant: |value| format!("(lanes){{0}} + {value}"),
    };
    let said = (0..program.operations.len()).map(|place| operand(program, place, Width::Double)).collect();
    let mut turned = HashSet::new();
    let statement = |place: usize, said: &mut [String], text: &mut String| {
        let operation = &program.operations[place];
        if let Operation::Sine(a) | Operation::Cosine(a) = *operation {
            if turned.insert(a) {
                let _ = writeln!(text, "    lanes s{a}, c{a};");
                let _ = writeln!(text, "    sine_and_cosine({}, &s{a}, &c{a});", said[a as usize]);
            }
            said[place] = format!("{}{a}", if matches!(operation, Operation::Sine(_)) { 's' } else { 'c' });
        } else if let Some(right) = right_side(operation, said) {
            let _ = writeln!(text, "    const lanes {} = {right};", said[place]);
        }
    };
    pieces::write(program, &form, said, statement, text);

    let _ = write!(text, "\n{}\n{{\n", declaration(name, program));
    text.push_str("    for (size_t first = 0; first < count; first += LANES) {\n");
    text.push_str("        const size_t here = count - first < LANES ? count - first : LANES;\n");
    let all = || program.arguments.iter().chain(&program.results).map(|array| (array.name, array.width()));
    for (array, width) in all() {
        let _ = writeln!(text, "        lanes {array}_[{}];", width.max(1));
    }
    for (array, width) in all().take(program.arguments.len()) {
        let _ = writeln!(text, "        gather({array}_, {array} + first * {width}, {width}, here);");
    }
    let names: Vec<String> = all().map(|(array, _)| format!("{array}_")).collect();
    let _ = writeln!(text, "        {function}_lanes({});", names.join(", "));
    for (array, width) in all().skip(program.arguments.len()) {
        let _ = writeln!(text, "        scatter({array} + first * {width}, {array}_, {width}, here);");
    }
    text.push_str("    }\n}\n");
}

/// What computes a number; nothing of constants and arguments. Of two operands one at least is a vector: what is constant was computed.
fn right_side(operation: &Operation, said: &[String]) -> Option<String> {
    let of = |place: u32| &said[place as usize];
    Some(match *operation {
        Operation::Root(a) => format!("root({})", of(a)),
        Operation::Absolute(a) => format!("absolute({})", of(a)),
        Operation::Smaller(a, b) => format!("smaller({}, {})", of(a), of(b)),
        Operation::OneIfZero(a) => format!("one_if_zero({})", of(a)),
        _ => return super::c::right_side(operation, said, Width::Double),
    })
}

/// A part of the test: some states in a batch, the arguments smaller and smaller, beside each by itself.
pub(super) fn test(name: &str, program: &Program, size: f64, text: &mut String) {
    const STATES: usize = 11;
    let function = program.function.symbol();
    for array in program.arguments.iter().chain(&program.results) {
        let _ = writeln!(text, "        static double many_{}[{}];", array.name, STATES * array.width().max(1));
    }
    let _ = writeln!(text, "        for (int i = 0; i < {STATES}; i++) {{");
    for (argument, from) in program.arguments.iter().zip(GIVEN) {
        let (array, width, scale) =
            (argument.name, argument.width(), if argument.name == "q" { "1" } else { "(1 - 0.05 * i)" });
        let _ = writeln!(
            text,
            "            for (int k = 0; k < {width}; k++) many_{array}[i * {width} + k] = {from}[k] * {scale};"
        );
    }
    let _ = writeln!(text, "        }}");
    let _ = writeln!(text, "        {name}_{function}_batch({STATES}, {});", program.named("many_", "many_"));
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
