//! Application life cycle management of ETSI GS MEC 010-2, at `/app_lcm/v1`. Descriptors are those of `/fog05`.

use axum::{
    Json, Router,
    body::Bytes,
    extract::{FromRequestParts, Path, State},
    http::{StatusCode, header::LOCATION, request::Parts},
    middleware,
    response::{IntoResponse, Response},
    routing::{get, post},
};
use cotorra_lifecycle::{
    LifecycleError, Subscription, SubscriptionType,
    mec::{self, INSTANCE_ATTRIBUTES, OCCURRENCE_ATTRIBUTES, OperationRequest, Task},
};
use cotorra_mec::{Parameters, Query};
use serde_json::Value;

use super::{
    super::auth::{self, Gate},
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

type Answer = Result<Json<Value>, Problem>;

/// Returns the OpenAPI document, which is checked in.
pub(in crate::api) fn openapi() -> String {
    include_str!("../../../../../docs/app-lcm.openapi.json").to_owned()
}

pub(super) fn router(served: Served, gate: Gate) -> Router {
    let document = openapi();
    let routes = Router::new()
        .route("/app_instances", get(instances).post(create))
        .route("/app_instances/{id}", get(instance).delete(remove))
        .route("/app_instances/{id}/{operation}", post(operate))
        .route("/app_lcm_op_occs", get(occurrences))
        .route("/app_lcm_op_occs/{id}", get(occurrence))
        .route("/subscriptions", get(subscriptions).post(subscribe))
        .route("/subscriptions/{id}", get(subscription).delete(unsubscribe))
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

/// The URI under which the caller reaches the service. Receivers of notifications need all of it.
struct Base(String);

impl FromRequestParts<Served> for Base {
    type Rejection = cotorra_mec::Problem;

    async fn from_request_parts(parts: &mut Parts, _: &Served) -> Result<Self, Self::Rejection> {
        Ok(Self(format!("http://{}{BASE}", cotorra_mec::authority(parts)?)))
    }
}

impl Served {
    fn document(&self, asked: &Asked, id: &str) -> Result<Value, LifecycleError> {
        let all = self.all();
        let instance = all.instance(asked.viewer(), id)?;
        let (_, of) = all.descriptor(None, &instance.descriptor)?;
        Ok(mec::instance(instance, of, BASE))
    }
}

async fn instances(State(served): State<Served>, asked: Asked, Parameters(parameters): Parameters) -> Answer {
    let query = Query::read(INSTANCE_ATTRIBUTES, &parameters)?;
    let all = served.all();
    let documents = all.instances(asked.viewer()).filter_map(|instance| {
        let (_, of) = all.descriptor(None, &instance.descriptor).ok()?;
        Some(mec::instance(instance, of, BASE))
    });
    Ok(Json(query.answer(documents)))
}

async fn create(State(served): State<Served>, asked: Asked, body: Bytes) -> Result<Response, Problem> {
    let request = mec::read(&body)?;
    let id = served.all().create(asked.viewer(), request)?;
    let location = format!("{BASE}/app_instances/{id}");
    Ok((StatusCode::CREATED, [(LOCATION, location)], Json(served.document(&asked, &id)?)).into_response())
}

async fn instance(State(served): State<Served>, asked: Asked, Path(id): Path<String>) -> Answer {
    Ok(Json(served.document(&asked, &id)?))
}

async fn remove(
    State(served): State<Served>,
    asked: Asked,
    Path(id): Path<String>,
) -> Result<StatusCode, Problem> {
    served.all().undefine(asked.viewer(), &id)?;
    Ok(StatusCode::NO_CONTENT)
}

/// Carries out an operation to its end, and returns where its occurrence is.
async fn operate(
    State(served): State<Served>,
    asked: Asked,
    Path((id, operation)): Path<(String, String)>,
    body: Bytes,
) -> Result<Response, Problem> {
    let request = OperationRequest::read(&operation, &body)?;
    if let Some(node) = request.node() {
        served.node(&asked, node.as_str())?;
    }
    let begun = served.all().begin(asked.viewer(), &id, &request, served.context.now())?;
    let carried_out = to_the_end(async move {
        let done = match begun.task {
            Task::Start => served.start(&asked, &id, "", REASON).await,
            Task::Stop => served.stop(&asked, &id, REASON).await,
            Task::Nothing => Ok(()),
        };
        served.all().end(&id, begun, done.is_ok(), served.context.now());
        done
    });
    carried_out.await?;
    let location = format!("{BASE}/app_lcm_op_occs/{}", begun.number);
    Ok((StatusCode::ACCEPTED, [(LOCATION, location)]).into_response())
}

async fn occurrences(
    State(served): State<Served>,
    asked: Asked,
    Parameters(parameters): Parameters,
) -> Answer {
    let query = Query::read(OCCURRENCE_ATTRIBUTES, &parameters)?;
    let documents = served.all().occurrence_documents(asked.viewer(), BASE);
    Ok(Json(query.answer(documents)))
}

async fn occurrence(State(served): State<Served>, asked: Asked, Path(id): Path<String>) -> Answer {
    Ok(Json(served.all().occurrence_document(asked.viewer(), &id, BASE)?))
}

/// Returns the kind of subscription in the only parameter, if it is given.
fn kind(parameters: &[(String, String)]) -> Result<Option<SubscriptionType>, LifecycleError> {
    let kind = match parameters {
        [] => return Ok(None),
        [(name, value)] if name == "subscriptionType" => serde_json::from_value(value.as_str().into()).ok(),
        _ => None,
    };
    let reason = "the only parameter is `subscriptionType`: AppInstanceStateChange or AppLcmOpOccStateChange";
    kind.ok_or_else(|| LifecycleError::Invalid(reason.to_owned())).map(Some)
}

async fn subscriptions(
    State(served): State<Served>,
    asked: Asked,
    Base(base): Base,
    Parameters(parameters): Parameters,
) -> Answer {
    let kind = kind(&parameters)?;
    Ok(Json(served.all().subscriptions().list(asked.viewer(), &base, kind)))
}

async fn subscribe(
    State(served): State<Served>,
    asked: Asked,
    Base(base): Base,
    Parameters(parameters): Parameters,
    body: Bytes,
) -> Result<Response, Problem> {
    let subscription = Subscription::read(&body)?;
    if kind(&parameters)?.is_some_and(|kind| kind != subscription.kind()) {
        let reason = "`subscriptionType` is one kind in the query and another in the body";
        return Err(LifecycleError::Invalid(reason.to_owned()).into());
    }
    let allowed = served.callbacks(asked.viewer());
    cotorra_mec::resolve(subscription.callback(), allowed).await.map_err(LifecycleError::from)?;
    let now = served.context.now();
    let (address, document) = served.all().subscriptions().add(asked.viewer(), &base, subscription, now)?;
    Ok((StatusCode::CREATED, [(LOCATION, address)], Json(document)).into_response())
}

async fn subscription(
    State(served): State<Served>,
    asked: Asked,
    Base(base): Base,
    Path(id): Path<String>,
) -> Answer {
    Ok(Json(served.all().subscriptions().document(asked.viewer(), &base, &id)?))
}

async fn unsubscribe(
    State(served): State<Served>,
    asked: Asked,
    Path(id): Path<String>,
) -> Result<StatusCode, Problem> {
    let now = served.context.now();
    served.all().subscriptions().remove(asked.viewer(), &id, now)?;
    Ok(StatusCode::NO_CONTENT)
}
