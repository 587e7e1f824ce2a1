//! Server-sent events as they happen, and the marks of plug-ins that virtual time waits for.

use std::{convert::Infallible, pin::Pin, sync::Arc};

use axum::{
    Extension, Json,
    extract::State,
    http::HeaderMap,
    response::sse::{Event as SseEvent, KeepAlive, Sse},
};
use cotorra_graph::{PluginId, SensorId, Stamped, Timestamp};
use cotorra_measurements::Kind;
use serde::Deserialize;
use tokio_stream::{Stream, StreamExt, wrappers::UnboundedReceiverStream};

use super::{
    auth::Caller,
    context::{Answer, Context},
    routes::plugin,
    types::{Done, Failure, Path, Query},
};
use crate::{
    core::message::Message,
    events::{
        follower::{EventFilter, Follower, PluginMessage},
        stream::Received,
    },
};

/// A selection of events.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Which {
    /// Kinds of events, separated by commas; all by default.
    kinds: Option<String>,
    /// Names of sensors, separated by commas, whose readings are sent; all by default.
    sensors: Option<String>,
}

/// Streams events as they happen. A reader that is more than 4096 events or 16 MiB behind loses the oldest, and slows no other. An
/// event named `missed` has the number of lost events, of all kinds, as its data. A plug-in that the testbed started away from
/// the core has events when they have arrived there.
///
/// In virtual time, a plug-in that the testbed started, identified by its token, loses no events. Its stream has an event
/// named `mark` at once, and then after the events of each moment. The mark's `id` is a number, and its data the time in
/// nanoseconds. Time stands still until the plug-in has posted that number to `/api/v1/marks/{number}`.
#[utoipa::path(get, path = "/api/v1/events", tag = "events",
    params(Which, ("X-Cotorra-Plugin" = Option<String>, Header)),
    responses((status = 200, body = String, content_type = "text/event-stream",
        description = "each `data:` is a Stamped event")))]
pub(super) async fn events(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
    headers: HeaderMap,
    Query(which): Query<Which>,
) -> Result<Sse<impl Stream<Item = Result<SseEvent, Infallible>>>, Failure> {
    let filter = EventFilter {
        view: caller.view.clone(),
        kinds: which.kinds.as_deref().map(parse_kinds).transpose()?,
        sensors: which.sensors.as_deref().map(parse_sensors).transpose()?,
    };
    let is_waited_for = |plugin: &PluginId| {
        let plugins = context.lockstep.as_ref().map(|lockstep| &lockstep.plugins);
        plugins.is_some_and(|these| these.as_ref().is_none_or(|these| these.contains(plugin)))
    };
    let stream: Pin<Box<dyn Stream<Item = _> + Send>> = match plugin(&context, &caller, &headers)? {
        Some(plugin) if is_waited_for(&plugin) => {
            let (follower, messages) = Follower::new(plugin, filter);
            context.core.send(Message::Follow(follower)).map_err(|_| Failure::ended())?;
            Box::pin(UnboundedReceiverStream::new(messages).map(|message| Ok(encode_message(&message))))
        }
        plugin => {
            let filter = Arc::new(filter);
            let events = match plugin.and_then(|plugin| context.distant.get(&plugin)) {
                Some(distant) => distant.subscribe(&filter),
                None => context.events.subscribe(),
            };
            Box::pin(events.filter_map(move |received| match received {
                Received::Event(event) => filter.apply(&event).map(|event| Ok(encode(&event))),
                Received::Missed(missed) => {
                    Some(Ok(SseEvent::default().event("missed").data(missed.to_string())))
                }
            }))
        }
    };
    Ok(Sse::new(stream).keep_alive(KeepAlive::default()))
}

/// The next wake-up of a plug-in.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Wake {
    /// Time of the next mark at the latest, nanoseconds since the run began, even without events.
    wake_at_ns: Option<u64>,
}

/// Returns a mark: the plug-in has handled all events before it, and has given its instructions. Virtual time goes on. In
/// real time, which never waits, this does nothing.
#[utoipa::path(post, path = "/api/v1/marks/{number}", tag = "events",
    params(("number" = u64, Path), ("X-Cotorra-Plugin" = Option<String>, Header), Wake),
    responses((status = 200, body = Done)))]
pub(super) async fn done(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
    Path(mark): Path<u64>,
    headers: HeaderMap,
    Query(wake): Query<Wake>,
) -> Answer<Done> {
    // A plug-in can only return marks that it was sent itself.
    if let Some(plugin) = plugin(&context, &caller, &headers)?.filter(|_| context.lockstep.is_some()) {
        let wake_at = wake.wake_at_ns.map(Timestamp::from_nanos);
        context.core.send(Message::Done { plugin, mark, wake_at }).map_err(|_| Failure::ended())?;
    }
    Ok(Json(Done { done: true }))
}

/// Parses names of sensors, separated by commas.
fn parse_sensors(names: &str) -> Result<Vec<SensorId>, Failure> {
    let parse = |name: &str| SensorId::new(name.trim()).map_err(|e| Failure::bad_request(e.to_string()));
    names.split(',').map(parse).collect()
}

/// Parses names of kinds, separated by commas.
pub(super) fn parse_kinds(names: &str) -> Result<Vec<Kind>, Failure> {
    let parse = |name: &str| {
        name.trim()
            .parse()
            .map_err(|e: cotorra_measurements::InvalidKind| Failure::bad_request(e.to_string()))
    };
    names.split(',').map(parse).collect()
}

fn encode(event: &Arc<Stamped>) -> SseEvent {
    let json = serde_json::to_string(event).expect("an event is valid JSON");
    SseEvent::default().data(json)
}

fn encode_message(message: &PluginMessage) -> SseEvent {
    match message {
        PluginMessage::Event(event) => encode(event),
        PluginMessage::Mark { number, now } => {
            SseEvent::default().event("mark").id(number.to_string()).data(now.as_nanos().to_string())
        }
    }
}
