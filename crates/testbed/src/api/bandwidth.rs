//! `/bwm/v1`, the Bandwidth Management API (ETSI GS MEC 015), for all of the testbed, and below `/domains/{name}` for a domain and
//! its applications. Allocations become mappings, by instructions under the caller's name and rights.

use std::sync::Arc;

use axum::{
    Extension, Router,
    extract::{Path, State},
    http::{HeaderMap, StatusCode, request::Parts},
    response::{IntoResponse, Response},
    routing::get,
};
use cotorra_bandwidth::{Bandwidth, Change, Consumer, Mapped, Seen, Selection, Survey, types::BwInfo};
use cotorra_graph::{Decision, Event, Instruction, VnfId, VnfState};
use cotorra_mec::{Json, Parameters, Problem, Resource, Task, changed, created, if_match, json, read, shown};
use tokio::sync::{Mutex, MutexGuard};
use tokio_stream::StreamExt as _;

use super::{auth::Caller, context::Context, routes::give, types::InstructionBody};
use crate::{
    domain::DomainView,
    events::{live::Snapshot, stream::Received},
};

/// Path of the service, below that of a domain.
pub(super) const PATH: &str = "/bwm/v1";
/// Reason of decisions.
const REASON: &str = "MEC 015";

/// The allocations of a run, which all consumers share.
#[derive(Clone)]
pub(super) struct Allocations {
    context: Context,
    /// A change holds them until the core has carried it out.
    all: Arc<Mutex<Bandwidth>>,
}

/// The service as one path has it: for the operator, or for a domain with its applications.
#[derive(Clone)]
struct Served {
    allocations: Allocations,
    view: Option<Arc<DomainView>>,
    prefix: String,
}

impl Allocations {
    pub(super) fn new(context: &Context) -> Self {
        let all = Bandwidth::new(Arc::clone(&context.testbed));
        Self { context: context.clone(), all: Arc::new(Mutex::new(all)) }
    }

    /// Returns the service's paths below a prefix: for the operator, or for the domain of a view.
    pub(super) fn router(&self, prefix: String, view: Option<&Arc<DomainView>>) -> Router {
        let no_path = || async { Problem::new(StatusCode::NOT_FOUND, "there is no such path here") };
        Router::new()
            .route("/bw_allocations", get(list).post(create))
            .route("/bw_allocations/{id}", get(show).put(replace).patch(modify).delete(remove))
            .fallback(no_path)
            .with_state(Served { allocations: self.clone(), view: view.cloned(), prefix })
    }

    /// Returns the task that ends the allocations of applications as these end. In virtual time there is none: what the core
    /// gets must not depend on the speed of this thread. There they end at the next request.
    pub(super) fn follow(&self) -> Option<Task> {
        if self.context.lockstep.is_some() {
            return None;
        }
        let (allocations, mut events) = (self.clone(), self.context.events.subscribe());
        Some(Box::pin(async move {
            while let Some(received) = events.next().await {
                let may_end = match received {
                    Received::Event(stamped) => may_end(&stamped.event),
                    Received::Missed(_) => true,
                };
                if may_end {
                    drop(allocations.lock().await);
                }
            }
            // A task of this thread never ends.
            std::future::pending::<()>().await;
        }))
    }

    /// Locks the allocations, without those that have ended.
    async fn lock(&self) -> MutexGuard<'_, Bandwidth> {
        let mut all = self.all.lock().await;
        if !all.is_empty() {
            let now = self.survey(|_, _| true);
            for (change, why) in all.ended(&now) {
                for instruction in change.instructions() {
                    let reason = format!("{REASON}: {why}");
                    let body = InstructionBody { instruction, reason: Some(reason) };
                    // The testbed itself ends it. A mapping that is gone already needs no end.
                    let _ = give(&self.context, &Caller::default(), &HeaderMap::new(), body).await;
                }
                all.commit("", change);
            }
        }
        all
    }

    /// Surveys the testbed, with the placements of some VNFs.
    fn survey(&self, has: impl Fn(&Snapshot, &VnfId) -> bool) -> Survey {
        let at = self.context.now();
        self.context.live.read(|now| {
            let placed = now.placements.values().filter(|placed| has(now, &placed.vnf));
            let attached = now.robots.iter();
            let mapped = |(ends, (links, reservation)): (&[_; 2], &(Vec<_>, _))| {
                (ends.clone(), Mapped { links: links.clone(), reservation: *reservation })
            };
            Survey {
                at,
                nodes: placed.map(|placed| (placed.vnf.clone(), placed.node.all().to_vec())).collect(),
                attached: attached
                    .filter_map(|(robot, context)| Some((robot.clone(), context.attached_to()?.clone())))
                    .collect(),
                mapped: now.mapped.iter().map(mapped).collect(),
            }
        })
    }
}

/// Whether an event may end an allocation.
fn may_end(event: &Event) -> bool {
    match event {
        Event::Placement(_) => true,
        Event::Vnf(event) => event.state == VnfState::Stopped,
        Event::Decision(Decision { instruction, refused: None, .. }) => {
            matches!(instruction, Instruction::Map { .. } | Instruction::RemoveVnf { .. })
        }
        _ => false,
    }
}

