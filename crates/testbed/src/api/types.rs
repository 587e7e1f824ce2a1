//! What the API takes and gives beside the types of the graph.

use std::{path::PathBuf, time::Duration};

use axum::{
    Json,
    extract::{FromRequest, FromRequestParts, rejection},
    http::StatusCode,
    response::{IntoResponse, Response},
};
use cotorra_graph::{
    BitRate, Direction, HardwareGraph, HostAddress, Instruction, LinkContext, Node, PluginSpec, Service,
    Testbed, Timestamp, Walk,
};
use cotorra_measurements::{Gap, Run, RunId, RunInfo};
use serde::{Deserialize, Serialize};

/// A testbed.
#[derive(Debug, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub(super) struct TestbedBody {
    name: String,
    description: String,
    graph: HardwareGraph,
    services: Vec<Service>,
    walks: Vec<Walk>,
    plugins: Vec<PluginSpec>,
    /// Events that came after this are newer than what other paths say.
    version: &'static str,
}

impl From<&Testbed> for TestbedBody {
    fn from(testbed: &Testbed) -> Self {
        Self {
            name: testbed.name.clone(),
            description: testbed.description.clone(),
            graph: testbed.graph.clone(),
            services: testbed.services.clone(),
            walks: testbed.walks.clone(),
            plugins: testbed.plugins.clone(),
            version: env!("CARGO_PKG_VERSION"),
        }
    }
}

/// A node and how to reach it.
#[derive(Debug, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub(super) struct NodeBody {
    #[serde(flatten)]
    pub(super) node: Node,
    /// Its addresses; none for a switch and a real machine.
    pub(super) address: Option<HostAddress>,
    /// Its network namespace, for `nsenter --net=`; none for a switch and a real machine.
    #[cfg_attr(feature = "openapi", schema(value_type = Option<String>))]
    pub(super) namespace: Option<PathBuf>,
}

/// One direction of a link, and how long ago it was told so. Ages of what was measured actively count up to then.
#[derive(Debug, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub(super) struct LinkBody {
    #[serde(flatten)]
    context: LinkContext,
    /// Milliseconds.
    age_ms: f64,
}

impl LinkBody {
    pub(super) fn new(context: LinkContext, age: Duration) -> Self {
        Self { context, age_ms: age.as_secs_f64() * 1e3 }
    }
}

/// A test of a link's throughput.
#[derive(Debug, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub(super) struct ThroughputTestBody {
    /// Which direction.
    pub(super) direction: Direction,
    /// How long packets are sent: 10 ms to 10 s; a second without it.
    #[serde(default)]
    pub(super) duration_ms: Option<f64>,
    /// How fast, bit/s; without it a tenth faster than the link is asked to be, and 1 Gbit/s at most.
    #[serde(default)]
    pub(super) rate_limit_bps: Option<BitRate>,
}

/// A run in a history.
#[derive(Debug, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub(super) struct RunBody {
    #[cfg_attr(feature = "openapi", schema(value_type = i64))]
    run: RunId,
    /// The testbed's.
    name: String,
    seed: u64,
    /// When it began, nanoseconds since 1970-01-01 UTC; 0 in virtual time.
    started_at_unix_ns: i64,
    /// When it ended, nanoseconds since it began; null while it goes on, and for good when it was killed.
    #[serde(rename = "ended_ns")]
    ended: Option<Timestamp>,
    /// Whether it is the one that this API is of.
    this: bool,
}

impl RunBody {
    pub(super) fn new(run: Run, this: RunId) -> Self {
        let Run { id, info: RunInfo { name, seed, started_at_unix_ns, testbed: _ }, ended } = run;
        Self { run: id, name, seed, started_at_unix_ns, ended, this: id == this }
    }
}

/// Events that were lost: [`cotorra_measurements::Gap`] as it is shown.
#[derive(Debug, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub(super) struct GapBody {
    /// Time of the earliest that is missing, nanoseconds since the run began.
    #[serde(rename = "from_ns")]
    from: Timestamp,
    /// Time of the latest that is missing.
    #[serde(rename = "until_ns")]
    until: Timestamp,
    /// How many are.
    events: u64,
}

