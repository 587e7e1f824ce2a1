//! The error of a run.

use std::io;

use cotorra_graph::NodeId;
use cotorra_recording::RecordingError;

use crate::{
    api::ApiError,
    capture::CaptureError,
    core::script::ScriptError,
    history::recorded::BeginError,
    plugins::PluginError,
    real::{links::RealLinkError, robots::RobotError},
    report::FolderError,
};

/// Error of bringing a testbed up or of finishing its run.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// A file of the run's folder.
    #[error(transparent)]
    Folder(#[from] FolderError),
    /// The history.
    #[error(transparent)]
    History(#[from] cotorra_measurements::Error),
    /// The emulated network's model.
    #[error(transparent)]
    Fabric(#[from] cotorra_fabric::GraphError),
    /// The emulated network's packets.
    #[error(transparent)]
    Datapath(#[from] cotorra_datapath::Error),
    /// The recording, or its live viewers.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The API.
    #[error(transparent)]
    Api(#[from] ApiError),
    /// A capture of packets.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// A plug-in.
    #[error(transparent)]
    Plugin(#[from] PluginError),
    /// Real Wi-Fi software.
    #[error(transparent)]
    Wifi(#[from] crate::wifi::WifiError),
    /// A link over a real interface.
    #[error(transparent)]
    RealLink(#[from] RealLinkError),
    /// A robot.
    #[error(transparent)]
    Robot(#[from] RobotError),
    /// The map for a robot's localization.
    #[error(transparent)]
    NotLocalized(#[from] cotorra_vnfs::NotLocalized),
    /// The script of link conditions.
    #[error(transparent)]
    Script(Box<ScriptError>),
    /// A socket or a thread.
    #[error("cannot {what}: {source}")]
    System {
        /// The failed action.
        what: String,
        /// The system's error.
        source: io::Error,
    },
    /// The run would never end, as in virtual time without walks.
    #[error("the testbed has no walk that would end the run: say how long it is to be, as in `--until 60s`")]
    Endless,
    /// Virtual time has no real machines.
    #[error(
        "`{0}` is a gateway, and virtual time has no real machines: run in real time, or put a server in its place"
    )]
    VirtualGateway(NodeId),
    /// Virtual time has no other cores.
    #[error(
        "the testbed has a border to other cores, and virtual time has none: run in real time, or remove `border` from the testbed file"
    )]
    VirtualBorder,
    /// Virtual time has no real programs.
    #[error(
        "wireless network `{0}` has hostapd and wpa_supplicant, which have no virtual time: simulate its model with \
         `--set wireless.{0}.wifi=model`"
    )]
    VirtualWifi(String),
    /// A policy server computes nothing.
    #[error(
        "`{0}` is a policy server, which models the times of inference: run with `--simulate`, or put a program of yours in \
         its place"
    )]
    RealPolicyServer(cotorra_graph::VnfId),
    /// The fabric carries the packets of sources of traffic, and of nothing else.
    #[error(
        "`{traffic}` is a source of traffic, and {reason}, so that its packets would not go where real ones do: run with \
         `--simulate`, or leave `traffic` out and send real traffic by `cotorra exec NODE iperf3 …`"
    )]
    RealTraffic {
        /// The source.
        traffic: cotorra_graph::TrafficId,
        /// What is in its way.
        reason: String,
    },
    /// This machine has no engine for a container.
    #[error("VNF `{vnf}` starts in a container on `{node}`, and {source}")]
    NoEngine {
        /// The VNF.
        vnf: cotorra_graph::VnfId,
        /// Its node.
        node: NodeId,
        /// The missing thing.
        source: cotorra_containers::NoEngine,
    },
    /// Agents of real servers.
    #[error(transparent)]
    Agents(#[from] crate::real::agents::error::AgentsError),
    /// The core's thread panicked, which is a bug.
    #[error("the run's core panicked; please report this as a bug, with the run's folder")]
    Panicked,
}

impl From<ScriptError> for RunError {
    fn from(error: ScriptError) -> Self {
        Self::Script(Box::new(error))
    }
}

impl From<BeginError> for RunError {
    fn from(error: BeginError) -> Self {
        match error {
            BeginError::History(error) => Self::History(error),
            BeginError::Note(error) => Self::Folder(error),
        }
    }
}

/// Returns the conversion of a system's error while doing `what`.
pub(crate) fn system(what: impl Into<String>) -> impl FnOnce(io::Error) -> RunError {
    let what = what.into();
    move |source| RunError::System { what, source }
}
