//! Subscriptions to the termination of an application (ETSI GS MEC 011 v3.1.1, clauses 7.1.3.2 and 7.1.4.2).

use std::sync::Arc;

use cotorra_mec::{InvalidRequest, Subscribed as _};
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::{
    links::{SUBSCRIPTIONS, base_of},
    subscription::{Subscription, Wanted},
};

/// Seconds from the notification until a VNF is killed: half a second, rounded up to the standard's integer.
const GRACE: u32 = 1;

/// A subscription of an application to its termination.
pub type TerminationSubscription = Subscription<Termination>;

/// The termination of the subscriber.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Termination {
    app_instance_id: String,
}

/// Whether the termination was notified.
#[derive(Debug, Default)]
pub struct Schedule {
    is_over: bool,
}

impl Schedule {
    /// Returns the notification of the application's end, once.
    pub(super) fn poll(
        &mut self,
        of: &TerminationSubscription,
        has_ended: bool,
        href: &str,
    ) -> Option<Arc<str>> {
        let was_over = std::mem::replace(&mut self.is_over, has_ended);
        let base = base_of(href, &of.list()).to_owned();
        let confirm = format!("{base}/applications/{}/confirm_termination", of.application);
        let notification = json!({
            "notificationType": "AppTerminationNotification", "operationAction": "TERMINATING",
            "maxGracefulTimeout": GRACE,
            "_links": { "subscription": { "href": href }, "confirmTermination": { "href": confirm } },
        });
        (has_ended && !was_over).then(|| notification.to_string().into())
    }
}

impl Wanted for Termination {
    const SERVICE: &'static str = "application support";
    const TYPE: &'static str = "AppTerminationNotificationSubscription";
    const LIST: &'static str = SUBSCRIPTIONS;
    type Schedule = Schedule;

    fn check(&self, application: &str) -> Result<(), InvalidRequest> {
        if self.app_instance_id != application {
            return InvalidRequest::malformed("appInstanceId must be that of the path");
        }
        Ok(())
    }
}
