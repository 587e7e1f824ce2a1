//! Requests and documents of ETSI GS MEC 010-2 v2.1.1, application life cycle management.

use cotorra_graph::{DomainId, NodeId, Timestamp};
use cotorra_mec::Attribute;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::{
    application::{Application, Stage},
    applications::Applications,
    descriptor::Descriptor,
    error::LifecycleError,
    operation::{PROVIDER, State, VERSION},
};

pub use crate::operation::{Occurrence, Operation, OperationState, read};

/// Longest name or description of an instance, bytes.
const LONGEST_TEXT: usize = 1024;

/// CreateAppInstanceRequest (6.2.2.3).
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct CreateRequest {
    /// Descriptor: its identifier in the catalog, or its own name.
    #[serde(rename = "appDId")]
    app_d_id: String,
    #[serde(default)]
    app_instance_name: Option<String>,
    #[serde(default)]
    app_instance_description: Option<String>,
}

/// InstantiateAppRequest (6.2.2.7).
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
struct InstantiateRequest {
    #[serde(rename = "selectedMECHostInfo")]
    selected_mec_host_info: Vec<HostInformation>,
    #[serde(default)]
    location_constraints: Value,
    #[serde(default)]
    vim_connection_info: Value,
    #[serde(default)]
    virtual_compute_descriptor: Value,
    #[serde(default)]
    virtual_storage_descriptor: Value,
}

/// MECHostInformation (6.2.2.17).
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
struct HostInformation {
    #[serde(default)]
    host_name: Option<String>,
    /// Any pairs. One named `node` names the node.
    host_id: Value,
}

/// OperateAppRequest (6.2.2.8).
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
struct OperateRequest {
    change_state_to: Change,
    #[serde(default)]
    stop_type: Option<StopType>,
    #[serde(default)]
    graceful_stop_timeout: Option<u32>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
enum Change {
    Started,
    Stopped,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
enum StopType {
    Forceful,
    Graceful,
}

/// TerminateAppRequest (6.2.2.9).
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
struct TerminateRequest {
    termination_type: StopType,
    #[serde(default)]
    graceful_termination_timeout: Option<u32>,
}

/// A request for an operation.
#[derive(Debug, Clone)]
pub struct OperationRequest(Wanted);

#[derive(Debug, Clone)]
enum Wanted {
    Instantiate(NodeId),
    Operate(Change),
    Terminate,
}

/// The request of an operation to the testbed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Task {
    /// Start the instance.
    Start,
    /// Stop the instance.
    Stop,
    /// Nothing: it is stopped.
    Nothing,
}

/// An operation that was begun.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Begun {
    /// Number of its occurrence.
    pub number: u64,
    /// Its kind.
    pub operation: Operation,
    /// The work to do.
    pub task: Task,
}

fn invalid<T>(reason: impl Into<String>) -> Result<T, LifecycleError> {
    Err(LifecycleError::Invalid(reason.into()))
}

/// Whether a value is absent, or says nothing.
fn is_absent(value: &Value) -> bool {
    matches!(value, Value::Null) || value.as_array().is_some_and(Vec::is_empty)
}

impl InstantiateRequest {
    /// Returns the selected node.
    fn node(&self) -> Result<NodeId, LifecycleError> {
        for (key, value) in [
            ("locationConstraints", &self.location_constraints),
            ("vimConnectionInfo", &self.vim_connection_info),
            ("virtualComputeDescriptor", &self.virtual_compute_descriptor),
            ("virtualStorageDescriptor", &self.virtual_storage_descriptor),
        ] {
            if !is_absent(value) {
                return invalid(format!(
                    "`{key}` cannot be honoured here: the descriptor says what is needed"
                ));
            }
        }
        let [host] = &self.selected_mec_host_info[..] else {
            return invalid("`selectedMECHostInfo` selects one host here");
        };
        let by_id = || match &host.host_id {
            Value::String(name) => Some(name.as_str()),
            Value::Object(pairs) => pairs.get("node").and_then(Value::as_str),
            _ => None,
        };
        let name = host.host_name.as_deref().or_else(by_id);
        let name = name.ok_or_else(|| {
            let reason = "name the node as `hostName`, or as `node` of `hostId`";
            LifecycleError::Invalid(reason.to_owned())
        })?;
        NodeId::new(name).map_err(|error| LifecycleError::Invalid(error.to_string()))
    }
}

