//! Collects the content of a document that the reader does not read, for one warning, and rejects unexpanded xacro.

use super::known::{ACTING, Known, OF_DRAKE, QUIET, ROBOT, like, one_off};
use super::lenient::UNDECLARED;
use super::xml::{Source, plain_attribute, quoted};
use crate::error::Error;
use roxmltree::{Attribute, Document, Node};

/// Largest number of findings listed in a message, and of findings that differ only in the name of a link or joint; the
/// others are counted.
const SHOWN: usize = 12;
const ALIKE: usize = 3;

/// The expected part of the error for a file with xacro expressions.
const RUN_XACRO: &str = "plain URDF: run xacro on the file first, `xacro in.xacro > out.urdf` \
                         (xacro is part of ROS, or pip install xacro)";

/// Unrecognized content in document order.
pub(super) struct Findings<'s> {
    source: &'s Source<'s>,
    document: &'s Document<'s>,
    shown: Vec<String>,
    count: usize,
}

impl<'s> Findings<'s> {
    pub(super) fn new(source: &'s Source<'s>, document: &'s Document<'s>) -> Self {
        Self { source, document, shown: Vec::new(), count: 0 }
    }

    /// Adds a finding with its position and a hint.
    pub(super) fn add(&mut self, what: &str, node: &Node, hint: &str) {
        self.count += 1;
        let kind = what.split('"').next();
        let alike = || self.shown.iter().filter(|other| other.split('"').next() == kind).count();
        if self.shown.len() < SHOWN && alike() < ALIKE {
            let line = self.source.line(self.document, node.range().start);
            let hint = if hint.is_empty() { String::new() } else { format!("; {hint}") };
            self.shown.push(format!("{what} (line {line}{hint})"));
        }
    }

    /// All findings in one line; `None` if there are none.
    pub(super) fn into_text(self) -> Option<String> {
        let rest = self.count - self.shown.len();
        let more = if rest > 0 { format!("; and {rest} more") } else { String::new() };
        (self.count > 0).then(|| self.shown.join("; ") + &more)
    }

    /// Visits all elements that are read.
    ///
    /// # Errors
    ///
    /// [`Error::Scene`] for xacro elements and expressions, and for an element with an undeclared prefix whose local
    /// name the reader knows.
    pub(super) fn survey(&mut self) -> Result<(), Error> {
        self.visit(&self.document.root_element(), &ROBOT, None)
    }

    fn visit(&mut self, node: &Node, known: &Known, owner: Option<&Node>) -> Result<(), Error> {
        for attribute in node.attributes() {
            self.refuse_expression(attribute.value(), || format!("{} of <{}>", attribute.name(), known.tag), node)?;
            self.attribute(node, &attribute, known, owner);
        }
        let mut seen: Vec<&str> = Vec::new();
        for child in node.children() {
            if child.is_text() {
                let text = child.text().unwrap_or_default().trim();
                if !text.is_empty() {
                    self.refuse_expression(text, || format!("the text of <{}>", known.tag), node)?;
                    self.add(&format!("text {} in {}", quoted(text), place(node, owner)), &child, "");
                }
            } else if child.is_element() {
                self.child(node, &child, known, owner, &mut seen)?;
            }
        }
        Ok(())
    }

    fn attribute(&mut self, node: &Node, attribute: &Attribute, known: &Known, owner: Option<&Node>) {
        let name = attribute.name();
        if attribute.namespace().is_some() || known.attributes.contains(&name) || known.passed_over.contains(&name) {
            return;
        }
        let known_names = || known.attributes.iter().copied();
        let shown = name.replace(UNDECLARED, ":");
        let mut hint = String::new();
        if let Some((_, local)) = name.split_once(UNDECLARED) {
            // A foreign attribute is ignored, unless it replaces one that the reader knows.
            let ours = known.attributes.contains(&local) && plain_attribute(node, local).is_none();
            if !ours && !known_names().any(|ours| one_off(&shown, ours)) {
                return;
            }
        } else if known.children.iter().any(|child| child.tag == name) {
            hint = format!("<{name}> is an element");
        } else if let Some(other) = like(name, known_names()) {
            hint = format!("is it {other}?");
        }
        self.add(&format!("attribute {shown} of {}", place(node, owner)), node, &hint);
    }

