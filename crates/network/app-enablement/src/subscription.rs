//! Subscriptions of services that have one type of them, in a list of the platform or of an application.

use std::{borrow::Cow, fmt::Debug, sync::Arc};

use cotorra_mec::{InvalidRequest, Notifying, Subscribed, TimeStamp};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use serde_json::json;

/// A subscription to what its type is about.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Subscription<W> {
    subscription_type: String,
    /// Target and end.
    #[serde(flatten)]
    notifying: Notifying,
    /// What is notified.
    #[serde(flatten)]
    pub(crate) wanted: W,
    /// The application that the list belongs to; empty for a list of the platform.
    #[serde(skip)]
    pub(crate) application: String,
}

/// What a type of subscriptions is about.
pub trait Wanted: Clone + Debug + Serialize + DeserializeOwned + Send + Sync + 'static {
    /// Name of the service, for messages to the operator.
    const SERVICE: &'static str;
    /// Name of the type.
    const TYPE: &'static str;
    /// Path of the list, below the service's.
    const LIST: &'static str;
    /// What decides when notifications are due.
    type Schedule: Debug + Send;

    /// Checks what the types do not express. `application` is the one that the list belongs to.
    ///
    /// # Errors
    /// [`InvalidRequest`].
    fn check(&self, application: &str) -> Result<(), InvalidRequest>;

    /// Returns the notification of a subscription that is about to expire, if the standard has one.
    fn expiry(_href: &str, _at: TimeStamp) -> Option<Arc<str>> {
        None
    }
}

impl<W: Wanted> Subscribed for Subscription<W> {
    const SERVICE: &'static str = W::SERVICE;
    const LISTS: &'static [&'static str] = &[W::LIST];
    type Schedule = W::Schedule;

    fn read(list: &str, body: &[u8]) -> Result<Self, InvalidRequest> {
        let application = list.split('/').nth(1).unwrap_or_default().to_owned();
        Ok(Self { application, ..cotorra_mec::read(body)? })
    }

    fn type_name(&self) -> &'static str {
        W::TYPE
    }

    fn list(&self) -> Cow<'static, str> {
        W::LIST.replace("{appInstanceId}", &self.application).into()
    }

    fn notifying(&self) -> &Notifying {
        &self.notifying
    }

    fn notifying_mut(&mut self) -> &mut Notifying {
        &mut self.notifying
    }

    fn check(&self) -> Result<(), InvalidRequest> {
        if self.subscription_type != W::TYPE {
            return InvalidRequest::malformed(format!("subscriptionType must be {}", W::TYPE));
        }
        self.wanted.check(&self.application)
    }

    fn test(href: &str) -> Arc<str> {
        let links = json!({ "subscription": { "href": href } });
        json!({ "notificationType": "TestNotification", "_links": links }).to_string().into()
    }

    fn expiry(href: &str, at: TimeStamp) -> Option<Arc<str>> {
        W::expiry(href, at)
    }
}
