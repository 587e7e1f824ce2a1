//! The history of the run, and of other runs in the same history.

use std::{borrow::Cow, ops::Bound, sync::Arc};

use axum::{
    Extension, Json,
    extract::State,
    http::header::CONTENT_TYPE,
    response::{IntoResponse, Response},
};
use cotorra_graph::{Direction, LinkId, NodeId, RobotContext, Testbed, Timestamp};
use cotorra_measurements::{
    Cursor, CurveRequest, Figure, History, Page, PageRequest, RunId, Sample, difference::Targets,
};
use serde::{Deserialize, Serialize};

use super::{
    auth::Caller,
    connections::Whose,
    context::Context,
    stream::parse_kinds,
    turns::TURNS,
    types::{Failure, GapBody, LinkState, Path, Query, RunBody},
};
use crate::report::{Fidelity, ServiceKpis};

/// A part of the history.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Part {
    /// Beginning, nanoseconds since the run began.
    #[serde(default)]
    from_ns: Timestamp,
    /// End, exclusive, nanoseconds since the run began; the run's end by default.
    until_ns: Option<Timestamp>,
    /// Maximum number of items; 1000 by default, 10000 at most.
    limit: Option<usize>,
    /// The `next` of the previous page.
    #[param(value_type = Option<String>)]
    after: Option<Cursor>,
    /// Direction of a link, `forward` by default; for links only.
    direction: Option<Direction>,
    /// Kinds of events, separated by commas, all by default; for events only.
    kinds: Option<String>,
    /// The number of another run of the same history, in place of this one.
    #[param(value_type = Option<i64>)]
    run: Option<RunId>,
}

impl Part {
    fn page(&self) -> PageRequest {
        PageRequest { limit: self.limit.unwrap_or(PageRequest::default().limit), after: self.after }
    }

    /// Returns the range of time, up to the present of a run.
    fn until(&self, present: Timestamp) -> Span {
        span(self.from_ns, self.until_ns, present)
    }
}

type Span = (Bound<Timestamp>, Bound<Timestamp>);

fn span(from: Timestamp, until: Option<Timestamp>, present: Timestamp) -> Span {
    let until = until.filter(|until| *until <= present);
    (Bound::Included(from), until.map_or(Bound::Included(present), Bound::Excluded))
}

/// An answer from the history as JSON, or a failure.
type Written = Result<Response, Failure>;

/// Queries the history on another thread, about this run or another. Passes on the time up to which the run is known. The
/// answer is written there, too: a long one must not keep others from being served. Requests that wait for their turn are
/// dropped with their caller's connection.
async fn ask<T: Serialize + 'static>(
    context: Context,
    whose: Whose,
    other: Option<RunId>,
    question: impl FnOnce(&History, RunId, Timestamp) -> cotorra_measurements::Result<T> + Send + 'static,
) -> Written {
    let turn = TURNS.take(whose).await;
    let ask = move || {
        if let Some(recorder) = context.lockstep.as_ref().and_then(|lockstep| lockstep.recorder.as_ref()) {
            recorder.flush()?;
        }
        let run = other.unwrap_or(context.run);
        let is_played = context.replay && run == context.run;
        let present = if is_played { context.live.read(|now| now.at) } else { Timestamp::MAX };
        let answer = question(&context.history, run, present)?;
        let answer = serde_json::to_vec(&answer).expect("an answer is valid JSON");
        drop(turn);
        Ok(answer)
    };
    match tokio::task::spawn_blocking(ask).await {
        Ok(Ok(answer)) => Ok(([(CONTENT_TYPE, "application/json")], answer).into_response()),
        Ok(Err(error @ cotorra_measurements::Error::NoSuchRun(_))) => {
            Err(Failure::not_found(error.to_string()))
        }
        Ok(Err(error)) => Err(Failure::unavailable(error.to_string())),
        Err(broken) => Err(Failure::unavailable(format!("the query failed: {broken}"))),
    }
}

/// Rejects queries of other runs by anyone but the operator: other runs may have other testbeds with other domains.
fn this_run(caller: &Caller, run: Option<RunId>) -> Result<(), Failure> {
    if run.is_some() { caller.operator() } else { Ok(()) }
}

/// Returns κ of a robot over time.
#[utoipa::path(get, path = "/api/v1/measurements/robots/{id}", tag = "measurements",
    params(("id" = String, Path), Part),
    responses((status = 200, body = Page<Sample<RobotContext>>)))]
