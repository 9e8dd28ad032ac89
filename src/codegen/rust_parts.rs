//! Rust of long programs: a function for each part, and tables of what differs from call to call.

use super::functions::Array;
use super::parts::{Cut, Entry, Given, Part, Run, Source, Tables, parts};
use super::program::{Program, operands};
use super::rust::{argument, constant, right_side, several};
use crate::scalar::Operation;
use std::collections::{HashMap, HashSet};
use std::fmt::Write;

/// What the compiler is told of each function.
const ALLOWED: &str = "#[rustfmt::skip]\n#[allow(non_snake_case, unused_variables, clippy::approx_constant, clippy::many_single_char_names, clippy::similar_names, clippy::too_many_arguments, clippy::too_many_lines, clippy::unreadable_literal)]\n";

/// Writes the body of the function to `text`, and its parts with their tables to `apart`.
pub(super) fn write(program: &Program, apart: &mut String, text: &mut String) {
    let cut = parts(program);
    let (function, results) = (program.function.symbol(), Array::sized(&program.results));
    let tables: Vec<Tables> =
        cut.parts.iter().enumerate().map(|(index, part)| function_of(program, &cut, (index, part), apart)).collect();
    for (name, width) in &results {
        let _ = writeln!(text, "    let mut {name} = [T::constant(0.0); {width}];");
    }
    let _ = writeln!(text, "    let mut kept = [T::constant(0.0); {}];", cut.slots);
    let given = program.arguments.iter().map(|array| array.name.to_owned());
    let given: Vec<String> = given.chain(results.iter().map(|(name, _)| format!("&mut {name}"))).collect();
    for Run { part, rows, then } in cut.runs() {
        let row = if rows.len() > 1 { "row".to_owned() } else { rows.start.to_string() };
        let of_call = tables[part]
            .widths()
            .map(|(suffix, _)| format!(", &{}_{part}_{}[{row}]", function.to_uppercase(), suffix.to_uppercase()));
        let call = format!("{function}_{part}({}, &mut kept{});", given.join(", "), of_call.collect::<String>());
        let _ = if rows.len() > 1 {
            writeln!(text, "    for row in {}..{} {{\n        {call}\n    }}", rows.start, rows.end)
        } else {
            writeln!(text, "    {call}")
        };
        for (result, index, slot) in then {
            let _ = writeln!(text, "    {}[{index}] = kept[{slot}];", results[result].0);
        }
    }
    for &(result, index, source) in &cut.others {
        let Source::Leaf(place) = source else { continue };
        let value = match program.operations[place] {
            Operation::Constant(bits) => constant(bits),
            Operation::Argument(index) => argument(program, index),
            _ => continue,
        };
        let _ = writeln!(text, "    {}[{index}] = {value};", results[result].0);
    }
    let names: Vec<String> = results.iter().map(|(name, _)| (*name).to_owned()).collect();
    let _ = write!(text, "    {}\n}}\n", several(&names));
}

/// The tables of a part: what each is called where it is read, its type, and a row for each call.
fn tables_of(cut: &Cut, program: &Program, tables: &Tables) -> [(&'static str, &'static str, Vec<String>); 2] {
    let of_places = if cut.has_short_places(program) { "u16" } else { "u32" };
    [
        ("c", "f64", tables.constants_by_calls().iter().map(|row| format!("{row:?}")).collect()),
        ("at", of_places, tables.places_by_calls().iter().map(|row| format!("{row:?}")).collect()),
    ]
}

/// Writes the function of a part after its tables.
fn function_of(program: &Program, cut: &Cut, (index, part): (usize, &Part), text: &mut String) -> Tables {
    let (mut tables, mut inside) = (Tables::default(), String::new());
    body(program, part, &mut tables, &mut inside);
    let function = format!("{}_{index}", program.function.symbol());
    let array = |name: &str, is_result: bool, width: usize| {
        format!("{name}: &{}[T; {width}]", if is_result { "mut " } else { "" })
    };
    let mut parameters: Vec<String> =
        Array::sized(&program.arguments).iter().map(|&(name, width)| array(name, false, width)).collect();
    parameters.extend(Array::sized(&program.results).iter().map(|&(name, width)| array(name, true, width)));
    parameters.push(array("kept", true, cut.slots));
    for (suffix, number, rows) in tables_of(cut, program, &tables) {
        if let Some(first) = rows.first() {
            let kind = format!("[{number}; {}]", first.split(", ").count());
            parameters.push(format!("{suffix}: &{kind}"));
            let name = format!("{}_{}", function.to_uppercase(), suffix.to_uppercase());
            let _ = write!(
                text,
                "\n#[rustfmt::skip]\n#[allow(clippy::approx_constant, clippy::unreadable_literal)]\nstatic {name}: [{kind}; {}] = [{}];\n",
                rows.len(),
                rows.join(", ")
            );
        }
    }
    let _ = write!(text, "\n{ALLOWED}fn {function}<T: Number>({}) {{\n{inside}}}\n", parameters.join(", "));
    tables
}

/// The text of an index.
fn place(tables: &mut Tables, of_calls: &[usize]) -> String {
    match tables.place(of_calls) {
        Entry::Same(place) => place.to_string(),
        Entry::Row(row) => format!("at[{row}] as usize"),
    }
}

/// The statements of a part.
fn body(program: &Program, part: &Part, tables: &mut Tables, text: &mut String) {
    let mut goes: HashMap<usize, Vec<String>> = HashMap::new();
    for (at, slots) in &part.keeps {
        goes.entry(*at).or_default().push(format!("kept[{}]", place(tables, slots)));
    }
    for (at, result, indices) in &part.writes {
        let to = format!("{}[{}]", program.results[*result].name, place(tables, indices));
        goes.entry(*at).or_default().push(to);
    }
    let (mut said, mut turned) = (vec![String::new(); part.given.len()], HashSet::new());
    for (at, operation) in part.operations.iter().enumerate() {
        for operand in operands(operation).into_iter().flatten() {
            let index = operand as usize;
            if index < part.given.len() && said[index].is_empty() {
                said[index] = given(program, (index, &part.given[index]), tables, text);
            }
        }
        let name = match *operation {
            Operation::Sine(a) | Operation::Cosine(a) => {
                if turned.insert(a) {
                    let _ = writeln!(text, "    let (s{a}, c{a}) = {}.sin_cos();", said[a as usize]);
                }
                format!("{}{a}", if matches!(operation, Operation::Sine(_)) { 's' } else { 'c' })
            }
            _ => {
                let right = right_side(operation, &said).unwrap_or_default();
                let _ = writeln!(text, "    let x{at} = {right};");
                format!("x{at}")
            }
        };
        for to in goes.remove(&at).unwrap_or_default() {
            let _ = writeln!(text, "    {to} = {name};");
        }
        said.push(name);
    }
}

/// What a given number is called; one that is read from an array that the part writes gets a name of its own.
fn given(program: &Program, (index, given): (usize, &Given), tables: &mut Tables, text: &mut String) -> String {
    let value = match given {
        Given::Constants(bits) => match tables.constant(bits) {
            Entry::Same(bits) => return constant(bits),
            Entry::Row(row) => return format!("T::constant(c[{row}])"),
        },
        Given::Arguments(array, indices) => format!("{}[{}]", program.arguments[*array].name, place(tables, indices)),
        Given::Kept(slots) => format!("kept[{}]", place(tables, slots)),
    };
    let _ = writeln!(text, "    let g{index} = {value};");
    format!("g{index}")
}
