//! docs/equations.md compared with the paper, the tests and the sources: every equation has a row, and the names in
//! the row exist.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Last equation of each section; section 0 is the introduction, whose two definitions are not numbered in print.
const LAST: [usize; 7] = [2, 7, 11, 14, 11, 7, 4];

/// Columns of a row: equation, printed, as implemented, Rust, Python, test, note.
const COLUMNS: usize = 7;
const RUST: usize = 3;
const PYTHON: usize = 4;
const TEST: usize = 5;

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// Concatenated text of all Rust files below a folder.
fn sources(folder: &Path) -> String {
    let mut text = String::new();
    let mut entries: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            text += &sources(&path);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            text += &fs::read_to_string(&path).unwrap();
        }
    }
    text
}

/// Text between backticks.
fn quoted(cell: &str) -> Vec<&str> {
    cell.split('`').skip(1).step_by(2).collect()
}

/// Cells of every row whose first cell is an equation number, by that number.
fn rows(page: &str) -> BTreeMap<(usize, usize), Vec<&str>> {
    let mut rows = BTreeMap::new();
    for line in page.lines().filter(|line| line.starts_with("| ")) {
        let cells: Vec<&str> = line.trim_matches('|').split('|').map(str::trim).collect();
        let Some((section, number)) = cells[0].split_once('.') else { continue };
        let (Ok(section), Ok(number)) = (section.parse(), number.parse()) else { continue };
        assert_eq!(cells.len(), COLUMNS, "{line}");
        assert!(rows.insert((section, number), cells).is_none(), "two rows for {section}.{number}");
    }
    rows
}

/// The body of a test, from its name to the end of the function.
fn body<'a>(tests: &'a str, name: &str) -> &'a str {
    let start = tests.find(&format!("#[test]\nfn {name}() {{")).unwrap_or_else(|| panic!("no test {name}"));
    let end = tests[start..].find("\n}\n").expect("a function ends");
    &tests[start..start + end]
}

fn page() -> String {
    fs::read_to_string(root().join("docs/equations.md")).unwrap()
}

#[test]
fn every_equation_has_one_row() {
    let page = page();
    let expected: Vec<_> =
        LAST.iter().enumerate().flat_map(|(section, &last)| (1..=last).map(move |i| (section, i))).collect();
    let found: Vec<_> = rows(&page).into_keys().collect();
    assert_eq!(found, expected);
}

#[test]
fn every_row_names_a_test_of_its_own() {
    let (page, tests) = (page(), sources(&root().join("tests")));
    for ((section, number), cells) in rows(&page) {
        let names = quoted(cells[TEST]);
        assert!(!names.is_empty(), "{section}.{number} names no test");
        for name in &names {
            assert!(name.starts_with(&format!("eq_{section}_{number}_")), "{name} in the row of {section}.{number}");
            let body = body(&tests, name);
            // Marks: s if samples are compared, x if a printed form is shown to be wrong.
            let marks: Vec<&str> = cells[TEST].rsplit('`').next().unwrap().split_whitespace().collect();
            let draws = body.contains("has_covariance(") || body.contains("mean_square(");
            assert_eq!(marks.contains(&"s"), draws, "{name}: the mark s");
            let fails = body.contains(".fails(") || body.contains("PRINTED_FORM_MARGIN");
            assert!(fails || !marks.contains(&"x"), "{name} shows no printed form failing");
        }
    }
}

#[test]
fn every_test_of_the_paper_is_in_the_table() {
    let (page, mut count) = (page(), 0_usize);
    for name in sources(&root().join("tests")).split("#[test]\nfn ").skip(1).filter_map(|rest| rest.split_once('(')) {
        if name.0.starts_with("eq_") || name.0.starts_with("result_") {
            assert!(page.contains(&format!("`{}`", name.0)), "{} is not in docs/equations.md", name.0);
            count += 1;
        }
    }
    assert!(count >= LAST.iter().sum::<usize>());
}

#[test]
fn every_row_names_functions_that_exist() {
    let page = page();
    let code = sources(&root().join("src"));
    let operators = fs::read_to_string(root().join("python/phipsi/operators.py")).unwrap();
    for ((section, number), cells) in rows(&page) {
        let functions = quoted(cells[RUST]);
        assert!(!functions.is_empty(), "{section}.{number} names no function");
        for path in functions {
            let last = path.rsplit("::").next().unwrap();
            let variant = path.contains("Kind::") && code.contains(&format!("\n        {last} = \""));
            let item = ["fn ", "struct "]
                .iter()
                .any(|kind| ["<", "("].iter().any(|after| code.contains(&format!("pub {kind}{last}{after}"))));
            assert!(variant || item, "{section}.{number}: no {path} in src/");
        }
        let expressions = quoted(cells[PYTHON]);
        assert!(!expressions.is_empty(), "{section}.{number} has nothing in Python");
        for attribute in expressions.iter().flat_map(|expression| expression.split("f.").skip(1)) {
            let name: String = attribute.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
            assert!(operators.contains(&format!("def {name}(")), "{section}.{number}: no f.{name} in Python");
        }
    }
}
