//! Subscriptions to migrations of applications (ETSI GS MEC 021 v2.2.1, clauses 7.3.2 and 7.4.2).

use std::{
    collections::{BTreeMap, BTreeSet},
    net::Ipv4Addr,
    sync::Arc,
};

use cotorra_graph::{NodeId, Nodes, VnfId};
use cotorra_mec::{InvalidRequest, TimeStamp};
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::{
    SUBSCRIPTIONS,
    registration::{AssociateId, AssociateType},
};
use crate::{
    applications::{Applications, Site},
    subscription::{Subscription, Wanted},
};

/// The standard's `mobilityStatus`.
const TRIGGERED: u8 = 1;
const COMPLETED: u8 = 2;
const FAILED: u8 = 3;

/// A subscription to migrations.
pub type MobilitySubscription = Subscription<Migrations>;

/// Migrations of applications.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Migrations {
    filter_criteria: FilterCriteria,
}

/// The migrations to notify.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
struct FilterCriteria {
    /// Without one, all applications of the platform.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    app_instance_id: Option<String>,
    /// Devices that the applications serve; all without any.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    associate_id: Vec<AssociateId>,
    #[serde(default = "triggered")]
    mobility_status: Vec<u8>,
}

fn triggered() -> Vec<u8> {
    vec![TRIGGERED]
}

impl Migrations {
    /// Returns the application that it is about; `None` for all.
    pub(super) fn application(&self) -> Option<&str> {
        self.filter_criteria.app_instance_id.as_deref()
    }

    fn wants(&self, moved: &Moved) -> bool {
        let criteria = &self.filter_criteria;
        let devices = &criteria.associate_id;
        self.application().is_none_or(|id| moved.application == *id)
            && (devices.is_empty() || moved.device.as_ref().is_some_and(|device| devices.contains(device)))
            && criteria.mobility_status.contains(&moved.status)
    }
}

/// Where an application is, and where it is moving to.
type Move = (Nodes, Option<Nodes>);

/// Returns where applications are and move to.
pub(super) fn moves(applications: &Applications) -> BTreeMap<VnfId, Move> {
    applications.iter().map(|(id, one)| (id.clone(), (one.nodes.clone(), one.target.clone()))).collect()
}

/// A step of a migration.
#[derive(Debug)]
pub(super) struct Moved {
    application: VnfId,
    status: u8,
    device: Option<AssociateId>,
    /// Address and port of the target; `None` if it is not emulated.
    target: Option<(Ipv4Addr, u16)>,
}

impl Moved {
    /// Returns its notification.
    pub(super) fn notification(&self, at: TimeStamp, href: &str) -> Arc<str> {
        let mut target = json!({ "appInstanceId": self.application });
        if let Some((host, port)) = self.target {
            target["commInterface"] = json!({ "ipAddresses": [{ "host": host, "port": port }] });
        }
        let devices: Vec<_> = self.device.iter().collect();
        json!({
            "notificationType": "MobilityProcedureNotification", "timeStamp": at, "associateId": devices,
            "mobilityStatus": self.status, "targetAppInfo": target, "_links": { "subscription": { "href": href } },
        })
        .to_string()
        .into()
    }
}

/// The migrations that a subscription knows of.
#[derive(Debug)]
pub struct Schedule {
    known: BTreeMap<VnfId, Move>,
}

impl Schedule {
    /// Starts with the migrations that go on already.
    pub(super) fn after(known: BTreeMap<VnfId, Move>) -> Self {
        Self { known }
    }

    /// Returns the wanted steps since the last call.
    pub(super) fn poll(&mut self, of: &Migrations, site: &Site, now: BTreeMap<VnfId, Move>) -> Vec<Moved> {
        let before = std::mem::replace(&mut self.known, now);
        let step = |application: &VnfId, status: u8, node: &NodeId| Moved {
            application: application.clone(),
            status,
            device: site
                .served(application)
                .map(|address| AssociateId { kind: AssociateType::Ipv4, value: address.to_string() }),
            target: site.endpoint(application, node),
        };
        let mut steps = Vec::new();
        for (application, (nodes, target)) in &self.known {
            let Some((was_on, was_target)) = before.get(application) else { continue };
            let outcome = was_target.as_ref().filter(|was| target.as_ref() != Some(*was)).map(|was| {
                let status = if was == nodes { COMPLETED } else { FAILED };
                (status, was)
            });
            // A migration that began and ended since the last call is announced, too.
            let at_once = (was_target.is_none() && was_on != nodes).then_some(nodes);
            let begun = target.as_ref().filter(|target| was_target.as_ref() != Some(*target)).or(at_once);
            let done = at_once.map(|nodes| (COMPLETED, nodes));
            for (status, to) in outcome.into_iter().chain(begun.map(|target| (TRIGGERED, target))).chain(done)
            {
                let new: BTreeSet<_> = to.all().iter().filter(|node| !was_on.all().contains(node)).collect();
                steps.extend(new.into_iter().map(|node| step(application, status, node)));
            }
        }
        steps.retain(|moved| of.wants(moved));
        steps
    }
}

impl Wanted for Migrations {
    const SERVICE: &'static str = "application mobility";
    const TYPE: &'static str = "MobilityProcedureSubscription";
    const LIST: &'static str = SUBSCRIPTIONS;
    type Schedule = Schedule;

    fn check(&self, _: &str) -> Result<(), InvalidRequest> {
        if self.filter_criteria.mobility_status.iter().any(|status| !(TRIGGERED..=FAILED).contains(status)) {
            return InvalidRequest::malformed("mobilityStatus is 1, 2 or 3");
        }
        Ok(())
    }

    fn expiry(href: &str, at: TimeStamp) -> Option<Arc<str>> {
        let notification = json!({
            "notificationType": "ExpiryNotification", "_links": { "subscription": { "href": href } },
            "expiryDeadline": at,
        });
        Some(notification.to_string().into())
    }
}
