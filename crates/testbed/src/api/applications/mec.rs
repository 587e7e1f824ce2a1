//! Application life cycle management of ETSI GS MEC 010-2, at `/app_lcm/v1`. Descriptors are those of `/fog05`.

use axum::{
    Extension, Json, Router,
    body::Bytes,
    extract::{Path, RawQuery, State},
    http::{HeaderMap, StatusCode, header::LOCATION},
    middleware,
    response::{IntoResponse, Response},
    routing::{get, post},
};
use cotorra_graph::Timestamp;
use cotorra_lifecycle::{
    LifecycleError,
    mec::{self, Begun, InstantiateRequest, OperateRequest, Task, TerminateRequest},
};
use serde_json::Value;

use super::{
    super::auth::{self, Caller, Gate},
    Asked, Rejected, Served, to_the_end,
};

const BASE: &str = "/app_lcm/v1";
/// Reason of decisions.
const REASON: &str = "MEC 010-2";

/// A problem in the form of the ETSI MEC standards.
struct Problem(Rejected);

impl<E: Into<Rejected>> From<E> for Problem {
    fn from(error: E) -> Self {
        Self(error.into())
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        cotorra_mec::Problem::new(self.0.status, self.0.reason).into_response()
    }
}

/// Returns the OpenAPI document, which is checked in.
pub(in crate::api) fn openapi() -> String {
    include_str!("../../../../../docs/app-lcm.openapi.json").to_owned()
}

pub(super) fn router(served: Served, gate: Gate) -> Router {
    let document = openapi();
    let routes = Router::new()
        .route("/app_instances", get(instances).post(create))
        .route("/app_instances/{id}", get(instance).delete(remove))
        .route("/app_instances/{id}/instantiate", post(instantiate))
        .route("/app_instances/{id}/operate", post(operate))
        .route("/app_instances/{id}/terminate", post(terminate))
        .route("/app_lcm_op_occs", get(occurrences))
        .route("/app_lcm_op_occs/{id}", get(occurrence))
        .fallback(async || {
            let reason = "no such path; see /app_lcm/v1/openapi.json";
            cotorra_mec::Problem::new(StatusCode::NOT_FOUND, reason)
        })
        .layer(middleware::from_fn_with_state(gate, auth::check_mec))
        .route(
            "/openapi.json",
            get(move || async move { ([("content-type", "application/json")], document) }),
        )
        .with_state(served);
    Router::new().nest(BASE, routes)
}

impl Served {
    fn now_ns(&self) -> u64 {
        let now = match &self.context.wais.clock {
            Some(clock) => clock(),
            None => self.context.live.read(|now| now.at),
        };
        now.since(Timestamp::ZERO).as_nanos().try_into().unwrap_or(u64::MAX)
    }

    fn document(&self, asked: &Asked, id: &str) -> Result<Value, LifecycleError> {
        let all = self.all.lock();
        let instance = all.instance(asked.viewer(), id)?;
        let (_, of) = all.descriptor(None, &instance.descriptor)?;
        Ok(mec::instance(instance, of, BASE))
    }

    /// Carries out an operation to its end, and returns where its occurrence is.
    async fn operation(&self, asked: &Asked, id: &str, begun: Begun) -> Result<Response, Rejected> {
        let done = match begun.task {
            Task::Start => self.start(asked, id, "", REASON).await,
            Task::Stop => self.stop(asked, id, REASON).await,
            Task::Nothing => Ok(()),
        };
        let now_ns = self.now_ns();
        self.all.lock().end(id, begun, done.is_ok(), now_ns);
        done?;
        let location = format!("{BASE}/app_lcm_op_occs/{}", begun.number);
        Ok((StatusCode::ACCEPTED, [(LOCATION, location)]).into_response())
    }
}

