//! Decodes trees to values. Each type of a file declares here how it is read, and its JSON Schema.

use std::net::Ipv4Addr;

use serde_json::{Value as Json, json};

pub(crate) use super::tree::{Entry, Node, Value};
use super::{Sink, Span, tree::shorten};
use cotorra_graph::{
    AgentId, DomainId, InstructionLimit, IpNetwork, LinkId, NodeId, PluginId, Position, SensorId, ServiceId,
    TrafficId, VnfId,
};

/// A type that stands in a file.
pub(crate) trait Decode: Sized {
    /// Returns the JSON Schema.
    fn schema() -> Json;

    /// Reads it; `None` when it is wrong, which the sink then knows.
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self>;

    /// Returns the value of an absent key; `None` if the key is required.
    fn absent() -> Option<Self> {
        None
    }
}

/// A key of a record, for its schema.
pub(crate) struct Field {
    pub key: &'static str,
    pub doc: &'static str,
    pub schema: Json,
    pub required: bool,
    pub default: Option<Json>,
}

/// A mapping with known keys; [`record!`] makes them.
pub(crate) trait Record: Sized {
    /// Documentation of the record.
    const DOC: &'static str;

    /// Returns the record's keys.
    fn fields() -> Vec<Field>;

    /// Takes its keys out of a mapping.
    fn take(from: &mut Fields<'_>, sink: &mut Sink) -> Option<Self>;
}

impl<T: Record> Decode for T {
    fn schema() -> Json {
        record_schema(T::DOC, T::fields())
    }

    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        let mut fields = Fields::of(node, sink)?;
        let value = T::take(&mut fields, sink);
        fields.finish(sink);
        value
    }
}

/// The schema of a record with this documentation and these keys.
fn record_schema(doc: &str, fields: Vec<Field>) -> Json {
    let required: Vec<_> = fields.iter().filter(|f| f.required).map(|f| f.key).collect();
    let properties: serde_json::Map<_, _> = fields
        .into_iter()
        .map(|f| {
            let mut schema = described(f.schema, f.doc);
            if let Some(default) = f.default {
                schema["default"] = default;
            }
            (f.key.to_owned(), schema)
        })
        .collect();
    let mut schema = json!({
        "type": "object",
        "description": sentence(doc),
        "properties": properties,
        "additionalProperties": false,
    });
    if !required.is_empty() {
        schema["required"] = json!(required);
    }
    schema
}

fn sentence(doc: &str) -> String {
    doc.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// A schema with what a key's own documentation says; what the type says of itself follows.
pub(crate) fn described(mut schema: Json, doc: &str) -> Json {
    let of_type = schema.get("description").and_then(Json::as_str).unwrap_or_default();
    let text = sentence(&format!("{doc} {of_type}"));
    if !text.is_empty() {
        schema["description"] = Json::String(text);
    }
    schema
}

/// The keys of a mapping while they are taken out.
pub(crate) struct Fields<'a> {
    entries: Vec<Option<&'a Entry>>,
    asked: Vec<&'static str>,
    span: &'a Span,
}

impl<'a> Fields<'a> {
    /// `None` if it is no mapping, which the sink then knows.
    pub fn of(node: &'a Node, sink: &mut Sink) -> Option<Self> {
        let Value::Mapping(entries) = &node.value else {
            expected(node, "a mapping", "write `key: value` lines, indented below it", sink);
            return None;
        };
        Some(Self { entries: entries.iter().map(Some).collect(), asked: Vec::new(), span: &node.span })
    }

    /// Takes one key out.
    pub fn take<T: Decode>(
        &mut self,
        key: &'static str,
        default: Option<Json>,
        sink: &mut Sink,
    ) -> Option<T> {
        let default = default.as_ref().map(Node::from_json);
        if let Some(node) = self.take_node(key).or(default.as_ref()) {
            return T::decode(node, sink);
        }
        let absent = T::absent();
        if absent.is_none() {
            self.report_missing(key, &T::schema(), sink);
        }
        absent
    }

    fn report_missing(&self, key: &str, schema: &Json, sink: &mut Sink) {
        sink.error(self.span, format!("`{key}` is missing"))
            .label("here")
            .help(format!("add `{key}: {}`", example(schema)));
    }