pub(super) async fn robot_history(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<NodeId>,
    Query(part): Query<Part>,
) -> Written {
    this_run(&caller, part.run)?;
    caller.sees(&id, |view| view.owns(&id))?;
    if part.run.is_none() && !context.testbed.graph.robots().any(|(node, _)| node.id == id) {
        return Err(Failure::not_found(format!("there is no robot `{id}`")));
    }
    ask(context, caller.whose(), part.run, move |history, run, present| {
        let mut page = history.robot_series(run, &id, part.until(present), part.page())?;
        if let Some(view) = &caller.view {
            let seen =
                |sample: Sample<RobotContext>| Some(Sample { value: view.robot(&sample.value)?, ..sample });
            page.items = page.items.into_iter().filter_map(seen).collect();
        }
        Ok(page)
    })
    .await
}

/// Returns d, λ and conditions of one direction of a link over time, with configured, measured and available figures.
#[utoipa::path(get, path = "/api/v1/measurements/links/{id}", tag = "measurements",
    params(("id" = String, Path), Part),
    responses((status = 200, body = Page<Sample<LinkState>>)))]
pub(super) async fn link_history(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<LinkId>,
    Query(part): Query<Part>,
) -> Written {
    this_run(&caller, part.run)?;
    caller.sees(&id, |view| view.sees_link(&id))?;
    let known = part.run.is_some()
        || context.testbed.graph.link(&id).is_some()
        || context.live.read(|now| now.links.keys().any(|(l, _)| *l == id));
    if !known {
        return Err(Failure::not_found(format!("there is no link `{id}`")));
    }
    let direction = part.direction.unwrap_or(Direction::Forward);
    ask(context, caller.whose(), part.run, move |history, run, present| {
        let page = history.link_series(run, &id, direction, part.until(present), part.page())?;
        let state = |Sample { at, value }| Sample { at, value: LinkState::from(value) };
        Ok(Page { items: page.items.into_iter().map(state).collect(), next: page.next })
    })
    .await
}

/// Returns the context of a node's machine over time.
#[utoipa::path(get, path = "/api/v1/measurements/machines/{id}", tag = "measurements",
    params(("id" = String, Path), Part),
    responses((status = 200, body = Page<Sample<cotorra_graph::MachineContext>>)))]
pub(super) async fn machine_history(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<NodeId>,
    Query(part): Query<Part>,
) -> Written {
    this_run(&caller, part.run)?;
    caller.sees(&id, |view| view.owns(&id))?;
    if part.run.is_none() && context.testbed.graph.node(&id).is_none() {
        return Err(Failure::not_found(format!("there is no node `{id}`")));
    }
    ask(context, caller.whose(), part.run, move |history, run, present| {
        history.machine_series(run, &id, part.until(present), part.page())
    })
    .await
}

/// Returns service times.
#[utoipa::path(get, path = "/api/v1/measurements/service-times", tag = "measurements",
    params(Part),
    responses((status = 200, body = Page<Sample<cotorra_graph::ServiceTime>>)))]
pub(super) async fn service_times(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
    Query(part): Query<Part>,
) -> Written {
    this_run(&caller, part.run)?;
    ask(context, caller.whose(), part.run, move |history, run, present| {
        let mut page = history.service_times(run, part.until(present), part.page())?;
        page.items.retain(|sample| caller.keeps(|view| view.owns(&sample.value.robot)));
        if let Some(view) = caller.view() {
            page.items.iter_mut().for_each(|sample| sample.value = view.service_time(&sample.value));
        }
        Ok(page)
    })
    .await
}

/// Returns up to when samples of a run were rolled up, by kind. Before that time there is one sample per step, and figures
/// are computed from all original samples. Kinds that are fully recorded are left out.
#[utoipa::path(get, path = "/api/v1/measurements/retained", tag = "measurements",
    params(OfRun),
    responses((status = 200, body = Vec<cotorra_measurements::Retained>)))]
pub(super) async fn retained(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
    Query(of): Query<OfRun>,
) -> Written {
    caller.operator()?;
    ask(context, caller.whose(), of.run, |history, run, _| history.retained(run)).await
}

/// Returns whether the emulation of a recorded run did what its testbed file demands. It is null if the run is not over, was
/// killed, or the token is a domain's.
#[utoipa::path(get, path = "/api/v1/measurements/verdict", tag = "measurements",
    responses((status = 200, body = Option<Fidelity>)))]
pub(super) async fn verdict(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
) -> Json<Option<Fidelity>> {
    Json(context.verdict.filter(|_| caller.operator().is_ok()))
}