impl From<Gap> for GapBody {
    fn from(Gap { from, until, events }: Gap) -> Self {
        Self { from, until, events }
    }
}

/// An instruction and why it is given.
#[derive(Debug, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub(super) struct InstructionBody {
    pub(super) instruction: Instruction,
    /// Kept with the decision.
    #[serde(default)]
    pub(super) reason: Option<String>,
}

/// An instruction was done, or its doing began.
#[derive(Debug, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub(super) struct Done {
    pub(super) done: bool,
}

/// Why something was not done.
#[derive(Debug)]
pub(super) struct Failure {
    status: StatusCode,
    key: &'static str,
    reason: String,
}

/// The body of a failure: `error` for a request that cannot be, `refused` for one that the testbed does not do.
#[cfg(feature = "openapi")]
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct FailureBody {
    /// What is wrong with the request.
    error: Option<String>,
    /// Why the testbed does not do it.
    refused: Option<String>,
}

impl Failure {
    pub(super) fn new(status: StatusCode, reason: impl Into<String>) -> Self {
        Self { status, key: "error", reason: reason.into() }
    }

    pub(super) fn bad_request(reason: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, reason)
    }

    pub(super) fn unauthorized() -> Self {
        Self::new(StatusCode::UNAUTHORIZED, "this API needs its token: `Authorization: Bearer …`")
    }

    pub(super) fn forbidden() -> Self {
        Self::new(StatusCode::FORBIDDEN, "web pages may not use this API; run it with a token to allow that")
    }

    /// It is of another domain than the caller's.
    pub(super) fn not_own(reason: impl Into<String>) -> Self {
        Self::new(StatusCode::FORBIDDEN, reason)
    }

    pub(super) fn not_found(reason: impl Into<String>) -> Self {
        Self::new(StatusCode::NOT_FOUND, reason)
    }

    pub(super) fn unavailable(reason: impl Into<String>) -> Self {
        Self::new(StatusCode::SERVICE_UNAVAILABLE, reason)
    }

    pub(super) fn ended() -> Self {
        Self::unavailable("the run has ended")
    }

    /// As the standards of ETSI MEC tell it.
    pub(super) fn into_problem(self) -> Response {
        cotorra_wais::http::problem(self.status, self.reason)
    }

    pub(super) fn refused(reason: impl Into<String>) -> Self {
        Self { key: "refused", ..Self::new(StatusCode::CONFLICT, reason) }
    }
}

impl IntoResponse for Failure {
    fn into_response(self) -> Response {
        let body = serde_json::Map::from_iter([(self.key.to_owned(), self.reason.into())]);
        (self.status, Json(body)).into_response()
    }
}

impl From<rejection::JsonRejection> for Failure {
    fn from(rejection: rejection::JsonRejection) -> Self {
        Self::new(rejection.status(), rejection.body_text())
    }
}

impl From<rejection::QueryRejection> for Failure {
    fn from(rejection: rejection::QueryRejection) -> Self {
        Self::new(rejection.status(), rejection.body_text())
    }
}

impl From<rejection::PathRejection> for Failure {
    fn from(rejection: rejection::PathRejection) -> Self {
        Self::new(rejection.status(), rejection.body_text())
    }
}

/// [`axum::Json`] whose rejection is a [`Failure`].
#[derive(FromRequest)]
#[from_request(via(axum::Json), rejection(Failure))]
pub(super) struct Body<T>(pub(super) T);

/// [`axum::extract::Query`] whose rejection is a [`Failure`].
#[derive(FromRequestParts)]
#[from_request(via(axum::extract::Query), rejection(Failure))]
pub(super) struct Query<T>(pub(super) T);

/// [`axum::extract::Path`] whose rejection is a [`Failure`].
#[derive(FromRequestParts)]
#[from_request(via(axum::extract::Path), rejection(Failure))]
pub(super) struct Path<T>(pub(super) T);
