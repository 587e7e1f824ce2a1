//! YAML as a tree that knows where each value stands. Bounded in size, depth and what aliases expand to, so that no
//! file exhausts memory.

use std::collections::{HashMap, HashSet};

use saphyr_parser::{Event, Marker, Parser, ScalarStyle};

use super::{Sink, Span};
use crate::file::MAX_TEXT;

/// A value and where it stands.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Node {
    /// Place for error messages: the value itself; of a collection, its key or first line.
    pub span: Span,
    /// The value.
    pub value: Value,
}

/// Value of a node.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Value {
    /// Text; `plain` if without quotes, so that it may be a number, a truth value or nothing at all.
    Scalar { text: String, plain: bool },
    /// A list.
    Sequence(Vec<Node>),
    /// Keys and their values, in the file's order; no key twice.
    Mapping(Vec<Entry>),
}

/// A key and its value.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Entry {
    pub key: String,
    pub key_span: Span,
    pub value: Node,
}

impl Node {
    /// The text, unless it is a collection or nothing at all.
    pub fn text(&self) -> Option<&str> {
        match &self.value {
            Value::Scalar { text, .. } if !self.is_null() => Some(text),
            _ => None,
        }
    }

    /// The value of a mapping's key.
    pub fn get(&self, key: &str) -> Option<&Self> {
        let Value::Mapping(entries) = &self.value else { return None };
        entries.iter().find(|entry| entry.key == key).map(|entry| &entry.value)
    }

    /// The items of a list, or the values of a mapping.
    pub fn items(&self) -> Box<dyn Iterator<Item = &Self> + '_> {
        match &self.value {
            Value::Scalar { .. } => Box::new(std::iter::empty()),
            Value::Sequence(items) => Box::new(items.iter()),
            Value::Mapping(entries) => Box::new(entries.iter().map(|entry| &entry.value)),
        }
    }

    /// Text that stands without quotes.
    pub fn plain(&self) -> Option<&str> {
        match &self.value {
            Value::Scalar { plain: true, .. } => self.text(),
            _ => None,
        }
    }

    /// Whether there is nothing, in the YAML core schema's words for it.
    pub fn is_null(&self) -> bool {
        matches!(&self.value, Value::Scalar { text, plain: true } if matches!(text.as_str(), "" | "~" | "null"))
    }

    /// Describes the value for a message.
    pub fn describe(&self) -> String {
        match &self.value {
            _ if self.is_null() => "nothing".to_owned(),
            Value::Scalar { text, .. } => format!("`{}`", shorten(text)),
            Value::Sequence(_) => "a list".to_owned(),
            Value::Mapping(_) => "a mapping".to_owned(),
        }
    }

    /// The same as JSON, scalars read by the YAML core schema.
    pub fn to_json(&self) -> serde_json::Value {
        use serde_json::Value as Json;
        match &self.value {
            _ if self.is_null() => Json::Null,
            Value::Scalar { text, plain: true } => match text.as_str() {
                "true" => Json::Bool(true),
                "false" => Json::Bool(false),
                _ => serde_json::from_str::<serde_json::Number>(text)
                    .map_or_else(|_| Json::String(text.clone()), Json::Number),
            },
            Value::Scalar { text, .. } => Json::String(text.clone()),
            Value::Sequence(items) => items.iter().map(Self::to_json).collect(),
            Value::Mapping(entries) => {
                Json::Object(entries.iter().map(|e| (e.key.clone(), e.value.to_json())).collect())
            }
        }
    }

    /// A value that stands in no file.
    pub fn from_json(json: &serde_json::Value) -> Self {
        use serde_json::Value as Json;
        let value = match json {
            Json::String(text) => Value::Scalar { text: text.clone(), plain: false },
            Json::Array(items) => Value::Sequence(items.iter().map(Self::from_json).collect()),
            Json::Object(entries) => Value::Mapping(
                entries
                    .iter()
                    .map(|(key, value)| Entry {
                        key: key.clone(),
                        key_span: 0..0,
                        value: Self::from_json(value),
                    })
                    .collect(),
            ),
            other => Value::Scalar { text: other.to_string(), plain: true },
        };
        Self { span: 0..0, value }
    }

    /// Returns the number of values in it. A long text counts as several.
    fn size(&self) -> usize {
        1 + match &self.value {
            Value::Scalar { text, .. } => text.len() / SHORT,
            Value::Sequence(items) => items.iter().map(Self::size).sum(),
            Value::Mapping(entries) => entries.iter().map(|e| 1 + e.key.len() / SHORT + e.value.size()).sum(),
        }
    }
}

