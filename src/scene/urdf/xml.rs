//! What the reader needs of XML: a parsed document, and elements that know the link or joint they are part of, so that
//! every complaint names it.

use crate::error::Error;
use nalgebra::Vector3;
use roxmltree::{Document, Node, ParsingOptions};

/// Parses a document. A byte order mark and white space before the XML declaration are passed over; a document type is
/// let be, but not with entities, which nothing in a URDF needs and with which a small file can grow without bound.
pub(super) fn parse<'a>(xml: &'a str, source: &str) -> Result<Document<'a>, Error> {
    let body = xml.trim_start_matches(|c: char| c == '\u{feff}' || c.is_ascii_whitespace());
    if !body.starts_with('<') {
        let found = if body.is_empty() { "nothing".into() } else { format!("text that starts with {}", quoted(body)) };
        return Err(Error::scene(
            source,
            found,
            "XML with a <robot> element (from_urdf takes the text, from_urdf_file a path)",
        ));
    }
    let options = ParsingOptions { allow_dtd: !body.contains("<!ENTITY"), ..ParsingOptions::default() };
    Document::parse_with_options(body, options).map_err(|error| {
        use roxmltree::Error::{DtdDetected, UnclosedRootNode, UnexpectedEndOfStream};
        if matches!(error, DtdDetected) {
            return Error::scene(source, "a document type that declares entities", "XML without entities");
        }
        // roxmltree counts from the start of `body`, and says 1:1 of what only the end of the document shows.
        let at_end = matches!(error, UnclosedRootNode | UnexpectedEndOfStream);
        let within = error.pos();
        let place = if at_end { end_of(xml) } else { after(&xml[..xml.len() - body.len()], within.row, within.col) };
        let reason = error.to_string().replace(&format!(" at {within}"), "");
        Error::scene(place_in(source, place), format!("malformed XML ({reason})"), "well-formed XML")
    })
}

/// Line and column, both from 1, of the end of a text.
fn end_of(text: &str) -> (u32, u32) {
    after(text, 1, 1)
}

/// Where line `row`, column `column` of a text comes to be when `prefix` is put before it.
fn after(prefix: &str, row: u32, column: u32) -> (u32, u32) {
    let count = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
    let last_line = prefix.rsplit('\n').next().unwrap_or_default();
    let lines = count(prefix.matches('\n').count());
    (row.saturating_add(lines), if row == 1 { column.saturating_add(count(last_line.chars().count())) } else { column })
}

fn place_in(source: &str, (line, column): (u32, u32)) -> String {
    format!("{source}, line {line}, column {column}")
}

/// Where an element is, for those that have no name to go by.
pub(super) fn position(node: &Node, source: &str) -> String {
    let within = node.document().text_pos_at(node.range().start);
    place_in(source, (within.row, within.col))
}

/// A piece of the file for a message, cut to a readable length.
pub(super) fn quoted(text: &str) -> String {
    match text.char_indices().nth(60) {
        Some((end, _)) => format!("{:?}...", &text[..end]),
        None => format!("{text:?}"),
    }
}

/// An element of a link or joint.
pub(super) struct Element<'a> {
    node: Node<'a, 'a>,
    /// The `<link>` or `<joint>` that it is part of, or is.
    owner: Node<'a, 'a>,
}

impl<'a> Element<'a> {
    /// A `<link>` or `<joint>`, which must have a name.
    pub(super) fn named(node: Node<'a, 'a>, source: &str) -> Result<Self, Error> {
        match node.attribute("name") {
            Some(name) if !name.is_empty() => Ok(Self { node, owner: node }),
            _ => {
                let tag = node.tag_name().name();
                Err(Error::scene(
                    position(&node, source),
                    format!("a <{tag}> without name"),
                    format!("<{tag} name=\"...\">"),
                ))
            }
        }
    }

    /// The name of the link or joint.
    pub(super) fn name(&self) -> &'a str {
        self.owner.attribute("name").unwrap_or_default()
    }

    /// The first child element of that name.
    pub(super) fn child(&self, name: &str) -> Option<Self> {
        let namespace = self.node.tag_name().namespace();
        self.node
            .children()
            .find(|child| child.tag_name().name() == name && child.tag_name().namespace() == namespace)
            .map(|node| Self { node, owner: self.owner })
    }

    /// The child element of that name, or an error that says what was `expected`.
    pub(super) fn required_child(&self, name: &str, expected: &str) -> Result<Self, Error> {
        self.child(name).ok_or_else(|| self.refuse(format!("no <{name}>{}", self.within()), expected))
    }

    /// An attribute as text.
    pub(super) fn text(&self, attribute: &str) -> Option<&'a str> {
        self.node.attribute(attribute)
    }

    /// An attribute as text that must be there.
    pub(super) fn required(&self, attribute: &str) -> Result<&'a str, Error> {
        self.text(attribute).ok_or_else(|| self.missing(attribute))
    }

    /// An attribute as a finite number.
    pub(super) fn number(&self, attribute: &str) -> Result<Option<f64>, Error> {
        match self.numbers::<1>(attribute, "a number")? {
            Some([value]) if !value.is_finite() => Err(self.bad(attribute, "a finite number")),
            found => Ok(found.map(|[value]| value)),
        }
    }

    /// An attribute as a finite number that must be there.
    pub(super) fn required_number(&self, attribute: &str) -> Result<f64, Error> {
        self.number(attribute)?.ok_or_else(|| self.missing(attribute))
    }

    /// An attribute as a number that may be infinite: a limit that is none.
    pub(super) fn limit(&self, attribute: &str) -> Result<Option<f64>, Error> {
        match self.numbers::<1>(attribute, "a number")? {
            Some([value]) if value.is_nan() => Err(self.bad(attribute, "a number")),
            found => Ok(found.map(|[value]| value)),
        }
    }

    /// An attribute as three finite numbers.
    pub(super) fn vector(&self, attribute: &str) -> Result<Option<Vector3<f64>>, Error> {
        match self.numbers::<3>(attribute, "three numbers")? {
            Some(values) if !values.iter().all(|x| x.is_finite()) => Err(self.bad(attribute, "three finite numbers")),
            found => Ok(found.map(Vector3::from)),
        }
    }

    /// An attribute as exactly N numbers apart by white space.
    fn numbers<const N: usize>(&self, attribute: &str, expected: &str) -> Result<Option<[f64; N]>, Error> {
        let Some(text) = self.text(attribute) else {
            return Ok(None);
        };
        let mut words = text.split_ascii_whitespace();
        let mut values = [0.0; N];
        for value in &mut values {
            *value = words.next().and_then(|word| word.parse().ok()).ok_or_else(|| self.bad(attribute, expected))?;
        }
        if words.next().is_some() {
            return Err(self.bad(attribute, expected));
        }
        Ok(Some(values))
    }

    fn bad(&self, attribute: &str, expected: &str) -> Error {
        let text = quoted(self.text(attribute).unwrap_or_default());
        self.refuse(format!("{text} in {attribute}{}", self.within()), expected)
    }

    fn missing(&self, attribute: &str) -> Error {
        self.refuse(format!("no {attribute}{}", self.within()), format!("{attribute}=\"...\""))
    }

    /// " in <origin>", for an element within a link or joint.
    fn within(&self) -> String {
        if self.node == self.owner { String::new() } else { format!(" in <{}>", self.node.tag_name().name()) }
    }

    /// An error that names the link or joint.
    pub(super) fn refuse(&self, found: impl Into<String>, expected: impl Into<String>) -> Error {
        Error::scene(format!("{} {:?}", self.owner.tag_name().name(), self.name()), found, expected)
    }
}
