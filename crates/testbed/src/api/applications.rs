//! Life cycle of applications over two published interfaces: `/fog05`, the REST routes of Eclipse fog05 v0.2, and
//! `/app_lcm/v1`, ETSI GS MEC 010-2. Both add, place and remove VNFs by instructions, under the caller's name and rights, and
//! place the VNFs of services in the same way.

mod fog05;
mod mec;

use std::{
    collections::BTreeMap,
    convert::Infallible,
    fs::{self, File},
    io::{self, Read as _, Seek as _, SeekFrom},
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use axum::{
    Router,
    extract::FromRequestParts,
    http::{HeaderMap, StatusCode, request::Parts},
};
use cotorra_engine::replica_name;
use cotorra_graph::{
    Decision, DomainId, Event, Instruction, Node, NodeId, Timestamp, VnfEvent, VnfId, VnfState,
};
use cotorra_lifecycle::{Applications, LifecycleError, Output, Recipient, Seen, fog05::is_node};
use cotorra_mec::{Allowed, CallbackError, Dispatch, Notifier, Outcome, QueryError, Task, deliver};
use parking_lot::{Mutex, MutexGuard};
use tokio::sync::Notify;
use tokio_stream::StreamExt as _;

use super::{
    auth::{Caller, Gate},
    context::Context,
    routes::give,
    turns::TURNS,
    types::{Failure, InstructionBody},
};
pub(super) use mec::openapi;

use crate::events::stream::Received;

/// Returns the paths of both interfaces, and the tasks that follow the testbed and send notifications.
pub(super) fn serve(context: &Context, gate: Gate) -> (Router, [Task; 2]) {
    let served = Served {
        context: context.clone(),
        all: Arc::new(Mutex::new(applications(context))),
        wake: Arc::default(),
        callbacks: Arc::new([true, false].map(|of_operator| context.callbacks(of_operator))),
    };
    let tasks = [deliver(served.clone()), follow(served.clone())];
    let router = fog05::router(served.clone(), gate.clone()).merge(mec::router(served, gate));
    (router, tasks)
}

/// Returns the applications at a run's begin: the VNFs of its services.
fn applications(context: &Context) -> Applications {
    let mut all = Applications::new(context.wais.epoch);
    let graph = &context.testbed.graph;
    for service in &context.testbed.services {
        // As instructions see it, a service is of its robot's domain.
        let robot = graph.node(&service.robot).filter(|_| graph.domains.len() > 1);
        for vnf in &service.vnfs {
            all.add_service_vnf(robot.map(|robot| robot.domain.clone()), service, vnf);
        }
    }
    all
}

/// The most bytes of an instance's output that are read at once, from its end.
const LONGEST_OUTPUT: u64 = 64 * 1024;

/// The state of the handlers.
#[derive(Clone)]
struct Served {
    context: Context,
    all: Arc<Mutex<Applications>>,
    /// Woken when there may be notifications to send.
    wake: Arc<Notify>,
    /// Networks for callbacks of the operator, and of domains.
    callbacks: Arc<[Allowed; 2]>,
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
            LifecycleError::Callback(CallbackError::Forbidden(_)) | LifecycleError::Full(_) => {
                StatusCode::FORBIDDEN
            }
            LifecycleError::TooOften(_) => StatusCode::TOO_MANY_REQUESTS,
            LifecycleError::Invalid(_) | LifecycleError::Descriptor(_) | LifecycleError::Callback(_) => {
                StatusCode::BAD_REQUEST
            }
        };
        Self { status, reason: error.to_string() }
    }
}

impl From<QueryError> for Rejected {
    fn from(error: QueryError) -> Self {
        Self { status: StatusCode::BAD_REQUEST, reason: error.to_string() }
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

impl FromRequestParts<Served> for Asked {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, _: &Served) -> Result<Self, Infallible> {
        let caller = parts.extensions.get::<Caller>().expect("callers are checked first");
        Ok(Self { caller: caller.clone(), headers: parts.headers.clone() })
    }
}

impl Asked {
    /// Returns the domain whose applications the caller sees; `None` for all.
    fn viewer(&self) -> Option<&DomainId> {
        self.caller.view().map(crate::domain::DomainView::domain)
    }
}

impl Served {
    /// Locks the applications, after a look at their VNFs. What changes is then notified.
    fn all(&self) -> MutexGuard<'_, Applications> {
        let (now, mut all) = (self.context.now(), self.all.lock());
        let vnfs: Vec<_> = all.vnfs().into_iter().cloned().collect();
        self.context.live.read(|snapshot| {
            for vnf in &vnfs {
                let of_file = || self.context.testbed.vnfs().find(|one| one.id == *vnf);
                let Some(known) = snapshot.added.get(vnf).or_else(of_file) else {
                    all.observe(vnf, None, &Seen::Gone, now);
                    continue;
                };
                let placed = snapshot.placements.get(vnf).map_or(&[][..], |placement| placement.node.all());
                all.observe_nodes(vnf, placed, snapshot.wanted.get(vnf).unwrap_or(&known.node), now);
                if let Some((on, seen)) = snapshot.vnfs.get(vnf).and_then(seen_after) {
                    all.observe(vnf, Some(on), &seen, now);
                }
            }
        });
        self.wake.notify_one();
        all
    }

