//! The registry of services (ETSI GS MEC 011 v3.1.1, clause 8), without a clock or a socket: those of the platform, and those
//! that applications register.

mod availability;
mod info;
mod query;

use std::{collections::BTreeMap, sync::Arc};

use cotorra_graph::{Timestamp, VnfId};
use cotorra_mec::{
    Dispatch, Epoch, MOST, Machine, RequestError, Resource, Subscriptions, Target, check_unchanged, etag,
};
use serde_json::Value;

pub use self::{availability::AvailabilitySubscription, info::ServiceInfo, query::ServiceQuery};
use self::{
    availability::{Known, Schedule},
    info::{LinksOfService, ServiceState},
};
use crate::{
    applications::{Applications, Site},
    links::{links, subscriptions_of},
};

/// A service of the platform.
#[derive(Debug, Clone)]
pub struct Provided {
    /// Its identifier and name.
    pub name: &'static str,
    /// The standard that it follows, such as `MEC 013`.
    pub standard: &'static str,
    /// Version of the standard.
    pub version: &'static str,
    /// Its path on this server.
    pub path: String,
}

/// The registry of a platform.
#[derive(Debug)]
pub struct Registry {
    site: Arc<Site>,
    applications: Applications,
    provided: Vec<Provided>,
    registered: BTreeMap<u64, Registered>,
    subscriptions: Subscriptions<AvailabilitySubscription>,
}

#[derive(Debug)]
struct Registered {
    application: VnfId,
    info: ServiceInfo,
    version: u64,
}

impl Registry {
    /// Makes the registry of a platform with these services of its own.
    pub fn new(site: Arc<Site>, epoch: Epoch, provided: Vec<Provided>) -> Self {
        Self {
            site,
            applications: Applications::default(),
            provided,
            registered: BTreeMap::new(),
            subscriptions: Subscriptions::new(epoch),
        }
    }

    /// Returns the services that a query wants. `base` is the URI under which the consumer sees the registry.
    pub fn services(&self, base: &str, query: &ServiceQuery) -> Vec<ServiceInfo> {
        let provided = self.provided.iter().map(|one| provided(base, one));
        let registered = self.registered.iter().map(|(id, one)| one.shown(*id, base));
        provided.chain(registered).filter(|service| query.wants(service)).collect()
    }

    /// Returns a service.
    ///
    /// # Errors
    /// [`RequestError::NotFound`].
    pub fn service(&self, base: &str, id: &str) -> Result<Resource<ServiceInfo>, RequestError> {
        if let Some(one) = self.provided.iter().find(|one| one.name == id) {
            let value = provided(base, one);
            return Ok(Resource { href: format!("{base}/services/{id}"), value, etag: etag(0, 0) });
        }
        let (number, found) = self.find(id)?;
        Ok(found.resource(number, base))
    }

    /// Returns the services of an application that a query wants.
    ///
    /// # Errors
    /// [`RequestError::NotFound`] if there is no such application.
    pub fn services_of(
        &self,
        base: &str,
        application: &str,
        query: &ServiceQuery,
    ) -> Result<Vec<ServiceInfo>, RequestError> {
        let application = self.applications.find(application)?;
        let base = below(base, application);
        let own = self.registered.iter().filter(|(_, one)| one.application == *application);
        let own = own.map(|(id, one)| one.shown(*id, &base));
        Ok(own.filter(|service| query.wants(service)).collect())
    }

    /// Returns a service of an application.
    ///
    /// # Errors
    /// [`RequestError::NotFound`].
    pub fn service_of(
        &self,
        base: &str,
        application: &str,
        id: &str,
    ) -> Result<Resource<ServiceInfo>, RequestError> {
        let (application, number, found) = self.find_of(application, id)?;
        Ok(found.resource(number, &below(base, application)))
    }

    /// Registers a service of an application.
    ///
    /// # Errors
    /// [`RequestError`]; then there is none.
    pub fn register(
        &mut self,
        now: Timestamp,
        base: &str,
        application: &str,
        info: ServiceInfo,
    ) -> Result<Resource<ServiceInfo>, RequestError> {
        self.subscriptions.admit(now)?;
        let application = self.applications.find(application)?.clone();
        info.check()?;
        if self.registered.len() >= MOST {
            return Err(RequestError::Full);
        }
        let (id, version) = (self.subscriptions.number(), self.subscriptions.number());
        let registered = Registered { application, info, version };
        let resource = registered.resource(id, &below(base, &registered.application));
        self.registered.insert(id, registered);
        Ok(resource)
    }

