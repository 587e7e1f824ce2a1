//! Comparison of values with ETSI's published schemas.

use serde_json::Value;

/// The schemas of ETSI's OpenAPI file of MEC 013 v3.1.1.
const SCHEMAS: &str = include_str!("../../tests/etsi/mec013-3.1.1.schemas.json");

/// Attributes that the file lacks by mistake: it calls one `AccessPointId` and requires `accessPointId`; and notifications
/// link to their subscription in the standard's text.
const BESIDE: [&str; 2] = ["accessPointId", "subscription"];

/// Returns how a value differs from a schema of this name. An attribute that the schema does not have is a difference.
pub(super) fn differences(value: &Value, schema: &str) -> Vec<String> {
    let schemas: Value = serde_json::from_str(SCHEMAS).unwrap();
    let mut found = Vec::new();
    let reference = serde_json::json!({ "$ref": format!("#/components/schemas/{schema}") });
    compare(value, &reference, &schemas, schema, &mut found);
    found
}

fn compare(value: &Value, schema: &Value, schemas: &Value, path: &str, found: &mut Vec<String>) {
    if let Some(reference) = schema["$ref"].as_str() {
        let target = schemas.pointer(reference.trim_start_matches('#'));
        let target = target.unwrap_or_else(|| panic!("{path}: there is no {reference}"));
        return compare(value, target, schemas, path, found);
    }
    let is_type = match schema["type"].as_str() {
        Some("object") => value.is_object(),
        Some("array") => value.is_array(),
        Some("string") => value.is_string(),
        Some("integer") => value.is_i64() || value.is_u64(),
        Some("number") => value.is_number(),
        Some("boolean") => value.is_boolean(),
        None => true,
        Some(other) => panic!("{path}: the comparison does not know the type {other}"),
    };
    if !is_type {
        found.push(format!("{path} is no {}", schema["type"]));
    }
    if let Some(values) = schema["enum"].as_array()
        && !values.contains(value)
    {
        found.push(format!("{path} is {value}"));
    }
    if schema["format"] == "uri" && !value.as_str().is_some_and(|text| text.contains(':')) {
        found.push(format!("{path} is no URI"));
    }
    if schema["format"] == "uint32" && value.as_u64().is_none_or(|number| number > u32::MAX.into()) {
        found.push(format!("{path} is no uint32"));
    }
    for name in schema["required"].as_array().into_iter().flatten().filter_map(Value::as_str) {
        if value.get(name).is_none() {
            found.push(format!("{path} lacks {name}"));
        }
    }
    if let Some(least) = schema["minItems"].as_u64()
        && value.as_array().is_some_and(|items| (items.len() as u64) < least)
    {
        found.push(format!("{path} has fewer than {least} items"));
    }
    for (i, item) in value.as_array().into_iter().flatten().enumerate() {
        compare(item, &schema["items"], schemas, &format!("{path}[{i}]"), found);
    }
    for (name, inner) in value.as_object().into_iter().flatten() {
        match schema["properties"].get(name) {
            Some(of) => compare(inner, of, schemas, &format!("{path}.{name}"), found),
            None if BESIDE.contains(&name.as_str()) => {}
            None => found.push(format!("{path} has no {name}")),
        }
    }
}

#[test]
fn differences_from_the_published_schemas_are_found() {
    use serde_json::json;
    let zone = json!({
        "zoneId": "a", "numberOfAccessPoints": 1, "numberOfUnserviceableAccessPoints": 0, "numberOfUsers": 2,
        "resourceURL": "http://x/",
    });
    assert_eq!(differences(&zone, "ZoneInfo"), [""; 0]);
    type Change = fn(&mut Value);
    let changes: [(Change, &str); 4] = [
        (|z| drop(z.as_object_mut().unwrap().remove("zoneId")), "ZoneInfo lacks zoneId"),
        (|z| z["numberOfUsers"] = json!("2"), "ZoneInfo.numberOfUsers is no \"integer\""),
        (|z| z["users"] = json!(2), "ZoneInfo has no users"),
        (|z| z["zoneId"] = json!(1), "ZoneInfo.zoneId is no \"string\""),
    ];
    for (change, expected) in changes {
        let mut wrong = zone.clone();
        change(&mut wrong);
        assert_eq!(differences(&wrong, "ZoneInfo"), [expected]);
    }
    let location = json!({ "latitude": [], "longitude": [1.0], "shape": 9 });
    assert_eq!(
        differences(&location, "LocationInfo"),
        ["LocationInfo.latitude has fewer than 1 items", "LocationInfo.shape is 9"]
    );
}
