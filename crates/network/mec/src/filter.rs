//! Attribute filters (ETSI GS MEC 009, clause 6.19): expressions `(op,attribute/attribute,value)` separated by `;`,
//! all of which must hold. A filter is parsed and checked against the data type once, then tested against many
//! objects.

use std::fmt;

use serde_json::Value;

use crate::attributes::{Attribute, Kind, find};

/// A text that is not a filter.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("invalid filter at character {}: {what}", at + 1)]
pub struct FilterError {
    /// Number of characters before the error.
    at: usize,
    what: String,
}

/// A filter of one data type.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Filter {
    root: Node,
}

/// Tests of an attribute and of the attributes in it.
///
/// Expressions with a common prefix are kept together, because a single element of an array must meet all of them.
#[derive(Debug, Clone, PartialEq, Default)]
struct Node {
    name: &'static str,
    tests: Vec<Test>,
    children: Vec<Node>,
}

/// A comparison with constants.
#[derive(Debug, Clone, PartialEq)]
struct Test {
    op: Op,
    values: Vec<Constant>,
}

#[derive(Debug, Clone, PartialEq)]
enum Constant {
    Text(String),
    Number(f64),
    Flag(bool),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Op {
    Eq,
    Neq,
    Gt,
    Lt,
    Gte,
    Lte,
    In,
    Nin,
    Cont,
    Ncont,
}

const OPS: [(&str, Op); 10] = [
    ("eq", Op::Eq),
    ("neq", Op::Neq),
    ("gt", Op::Gt),
    ("lt", Op::Lt),
    ("gte", Op::Gte),
    ("lte", Op::Lte),
    ("in", Op::In),
    ("nin", Op::Nin),
    ("cont", Op::Cont),
    ("ncont", Op::Ncont),
];

impl Op {
    fn name(self) -> &'static str {
        OPS.iter().find(|(_, op)| *op == self).map_or("", |(name, _)| name)
    }

    /// Whether it takes a list of values.
    fn takes_many(self) -> bool {
        matches!(self, Self::In | Self::Nin | Self::Cont | Self::Ncont)
    }

    /// Checks that the operator applies to attributes of this kind. The error names the kind that it compares.
    fn suits(self, kind: Kind) -> Result<(), &'static str> {
        match (self, kind) {
            (Self::Gt | Self::Lt | Self::Gte | Self::Lte, Kind::Text | Kind::Address | Kind::Flag) => {
                Err("numbers")
            }
            (Self::Cont | Self::Ncont, Kind::Number | Kind::Flag) => Err("strings"),
            _ => Ok(()),
        }
    }
}

impl Filter {
    /// Parses a filter of a data type with these attributes.
    ///
    /// # Errors
    /// [`FilterError`] with the place and the expected text.
    pub fn parse(text: &str, of: &'static [Attribute]) -> Result<Self, FilterError> {
        let mut reader = Reader { text, at: 0 };
        let mut root = Node::default();
        loop {
            reader.expect('(', "an expression begins with `(`, as in (eq,channel,6)")?;
            let (op, at) = reader.op()?;
            reader.expect(',', "expected `,` and an attribute after the operator")?;
            let (node, attribute) = reader.attribute(of, &mut root)?;
            if let Err(others) = op.suits(attribute.kind) {
                let what = format!("`{}` compares {others}, but `{}` is none", op.name(), attribute.name);
                return Err(FilterError { at, what });
            }
            let mut values = Vec::new();
            while reader.take(',') {
                values.push(reader.value(attribute)?);
            }
            match values.len() {
                0 => return reader.fail("expected `,` and a value after the attribute"),
                1 => {}
                _ if op.takes_many() => {}
                _ => return reader.fail(&format!("`{}` takes one value", op.name())),
            }
            reader.expect(')', "an expression ends with `)`")?;
            node.tests.push(Test { op, values });
            if reader.is_at_end() {
                return Ok(Self { root });
            }
            reader.expect(';', "expected `;` between expressions")?;
        }
    }

    /// Whether an object meets all expressions. If an array is on the path, one of its elements must meet all
    /// expressions with the same prefix. A missing attribute meets no expression, neither `eq` nor `neq`.
    pub fn matches(&self, object: &Value) -> bool {
        self.root.is_met(object)
    }
}

impl Node {
    fn is_met(&self, value: &Value) -> bool {
        match value {
            Value::Array(elements) => elements.iter().any(|element| self.is_met(element)),
            _ => {
                self.tests.iter().all(|test| test.is_met(value))
                    && self
                        .children
                        .iter()
                        .all(|child| value.get(child.name).is_some_and(|value| child.is_met(value)))
            }
        }
    }

    fn child(&mut self, name: &'static str) -> &mut Self {
        let place = self.children.iter().position(|child| child.name == name).unwrap_or_else(|| {
            self.children.push(Self { name, ..Self::default() });
            self.children.len() - 1
        });
        &mut self.children[place]
    }

    /// Writes the expressions of this node and those below it.
    fn write(&self, prefix: &str, first: &mut bool, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let path = if prefix.is_empty() { self.name.to_owned() } else { format!("{prefix}/{}", self.name) };
        for test in &self.tests {
            let separator = if std::mem::take(first) { "" } else { ";" };
            write!(f, "{separator}({},{path}", test.op.name())?;
            for value in &test.values {
                match value {
                    Constant::Text(text) => write!(f, ",'{}'", text.replace('\'', "''"))?,
                    Constant::Number(number) => write!(f, ",{number}")?,
                    Constant::Flag(flag) => write!(f, ",{flag}")?,
                }
            }
            f.write_str(")")?;
        }
        self.children.iter().try_for_each(|child| child.write(&path, first, f))
    }
}

