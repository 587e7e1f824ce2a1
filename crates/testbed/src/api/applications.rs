//! Life cycle of applications over two published interfaces: `/fog05`, the REST routes of Eclipse fog05 v0.2, and
//! `/app_lcm/v1`, ETSI GS MEC 010-2. Both add, move and remove VNFs by instructions, under the caller's name and rights.

mod fog05;
mod mec;

use std::{collections::BTreeMap, sync::Arc};

use axum::{
    Router,
    http::{HeaderMap, StatusCode},
};
use cotorra_graph::{DomainId, Instruction, Node, NodeId, Nodes, Vnf, VnfId, VnfState};
use cotorra_lifecycle::{Application, Applications, LifecycleError, Seen, Stage, fog05::is_node};
use parking_lot::Mutex;

use super::{
    auth::{Caller, Gate},
    context::Context,
    routes::give,
    types::{Failure, InstructionBody},
};
pub(super) use mec::openapi;

use crate::live::Snapshot;

/// Returns the paths of both interfaces.
pub(super) fn serve(context: &Context, gate: Gate) -> Router {
    let served = Served { context: context.clone(), all: Arc::default() };
    Router::new().merge(fog05::router(served.clone(), gate.clone())).merge(mec::router(served, gate))
}

/// The state of the handlers.
#[derive(Clone)]
struct Served {
    context: Context,
    all: Arc<Mutex<Applications>>,
}

/// A rejected request.
struct Rejected {
    status: StatusCode,
    reason: String,
}

impl Rejected {
    fn conflict(reason: impl Into<String>) -> Self {
        Self { status: StatusCode::CONFLICT, reason: reason.into() }
    }
}

impl From<LifecycleError> for Rejected {
    fn from(error: LifecycleError) -> Self {
        let status = match error {
            LifecycleError::Unknown(..) => StatusCode::NOT_FOUND,
            LifecycleError::Conflict(_) => StatusCode::CONFLICT,
            LifecycleError::Invalid(_) | LifecycleError::Descriptor(_) => StatusCode::BAD_REQUEST,
        };
        Self { status, reason: error.to_string() }
    }
}

impl From<Failure> for Rejected {
    fn from(failure: Failure) -> Self {
        let (status, reason) = failure.into_parts();
        Self { status, reason }
    }
}

/// A request's caller, and its headers.
#[derive(Clone)]
struct Asked {
    caller: Caller,
    headers: HeaderMap,
}

impl Asked {
    /// Returns the domain whose applications the caller sees; `None` for all.
    fn viewer(&self) -> Option<&DomainId> {
        self.caller.view().map(crate::domain::DomainView::domain)
    }
}

impl Served {
    /// Returns the servers that a caller sees.
    fn nodes(&self, asked: &Asked) -> impl Iterator<Item = &Node> {
        let seen = |node: &&Node| is_node(node) && asked.caller.keeps(|view| view.owns(&node.id));
        self.context.testbed.graph.nodes.iter().filter(seen)
    }

    /// Returns a server that a caller sees.
    fn node(&self, asked: &Asked, name: &str) -> Result<&Node, Rejected> {
        let missing = || LifecycleError::Unknown("node that runs VNFs,", name.to_owned()).into();
        self.nodes(asked).find(|node| node.id == *name).ok_or_else(missing)
    }

    /// Returns the CPUs and bytes that VNFs take of each node.
    fn taken(&self) -> BTreeMap<NodeId, (f64, u64)> {
        let mut taken = BTreeMap::<_, (f64, u64)>::new();
        self.context.live.read(|now| {
            for placement in now.placements.values() {
                let of_file = || self.context.testbed.vnfs().find(|vnf| vnf.id == placement.vnf);
                let Some(vnf) = now.added.get(&placement.vnf).or_else(of_file) else { continue };
                for node in placement.node.all() {
                    let of_node = taken.entry(node.clone()).or_default();
                    *of_node = (of_node.0 + vnf.cpus, of_node.1 + vnf.memory_bytes);
                }
            }
        });
        taken
    }

    /// Returns what is seen of an instance's VNF.
    fn seen(&self, instance: &Application) -> Seen {
        match &instance.stage {
            Stage::Started(vnf) => self.context.live.read(|now| seen(now, vnf)),
            Stage::Defined | Stage::Configured => Seen::Starting,
        }
    }

    async fn give(&self, asked: &Asked, instruction: Instruction, reason: &str) -> Result<(), Rejected> {
        let body = InstructionBody { instruction, reason: Some(reason.to_owned()) };
        Ok(give(&self.context, &asked.caller, &asked.headers, body).await.map(|_| ())?)
    }

    /// Starts an instance, and waits until its VNF was added or rejected.
    async fn start(&self, asked: &Asked, id: &str, env: &str, reason: &str) -> Result<(), Rejected> {
        let vnf: Vnf = self.all.lock().begin_start(asked.viewer(), id, env)?;
        let name = vnf.id.clone();
        let done = self.give(asked, Instruction::AddVnf { vnf: Box::new(vnf) }, reason).await;
        self.all.lock().end_start(id, done.is_ok().then_some(name));
        done
    }

    /// Stops an instance.
    async fn stop(&self, asked: &Asked, id: &str, reason: &str) -> Result<(), Rejected> {
        let vnf = self.all.lock().begin_stop(asked.viewer(), id)?;
        // Others may have removed its VNF already.
        let is_gone = self.context.live.read(|now| seen(now, &vnf)) == Seen::Gone;
        let done = match is_gone {
            true => Ok(()),
            false => self.give(asked, Instruction::RemoveVnf { vnf }, reason).await,
        };
        self.all.lock().end_stop(id, done.is_ok());
        done
    }

    /// Moves an instance to a node.
    async fn migrate(&self, asked: &Asked, id: &str, to: NodeId, reason: &str) -> Result<(), Rejected> {
        let vnf = self.all.lock().begin_move(asked.viewer(), id)?;
        let done = self.give(asked, Instruction::Place { vnf, node: Nodes::from(to.clone()) }, reason).await;
        self.all.lock().end_move(id, done.is_ok().then_some(to));
        done
    }
}

/// Runs a task to its end, even if the caller does not wait for it: an operation is never left half done.
async fn to_the_end<T: Send + 'static>(
    task: impl Future<Output = Result<T, Rejected>> + Send + 'static,
) -> Result<T, Rejected> {
    let ended = |_| Rejected::from(Failure::ended());
    tokio::spawn(task).await.map_err(ended)?
}

/// Returns what is seen of an added VNF.
fn seen(now: &Snapshot, vnf: &VnfId) -> Seen {
    if !now.added.contains_key(vnf) {
        return Seen::Gone;
    }
    match now.vnfs.get(vnf) {
        None => Seen::Starting,
        Some(last) if last.state == VnfState::Failed => Seen::Failed(last.detail.clone().unwrap_or_default()),
        Some(_) => Seen::Serves,
    }
}
