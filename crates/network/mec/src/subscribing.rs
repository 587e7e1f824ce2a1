//! Parts of subscriptions that all standards share: the target of notifications, links, and errors of requests.

use serde::{Deserialize, Serialize};

use crate::{callback::CallbackError, limiter::TooOften, time::TimeStamp};

/// Most subscriptions of a service, and most resources of another kind.
pub const MOST: usize = 256;

/// Target and end of a subscription.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct Notifying {
    /// URI for notifications: `http://host:port/path`, on a network that the operator allows.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(format = "uri", nullable = false)]
    pub callback_reference: Option<String>,
    /// Request a `TestNotification` first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub request_test_notification: Option<bool>,
    /// Request a WebSocket instead of a callback; takes precedence over one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub websock_notif_config: Option<WebsockNotifConfig>,
    /// Set by the service.
    #[serde(rename = "_links", default, skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub links: Option<SelfLink>,
    /// End of the subscription, at most a day ahead. Without it, the subscription ends with the run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub expiry_deadline: Option<TimeStamp>,
}

/// A WebSocket for notifications (ETSI GS MEC 009, 6.12b).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct WebsockNotifConfig {
    /// URI to connect to; set by the service.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(format = "uri", nullable = false)]
    pub websocket_uri: Option<String>,
    /// Whether to provide a WebSocket.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub request_websocket_uri: Option<bool>,
}

/// A link to a resource.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct LinkType {
    #[schema(format = "uri")]
    pub href: String,
}

impl LinkType {
    /// Returns the link to a URI.
    pub fn to(href: impl Into<String>) -> Self {
        Self { href: href.into() }
    }
}

/// The link to the resource itself.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct SelfLink {
    #[serde(rename = "self")]
    pub itself: LinkType,
}

impl SelfLink {
    /// Returns the link to a URI.
    pub fn to(href: impl Into<String>) -> Self {
        Self { itself: LinkType::to(href) }
    }
}

/// A request that cannot be met.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum InvalidRequest {
    /// The request is incomplete or contradictory.
    #[error("{0}")]
    Malformed(String),
    /// The request is valid, but the testbed lacks the data.
    #[error("{0}")]
    Unsupported(&'static str),
}

impl InvalidRequest {
    /// Returns the error of an incomplete or contradictory request.
    ///
    /// # Errors
    /// Always [`InvalidRequest::Malformed`].
    pub fn malformed<T>(what: impl Into<String>) -> Result<T, Self> {
        Err(Self::Malformed(what.into()))
    }
}

/// Parses JSON.
///
/// # Errors
/// [`InvalidRequest::Malformed`] with the place.
pub fn read<'a, T: Deserialize<'a>>(body: &'a [u8]) -> Result<T, InvalidRequest> {
    let mut json = serde_json::Deserializer::from_slice(body);
    let read = serde_path_to_error::deserialize(&mut json);
    read.or_else(|error| match error.path().to_string() {
        path if path == "." => InvalidRequest::malformed(error.inner().to_string()),
        path => InvalidRequest::malformed(format!("{path}: {}", error.inner())),
    })
    .and_then(|value| {
        json.end().map(|()| value).or_else(|error| InvalidRequest::malformed(error.to_string()))
    })
}

/// A request that is not met.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RequestError {
    /// The request is invalid.
    #[error(transparent)]
    Invalid(#[from] InvalidRequest),
    /// The callback cannot be used.
    #[error(transparent)]
    Callback(#[from] CallbackError),
    /// There is no such resource.
    #[error("there is no {what} `{id}`")]
    NotFound {
        /// Kind of the resource.
        what: &'static str,
        /// Its ID.
        id: String,
    },
    /// The resource was changed meanwhile.
    #[error("the resource has changed since the version in `If-Match`: it is {0} now")]
    Changed(String),
    /// The state of the resource does not permit it.
    #[error("{0}")]
    State(&'static str),
    /// The limit is reached.
    #[error("there are {MOST} already: delete some first")]
    Full,
    /// Changes are too frequent.
    #[error(transparent)]
    TooOften(#[from] TooOften),
}

/// A resource with its metadata.
#[derive(Debug, Clone, PartialEq)]
pub struct Resource<T> {
    pub value: T,
    pub href: String,
    /// Entity tag in quotes, which changes with the resource.
    pub etag: String,
}