/// Returns the KPIs of a recorded run's services and the verdicts on them. There are none if the run is not over, was killed, or
/// the token is a domain's.
#[utoipa::path(get, path = "/api/v1/measurements/kpis", tag = "measurements",
    responses((status = 200, body = Vec<ServiceKpis>)))]
pub(super) async fn kpis(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
) -> Json<Vec<ServiceKpis>> {
    Json(if caller.operator().is_ok() { context.kpis } else { Vec::new() })
}

/// A run.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct OfRun {
    /// The number of another run of the same history, in place of this one.
    #[param(value_type = Option<i64>)]
    run: Option<RunId>,
}

/// Returns handovers.
#[utoipa::path(get, path = "/api/v1/measurements/handovers", tag = "measurements",
    params(Part),
    responses((status = 200, body = Page<Sample<cotorra_graph::Handover>>)))]
pub(super) async fn handovers(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
    Query(part): Query<Part>,
) -> Written {
    caller.operator()?;
    ask(context, caller.whose(), part.run, move |history, run, present| {
        history.handovers(run, part.until(present), part.page())
    })
    .await
}

/// Returns events of any kind, in order. With a domain's token a page may have fewer events than its limit: events of other
/// domains are left out.
#[utoipa::path(get, path = "/api/v1/measurements/events", tag = "measurements",
    params(Part),
    responses((status = 200, body = Page<cotorra_graph::Stamped>)))]
pub(super) async fn event_history(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
    Query(part): Query<Part>,
) -> Written {
    this_run(&caller, part.run)?;
    let kinds = part.kinds.as_deref().map(parse_kinds).transpose()?.unwrap_or_default();
    ask(context, caller.whose(), part.run, move |history, run, present| {
        let mut page = history.events(run, &kinds, part.until(present), part.page())?;
        if let Some(view) = &caller.view {
            page.items =
                page.items.iter().filter_map(|event| view.event(event).map(Cow::into_owned)).collect();
        }
        Ok(page)
    })
    .await
}

/// Returns the gaps where events were lost. What a run without an end lost after its last event is unknown.
#[utoipa::path(get, path = "/api/v1/measurements/gaps", tag = "measurements",
    params(Part),
    responses((status = 200, body = Page<GapBody>)))]
pub(super) async fn gaps(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
    Query(part): Query<Part>,
) -> Written {
    caller.operator()?;
    ask(context, caller.whose(), part.run, move |history, run, present| {
        let Page { items, next } = history.gaps(run, part.until(present), part.page())?;
        Ok(Page { items: items.into_iter().map(GapBody::from).collect(), next })
    })
    .await
}

/// A figure, and its resolution.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Which {
    /// The figure and its object: `delay:LINK:DIRECTION`, `throughput:…`, `queue:…`, `delay_scale:…` or `drop_scale:…`
    /// (forward without a direction); `x:ROBOT`, `y:…`, `z:…`, `heading:…`, `linear:…`, `vertical:…`, `angular:…`,
    /// `nearest_obstacle:…` or `localization_error:…`; `signal:ROBOT:RADIO_UNIT`; `load:RADIO_UNIT`;
    /// `service_time:SERVICE:ROBOT` or `handover_gap:ROBOT` (of all without an object); `time_part:LINK:SERVICE:ROBOT`
    /// (also of `sender`, `vnf`, `receiver` or `unknown`); `sensor:ROBOT:SENSOR:COMPONENT`; `cpu:NODE`,
    /// `load_average:…` or `available_memory:…` of a machine; `lateness_p50`, `lateness_p99` or `lateness_max`.
    #[param(value_type = String)]
    figure: Figure,
    /// Beginning, nanoseconds since the run began.
    #[serde(default)]
    from_ns: Timestamp,
    /// End, exclusive, nanoseconds since the run began; the run's end by default.
    until_ns: Option<Timestamp>,
    /// Maximum number of points; 1000 by default, 10000 at most.
    points: Option<usize>,
    /// Quantiles of each point, as shares from 0 to 1 separated by commas; 0.5 by default.
    quantiles: Option<String>,
    /// The number of another run of the same history, in place of this one.
    #[param(value_type = Option<i64>)]
    run: Option<RunId>,
}

/// Returns a figure over time in a bounded number of points. Each has count, minimum, maximum, mean, last and quantiles of
/// its samples, and whether events were lost. With a domain's token: figures of its own robots, links and nodes.
#[utoipa::path(get, path = "/api/v1/measurements/series", tag = "measurements",
    params(Which),
    responses((status = 200, body = cotorra_measurements::Curve)))]
