//! Subscriptions to the availability of services (ETSI GS MEC 011 v3.1.1, clauses 8.1.3.2 and 8.1.4.2).

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

use cotorra_mec::{InvalidRequest, Subscribed as _};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::{
    ServiceState,
    info::{CategoryRef, ServiceInfo},
};
use crate::{
    links::{SUBSCRIPTIONS, base_of},
    subscription::{Subscription, Wanted},
};

/// A subscription of an application to the availability of services.
pub type AvailabilitySubscription = Subscription<Availability>;

/// The availability of services.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Availability {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    filtering_criteria: Option<FilteringCriteria>,
}

/// The services and changes to notify. Empty lists match all.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
struct FilteringCriteria {
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    ser_instance_ids: Vec<String>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    ser_names: Vec<String>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    ser_categories: Vec<CategoryRef>,
    /// States after the change.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    states: Vec<ServiceState>,
    /// Without effect if true: all services are local. Nothing is notified if false.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    is_local: Option<bool>,
}

impl FilteringCriteria {
    fn want(&self, id: u64, known: &Known) -> bool {
        let category = known.category.as_ref();
        (self.ser_instance_ids.is_empty() || self.ser_instance_ids.contains(&id.to_string()))
            && (self.ser_names.is_empty() || self.ser_names.contains(&known.name))
            && (self.ser_categories.is_empty()
                || self.ser_categories.iter().any(|wanted| category == Some(&wanted.id)))
            && (self.states.is_empty() || self.states.contains(&known.state))
            && self.is_local != Some(false)
    }
}

/// The state of a service, as far as changes of it are notified.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Known {
    name: String,
    category: Option<String>,
    state: ServiceState,
    version: u64,
    /// The attributes beside the state.
    attributes: Value,
}

impl Known {
    pub(super) fn of(info: &ServiceInfo, version: u64) -> Self {
        let state = ServiceState::Active;
        Self {
            name: info.ser_name.clone(),
            category: info.ser_category.as_ref().map(|category| category.id.clone()),
            state: info.state,
            version,
            attributes: json!(ServiceInfo { state, ..info.clone() }),
        }
    }

    /// Returns the standard's name of a change from an earlier state; `None` if nothing changed.
    fn change_since(&self, before: Option<&Self>) -> Option<&'static str> {
        match before {
            None => Some("ADDED"),
            Some(before) if before.version == self.version => None,
            Some(before) if before.attributes != self.attributes => Some("ATTRIBUTES_CHANGED"),
            Some(before) if before.state != self.state => Some("STATE_CHANGED"),
            Some(_) => None,
        }
    }
}

/// The services of which a subscription was notified.
#[derive(Debug)]
pub struct Schedule {
    known: BTreeMap<u64, Known>,
}

impl Schedule {
    /// Starts with the services that there are already.
    pub(super) fn after(known: BTreeMap<u64, Known>) -> Self {
        Self { known }
    }

    /// Returns the notification of the changes since the last call, if any.
    pub(super) fn poll(
        &mut self,
        of: &AvailabilitySubscription,
        now: &BTreeMap<u64, Known>,
        href: &str,
    ) -> Option<Arc<str>> {
        let before = std::mem::replace(&mut self.known, now.clone());
        let all: BTreeSet<_> = before.keys().chain(now.keys()).copied().collect();
        let everything = FilteringCriteria::default();
        let criteria = of.wanted.filtering_criteria.as_ref().unwrap_or(&everything);
        let base = base_of(href, &of.list()).to_owned();
        let reference = |id: u64| {
            let (known, change) = match (before.get(&id), now.get(&id)) {
                (before, Some(now)) => (now.clone(), now.change_since(before)?),
                (Some(before), None) => {
                    (Known { state: ServiceState::Inactive, ..before.clone() }, "REMOVED")
                }
                (None, None) => return None,
            };
            let mut reference = json!({
                "serName": known.name, "serInstanceId": id.to_string(), "state": known.state, "changeType": change,
            });
            if change != "REMOVED" {
                reference["link"] = json!({ "href": format!("{base}/services/{id}") });
            }
            criteria.want(id, &known).then_some(reference)
        };
        let references: Vec<_> = all.into_iter().filter_map(reference).collect();
        let notification = json!({
            "notificationType": "SerAvailabilityNotification", "serviceReferences": references,
            "_links": { "subscription": { "href": href } },
        });
        (!references.is_empty()).then(|| notification.to_string().into())
    }
}

impl Wanted for Availability {
    const SERVICE: &'static str = "service registry";
    const TYPE: &'static str = "SerAvailabilityNotificationSubscription";
    const LIST: &'static str = SUBSCRIPTIONS;
    type Schedule = Schedule;

    fn check(&self, _: &str) -> Result<(), InvalidRequest> {
        let Some(criteria) = &self.filtering_criteria else { return Ok(()) };
        let sets = [
            criteria.ser_instance_ids.is_empty(),
            criteria.ser_names.is_empty(),
            criteria.ser_categories.is_empty(),
        ];
        if sets.into_iter().filter(|empty| !empty).count() > 1 {
            return InvalidRequest::malformed(
                "serInstanceIds, serNames and serCategories exclude each other",
            );
        }
        Ok(())
    }
}
