//! The run's time: how it passes, and control of that in virtual time and in a replay.

use std::time::Duration;

use axum::{Extension, Json, extract::State};
use cotorra_graph::Timestamp;
use serde::{Deserialize, Serialize};
use tokio::sync::oneshot;

use super::{
    auth::Caller,
    context::{Answer, Context},
    types::{Body, Failure},
};
use crate::{
    core::message::Message,
    virtual_time::time_control::{Speed, TimeChange, TimeState},
};

/// Longest step, milliseconds: a day.
const LONGEST_STEP_MS: f64 = 86_400_000.0;

/// Course of the run's time.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct ClockBody {
    /// Time of the run.
    #[serde(rename = "at_ns")]
    at: Timestamp,
    /// Whether time can be stopped, stepped, and sped up: in virtual time and in a replay, not in real time.
    controllable: bool,
    /// Whether time is stopped.
    paused: bool,
    /// Seconds of the run per second while time is not stopped.
    speed: SpeedBody,
}

impl From<TimeState> for ClockBody {
    fn from(TimeState { now, paused, speed }: TimeState) -> Self {
        let speed = match speed {
            Speed::Times(times) => SpeedBody::Times(times),
            Speed::Max => SpeedBody::Max(AsFastAsPossible::Max),
        };
        Self { at: now, controllable: true, paused, speed }
    }
}

/// Seconds of the run per second, or `max`: as fast as possible.
#[derive(Debug, Clone, Copy, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(untagged)]
pub(super) enum SpeedBody {
    Times(f64),
    Max(AsFastAsPossible),
}

#[derive(Debug, Clone, Copy, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum AsFastAsPossible {
    Max,
}

/// A change of how time passes. What is left out stays as it is.
#[derive(Debug, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct ClockChangeBody {
    /// Stops time, or lets it pass again.
    paused: Option<bool>,
    /// 0.001 to 1000000 seconds of the run per second, or `max`.
    speed: Option<SpeedBody>,
    /// Stops time after so many milliseconds of the run from now; a day at most. Events at their end are included.
    step_ms: Option<f64>,
}

impl ClockChangeBody {
    fn parse(self) -> Result<TimeChange, Failure> {
        let speed = match self.speed {
            None => None,
            Some(SpeedBody::Max(_)) => Some(Speed::Max),
            Some(SpeedBody::Times(times)) => {
                let invalid = || Failure::bad_request("`speed` is 0.001 to 1000000, or `max`");
                Some(Speed::times(times).ok_or_else(invalid)?)
            }
        };
        if self.step_ms.is_some() && self.paused == Some(false) {
            return Err(Failure::bad_request("`step_ms` stops time, and `paused: false` does not"));
        }
        let step = match self.step_ms {
            None => None,
            Some(ms) if (0.0..=LONGEST_STEP_MS).contains(&ms) => Some(Duration::from_secs_f64(ms / 1e3)),
            Some(_) => return Err(Failure::bad_request("`step_ms` is 0 to 86400000")),
        };
        Ok(TimeChange { paused: self.paused, speed, step })
    }
}

/// Returns how the run's time passes.
#[utoipa::path(get, path = "/api/v1/clock", tag = "clock",
    responses((status = 200, body = ClockBody)))]
pub(super) async fn clock(State(context): State<Context>) -> Answer<ClockBody> {
    if context.paced {
        return change(&context, TimeChange::default()).await;
    }
    let speed = SpeedBody::Times(1.0);
    Ok(Json(ClockBody { at: context.now(), controllable: false, paused: context.replay, speed }))
}

/// Stops time, lets it pass again, takes it on by a step, or changes its speed. In virtual time, nothing but the real time
/// at which the run does something depends on that.
#[utoipa::path(post, path = "/api/v1/clock", tag = "clock",
    request_body = ClockChangeBody,
    responses((status = 200, body = ClockBody), (status = 409, description = "real time passes by itself", body = super::types::FailureBody)))]
pub(super) async fn control(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
    Body(body): Body<ClockChangeBody>,
) -> Answer<ClockBody> {
    caller.operator()?;
    let wanted = body.parse()?;
    if !context.paced {
        let reason = if context.replay {
            "this is a view of a finished run, in which no time passes"
        } else {
            "this run is in real time, which nobody can stop"
        };
        return Err(Failure::refused(reason));
    }
    change(&context, wanted).await
}

async fn change(context: &Context, change: TimeChange) -> Answer<ClockBody> {
    let (reply, answer) = oneshot::channel();
    let reply = Box::new(move |state| drop(reply.send(state)));
    context.core.send(Message::ControlTime { change, reply }).map_err(|_| Failure::ended())?;
    answer.await.map(|state: TimeState| Json(state.into())).map_err(|_| Failure::ended())
}
