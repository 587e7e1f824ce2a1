//! XML-RPC, the protocol between ROS 1 nodes and their master: calls, answers and faults, to text and back.
//! Input is not trusted: parsing never panics, follows no entities, and bounds nesting.
//!
//! Source: xmlrpc.com/spec.md.

use std::{collections::BTreeMap, fmt::Write};

use base64::{Engine, prelude::BASE64_STANDARD};
use roxmltree::{Document, Node, ParsingOptions};

/// Deepest nesting of values.
const MAX_DEPTH: usize = 32;
/// Most elements of an answer. An element takes many times the memory of its text.
const MAX_NODES: u32 = 4_000_000;
/// Most elements of a call, which anyone can send.
const MAX_NODES_OF_CALL: u32 = 200_000;

/// A value of XML-RPC, in calls and parameters.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// `boolean`.
    Bool(bool),
    /// `i4`, `int`.
    Int(i32),
    /// `double`.
    Double(f64),
    /// `string`.
    String(String),
    /// `base64`.
    Bytes(Vec<u8>),
    /// `dateTime.iso8601`, as text.
    DateTime(String),
    /// `array`.
    Array(Vec<Value>),
    /// `struct`, such as a namespace of parameters.
    Struct(BTreeMap<String, Value>),
}

impl Value {
    /// Returns the text, if it is one.
    pub fn as_str(&self) -> Option<&str> {
        if let Self::String(text) = self { Some(text) } else { None }
    }

    /// Returns the integer, if it is one.
    pub fn as_int(&self) -> Option<i32> {
        if let Self::Int(value) = self { Some(*value) } else { None }
    }

    /// Returns the number, if it is one.
    pub fn as_f64(&self) -> Option<f64> {
        match self {
            Self::Double(value) => Some(*value),
            Self::Int(value) => Some(f64::from(*value)),
            _ => None,
        }
    }

    /// Returns the flag, if it is one.
    pub fn as_bool(&self) -> Option<bool> {
        if let Self::Bool(value) = self { Some(*value) } else { None }
    }

    /// Returns the elements, if it is an array.
    pub fn as_array(&self) -> Option<&[Value]> {
        if let Self::Array(values) = self { Some(values) } else { None }
    }

    fn write(&self, xml: &mut String) {
        xml.push_str("<value>");
        // Writing to a string does not fail.
        let _ = match self {
            Self::Bool(value) => write!(xml, "<boolean>{}</boolean>", u8::from(*value)),
            Self::Int(value) => write!(xml, "<int>{value}</int>"),
            Self::Double(value) => write!(xml, "<double>{value}</double>"),
            Self::String(value) => write!(xml, "<string>{}</string>", escaped(value)),
            Self::Bytes(value) => write!(xml, "<base64>{}</base64>", BASE64_STANDARD.encode(value)),
            Self::DateTime(value) => write!(xml, "<dateTime.iso8601>{}</dateTime.iso8601>", escaped(value)),
            Self::Array(values) => {
                xml.push_str("<array><data>");
                values.iter().for_each(|value| value.write(xml));
                write!(xml, "</data></array>")
            }
            Self::Struct(members) => {
                xml.push_str("<struct>");
                for (name, value) in members {
                    let _ = write!(xml, "<member><name>{}</name>", escaped(name));
                    value.write(xml);
                    xml.push_str("</member>");
                }
                write!(xml, "</struct>")
            }
        };
        xml.push_str("</value>");
    }
}

macro_rules! into_value {
    ($($kind:ty => $variant:ident),*) => { $(
        impl From<$kind> for Value {
            fn from(value: $kind) -> Self {
                Self::$variant(value.into())
            }
        }
    )* };
}

into_value!(bool => Bool, i32 => Int, f64 => Double, &str => String, String => String);

impl<T: Into<Value>> From<Vec<T>> for Value {
    fn from(values: Vec<T>) -> Self {
        Self::Array(values.into_iter().map(Into::into).collect())
    }
}

impl<T: Into<Value>, const N: usize> From<[T; N]> for Value {
    fn from(values: [T; N]) -> Self {
        Self::Array(values.into_iter().map(Into::into).collect())
    }
}

