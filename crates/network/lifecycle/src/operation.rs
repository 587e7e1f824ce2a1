//! Operations of ETSI GS MEC 010-2, and the state of an instance in its terms.

use cotorra_mec::TimeStamp;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::{
    application::{Application, Seen, Stage},
    error::LifecycleError,
};

/// Provider of all applications.
pub(crate) const PROVIDER: &str = "cotorra";
/// Version of all applications and descriptors.
pub(crate) const VERSION: &str = "1";

/// Reads a request.
///
/// # Errors
/// [`LifecycleError::Invalid`].
pub fn read<T: for<'a> Deserialize<'a>>(body: &[u8]) -> Result<T, LifecycleError> {
    serde_json::from_slice(body).map_err(|error| LifecycleError::Invalid(error.to_string()))
}

/// An operation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum Operation {
    /// Add the VNF on a node.
    Instantiate,
    /// Add or remove the VNF of an instance that has a node.
    Operate,
    /// Remove the VNF, and forget the node.
    Terminate,
}

/// State of an operation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum OperationState {
    /// It is about to be carried out. No operation here has this state.
    Starting,
    /// It is carried out.
    Processing,
    /// It is done.
    Completed,
    /// It was rejected. Nothing has changed.
    Failed,
}

/// State of an instance.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
pub(crate) enum State {
    /// It has no node.
    NotInstantiated,
    /// Its VNF serves.
    Started,
    /// Its VNF does not serve.
    Stopped,
}

impl State {
    pub(crate) const ALL: [Self; 3] = [Self::NotInstantiated, Self::Started, Self::Stopped];

    pub(crate) fn of(instance: &Application) -> Self {
        match &instance.stage {
            Stage::Defined => Self::NotInstantiated,
            Stage::Started(_, Seen::Serves) => Self::Started,
            Stage::Configured | Stage::Started(..) => Self::Stopped,
        }
    }
}

/// An operation that occurred, or that is carried out.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Occurrence {
    pub(crate) instance: String,
    pub(crate) operation: Operation,
    pub(crate) state: OperationState,
    started: TimeStamp,
    pub(crate) entered: TimeStamp,
}

impl Occurrence {
    pub(crate) fn new(instance: &str, operation: Operation, now: TimeStamp) -> Self {
        let state = OperationState::Processing;
        Self { instance: instance.to_owned(), operation, state, started: now, entered: now }
    }

    pub(crate) fn document(&self, number: u64, base: &str) -> Value {
        json!({
            "id": number.to_string(), "operationState": self.state, "lcmOperation": self.operation,
            "stateEnteredTime": self.entered, "startTime": self.started,
            "_links": {
                "self": { "href": format!("{base}/app_lcm_op_occs/{number}") },
                "appInstance": { "href": format!("{base}/app_instances/{}", self.instance) },
            },
        })
    }
}
