//! Shares of samples within their target, over the services of interest.

use cotorra_graph::{ServiceId, Testbed};

/// There is no service of that name.
#[derive(Debug, thiserror::Error)]
#[error("there is no service `{service}` in the testbed file; its services: {}", known.join(", "))]
pub struct UnknownService {
    service: String,
    known: Vec<String>,
}

/// Returns the services of these names; without names, those in the total ([`Testbed::services_in_total`]).
///
/// # Errors
/// [`UnknownService`].
pub(crate) fn services(testbed: &Testbed, names: &[String]) -> Result<Vec<ServiceId>, UnknownService> {
    let all: Vec<_> = testbed.services.iter().map(|service| service.id.clone()).collect();
    if names.is_empty() {
        return Ok(testbed.services_in_total().map(|service| service.id.clone()).collect());
    }
    let of = |name: &String| {
        let known = || all.iter().map(ToString::to_string).collect();
        let found = all.iter().find(|service| service.as_str() == name);
        found.cloned().ok_or_else(|| UnknownService { service: name.clone(), known: known() })
    };
    names.iter().map(of).collect()
}
