//! Tolerance for common violations of XML: undeclared prefixes, `--` in comments, `<?xml?>` after the beginning.
//!
//! None of them changes the robot. A document that fails to parse because of them is rewritten as valid XML and parsed
//! again. Other violations are rejected with a suggested fix.

use roxmltree::Error;
use std::collections::HashSet;

/// Replaces the colon after an undeclared prefix: a private-use character, which XML accepts in names.
pub(super) const UNDECLARED: char = '\u{e0fff}';

/// True if [`restated`] corrects the error.
pub(super) fn can_be_restated(error: &Error) -> bool {
    matches!(error, Error::UnknownNamespace(..) | Error::InvalidComment(_) | Error::UnexpectedDeclaration(_))
}

/// The document with the violations replaced and every other character at the same line and column: comments without
/// `--`, blanks for all declarations but the first, and [`UNDECLARED`] for the colon after an undeclared prefix.
pub(super) fn restated(text: &str) -> String {
    let mut declared = HashSet::from(["xml", "xmlns"]);
    for_pieces(text, |piece| {
        if let Piece::Name(name) = piece {
            declared.extend(name.strip_prefix("xmlns:"));
        }
    });
    let mut out = String::with_capacity(text.len() + 64);
    for_pieces(text, |piece| match piece {
        Piece::Other(text) => out.push_str(text),
        Piece::Comment(inner) => out.push_str(&inner.replace('-', "_")),
        Piece::Declaration(text) if out.is_empty() => out.push_str(text),
        Piece::Declaration(text) => out.extend(text.chars().map(|c| if c == '\n' || c == '\r' { c } else { ' ' })),
        Piece::Name(name) => match name.split_once(':') {
            Some((prefix, local)) if !prefix.is_empty() && !declared.contains(prefix) => {
                out.push_str(prefix);
                out.push(UNDECLARED);
                out.push_str(local);
            }
            _ => out.push_str(name),
        },
    });
    out
}

/// Largest number of attributes of one element; roxmltree compares each attribute with all preceding ones.
pub(super) const MOST_ATTRIBUTES: usize = 1_000;

/// Position of the first element with more than [`MOST_ATTRIBUTES`] attributes, if there is one.
pub(super) fn with_many_attributes(text: &str) -> Option<usize> {
    /// Length of ` a=""`.
    const SHORTEST: usize = 5;
    if text.split('<').all(|piece| piece.len() <= SHORTEST * MOST_ATTRIBUTES) {
        return None;
    }
    let (mut at, mut begins, mut names, mut found) = (0, 0, 0, None);
    for_pieces(text, |piece| {
        let length = match piece {
            Piece::Name(name) => {
                names += 1;
                // The first name is that of the element.
                if names > MOST_ATTRIBUTES + 1 {
                    found.get_or_insert(begins);
                }
                name.len()
            }
            Piece::Comment(text) | Piece::Declaration(text) | Piece::Other(text) => {
                if text.starts_with('<') {
                    (begins, names) = (at, 0);
                }
                text.len()
            }
        };
        at += length;
    });
    found
}

/// A piece of a document.
enum Piece<'a> {
    /// The text between `<!--` and `-->`.
    Comment(&'a str),
    /// `<?xml ... ?>`.
    Declaration(&'a str),
    /// The name of an element or attribute in a tag.
    Name(&'a str),
    /// Any other text.
    Other(&'a str),
}

/// Splits a document, which need not be well-formed, into pieces whose concatenation is the document.
fn for_pieces<'a>(text: &'a str, mut each: impl FnMut(Piece<'a>)) {
    let mut rest = text;
    while let Some(at) = rest.find('<') {
        each(Piece::Other(&rest[..at]));
        rest = &rest[at..];
        let until = |mark: &str, from: usize| rest[from..].find(mark).map_or(rest.len(), |at| from + at + mark.len());
        let end = if rest.starts_with("<!--") {
            let end = until("-->", 4);
            let inner = rest[4..end].strip_suffix("-->").unwrap_or(&rest[4..end]);
            each(Piece::Other("<!--"));
            each(Piece::Comment(inner));
            each(Piece::Other(&rest[4 + inner.len()..end]));
            end
        } else if rest.starts_with("<![CDATA[") {
            let end = until("]]>", 9);
            each(Piece::Other(&rest[..end]));
            end
        } else if rest.starts_with("<?") {
            let end = until("?>", 2);
            let declares = rest.strip_prefix("<?xml").is_some_and(|after| after.starts_with(char::is_whitespace));
            each(if declares { Piece::Declaration(&rest[..end]) } else { Piece::Other(&rest[..end]) });
            end
        } else if rest.starts_with("<!") {
            each(Piece::Other("<!"));
            2
        } else {
            let end = end_of_tag(rest);
            for_words(&rest[..end], &mut each);
            end
        };
        rest = &rest[end..];
    }
    each(Piece::Other(rest));
}

/// The end of a tag: the position after the first `>` outside quotes.
fn end_of_tag(tag: &str) -> usize {
    let mut quote = None;
    for (at, c) in tag.char_indices() {
        match quote {
            Some(open) if c == open => quote = None,
            None if c == '"' || c == '\'' => quote = Some(c),
            None if c == '>' => return at + 1,
            _ => {}
        }
    }
    tag.len()
}

/// Splits a tag into names and the text between them.
fn for_words<'a>(tag: &'a str, each: &mut impl FnMut(Piece<'a>)) {
    let mut rest = tag;
    while !rest.is_empty() {
        let is_name = |c: char| !(c.is_ascii_whitespace() || matches!(c, '<' | '>' | '/' | '=' | '"' | '\''));
        let end = match rest.chars().next() {
            Some(quote @ ('"' | '\'')) => rest[1..].find(quote).map_or(rest.len(), |at| at + 2),
            Some(c) if is_name(c) => rest.find(|c| !is_name(c)).unwrap_or(rest.len()),
            _ => 1,
        };
        each(if rest.starts_with(is_name) { Piece::Name(&rest[..end]) } else { Piece::Other(&rest[..end]) });
        rest = &rest[end..];
    }
}

/// The text of an XML error as (found, expected fix).
pub(super) fn remedy(error: &Error) -> (String, String) {
    let instead = |text: &str| format!("{text} in its place");
    match error {
        Error::MalformedEntityReference(_) => ("a bare &".into(), instead("&amp;")),
        Error::UnknownEntityReference(name, _) => {
            let known = "one of &amp; &lt; &gt; &quot; &apos;, which XML knows; &amp; for the character & itself";
            (format!("&{name};, which is not defined"), known.into())
        }
        Error::InvalidAttributeValue(_) | Error::InvalidChar(b'"' | b'\'', b'<', _) => (
            "a bare < in the value of an attribute".into(),
            instead("&lt;") + ", or the quote that ends the value before it",
        ),
        Error::UnknownNamespace(prefix, _) => {
            (format!("prefix '{prefix}', which is not declared here"), format!("xmlns:{prefix}=\"...\" on <robot>"))
        }
        _ => {
            let reason = error.to_string().replace(&format!(" at {}", error.pos()), "");
            (format!("malformed XML ({reason})"), "well-formed XML".into())
        }
    }
}