    fn child(
        &mut self,
        node: &Node,
        child: &Node,
        known: &Known,
        owner: Option<&Node>,
        seen: &mut Vec<&'static str>,
    ) -> Result<(), Error> {
        let tag = child.tag_name().name();
        if let Some((prefix, local)) = foreign(child) {
            return self.foreign_child(node, child, known, owner, (prefix, local));
        }
        let ours = child.tag_name().namespace() == node.tag_name().namespace();
        if let Some(read) = known.children.iter().find(|read| ours && read.tag == tag) {
            if !read.many && seen.contains(&read.tag) {
                self.add(&format!("a second <{tag}> in {}", place(node, owner)), child, "the first is read");
                return Ok(());
            }
            seen.push(read.tag);
            return self.visit(child, read, owner.or((known.tag == ROBOT.tag).then_some(child)));
        }
        if QUIET.contains(&tag) {
            for inner in child.children().filter(|inner| acts(tag, inner)) {
                let of = plain_attribute(child, "reference").map_or_else(|| place(node, owner), quoted);
                self.add(&format!("<{}> in <{tag}> of {of}", inner.tag_name().name()), &inner, "");
            }
            return Ok(());
        }
        for attribute in child.attributes() {
            self.refuse_expression(attribute.value(), || format!("{} of <{tag}>", attribute.name()), child)?;
        }
        let hint = if known.attributes.contains(&tag) {
            format!("it is an attribute: <{} {tag}=\"...\">", known.tag)
        } else {
            let names = known.children.iter().map(|read| read.tag).chain(QUIET);
            like(tag, names).map_or_else(String::new, |other| format!("is it <{other}>?"))
        };
        self.add(&format!("<{tag}> in {}", place(node, owner)), child, &hint);
        Ok(())
    }

    /// An element with a foreign prefix belongs to another program; it is ignored unless it resembles one that the
    /// reader knows.
    fn foreign_child(
        &mut self,
        node: &Node,
        child: &Node,
        known: &Known,
        owner: Option<&Node>,
        (prefix, local): (&str, &str),
    ) -> Result<(), Error> {
        let of_xacro = prefix == "xacro" || child.tag_name().namespace().is_some_and(|uri| uri.ends_with("xacro"));
        if of_xacro {
            return Err(Error::scene(self.source.place_of(child), format!("<xacro:{local}>"), RUN_XACRO));
        }
        let whole = format!("{prefix}:{local}");
        let mut tags = known.children.iter().map(|read| read.tag);
        let undeclared = child.tag_name().name().contains(UNDECLARED);
        if prefix == "drake" && OF_DRAKE.contains(&local) {
            self.add(&format!("<{whole}> in {}", place(node, owner)), child, "");
        } else if undeclared && tags.clone().any(|tag| tag == local) {
            let found = format!("<{whole}>, whose prefix '{prefix}' is not declared");
            let expected = format!("<{local}>, or xmlns:{prefix}=\"...\" on <robot>");
            return Err(Error::scene(self.source.place_of_name(child), found, expected));
        } else if undeclared && tags.any(|tag| one_off(&whole, tag)) {
            self.add(&format!("<{whole}> in {}", place(node, owner)), child, "");
        }
        Ok(())
    }

    /// Rejects `${...}` and `$(...)`, which xacro would have replaced.
    pub(super) fn refuse_expression(&self, text: &str, what: impl Fn() -> String, node: &Node) -> Result<(), Error> {
        if text.contains("${") || text.contains("$(") {
            let found = format!("the expression {} in {}", quoted(text), what());
            return Err(Error::scene(self.source.place_of(node), found, RUN_XACRO));
        }
        Ok(())
    }
}

/// True if an element inside of an element of QUIET affects the dynamics.
fn acts(outer: &str, inner: &Node) -> bool {
    let value = plain_attribute(inner, "value").or(inner.text()).unwrap_or_default().trim();
    let is_false = value.eq_ignore_ascii_case("false") || value.parse() == Ok(0.0);
    ACTING.iter().any(|&(of, name, on)| {
        of == outer && inner.has_tag_name(name) && on.is_none_or(|on| !value.is_empty() && is_false != on)
    })
}

/// Text such as `<dynamics> of joint "elbow"` for an element of a link or joint.
fn place(node: &Node, owner: Option<&Node>) -> String {
    let tag = node.tag_name().name();
    let Some(owner) = owner else {
        return format!("<{tag}>");
    };
    let name = plain_attribute(owner, "name").unwrap_or_default();
    let of = format!("{} {}", owner.tag_name().name(), quoted(name));
    if node == owner { of } else { format!("<{tag}> of {of}") }
}

/// Prefix and local name of an element in a namespace other than that of the robot; `None` without a prefix.
pub(super) fn foreign<'a>(node: &Node<'a, '_>) -> Option<(&'a str, &'a str)> {
    let document: &'a Document = node.document();
    let namespace = node.tag_name().namespace();
    let start = node.range().start + 1;
    let written = &document.input_text()[start..];
    let end = written.find(|c: char| c.is_ascii_whitespace() || matches!(c, '/' | '>')).unwrap_or(written.len());
    let written = &written[..end];
    if let Some(parts) = written.split_once(UNDECLARED) {
        return Some(parts);
    }
    (namespace != document.root_element().tag_name().namespace()).then(|| written.split_once(':')).flatten()
}
