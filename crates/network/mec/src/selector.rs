//! Attribute selectors (ETSI GS MEC 009, clause 6.18): the complex attributes - structures and arrays - that an
//! answer includes. Simple and required attributes are always included.

use serde_json::{Map, Value};

use crate::attributes::{Attribute, Kind, find};

/// Invalid selectors.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SelectorError {
    /// The data type has no such attribute.
    #[error("`{parameter}` names `{path}`, but there is no attribute `{name}`; there are {there}")]
    Unknown {
        /// Name of the parameter.
        parameter: &'static str,
        /// The invalid path.
        path: String,
        /// The unknown name in it.
        name: String,
        /// Names of the existing attributes.
        there: String,
    },
    /// A required or simple attribute is excluded.
    #[error("`{0}` cannot be left out: `exclude_fields` takes only optional structures and arrays")]
    Required(String),
    /// Two selectors contradict each other.
    #[error("`{0}` and `{1}` exclude each other: give one of them")]
    Conflict(&'static str, &'static str),
}

/// The selectors of a query.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Selectors {
    pub(crate) all_fields: bool,
    pub(crate) fields: Option<String>,
    pub(crate) exclude_fields: Option<String>,
    pub(crate) exclude_default: bool,
}

/// The attributes of an object to include.
///
/// The standards exclude no attribute of the types here by default. `all_fields`, `exclude_default` and no selector
/// therefore mean the same.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) enum Selection {
    /// All attributes.
    #[default]
    All,
    /// Of complex attributes only these.
    Only(&'static [Attribute], Vec<Choice>),
    /// All but these.
    Without(Vec<Choice>),
}

impl PartialEq for Attribute {
    fn eq(&self, other: &Self) -> bool {
        std::ptr::eq(self, other)
    }
}

impl Eq for Attribute {}

/// A selected attribute, with its selected inner attributes. An empty list selects all of it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Choice {
    attribute: &'static Attribute,
    inner: Vec<Choice>,
}

impl Selection {
    pub(crate) fn new(selectors: &Selectors, of: &'static [Attribute]) -> Result<Self, SelectorError> {
        let given = [
            ("all_fields", selectors.all_fields),
            ("fields", selectors.fields.is_some()),
            ("exclude_fields", selectors.exclude_fields.is_some()),
            ("exclude_default", selectors.exclude_default),
        ];
        let given: Vec<_> = given.iter().filter(|(_, given)| *given).map(|(name, _)| *name).collect();
        if let [one, other, ..] = given[..]
            && given != ["fields", "exclude_default"]
        {
            return Err(SelectorError::Conflict(one, other));
        }
        match (&selectors.fields, &selectors.exclude_fields) {
            // Nothing is excluded by default, so `fields` adds to everything.
            (Some(list), None) if selectors.exclude_default => {
                choices("fields", list, of, |_| true).map(|_| Self::All)
            }
            (Some(list), _) => Ok(Self::Only(of, choices("fields", list, of, |_| true)?)),
            (None, Some(list)) => {
                let may_go = |attribute: &Attribute| attribute.is_complex() && !attribute.required;
                Ok(Self::Without(choices("exclude_fields", list, of, may_go)?))
            }
            (None, None) => Ok(Self::All),
        }
    }

    /// Returns the selected part of an object.
    pub(crate) fn apply(&self, object: &Value) -> Value {
        match self {
            Self::All => object.clone(),
            Self::Only(of, choices) => only(object, of, choices),
            Self::Without(choices) => without(object, choices),
        }
    }
}

/// Reads paths separated by commas.
fn choices(
    parameter: &'static str,
    list: &str,
    of: &'static [Attribute],
    may_be: impl Fn(&Attribute) -> bool,
) -> Result<Vec<Choice>, SelectorError> {
    let mut all = Vec::new();
    for path in list.split(',') {
        let (mut among, mut chosen) = (of, &mut all);
        let mut names = path.split('/').peekable();
        while let Some(name) = names.next() {
            let Some(attribute) = find(among, name) else {
                let there: Vec<_> = among.iter().map(|attribute| attribute.name).collect();
                let there = if there.is_empty() { "none".to_owned() } else { there.join(", ") };
                return Err(SelectorError::Unknown {
                    parameter,
                    path: path.to_owned(),
                    name: name.to_owned(),
                    there,
                });
            };
            let is_last = names.peek().is_none();
            if is_last && !may_be(attribute) {
                return Err(SelectorError::Required(path.to_owned()));
            }
            among = if let Kind::Structure(inner) = attribute.kind { inner } else { &[] };
            let Some(next) = descend(chosen, attribute, is_last) else { break };
            chosen = next;
        }
    }
    Ok(all)
}

/// Returns the choices within an attribute; `None` if all of it is chosen.
fn descend<'c>(
    choices: &'c mut Vec<Choice>,
    attribute: &'static Attribute,
    is_last: bool,
) -> Option<&'c mut Vec<Choice>> {
    let place = choices.iter().position(|choice| choice.attribute == attribute);
    let place = match place {
        Some(place) if choices[place].inner.is_empty() => return None,
        Some(place) => place,
        None => {
            choices.push(Choice { attribute, inner: Vec::new() });
            choices.len() - 1
        }
    };
    let inner = &mut choices[place].inner;
    if is_last {
        inner.clear();
        return None;
    }
    Some(inner)
}