impl OperateRequest {
    /// Returns the wanted state.
    fn change(&self) -> Result<Change, LifecycleError> {
        let graceful = self.stop_type == Some(StopType::Graceful);
        if self.change_state_to == Change::Started && self.stop_type.is_some() {
            return invalid("`stopType` is for `changeStateTo` STOPPED only");
        }
        if graceful != self.graceful_stop_timeout.is_some() {
            return invalid("`gracefulStopTimeout` goes with `stopType` GRACEFUL, and only with it");
        }
        Ok(self.change_state_to)
    }
}

impl OperationRequest {
    /// Reads the request for an operation: `instantiate`, `operate` or `terminate`.
    ///
    /// # Errors
    /// [`LifecycleError`].
    pub fn read(operation: &str, body: &[u8]) -> Result<Self, LifecycleError> {
        Ok(Self(match operation {
            "instantiate" => Wanted::Instantiate(read::<InstantiateRequest>(body)?.node()?),
            "operate" => Wanted::Operate(read::<OperateRequest>(body)?.change()?),
            "terminate" => {
                let request: TerminateRequest = read(body)?;
                let is_forced = request.termination_type == StopType::Forceful;
                if is_forced && request.graceful_termination_timeout.is_some() {
                    let reason = "`gracefulTerminationTimeout` goes with `terminationType` GRACEFUL only";
                    return invalid(reason);
                }
                Wanted::Terminate
            }
            other => return Err(LifecycleError::Unknown("operation", other.to_owned())),
        }))
    }

    /// Returns the selected node of an instantiation.
    pub fn node(&self) -> Option<&NodeId> {
        match &self.0 {
            Wanted::Instantiate(node) => Some(node),
            Wanted::Operate(_) | Wanted::Terminate => None,
        }
    }
}

impl Applications {
    /// Creates an application instance. Returns its identifier.
    ///
    /// # Errors
    /// [`LifecycleError`].
    pub fn create(
        &mut self,
        viewer: Option<&DomainId>,
        request: CreateRequest,
    ) -> Result<String, LifecycleError> {
        let texts = [request.app_instance_name, request.app_instance_description];
        if texts.iter().flatten().any(|text| text.len() > LONGEST_TEXT) {
            return invalid(format!("a name and a description have at most {LONGEST_TEXT} bytes each"));
        }
        Ok(self.define(viewer, &request.app_d_id, None, texts)?.id.clone())
    }

    /// Begins an operation. Call [`Self::end`] with the outcome of its task.
    ///
    /// # Errors
    /// [`LifecycleError`].
    pub fn begin(
        &mut self,
        viewer: Option<&DomainId>,
        id: &str,
        request: &OperationRequest,
        now: Timestamp,
    ) -> Result<Begun, LifecycleError> {
        let conflict =
            |what: &str| Err(LifecycleError::Conflict(format!("the application instance `{id}` {what}")));
        let (operation, task) = match (&request.0, &self.instance(viewer, id)?.stage) {
            (Wanted::Instantiate(node), _) => {
                self.settle(viewer, id, node.clone(), now)?;
                (Operation::Instantiate, Task::Start)
            }
            (_, Stage::Defined) => return conflict("is not instantiated"),
            (Wanted::Operate(Change::Started), Stage::Configured) => (Operation::Operate, Task::Start),
            (Wanted::Operate(Change::Stopped), Stage::Started(..)) => (Operation::Operate, Task::Stop),
            (Wanted::Operate(Change::Stopped), Stage::Configured) => return conflict("is stopped already"),
            (Wanted::Operate(Change::Started), Stage::Started(..)) => {
                return conflict("was started already: if it does not serve, stop it first");
            }
            (Wanted::Terminate, Stage::Configured) => (Operation::Terminate, Task::Nothing),
            (Wanted::Terminate, Stage::Started(..)) => (Operation::Terminate, Task::Stop),
        };
        Ok(Begun { number: self.record(id, operation, now), operation, task })
    }

    /// Ends an operation.
    pub fn end(&mut self, id: &str, begun: Begun, is_done: bool, now: Timestamp) {
        let state = if is_done { OperationState::Completed } else { OperationState::Failed };
        match begun.operation {
            Operation::Instantiate if !is_done => self.unsettle(id, now),
            Operation::Terminate if is_done => self.unsettle(id, now),
            _ => {}
        }
        self.conclude(begun.number, state, now);
    }

