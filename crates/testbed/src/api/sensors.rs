//! The sensors that robots declare, and what they read last.

use axum::{Extension, Json, extract::State};
use cotorra_graph::{ComponentId, NodeId, Sensor, SensorReading};
use cotorra_measurements::Sample;
use serde::Serialize;

use super::{
    Answer, Context,
    auth::Caller,
    types::{Failure, Path},
};

/// A sensor, and what it read last.
#[derive(Debug, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub(super) struct SensorBody {
    /// As the testbed file declares it.
    declared: Sensor,
    /// The numbers of a reading.
    components: Vec<ComponentBody>,
    /// The last reading; null before the first.
    last: Option<Sample<SensorReading>>,
}

/// One of the numbers of a reading.
#[derive(Debug, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub(super) struct ComponentBody {
    /// Its name.
    component: ComponentId,
    /// Its unit; empty for a share.
    unit: String,
}

/// The sensors of a robot beside what its context has, each with its last reading.
#[cfg_attr(feature = "openapi", utoipa::path(get, path = "/api/v1/robots/{id}/sensors", tag = "robots",
    params(("id" = String, Path)),
    responses((status = 200, body = Vec<SensorBody>))))]
pub(super) async fn sensors(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<NodeId>,
) -> Answer<Vec<SensorBody>> {
    caller.sees(&id, |view| view.owns(&id))?;
    let mut robots = context.testbed.graph.robots();
    let robot = robots.find(|(node, _)| node.id == id).map(|(_, robot)| robot);
    let robot = robot.ok_or_else(|| Failure::not_found(format!("there is no robot `{id}`")))?;
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
    Ok(Json(robot.sensors.iter().map(body).collect()))
}