/// Enough of a text to recognise it.
pub(crate) fn shorten(text: &str) -> String {
    if text.chars().count() <= 60 {
        text.to_owned()
    } else {
        text.chars().take(57).chain("...".chars()).collect()
    }
}

/// Bytes of one text: a name has 63, and the longest settings of a plug-in have some thousand.
const MAX_SCALAR: usize = 64 << 10;
/// Collections in collections.
const MAX_DEPTH: usize = 64;
/// Keys and values. A testbed of as many hosts and links as there may be has 1.4 million.
const MAX_VALUES: usize = 2 << 20;
/// Values that are kept for aliases, and that aliases expand to.
const MAX_ALIASED: usize = 100_000;
/// Bytes of a text for which it counts as one more value.
const SHORT: usize = 64;

/// Reads one YAML document. `None` if it is no YAML, which the sink then knows; duplicate keys it knows as well.
pub(crate) fn parse(text: &str, sink: &mut Sink) -> Option<Node> {
    if text.len() > MAX_TEXT {
        sink.error(&(0..0), format!("the file has {} bytes, more than {MAX_TEXT}", text.len()))
            .help("split it, or keep large data in files of its own");
        return None;
    }
    let places = Places::of(text);
    let mut builder =
        Builder { text, sink, open: Vec::new(), anchors: HashMap::new(), values: 0, aliased: 0, root: None };
    for event in Parser::new_from_str(text) {
        match event {
            Ok((event, span)) => {
                let start = places.byte(span.start);
                let span = start..places.byte(span.end).max(start);
                builder.event(event, span)?;
            }
            Err(error) => {
                let at = places.byte(*error.marker());
                builder.sink.error(&(at..at), format!("this is no YAML: {}", error.info())).help(
                    "check the indentation, and that brackets, braces and quotes are closed; a text that \
                     holds `: ` or ` #` needs quotes",
                );
                return None;
            }
        }
    }
    let root = builder.root;
    if root.is_none() {
        sink.error(&(0..0), "the file is empty").help("write `key: value` lines");
    }
    root
}

/// Converts the scanner's places, counted in characters, to bytes.
struct Places {
    /// The byte at which each character begins; `None` where that is the same.
    bytes: Option<Vec<u32>>,
    len: usize,
}

impl Places {
    fn of(text: &str) -> Self {
        let bytes = (!text.is_ascii()).then(|| text.char_indices().map(|(at, _)| at as u32).collect());
        Self { bytes, len: text.len() }
    }

    fn byte(&self, marker: Marker) -> usize {
        match &self.bytes {
            None => marker.index().min(self.len),
            Some(bytes) => bytes.get(marker.index()).map_or(self.len, |&at| at as usize),
        }
    }
}

struct Builder<'a> {
    text: &'a str,
    sink: &'a mut Sink,
    open: Vec<Open>,
    anchors: HashMap<usize, Node>,
    values: usize,
    aliased: usize,
    root: Option<Node>,
}

/// A collection whose end has not come yet.
struct Open {
    anchor: usize,
    start: usize,
    value: Value,
    /// The key of a mapping whose value comes next, and its place.
    key: Option<(String, Span)>,
    /// The keys so far.
    keys: HashSet<String>,
}

