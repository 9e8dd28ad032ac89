//! Programs as functions. A short program is one function; each part of a long one is a function, and a part that limbs
//! repeat is called in a loop, with the values of each limb in tables. [`Syntax`] has the templates of the language.

use super::parts::{Cut, Entry, Given, Part, Run, Source, Tables, parts};
use super::program::{Program, operands};
use super::syntax::{Syntax, filled};
use super::width::Width;
use crate::scalar::Operation;
use std::collections::{HashMap, HashSet};
use std::fmt::Write;

pub(super) use super::parts::is_cut;

/// The form of a program in the code.
pub(super) struct Form<'a> {
    pub syntax: &'a Syntax,
    pub width: Width,
    /// The text before the first statement of the function, and after the last.
    pub head: String,
    pub tail: String,
    /// The prefix of the names of its parts.
    pub name: String,
    /// The parameters of its parts, and the arguments in calls of them.
    pub parameters: String,
    pub names: String,
    /// True if the caller guarantees that no result overlaps an argument: results are then written as soon as they are
    /// computed.
    pub is_apart: bool,
}

/// The macro that prevents the inlining of a part.
pub(super) const APART: &str =
    "\n#if defined(__GNUC__)\n#define APART __attribute__((noinline))\n#else\n#define APART\n#endif\n";

impl Form<'_> {
    fn scalar(&self) -> &'static str {
        (self.syntax.scalar)(self.width)
    }

    fn element(&self, array: &str, index: &str) -> String {
        filled(self.syntax.element, &[("array", array), ("index", index)])
    }

    /// Gives a name to a value.
    fn declare(&self, name: &str, value: &str, text: &mut String) {
        let declare = filled(self.syntax.declare, &[("scalar", self.scalar())]);
        let _ = writeln!(text, "    {declare}{name} = {value};");
    }

    /// The text of an index.
    fn index(&self, tables: &mut Tables, of_calls: &[usize]) -> String {
        match tables.place(of_calls) {
            Entry::Same(place) => place.to_string(),
            Entry::Row(row) => filled(self.syntax.index_of_call, &[("row", &row.to_string())]),
        }
    }

    /// Statements that use otherwise unused names.
    fn unread<'n>(&self, names: impl Iterator<Item = &'n str>, text: &mut String) {
        for name in names {
            text.push_str(&filled(self.syntax.unread, &[("name", name)]));
        }
    }

    /// The template of a table or of its use; `more` are values that only one of them has.
    fn of_table(&self, template: &str, index: usize, suffix: &str, more: &[(&str, &str)]) -> String {
        let (index, upper) = (index.to_string(), [self.name.to_uppercase(), suffix.to_uppercase()]);
        let known = [
            ("name", &self.name[..]),
            ("NAME", &upper[0]),
            ("index", &index),
            ("suffix", suffix),
            ("SUFFIX", &upper[1]),
        ];
        filled(template, &[&known, more].concat())
    }
}

/// The functions of the parts (none for a short program), and the function itself.
pub(super) fn write(program: &Program, form: &Form) -> [String; 2] {
    let (cut, mut apart, mut text) = (parts(program), String::new(), form.head.clone());
    if is_cut(program) {
        let tables: Vec<Tables> = (cut.parts.iter().enumerate())
            .map(|(index, part)| {
                let (mut tables, mut inside) = (Tables::default(), String::new());
                body(program, part, form, &mut tables, &mut inside);
                function(program, &cut, (index, form, &tables), &inside, &mut apart);
                tables
            })
            .collect();
        calls(program, &cut, form, &tables, &mut text);
    } else {
        // One, or none if there is nothing to compute.
        for part in &cut.parts {
            body(program, part, form, &mut Tables::default(), &mut text);
        }
    }
    for &(result, index, source) in &cut.others {
        if let Source::Leaf(place) = source {
            let value = match program.operations[place] {
                Operation::Argument(of) => {
                    let (array, at) = program.argument(of);
                    form.element(array.name, &at.to_string())
                }
                Operation::Constant(bits) => {
                    let value = (form.syntax.operand)(bits, form.width);
                    filled(form.syntax.constant_result, &[("value", &value)])
                }
                _ => continue,
            };
            put(program, form, (result, &index.to_string()), &value, &mut text);
        }
    }
    if !is_cut(program) {
        form.unread(program.unread(), &mut text);
    }
    [apart, text + &form.tail]
}

/// Writes a value to an element of a result.
fn put(program: &Program, form: &Form, (result, index): (usize, &str), value: &str, text: &mut String) {
    let _ = writeln!(text, "    {} = {value};", form.element(program.results[result].name, index));
}

/// The statements of a part.
fn body(program: &Program, part: &Part, form: &Form, tables: &mut Tables, text: &mut String) {
    let mut names: Vec<String> = vec![String::new(); part.given.len()];
    // The places where values are stored, by their operations.
    let mut targets: HashMap<usize, Vec<String>> = HashMap::new();
    for (at, slots) in &part.keeps {
        targets.entry(*at).or_default().push(format!("kept[{}]", form.index(tables, slots)));
    }
    for (at, result, indices) in &part.writes {
        let index = form.index(tables, indices);
        targets.entry(*at).or_default().push(form.element(program.results[*result].name, &index));
    }
    let (mut angles, mut late) = (HashSet::new(), String::new());
    for (at, operation) in part.operations.iter().enumerate() {
        for operand in operands(operation).into_iter().flatten() {
            let operand = operand as usize;
            if operand < part.given.len() && names[operand].is_empty() {
                names[operand] = given(program, (operand, &part.given[operand]), form, tables, text);
            }
        }
        names.push(statement(operation, (at, &names), form, &mut angles, text));
        for target in targets.remove(&at).unwrap_or_default() {
            let text = if form.is_apart || is_cut(program) { &mut *text } else { &mut late };
            let _ = writeln!(text, "    {target} = {};", names[part.given.len() + at]);
        }
    }
    text.push_str(&late);
}