    /// Returns the networks for a caller's callbacks.
    fn callbacks(&self, viewer: Option<&DomainId>) -> &Allowed {
        &self.callbacks[usize::from(viewer.is_some())]
    }

    /// Returns the servers that a caller sees.
    fn nodes(&self, asked: &Asked) -> impl Iterator<Item = &Node> {
        let seen = |node: &&Node| is_node(node) && asked.caller.keeps(|view| view.owns(&node.id));
        self.context.testbed.graph.nodes.iter().filter(seen)
    }

    /// Returns a node that runs VNFs and that a caller sees: a server, a radio unit or a robot.
    fn node(&self, asked: &Asked, name: &str) -> Result<&Node, Rejected> {
        let missing = || LifecycleError::Unknown("node that runs VNFs,", name.to_owned()).into();
        let seen = |node: &&Node| asked.caller.keeps(|view| view.owns(&node.id)) && node.capacity().is_some();
        let mut nodes = self.context.testbed.graph.nodes.iter();
        nodes.find(|node| node.id == *name).filter(seen).ok_or_else(missing)
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

    async fn give(&self, asked: &Asked, instruction: Instruction, reason: &str) -> Result<(), Rejected> {
        let body = InstructionBody { instruction, reason: Some(reason.to_owned()) };
        Ok(give(&self.context, &asked.caller, &asked.headers, body).await.map(|_| ())?)
    }

    /// Starts an instance, and waits until its VNF was added, placed or rejected.
    async fn start(&self, asked: &Asked, id: &str, env: &str, reason: &str) -> Result<(), Rejected> {
        let instruction = self.all().begin_start(asked.viewer(), id, env)?;
        let vnf = match &instruction {
            Instruction::AddVnf { vnf } => Some(vnf.id.clone()),
            Instruction::Place { vnf, .. } => Some(vnf.clone()),
            _ => None,
        };
        let started = vnf.map(|vnf| (vnf.clone(), self.log_length(&vnf)));
        let done = self.give(asked, instruction, reason).await;
        self.all().end_start(id, started.filter(|_| done.is_ok()), self.context.now());
        // It may serve already.
        drop(self.all());
        done
    }

    /// Stops an instance.
    async fn stop(&self, asked: &Asked, id: &str, reason: &str) -> Result<(), Rejected> {
        let instruction = self.all().begin_stop(asked.viewer(), id)?;
        // Once it is removed, a VNF of another may get its name and write there.
        let written = match &instruction {
            Some(Instruction::RemoveVnf { vnf }) => self.log_length(vnf),
            _ => 0,
        };
        let done = match instruction {
            Some(instruction) => self.give(asked, instruction, reason).await,
            // Others have removed its VNF already.
            None => Ok(()),
        };
        self.all().end_stop(id, done.is_ok().then_some(written), self.context.now());
        done
    }

    /// Returns the log of a VNF with one instance; `None` if no program runs.
    fn log(&self, vnf: &VnfId) -> Option<PathBuf> {
        Some(self.context.logs.as_ref()?.join(format!("{}.log", replica_name(vnf, 0))))
    }

    /// Returns the length of a VNF's log so far, bytes.
    fn log_length(&self, vnf: &VnfId) -> u64 {
        let metadata = self.log(vnf).and_then(|log| fs::metadata(log).ok());
        metadata.map_or(0, |metadata| metadata.len())
    }

    /// Returns the end of what an instance wrote since its last start.
    async fn output(&self, asked: &Asked, id: &str) -> Result<String, Rejected> {
        let (output, node) = {
            let all = self.all();
            let node = all.instance(asked.viewer(), id)?.node.clone();
            (all.output(asked.viewer(), id)?.clone(), node)
        };
        let agent = node.and_then(|node| self.context.testbed.graph.node(&node)?.real_server());
        if agent.is_some() {
            return Err(Rejected::conflict(format!(
                "the output of the instance `{id}` is at the agent of its node"
            )));
        }
        let no_program = || Rejected::conflict("no program runs in virtual time, so that there is no output");
        let log = self.log(&output.vnf).ok_or_else(no_program)?;
        let turn = TURNS.take(asked.caller.whose()).await;
        let read = tokio::task::spawn_blocking(move || tail(&log, &output)).await;
        drop(turn);
        let read = read.map_err(|_| Failure::ended())?;
        read.map_err(|error| Rejected::conflict(format!("the output of the instance `{id}`: {error}")))
    }

    /// Moves an instance to a node.
    async fn migrate(&self, asked: &Asked, id: &str, to: NodeId, reason: &str) -> Result<(), Rejected> {
        let instruction = self.all().begin_move(asked.viewer(), id, to)?;
        let done = self.give(asked, instruction, reason).await;
        self.all().end_move(id);
        done
    }
}

/// Reads the end of an instance's part of a log, of at most [`LONGEST_OUTPUT`].
fn tail(log: &Path, output: &Output) -> io::Result<String> {
    let mut log = match File::open(log) {
        // It has not written anything yet.
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(String::new()),
        log => log?,
    };
    let to = output.to.map_or_else(|| log.metadata().map(|metadata| metadata.len()), Ok)?;
    let from = output.from.max(to.saturating_sub(LONGEST_OUTPUT));
    log.seek(SeekFrom::Start(from))?;
    let mut bytes = Vec::new();
    log.take(to.saturating_sub(from)).read_to_end(&mut bytes)?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

/// Runs a task to its end, even if the caller does not wait for it: an operation is never left half done.
async fn to_the_end<T: Send + 'static>(
    task: impl Future<Output = Result<T, Rejected>> + Send + 'static,
) -> Result<T, Rejected> {
    let ended = |_| Rejected::from(Failure::ended());
    tokio::spawn(task).await.map_err(ended)?
}

/// Returns the node of an instance and what is seen of it after an event of its VNF; `None` if the event says nothing of an
/// instance that goes on.
fn seen_after(last: &VnfEvent) -> Option<(&NodeId, Seen)> {
    let seen = match last.state {
        VnfState::Started => Seen::Serves,
        VnfState::Died => Seen::Restarts,
        VnfState::Failed => Seen::Failed(last.detail.clone().unwrap_or_default()),
        // It was moved, and serves elsewhere, or it was removed.
        VnfState::Stopped => return None,
    };
    Some((&last.node, seen))
}

/// Returns the task that follows the testbed's events: each state of a VNF is seen, however short it is.
fn follow(served: Served) -> Task {
    let mut events = served.context.events.subscribe();
    Box::pin(async move {
        loop {
            let event = match events.next().await {
                Some(Received::Event(stamped)) => stamped,
                Some(Received::Missed(_)) => {
                    drop(served.all());
                    continue;
                }
                // The run has ended.
                None => std::future::pending().await,
            };
            let now = || served.context.now();
            match &event.event {
                Event::Vnf(event) => {
                    let Some((on, seen)) = seen_after(event) else { continue };
                    served.all.lock().observe(&event.vnf, Some(on), &seen, now());
                }
                Event::Decision(Decision {
                    instruction: Instruction::RemoveVnf { vnf },
                    refused: None,
                    ..
                }) => served.all.lock().observe(vnf, None, &Seen::Gone, now()),
                // Instances go with their nodes.
                Event::Placement(_) => drop(served.all()),
                _ => continue,
            }
            served.wake.notify_one();
        }
    })
}

impl Notifier for Served {
    type Target = Recipient;

    fn poll(&self) -> (Vec<Dispatch<Recipient>>, Option<Duration>) {
        let (now, mut all) = (self.context.now(), self.all.lock());
        let subscriptions = all.subscriptions();
        let dispatches = subscriptions.poll(now);
        let complaints = subscriptions.take_complaints();
        // In virtual time a deadline may stand still: this must not become a busy loop.
        let wait = |deadline: Timestamp| deadline.since(now).max(Duration::from_millis(1));
        let wait = subscriptions.deadline().map(wait);
        drop(all);
        complaints.into_iter().for_each(|complaint| self.context.tell(complaint));
        (dispatches, wait)
    }

    async fn woken(&self) {
        self.wake.notified().await;
    }

    async fn send(&self, Dispatch { target, body, .. }: Dispatch<Recipient>) -> Outcome {
        cotorra_mec::post(&target.callback, self.callbacks(target.owner.as_ref()), body).await
    }

    fn done(&self, subscription: u64, attempt: u64, outcome: Outcome) {
        let now = self.context.now();
        self.all.lock().subscriptions().done(subscription, attempt, outcome, now);
        self.wake.notify_one();
    }
}
