//! `/bwm/v1`, the Bandwidth Management API (ETSI GS MEC 015). Allocations become mappings, by instructions under the caller's name
//! and rights.

use std::sync::Arc;

use axum::{
    Extension, Router,
    extract::{Path, State},
    http::{HeaderMap, StatusCode, request::Parts},
    middleware,
    response::{IntoResponse, Response},
    routing::get,
};
use cotorra_bandwidth::{Bandwidth, Change, Selection, Survey, types::BwInfo};
use cotorra_graph::{Instruction, PathKind};
use cotorra_mec::{Json, Parameters, Problem, Resource, changed, created, if_match, json, read, shown};
use tokio::sync::Mutex;

use super::{
    auth::{self, Caller, Gate},
    context::Context,
    routes::give,
    types::InstructionBody,
};

const BASE: &str = "/bwm/v1";
/// Reason of decisions.
const REASON: &str = "MEC 015";

/// Returns the service's paths.
pub(super) fn serve(context: &Context, gate: Gate) -> Router {
    let all = Arc::new(Mutex::new(Bandwidth::new(Arc::clone(&context.testbed))));
    let no_path = || async { Problem::new(StatusCode::NOT_FOUND, "there is no such path here") };
    let routes = Router::new()
        .route("/bw_allocations", get(list).post(create))
        .route("/bw_allocations/{id}", get(show).put(replace).patch(modify).delete(remove))
        .fallback(no_path)
        .with_state(Served { context: context.clone(), all });
    Router::new().nest(BASE, routes).layer(middleware::from_fn_with_state(gate, auth::check_mec))
}

/// The state of the handlers. A change holds the allocations until the core has carried it out.
#[derive(Clone)]
struct Served {
    context: Context,
    all: Arc<Mutex<Bandwidth>>,
}

/// The caller of a request, and the URI under which it reaches the service.
struct Asked {
    caller: Caller,
    headers: HeaderMap,
    base: String,
}

impl axum::extract::FromRequestParts<Served> for Asked {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, served: &Served) -> Result<Self, Problem> {
        let caller = Extension::<Caller>::from_request_parts(parts, served).await;
        let Extension(caller) = caller.expect("the gate has identified the caller");
        let base = format!("http://{}{BASE}", cotorra_mec::authority(parts)?);
        Ok(Self { caller, headers: parts.headers.clone(), base })
    }
}

type Answer = Result<Response, Problem>;

impl Served {
    fn survey(&self) -> Survey {
        self.context.live.read(|now| {
            let placed = now.placements.values();
            let attached = now.robots.iter();
            let mapped = now.virtual_links.iter().filter(|link| link.path != PathKind::Shortest);
            Survey {
                nodes: placed.map(|placed| (placed.vnf.clone(), placed.node.all().to_vec())).collect(),
                attached: attached
                    .filter_map(|(robot, context)| Some((robot.clone(), context.attached_to()?.clone())))
                    .collect(),
                mapped: mapped.map(|link| (link.from.clone(), link.to.clone())).collect(),
            }
        })
    }

    async fn give(&self, asked: &Asked, instruction: Instruction) -> Result<(), Problem> {
        let body = InstructionBody { instruction, reason: Some(REASON.to_owned()) };
        let done = give(&self.context, &asked.caller, &asked.headers, body).await;
        done.map(|_| ()).map_err(|failure| match failure.into_parts() {
            // The standard has no conflicts.
            (StatusCode::CONFLICT, reason) => Problem::forbidden(reason),
            (status, reason) => Problem::new(status, reason),
        })
    }

    /// Brings a change about. If the core rejects a part of it, nothing has changed.
    async fn carry_out(
        &self,
        asked: &Asked,
        all: &mut Bandwidth,
        change: Change,
    ) -> Result<Option<Resource<BwInfo>>, Problem> {
        for (done, instruction) in change.instructions().enumerate() {
            if let Err(problem) = self.give(asked, instruction).await {
                for instruction in change.undo(done) {
                    // What was in force before has room again.
                    let _ = self.give(asked, instruction).await;
                }
                return Err(problem);
            }
        }
        Ok(all.commit(&asked.base, change))
    }
}

async fn list(State(served): State<Served>, Parameters(given): Parameters) -> Answer {
    let selection = Selection::read(&given)?;
    Ok(json(&served.all.lock().await.list(&selection)))
}

async fn create(State(served): State<Served>, asked: Asked, Json(body): Json) -> Answer {
    let info = read(&body)?;
    let mut all = served.all.lock().await;
    let change = all.create(&served.survey(), info)?;
    let resource = served.carry_out(&asked, &mut all, change).await?;
    Ok(resource.map_or_else(|| StatusCode::NO_CONTENT.into_response(), |resource| created(&resource)))
}

async fn show(State(served): State<Served>, Path(id): Path<String>, asked: Asked) -> Answer {
    Ok(shown(&asked.headers, &served.all.lock().await.get(&asked.base, &id)?))
}

async fn replace(
    State(served): State<Served>,
    Path(id): Path<String>,
    asked: Asked,
    Json(body): Json,
) -> Answer {
    let info = read(&body)?;
    let mut all = served.all.lock().await;
    let change = all.replace(&served.survey(), &id, if_match(&asked.headers), info)?;
    end(served.carry_out(&asked, &mut all, change).await?)
}

async fn modify(
    State(served): State<Served>,
    Path(id): Path<String>,
    asked: Asked,
    Json(body): Json,
) -> Answer {
    let deltas = read(&body)?;
    let mut all = served.all.lock().await;
    let change = all.modify(&served.survey(), &id, if_match(&asked.headers), deltas)?;
    end(served.carry_out(&asked, &mut all, change).await?)
}

async fn remove(State(served): State<Served>, Path(id): Path<String>, asked: Asked) -> Answer {
    let mut all = served.all.lock().await;
    let change = all.remove(&id, if_match(&asked.headers))?;
    end(served.carry_out(&asked, &mut all, change).await?)
}

/// Answers with an allocation, or without one that has ended.
fn end(resource: Option<Resource<BwInfo>>) -> Answer {
    Ok(resource.map_or_else(|| StatusCode::NO_CONTENT.into_response(), |resource| changed(&resource)))
}
