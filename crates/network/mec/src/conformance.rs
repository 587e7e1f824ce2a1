//! Comparison of values with ETSI's published schemas, for tests of services.

use serde_json::Value;

/// The schemas of an OpenAPI file.
#[derive(Debug, Clone, Copy)]
pub struct Published {
    /// The JSON that has `components.schemas`.
    pub schemas: &'static str,
    /// Attributes that the file lacks by mistake.
    pub beside: &'static [&'static str],
}

impl Published {
    /// Returns how a value differs from a schema of this name. An attribute that the schema does not have is a difference.
    pub fn differences(self, value: &Value, schema: &str) -> Vec<String> {
        let schemas: Value = serde_json::from_str(self.schemas).expect("the file is JSON");
        let mut found = Vec::new();
        let reference = serde_json::json!({ "$ref": format!("#/components/schemas/{schema}") });
        Comparison { schemas, beside: self.beside, found: &mut found }.compare(value, &reference, schema);
        found
    }
}

struct Comparison<'a> {
    schemas: Value,
    beside: &'static [&'static str],
    found: &'a mut Vec<String>,
}

impl Comparison<'_> {
    fn compare(&mut self, value: &Value, schema: &Value, path: &str) {
        if let Some(reference) = schema["$ref"].as_str() {
            let target = self.schemas.pointer(reference.trim_start_matches('#')).cloned();
            let target = target.unwrap_or_else(|| panic!("{path}: there is no {reference}"));
            return self.compare(value, &target, path);
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
            self.found.push(format!("{path} is no {}", schema["type"]));
        }
        if let Some(values) = schema["enum"].as_array()
            && !values.contains(&"SEE_DESCRIPTION".into())
            && !values.contains(value)
        {
            self.found.push(format!("{path} is {value}"));
        }
        if schema["format"] == "uri" && !value.as_str().is_some_and(|text| text.contains(':')) {
            self.found.push(format!("{path} is no URI"));
        }
        if schema["format"] == "uint32" && value.as_u64().is_none_or(|number| number > u32::MAX.into()) {
            self.found.push(format!("{path} is no uint32"));
        }
        for name in schema["required"].as_array().into_iter().flatten().filter_map(Value::as_str) {
            if value.get(name).is_none() {
                self.found.push(format!("{path} lacks {name}"));
            }
        }
        if let Some(least) = schema["minItems"].as_u64()
            && value.as_array().is_some_and(|items| (items.len() as u64) < least)
        {
            self.found.push(format!("{path} has fewer than {least} items"));
        }
        for (i, item) in value.as_array().into_iter().flatten().enumerate() {
            self.compare(item, &schema["items"], &format!("{path}[{i}]"));
        }
        for (name, inner) in value.as_object().into_iter().flatten() {
            match schema["properties"].get(name) {
                Some(of) => self.compare(inner, of, &format!("{path}.{name}")),
                None if self.beside.contains(&name.as_str()) => {}
                None => self.found.push(format!("{path} has no {name}")),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PUBLISHED: Published = Published {
        schemas: include_str!("../../location/tests/etsi/mec013-3.1.1.schemas.json"),
        beside: &[],
    };

    #[test]
    fn differences_from_the_published_schemas_are_found() {
        use serde_json::json;
        let zone = json!({
            "zoneId": "a", "numberOfAccessPoints": 1, "numberOfUnserviceableAccessPoints": 0, "numberOfUsers": 2,
            "resourceURL": "http://x/",
        });
        assert_eq!(PUBLISHED.differences(&zone, "ZoneInfo"), [""; 0]);
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
            assert_eq!(PUBLISHED.differences(&wrong, "ZoneInfo"), [expected]);
        }
        let location = json!({ "latitude": [], "longitude": [1.0], "shape": 9 });
        assert_eq!(
            PUBLISHED.differences(&location, "LocationInfo"),
            ["LocationInfo.latitude has fewer than 1 items", "LocationInfo.shape is 9"]
        );
    }
}
