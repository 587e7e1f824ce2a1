//! Queries of services (ETSI GS MEC 011 v3.1.1, clause 8.2.3.3.1).

use cotorra_mec::InvalidRequest;

use super::ServiceInfo;

/// A query of services. Empty lists match all.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ServiceQuery {
    instances: Vec<String>,
    names: Vec<String>,
    category: Option<String>,
    locality: Option<String>,
    consumed_local_only: Option<bool>,
    is_local: Option<bool>,
}

impl ServiceQuery {
    /// Parses the parameters of a query.
    ///
    /// # Errors
    /// [`InvalidRequest::Malformed`] for an unknown parameter, a value that is none of its type, and for two of
    /// `ser_instance_id`, `ser_name` and `ser_category_id`, which exclude each other.
    pub fn read(parameters: Vec<(String, String)>) -> Result<Self, InvalidRequest> {
        let mut query = Self::default();
        for (name, value) in parameters {
            match name.as_str() {
                "ser_instance_id" => query.instances.push(value),
                "ser_name" => query.names.push(value),
                "ser_category_id" => once(&mut query.category, &name, value)?,
                "scope_of_locality" => once(&mut query.locality, &name, value)?,
                "consumed_local_only" => once(&mut query.consumed_local_only, &name, flag(&name, &value)?)?,
                "is_local" => once(&mut query.is_local, &name, flag(&name, &value)?)?,
                _ => {
                    return InvalidRequest::malformed(format!(
                        "there is no parameter `{name}`; there are ser_instance_id, ser_name, ser_category_id, \
                         scope_of_locality, consumed_local_only, is_local"
                    ));
                }
            }
        }
        let sets = [!query.instances.is_empty(), !query.names.is_empty(), query.category.is_some()];
        if sets.into_iter().filter(|given| *given).count() > 1 {
            return InvalidRequest::malformed(
                "ser_instance_id, ser_name and ser_category_id exclude each other: give one of them",
            );
        }
        Ok(query)
    }

    /// Whether it wants a service.
    pub(super) fn wants(&self, service: &ServiceInfo) -> bool {
        let among = |list: &[String], value: Option<&String>| {
            list.is_empty() || value.is_some_and(|value| list.contains(value))
        };
        among(&self.instances, service.ser_instance_id.as_ref())
            && among(&self.names, Some(&service.ser_name))
            && self.category.as_ref().is_none_or(|wanted| {
                service.ser_category.as_ref().is_some_and(|category| category.id == *wanted)
            })
            && self.locality.as_ref().is_none_or(|wanted| service.locality() == **wanted)
            && self
                .consumed_local_only
                .is_none_or(|wanted| service.consumed_local_only.unwrap_or(true) == wanted)
            && self.is_local.is_none_or(|wanted| service.is_local.unwrap_or(true) == wanted)
    }
}

fn once<T>(place: &mut Option<T>, name: &str, value: T) -> Result<(), InvalidRequest> {
    match place.replace(value) {
        None => Ok(()),
        Some(_) => InvalidRequest::malformed(format!("`{name}` is given twice")),
    }
}

fn flag(name: &str, value: &str) -> Result<bool, InvalidRequest> {
    match value {
        "true" => Ok(true),
        "false" => Ok(false),
        _ => InvalidRequest::malformed(format!("`{name}` is true or false")),
    }
}
