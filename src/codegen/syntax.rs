//! How C, CUDA C++ and Rust write the same program: one table of templates per language, which
//! [`pieces`](super::pieces) fills in.
//!
//! A placeholder is a name in braces; doubled braces are braces of the text, as in `format!`.

use super::width::Width;
use crate::scalar::Operation;

/// Templates of one language.
pub(super) struct Syntax {
    /// The type of a scalar in the code of this width.
    pub scalar: fn(Width) -> &'static str,
    /// A constant as an operand, given by its bits.
    pub operand: fn(u64, Width) -> String,
    /// The declaration before the name of a value: `{scalar}`.
    pub declare: &'static str,
    /// A constant as a result: `{value}`.
    pub constant_result: &'static str,
    /// An element of an argument or a result: `{array}`, `{index}`.
    pub element: &'static str,
    /// A constant and an index that differ between calls: `{row}`.
    pub constant_of_call: &'static str,
    pub index_of_call: &'static str,
    /// True if an element of an argument (true) or of the stored values (false) gets a name before its first use.
    pub is_named: fn(bool) -> bool,
    /// One statement for sine and cosine of the same angle: `{scalar}`, `{angle}`, `{place}`; None: two calls.
    pub sine_and_cosine: Option<&'static str>,
    pub expressions: Expressions,
    /// The head of the function of a part: `{name}`, `{index}`, `{parameters}`.
    pub part_head: &'static str,
    /// Parameters of a part: the stored values (`{scalar}`, `{slots}`) and a table (`{kind}`, `{suffix}`, `{width}`).
    pub kept_parameter: &'static str,
    pub table_parameter: &'static str,
    /// Statements that use every parameter once, so that compilers do not warn: `{name}`; empty: none.
    pub unread: &'static str,
    /// A table: `{name}`, `{NAME}`, `{index}`, `{suffix}`, `{SUFFIX}`, `{kind}`, `{width}`, `{rows}`, `{values}`.
    pub table: &'static str,
    /// The delimiters around the values of one call in a table.
    pub row_of_table: [&'static str; 2],
    /// The types of indices in tables: of 16 bits, and longer.
    pub indices: [&'static str; 2],
    /// The type of constants in tables.
    pub constants: fn(Width) -> &'static str,
    /// The array of stored values: `{scalar}`, `{slots}`.
    pub kept: &'static str,
    /// The call of a part (`{name}`, `{index}`, `{names}`, `{tables}`), and one table in it (`{row}` and those of
    /// `table`).
    pub call: &'static str,
    pub table_argument: &'static str,
    /// Several calls: `{start}`, `{end}`, `{call}`; and the name of the row there.
    pub repeat: &'static str,
    pub row: &'static str,
}

/// Operations that the languages write differently. The operands are `{a}`, `{b}` and `{c}`; `{f}` is the suffix of a
/// function's name.
pub(super) struct Expressions {
    product_sum: &'static str,
    minus_product: &'static str,
    root: &'static str,
    sine: &'static str,
    cosine: &'static str,
    absolute: &'static str,
    smaller: &'static str,
    one_if_zero: &'static str,
}

/// The expressions of C and its relatives.
const C_EXPRESSIONS: Expressions = Expressions {
    product_sum: "{a} * {b} + {c}",
    minus_product: "{c} - {a} * {b}",
    root: "sqrt{f}({a})",
    sine: "sin{f}({a})",
    cosine: "cos{f}({a})",
    absolute: "fabs{f}({a})",
    // fmin would ignore NaN.
    smaller: "{a} < {b} || {a} != {a} ? {a} : {b}",
    one_if_zero: "{a} == 0 ? 1 : 0",
};

/// C99, one state.
pub(super) const C: Syntax = Syntax {
    scalar: Width::of_c,
    operand: literal,
    declare: "const {scalar} ",
    constant_result: "{value}",
    element: "{array}[{index}]",
    constant_of_call: "c[{row}]",
    index_of_call: "at[{row}]",
    is_named: |_| false,
    sine_and_cosine: None,
    expressions: C_EXPRESSIONS,
    part_head: "\nstatic APART void {name}_{index}({parameters})\n{{\n",
    kept_parameter: "{scalar} *kept",
    table_parameter: "const {kind} *{suffix}",
    unread: "    (void){name};\n",
    table: "\nstatic const {kind} {name}_{index}_{suffix}[] = {{{values}}};\n",
    row_of_table: ["", ""],
    indices: ["unsigned short", "unsigned"],
    constants: Width::of_c,
    kept: "    {scalar} kept[{slots}];\n",
    call: "    {name}_{index}({names}, kept{tables});\n",
    table_argument: ", {name}_{index}_{suffix} + {row} * {width}",
    repeat: "    for (int i = {start}; i < {end}; i++)\n    {call}",
    row: "i",
};

/// C99, many states: one state per lane of a vector. At least one of two operands is a vector, because constants are
/// folded before.
pub(super) const LANES: Syntax = Syntax {
    scalar: |_| "lanes",
    // A scalar is not a vector.
    constant_result: "(lanes){{0}} + {value}",
    sine_and_cosine: Some(PAIR_OF_C),
    expressions: Expressions {
        root: "root({a})",
        absolute: "absolute({a})",
        smaller: "smaller((lanes){{0}} + {a}, (lanes){{0}} + {b})",
        one_if_zero: "one_if_zero({a})",
        ..C_EXPRESSIONS
    },
    ..C
};

/// CUDA C++, one state per thread, arrays by components.
pub(super) const CUDA: Syntax = Syntax {
    element: "{array}[{index} * count + state]",
    is_named: |is_argument| is_argument,
    sine_and_cosine: Some(PAIR_OF_C),
    part_head: "\n__device__ APART void {name}_{index}({parameters})\n{{\n",
    table: "\n__device__ const {kind} {name}_{index}_{suffix}[] = {{{values}}};\n",
    ..C
};

const PAIR_OF_C: &str = "    {scalar} s{place}, c{place};\n    sine_and_cosine({angle}, &s{place}, &c{place});\n";

/// Rust, generic over the scalar.
pub(super) const RUST: Syntax = Syntax {
    scalar: |_| "T",
    operand: |bits, _| format!("T::constant({:?})", f64::from_bits(bits)),
    declare: "let ",
    constant_result: "{value}",
    element: "{array}[{index}]",
    constant_of_call: "T::constant(c[{row}])",
    index_of_call: "at[{row}] as usize",
    is_named: |_| true,
    sine_and_cosine: Some("    let (s{place}, c{place}) = {angle}.sin_cos();\n"),
    expressions: Expressions {
        product_sum: "{a}.product_sum({b}, {c})",
        minus_product: "{a}.minus_product({b}, {c})",
        root: "{a}.sqrt()",
        // Sine and cosine are always computed together.
        sine: "{a}.sin_cos().0",
        cosine: "{a}.sin_cos().1",
        absolute: "{a}.abs()",
        smaller: "{a}.smaller({b})",
        one_if_zero: "{a}.one_if_zero()",
    },
    part_head: "\n#[rustfmt::skip]\n#[allow(non_snake_case, unused_variables, clippy::approx_constant, \
                clippy::many_single_char_names, clippy::similar_names, clippy::too_many_arguments, \
                clippy::too_many_lines, clippy::unreadable_literal)]\n\
                fn {name}_{index}<T: Number>({parameters}) {{\n",
    kept_parameter: "kept: &mut [T; {slots}]",
    table_parameter: "{suffix}: &[{kind}; {width}]",
    unread: "",
    table: "\n#[rustfmt::skip]\n#[allow(clippy::approx_constant, clippy::unreadable_literal)]\n\
            static {NAME}_{index}_{SUFFIX}: [[{kind}; {width}]; {rows}] = [{values}];\n",
    row_of_table: ["[", "]"],
    indices: ["u16", "u32"],
    constants: |_| "f64",
    kept: "    let mut kept = [T::constant(0.0); {slots}];\n",
    call: "    {name}_{index}({names}, &mut kept{tables});\n",
    table_argument: ", &{NAME}_{index}_{SUFFIX}[{row}]",
    repeat: "    for row in {start}..{end} {{\n    {call}    }}\n",
    row: "row",
};

/// A constant of C as an operand.
fn literal(bits: u64, width: Width) -> String {
    let x = f64::from_bits(bits);
    if x < 0.0 { format!("({})", width.constant(x)) } else { width.constant(x) }
}

impl Syntax {
    /// The expression that computes a value from the names of its operands; None for constants and arguments.
    pub fn right_side(&self, operation: &Operation, names: &[String], width: Width) -> Option<String> {
        let own = &self.expressions;
        let template = match operation {
            Operation::Constant(_) | Operation::Argument(_) => return None,
            Operation::Sum(..) => "{a} + {b}",
            Operation::Difference(..) => "{a} - {b}",
            Operation::Product(..) => "{a} * {b}",
            Operation::ProductSum(..) => own.product_sum,
            Operation::MinusProduct(..) => own.minus_product,
            Operation::Quotient(..) => "{a} / {b}",
            Operation::Negative(_) => "-{a}",
            Operation::Root(_) => own.root,
            Operation::Sine(_) => own.sine,
            Operation::Cosine(_) => own.cosine,
            Operation::Absolute(_) => own.absolute,
            Operation::Smaller(..) => own.smaller,
            Operation::OneIfZero(_) => own.one_if_zero,
        };
        let [a, b, c] =
            super::program::operands(operation).map(|place| place.map_or("", |place| &names[place as usize]));
        Some(filled(template, &[("a", a), ("b", b), ("c", c), ("f", width.suffix())]))
    }
}

/// The template with these values in place of the names in braces.
///
/// # Panics
///
/// For a name without a value.
pub(super) fn filled(template: &str, values: &[(&str, &str)]) -> String {
    let (mut text, mut rest) = (String::with_capacity(2 * template.len()), template);
    while let Some(at) = rest.find(['{', '}']) {
        text.push_str(&rest[..at]);
        let after = &rest[at + 1..];
        if after.starts_with(&rest[at..=at]) {
            text.push_str(&rest[at..=at]);
            rest = &after[1..];
            continue;
        }
        let (name, others) = after.split_once('}').unwrap_or((after, ""));
        let value = values.iter().find(|(known, _)| *known == name);
        text.push_str(value.unwrap_or_else(|| unreachable!("no value for {name} in {template}")).1);
        rest = others;
    }
    text + rest
}
