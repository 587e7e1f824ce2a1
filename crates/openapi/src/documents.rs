//! Derived OpenAPI documents, in a form that generators of clients understand.

use std::{env, fs, path::Path};

use serde_json::{Map, Value, json};
use utoipa::openapi::OpenApi;

/// Compares a derived document with the file in which it is checked in. With the environment variable `BLESS`, it writes that
/// file anew.
///
/// # Panics
/// If they differ, or the file cannot be read.
pub fn compare(document: &OpenApi, file: &Path) {
    let expected = "the document holds only what JSON can";
    let mut document = serde_json::to_value(document).expect(expected);
    simplify(&mut document);
    let derived = serde_json::to_string_pretty(&document).expect(expected) + "\n";
    if env::var_os("BLESS").is_some() {
        fs::write(file, &derived).expect("the file can be written");
    }
    let checked_in = fs::read_to_string(file).expect("the file can be read");
    assert!(
        derived == checked_in,
        "{} is not what the code says: write it anew by this test, with BLESS=1",
        file.display()
    );
}

/// Merges each `allOf` of a document into plain objects, and gives what one can choose from a schema each.
///
/// Derived schemas have an `allOf` for each tag and each flattened field; generators of clients cannot put those into unions.
/// An `allOf` with a choice among its parts becomes that choice, of merged objects; one that is written out twice is referred
/// to. Of the schema `Event`, what has the tag
/// `walk_finished` becomes `EventWalkFinished`.
fn simplify(document: &mut Value) {
    let schemas = document.pointer("/components/schemas").cloned().unwrap_or_default();
    merge(document, &schemas);
    let Some(schemas) = document.pointer_mut("/components/schemas").and_then(Value::as_object_mut) else {
        return;
    };
    let known: Vec<_> =
        schemas.iter().map(|(name, schema)| (name.clone(), undescribed(schema.clone()))).collect();
    for schema in schemas.values_mut() {
        refer(schema, &known);
    }
    name_choices(schemas);
}

/// Refers to a schema where it is written out within another one, as derived schemas of generic types do.
fn refer(within: &mut Value, known: &[(String, Value)]) {
    let children: Vec<&mut Value> = match within {
        Value::Array(items) => items.iter_mut().collect(),
        Value::Object(object) => object.values_mut().collect(),
        _ => return,
    };
    for child in children {
        let is_choice = child.get("oneOf").is_some();
        let same = |(_, schema): &&(String, Value)| is_choice && undescribed(child.clone()) == *schema;
        match known.iter().find(same) {
            Some((name, _)) => *child = json!({ "$ref": format!("#/components/schemas/{name}") }),
            None => refer(child, known),
        }
    }
}

fn undescribed(mut schema: Value) -> Value {
    if let Value::Object(object) = &mut schema {
        object.remove("description");
    }
    schema
}

/// Names what has a tag, and refers to it.
fn name_choices(schemas: &mut Map<String, Value>) {
    let mut named = Map::new();
    for (of, schema) in schemas.iter_mut() {
        for one in schema.get_mut("oneOf").and_then(Value::as_array_mut).into_iter().flatten() {
            if let Some(tag) = tag(one) {
                let name = tag.split('_').fold(of.clone(), |name, word| {
                    let (first, rest) = word.split_at(word.len().min(1));
                    name + &first.to_uppercase() + rest
                });
                let reference = json!({ "$ref": format!("#/components/schemas/{name}") });
                named.insert(name, std::mem::replace(one, reference));
            }
        }
    }
    schemas.extend(named);
}

/// The one text that a property of an object can be.
fn tag(schema: &Value) -> Option<String> {
    let only = |property: &Value| match property.get("enum")?.as_array()?.as_slice() {
        [Value::String(only)] => Some(only.clone()),
        _ => None,
    };
    schema.get("properties")?.as_object()?.values().find_map(only)
}

fn merge(value: &mut Value, schemas: &Value) {
    match value {
        Value::Array(items) => items.iter_mut().for_each(|item| merge(item, schemas)),
        Value::Object(object) if object.contains_key("allOf") => {
            let description = object.get("description").cloned();
            let mut alternatives = alternatives(value, schemas);
            *value = match alternatives.len() {
                1 => Value::Object(alternatives.remove(0)),
                _ => {
                    let alternatives = Value::from(alternatives);
                    // Without a tag, what fits one may fit another, too.
                    let tagged =
                        alternatives.as_array().is_some_and(|all| all.iter().all(|one| tag(one).is_some()));
                    json!({ (if tagged { "oneOf" } else { "anyOf" }): alternatives })
                }
            };
            if let (Some(description), Value::Object(object)) = (description, &mut *value) {
                object.insert("description".to_owned(), description);
            }
            merge(value, schemas);
        }
        Value::Object(object) => object.values_mut().for_each(|item| merge(item, schemas)),
        _ => {}
    }
}

