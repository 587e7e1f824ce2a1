//! Every text and list of every request has a bound: the document of the API names them all, so that none is forgotten.

use serde::de::DeserializeOwned;

use super::*;
use crate::api::{
    clock,
    types::{AddVnfBody, InstructionBody, ThroughputTestBody},
};

/// Longer than any text or list may be, and shorter than the longest body.
const OVERSIZE: usize = 100_000;

/// Texts with a form of their own, whose small value here has not that form.
const FORMED: [&str; 2] = ["core", "key"];

/// Reads the body of a request, by the name of its type in the document. A new type has no reader here.
fn reader(name: &str) -> fn(Value) -> Result<(), String> {
    fn read<T: DeserializeOwned>(value: Value) -> Result<(), String> {
        // As bytes, as a request has it.
        let read = serde_json::from_slice::<T>(&serde_json::to_vec(&value).unwrap());
        read.map(|_| ()).map_err(|error| error.to_string())
    }
    match name {
        "InstructionBody" => read::<InstructionBody>,
        "AddVnfBody" => read::<AddVnfBody>,
        "ThroughputTestBody" => read::<ThroughputTestBody>,
        "ClockChangeBody" => read::<clock::ClockChangeBody>,
        other => panic!("the bounds of the request {other} are not tested"),
    }
}

/// A value that differs from the smallest one at one place, which holds a small and an oversize text or list.
struct Place {
    path: String,
    small: Value,
    oversize: Value,
}

struct Document(Value);

impl Document {
    fn resolve<'a>(&'a self, schema: &'a Value) -> &'a Value {
        match schema["$ref"].as_str() {
            Some(name) => self.resolve(&self.0["components"]["schemas"][name.rsplit_once('/').unwrap().1]),
            None => schema,
        }
    }

    /// Returns the alternatives of a schema but null.
    fn alternatives<'a>(&'a self, schema: &'a Value) -> Vec<&'a Value> {
        let schema = self.resolve(schema);
        match schema["oneOf"].as_array().or_else(|| schema["anyOf"].as_array()) {
            Some(all) => all
                .iter()
                .flat_map(|one| self.alternatives(one))
                .filter(|one| one["type"] != "null")
                .collect(),
            None => vec![schema],
        }
    }

    /// Returns the properties of an object, and the names of those that it needs.
    fn properties<'a>(&'a self, schema: &'a Value) -> (BTreeMap<&'a str, &'a Value>, BTreeSet<&'a str>) {
        let schema = self.resolve(schema);
        let (mut all, mut required) = (BTreeMap::new(), BTreeSet::new());
        for part in schema["allOf"].as_array().into_iter().flatten() {
            let (more, needed) = self.properties(part);
            all.extend(more);
            required.extend(needed);
        }
        all.extend(schema["properties"].as_object().into_iter().flatten().map(|(k, v)| (k.as_str(), v)));
        required.extend(schema["required"].as_array().into_iter().flatten().filter_map(Value::as_str));
        (all, required)
    }

    fn smallest(&self, schema: &Value) -> Value {
        let schema = self.alternatives(schema)[0];
        if let Some(values) = schema["enum"].as_array() {
            return values[0].clone();
        }
        let kind = schema["type"].as_array().map_or(&schema["type"], |kinds| &kinds[0]);
        match kind.as_str() {
            Some("string") => json!("a"),
            Some("number") => json!(0.5),
            Some("integer") => json!(1),
            Some("boolean") => json!(false),
            Some("array") => json!([]),
            _ => {
                let (properties, required) = self.properties(schema);
                let needed =
                    required.into_iter().map(|name| (name.to_owned(), self.smallest(properties[name])));
                Value::Object(needed.collect())
            }
        }
    }

    fn places(&self, path: &str, schema: &Value) -> Vec<Place> {
        self.alternatives(schema).into_iter().flat_map(|one| self.places_of_one(path, one)).collect()
    }

    fn places_of_one(&self, path: &str, schema: &Value) -> Vec<Place> {
        let kind = schema["type"].as_array().map_or(&schema["type"], |kinds| &kinds[0]);
        let path = path.to_owned();
        match kind.as_str() {
            _ if schema["enum"].is_array() => Vec::new(),
            Some("string") => vec![Place { path, small: json!("b"), oversize: "b".repeat(OVERSIZE).into() }],
            Some("number" | "integer" | "boolean") => Vec::new(),
            Some("array") => {
                let items = &schema["items"];
                let item = self.smallest(items);
                let (small, oversize) = (json!([item]), vec![item.clone(); OVERSIZE].into());
                let inner = self.places(&format!("{path}[]"), items).into_iter().map(|place| Place {
                    small: json!([place.small]),
                    oversize: json!([place.oversize]),
                    ..place
                });
                [Place { path, small, oversize }].into_iter().chain(inner).collect()
            }
            _ => {
                let (properties, _) = self.properties(schema);
                assert!(!properties.is_empty(), "{path} can hold anything: {schema}");
                let smallest = self.smallest(schema);
                let with = |name: &str, value| {
                    let mut whole = smallest.clone();
                    whole[name] = value;
                    whole
                };
                let inner = |(name, schema): (&str, &Value)| {
                    let places = self.places(&format!("{path}.{name}"), schema).into_iter();
                    let whole = |place: Place| Place {
                        small: with(name, place.small),
                        oversize: with(name, place.oversize),
                        ..place
                    };
                    places.map(whole).collect::<Vec<_>>()
                };
                properties.into_iter().flat_map(inner).collect()
            }
        }
    }
}

