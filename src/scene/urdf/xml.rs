//! XML access for the reader: a parsed document, and elements that know their link or joint, so that every error names
//! it.

use super::lenient;
use crate::error::{Error, in_language};
use nalgebra::Vector3;
use roxmltree::{Document, Node, ParsingOptions, TextPos};

/// Versions of the format, in order; files that declare none have the first.
pub(super) const VERSIONS: [&str; 3] = ["1.0", "1.1", "1.2"];

/// The text of a URDF, and its name in messages.
pub(super) struct Source<'a> {
    /// "URDF", or the path.
    pub(super) name: &'a str,
    /// A byte order mark and white space before the XML, which XML forbids but some editors write.
    skipped: &'a str,
    body: &'a str,
}

impl<'a> Source<'a> {
    pub(super) fn new(xml: &'a str, name: &'a str) -> Self {
        let body = xml.trim_start_matches(|c: char| c == '\u{feff}' || c.is_ascii_whitespace());
        Self { name, skipped: &xml[..xml.len() - body.len()], body }
    }

    /// Parses the document; `restated` stores the corrected text if the original violates XML. Document types are
    /// accepted, but not entities, which no URDF needs and which let a small file expand without bound.
    pub(super) fn parse<'b>(&'b self, restated: &'b mut String) -> Result<Document<'b>, Error> {
        if self.body.is_empty() {
            return Err(self.refuse("nothing", "XML with a <robot> element"));
        }
        if !self.body.starts_with('<') {
            let found = format!("text that starts with {}", quoted(self.body));
            let expected =
                in_language("XML with a <robot> element (a path is for from_urdf_file)", "XML with a <robot> element");
            return Err(self.refuse(found, expected));
        }
        if let Some(at) = lenient::with_many_attributes(self.body) {
            let before = &self.body[..at];
            let column = before.rsplit('\n').next().unwrap_or_default().chars().count();
            let place = TextPos::new(1 + count(before.matches('\n').count()), 1 + count(column));
            let most = lenient::MOST_ATTRIBUTES;
            let found = format!("an element with more than {most} attributes");
            return Err(Error::scene(self.place(place), found, format!("at most {most} in one element")));
        }
        let parsed = |text: &'b str| {
            let options = ParsingOptions { allow_dtd: !text.contains("<!ENTITY"), ..ParsingOptions::default() };
            Document::parse_with_options(text, options)
        };
        match parsed(self.body) {
            Err(error) if lenient::can_be_restated(&error) => {
                *restated = lenient::restated(self.body);
                parsed(restated)
            }
            result => result,
        }
        .map_err(|error| self.malformed(&error))
    }

    fn malformed(&self, error: &roxmltree::Error) -> Error {
        use roxmltree::Error::{DtdDetected, UnclosedRootNode, UnexpectedEndOfStream};
        let place = match error {
            DtdDetected => return self.refuse("a document type that declares entities", "XML without entities"),
            // These errors occur at the end of the document, but roxmltree reports position 1:1.
            UnclosedRootNode | UnexpectedEndOfStream => {
                let lines = count(self.body.matches('\n').count());
                let last = self.body.rsplit('\n').next().unwrap_or_default();
                self.place(TextPos::new(1 + lines, 1 + count(last.chars().count())))
            }
            _ => self.place(error.pos()),
        };
        let (found, expected) = lenient::remedy(error);
        Error::scene(place, found, expected)
    }

    /// An error about the document as a whole.
    pub(super) fn refuse(&self, found: impl Into<String>, expected: impl Into<String>) -> Error {
        Error::scene(self.name, found, expected)
    }

    /// Position of an element, for elements without a name.
    pub(super) fn place_of(&self, node: &Node) -> String {
        self.place(node.document().text_pos_at(node.range().start))
    }

    /// Position of the name of an element, after its `<`.
    pub(super) fn place_of_name(&self, node: &Node) -> String {
        self.place(node.document().text_pos_at(node.range().start + 1))
    }

    /// Line, counted from 1, of a byte of the document.
    pub(super) fn line(&self, document: &Document, byte: usize) -> u32 {
        self.line_of(document.text_pos_at(byte))
    }

    fn line_of(&self, within: TextPos) -> u32 {
        count(self.skipped.matches('\n').count()).saturating_add(within.row)
    }

    /// Name, line and column (counted from 1) of a position in the body.
    fn place(&self, within: TextPos) -> String {
        let line = self.line_of(within);
        let before = self.skipped.rsplit('\n').next().unwrap_or_default().trim_start_matches('\u{feff}');
        let column = if within.row == 1 { count(before.len()).saturating_add(within.col) } else { within.col };
        format!("{}, line {line}, column {column}", self.name)
    }
}

