//! The API's types beside those of the graph.

use std::{path::PathBuf, time::Duration};

use axum::{
    Json,
    extract::{FromRequest, FromRequestParts, rejection},
    http::StatusCode,
    response::{IntoResponse, Response},
};
use cotorra_graph::{
    BitRate, Direction, HardwareGraph, HostAddress, Instruction, LinkContext, LinkFigures, MachineContext,
    Node, Nodes, PluginSpec, Service, Testbed, Timestamp, Vnf, VnfEvent, Walk, millis,
};
use cotorra_measurements::{Gap, Run, RunId, RunInfo};
use cotorra_mec::Problem;
use serde::{Deserialize, Deserializer, Serialize, de};

/// The most bytes of the reason in an answer.
const LONGEST_FAILURE: usize = 4096;

/// A testbed.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct TestbedBody {
    name: String,
    description: String,
    graph: HardwareGraph,
    services: Vec<Service>,
    walks: Vec<Walk>,
    plugins: Vec<PluginSpec>,
    /// Version of cotorra.
    version: &'static str,
    /// Whether it follows instructions. A replay and a view refuse them.
    steerable: bool,
}

impl TestbedBody {
    pub(super) fn new(testbed: &Testbed, steerable: bool) -> Self {
        Self {
            name: testbed.name.clone(),
            description: testbed.description.clone(),
            graph: testbed.graph.clone(),
            services: testbed.services.clone(),
            walks: testbed.walks.clone(),
            plugins: testbed.plugins.clone(),
            version: env!("CARGO_PKG_VERSION"),
            steerable,
        }
    }
}

/// A node and its addresses.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct NodeBody {
    #[serde(flatten)]
    pub(super) node: Node,
    /// Addresses of an emulated host. Those of real servers and machines are in the node.
    pub(super) address: Option<HostAddress>,
    /// Network namespace of an emulated host, for `nsenter --net=`.
    #[schema(value_type = Option<String>)]
    pub(super) namespace: Option<PathBuf>,
}

/// One direction of a link, and the age of this context. Ages of measurements count up to the context's time.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct LinkBody {
    #[serde(flatten)]
    state: LinkState,
    /// Age, milliseconds.
    age_ms: f64,
}

impl LinkBody {
    pub(super) fn new(context: LinkContext, age: Duration) -> Self {
        Self { state: context.into(), age_ms: millis::of(age) }
    }
}

/// One direction of a link, with configured, measured and available figures.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct LinkState {
    #[serde(flatten)]
    context: LinkContext,
    /// Its figures.
    figures: LinkFigures,
}

impl From<LinkContext> for LinkState {
    fn from(context: LinkContext) -> Self {
        Self { figures: context.figures(), context }
    }
}

/// The context of a node's machine, and its age.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct MachineBody {
    #[serde(flatten)]
    context: MachineContext,
    /// Age, milliseconds.
    age_ms: f64,
}

impl MachineBody {
    pub(super) fn new(context: MachineContext, age: Duration) -> Self {
        Self { context, age_ms: millis::of(age) }
    }
}

/// A test of a link's throughput.
#[derive(Debug, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct ThroughputTestBody {
    pub(super) direction: Direction,
    /// Duration of sending: 10 ms to 10 s; one second by default.
    #[serde(default)]
    pub(super) duration_ms: Option<f64>,
    /// Rate of sending, bit/s; by default a tenth above the link's configured rate, and 1 Gbit/s at most.
    #[serde(default)]
    pub(super) rate_limit_bps: Option<BitRate>,
}

/// A run in a history.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct RunBody {
    #[schema(value_type = i64)]
    run: RunId,
    /// Name of the testbed.
    name: String,
    seed: u64,
    /// Beginning, nanoseconds since 1970-01-01 UTC; 0 in virtual time.
    started_at_unix_ns: i64,
    /// End, nanoseconds since the beginning; null while the run goes on, and forever if it was killed.
    #[serde(rename = "ended_ns")]
    ended: Option<Timestamp>,
    /// Whether this API serves that run.
    this: bool,
}

impl RunBody {
    pub(super) fn new(run: Run, this: RunId) -> Self {
        let Run { id, info: RunInfo { name, seed, started_at_unix_ns, testbed: _ }, ended } = run;
        Self { run: id, name, seed, started_at_unix_ns, ended, this: id == this }
    }
}

