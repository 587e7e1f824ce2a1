//! Data types of ETSI GS MEC 015 v2.2.1, clause 7.

use serde::{Deserialize, Serialize};

/// An allocation of bandwidth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct BwInfo {
    /// The allocation; set by the service.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub allocation_id: Option<String>,
    /// The application instance.
    pub app_ins_id: String,
    /// Name of the application.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub app_name: Option<String>,
    /// 0 for all packets of the application, 1 for those of a session.
    pub request_type: u8,
    /// The session.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub session_filter: Option<Vec<SessionFilter>>,
    /// Priority, whose values the standard does not define.
    #[serde(rename = "fixedBWPriority", default, skip_serializing_if = "Option::is_none")]
    pub fixed_bw_priority: Option<String>,
    /// Bandwidth, bit/s.
    pub fixed_allocation: String,
    /// Direction of the packets.
    pub allocation_direction: AllocationDirection,
}

/// Changes of an allocation.
#[derive(Debug, Clone, PartialEq, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct BwInfoDeltas {
    /// The allocation.
    #[serde(default)]
    pub allocation_id: Option<String>,
    /// The application instance.
    pub app_ins_id: String,
    /// As in [`BwInfo`].
    pub request_type: u8,
    /// The session.
    #[serde(default)]
    pub session_filter: Option<Vec<SessionFilter>>,
    /// Priority.
    #[serde(rename = "fixedBWPriority", default)]
    pub fixed_bw_priority: Option<String>,
    /// Bandwidth, bit/s.
    #[serde(default)]
    pub fixed_allocation: Option<String>,
    /// Direction of the packets.
    #[serde(default)]
    pub allocation_direction: Option<AllocationDirection>,
}

/// A session: the packets between two addresses.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct SessionFilter {
    /// Source address.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source_ip: Option<String>,
    /// Source port.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source_port: Option<Ports>,
    /// Destination address.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dst_address: Option<String>,
    /// Destination port.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dst_port: Option<Ports>,
    /// Protocol number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub protocol: Option<String>,
}

/// One port, as in v2.2.1, or several, as in v2.1.1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(untagged)]
pub enum Ports {
    /// One.
    One(String),
    /// Several.
    Several(Vec<String>),
}

/// Direction of the packets that an allocation is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub enum AllocationDirection {
    /// Away from the application.
    #[serde(rename = "00")]
    Downlink,
    /// Towards the application.
    #[serde(rename = "01")]
    Uplink,
    /// Both.
    #[serde(rename = "10")]
    Symmetrical,
}
