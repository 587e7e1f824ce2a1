//! Subscriptions to the termination of an application (ETSI GS MEC 011 v3.1.1, clauses 7.1.3.2 and 7.1.4.2).

use std::{borrow::Cow, sync::Arc};

use cotorra_mec::{InvalidRequest, Notifying, Subscribed};
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::links::{SUBSCRIPTIONS, application_of, base_of, check_type, subscriptions_of, test};

/// Name of the type.
const TYPE: &str = "AppTerminationNotificationSubscription";

/// Seconds from the notification until a VNF is killed: half a second, rounded up to the standard's integer.
const GRACE: u32 = 1;

/// A subscription of an application to its termination.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct TerminationSubscription {
    subscription_type: String,
    /// Target and end.
    #[serde(flatten)]
    notifying: Notifying,
    app_instance_id: String,
    /// The subscriber.
    #[serde(skip)]
    pub(super) application: String,
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

impl Subscribed for TerminationSubscription {
    const SERVICE: &'static str = "application support";
    const LISTS: &'static [&'static str] = &[SUBSCRIPTIONS];
    type Schedule = Schedule;

    fn read(list: &str, body: &[u8]) -> Result<Self, InvalidRequest> {
        Ok(Self { application: application_of(list), ..cotorra_mec::read(body)? })
    }

    fn type_name(&self) -> &'static str {
        TYPE
    }

    fn list(&self) -> Cow<'static, str> {
        subscriptions_of(&self.application).into()
    }

    fn notifying(&self) -> &Notifying {
        &self.notifying
    }

    fn notifying_mut(&mut self) -> &mut Notifying {
        &mut self.notifying
    }

    fn check(&self) -> Result<(), InvalidRequest> {
        check_type(&self.subscription_type, TYPE)?;
        if self.app_instance_id != self.application {
            return InvalidRequest::malformed("appInstanceId must be that of the path");
        }
        Ok(())
    }

    fn test(href: &str) -> Arc<str> {
        test(href)
    }
}
