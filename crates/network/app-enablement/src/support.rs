//! Support of applications from their start to their end (ETSI GS MEC 011 v3.1.1, clause 7), without a clock or a socket.

mod termination;

use std::{
    collections::{BTreeMap, VecDeque},
    sync::Arc,
};

use cotorra_graph::{Timestamp, VnfId};
use cotorra_mec::{Dispatch, Epoch, InvalidRequest, MOST, Machine, RequestError, Subscriptions, Target};
use serde::Deserialize;
use serde_json::{Value, json};

use self::termination::Schedule;
pub use self::termination::TerminationSubscription;
use crate::{
    applications::{Applications, Site},
    links::{links, subscriptions_of},
};

/// The support of a platform's applications.
#[derive(Debug)]
pub struct Support {
    site: Arc<Site>,
    epoch: Epoch,
    applications: Applications,
    /// When each application confirmed that it is ready.
    ready: BTreeMap<VnfId, Timestamp>,
    /// Applications that were removed, the last ones.
    ended: VecDeque<VnfId>,
    subscriptions: Subscriptions<TerminationSubscription>,
}

/// A confirmation of an application (7.1.4.3, 7.1.4.4).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Confirmation {
    /// It is ready.
    Ready,
    /// It may be terminated or stopped.
    Termination,
}

#[derive(Deserialize)]
struct ReadyConfirmation {
    indication: Indication,
}

#[derive(Deserialize)]
#[serde(rename_all = "UPPERCASE")]
enum Indication {
    Ready,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct TerminationConfirmation {
    operation_action: OperationAction,
}

#[derive(PartialEq, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
enum OperationAction {
    Stopping,
    Terminating,
}

/// Rules for an application's traffic and names, which its descriptor would have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rules {
    Traffic,
    Dns,
}

impl Rules {
    fn what(self) -> &'static str {
        match self {
            Self::Traffic => "traffic rule",
            Self::Dns => "DNS rule",
        }
    }
}

impl Support {
    /// Makes the support of a site's applications.
    pub fn new(site: Arc<Site>, epoch: Epoch) -> Self {
        Self {
            site,
            epoch,
            applications: Applications::default(),
            ready: BTreeMap::new(),
            ended: VecDeque::new(),
            subscriptions: Subscriptions::new(epoch),
        }
    }

    /// Records a confirmation of an application.
    ///
    /// # Errors
    /// [`RequestError`] if there is no such application, the body is none, or nothing terminates the application.
    pub fn confirm(
        &mut self,
        now: Timestamp,
        application: &str,
        what: Confirmation,
        body: &[u8],
    ) -> Result<(), RequestError> {
        self.subscriptions.admit(now)?;
        match what {
            Confirmation::Ready => {
                let application = self.applications.find(application)?.clone();
                let ReadyConfirmation { indication: Indication::Ready } = cotorra_mec::read(body)?;
                self.ready.entry(application).or_insert(now);
                Ok(())
            }
            Confirmation::Termination => {
                let has_ended = self.ended.iter().any(|ended| *ended == *application);
                if !has_ended {
                    self.applications.find(application)?;
                }
                let TerminationConfirmation { operation_action } = cotorra_mec::read(body)?;
                if has_ended && operation_action == OperationAction::Terminating {
                    return Ok(());
                }
                Err(RequestError::State("nothing terminates or stops the application"))
            }
        }
    }

    /// Returns the applications, and when each confirmed that it is ready.
    pub fn readiness(&self) -> impl Iterator<Item = (&VnfId, Option<Timestamp>)> {
        self.applications.iter().map(|(application, _)| (application, self.ready.get(application).copied()))
    }

    /// Returns TimingCaps (7.1.2.4). The platform has no time servers.
    pub fn timing_caps(&self, now: Timestamp) -> Value {
        json!({ "timeStamp": self.epoch.at(now), "ntpServers": [], "ptpMasters": [] })
    }

    /// Returns CurrentTime (7.1.2.5): that of the run, which follows the machine's clock or is virtual.
    pub fn current_time(&self, now: Timestamp) -> Value {
        let mut time = json!(self.epoch.at(now));
        time["timeSourceStatus"] = "NONTRACEABLE".into();
        time
    }

    /// Returns AppInfo (7.1.2.6) of an application.
    ///
    /// # Errors
    /// [`RequestError::NotFound`].
    pub fn registration(&self, application: &str) -> Result<Value, RequestError> {
        let application = self.applications.find(application)?;
        Ok(json!({ "appName": application, "appInstanceId": application, "isInsByMec": true }))
    }

    /// Rejects a registration: the testbed starts all of its applications itself.
    pub fn register(&self) -> RequestError {
        InvalidRequest::Unsupported(
            "the applications are the VNFs of the testbed: add one by an instruction or by app_lcm",
        )
        .into()
    }

    /// Returns the rules of an application: none, because no descriptor can have any.
    ///
    /// # Errors
    /// [`RequestError::NotFound`] if there is no such application.
    pub fn rules(&self, application: &str) -> Result<[Value; 0], RequestError> {
        self.applications.find(application).map(|_| [])
    }

    /// Returns a rule of an application, which has none.
    ///
    /// # Errors
    /// Always [`RequestError::NotFound`].
    pub fn rule(&self, application: &str, of: Rules, id: &str) -> Result<Value, RequestError> {
        self.applications.find(application)?;
        Err(RequestError::NotFound { what: of.what(), id: id.to_owned() })
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
}

impl Machine for Support {
    type Site = Site;
    type Survey = Applications;
    type Subscription = TerminationSubscription;

    fn site(&self) -> &Arc<Site> {
        &self.site
    }

    fn observe(&mut self, applications: Applications) {
        self.ready.retain(|application, _| applications.has(application));
        self.ended.retain(|application| !applications.has(application));
        let gone = self.applications.iter().map(|(application, _)| application);
        self.ended.extend(gone.filter(|application| !applications.has(application)).cloned());
        let surplus = self.ended.len().saturating_sub(MOST);
        self.ended.drain(..surplus);
        self.applications = applications;
    }

    fn check(&self, subscription: &TerminationSubscription) -> Result<(), RequestError> {
        self.applications.find(&subscription.application).map(drop)
    }

    fn schedule(&self, _: Timestamp, _: &TerminationSubscription) -> Schedule {
        Schedule::default()
    }

    fn subscriptions(&mut self) -> &mut Subscriptions<TerminationSubscription> {
        &mut self.subscriptions
    }

    fn poll(&mut self, now: Timestamp) -> Vec<Dispatch<Target>> {
        let applications = &self.applications;
        self.subscriptions.poll(now, |subscription, schedule, href| {
            schedule.poll(subscription, applications.find(&subscription.application).is_err(), href)
        })
    }
}

#[cfg(test)]
mod tests;