impl Builder<'_> {
    fn event(&mut self, event: Event<'_>, span: Span) -> Option<()> {
        self.values += usize::from(matches!(
            event,
            Event::Scalar(..) | Event::SequenceStart(..) | Event::MappingStart(..)
        ));
        if self.values > MAX_VALUES {
            self.sink
                .error(&span, format!("the file has more than {MAX_VALUES} keys and values"))
                .help("split it, or keep large data in files of its own");
            return None;
        }
        match event {
            Event::Scalar(text, style, anchor, tag) => {
                self.refuse_tag(tag.is_some(), &span);
                if text.len() > MAX_SCALAR {
                    self.sink
                        .error(
                            &(span.start..span.start),
                            format!("this text has more than {MAX_SCALAR} bytes"),
                        )
                        .help("keep large data in a file of its own");
                    return None;
                }
                let plain = style == ScalarStyle::Plain;
                let span = span.start..span.start + self.text[span.clone()].trim_end().len();
                let node = Node { span, value: Value::Scalar { text: text.into_owned(), plain } };
                self.complete(node, anchor)
            }
            Event::SequenceStart(anchor, tag) => {
                self.refuse_tag(tag.is_some(), &span);
                self.begin(anchor, span, Value::Sequence(Vec::new()))
            }
            Event::MappingStart(anchor, tag) => {
                self.refuse_tag(tag.is_some(), &span);
                self.begin(anchor, span, Value::Mapping(Vec::new()))
            }
            Event::SequenceEnd | Event::MappingEnd => {
                let open = self.open.pop().expect("the parser closes what it opened");
                let end = span.end.max(open.start);
                let all = &self.text[open.start..end];
                let first_line = all.lines().next().unwrap_or("").trim_end();
                let node = Node { span: open.start..open.start + first_line.len(), value: open.value };
                self.complete(node, open.anchor)
            }
            Event::Alias(id) => self.alias(id, span),
            Event::DocumentStart(_) if self.root.is_some() => {
                self.sink
                    .error(&span, "a second document begins here")
                    .help("a file holds one document: remove the `---`");
                None
            }
            _ => Some(()),
        }
    }

    fn refuse_tag(&mut self, tagged: bool, span: &Span) {
        if tagged {
            self.sink.error(span, "this value has a tag").help("remove the `!…`: tags mean nothing here");
        }
    }

    fn begin(&mut self, anchor: usize, span: Span, value: Value) -> Option<()> {
        if self.open.len() == MAX_DEPTH {
            self.sink
                .error(&span, format!("more than {MAX_DEPTH} collections inside each other"))
                .help("nothing here is that deep: check the brackets and the indentation");
            return None;
        }
        self.open.push(Open { anchor, start: span.start, value, key: None, keys: HashSet::new() });
        Some(())
    }

    fn alias(&mut self, id: usize, span: Span) -> Option<()> {
        let Some(node) = self.anchors.get(&id).cloned() else {
            self.sink
                .error(&span, "this alias refers to a value that holds it")
                .help("write the value out, or refer to one that is complete");
            return None;
        };
        self.expand(&node, &span)?;
        self.complete(node, 0)
    }

    /// Counts a value that an anchor keeps, or that an alias expands to.
    fn expand(&mut self, node: &Node, span: &Span) -> Option<()> {
        self.aliased += node.size();
        if self.aliased > MAX_ALIASED {
            self.sink
                .error(span, format!("anchors and aliases expand to more than {MAX_ALIASED} values"))
                .help("use fewer aliases of aliases, and no anchors around large parts");
            return None;
        }
        Some(())
    }

    fn complete(&mut self, mut node: Node, anchor: usize) -> Option<()> {
        if anchor != 0 {
            let span = node.span.clone();
            self.expand(&node, &span)?;
            self.anchors.insert(anchor, node.clone());
        }
        let Some(open) = self.open.last_mut() else {
            self.root = Some(node);
            return Some(());
        };
        match &mut open.value {
            Value::Sequence(items) => items.push(node),
            Value::Mapping(entries) => match open.key.take() {
                Some((key, key_span)) if open.keys.insert(key.clone()) => {
                    // A mistake of a collection as a whole, or of a missing value, shows at its key.
                    if !matches!(node.value, Value::Scalar { .. }) || node.is_null() {
                        node.span = key_span.clone();
                    }
                    entries.push(Entry { key, key_span, value: node });
                }
                Some((key, key_span)) => {
                    self.sink
                        .error(&key_span, format!("`{}` is here twice", shorten(&key)))
                        .label("the second one")
                        .help("remove one of them, or rename it");
                }
                None => {
                    let Value::Scalar { text, .. } = node.value else {
                        self.sink.error(&node.span, "a key is one word").help("write `key: value`");
                        return None;
                    };
                    open.key = Some((text, node.span));
                }
            },
            Value::Scalar { .. } => unreachable!("only collections are opened"),
        }
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tree(text: &str) -> Node {
        let mut sink = Sink::default();
        let root = parse(text, &mut sink);
        assert!(sink.is_empty(), "{}", sink.finish("x.yaml", text));
        root.unwrap()
    }

    fn entries(node: &Node) -> &[Entry] {
        let Value::Mapping(entries) = &node.value else { panic!("a mapping") };
        entries
    }

    /// Returns what is wrong with a text.
    fn mistake(text: &str) -> String {
        let mut sink = Sink::default();
        assert_eq!(parse(text, &mut sink), None);
        sink.finish("x.yaml", text).list[0].message.clone()
    }

    #[test]
    fn files_of_too_many_values_are_rejected() {
        let list = |values: usize| format!("[{}]", "a,".repeat(values));
        // With the list itself.
        assert!(mistake(&list(MAX_VALUES)).contains("more than 2097152 keys and values"));
        let keys: String = (0..=MAX_VALUES / 2).map(|i| format!("{i}:\n")).collect();
        assert!(mistake(&keys).contains("more than 2097152 keys and values"));
    }

    #[test]
    fn anchors_keep_no_more_than_aliases_expand_to() {
        let nested = |part: &str| {
            let anchors: String = (0..60).map(|i| format!("&a{i} [")).collect();
            format!("{anchors}{part}{}", "]".repeat(60))
        };
        assert_eq!(tree(&nested("a")).size(), 61);
        assert!(mistake(&nested(&"a,".repeat(2000))).starts_with("anchors and aliases expand to more"));
        // Few values that are long.
        let long = format!("{},", "a".repeat(MAX_SCALAR)).repeat(2);
        assert!(mistake(&nested(&long)).starts_with("anchors and aliases expand to more"));
    }

    #[test]
    fn spans_are_bytes_of_values() {
        let text = "größe: 5 µs  # so\nliste: [ä, 'ö ']\n";
        let root = tree(text);
        let [size, list] = entries(&root) else { panic!("two entries") };
        assert_eq!(&text[size.key_span.clone()], "größe");
        assert_eq!(&text[size.value.span.clone()], "5 µs");
        let Value::Sequence(items) = &list.value.value else { panic!("a list") };
        assert_eq!(&text[items[0].span.clone()], "ä");
        assert_eq!(&text[items[1].span.clone()], "'ö '");
        assert_eq!(items[1].text(), Some("ö "));
        // A collection as a whole shows at its key.
        assert_eq!(&text[list.value.span.clone()], "liste");
    }

    #[test]
    fn aliases_repeat_values() {
        let root = tree("a: &x { b: 1 }\nc: *x\n");
        let [a, c] = entries(&root) else { panic!("two entries") };
        assert_eq!(a.value.to_json(), c.value.to_json());
    }

    #[test]
    fn scalars_become_json_by_the_core_schema() {
        let root = tree("[1, -2.5, 1e3, true, 'true', ~, null, text, 01, nan]");
        let json = serde_json::json!([1, -2.5, 1e3, true, "true", null, null, "text", "01", "nan"]);
        assert_eq!(root.to_json(), json);
        assert_eq!(Node::from_json(&json).to_json(), json);
    }
}
