//! What was: the history of the run.

use std::ops::Range;

use axum::{Json, extract::State};
use cotorra_graph::{
    Direction, Handover, LinkContext, LinkId, NodeId, RobotContext, ServiceTime, Stamped, Timestamp,
};
use cotorra_measurements::{Cursor, GraphState, History, Page, PageRequest, RunId, Sample};
use serde::Deserialize;

use super::{
    Answer, Context,
    stream::parse_kinds,
    types::{Failure, FailureBody, Path, Query},
};

/// Which part of the history.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Part {
    /// From here on, seconds since the run began.
    #[serde(default)]
    from_s: f64,
    /// Up to here, this excluded, seconds since the run began; to the end if it is left out.
    to_s: Option<f64>,
    /// How many at the most; 1000 if it is left out, never more than 10000.
    limit: Option<usize>,
    /// The `next` of the page before.
    #[param(value_type = Option<String>)]
    after: Option<Cursor>,
    /// One direction of the link, `forward` if it is left out; for links only.
    direction: Option<Direction>,
    /// Kinds of events, with commas between, all if it is left out; for events only.
    kinds: Option<String>,
}

impl Part {
    fn range(&self) -> Range<Timestamp> {
        let end = self.to_s.map_or(Timestamp::MAX, Timestamp::from_secs_f64);
        Timestamp::from_secs_f64(self.from_s)..end
    }

    fn page(&self) -> PageRequest {
        PageRequest { limit: self.limit.unwrap_or(PageRequest::default().limit), after: self.after }
    }
}

/// Asks the history where that may take its time.
async fn ask<T: Send + 'static>(
    context: Context,
    question: impl FnOnce(&History, RunId) -> cotorra_measurements::Result<T> + Send + 'static,
) -> Answer<T> {
    let ask = move || {
        if let Some(lockstep) = &context.lockstep {
            lockstep.recorder.flush()?;
        }
        question(&context.history, context.run)
    };
    let asked = tokio::task::spawn_blocking(ask).await;
    match asked {
        Ok(answer) => answer.map(Json).map_err(|error| Failure::unavailable(error.to_string())),
        Err(broken) => Err(Failure::unavailable(format!("the question broke off: {broken}"))),
    }
}

/// κ of a robot over time.
#[utoipa::path(get, path = "/api/v1/measurements/robots/{id}", tag = "measurements",
    params(("id" = String, Path), Part),
    responses((status = 200, body = Page<Sample<RobotContext>>), (status = 404, body = FailureBody)))]
pub(super) async fn robot_history(
    State(context): State<Context>,
    Path(id): Path<NodeId>,
    Query(part): Query<Part>,
) -> Answer<Page<Sample<RobotContext>>> {
    if !context.testbed.graph.robots().any(|(node, _)| node.id == id) {
        return Err(Failure::not_found(format!("there is no robot `{id}`")));
    }
    ask(context, move |history, run| history.robot_series(run, &id, part.range(), part.page())).await
}

/// d, λ and conditions of one direction of a link over time.
#[utoipa::path(get, path = "/api/v1/measurements/links/{id}", tag = "measurements",
    params(("id" = String, Path), Part),
    responses((status = 200, body = Page<Sample<LinkContext>>), (status = 404, body = FailureBody)))]
pub(super) async fn link_history(
    State(context): State<Context>,
    Path(id): Path<LinkId>,
    Query(part): Query<Part>,
) -> Answer<Page<Sample<LinkContext>>> {
    let known = context.testbed.graph.link(&id).is_some()
        || context.live.read(|now| now.links.keys().any(|(l, _)| *l == id));
    if !known {
        return Err(Failure::not_found(format!("there is no link `{id}`")));
    }
    let direction = part.direction.unwrap_or(Direction::Forward);
    ask(context, move |history, run| history.link_series(run, &id, direction, part.range(), part.page()))
        .await
}

/// Service times.
#[utoipa::path(get, path = "/api/v1/measurements/service-times", tag = "measurements", params(Part),
    responses((status = 200, body = Page<Sample<ServiceTime>>)))]
pub(super) async fn service_times(
    State(context): State<Context>,
    Query(part): Query<Part>,
) -> Answer<Page<Sample<ServiceTime>>> {
    ask(context, move |history, run| history.service_times(run, part.range(), part.page())).await
}

/// Handovers.
#[utoipa::path(get, path = "/api/v1/measurements/handovers", tag = "measurements", params(Part),
    responses((status = 200, body = Page<Sample<Handover>>)))]
pub(super) async fn handovers(
    State(context): State<Context>,
    Query(part): Query<Part>,
) -> Answer<Page<Sample<Handover>>> {
    ask(context, move |history, run| history.handovers(run, part.range(), part.page())).await
}

/// Events of any kind, as they were told.
#[utoipa::path(get, path = "/api/v1/measurements/events", tag = "measurements", params(Part),
    responses((status = 200, body = Page<Stamped>), (status = 400, body = FailureBody)))]
pub(super) async fn events(
    State(context): State<Context>,
    Query(part): Query<Part>,
) -> Answer<Page<Stamped>> {
    let kinds = part.kinds.as_deref().map(parse_kinds).transpose()?.unwrap_or_default();
    ask(context, move |history, run| history.events(run, &kinds, part.range(), part.page())).await
}

/// At which time.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct At {
    /// Seconds since the run began; now if it is left out.
    at_s: Option<f64>,
}

/// The whole graph at a time: of everything the last that was known.
#[utoipa::path(get, path = "/api/v1/measurements/state", tag = "measurements", params(At),
    responses((status = 200, body = GraphState)))]
pub(super) async fn state(State(context): State<Context>, Query(at): Query<At>) -> Answer<GraphState> {
    let at = at.at_s.map(Timestamp::from_secs_f64).unwrap_or_else(|| context.live.read(|now| now.at));
    ask(context, move |history, run| history.state_at(run, at)).await
}