    /// Takes one key's value out as it stands.
    pub fn take_node(&mut self, key: &'static str) -> Option<&'a Node> {
        self.asked.push(key);
        let place = self.entries.iter().position(|e| e.is_some_and(|e| e.key == key))?;
        self.entries[place].take().map(|e| &e.value)
    }

    /// Reports the keys that nothing asked for.
    pub fn finish(self, sink: &mut Sink) {
        for entry in self.entries.into_iter().flatten().take(Sink::AT_MOST) {
            let error = sink.error(&entry.key_span, format!("unknown key `{}`", shorten(&entry.key)));
            error.help(match nearest(&entry.key, self.asked.iter().copied()) {
                Some(near) => format!("did you mean `{near}`?"),
                None => format!("the keys here are {}", words(&self.asked)),
            });
        }
    }
}

/// A value that a schema allows, as short as a hint needs it.
fn example(schema: &Json) -> String {
    if let Some(example) = schema.pointer("/examples/0") {
        return example.as_str().map_or_else(|| example.to_string(), str::to_owned);
    }
    if let Some(word) = schema.pointer("/enum/0").and_then(Json::as_str) {
        return word.to_owned();
    }
    if schema["type"] == "array" { "[…]" } else { "…" }.to_owned()
}

/// Bytes of the longest word that is compared with what may be meant. No key or name is longer.
const LONGEST_TYPO: usize = 256;

/// The candidate that was probably meant.
pub(crate) fn nearest<'a>(word: &str, candidates: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    if word.len() > LONGEST_TYPO {
        return None;
    }
    let word = word.to_lowercase();
    candidates
        .map(|c| (strsim::damerau_levenshtein(&word, &c.to_lowercase()), c))
        .filter(|&(distance, c)| distance <= word.chars().count().max(c.chars().count()) / 3)
        .min_by_key(|&(distance, _)| distance)
        .map(|(_, c)| c)
}

/// Returns a help text that lists all choices.
pub(crate) fn there_are<S: AsRef<str>>(all: &[S]) -> String {
    format!("there {} {}", if all.len() == 1 { "is only" } else { "are" }, words(all))
}

/// `a`, `b` and `c`.
pub(crate) fn words<S: AsRef<str>>(words: &[S]) -> String {
    const AT_MOST: usize = 20;
    let quoted: Vec<_> = words.iter().take(AT_MOST).map(|w| format!("`{}`", w.as_ref())).collect();
    match quoted.as_slice() {
        [] => "none".to_owned(),
        all if words.len() > AT_MOST => format!("{}, …", all.join(", ")),
        [one] => one.clone(),
        [many @ .., last] => format!("{} and {last}", many.join(", ")),
    }
}

/// Reports that something else was expected.
pub(crate) fn expected(node: &Node, what: &str, help: &str, sink: &mut Sink) {
    sink.error(&node.span, format!("expected {what}, found {}", node.describe())).help(help);
}