/// Lost events: [`cotorra_measurements::Gap`] as the API shows it.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct GapBody {
    /// Time of the earliest lost event, nanoseconds since the run began.
    #[serde(rename = "from_ns")]
    from: Timestamp,
    /// Time of the latest lost event.
    #[serde(rename = "until_ns")]
    until: Timestamp,
    /// Number of lost events.
    events: u64,
}

impl From<Gap> for GapBody {
    fn from(Gap { from, until, events }: Gap) -> Self {
        Self { from, until, events }
    }
}

/// An instruction and its reason.
#[derive(Debug, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct InstructionBody {
    pub(super) instruction: Instruction,
    /// Recorded with the decision; 1024 bytes at most.
    #[serde(default, deserialize_with = "reason")]
    pub(super) reason: Option<String>,
}

/// Reads a reason of bounded length.
fn reason<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<String>, D::Error> {
    let reason = Option::<String>::deserialize(deserializer)?;
    let (bytes, longest) = (reason.as_ref().map_or(0, String::len), Instruction::LONGEST_REASON);
    if bytes > longest {
        return Err(de::Error::custom(format!("its reason has {bytes} bytes, more than {longest}")));
    }
    Ok(reason)
}

/// Reads a VNF within the bounds of [`Instruction::measure`].
fn added_vnf<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Box<Vnf>, D::Error> {
    let vnf = Box::<Vnf>::deserialize(deserializer)?;
    let instruction = Instruction::AddVnf { vnf };
    instruction.measure().map_err(de::Error::custom)?;
    match instruction {
        Instruction::AddVnf { vnf } => Ok(vnf),
        _ => unreachable!("it was just made"),
    }
}

/// A VNF to add.
#[derive(Debug, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct AddVnfBody {
    /// A command or an image. It has the rights of a confined command: `rights` other than the usual ones, and `volumes`
    /// and `devices` of its image, are refused. Its variables have values: `NAME=VALUE`.
    #[serde(deserialize_with = "added_vnf")]
    pub(super) vnf: Box<Vnf>,
    /// Recorded with the decision; 1024 bytes at most.
    #[serde(default, deserialize_with = "reason")]
    pub(super) reason: Option<String>,
}

/// A VNF that was added, and its state.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct AddedVnfBody {
    pub(super) vnf: Vnf,
    /// Present nodes of its instances.
    pub(super) node: Nodes,
    /// Its last event; null before its first instance serves.
    pub(super) last: Option<VnfEvent>,
}

/// The instruction was applied, or its application has begun.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct Done {
    pub(super) done: bool,
}

/// Reason for which a request failed.
#[derive(Debug)]
pub(super) struct Failure {
    status: StatusCode,
    key: &'static str,
    reason: String,
}

/// The body of a failure: `error` for an invalid request, `refused` for one that the testbed rejects.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[allow(dead_code, reason = "used by the OpenAPI document")]
pub(super) struct FailureBody {
    /// The mistake in the request.
    error: Option<String>,
    /// Reason for which the testbed rejects the request.
    refused: Option<String>,
}

impl Failure {
    pub(super) fn new(status: StatusCode, reason: impl Into<String>) -> Self {
        // An error may quote the request.
        let mut reason = reason.into();
        if reason.len() > LONGEST_FAILURE {
            reason.truncate(reason.floor_char_boundary(LONGEST_FAILURE));
            reason.push('…');
        }
        Self { status, key: "error", reason }
    }

    pub(super) fn bad_request(reason: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, reason)
    }

    pub(super) fn unauthorized() -> Self {
        Self::new(
            StatusCode::UNAUTHORIZED,
            "this API is its user's: use the run's socket, as `cotorra` and the clients do, sign a page in with `cotorra open`, \
             or show the token that the run has in COTORRA_TOKEN: `Authorization: Bearer …`",
        )
    }

    pub(super) fn forbidden() -> Self {
        Self::new(StatusCode::FORBIDDEN, "pages of other sites may not use this API")
    }

    /// The object belongs to another domain than the caller's.
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

    /// Returns the status and the reason.
    pub(super) fn into_parts(self) -> (StatusCode, String) {
        (self.status, self.reason)
    }

    /// Returns the failure in the form of the ETSI MEC standards.
    pub(super) fn into_problem(self) -> Response {
        Problem::new(self.status, self.reason).into_response()
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
