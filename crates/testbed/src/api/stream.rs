//! What happens, as it happens: server-sent events.

use std::{convert::Infallible, sync::Arc};

use axum::{
    extract::State,
    response::sse::{Event as SseEvent, KeepAlive, Sse},
};
use cotorra_graph::Stamped;
use cotorra_measurements::Kind;
use serde::Deserialize;
use tokio_stream::{
    Stream, StreamExt,
    wrappers::{BroadcastStream, errors::BroadcastStreamRecvError},
};

use super::{
    Context,
    types::{Failure, FailureBody, Query},
};

/// Which events.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Which {
    /// Kinds of events, with commas between; all if it is left out.
    kinds: Option<String>,
}

/// Events as they happen. A reader that is too slow loses the oldest, is told how many by an event named `missed`, and
/// slows nobody.
#[utoipa::path(get, path = "/api/v1/events", tag = "events", params(Which),
    responses((status = 200, body = String, content_type = "text/event-stream",
        description = "each `data:` is a Stamped event"), (status = 400, body = FailureBody)))]
pub(super) async fn events(
    State(context): State<Context>,
    Query(which): Query<Which>,
) -> Result<Sse<impl Stream<Item = Result<SseEvent, Infallible>>>, Failure> {
    let kinds = which.kinds.as_deref().map(parse_kinds).transpose()?;
    let wanted =
        move |event: &Stamped| kinds.as_ref().is_none_or(|kinds| kinds.contains(&Kind::of(&event.event)));
    let stream =
        BroadcastStream::new(context.events.subscribe()).filter_map(move |received| match received {
            Ok(event) if wanted(&event) => Some(Ok(encode(&event))),
            Ok(_) => None,
            Err(BroadcastStreamRecvError::Lagged(missed)) => {
                Some(Ok(SseEvent::default().event("missed").data(missed.to_string())))
            }
        });
    Ok(Sse::new(stream).keep_alive(KeepAlive::default()))
}

/// Names of kinds with commas between.
pub(super) fn parse_kinds(names: &str) -> Result<Vec<Kind>, Failure> {
    let parse = |name: &str| {
        name.trim()
            .parse()
            .map_err(|e: cotorra_measurements::InvalidKind| Failure::bad_request(e.to_string()))
    };
    names.split(',').map(parse).collect()
}

fn encode(event: &Arc<Stamped>) -> SseEvent {
    let json = serde_json::to_string(event).expect("an event holds only what JSON can");
    SseEvent::default().data(json)
}