pub(super) async fn series(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
    Query(which): Query<Which>,
) -> Written {
    this_run(&caller, which.run)?;
    caller.sees(&which.figure, |view| view.sees_figure(&which.figure))?;
    let mut request = CurveRequest::default();
    request.points = which.points.unwrap_or(request.points);
    if let Some(shares) = &which.quantiles {
        let parse = |share: &str| share.trim().parse().ok().filter(|share| (0.0..=1.0).contains(share));
        let shares: Option<Vec<f64>> = shares.split(',').map(parse).collect();
        request.quantiles = shares.ok_or_else(|| {
            Failure::bad_request("quantiles are shares from 0 to 1 with commas between, as in 0.5,0.99")
        })?;
    }
    ask(context, caller.whose(), which.run, move |history, run, present| {
        history.curve(run, &which.figure, span(which.from_ns, which.until_ns, present), &request)
    })
    .await
}

/// A page of runs.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Runs {
    /// Only runs after this one.
    #[param(value_type = Option<i64>)]
    after: Option<RunId>,
    /// Maximum number of runs; 1000 by default, 10000 at most.
    limit: Option<usize>,
}

/// Returns the runs in this run's history, the oldest first.
#[utoipa::path(get, path = "/api/v1/measurements/runs", tag = "measurements",
    params(Runs),
    responses((status = 200, body = Vec<RunBody>)))]
pub(super) async fn runs(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
    Query(which): Query<Runs>,
) -> Written {
    caller.operator()?;
    let limit = which.limit.unwrap_or(PageRequest::default().limit);
    ask(context, caller.whose(), None, move |history, this, _| {
        let runs = history.runs(which.after, limit)?;
        Ok(runs.into_iter().map(|run| RunBody::new(run, this)).collect::<Vec<_>>())
    })
    .await
}

/// Two runs to compare.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Pair {
    /// The number of the first run.
    #[param(value_type = i64)]
    a: RunId,
    /// The number of the second run; this run by default.
    #[param(value_type = Option<i64>)]
    b: Option<RunId>,
}

/// Compares two runs of this run's history.
#[utoipa::path(get, path = "/api/v1/measurements/difference", tag = "measurements",
    params(Pair),
    responses((status = 200, body = cotorra_measurements::Difference), (status = 409, description = "refused, for the reason in the body", body = super::types::FailureBody)))]
pub(super) async fn difference(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
    Query(Pair { a, b }): Query<Pair>,
) -> Written {
    caller.operator()?;
    let b = b.unwrap_or(context.run);
    if context.replay && [a, b].contains(&context.run) {
        return Err(Failure::refused("this is a replay: how its run ends is not told before it does"));
    }
    let (own, own_run) = (Arc::clone(&context.testbed), context.run);
    ask(context, caller.whose(), Some(b), move |history, b, _| {
        let targets = |run: RunId| {
            if run == own_run {
                return Ok(targets(&own));
            }
            let info = history.run(run)?.info;
            // Files that the other run's testbed file names need not be here.
            let other = cotorra_testbed_file::parse(&info.name, &info.testbed, std::path::Path::new(""));
            Ok(other.as_ref().map(targets).unwrap_or_default())
        };
        history.difference(a, b, [targets(a)?, targets(b)?])
    })
    .await
}

/// Returns the targets of a testbed's services.
fn targets(testbed: &Testbed) -> Targets {
    testbed.services.iter().map(|service| (service.id.clone(), service.kpis.service_time)).collect()
}

/// A time.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct At {
    /// Nanoseconds since the run began. The default is now, and for another run its end.
    at_ns: Option<Timestamp>,
    /// The number of another run of the same history, in place of this one.
    #[param(value_type = Option<i64>)]
    run: Option<RunId>,
}

/// Returns the whole graph at a time, with the last known state of every object. With a domain's token: its part of it.
#[utoipa::path(get, path = "/api/v1/measurements/state", tag = "measurements",
    params(At),
    responses((status = 200, body = cotorra_measurements::GraphState)))]
pub(super) async fn state(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
    Query(at): Query<At>,
) -> Written {
    this_run(&caller, at.run)?;
    let now = if at.run.is_some() { Timestamp::MAX } else { context.live.read(|now| now.at) };
    let when = at.at_ns.unwrap_or(now);
    ask(context, caller.whose(), at.run, move |history, run, present| {
        let state = history.state_at(run, when.min(present))?;
        Ok(match caller.view() {
            Some(view) => view.state(state),
            None => state,
        })
    })
    .await
}