    /// Returns the occurrences of operations (6.2.2.13), at addresses below `base`.
    pub fn occurrence_documents(&self, viewer: Option<&DomainId>, base: &str) -> Vec<Value> {
        self.occurrences(viewer).map(|(number, occurrence)| occurrence.document(number, base)).collect()
    }

    /// Returns an occurrence of an operation.
    ///
    /// # Errors
    /// [`LifecycleError::Unknown`].
    pub fn occurrence_document(
        &self,
        viewer: Option<&DomainId>,
        id: &str,
        base: &str,
    ) -> Result<Value, LifecycleError> {
        let found = self.occurrences(viewer).find(|(number, _)| number.to_string() == id);
        let (number, occurrence) =
            found.ok_or_else(|| LifecycleError::Unknown("operation occurrence", id.to_owned()))?;
        Ok(occurrence.document(number, base))
    }
}

/// Returns an application instance (6.2.2.4), at an address below `base`.
pub fn instance(instance: &Application, of: &Descriptor, base: &str) -> Value {
    let state = State::of(instance);
    let operational = (state != State::NotInstantiated).then_some(state);
    let instantiation = if operational.is_some() { "INSTANTIATED" } else { "NOT_INSTANTIATED" };
    let itself = format!("{base}/app_instances/{}", instance.id);
    let link = |task: &str| json!({ "href": format!("{itself}/{task}") });
    let mut document = json!({
        "id": instance.id, "appDId": instance.descriptor, "appPkgId": instance.descriptor, "appName": of.name,
        "appProvider": PROVIDER, "appSoftVersion": VERSION, "appDVersion": VERSION, "instantiationState": instantiation,
        "_links": { "self": { "href": itself } },
    });
    if let Some(name) = &instance.name {
        document["appInstanceName"] = name.as_str().into();
    }
    if let Some(description) = &instance.description {
        document["appInstanceDescription"] = description.as_str().into();
    }
    match operational {
        None => document["_links"]["instantiate"] = link("instantiate"),
        Some(state) => {
            document["instantiatedAppState"] = json!({ "operationalState": state });
            document["_links"]["terminate"] = link("terminate");
            document["_links"]["operate"] = link("operate");
        }
    }
    document
}

/// Attributes of application instances (6.2.2.4), for queries.
pub static INSTANCE_ATTRIBUTES: &[Attribute] = APP_INSTANCE_INFO;
/// Attributes of operations' occurrences (6.2.2.13), for queries.
pub static OCCURRENCE_ATTRIBUTES: &[Attribute] = APP_INSTANCE_LCM_OP_OCC;

cotorra_mec::attributes! {
    APP_INSTANCE_INFO {
        !"id": Text,
        !"appDId": Text,
        !"appProvider": Text,
        !"appName": Text,
        !"appSoftVersion": Text,
        !"appDVersion": Text,
        !"appPkgId": Text,
        !"instantiationState": Text,
        !"_links": (INSTANCE_LINKS),
        "appInstanceName": Text,
        "appInstanceDescription": Text,
        "vimConnectionInfo": [(VIM_CONNECTION_INFO)],
        "instantiatedAppState": (INSTANTIATED_APP_STATE),
    }
    INSTANCE_LINKS {
        !"self": (LINK),
        "instantiate": (LINK),
        "terminate": (LINK),
        "operate": (LINK),
    }
    VIM_CONNECTION_INFO { !"id": Text, !"vimType": Text, "vimId": Text, }
    INSTANTIATED_APP_STATE { !"operationalState": Text, }
    APP_INSTANCE_LCM_OP_OCC {
        !"id": Text,
        !"operationState": Text,
        !"stateEnteredTime": (TIME_STAMP),
        !"startTime": (TIME_STAMP),
        !"lcmOperation": Text,
        !"_links": (OCCURRENCE_LINKS),
        "operationParams": Text,
    }
    OCCURRENCE_LINKS { !"self": (LINK), !"appInstance": (LINK), }
    TIME_STAMP { !"seconds": Number, !"nanoSeconds": Number, }
    LINK { !"href": Text, }
}