#[test]
fn no_request_has_a_text_or_list_without_a_bound() {
    let document = Document(serde_json::from_str(&openapi()).unwrap());
    let methods = document.0["paths"].as_object().unwrap().values();
    let bodies = methods.flat_map(|methods| methods.as_object().unwrap().values()).filter_map(|method| {
        let content = method["requestBody"]["content"].as_object()?;
        Some(content["application/json"]["schema"]["$ref"].as_str().expect("a request's body has a name"))
    });
    let bodies: BTreeSet<_> = bodies.map(|body| body.rsplit_once('/').unwrap().1.to_owned()).collect();
    assert!(bodies.contains("InstructionBody"));
    let mut unbounded = Vec::new();
    let mut tested = BTreeSet::new();
    for body in &bodies {
        let (schema, read) = (&document.0["components"]["schemas"][body], reader(body));
        read(document.smallest(schema)).unwrap_or_else(|error| panic!("{body}: {error}"));
        for Place { path, small, oversize } in document.places(body, schema) {
            if !FORMED.iter().any(|formed| path.ends_with(formed)) {
                read(small.clone()).unwrap_or_else(|error| panic!("{path}: {error}: {small}"));
            }
            match read(oversize) {
                Ok(()) => unbounded.push(path),
                Err(error) => {
                    assert!(error.len() < 1000, "{path}: the error repeats the request");
                    tested.insert(path);
                }
            }
        }
    }
    assert!(unbounded.is_empty(), "texts and lists without a bound: {unbounded:#?}");
    assert!(tested.len() > 40, "{tested:#?}");
}

#[test]
fn every_variant_of_an_instruction_is_in_the_document() {
    let document: Value = serde_json::from_str(&openapi()).unwrap();
    let variants = document["components"]["schemas"]["Instruction"]["oneOf"].as_array().unwrap();
    let longest = variants.len();
    // The error of an unknown variant names all that there are.
    let unknown = json!({ "instruction": { "instruction": "none" } });
    let error = serde_json::from_value::<InstructionBody>(unknown).unwrap_err().to_string();
    let known = error.split_once("expected one of ").unwrap().1.split(", ").count();
    assert_eq!(known, longest, "{error}");
}

#[test]
fn an_oversize_request_is_rejected_and_changes_nothing() {
    let served = Domains::serve();
    let ssid = "s".repeat(200_000);
    let access_point = json!({ "ssid": ssid, "mobility_domain": 1 });
    let provision = json!({ "instruction": "provision", "robot": "robot", "radio_unit": "ap", "access_point": access_point });
    let scan = json!({ "instruction": "scan", "robot": "robot" });
    let note = json!({ "instruction": "note", "process": "p".repeat(200_000), "step": "s" });
    let vnf = json!({
        "id": "v", "program": { "command": ["w".repeat(200_000)] }, "cpus": 1.0, "memory_bytes": 1, "node": "left"
    });
    for (path, body, reason) in [
        ("instructions", json!({ "instruction": provision }), "its `ssid` has 200000 bytes: at most 32"),
        (
            "instructions",
            json!({ "instruction": scan, "reason": "r".repeat(1025) }),
            "its reason has 1025 bytes",
        ),
        ("instructions", json!({ "instruction": note }), "its `process` has 200000 bytes: at most 512"),
        ("vnfs", json!({ "vnf": vnf }), "its `command` has 200000 bytes"),
    ] {
        let (status, mut answer) = served.ask(ONE, &format!("POST /api/v1/{path}"), &body.to_string());
        let mut text = String::new();
        answer.read_to_string(&mut text).unwrap();
        assert_eq!(status, 422, "{text}");
        assert!(text.contains(reason) && text.len() < 1000, "{text}");
    }
    assert!(served.core.try_recv().is_err(), "the core was told nothing");
}
