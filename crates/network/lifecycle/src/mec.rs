//! Requests and documents of ETSI GS MEC 010-2 v2.1.1, application life cycle management.

use cotorra_graph::{DomainId, NodeId};
use serde::Deserialize;
use serde_json::{Value, json};

use crate::{Application, Applications, Descriptor, LifecycleError, Stage};

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
pub struct InstantiateRequest {
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
pub struct OperateRequest {
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
pub struct TerminateRequest {
    termination_type: StopType,
    #[serde(default)]
    graceful_termination_timeout: Option<u32>,
}

/// An operation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Operation {
    /// Add the VNF on a node.
    Instantiate,
    /// Add or remove the VNF of an instance that has a node.
    Operate,
    /// Remove the VNF, and forget the node.
    Terminate,
}

/// State of an operation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OperationState {
    /// It is carried out.
    Processing,
    /// It is done.
    Completed,
    /// It was rejected. Nothing has changed.
    Failed,
}

/// An operation that occurred, or that is carried out.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Occurrence {
    instance: String,
    operation: Operation,
    pub(crate) state: OperationState,
    started_ns: u64,
    pub(crate) entered_ns: u64,
}

/// What an operation asks of the testbed.
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
    /// What is to be done.
    pub task: Task,
}

/// Reads a request.
///
/// # Errors
/// [`LifecycleError::Invalid`].
pub fn read<T: for<'a> Deserialize<'a>>(body: &[u8]) -> Result<T, LifecycleError> {
    serde_json::from_slice(body).map_err(|error| LifecycleError::Invalid(error.to_string()))
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
    ///
    /// # Errors
    /// [`LifecycleError::Invalid`] if it asks for more than one node.
    pub fn node(&self) -> Result<NodeId, LifecycleError> {
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

    /// Begins to instantiate an application on a node. Call [`Self::end`] with the outcome of its task.
    ///
    /// # Errors
    /// [`LifecycleError`].
    pub fn instantiate(
        &mut self,
        viewer: Option<&DomainId>,
        id: &str,
        node: NodeId,
        now_ns: u64,
    ) -> Result<Begun, LifecycleError> {
        self.settle(viewer, id, node)?;
        Ok(self.begun(id, Operation::Instantiate, Task::Start, now_ns))
    }

    /// Begins to start or stop an instantiated application. Call [`Self::end`] with the outcome of its task.
    ///
    /// # Errors
    /// [`LifecycleError`].
    pub fn operate(
        &mut self,
        viewer: Option<&DomainId>,
        id: &str,
        request: &OperateRequest,
        now_ns: u64,
    ) -> Result<Begun, LifecycleError> {
        let graceful = request.stop_type == Some(StopType::Graceful);
        if request.change_state_to == Change::Started && request.stop_type.is_some() {
            return invalid("`stopType` is for `changeStateTo` STOPPED only");
        }
        if graceful != request.graceful_stop_timeout.is_some() {
            return invalid("`gracefulStopTimeout` goes with `stopType` GRACEFUL, and only with it");
        }
        let task = match (&self.instance(viewer, id)?.stage, request.change_state_to) {
            (Stage::Defined, _) => {
                let reason = format!("the application instance `{id}` is not instantiated");
                return Err(LifecycleError::Conflict(reason));
            }
            (Stage::Configured, Change::Started) => Task::Start,
            (Stage::Started(_), Change::Stopped) => Task::Stop,
            (Stage::Configured, Change::Stopped) | (Stage::Started(_), Change::Started) => {
                let reason = format!("the application instance `{id}` has this state already");
                return Err(LifecycleError::Conflict(reason));
            }
        };
        Ok(self.begun(id, Operation::Operate, task, now_ns))
    }

    /// Begins to terminate an instantiated application. Call [`Self::end`] with the outcome of its task.
    ///
    /// # Errors
    /// [`LifecycleError`].
    pub fn terminate(
        &mut self,
        viewer: Option<&DomainId>,
        id: &str,
        request: &TerminateRequest,
        now_ns: u64,
    ) -> Result<Begun, LifecycleError> {
        if request.termination_type == StopType::Forceful && request.graceful_termination_timeout.is_some() {
            return invalid("`gracefulTerminationTimeout` goes with `terminationType` GRACEFUL only");
        }
        let task = match self.instance(viewer, id)?.stage {
            Stage::Defined => {
                let reason = format!("the application instance `{id}` is not instantiated");
                return Err(LifecycleError::Conflict(reason));
            }
            Stage::Configured => Task::Nothing,
            Stage::Started(_) => Task::Stop,
        };
        Ok(self.begun(id, Operation::Terminate, task, now_ns))
    }

    fn begun(&mut self, id: &str, operation: Operation, task: Task, now_ns: u64) -> Begun {
        let occurrence = Occurrence {
            instance: id.to_owned(),
            operation,
            state: OperationState::Processing,
            started_ns: now_ns,
            entered_ns: now_ns,
        };
        Begun { number: self.record(id, occurrence), operation, task }
    }

    /// Ends an operation.
    pub fn end(&mut self, id: &str, begun: Begun, is_done: bool, now_ns: u64) {
        let state = if is_done { OperationState::Completed } else { OperationState::Failed };
        match begun.operation {
            Operation::Instantiate if !is_done => self.unsettle(id),
            Operation::Terminate if is_done => self.unsettle(id),
            _ => {}
        }
        self.conclude(begun.number, state, now_ns);
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

impl Occurrence {
    fn document(&self, number: u64, base: &str) -> Value {
        let operation = match self.operation {
            Operation::Instantiate => "INSTANTIATE",
            Operation::Operate => "OPERATE",
            Operation::Terminate => "TERMINATE",
        };
        let state = match self.state {
            OperationState::Processing => "PROCESSING",
            OperationState::Completed => "COMPLETED",
            OperationState::Failed => "FAILED",
        };
        let time = |ns: u64| json!({ "seconds": ns / 1_000_000_000, "nanoSeconds": ns % 1_000_000_000 });
        json!({
            "id": number.to_string(), "operationState": state, "lcmOperation": operation,
            "stateEnteredTime": time(self.entered_ns), "startTime": time(self.started_ns),
            "_links": {
                "self": { "href": format!("{base}/app_lcm_op_occs/{number}") },
                "appInstance": { "href": format!("{base}/app_instances/{}", self.instance) },
            },
        })
    }
}

/// Returns an application instance (6.2.2.4), at an address below `base`.
pub fn instance(instance: &Application, of: &Descriptor, base: &str) -> Value {
    let (instantiation, operational) = match instance.stage {
        Stage::Defined => ("NOT_INSTANTIATED", None),
        Stage::Configured => ("INSTANTIATED", Some("STOPPED")),
        Stage::Started(_) => ("INSTANTIATED", Some("STARTED")),
    };
    let itself = format!("{base}/app_instances/{}", instance.id);
    let link = |task: &str| json!({ "href": format!("{itself}/{task}") });
    let mut document = json!({
        "id": instance.id, "appDId": instance.descriptor, "appPkgId": instance.descriptor, "appName": of.name,
        "appProvider": "cotorra", "appSoftVersion": "1", "appDVersion": "1", "instantiationState": instantiation,
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