/// A call of a method.
#[derive(Debug, Clone, PartialEq)]
pub struct Call {
    /// The method.
    pub method: String,
    /// Its arguments.
    pub arguments: Vec<Value>,
}

/// A failed call, as the peer reports it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{message} (fault {code})")]
pub struct Fault {
    /// The peer's number for the failure.
    pub code: i32,
    /// The description of the failure.
    pub message: String,
}

/// Reason why bytes are not XML-RPC.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum XmlRpcError {
    /// The bytes are not XML, or use parts of XML that are not allowed here.
    #[error("not well-formed XML: {0}")]
    Xml(String),
    /// The XML is another document.
    #[error("not XML-RPC: {0}")]
    Shape(&'static str),
}

impl From<&XmlRpcError> for Fault {
    /// The answer to an invalid call.
    fn from(error: &XmlRpcError) -> Self {
        Self { code: 1, message: error.to_string() }
    }
}

/// Escapes the characters that have a meaning in XML. Replaces those that XML does not allow.
fn escaped(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            // Readers would turn it into a line feed.
            '\r' => escaped.push_str("&#13;"),
            '\t' | '\n' => escaped.push(c),
            '\0'..='\x1f' | '\u{fffe}' | '\u{ffff}' => escaped.push('\u{fffd}'),
            _ => escaped.push(c),
        }
    }
    escaped
}

const PROLOGUE: &str = "<?xml version=\"1.0\"?>\n";

impl Call {
    /// A call of a method.
    pub fn new(method: &str, arguments: Vec<Value>) -> Self {
        Self { method: method.to_owned(), arguments }
    }

    /// Writes the call as a document.
    pub fn to_xml(&self) -> String {
        let mut xml =
            format!("{PROLOGUE}<methodCall><methodName>{}</methodName><params>", escaped(&self.method));
        for argument in &self.arguments {
            xml.push_str("<param>");
            argument.write(&mut xml);
            xml.push_str("</param>");
        }
        xml.push_str("</params></methodCall>");
        xml
    }

    /// Reads a call from a document.
    ///
    /// # Errors
    /// [`XmlRpcError`] if it is not a call.
    pub fn from_xml(xml: &[u8]) -> Result<Self, XmlRpcError> {
        with_root(xml, MAX_NODES_OF_CALL, |root| {
            if !root.has_tag_name("methodCall") {
                return Err(XmlRpcError::Shape("a call is a `methodCall`"));
            }
            let method = child(root, "methodName")
                .and_then(|name| name.text())
                .ok_or(XmlRpcError::Shape("a `methodCall` has a `methodName`"))?;
            let arguments = child(root, "params").map_or(Ok(Vec::new()), |params| {
                elements(params)
                    .map(|param| read_value(only_value(param).ok_or(NO_VALUE)?, 0))
                    .collect::<Result<_, _>>()
            })?;
            Ok(Self { method: method.trim().to_owned(), arguments })
        })
    }
}

/// Writes the answer to a call as a document.
pub fn answer_to_xml(answer: &Result<Value, Fault>) -> String {
    let mut xml = format!("{PROLOGUE}<methodResponse>");
    match answer {
        Ok(value) => {
            xml.push_str("<params><param>");
            value.write(&mut xml);
            xml.push_str("</param></params>");
        }
        Err(Fault { code, message }) => {
            xml.push_str("<fault>");
            let members = [("faultCode", Value::Int(*code)), ("faultString", message.as_str().into())];
            Value::Struct(members.map(|(name, value)| (name.to_owned(), value)).into()).write(&mut xml);
            xml.push_str("</fault>");
        }
    }
    xml.push_str("</methodResponse>");
    xml
}

/// Reads the answer to a call from a document.
///
/// # Errors
/// [`XmlRpcError`] if it is not an answer.
pub fn answer_from_xml(xml: &[u8]) -> Result<Result<Value, Fault>, XmlRpcError> {
    with_root(xml, MAX_NODES, |root| {
        if !root.has_tag_name("methodResponse") {
            return Err(XmlRpcError::Shape("an answer is a `methodResponse`"));
        }
        if let Some(fault) = child(root, "fault") {
            let Value::Struct(members) = read_value(only_value(fault).ok_or(NO_VALUE)?, 0)? else {
                return Err(XmlRpcError::Shape("a `fault` is a `struct`"));
            };
            let code = members.get("faultCode").and_then(Value::as_int).unwrap_or_default();
            let message = members.get("faultString").and_then(Value::as_str).unwrap_or_default().to_owned();
            return Ok(Err(Fault { code, message }));
        }
        let param = child(root, "params").and_then(|params| child(params, "param"));
        let value = param.and_then(only_value).ok_or(NO_VALUE)?;
        read_value(value, 0).map(Ok)
    })
}