    /// Replaces what is registered of a service.
    ///
    /// # Errors
    /// [`RequestError`]; then nothing has changed.
    pub fn update(
        &mut self,
        now: Timestamp,
        base: &str,
        (application, id): (&str, &str),
        if_match: Option<&str>,
        info: ServiceInfo,
    ) -> Result<Resource<ServiceInfo>, RequestError> {
        self.subscriptions.admit(now)?;
        let (application, number, found) = self.find_of(application, id)?;
        let application = application.clone();
        info.check()?;
        check_unchanged(if_match, number, found.version)?;
        let version = self.subscriptions.number();
        let registered = Registered { application, info, version };
        let resource = registered.resource(number, &below(base, &registered.application));
        self.registered.insert(number, registered);
        Ok(resource)
    }

    /// Removes a service of an application.
    ///
    /// # Errors
    /// [`RequestError`].
    pub fn deregister(
        &mut self,
        now: Timestamp,
        (application, id): (&str, &str),
        if_match: Option<&str>,
    ) -> Result<(), RequestError> {
        self.subscriptions.admit(now)?;
        let (_, number, found) = self.find_of(application, id)?;
        check_unchanged(if_match, number, found.version)?;
        self.registered.remove(&number);
        Ok(())
    }

    fn find(&self, id: &str) -> Result<(u64, &Registered), RequestError> {
        let number = id.parse().ok();
        let found = number.and_then(|number| Some((number, self.registered.get(&number)?)));
        found.ok_or_else(|| RequestError::NotFound { what: "service", id: id.to_owned() })
    }

    fn find_of(&self, application: &str, id: &str) -> Result<(&VnfId, u64, &Registered), RequestError> {
        let application = self.applications.find(application)?;
        let (number, found) = self.find(id)?;
        if found.application != *application {
            return Err(RequestError::NotFound { what: "service", id: id.to_owned() });
        }
        Ok((application, number, found))
    }

    /// Returns links to the subscriptions of an application.
    ///
    /// # Errors
    /// [`RequestError::NotFound`] if there is no such application.
    pub fn links(&self, base: &str, application: &str) -> Result<Value, RequestError> {
        let application = self.applications.find(application)?;
        let list = subscriptions_of(application.as_str());
        Ok(links(&self.subscriptions, base, &list, "subscriptions", |_| true))
    }

    /// Returns the state of each service that applications registered.
    fn known(&self) -> BTreeMap<u64, Known> {
        let known = |(id, one): (&u64, &Registered)| (*id, Known::of(&one.info, one.version));
        self.registered.iter().map(known).collect()
    }
}

/// Returns the URI below which an application's own resources are.
fn below(base: &str, application: &VnfId) -> String {
    format!("{base}/applications/{application}")
}

/// Returns what is known of a service of the platform.
fn provided(base: &str, of: &Provided) -> ServiceInfo {
    let href = format!("{base}/services/{}", of.name);
    ServiceInfo::of_platform(of, cotorra_mec::origin(base), LinksOfService::to(href))
}

impl Registered {
    fn shown(&self, id: u64, base: &str) -> ServiceInfo {
        self.info.clone().registered(id, LinksOfService::to(format!("{base}/services/{id}")))
    }

    fn resource(&self, id: u64, base: &str) -> Resource<ServiceInfo> {
        let (value, href) = (self.shown(id, base), format!("{base}/services/{id}"));
        Resource { value, href, etag: etag(id, self.version) }
    }
}

impl Machine for Registry {
    type Site = Site;
    type Survey = Applications;
    type Subscription = AvailabilitySubscription;

    fn site(&self) -> &Arc<Site> {
        &self.site
    }

    /// Services end with their application.
    fn observe(&mut self, applications: Applications) {
        self.registered.retain(|_, one| applications.has(&one.application));
        self.applications = applications;
    }

    fn check(&self, subscription: &AvailabilitySubscription) -> Result<(), RequestError> {
        self.applications.find(&subscription.application).map(drop)
    }

    fn schedule(&self, _: Timestamp, _: &AvailabilitySubscription) -> Schedule {
        Schedule::after(self.known())
    }

    fn subscriptions(&mut self) -> &mut Subscriptions<AvailabilitySubscription> {
        &mut self.subscriptions
    }

    fn poll(&mut self, now: Timestamp) -> Vec<Dispatch<Target>> {
        let known = self.known();
        self.subscriptions.poll(now, |subscription, schedule, href| schedule.poll(subscription, &known, href))
    }
}

#[cfg(test)]
mod tests;