/// The caller of a request, and the URI under which it reaches the service.
struct Asked {
    caller: Caller,
    consumer: Consumer,
    headers: HeaderMap,
    base: String,
}

impl axum::extract::FromRequestParts<Served> for Asked {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, served: &Served) -> Result<Self, Problem> {
        let caller = Extension::<Caller>::from_request_parts(parts, served).await;
        let Extension(caller) = caller.expect("the gate has identified the caller");
        let base = format!("http://{}{}", cotorra_mec::authority(parts)?, served.prefix);
        let domain = served.view.as_ref().map(|view| view.domain().clone());
        let consumer = match (domain, caller.application()) {
            (None, _) => Consumer::Operator,
            (Some(domain), None) => Consumer::Domain(domain),
            (Some(domain), Some(application)) => Consumer::Application(domain, application.clone()),
        };
        Ok(Self { caller, consumer, headers: parts.headers.clone(), base })
    }
}

type Answer = Result<Response, Problem>;

impl Served {
    fn context(&self) -> &Context {
        &self.allocations.context
    }

    /// Plans a change for a caller, and carries it out.
    async fn change<E: Into<Problem>>(
        &self,
        asked: &Asked,
        plan: impl FnOnce(&mut Bandwidth, Seen<'_>) -> Result<Change, E>,
    ) -> Result<Option<Resource<BwInfo>>, Problem> {
        let mut all = self.allocations.lock().await;
        let survey = self.allocations.survey(|now, vnf| {
            let added = |vnf: &_| now.nodes_of_added(vnf).map(|nodes| nodes.all().to_vec());
            self.view.as_ref().is_none_or(|view| view.has_vnf(vnf, added))
        });
        let part = self.view.as_ref().map_or(&*self.context().testbed, |view| view.testbed());
        let seen = Seen { consumer: &asked.consumer, part, survey: &survey };
        let change = plan(&mut all, seen).map_err(Into::into)?;
        self.carry_out(asked, &mut all, change).await
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

    async fn give(&self, asked: &Asked, instruction: Instruction) -> Result<(), Problem> {
        if let Some(view) = &self.view {
            // Also for the operator, who acts for the domain here.
            view.check(&instruction, |_| None).map_err(|error| Problem::forbidden(error.to_string()))?;
        }
        // An application cannot use the name of a plug-in.
        let (headers, reason) = match asked.caller.application() {
            Some(application) => (&HeaderMap::new(), format!("{REASON}: by `{application}`")),
            None => (&asked.headers, REASON.to_owned()),
        };
        let body = InstructionBody { instruction, reason: Some(reason) };
        let done = give(self.context(), &asked.caller, headers, body).await;
        done.map(|_| ()).map_err(|failure| match failure.into_parts() {
            // The standard has no conflicts.
            (StatusCode::CONFLICT, reason) => Problem::forbidden(reason),
            (status, reason) => Problem::new(status, reason),
        })
    }
}

async fn list(State(served): State<Served>, asked: Asked, Parameters(given): Parameters) -> Answer {
    let selection = Selection::read(&given)?;
    Ok(json(&served.allocations.lock().await.list(&asked.consumer, &selection)))
}

async fn create(State(served): State<Served>, asked: Asked, Json(body): Json) -> Answer {
    let info = read(&body)?;
    let resource = served.change(&asked, |all, seen| all.create(seen, info)).await?;
    Ok(resource.map_or_else(|| StatusCode::NO_CONTENT.into_response(), |resource| created(&resource)))
}

async fn show(State(served): State<Served>, Path(id): Path<String>, asked: Asked) -> Answer {
    let all = served.allocations.lock().await;
    Ok(shown(&asked.headers, &all.get(&asked.consumer, &asked.base, &id)?))
}

async fn replace(
    State(served): State<Served>,
    Path(id): Path<String>,
    asked: Asked,
    Json(body): Json,
) -> Answer {
    let (info, unchanged) = (read(&body)?, if_match(&asked.headers));
    end(served.change(&asked, |all, seen| all.replace(seen, &id, unchanged, info)).await?)
}

async fn modify(
    State(served): State<Served>,
    Path(id): Path<String>,
    asked: Asked,
    Json(body): Json,
) -> Answer {
    let (deltas, unchanged) = (read(&body)?, if_match(&asked.headers));
    end(served.change(&asked, |all, seen| all.modify(seen, &id, unchanged, deltas)).await?)
}

async fn remove(State(served): State<Served>, Path(id): Path<String>, asked: Asked) -> Answer {
    let unchanged = if_match(&asked.headers);
    end(served.change(&asked, |all, seen| all.remove(seen, &id, unchanged)).await?)
}

/// Answers with an allocation, or without one that has ended.
fn end(resource: Option<Resource<BwInfo>>) -> Answer {
    Ok(resource.map_or_else(|| StatusCode::NO_CONTENT.into_response(), |resource| changed(&resource)))
}
