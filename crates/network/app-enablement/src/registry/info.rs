//! What is registered of a service (ETSI GS MEC 011 v3.1.1, clause 8.1.2), in its JSON form.

use cotorra_mec::{InvalidRequest, LinkType};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use super::Provided;

/// A service (8.1.2.2).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct ServiceInfo {
    /// Assigned by the registry.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ser_instance_id: Option<String>,
    pub ser_name: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ser_category: Option<CategoryRef>,
    pub version: String,
    pub state: ServiceState,
    /// A transport of the platform, which has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub transport_id: Option<String>,
    /// The transport of the application.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub transport_info: Option<TransportInfo>,
    pub serializer: SerializerType,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scope_of_locality: Option<LocalityType>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub consumed_local_only: Option<bool>,
    /// Set by the registry: all of its services are of the consumer's own platform.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub is_local: Option<bool>,
    /// Proposed seconds between heartbeats. The registry wants none, and therefore does not show it.
    #[serde(default, skip_serializing)]
    pub liveness_interval: Option<u32>,
    /// Set by the registry.
    #[serde(rename = "_links", default, skip_serializing_if = "Option::is_none")]
    pub links: Option<LinksOfService>,
}

/// Links of a service. A registry that wants no heartbeats has one link.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LinksOfService {
    #[serde(rename = "self")]
    pub itself: LinkType,
}

impl LinksOfService {
    pub(super) fn to(href: String) -> Self {
        Self { itself: LinkType::to(href) }
    }
}

/// A category of services (8.1.5.2).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CategoryRef {
    pub href: String,
    pub id: String,
    pub name: String,
    pub version: String,
}

/// State of a service (8.1.6.4).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum ServiceState {
    Active,
    Inactive,
    Suspended,
}

/// Format of a service's data (8.1.6.3).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum SerializerType {
    Json,
    Xml,
    Protobuf3,
}

/// Where a service can be consumed (8.1.6.5). Recorded without effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
pub enum LocalityType {
    MecSystem,
    MecHost,
    NfviPop,
    Zone,
    ZoneGroup,
    NfviNode,
}

/// Kind of a transport (8.1.6.2).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
pub enum TransportType {
    RestHttp,
    MbTopicBased,
    MbRouting,
    MbPubsub,
    Rpc,
    RpcStreaming,
    Websocket,
}

/// How a service is reached (8.1.2.3).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct TransportInfo {
    pub id: String,
    pub name: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub description: Option<String>,
    #[serde(rename = "type")]
    pub kind: TransportType,
    pub protocol: String,
    pub version: String,
    pub endpoint: EndPointInfo,
    /// Recorded as it is given.
    pub security: Map<String, Value>,
    /// Recorded as it is given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub impl_specific_info: Option<Map<String, Value>>,
}

/// The address of a service (8.1.5.3): exactly one of these.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
pub enum EndPointInfo {
    Uris(Vec<String>),
    Fqdn(Vec<String>),
    Addresses(Vec<Address>),
    Alternative(Map<String, Value>),
}

/// A host and port.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Address {
    pub host: String,
    pub port: u16,
}

impl ServiceInfo {
    /// Parses the JSON of a service.
    ///
    /// # Errors
    /// [`InvalidRequest::Malformed`] with the place.
    pub fn read(body: &[u8]) -> Result<Self, InvalidRequest> {
        cotorra_mec::read(body)
    }

    /// Checks constraints that the types do not express.
    pub(super) fn check(&self) -> Result<(), InvalidRequest> {
        if self.transport_id.is_some() {
            let none = "the platform has no transports for transportId: give transportInfo";
            return Err(InvalidRequest::Unsupported(none));
        }
        if self.transport_info.is_none() {
            return InvalidRequest::malformed("transportInfo is needed");
        }
        Ok(())
    }

    /// Returns the service as the registry shows it.
    pub(super) fn registered(self, id: u64, links: LinksOfService) -> Self {
        Self { ser_instance_id: Some(id.to_string()), is_local: Some(true), links: Some(links), ..self }
    }

    /// Returns a service of the platform, on the server with this origin.
    pub(super) fn of_platform(of: &Provided, origin: &str, links: LinksOfService) -> Self {
        let uri = format!("{origin}{}", of.path);
        Self {
            ser_instance_id: Some(of.name.to_owned()),
            ser_name: of.name.to_owned(),
            ser_category: Some(CategoryRef {
                href: uri.clone(),
                id: of.standard.to_owned(),
                name: of.name.to_owned(),
                version: of.version.to_owned(),
            }),
            version: of.version.to_owned(),
            state: ServiceState::Active,
            transport_id: None,
            transport_info: Some(TransportInfo {
                id: "http".to_owned(),
                name: "REST".to_owned(),
                description: None,
                kind: TransportType::RestHttp,
                protocol: "HTTP".to_owned(),
                version: "1.1".to_owned(),
                endpoint: EndPointInfo::Uris(vec![uri]),
                security: Map::new(),
                impl_specific_info: None,
            }),
            serializer: SerializerType::Json,
            scope_of_locality: Some(LocalityType::MecHost),
            consumed_local_only: Some(true),
            is_local: Some(true),
            liveness_interval: None,
            links: Some(links),
        }
    }

    /// Returns an attribute as its JSON string.
    pub(super) fn locality(&self) -> Value {
        json!(self.scope_of_locality.unwrap_or(LocalityType::MecHost))
    }
}