/// The filter as text. Parsing it gives the same filter.
impl fmt::Display for Filter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.root.write("", &mut true, f)
    }
}

impl Test {
    fn is_met(&self, value: &Value) -> bool {
        let Some(first) = self.values.first() else { return false };
        match self.op {
            Op::Eq => first == value,
            Op::Neq => first != value,
            Op::Gt => first.order(value, |value, constant| value > constant),
            Op::Lt => first.order(value, |value, constant| value < constant),
            Op::Gte => first.order(value, |value, constant| value >= constant),
            Op::Lte => first.order(value, |value, constant| value <= constant),
            Op::In => self.values.iter().any(|constant| constant == value),
            Op::Nin => self.values.iter().all(|constant| constant != value),
            Op::Cont => self.values.iter().any(|constant| constant.is_in(value)),
            Op::Ncont => !self.values.iter().any(|constant| constant.is_in(value)),
        }
    }
}

impl PartialEq<Value> for Constant {
    fn eq(&self, value: &Value) -> bool {
        match self {
            Self::Text(text) => value.as_str() == Some(text),
            Self::Number(number) => value.as_f64() == Some(*number),
            Self::Flag(flag) => value.as_bool() == Some(*flag),
        }
    }
}

impl Constant {
    fn order(&self, value: &Value, holds: impl Fn(f64, f64) -> bool) -> bool {
        match (value.as_f64(), self) {
            (Some(value), Self::Number(constant)) => holds(value, *constant),
            _ => false,
        }
    }

    fn is_in(&self, value: &Value) -> bool {
        matches!((value, self), (Value::String(text), Self::Text(part)) if text.contains(part.as_str()))
    }
}

/// Parser state.
struct Reader<'a> {
    text: &'a str,
    /// Bytes read.
    at: usize,
}

impl<'a> Reader<'a> {
    fn rest(&self) -> &'a str {
        &self.text[self.at..]
    }

    fn is_at_end(&self) -> bool {
        self.rest().is_empty()
    }

    fn fail<T>(&self, what: &str) -> Result<T, FilterError> {
        Err(FilterError { at: self.text[..self.at].chars().count(), what: what.to_owned() })
    }

    fn take(&mut self, wanted: char) -> bool {
        let there = self.rest().starts_with(wanted);
        self.at += if there { wanted.len_utf8() } else { 0 };
        there
    }

    fn expect(&mut self, wanted: char, what: &str) -> Result<(), FilterError> {
        if self.take(wanted) { Ok(()) } else { self.fail(what) }
    }

    /// Reads up to one of these characters, which is not consumed.
    fn until(&mut self, ends: &[char]) -> &'a str {
        let rest = self.rest();
        let word = &rest[..rest.find(ends).unwrap_or(rest.len())];
        self.at += word.len();
        word
    }

    fn op(&mut self) -> Result<(Op, usize), FilterError> {
        let before = self.at;
        let word = self.until(&[',', ')', '(']);
        let Some((_, op)) = OPS.iter().find(|(name, _)| *name == word) else {
            self.at = before;
            let names = OPS.map(|(name, _)| name).join(", ");
            return self.fail(&format!("there is no operator `{word}`; there are {names}"));
        };
        Ok((*op, self.text[..before].chars().count()))
    }

    /// Reads a path. Returns its attribute and the attribute's node.
    fn attribute<'n>(
        &mut self,
        of: &'static [Attribute],
        root: &'n mut Node,
    ) -> Result<(&'n mut Node, &'static Attribute), FilterError> {
        let (mut among, mut node) = (of, root);
        loop {
            let before = self.at;
            let name = self.until(&[',', ')', '/', '(']);
            let Some(attribute) = find(among, name) else {
                self.at = before;
                let names: Vec<_> = among.iter().map(|attribute| attribute.name).collect();
                return self.fail(&format!("there is no attribute `{name}`; there are {}", names.join(", ")));
            };
            node = node.child(attribute.name);
            match (attribute.kind, self.take('/')) {
                (Kind::Structure(inner), true) => among = inner,
                (Kind::Structure(_), false) => {
                    return self.fail(&format!("`{name}` has attributes: name one of them after `{name}/`"));
                }
                (_, true) => return self.fail(&format!("`{name}` has no attributes")),
                (_, false) => return Ok((node, attribute)),
            }
        }
    }

    /// Reads a value. It is in single quotes if it contains a quote, a comma or a bracket; a quote in it is doubled.
    fn value(&mut self, attribute: &Attribute) -> Result<Constant, FilterError> {
        let before = self.at;
        let text = if self.take('\'') {
            let mut text = String::new();
            loop {
                text += self.until(&['\'']);
                if !self.take('\'') {
                    return self.fail("a quoted value ends with `'`");
                }
                if !self.take('\'') {
                    break text;
                }
                text.push('\'');
            }
        } else {
            let text = self.until(&[',', ')', '\'']);
            if self.rest().starts_with('\'') {
                return self.fail("put a value with a quote in quotes, and double the quote");
            }
            text.to_owned()
        };
        let constant = match attribute.kind {
            Kind::Number => text.parse().ok().filter(|n: &f64| n.is_finite()).map(Constant::Number),
            Kind::Flag => text.parse().ok().map(Constant::Flag),
            Kind::Address => Some(Constant::Text(text.to_ascii_lowercase().replace('-', ":"))),
            Kind::Text | Kind::Structure(_) => Some(Constant::Text(text.clone())),
        };
        constant.map_or_else(
            || {
                self.at = before;
                let kind =
                    if matches!(attribute.kind, Kind::Number) { "a number" } else { "`true` or `false`" };
                self.fail(&format!("`{}` is {kind}, and `{text}` is not", attribute.name))
            },
            Ok,
        )
    }
}

#[cfg(test)]
mod tests;
