//! What happens, as it happens: server-sent events; and in virtual time, when a plug-in has taken them in.

use std::{convert::Infallible, pin::Pin, sync::Arc};

use axum::{
    Extension, Json,
    extract::State,
    http::HeaderMap,
    response::sse::{Event as SseEvent, KeepAlive, Sse},
};
use cotorra_graph::{Event, PluginId, SensorId, Stamped, Timestamp};
use cotorra_measurements::Kind;
use serde::Deserialize;
use tokio::sync::mpsc::{UnboundedSender, unbounded_channel};
use tokio_stream::{
    Stream, StreamExt,
    wrappers::{BroadcastStream, UnboundedReceiverStream, errors::BroadcastStreamRecvError},
};

use super::{
    Answer, Context,
    auth::Caller,
    routes::plugin,
    types::{Done, Failure, Path, Query},
};
use crate::{core_loop::Message, domain};

/// A stream of events to a plug-in that virtual time waits for.
pub(crate) struct Follower {
    /// Whose.
    pub(crate) plugin: PluginId,
    wanted: Wanted,
    caller: Caller,
    tell: UnboundedSender<Told>,
}

/// Which events somebody asked for; all where nothing is said.
#[derive(Debug, Default)]
struct Wanted {
    kinds: Option<Vec<Kind>>,
    /// Readings of sensors of these names.
    sensors: Option<Vec<SensorId>>,
}

impl Wanted {
    fn holds(&self, event: &Event) -> bool {
        let of_sensor = |sensors: &Vec<SensorId>| match event {
            Event::Sensor(reading) => sensors.contains(&reading.sensor),
            _ => true,
        };
        self.kinds.as_ref().is_none_or(|kinds| kinds.contains(&Kind::of(event)))
            && self.sensors.as_ref().is_none_or(of_sensor)
    }
}

/// What such a stream tells.
pub(crate) enum Told {
    /// Something happened.
    Event(Arc<Stamped>),
    /// That is all up to now; time stands still until it is done with that.
    Mark {
        /// What is to be given back.
        number: u64,
        /// The time.
        now: Timestamp,
    },
}

impl Follower {
    /// One that is told everything, and where it is.
    #[cfg(test)]
    pub(crate) fn of(plugin: PluginId) -> (Self, tokio::sync::mpsc::UnboundedReceiver<Told>) {
        let (tell, told) = unbounded_channel();
        (Self { plugin, wanted: Wanted::default(), caller: Caller::default(), tell }, told)
    }

    /// What it is told of an event, if it asked for its kind.
    pub(crate) fn sees(&self, event: &Arc<Stamped>) -> Option<Arc<Stamped>> {
        seen(&self.caller, &self.wanted, event)
    }

    /// Tells it; false if nobody reads any more.
    pub(crate) fn tell(&self, told: Told) -> bool {
        self.tell.send(told).is_ok()
    }

    /// Whether nobody reads any more.
    pub(crate) fn is_gone(&self) -> bool {
        self.tell.is_closed()
    }
}

/// Which events.
#[derive(Debug, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::IntoParams))]
#[serde(deny_unknown_fields)]
#[cfg_attr(feature = "openapi", into_params(parameter_in = Query))]
pub(super) struct Which {
    /// Kinds of events, with commas between; all if it is left out.
    kinds: Option<String>,
    /// Names of sensors, with commas between, of which readings are told; all if it is left out.
    sensors: Option<String>,
}

/// Events as they happen. A reader that is more than 4096 events behind loses the oldest, and slows nobody: an event named
/// `missed` tells it how many it lost there, of all kinds, as its data.
///
/// In virtual time a plug-in that the testbed started, which its secret says, loses none: at once, and then after
/// the events of each moment, its stream has an event named `mark`, with a number as its `id` and the time, in
/// nanoseconds, as its data. Time stands still until the plug-in has posted that number to `/api/v1/marks/{number}`.
#[cfg_attr(feature = "openapi", utoipa::path(get, path = "/api/v1/events", tag = "events",
    params(Which, ("X-Cotorra-Plugin" = Option<String>, Header)),
    responses((status = 200, body = String, content_type = "text/event-stream",
        description = "each `data:` is a Stamped event"))))]
