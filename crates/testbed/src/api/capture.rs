//! Captures of the packets that cross links.

use axum::{
    Extension,
    body::Body,
    extract::State,
    http::{StatusCode, header::CONTENT_TYPE},
    response::{IntoResponse as _, Response},
};
use cotorra_fabric::TapError;
use serde::Deserialize;

use super::{
    auth::Caller,
    context::Context,
    types::{Failure, Path, Query},
};
use crate::capture::{Capture, Filter, PCAPNG, WHOLE, WiretapError};

/// The packets of a capture.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Which {
    /// A filter such as `udp and host edge`, a subset of pcap-filter(7); all packets by default.
    filter: Option<String>,
    /// Bytes to keep of each packet; all by default.
    snap_bytes: Option<u32>,
}

/// Streams the packets that cross a link, or the links of a node, as a pcapng file without an end. Each packet has a comment
/// with the times at which it entered the link, was due, and was delivered. Packets for which the reader is too slow are
/// missed, and counted in the next packet. This needs the operator's token.
#[utoipa::path(get, path = "/api/v1/network/captures/{id}", tag = "network",
    params(("id" = String, Path, description = "a link or a node"), Which),
    responses((status = 200, body = String, content_type = "application/x-pcapng"),
        (status = 409, description = "refused, for the reason in the body", body = super::types::FailureBody)))]
pub(super) async fn capture(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
    Query(Which { filter, snap_bytes }): Query<Which>,
) -> Result<Response, Failure> {
    caller.operator()?;
    let wiretap = context.wiretap.ok_or_else(|| Failure::refused("a replay carries no packets"))?;
    let parse = |text: String| Filter::parse(&text, &context.testbed.graph);
    let filter = filter.map(parse).transpose().map_err(|error| Failure::bad_request(error.to_string()))?;
    let (capture, reader) = Capture::new(filter, snap_bytes.unwrap_or(WHOLE));
    wiretap(&id, reader).map_err(|error| match error {
        WiretapError::Tap(TapError::Unknown(_)) => Failure::not_found(error.to_string()),
        WiretapError::Tap(TapError::TooMany) => {
            Failure::new(StatusCode::TOO_MANY_REQUESTS, error.to_string())
        }
        WiretapError::Elsewhere(reason) => Failure::refused(reason),
    })?;
    Ok(([(CONTENT_TYPE, PCAPNG)], Body::from_stream(capture)).into_response())
}