const NO_VALUE: XmlRpcError = XmlRpcError::Shape("a `param`, `member` or `fault` has a `value`");

fn with_root<T>(
    xml: &[u8],
    most: u32,
    read: impl FnOnce(Node<'_, '_>) -> Result<T, XmlRpcError>,
) -> Result<T, XmlRpcError> {
    let text = std::str::from_utf8(xml).map_err(|error| XmlRpcError::Xml(error.to_string()))?;
    let options = ParsingOptions { allow_dtd: false, nodes_limit: most, ..ParsingOptions::default() };
    let document = Document::parse_with_options(text.trim_start(), options)
        .map_err(|error| XmlRpcError::Xml(error.to_string()))?;
    read(document.root_element())
}

fn elements<'a, 'input>(parent: Node<'a, 'input>) -> impl Iterator<Item = Node<'a, 'input>> {
    parent.children().filter(Node::is_element)
}

fn child<'a, 'input>(parent: Node<'a, 'input>, name: &str) -> Option<Node<'a, 'input>> {
    elements(parent).find(|node| node.has_tag_name(name))
}

fn only_value<'a, 'input>(parent: Node<'a, 'input>) -> Option<Node<'a, 'input>> {
    child(parent, "value")
}

/// Returns all text of an element, without comments.
fn text(node: Node<'_, '_>) -> String {
    node.children().filter(Node::is_text).filter_map(|part| part.text()).collect()
}

fn read_value(value: Node<'_, '_>, depth: usize) -> Result<Value, XmlRpcError> {
    if depth == MAX_DEPTH {
        return Err(XmlRpcError::Shape("values nest 32 deep at most"));
    }
    let Some(typed) = elements(value).next() else { return Ok(Value::String(text(value))) };
    let content = text(typed);
    match typed.tag_name().name() {
        "string" => Ok(Value::String(content)),
        "i4" | "int" => match content.trim().parse() {
            Ok(value) => Ok(Value::Int(value)),
            Err(_) => Err(XmlRpcError::Shape("an `int` has 32 bits")),
        },
        "boolean" => match content.trim() {
            "0" | "false" => Ok(Value::Bool(false)),
            "1" | "true" => Ok(Value::Bool(true)),
            _ => Err(XmlRpcError::Shape("a `boolean` is 0 or 1")),
        },
        "double" => match content.trim().parse() {
            Ok(value) => Ok(Value::Double(value)),
            Err(_) => Err(XmlRpcError::Shape("a `double` is a number")),
        },
        "base64" => {
            let packed: String = content.chars().filter(|c| !c.is_ascii_whitespace()).collect();
            match BASE64_STANDARD.decode(packed) {
                Ok(bytes) => Ok(Value::Bytes(bytes)),
                Err(_) => Err(XmlRpcError::Shape("`base64` is not base64")),
            }
        }
        "dateTime.iso8601" => Ok(Value::DateTime(content)),
        "array" => {
            let data = child(typed, "data").ok_or(XmlRpcError::Shape("an `array` has a `data`"))?;
            elements(data)
                .map(|value| read_value(value, depth + 1))
                .collect::<Result<_, _>>()
                .map(Value::Array)
        }
        "struct" => elements(typed)
            .map(|member| {
                let name = child(member, "name").ok_or(XmlRpcError::Shape("a `member` has a `name`"))?;
                Ok((text(name), read_value(only_value(member).ok_or(NO_VALUE)?, depth + 1)?))
            })
            .collect::<Result<_, _>>()
            .map(Value::Struct),
        _ => Err(XmlRpcError::Shape("a `value` has one of the types that XML-RPC has")),
    }
}

#[cfg(test)]
mod tests;
