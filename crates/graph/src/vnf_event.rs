//! Life cycle of VNFs' processes.

use serde::{Deserialize, Serialize};

use crate::id::{NodeId, VnfId};

/// Change of a VNF's process.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct VnfEvent {
    /// The VNF.
    pub vnf: VnfId,
    /// Its node.
    pub node: NodeId,
    /// Its new state.
    pub state: VnfState,
    /// Exit status or error, for people.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub detail: Option<String>,
}

/// State of a VNF's process.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum VnfState {
    /// The process runs.
    Started,
    /// The process ended by itself, and will be started again.
    Died,
    /// The process was stopped.
    Stopped,
    /// The process cannot be started.
    Failed,
}

impl VnfState {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Started, Self::Died, Self::Stopped, Self::Failed];

    /// Returns the name in JSON.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Started => "started",
            Self::Died => "died",
            Self::Stopped => "stopped",
            Self::Failed => "failed",
        }
    }
}
