//! The state of the API's handlers.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::PathBuf,
    sync::{Arc, mpsc},
};

use axum::Json;
use cotorra_graph::{IpNetwork, NodeId, PluginId, Stamped, Testbed};
use cotorra_measurements::{History, PacedRecorder, RunId};
use cotorra_wais::types::Epoch;
use tokio::sync::broadcast;

use super::types::Failure;
use crate::{clock::Clock, keeping::Keeper, live::Live, message::Message};

/// Threads for queries of the history.
pub(super) const BLOCKING_THREADS: usize = 16;

/// A handler's body, or a failure.
pub(super) type Answer<T> = Result<Json<T>, Failure>;

/// What the API's handlers need.
#[derive(Clone)]
pub(crate) struct Context {
    pub(crate) testbed: Arc<Testbed>,
    pub(crate) live: Live,
    pub(crate) history: Arc<History>,
    pub(crate) run: RunId,
    pub(crate) events: broadcast::Sender<Arc<Stamped>>,
    pub(crate) core: mpsc::Sender<Message>,
    pub(crate) namespaces: Arc<BTreeMap<NodeId, PathBuf>>,
    /// The plug-ins of this run, in process or started by it: nobody else goes by their names.
    pub(crate) hosted: Arc<BTreeSet<PluginId>>,
    /// In virtual time only.
    pub(crate) lockstep: Option<Lockstep>,
    /// What is told was recorded before: the history knows more than the present of the run.
    pub(crate) replay: bool,
    /// Large data of sensors, where any has that.
    pub(crate) keeper: Option<Keeper>,
    pub(crate) wais: WaisOptions,
}

/// What is different in virtual time, which stands still while a plug-in answers.
#[derive(Clone)]
pub(crate) struct Lockstep {
    /// For whom it does; `None` for whoever follows under a name.
    pub(crate) plugins: Option<Arc<BTreeSet<PluginId>>>,
    /// Made durable before the history is asked, so that an answer does not depend on the writer's speed; `None` where
    /// nothing is recorded.
    pub(crate) recorder: Option<PacedRecorder>,
}

/// What the service needs beside what the API knows.
#[derive(Clone, Default)]
pub(crate) struct WaisOptions {
    /// The run's clock; without one it is the time of the last event.
    pub(crate) clock: Option<Clock>,
    /// When the run began; 0 in virtual time.
    pub(crate) epoch: Epoch,
    /// Networks that notifications may be sent to, beside those of the testbed file.
    pub(crate) callbacks: Vec<IpNetwork>,
}
