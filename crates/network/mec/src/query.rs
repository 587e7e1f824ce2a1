//! Parameters of queries: filters and selectors of attributes (ETSI GS MEC 009, 6.18 and 6.19).

use serde_json::Value;

use crate::{
    attributes::Attribute,
    filter::{Filter, FilterError},
    selector::{Selection, SelectorError, Selectors},
};

/// A query of one data type.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Query {
    filter: Option<Filter>,
    selection: Selection,
}

/// Invalid query parameters.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum QueryError {
    /// An invalid filter.
    #[error(transparent)]
    Filter(#[from] FilterError),
    /// Invalid selectors.
    #[error(transparent)]
    Selector(#[from] SelectorError),
    /// The parameter does not exist.
    #[error(
        "there is no parameter `{0}`; there are filter, all_fields, fields, exclude_fields, exclude_default"
    )]
    Unknown(String),
    /// The parameter is repeated.
    #[error("`{0}` is given twice")]
    Twice(String),
}

impl Query {
    /// Parses the parameters of a query of a data type with these attributes.
    ///
    /// # Errors
    /// [`QueryError`].
    pub fn read(of: &'static [Attribute], parameters: &[(String, String)]) -> Result<Self, QueryError> {
        let (mut selectors, mut filter) = (Selectors::default(), None);
        for (i, (name, value)) in parameters.iter().enumerate() {
            if parameters[..i].iter().any(|(other, _)| other == name) {
                return Err(QueryError::Twice(name.clone()));
            }
            match name.as_str() {
                "filter" => filter = Some(Filter::parse(value, of)?),
                "all_fields" => selectors.all_fields = true,
                "fields" => selectors.fields = Some(value.clone()),
                "exclude_fields" => selectors.exclude_fields = Some(value.clone()),
                "exclude_default" => selectors.exclude_default = true,
                _ => return Err(QueryError::Unknown(name.clone())),
            }
        }
        Ok(Self { filter, selection: Selection::new(&selectors, of)? })
    }

    /// Whether it wants an object.
    pub fn wants(&self, object: &Value) -> bool {
        self.filter.as_ref().is_none_or(|filter| filter.matches(object))
    }

    /// Whether it wants all objects.
    pub fn wants_all(&self) -> bool {
        self.filter.is_none()
    }

    /// Returns the selected part of an object.
    pub fn select(&self, object: &Value) -> Value {
        self.selection.apply(object)
    }

    /// Whether objects are selected as a whole.
    pub fn selects_all(&self) -> bool {
        self.selection == Selection::All
    }

    /// Returns the selected parts of the wanted objects.
    pub fn answer(&self, objects: impl IntoIterator<Item = Value>) -> Value {
        objects.into_iter().filter(|object| self.wants(object)).map(|object| self.select(&object)).collect()
    }
}
