//! Programs as functions of C or CUDA: a short one is one function; of a long one each part is, and what limbs repeat is called in a loop, with the numbers of each limb in tables.

use super::parts::{Cut, Entry, Given, Part, Run, Source, Tables, parts};
use super::program::Program;
use super::width::Width;
use crate::scalar::Operation;
use std::collections::{HashMap, HashSet};
use std::fmt::Write;

pub(super) use super::parts::is_cut;

/// How a program is written.
pub(super) struct Form {
    /// The declaration of the function.
    pub head: String,
    /// What it does before all else.
    pub before: &'static str,
    /// What the names of its parts begin with.
    pub name: String,
    /// Its parameters, and their names.
    pub parameters: String,
    pub names: String,
    /// The type of a number here, and of those in tables.
    pub number: &'static str,
    pub width: Width,
    /// What stands before the function of a part, and before a table.
    pub of_part: &'static str,
    pub of_table: &'static str,
    /// Whether the caller lets no result overlap an argument: numbers are written then as soon as they are there.
    pub is_apart: bool,
    /// How a constant is written as such a number where it is a result.
    pub constant: fn(&str) -> String,
    /// A number of an argument or a result, by the text of its index.
    pub number_of: fn(&str, &str) -> String,
    /// Whether arguments are read once, and sines computed with their cosines by `sine_and_cosine`.
    pub reads_once: bool,
    pub has_pairs: bool,
    /// What computes a number.
    pub right_side: fn(&Operation, &[String], Width) -> Option<String>,
}

/// What keeps a part apart.
pub(super) const APART: &str =
    "\n#if defined(__GNUC__)\n#define APART __attribute__((noinline))\n#else\n#define APART\n#endif\n";

/// The text of an index.
fn place(tables: &mut Tables, of_calls: &[usize]) -> String {
    match tables.place(of_calls) {
        Entry::Same(place) => place.to_string(),
        Entry::Row(row) => format!("at[{row}]"),
    }
}

/// A constant where it is an operand.
pub(super) fn literal(bits: u64, width: Width) -> String {
    let x = f64::from_bits(bits);
    if x < 0.0 { format!("({})", width.constant(x)) } else { width.constant(x) }
}

/// Writes the function, after its parts where there are several.
pub(super) fn write(program: &Program, form: &Form, text: &mut String) {
    let cut = parts(program);
    if is_cut(program) {
        let tables: Vec<Tables> = (cut.parts.iter().enumerate())
            .map(|(index, part)| {
                let (mut tables, mut inside) = (Tables::default(), String::new());
                body(program, part, form, &mut tables, &mut inside);
                function(program, &cut, (index, form, &tables), &inside, text);
                tables
            })
            .collect();
        let _ = write!(text, "\n{}\n{{\n{}", form.head, form.before);
        calls(program, &cut, form, &tables, text);
    } else {
        let _ = write!(text, "\n{}\n{{\n{}", form.head, form.before);
        // One, or none where nothing is to be computed.
        for part in &cut.parts {
            body(program, part, form, &mut Tables::default(), text);
        }
    }
    for &(result, index, source) in &cut.others {
        if let Source::Leaf(place) = source {
            let value = match program.operations[place] {
                Operation::Argument(of) => {
                    let (array, at) = program.argument(of);
                    (form.number_of)(array.name, &at.to_string())
                }
                Operation::Constant(bits) => (form.constant)(&literal(bits, form.width)),
                _ => continue,
            };
            put(program, form, (result, &index.to_string()), &value, text);
        }
    }
    if !is_cut(program) {
        unread(program.unread(), text);
    }
    text.push_str("}\n");
}

/// What nothing reads is no fault.
fn unread<'a>(names: impl Iterator<Item = &'a str>, text: &mut String) {
    for name in names {
        let _ = writeln!(text, "    (void){name};");
    }
}

/// A number becomes one of a result.
fn put(program: &Program, form: &Form, (result, index): (usize, &str), value: &str, text: &mut String) {
    let _ = writeln!(text, "    {} = {value};", (form.number_of)(program.results[result].name, index));
}

/// The statements of a part.
fn body(program: &Program, part: &Part, form: &Form, tables: &mut Tables, text: &mut String) {
    let mut said: Vec<String> = vec![String::new(); part.given.len()];
    // Where numbers go, by their operations.
    let mut goes: HashMap<usize, Vec<String>> = HashMap::new();
    for (at, slots) in &part.keeps {
        goes.entry(*at).or_default().push(format!("kept[{}]", place(tables, slots)));
    }
    for (at, result, indices) in &part.writes {
        let index = place(tables, indices);
        goes.entry(*at).or_default().push((form.number_of)(program.results[*result].name, &index));
    }
    let (mut turned, mut late) = (HashSet::new(), String::new());
    for (at, operation) in part.operations.iter().enumerate() {
        for operand in super::program::operands(operation).into_iter().flatten() {
            let operand = operand as usize;
            if operand < part.given.len() && said[operand].is_empty() {
                said[operand] = given(program, (operand, &part.given[operand]), form, tables, text);
            }
        }
        said.push(statement(operation, (at, &said), form, &mut turned, text));
        for to in goes.remove(&at).unwrap_or_default() {
            let text = if form.is_apart || is_cut(program) { &mut *text } else { &mut late };
            let _ = writeln!(text, "    {to} = {};", said[part.given.len() + at]);
        }
    }
    text.push_str(&late);
}

