//! The state of the API's handlers.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::PathBuf,
    sync::{Arc, mpsc},
};

use axum::Json;
use cotorra_graph::{Event, IpNetwork, NodeId, PluginId, Stamped, Testbed, Timestamp};
use cotorra_measurements::{History, PacedRecorder, RunId};
use cotorra_mec::{Allowed, Epoch};

use super::types::Failure;
use crate::{
    capture::Wiretap,
    clock::Clock,
    core::message::Message,
    events::{distant::DistantStream, live::Live, stream::EventStream},
    history::keeping::Keeper,
    report::{Fidelity, ServiceKpis},
};

/// Threads that read files and the history; [`super::turns`] shares them out.
pub(super) const BLOCKING_THREADS: usize = 16;

/// A handler's body, or a failure.
pub(super) type Answer<T> = Result<Json<T>, Failure>;

/// The state of the API's handlers.
#[derive(Clone)]
pub(crate) struct Context {
    pub(crate) testbed: Arc<Testbed>,
    pub(crate) live: Live,
    pub(crate) history: Arc<History>,
    pub(crate) run: RunId,
    pub(crate) events: EventStream,
    pub(crate) core: mpsc::Sender<Message>,
    pub(crate) namespaces: Arc<BTreeMap<NodeId, PathBuf>>,
    /// The plug-ins of this run, in process or started by it. No other caller can use their names.
    pub(crate) hosted: Arc<BTreeSet<PluginId>>,
    /// Set in virtual time only.
    pub(crate) lockstep: Option<Lockstep>,
    /// Streams of plug-ins that are programs and away from the core, in real time.
    pub(crate) distant: Arc<BTreeMap<PluginId, DistantStream>>,
    /// Whether events come from a recording: the history then reaches beyond the present of the run.
    pub(crate) replay: bool,
    /// Whether the pace of time can be changed.
    pub(crate) paced: bool,
    /// The verdict on a recorded run, if its folder has one.
    pub(crate) verdict: Option<Fidelity>,
    /// The KPIs of a recorded run's services, as its folder has them.
    pub(crate) kpis: Vec<ServiceKpis>,
    /// Large data of sensors, if any sensor has such.
    pub(crate) keeper: Option<Keeper>,
    pub(crate) wais: WaisOptions,
    /// Folder of the output of VNFs; `None` if no program of theirs runs.
    pub(crate) logs: Option<PathBuf>,
    /// Access to packets; `None` if there are none.
    pub(crate) wiretap: Option<Wiretap>,
}

impl Context {
    /// Returns the time of the run.
    pub(super) fn now(&self) -> Timestamp {
        match &self.wais.clock {
            Some(clock) => clock(),
            None => self.live.read(|now| now.at),
        }
    }

    /// Returns the networks that notifications may be sent to. A domain may not make this machine post to other services
    /// on it.
    pub(super) fn callbacks(&self, of_operator: bool) -> Allowed {
        let named = self.testbed.wais.callbacks.iter().chain(&self.wais.callbacks).copied();
        let allowed = Allowed::new(named);
        if of_operator { allowed.and_loopback() } else { allowed }
    }

    /// Reports a message to the operator.
    pub(super) fn tell(&self, message: String) {
        tracing::warn!("{message}");
        let event = Event::Notice { message };
        // The run may have ended already.
        let _ = self.core.send(Message::Network(Stamped { at: self.now(), event }));
    }
}

/// The difference in virtual time, which stands still while a plug-in answers.
#[derive(Clone)]
pub(crate) struct Lockstep {
    /// The plug-ins that time waits for; `None` for every follower with a name.
    pub(crate) plugins: Option<Arc<BTreeSet<PluginId>>>,
    /// Flushed before a query of the history, so that answers do not depend on the writer's speed. `None` if nothing is
    /// recorded.
    pub(crate) recorder: Option<PacedRecorder>,
}

/// Options of the services of ETSI MEC.
#[derive(Clone, Default)]
pub(crate) struct WaisOptions {
    /// The run's clock; without one the time is that of the last event.
    pub(crate) clock: Option<Clock>,
    /// Calendar time of the run's beginning; 0 in virtual time.
    pub(crate) epoch: Epoch,
    /// Networks that notifications may be sent to, beside those of the testbed file.
    pub(crate) callbacks: Vec<IpNetwork>,
}
