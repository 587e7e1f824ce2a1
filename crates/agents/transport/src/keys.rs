//! Keys of messages: `cotorra/<run>/agent/<agent>/<kind>`.

use cotorra_agent_protocol::Run;
use cotorra_graph::AgentId;

/// The beginning of all keys of an agent, in any run.
pub(crate) fn of_agent(agent: &AgentId) -> String {
    format!("cotorra/*/agent/{agent}")
}

/// The beginning of an agent's keys in a run.
pub(crate) fn in_run(run: Run, agent: &AgentId) -> String {
    format!("cotorra/{}/agent/{agent}", run.0)
}

/// Last parts of keys.
pub(crate) const WANTED: &str = "wanted";
pub(crate) const BEAT: &str = "beat";
pub(crate) const STATE: &str = "state";
pub(crate) const CONTEXT: &str = "context";
/// To a robot.
pub(crate) const COMMAND: &str = "command";
/// Of a robot.
pub(crate) const READING: &str = "reading";
pub(crate) const TURN: &str = "turn";
/// Those that are sent many times.
pub(crate) const MESSAGES: [&str; 6] = [BEAT, STATE, CONTEXT, COMMAND, READING, TURN];
/// Followed by the number of the agent's process.
pub(crate) const ALIVE: &str = "alive";
/// Followed by the file's SHA-256.
pub(crate) const FILE: &str = "file";