/// The objects that a schema stands for: one, or each of a choice. Null is an object without properties: a field that may be
/// left out, flattened.
fn alternatives(schema: &Value, schemas: &Value) -> Vec<Map<String, Value>> {
    if let Some(name) = schema.get("$ref").and_then(Value::as_str) {
        let named = name.rsplit('/').next().and_then(|name| schemas.get(name));
        return alternatives(named.unwrap_or(&Value::Null), schemas);
    }
    let list = |key: &str| schema.get(key).and_then(Value::as_array);
    if let Some(parts) = list("allOf") {
        return parts.iter().fold(vec![Map::new()], |merged, part| {
            let part = alternatives(part, schemas);
            merged.iter().flat_map(|left| part.iter().map(|right| merged_objects(left, right))).collect()
        });
    }
    if let Some(choice) = list("oneOf") {
        return choice.iter().flat_map(|one| alternatives(one, schemas)).collect();
    }
    match schema {
        Value::Object(object) if object.get("type").is_none_or(|kind| kind != "null") => vec![object.clone()],
        _ => vec![Map::new()],
    }
}

/// An object with the properties of both.
fn merged_objects(left: &Map<String, Value>, right: &Map<String, Value>) -> Map<String, Value> {
    let mut merged = left.clone();
    for (key, value) in right {
        match (merged.get_mut(key), value) {
            (Some(Value::Object(ours)), Value::Object(theirs)) => ours.extend(theirs.clone()),
            (Some(Value::Array(ours)), Value::Array(theirs)) => ours.extend(theirs.iter().cloned()),
            (Some(_), _) => {}
            (None, value) => {
                merged.insert(key.clone(), value.clone());
            }
        }
    }
    merged
}

#[cfg(test)]
mod tests {
    use super::*;

    fn merged(schema: Value) -> (Value, Value) {
        let mut document = json!({ "components": { "schemas": {
            "Place": { "type": "object", "required": ["x"], "properties": { "x": { "type": "number" } } },
            "Kind": { "oneOf": [
                { "type": "object", "required": ["kind"], "properties": { "kind": { "enum": ["switch"] } } },
                { "allOf": [{ "$ref": "#/components/schemas/Place" }, {
                    "type": "object", "required": ["kind"], "properties": { "kind": { "enum": ["robot"] } },
                }] },
            ] },
            "It": schema,
        } } });
        simplify(&mut document);
        let schemas = document.pointer("/components/schemas").unwrap();
        (schemas["It"].clone(), schemas.clone())
    }

    #[test]
    fn flattened_fields_are_one_object() {
        let id =
            json!({ "type": "object", "required": ["id"], "properties": { "id": { "type": "string" } } });
        let parts =
            json!({ "allOf": [{ "$ref": "#/components/schemas/Place" }, id], "description": "A node." });
        let expected = json!({
            "type": "object", "required": ["x", "id"], "description": "A node.",
            "properties": { "x": { "type": "number" }, "id": { "type": "string" } },
        });
        assert_eq!(merged(parts).0, expected);
    }

    #[test]
    fn choices_stay_choices_of_whole_objects() {
        let id =
            json!({ "type": "object", "required": ["id"], "properties": { "id": { "type": "string" } } });
        let (node, schemas) = merged(json!({ "allOf": [{ "$ref": "#/components/schemas/Kind" }, id] }));
        let names = ["ItSwitch", "ItRobot"];
        let references = names.map(|name| json!({ "$ref": format!("#/components/schemas/{name}") }));
        assert_eq!(node["oneOf"], json!(references));
        let required = names.map(|name| &schemas[name]["required"]);
        assert_eq!(required, [&json!(["kind", "id"]), &json!(["x", "kind", "id"])]);
    }

    #[test]
    fn optional_fields_add_their_properties_or_none() {
        let (point, _) = merged(json!({ "allOf": [
            { "oneOf": [{ "$ref": "#/components/schemas/Place" }, { "type": "null" }] },
            { "type": "object", "required": ["gap"], "properties": { "gap": { "type": "boolean" } } },
        ] }));
        let required: Vec<_> =
            point["anyOf"].as_array().unwrap().iter().map(|one| &one["required"]).collect();
        assert_eq!(required, [&json!(["x", "gap"]), &json!(["gap"])]);
    }
}