pub(super) async fn events(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
    headers: HeaderMap,
    Query(which): Query<Which>,
) -> Result<Sse<impl Stream<Item = Result<SseEvent, Infallible>>>, Failure> {
    let wanted = Wanted {
        kinds: which.kinds.as_deref().map(parse_kinds).transpose()?,
        sensors: which.sensors.as_deref().map(parse_sensors).transpose()?,
    };
    let is_waited_for = |plugin: &PluginId| {
        let plugins = context.lockstep.as_ref().map(|lockstep| &lockstep.plugins);
        plugins.is_some_and(|these| these.as_ref().is_none_or(|these| these.contains(plugin)))
    };
    let stream: Pin<Box<dyn Stream<Item = _> + Send>> =
        match plugin(&context, &caller, &headers)?.filter(is_waited_for) {
            Some(plugin) => {
                let (tell, told) = unbounded_channel();
                let follower = Follower { plugin, wanted, caller, tell };
                context.core.send(Message::Follow(follower)).map_err(|_| Failure::ended())?;
                Box::pin(UnboundedReceiverStream::new(told).map(|told| Ok(encode_told(&told))))
            }
            None => Box::pin(BroadcastStream::new(context.events.subscribe()).filter_map(move |received| {
                match received {
                    Ok(event) => seen(&caller, &wanted, &event).map(|event| Ok(encode(&event))),
                    Err(BroadcastStreamRecvError::Lagged(missed)) => {
                        Some(Ok(SseEvent::default().event("missed").data(missed.to_string())))
                    }
                }
            })),
        };
    Ok(Sse::new(stream).keep_alive(KeepAlive::default()))
}

/// When a plug-in wants to be woken.
#[derive(Debug, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::IntoParams))]
#[serde(deny_unknown_fields)]
#[cfg_attr(feature = "openapi", into_params(parameter_in = Query))]
pub(super) struct Wake {
    /// At this time at the latest, nanoseconds since the run began, there is another mark, events or not.
    wake_at_ns: Option<u64>,
}

/// Say that all events before a mark were taken in, and all instructions that they call for were given: virtual time
/// goes on. In real time, which waits for nobody, it does nothing.
#[cfg_attr(feature = "openapi", utoipa::path(post, path = "/api/v1/marks/{number}", tag = "events",
    params(("number" = u64, Path), ("X-Cotorra-Plugin" = Option<String>, Header), Wake),
    responses((status = 200, body = Done))))]
pub(super) async fn done(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
    Path(mark): Path<u64>,
    headers: HeaderMap,
    Query(wake): Query<Wake>,
) -> Answer<Done> {
    // Nobody is done with what another one was told.
    if let Some(plugin) = plugin(&context, &caller, &headers)?.filter(|_| context.lockstep.is_some()) {
        let wake_at = wake.wake_at_ns.map(Timestamp::from_nanos);
        context.core.send(Message::Done { plugin, mark, wake_at }).map_err(|_| Failure::ended())?;
    }
    Ok(Json(Done { done: true }))
}

/// What a caller is told of an event, if it asked for such.
fn seen(caller: &Caller, wanted: &Wanted, event: &Arc<Stamped>) -> Option<Arc<Stamped>> {
    let seen = domain::seen(caller.view.as_deref(), event)?;
    wanted.holds(&seen.event).then_some(seen)
}

/// Names of sensors with commas between.
fn parse_sensors(names: &str) -> Result<Vec<SensorId>, Failure> {
    let parse = |name: &str| SensorId::new(name.trim()).map_err(|e| Failure::bad_request(e.to_string()));
    names.split(',').map(parse).collect()
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

fn encode_told(told: &Told) -> SseEvent {
    match told {
        Told::Event(event) => encode(event),
        Told::Mark { number, now } => {
            SseEvent::default().event("mark").id(number.to_string()).data(now.as_nanos().to_string())
        }
    }
}