/// A count of characters or lines in the type that roxmltree uses.
fn count(n: usize) -> u32 {
    u32::try_from(n).unwrap_or(u32::MAX)
}

/// Text of the file for a message, truncated to 60 characters.
pub(super) fn quoted(text: &str) -> String {
    match text.char_indices().nth(60) {
        Some((end, _)) => format!("{:?}...", &text[..end]),
        None => format!("{text:?}"),
    }
}

/// An attribute without a namespace; the lookup of roxmltree accepts any namespace.
pub(super) fn plain_attribute<'a>(node: &Node<'a, '_>, name: &str) -> Option<&'a str> {
    node.attributes().find(|attribute| attribute.name() == name && attribute.namespace().is_none()).map(|a| a.value())
}

/// An element of a link or joint.
pub(super) struct Element<'a> {
    node: Node<'a, 'a>,
    /// The `<link>` or `<joint>` that contains the element, or is the element.
    owner: Node<'a, 'a>,
}

impl<'a> Element<'a> {
    /// A `<link>` or `<joint>`, which must have a name.
    pub(super) fn named(node: Node<'a, 'a>, source: &Source) -> Result<Self, Error> {
        match plain_attribute(&node, "name") {
            Some(name) if !name.is_empty() => Ok(Self { node, owner: node }),
            _ => {
                let tag = node.tag_name().name();
                Err(Error::scene(
                    source.place_of(&node),
                    format!("a <{tag}> without name"),
                    format!("<{tag} name=\"...\">"),
                ))
            }
        }
    }

    /// The name of the link or joint.
    pub(super) fn name(&self) -> &'a str {
        plain_attribute(&self.owner, "name").unwrap_or_default()
    }

    /// True if the file declares this version of the format, one of [`VERSIONS`], or a later one.
    pub(super) fn has_version(&self, version: &str) -> bool {
        plain_attribute(&self.node.document().root_element(), "version").unwrap_or(VERSIONS[0]) >= version
    }

    /// The first child element named `name`.
    pub(super) fn child(&self, name: &str) -> Option<Self> {
        let namespace = self.node.tag_name().namespace();
        self.node
            .children()
            .find(|child| child.tag_name().name() == name && child.tag_name().namespace() == namespace)
            .map(|node| Self { node, owner: self.owner })
    }

    /// The child element named `name`, or an error with the `expected` text.
    pub(super) fn required_child(&self, name: &str, expected: &str) -> Result<Self, Error> {
        self.child(name).ok_or_else(|| self.refuse(format!("no <{name}>{}", self.within()), expected))
    }

    /// An attribute as text.
    pub(super) fn text(&self, attribute: &str) -> Option<&'a str> {
        plain_attribute(&self.node, attribute)
    }

    /// A required attribute as text.
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

    /// A required attribute as a finite number.
    pub(super) fn required_number(&self, attribute: &str) -> Result<f64, Error> {
        self.number(attribute)?.ok_or_else(|| self.missing(attribute))
    }

    /// An attribute as a number that can be infinite, for "no limit".
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

    /// An attribute as exactly N numbers separated by white space.
    pub(super) fn numbers<const N: usize>(&self, attribute: &str, expected: &str) -> Result<Option<[f64; N]>, Error> {
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

    pub(super) fn bad(&self, attribute: &str, expected: &str) -> Error {
        let text = quoted(self.text(attribute).unwrap_or_default());
        self.refuse(format!("{text} in {attribute} of <{}>", self.node.tag_name().name()), expected)
    }

    fn missing(&self, attribute: &str) -> Error {
        self.refuse(format!("no {attribute}{}", self.within()), format!("{attribute}=\"...\""))
    }

    /// Text such as " in <origin>" for an element inside a link or joint.
    fn within(&self) -> String {
        if self.node == self.owner { String::new() } else { format!(" in <{}>", self.node.tag_name().name()) }
    }

    /// An error that names the link or joint.
    pub(super) fn refuse(&self, found: impl Into<String>, expected: impl Into<String>) -> Error {
        Error::scene(format!("{} {:?}", self.owner.tag_name().name(), self.name()), found, expected)
    }
}
