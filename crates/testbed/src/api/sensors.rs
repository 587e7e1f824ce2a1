//! The declared sensors of robots, and their last readings.

use std::{
    collections::BTreeMap,
    pin::Pin,
    sync::Arc,
    task::{self, Poll},
};

use axum::{
    Extension, Json,
    body::{Body, Bytes, HttpBody},
    extract::State,
    http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header::CONTENT_TYPE},
    response::{IntoResponse as _, Response},
};
use cotorra_graph::{ComponentId, DataFormat, NodeId, Sensor, SensorId, SensorReading};
use cotorra_measurements::{Sample, StoredData, WantedData};
use hyper::body::{Frame, SizeHint};
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::{
    auth::Caller,
    connections::Whose,
    context::{Answer, Context},
    turns::TURNS,
    types::{Failure, Path},
};

/// Readings with large data that one caller can fetch at the same time. Others wait, because each is in memory until it is
/// sent.
const GIVEN: usize = 4;

/// The callers' turns. No caller takes those of another.
static READINGS: Mutex<BTreeMap<Whose, Arc<Semaphore>>> = Mutex::new(BTreeMap::new());

/// A sensor and its last reading.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct SensorBody {
    /// The declaration in the testbed file.
    declared: Sensor,
    /// The numbers of a reading.
    components: Vec<ComponentBody>,
    /// The last reading; null before the first.
    last: Option<Sample<SensorReading>>,
}

/// One number of a reading.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct ComponentBody {
    component: ComponentId,
    /// The unit; empty for a share.
    unit: String,
}

/// Returns the sensors of a robot beside those in its context, each with its last reading.
#[utoipa::path(get, path = "/api/v1/robots/{id}/sensors", tag = "robots",
    params(("id" = String, Path)),
    responses((status = 200, body = Vec<SensorBody>)))]
pub(super) async fn sensors(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<NodeId>,
) -> Answer<Vec<SensorBody>> {
    caller.sees(&id, |view| view.owns(&id))?;
    let declared = declared(&context, &id)?;
    let body = |sensor: &Sensor| {
        let unit =
            |(component, unit): (ComponentId, &str)| ComponentBody { component, unit: unit.to_owned() };
        let last = context.live.read(|now| now.sensors.get(&(id.clone(), sensor.id.clone())).cloned());
        SensorBody {
            declared: sensor.clone(),
            components: sensor.kind.components().into_iter().map(unit).collect(),
            last: last.map(|(at, value)| Sample { at, value }),
        }
    };
    Ok(Json(declared.iter().map(body).collect()))
}

/// Returns the declared sensors of a robot.
fn declared<'a>(context: &'a Context, id: &NodeId) -> Result<&'a [Sensor], Failure> {
    let mut robots = context.testbed.graph.robots();
    let robot = robots.find(|(node, _)| node.id == *id).map(|(_, robot)| &*robot.sensors);
    robot.ok_or_else(|| Failure::not_found(format!("there is no robot `{id}`")))
}

/// Selects a reading of a sensor.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(try_from = "String")]
pub(super) enum Which {
    Latest,
    Number(u64),
}

impl TryFrom<String> for Which {
    type Error = String;
    fn try_from(text: String) -> Result<Self, String> {
        let number = || text.parse().map_err(|_| format!("`{text}` is neither `latest` nor a number"));
        if text == "latest" { Ok(Self::Latest) } else { number().map(Self::Number) }
    }
}

/// A body of raw bytes.
#[derive(utoipa::ToSchema)]
#[schema(value_type = String, format = Binary)]
#[allow(dead_code, reason = "used by the OpenAPI document")]
struct LargeBytes(Vec<u8>);