/// Drops complex attributes that are not chosen, unless they are required, at each level with a choice.
fn only(value: &Value, of: &'static [Attribute], choices: &[Choice]) -> Value {
    each(value, |name, inner| {
        let attribute = find(of, name)?;
        match choices.iter().find(|choice| choice.attribute == attribute) {
            Some(choice) if !choice.inner.is_empty() => match attribute.kind {
                Kind::Structure(of) => Some(only(inner, of, &choice.inner)),
                _ => Some(inner.clone()),
            },
            Some(_) => Some(inner.clone()),
            None => (!attribute.is_complex() || attribute.required).then(|| inner.clone()),
        }
    })
}

fn without(value: &Value, choices: &[Choice]) -> Value {
    each(value, |name, inner| match choices.iter().find(|choice| choice.attribute.name == name) {
        Some(choice) if choice.inner.is_empty() => None,
        Some(choice) => Some(without(inner, &choice.inner)),
        None => Some(inner.clone()),
    })
}

/// Applies `keep` to the attributes of an object, or of each object of an array.
fn each(value: &Value, keep: impl Fn(&str, &Value) -> Option<Value>) -> Value {
    fn one(value: &Value, keep: &dyn Fn(&str, &Value) -> Option<Value>) -> Value {
        match value {
            Value::Object(map) => {
                let kept = map.iter().filter_map(|(name, inner)| Some((name.clone(), keep(name, inner)?)));
                Value::Object(Map::from_iter(kept))
            }
            Value::Array(elements) => elements.iter().map(|element| one(element, keep)).collect(),
            simple => simple.clone(),
        }
    }
    one(value, &keep)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::testing::ACCESS_POINT;

    fn object() -> Value {
        json!({
            "apId": { "bssid": "02:77:00:00:00:01", "ssid": ["lab"], "ipAddress": ["10.77.0.1"] },
            "timeStamp": { "seconds": 1, "nanoSeconds": 2 },
            "channel": 6,
            "bssLoad": { "staCount": 3, "channelUtilization": 4, "availAdmCap": 0 },
        })
    }

    fn select(query: &[(&str, &str)]) -> Result<Value, SelectorError> {
        let mut selectors = Selectors::default();
        for (name, value) in query {
            match *name {
                "all_fields" => selectors.all_fields = true,
                "fields" => selectors.fields = Some((*value).to_owned()),
                "exclude_fields" => selectors.exclude_fields = Some((*value).to_owned()),
                _ => selectors.exclude_default = true,
            }
        }
        Selection::new(&selectors, ACCESS_POINT).map(|selection| selection.apply(&object()))
    }

    fn names(value: &Value) -> Vec<&str> {
        value.as_object().unwrap().keys().map(String::as_str).collect()
    }

    #[test]
    fn default_selectors_include_everything() {
        for query in [
            &[][..],
            &[("all_fields", "")],
            &[("exclude_default", "")],
            &[("exclude_default", ""), ("fields", "bssLoad")],
        ] {
            assert_eq!(select(query).unwrap(), object(), "{query:?}");
        }
    }

    #[test]
    fn fields_keeps_simple_required_and_named_attributes() {
        let chosen = select(&[("fields", "bssLoad")]).unwrap();
        assert_eq!(names(&chosen), ["apId", "bssLoad", "channel"]);
        assert_eq!(chosen["apId"], object()["apId"], "nothing in it was named, so it is complete");
        // If inner attributes are named, the others are dropped.
        let chosen = select(&[("fields", "apId/ssid,timeStamp")]).unwrap();
        assert_eq!(names(&chosen), ["apId", "channel", "timeStamp"]);
        assert_eq!(names(&chosen["apId"]), ["bssid", "ssid"]);
        // A whole attribute overrides a part of it, in either order.
        for list in ["apId,apId/ssid", "apId/ssid,apId"] {
            assert_eq!(select(&[("fields", list)]).unwrap()["apId"], object()["apId"]);
        }
    }

    #[test]
    fn exclude_fields_drops_named_attributes() {
        let chosen = select(&[("exclude_fields", "bssLoad,apId/ipAddress")]).unwrap();
        assert_eq!(names(&chosen), ["apId", "channel", "timeStamp"]);
        assert_eq!(names(&chosen["apId"]), ["bssid", "ssid"]);
    }

    #[test]
    fn invalid_selectors_are_rejected_with_a_reason() {
        for (query, part) in [
            (&[("fields", "load")][..], "no attribute `load`"),
            (&[("fields", "bssLoad/x")], "there are staCount"),
            (&[("fields", "channel/x")], "there are none"),
            (&[("fields", "")], "no attribute ``"),
            (&[("exclude_fields", "apId")], "cannot be left out"),
            (&[("exclude_fields", "channel")], "cannot be left out"),
            (&[("fields", "bssLoad"), ("exclude_fields", "bssLoad")], "exclude each other"),
            (&[("all_fields", ""), ("fields", "bssLoad")], "exclude each other"),
            (&[("all_fields", ""), ("exclude_default", "")], "exclude each other"),
        ] {
            let error = select(query).unwrap_err().to_string();
            assert!(error.contains(part), "{query:?}: {error}");
        }
    }
}