/// Computes a number, and gives its name.
fn statement(
    operation: &Operation,
    (at, said): (usize, &[String]),
    form: &Form,
    turned: &mut HashSet<u32>,
    text: &mut String,
) -> String {
    if let (Operation::Sine(a) | Operation::Cosine(a), true) = (*operation, form.has_pairs) {
        if turned.insert(a) {
            let _ = writeln!(text, "    {} s{a}, c{a};", form.number);
            let _ = writeln!(text, "    sine_and_cosine({}, &s{a}, &c{a});", said[a as usize]);
        }
        return format!("{}{a}", if matches!(operation, Operation::Sine(_)) { 's' } else { 'c' });
    }
    let right = (form.right_side)(operation, said, form.width).unwrap_or_default();
    let _ = writeln!(text, "    const {} x{at} = {right};", form.number);
    format!("x{at}")
}

/// What a given number is called; one that is read by way of a table, or once only, gets a name of its own.
fn given(
    program: &Program,
    (index, given): (usize, &Given),
    form: &Form,
    tables: &mut Tables,
    text: &mut String,
) -> String {
    let before = tables.places();
    let (value, is_argument) = match given {
        Given::Constants(bits) => {
            return match tables.constant(bits) {
                Entry::Same(bits) => literal(bits, form.width),
                Entry::Row(row) => format!("c[{row}]"),
            };
        }
        Given::Arguments(array, indices) => {
            ((form.number_of)(program.arguments[*array].name, &place(tables, indices)), true)
        }
        Given::Kept(slots) => (format!("kept[{}]", place(tables, slots)), false),
    };
    if tables.places() == before && !(is_argument && form.reads_once) {
        return value;
    }
    let _ = writeln!(text, "    const {} g{index} = {value};", form.number);
    format!("g{index}")
}

/// The tables of a part: what each is called where it is read, the type of its numbers, and the numbers of each call.
fn tables_of(
    program: &Program,
    cut: &Cut,
    width: Width,
    tables: &Tables,
) -> [(&'static str, &'static str, Vec<Vec<String>>); 2] {
    let all = |rows: Vec<Vec<f64>>| rows.iter().map(|row| row.iter().map(|&x| width.constant(x)).collect()).collect();
    let constants = all(tables.constants_by_calls());
    let places = tables.places_by_calls().iter().map(|row| row.iter().map(usize::to_string).collect()).collect();
    let of_places = if cut.has_short_places(program) { "unsigned short" } else { "unsigned" };
    [("c", width.of_c(), constants), ("at", of_places, places)]
}

/// The function of a part after its tables.
fn function(
    program: &Program,
    cut: &Cut,
    (index, form, tables): (usize, &Form, &Tables),
    inside: &str,
    text: &mut String,
) {
    let (name, table) = (&form.name, form.of_table);
    let mut parameters = format!("{}, {} *kept", form.parameters, form.number);
    for (suffix, kind, rows) in tables_of(program, cut, form.width, tables) {
        if !rows.is_empty() {
            let _ =
                write!(text, "\n{table} const {kind} {name}_{index}_{suffix}[] = {{{}}};\n", rows.concat().join(", "));
            let _ = write!(parameters, ", const {kind} *{suffix}");
        }
    }
    let _ = write!(text, "\n{} void {name}_{index}({parameters})\n{{\n{inside}", form.of_part);
    unread(form.names.split(", ").chain(["kept"]), text);
    text.push_str("}\n");
}

/// The calls of all parts, those of one part after another in a loop.
fn calls(program: &Program, cut: &Cut, form: &Form, tables: &[Tables], text: &mut String) {
    let _ = writeln!(text, "    {} kept[{}];", form.number, cut.slots.max(1));
    for Run { part, rows, then } in cut.runs() {
        let row = if rows.len() > 1 {
            let _ = write!(text, "    for (int i = {}; i < {}; i++)\n    ", rows.start, rows.end);
            "i".to_owned()
        } else {
            rows.start.to_string()
        };
        let name = format!("{}_{part}", form.name);
        let _ = write!(text, "    {name}({}, kept", form.names);
        for (suffix, width) in tables[part].widths() {
            let _ = write!(text, ", {name}_{suffix} + {row} * {width}");
        }
        text.push_str(");\n");
        for (result, index, slot) in then {
            put(program, form, (result, &index.to_string()), &format!("kept[{slot}]"), text);
        }
    }
}