/// Computes a value, and returns its name.
fn statement(
    operation: &Operation,
    (at, names): (usize, &[String]),
    form: &Form,
    angles: &mut HashSet<u32>,
    text: &mut String,
) -> String {
    if let (Operation::Sine(a) | Operation::Cosine(a), Some(template)) = (*operation, form.syntax.sine_and_cosine) {
        if angles.insert(a) {
            let place = a.to_string();
            let values = [("scalar", form.scalar()), ("angle", &names[a as usize]), ("place", &place)];
            text.push_str(&filled(template, &values));
        }
        return name_of_pair(operation, a);
    }
    let name = format!("x{at}");
    form.declare(&name, &form.syntax.right_side(operation, names, form.width).unwrap_or_default(), text);
    name
}

/// The name of a sine or a cosine that was computed together with the other.
pub(super) fn name_of_pair(operation: &Operation, angle: u32) -> String {
    format!("{}{angle}", if matches!(operation, Operation::Sine(_)) { 's' } else { 'c' })
}

/// The expression of a given value. Gives it a name if the language requires one or if its index is read from a table.
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
                Entry::Same(bits) => (form.syntax.operand)(bits, form.width),
                Entry::Row(row) => filled(form.syntax.constant_of_call, &[("row", &row.to_string())]),
            };
        }
        Given::Arguments(array, indices) => {
            (form.element(program.arguments[*array].name, &form.index(tables, indices)), true)
        }
        Given::Kept(slots) => (format!("kept[{}]", form.index(tables, slots)), false),
    };
    if tables.places() == before && !(form.syntax.is_named)(is_argument) {
        return value;
    }
    let name = format!("g{index}");
    form.declare(&name, &value, text);
    name
}

/// The function of a part after its tables.
fn function(
    program: &Program,
    cut: &Cut,
    (index, form, tables): (usize, &Form, &Tables),
    inside: &str,
    text: &mut String,
) {
    let (syntax, slots) = (form.syntax, cut.slots.max(1).to_string());
    let kept = filled(syntax.kept_parameter, &[("scalar", form.scalar()), ("slots", &slots)]);
    let mut parameters = format!("{}, {kept}", form.parameters);
    let numbers = tables.constants_by_calls();
    let constants = numbers.iter().map(|row| row.iter().map(|&x| form.width.constant(x)).collect());
    let indices = tables.places_by_calls().iter().map(|row| row.iter().map(usize::to_string).collect()).collect();
    let of_indices = syntax.indices[usize::from(!cut.has_short_places(program))];
    let all: [(_, _, Vec<Vec<String>>); 2] =
        [("c", (syntax.constants)(form.width), constants.collect()), ("at", of_indices, indices)];
    for (suffix, kind, rows) in all {
        let Some(first) = rows.first() else { continue };
        let (width, count) = (first.len().to_string(), rows.len().to_string());
        let [before, after] = syntax.row_of_table;
        let values: Vec<String> = rows.iter().map(|row| format!("{before}{}{after}", row.join(", "))).collect();
        let more = [("kind", kind), ("width", &width), ("rows", &count), ("values", &values.join(", "))];
        text.push_str(&form.of_table(syntax.table, index, suffix, &more));
        let _ = write!(parameters, ", {}", form.of_table(syntax.table_parameter, index, suffix, &more));
    }
    text.push_str(&form.of_table(syntax.part_head, index, "", &[("parameters", &parameters)]));
    text.push_str(inside);
    form.unread(form.names.split(", ").chain(["kept"]), text);
    text.push_str("}\n");
}

/// The calls of all parts; consecutive calls of one part are in a loop.
fn calls(program: &Program, cut: &Cut, form: &Form, tables: &[Tables], text: &mut String) {
    let (syntax, slots) = (form.syntax, cut.slots.max(1).to_string());
    text.push_str(&filled(syntax.kept, &[("scalar", form.scalar()), ("slots", &slots)]));
    for Run { part, rows, then } in cut.runs() {
        let row = if rows.len() > 1 { syntax.row.to_owned() } else { rows.start.to_string() };
        let of_call = tables[part].widths().map(|(suffix, width)| {
            form.of_table(syntax.table_argument, part, suffix, &[("row", &row), ("width", &width.to_string())])
        });
        let of_call: String = of_call.collect();
        let call = form.of_table(syntax.call, part, "", &[("names", &form.names), ("tables", &of_call)]);
        if rows.len() > 1 {
            let (start, end) = (rows.start.to_string(), rows.end.to_string());
            text.push_str(&filled(syntax.repeat, &[("start", &start), ("end", &end), ("call", &call)]));
        } else {
            text.push_str(&call);
        }
        for (result, index, slot) in then {
            put(program, form, (result, &index.to_string()), &format!("kept[{slot}]"), text);
        }
    }
}