/// Declares a record of a file: its Rust type, its decoder and its JSON Schema in one. A key may be left out if it has
/// a default (`= json`) or an `Option` type. `field as "key"` gives a field another key. `..name: Type` at the end takes in
/// the keys of another record.
macro_rules! record {
    (
        $(#[doc = $doc:literal])*
        $(#[derive($derive:ident)])?
        $name:ident {
            $( $(#[doc = $field_doc:literal])* $field:ident $(as $key:literal)?: $type:ty $(= $default:tt)?, )*
            $(.. $flat:ident: $flat_type:ty,)?
        }
    ) => {
        $(#[doc = $doc])*
        #[derive(Debug $(, $derive)?)]
        pub(crate) struct $name {
            $( $(#[doc = $field_doc])* pub $field: $type, )*
            $( pub $flat: $flat_type, )?
        }

        impl $crate::yaml::decode::Record for $name {
            const DOC: &'static str = concat!($($doc, " "),*);

            fn fields() -> Vec<$crate::yaml::decode::Field> {
                #[allow(unused_mut, reason = "only some records take in another's keys")]
                let mut fields = vec![$({
                    let default: Option<serde_json::Value> = None $(.or(Some(serde_json::json!($default))))?;
                    $crate::yaml::decode::Field {
                        key: $crate::yaml::decode::key!($field $($key)?),
                        doc: concat!($($field_doc, " "),*),
                        schema: <$type as $crate::yaml::decode::Decode>::schema(),
                        required: default.is_none()
                            && <$type as $crate::yaml::decode::Decode>::absent().is_none(),
                        default,
                    }
                }),*];
                $( fields.extend(<$flat_type as $crate::yaml::decode::Record>::fields()); )?
                fields
            }

            #[allow(unused_variables, reason = "a record may have no keys")]
            fn take(
                from: &mut $crate::yaml::decode::Fields<'_>,
                sink: &mut $crate::yaml::Sink,
            ) -> Option<Self> {
                $(
                    let default = None $(.or(Some(serde_json::json!($default))))?;
                    let $field = from.take::<$type>($crate::yaml::decode::key!($field $($key)?), default, sink);
                )*
                $( let $flat = <$flat_type as $crate::yaml::decode::Record>::take(from, sink); )?
                Some(Self { $($field: $field?,)* $($flat: $flat?,)? })
            }
        }
    };
}

/// Returns the key of a record's field.
macro_rules! key {
    ($field:ident) => {
        stringify!($field)
    };
    ($field:ident $key:literal) => {
        $key
    };
}

/// Declares a record of several kinds, by the value of one key.
macro_rules! tagged {
    (
        $(#[doc = $doc:literal])*
        $name:ident by $tag:ident { $($word:literal => $variant:ident($record:ty),)* }
    ) => {
        $(#[doc = $doc])*
        #[derive(Debug)]
        #[allow(clippy::large_enum_variant, reason = "there are few, and they are taken apart at once")]
        pub(crate) enum $name { $( $variant($record), )* }

        impl $crate::yaml::decode::Decode for $name {
            fn schema() -> serde_json::Value {
                use $crate::yaml::decode::{Decode, tagged_schema};
                let kinds = vec![$( tagged_schema(stringify!($tag), $word, <$record as Decode>::schema()) ),*];
                serde_json::json!({ "description": concat!($($doc, " "),*).trim(), "oneOf": kinds })
            }

            fn decode(
                node: &$crate::yaml::decode::Node,
                sink: &mut $crate::yaml::Sink,
            ) -> Option<Self> {
                use $crate::yaml::decode::{Fields, Record, choose};
                let mut fields = Fields::of(node, sink)?;
                let Some(tag) = fields.take_node(stringify!($tag)) else {
                    sink.error(&node.span, concat!("`", stringify!($tag), "` is missing")).help(format!(
                        concat!("add `", stringify!($tag), ": …` with one of {}"),
                        $crate::yaml::decode::words(&[$($word),*]),
                    ));
                    return None;
                };
                let value = match choose(tag, stringify!($tag), &[$($word),*], sink)? {
                    $( $word => <$record as Record>::take(&mut fields, sink).map(Self::$variant), )*
                    _ => unreachable!("one of these words was chosen"),
                };
                fields.finish(sink);
                value
            }
        }
    };
}

/// Says which words stand for the values of an enumeration.
macro_rules! choice {
    ($name:ty, $what:literal, { $($word:literal => $value:expr, $doc:literal;)* }) => {
        impl $crate::yaml::decode::Decode for $name {
            fn schema() -> serde_json::Value {
                let words = [$( concat!("`", $word, "`: ", $doc) ),*].join("; ");
                serde_json::json!({ "description": format!("{words}."), "enum": [$($word),*] })
            }

            fn decode(
                node: &$crate::yaml::decode::Node,
                sink: &mut $crate::yaml::Sink,
            ) -> Option<Self> {
                match $crate::yaml::decode::choose(node, $what, &[$($word),*], sink)? {
                    $( $word => Some($value), )*
                    _ => unreachable!("one of these words was chosen"),
                }
            }
        }
    };
}

pub(crate) use {choice, key, record, tagged};

/// Decodes one of several words. Reports any other value.
pub(crate) fn choose(
    node: &Node,
    what: &str,
    among: &[&'static str],
    sink: &mut Sink,
) -> Option<&'static str> {
    let text = node.text().unwrap_or_default();
    if let Some(word) = among.iter().find(|w| **w == text) {
        return Some(word);
    }
    sink.error(&node.span, format!("{} is not a {what}", node.describe())).help(
        match nearest(text, among.iter().copied()) {
            Some(near) => format!("did you mean `{near}`? ({})", there_are(among)),
            None => there_are(among),
        },
    );
    None
}

/// The schema of one kind of a tagged record.
pub(crate) fn tagged_schema(tag: &str, word: &str, mut schema: Json) -> Json {
    schema["properties"][tag] = json!({ "const": word });
    let mut required = vec![json!(tag)];
    required.extend(schema["required"].as_array().cloned().unwrap_or_default());
    schema["required"] = Json::Array(required);
    schema
}

/// A value and where it stands, for what is checked later.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Spanned<T> {
    pub value: T,
    pub span: Span,
}

impl<T: Decode> Decode for Spanned<T> {
    fn schema() -> Json {
        T::schema()
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        Some(Self { value: T::decode(node, sink)?, span: node.span.clone() })
    }
    fn absent() -> Option<Self> {
        Some(Self { value: T::absent()?, span: 0..0 })
    }
}

impl<T: Decode> Decode for Option<T> {
    fn schema() -> Json {
        T::schema()
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        T::decode(node, sink).map(Some)
    }
    fn absent() -> Option<Self> {
        Some(None)
    }
}

/// Bytes that the records of one list or table take at most. A record can take many times the bytes of its text.
const MAX_RECORDS: usize = 256 << 20;

/// Returns the number of records of a type that a list or table may have.
pub(crate) fn most<T>() -> usize {
    MAX_RECORDS / size_of::<T>().max(1)
}

/// Whether so many records may be read. Reports it otherwise.
fn has_room<T>(node: &Node, count: usize, sink: &mut Sink) -> bool {
    let most = most::<T>();
    if count > most {
        sink.error(&node.span, format!("there are {count} entries, and {most} are the most"))
            .help("describe fewer of them");
    }
    count <= most
}

impl<T: Decode> Decode for Vec<T> {
    fn schema() -> Json {
        json!({ "type": "array", "items": T::schema() })
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        let Value::Sequence(items) = &node.value else {
            expected(node, "a list", "write `[one, another]`, or a line `- one` for each", sink);
            return None;
        };
        if !has_room::<T>(node, items.len(), sink) {
            return None;
        }
        // All are read before any that failed ends it, so that each one's mistakes show.
        let read: Vec<_> = items.iter().map(|item| T::decode(item, sink)).collect();
        read.into_iter().collect()
    }
}

/// A short form, which is one word or figure, or a long one, which is a mapping or list.
#[derive(Debug)]
pub(crate) enum Either<Short, Long> {
    Short(Short),
    Long(Long),
}

impl<Short: Decode, Long: Decode> Decode for Either<Short, Long> {
    fn schema() -> Json {
        json!({ "anyOf": [Short::schema(), Long::schema()] })
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        match node.value {
            Value::Scalar { .. } => Short::decode(node, sink).map(Self::Short),
            _ => Long::decode(node, sink).map(Self::Long),
        }
    }
}

/// A name that a key gives to a value.
pub(crate) trait Name: Sized {
    /// Returns the JSON Schema.
    fn schema() -> Json;
    /// Returns the rule of such names, for people.
    fn rule() -> String;
    /// Reads it.
    fn read(text: &str) -> Option<Self>;

    /// Reads it; `None` when it is wrong, which the sink then knows.
    fn read_or_report(text: &str, span: &Span, sink: &mut Sink) -> Option<Self> {
        let name = Self::read(text);
        if name.is_none() {
            sink.error(span, format!("`{}` is not a name", shorten(text))).help(Self::rule());
        }
        name
    }
}

/// Named values, in the file's order.
#[derive(Debug)]
pub(crate) struct Table<K, V>(pub Vec<(Spanned<K>, V)>);

impl<K: Name, V: Decode> Decode for Table<K, V> {
    fn schema() -> Json {
        json!({ "type": "object", "propertyNames": K::schema(), "additionalProperties": V::schema() })
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        let Value::Mapping(entries) = &node.value else {
            expected(
                node,
                "a mapping of names",
                "write a line `name:` for each, and its keys below it",
                sink,
            );
            return None;
        };
        if !has_room::<(Spanned<K>, V)>(node, entries.len(), sink) {
            return None;
        }
        let mut all = Some(Vec::with_capacity(entries.len()));
        for entry in entries {
            let key = K::read_or_report(&entry.key, &entry.key_span, sink)
                .map(|value| Spanned { value, span: entry.key_span.clone() });
            match (key, V::decode(&entry.value, sink), &mut all) {
                (Some(key), Some(value), Some(all)) => all.push((key, value)),
                _ => all = None,
            }
        }
        all.map(Self)
    }
}

macro_rules! ids {
    ($($id:ty),*) => {$(
        impl Name for $id {
            fn schema() -> Json {
                // A `-` stands for itself only at the end.
                let (others, rest) = (Self::OTHERS.replace('-', ""), Self::LONGEST - 1);
                let pattern = format!("^[A-Za-z0-9][A-Za-z0-9{others}-]{{0,{rest}}}$");
                json!({ "type": "string", "pattern": pattern })
            }
            fn rule() -> String {
                Self::rule()
            }
            fn read(text: &str) -> Option<Self> {
                Self::new(text).ok()
            }
        }

        impl Decode for $id {
            fn schema() -> Json {
                <Self as Name>::schema()
            }
            fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
                let Some(text) = node.text() else {
                    expected(node, "a name", "write one name, such as `R1`", sink);
                    return None;
                };
                Self::read_or_report(text, &node.span, sink)
            }
        }
    )*};
}

ids!(AgentId, DomainId, LinkId, NodeId, PluginId, SensorId, ServiceId, TrafficId, VnfId);

impl Name for String {
    fn schema() -> Json {
        json!({ "type": "string", "minLength": 1 })
    }
    fn rule() -> String {
        "use one character or more".to_owned()
    }
    fn read(text: &str) -> Option<Self> {
        (!text.is_empty()).then(|| text.to_owned())
    }
}

impl Decode for String {
    fn schema() -> Json {
        json!({ "type": "string" })
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        if let Some(text) = node.text() {
            return Some(text.to_owned());
        }
        expected(node, "a text", "write it behind the colon; with `: ` or ` #` in it, in quotes", sink);
        None
    }
}

impl Decode for bool {
    fn schema() -> Json {
        json!({ "type": "boolean" })
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        match node.plain() {
            Some("true") => Some(true),
            Some("false") => Some(false),
            _ => {
                expected(node, "`true` or `false`", "write one of them, without quotes", sink);
                None
            }
        }
    }
}

impl Decode for u64 {
    fn schema() -> Json {
        json!({ "type": "integer", "minimum": 0 })
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        let number = node.plain().and_then(|text| text.parse().ok());
        if number.is_none() {
            expected(node, "a whole number, 0 or more", "write only digits, such as `7`", sink);
        }
        number
    }
}

macro_rules! small_number {
    ($($number:ty, $example:literal;)*) => {$(
        impl Decode for $number {
            fn schema() -> Json {
                json!({ "type": "integer", "minimum": 0, "maximum": <$number>::MAX })
            }
            fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
                let number = node.plain().and_then(|text| text.parse().ok());
                if number.is_none() {
                    let what = format!("a whole number from 0 to {}", <$number>::MAX);
                    expected(node, &what, concat!("write only digits, such as `", $example, "`"), sink);
                }
                number
            }
        }
    )*};
}
small_number! { u8, "6"; u16, "1"; u32, "3"; }

impl Decode for InstructionLimit {
    fn schema() -> Json {
        json!({ "type": "integer", "minimum": 1, "maximum": Self::MOST })
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        let limit = node.plain().and_then(|text| text.parse().ok()).and_then(Self::new);
        if limit.is_none() {
            let what = format!("a whole number from 1 to {}", Self::MOST);
            expected(node, &what, "write only digits, such as `1000`", sink);
        }
        limit
    }
}

/// Reads a finite number; Rust's own parser would let `inf` and `nan` pass.
fn number(node: &Node) -> Option<f64> {
    let text = node.plain()?;
    let begins_well =
        text.trim_start_matches(['-', '+']).starts_with(|c: char| c.is_ascii_digit() || c == '.');
    text.parse().ok().filter(|n: &f64| begins_well && n.is_finite())
}

impl Decode for f64 {
    fn schema() -> Json {
        json!({ "type": "number" })
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        let number = number(node);
        if number.is_none() {
            expected(node, "a number", "write it plainly, such as `2.5`", sink);
        }
        number
    }
}

/// A plain number that is zero or more.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Amount(pub f64);

impl Decode for Amount {
    fn schema() -> Json {
        json!({ "type": "number", "minimum": 0, "examples": [2] })
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        let number = number(node).filter(|&n| n >= 0.0);
        if number.is_none() {
            expected(node, "a number, 0 or more", "write it plainly, such as `2.5`", sink);
        }
        number.map(|n| Self(n.abs()))
    }
}

/// Metres from the map's origin beyond which a place is surely a mistake.
const FARTHEST_M: f64 = 1e6;

impl Decode for Position {
    fn schema() -> Json {
        json!({
            "type": "array",
            "items": { "type": "number" },
            "minItems": 2,
            "maxItems": 3,
            "examples": [[2.5, -1], [2.5, -1, 1.8]],
            "description": "A place `[x, y]` on the map, in metres, or `[x, y, z]` above its floor.",
        })
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        let numbers = match &node.value {
            Value::Sequence(items) => items.iter().map(number).collect::<Option<Vec<_>>>(),
            _ => None,
        };
        match numbers.as_deref() {
            Some(place @ (&[x, y] | &[x, y, _])) => {
                if place.iter().all(|metres| metres.abs() <= FARTHEST_M) {
                    return Some(Self { x, y, z: place.get(2).copied().unwrap_or_default() });
                }
                sink.error(&node.span, "this place is more than 1000 km from the map's origin")
                    .help("write x, y and z in metres");
                None
            }
            _ => {
                let help = "write `[x, y]` in metres, such as `[2.5, -1]`, or `[x, y, z]` above the floor";
                expected(node, "a place", help, sink);
                None
            }
        }
    }
}

impl Decode for IpNetwork {
    fn schema() -> Json {
        json!({ "type": "string", "examples": ["10.1.0.0/16"] })
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        match node.text().unwrap_or_default().parse() {
            Ok(network) => Some(network),
            Err(_) => {
                expected(
                    node,
                    "a network of IP addresses",
                    "write it like `10.1.0.0/16` or `10.1.2.3`",
                    sink,
                );
                None
            }
        }
    }
}

impl Decode for Ipv4Addr {
    fn schema() -> Json {
        json!({ "type": "string", "format": "ipv4" })
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        let address = node.text().and_then(|text| text.parse().ok());
        if address.is_none() {
            expected(node, "an IPv4 address", "write it like `192.168.1.7`", sink);
        }
        address
    }
}

/// Keys of any name and values of any kind, for whoever reads them later.
impl Decode for serde_json::Map<String, Json> {
    fn schema() -> Json {
        json!({ "type": "object" })
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        match node.to_json() {
            Json::Object(map) => Some(map),
            _ => {
                expected(node, "a mapping", "write `key: value` lines, indented below it", sink);
                None
            }
        }
    }
}

impl Sink {
    /// Reports a reference to a name that nothing has, with the known names of that kind.
    pub(crate) fn unknown_name<'a>(
        &mut self,
        span: &Span,
        kind: &str,
        name: &str,
        known: impl Iterator<Item = &'a str>,
    ) {
        let mut known: Vec<_> = known.collect();
        known.sort_unstable();
        let help = match nearest(name, known.iter().copied()) {
            Some(near) => format!("did you mean `{near}`?"),
            None if known.is_empty() => format!("this file has no {kind} at all"),
            None => there_are(&known),
        };
        self.error(span, format!("there is no {kind} `{name}`")).help(help);
    }
}

#[cfg(test)]
mod tests {
    use cotorra_graph::{HostAddress, NodeId};

    use super::*;
    use crate::{
        records::{LinkRecord, NodeRecord},
        yaml::parse,
    };

    #[test]
    fn as_many_hosts_and_links_as_a_testbed_may_have_are_read_and_no_end_of_records() {
        assert!(
            most::<LinkRecord>() > 100_000
                && most::<(Spanned<NodeId>, NodeRecord)>() > HostAddress::MAX_HOSTS
        );
        let mut sink = Sink::default();
        let text = format!("[{}]", "{},".repeat(most::<LinkRecord>() + 1));
        let node = parse(&text, &mut sink).unwrap();
        assert!(Vec::<LinkRecord>::decode(&node, &mut sink).is_none());
        let mistakes = sink.finish("x.yaml", &text).list;
        assert_eq!(mistakes.len(), 1, "none of them is read");
        assert!(mistakes[0].message.ends_with("are the most"), "{}", mistakes[0].message);
    }
}
