//! Registrations of applications for mobility (ETSI GS MEC 021 v2.2.1, clause 7.2.2), in their JSON form.

use cotorra_mec::InvalidRequest;
use serde::{Deserialize, Serialize};

/// A registration (7.2.2).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct RegistrationInfo {
    /// Assigned by the service.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    app_mobility_service_id: Option<String>,
    service_consumer_id: ServiceConsumerId,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    device_information: Vec<DeviceInformation>,
    /// Seconds until it expires; 0 for never.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    expiry_time: Option<u32>,
}

/// The application that is registered.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
struct ServiceConsumerId {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    app_instance_id: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    mep_id: Option<String>,
}

/// A device that the application serves. Recorded without effect.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
struct DeviceInformation {
    associate_id: AssociateId,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    app_mobility_service_level: Option<u8>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    context_transfer_state: Option<u8>,
}

/// Identifier of a device (ETSI GS MEC 012, 6.5.4).
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub(crate) struct AssociateId {
    /// Kind of the identifier.
    #[serde(rename = "type")]
    pub(crate) kind: AssociateType,
    pub(crate) value: String,
}

/// Kind of a device's identifier. The testbed knows devices by their IPv4 addresses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub(crate) enum AssociateType {
    #[serde(rename = "UE_IPv4_ADDRESS")]
    Ipv4,
    #[serde(rename = "UE_IPV6_ADDRESS")]
    Ipv6,
    #[serde(rename = "NATED_IP_ADDRESS")]
    Nated,
    #[serde(rename = "GTP_TEID")]
    Tunnel,
}

impl RegistrationInfo {
    /// Parses the JSON of a registration.
    ///
    /// # Errors
    /// [`InvalidRequest`].
    pub fn read(body: &[u8]) -> Result<Self, InvalidRequest> {
        let info: Self = cotorra_mec::read(body)?;
        info.application()?;
        if info.expiry_time.is_some_and(|seconds| seconds != 0) {
            return Err(InvalidRequest::Unsupported(
                "a registration ends with its application: expiryTime is 0",
            ));
        }
        Ok(info)
    }

    /// Returns the application that is registered.
    pub(super) fn application(&self) -> Result<&str, InvalidRequest> {
        let id = self.service_consumer_id.app_instance_id.as_deref();
        id.ok_or_else(|| InvalidRequest::Malformed("serviceConsumerId needs appInstanceId".to_owned()))
    }

    pub(super) fn with_id(self, id: u64) -> Self {
        Self { app_mobility_service_id: Some(id.to_string()), ..self }
    }
}
