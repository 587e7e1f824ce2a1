//! Application mobility (ETSI GS MEC 021 v2.2.1), without a clock or a socket: an accepted `place` announces the target of a
//! migration, which happens once the new instance serves.

mod procedure;
mod registration;

use std::{collections::BTreeMap, sync::Arc};

use cotorra_graph::Timestamp;
use cotorra_mec::{
    Dispatch, Epoch, MOST, Machine, RequestError, Resource, Subscriptions, Target, check_unchanged, etag,
};
use serde_json::Value;

use self::procedure::{Schedule, moves};
pub use self::{procedure::MobilitySubscription, registration::RegistrationInfo};
use crate::{
    applications::{Applications, Site},
    links::links,
};

/// Path of the subscriptions.
const SUBSCRIPTIONS: &str = "subscriptions";

/// The application mobility service of a platform.
#[derive(Debug)]
pub struct Mobility {
    site: Arc<Site>,
    epoch: Epoch,
    applications: Applications,
    registered: BTreeMap<u64, (RegistrationInfo, u64)>,
    subscriptions: Subscriptions<MobilitySubscription>,
}

impl Mobility {
    /// Makes the service of a site's applications.
    pub fn new(site: Arc<Site>, epoch: Epoch) -> Self {
        Self {
            site,
            epoch,
            applications: Applications::default(),
            registered: BTreeMap::new(),
            subscriptions: Subscriptions::new(epoch),
        }
    }

    /// Returns the registered applications.
    pub fn registrations(&self) -> Vec<RegistrationInfo> {
        self.registered.iter().map(|(id, (info, _))| info.clone().with_id(*id)).collect()
    }

    /// Returns a registered application.
    ///
    /// # Errors
    /// [`RequestError::NotFound`].
    pub fn registration(&self, base: &str, id: &str) -> Result<Resource<RegistrationInfo>, RequestError> {
        let (number, (info, version)) = self.find(id)?;
        let href = format!("{base}/app_mobility_services/{number}");
        Ok(Resource { value: info.clone().with_id(number), href, etag: etag(number, *version) })
    }

    /// Registers an application.
    ///
    /// # Errors
    /// [`RequestError`]; then it is not registered.
    pub fn register(
        &mut self,
        now: Timestamp,
        base: &str,
        info: RegistrationInfo,
    ) -> Result<Resource<RegistrationInfo>, RequestError> {
        self.subscriptions.admit(now)?;
        self.check_registration(&info)?;
        if self.registered.len() >= MOST {
            return Err(RequestError::Full);
        }
        let (id, version) = (self.subscriptions.number(), self.subscriptions.number());
        self.registered.insert(id, (info, version));
        self.registration(base, &id.to_string())
    }

    /// Replaces a registration.
    ///
    /// # Errors
    /// [`RequestError`]; then nothing has changed.
    pub fn update(
        &mut self,
        now: Timestamp,
        base: &str,
        id: &str,
        if_match: Option<&str>,
        info: RegistrationInfo,
    ) -> Result<Resource<RegistrationInfo>, RequestError> {
        self.subscriptions.admit(now)?;
        let (number, (_, version)) = self.find(id)?;
        check_unchanged(if_match, number, *version)?;
        self.check_registration(&info)?;
        let version = self.subscriptions.number();
        self.registered.insert(number, (info, version));
        self.registration(base, id)
    }

    /// Ends a registration.
    ///
    /// # Errors
    /// [`RequestError`].
    pub fn deregister(
        &mut self,
        now: Timestamp,
        id: &str,
        if_match: Option<&str>,
    ) -> Result<(), RequestError> {
        self.subscriptions.admit(now)?;
        let (number, (_, version)) = self.find(id)?;
        check_unchanged(if_match, number, *version)?;
        self.registered.remove(&number);
        Ok(())
    }

    fn find(&self, id: &str) -> Result<(u64, &(RegistrationInfo, u64)), RequestError> {
        let number = id.parse().ok();
        let found = number.and_then(|number| Some((number, self.registered.get(&number)?)));
        found
            .ok_or_else(|| RequestError::NotFound { what: "application mobility service", id: id.to_owned() })
    }

    fn check_registration(&self, info: &RegistrationInfo) -> Result<(), RequestError> {
        self.applications.find(info.application()?).map(drop)
    }

    /// Returns links to the subscriptions.
    pub fn links(&self, base: &str) -> Value {
        links(&self.subscriptions, base, SUBSCRIPTIONS, "subscription", |_| true)
    }
}

impl Machine for Mobility {
    type Site = Site;
    type Survey = Applications;
    type Subscription = MobilitySubscription;

    fn site(&self) -> &Arc<Site> {
        &self.site
    }

    /// Registrations end with their application.
    fn observe(&mut self, applications: Applications) {
        let is_there =
            |info: &RegistrationInfo| info.application().is_ok_and(|id| applications.find(id).is_ok());
        self.registered.retain(|_, (info, _)| is_there(info));
        self.applications = applications;
    }

    fn check(&self, subscription: &MobilitySubscription) -> Result<(), RequestError> {
        subscription.wanted.application().map_or(Ok(()), |id| self.applications.find(id).map(drop))
    }

    fn schedule(&self, _: Timestamp, _: &MobilitySubscription) -> Schedule {
        Schedule::after(moves(&self.applications))
    }

    fn subscriptions(&mut self) -> &mut Subscriptions<MobilitySubscription> {
        &mut self.subscriptions
    }

    fn poll(&mut self, now: Timestamp) -> Vec<Dispatch<Target>> {
        let (site, applications) = (&self.site, &self.applications);
        let at = self.epoch.at(applications.at);
        self.subscriptions.poll(now, |subscription, schedule, href| {
            let due = schedule.poll(&subscription.wanted, site, moves(applications));
            due.into_iter().map(move |moved| moved.notification(at, href)).collect::<Vec<_>>()
        })
    }
}

#[cfg(test)]
mod tests;