/// Rejects filters and selectors of attributes, which this service does not have.
fn no_query(query: Option<String>) -> Result<(), LifecycleError> {
    match query.filter(|query| !query.is_empty()) {
        None => Ok(()),
        Some(_) => Err(LifecycleError::Invalid(
            "filters and selectors of attributes are not supported here".to_owned(),
        )),
    }
}

async fn instances(
    State(served): State<Served>,
    Extension(caller): Extension<Caller>,
    RawQuery(query): RawQuery,
) -> Result<Json<Value>, Problem> {
    no_query(query)?;
    let asked = Asked { caller, headers: HeaderMap::new() };
    let all = served.all.lock();
    let document = |instance| -> Option<Value> {
        let instance: &cotorra_lifecycle::Application = instance;
        Some(mec::instance(instance, all.descriptor(None, &instance.descriptor).ok()?.1, BASE))
    };
    Ok(Json(all.instances(asked.viewer()).filter_map(document).collect()))
}

async fn create(
    State(served): State<Served>,
    Extension(caller): Extension<Caller>,
    body: Bytes,
) -> Result<Response, Problem> {
    let asked = Asked { caller, headers: HeaderMap::new() };
    let request = mec::read(&body)?;
    let id = served.all.lock().create(asked.viewer(), request)?;
    let location = format!("{BASE}/app_instances/{id}");
    Ok((StatusCode::CREATED, [(LOCATION, location)], Json(served.document(&asked, &id)?)).into_response())
}

async fn instance(
    State(served): State<Served>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
) -> Result<Json<Value>, Problem> {
    Ok(Json(served.document(&Asked { caller, headers: HeaderMap::new() }, &id)?))
}

async fn remove(
    State(served): State<Served>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
) -> Result<StatusCode, Problem> {
    let asked = Asked { caller, headers: HeaderMap::new() };
    served.all.lock().undefine(asked.viewer(), &id)?;
    Ok(StatusCode::NO_CONTENT)
}

async fn instantiate(
    State(served): State<Served>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
    headers: HeaderMap,
    body: Bytes,
) -> Result<Response, Problem> {
    let asked = Asked { caller, headers };
    let request: InstantiateRequest = mec::read(&body)?;
    let node = request.node()?;
    let node = served.node(&asked, node.as_str())?.id.clone();
    let now_ns = served.now_ns();
    let begun = served.all.lock().instantiate(asked.viewer(), &id, node, now_ns)?;
    Ok(to_the_end(async move { served.operation(&asked, &id, begun).await }).await?)
}

async fn operate(
    State(served): State<Served>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
    headers: HeaderMap,
    body: Bytes,
) -> Result<Response, Problem> {
    let asked = Asked { caller, headers };
    let request: OperateRequest = mec::read(&body)?;
    let now_ns = served.now_ns();
    let begun = served.all.lock().operate(asked.viewer(), &id, &request, now_ns)?;
    Ok(to_the_end(async move { served.operation(&asked, &id, begun).await }).await?)
}

async fn terminate(
    State(served): State<Served>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
    headers: HeaderMap,
    body: Bytes,
) -> Result<Response, Problem> {
    let asked = Asked { caller, headers };
    let request: TerminateRequest = mec::read(&body)?;
    let now_ns = served.now_ns();
    let begun = served.all.lock().terminate(asked.viewer(), &id, &request, now_ns)?;
    Ok(to_the_end(async move { served.operation(&asked, &id, begun).await }).await?)
}

async fn occurrences(
    State(served): State<Served>,
    Extension(caller): Extension<Caller>,
    RawQuery(query): RawQuery,
) -> Result<Json<Value>, Problem> {
    no_query(query)?;
    let asked = Asked { caller, headers: HeaderMap::new() };
    Ok(Json(served.all.lock().occurrence_documents(asked.viewer(), BASE).into()))
}

async fn occurrence(
    State(served): State<Served>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
) -> Result<Json<Value>, Problem> {
    let asked = Asked { caller, headers: HeaderMap::new() };
    Ok(Json(served.all.lock().occurrence_document(asked.viewer(), &id, BASE)?))
}