/// Returns the bytes of a reading with large data, such as an image.
///
/// Readings are numbered from 0. A run keeps the last ones, as many as the sensor's `keep` has room for.
#[utoipa::path(get, path = "/api/v1/robots/{id}/sensors/{name}/{reading}", tag = "robots",
    params(("id" = String, Path), ("name" = String, Path),
        ("reading" = String, Path, description = "the number of a reading, or `latest` for the last that is kept")),
    responses(
        (status = 200, content(
            (inline(LargeBytes) = "application/octet-stream"), (inline(LargeBytes) = "image/jpeg"),
            (inline(LargeBytes) = "image/png")), headers(
            ("X-Cotorra-Sequence" = u64, description = "the number of the reading"),
            ("X-Cotorra-Format" = DataFormat, description = "how it is written"),
            ("X-Cotorra-Width" = u32, description = "columns of an image, rays of a scan"),
            ("X-Cotorra-Height" = u32, description = "rows of an image; 1 of a scan"),
            ("X-Cotorra-Measured-Ns" = u64, description = "when it was measured"))),
        (status = 410, description = "there was such a reading, which is not kept any more", body = super::types::FailureBody)))]
pub(super) async fn large_data(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
    Path((id, name, which)): Path<(NodeId, SensorId, Which)>,
) -> Result<Response, Failure> {
    caller.sees(&id, |view| view.owns(&id))?;
    let sensor = declared(&context, &id)?.iter().find(|sensor| sensor.id == name);
    let sensor = sensor.ok_or_else(|| Failure::not_found(format!("robot `{id}` has no sensor `{name}`")))?;
    let keeper = context.keeper.clone().filter(|_| sensor.kind.keep_bytes().is_some()).ok_or_else(|| {
        Failure::not_found(format!("nothing is kept of sensor `{name}` but what its events say"))
    })?;
    let last = context.live.read(|now| Some(now.sensors.get(&(id.clone(), name.clone()))?.1.data?.sequence));
    let wanted = match (which, last) {
        (Which::Latest, Some(last)) => WantedData::UpTo(last),
        (Which::Number(number), Some(last)) if number <= last => WantedData::Number(number),
        _ => return Err(Failure::not_found(format!("sensor `{name}` has no such reading yet"))),
    };
    let given =
        READINGS.lock().entry(caller.whose()).or_insert_with(|| Arc::new(Semaphore::new(GIVEN))).clone();
    let turn = given.acquire_owned().await.expect("never closed");
    let on_thread = TURNS.take(caller.whose()).await;
    let read = tokio::task::spawn_blocking(move || keeper.read(&id, &name, wanted)).await;
    drop(on_thread);
    let broken = |error: &dyn std::fmt::Display| Failure::unavailable(format!("it cannot be read: {error}"));
    let stored = read.map_err(|error| broken(&error))?.map_err(|error| broken(&error))?;
    let gone = || Failure::new(StatusCode::GONE, "the reading is not kept any more");
    Ok(written(stored.ok_or_else(gone)?, turn))
}

fn written(StoredData { measured, data, bytes }: StoredData, turn: OwnedSemaphorePermit) -> Response {
    let kind = match data.format {
        DataFormat::Scan | DataFormat::Mono8 | DataFormat::Rgb8 => "application/octet-stream",
        DataFormat::Jpeg => "image/jpeg",
        DataFormat::Png => "image/png",
    };
    let mut headers = HeaderMap::from_iter([
        (CONTENT_TYPE, HeaderValue::from_static(kind)),
        (HeaderName::from_static("x-cotorra-format"), HeaderValue::from_static(data.format.as_str())),
    ]);
    for (name, figure) in [
        ("x-cotorra-sequence", data.sequence),
        ("x-cotorra-width", data.width.into()),
        ("x-cotorra-height", data.height.into()),
        ("x-cotorra-measured-ns", measured.as_nanos()),
    ] {
        headers.insert(HeaderName::from_static(name), figure.into());
    }
    (headers, Body::new(Given { body: bytes.into(), _turn: turn })).into_response()
}

/// A body that holds its caller's turn until all of it is sent.
struct Given {
    body: Body,
    _turn: OwnedSemaphorePermit,
}

impl HttpBody for Given {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut task::Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        Pin::new(&mut self.body).poll_frame(context)
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}
