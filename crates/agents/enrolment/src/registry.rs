//! The registry of agents: their generations, and until when each may connect. Pure data.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

use chrono::{DateTime, TimeDelta, Utc};
use cotorra_graph::AgentId;
use serde::{Deserialize, Serialize};

use crate::{
    CoreEndpoint, EnrolmentError,
    certificates::{AgentCertificate, common_name},
    time_text,
};

/// Version of the file.
const VERSION: u32 = 1;
/// Maximum number of agents, with revoked ones.
const MOST_AGENTS: usize = 4096;
/// Maximum number of generations of an agent that may connect at the same time.
const MOST_GRANTS: usize = 16;
/// Maximum number of hosts in the core's certificate.
const MOST_HOSTS: usize = 64;

/// An agent in the registry.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Enrolled {
    /// Name.
    pub name: AgentId,
    /// Its newest generation.
    pub generation: u32,
    /// End of validity of the newest generation.
    pub not_after: DateTime<Utc>,
    /// Whether it is revoked.
    pub state: AgentState,
}

/// Whether an agent is revoked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum AgentState {
    /// It may connect while its certificate is valid.
    Enrolled,
    /// All its generations are rejected.
    Revoked,
}

/// A generation of an agent that may connect.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Granted {
    /// The agent.
    pub name: AgentId,
    /// The common name of its certificate, such as `robot.2`.
    pub common_name: String,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Registry {
    version: u32,
    agents: BTreeMap<AgentId, Record>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Record {
    core: CoreEndpoint,
    /// Newest generation. Never falls.
    generation: u32,
    #[serde(with = "time_text")]
    not_after: DateTime<Utc>,
    /// Validity of the newest generation when it was made.
    valid_s: u64,
    /// Generations that may connect, oldest first. Empty if the agent is revoked.
    granted: Vec<Grant>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Grant {
    generation: u32,
    #[serde(with = "time_text")]
    until: DateTime<Utc>,
}

impl Record {
    fn is_revoked(&self) -> bool {
        self.granted.is_empty()
    }
}

impl Registry {
    pub fn new() -> Self {
        Self { version: VERSION, agents: BTreeMap::new() }
    }

    pub fn is_empty(&self) -> bool {
        self.agents.is_empty()
    }

    /// Reads the text of a file. Returns the mistake if it is not a registry.
    pub fn parse(text: &str) -> Result<Self, String> {
        #[derive(Deserialize)]
        struct Version {
            version: u32,
        }
        let Version { version } = serde_json::from_str(text).map_err(|error| error.to_string())?;
        if version != VERSION {
            return Err(format!("it has version {version}, and this cotorra reads version {VERSION}"));
        }
        let registry: Self = serde_json::from_str(text).map_err(|error| error.to_string())?;
        for (name, record) in &registry.agents {
            let mut numbers = record.granted.iter().map(|grant| grant.generation);
            let is_newest = numbers.next_back().is_none_or(|newest| newest == record.generation);
            if record.generation == 0 || !is_newest || numbers.any(|older| older >= record.generation) {
                return Err(format!("the generations of `{name}` are not in order"));
            }
        }
        Ok(registry)
    }

    pub fn text(&self) -> String {
        serde_json::to_string_pretty(self).expect("text and numbers become JSON") + "\n"
    }

    /// Enrols an agent that is new or revoked. Returns its next certificate.
    pub fn enrol(
        &mut self,
        name: &AgentId,
        core: &CoreEndpoint,
        validity: Duration,
        now: DateTime<Utc>,
    ) -> Result<AgentCertificate, EnrolmentError> {
        let generation = match self.agents.get(name) {
            Some(record) if record.is_revoked() => record.generation,
            Some(Record { generation, .. }) => {
                return Err(EnrolmentError::AlreadyEnrolled { name: name.clone(), generation: *generation });
            }
            None if self.agents.len() >= MOST_AGENTS => {
                return Err(EnrolmentError::TooMany { what: "agents", most: MOST_AGENTS });
            }
            None => 0,
        };
        let record =
            Record { core: core.clone(), generation, not_after: now, valid_s: 0, granted: Vec::new() };
        self.add_generation(name, record, validity, now)
    }

    /// Makes the next generation of an agent. The others may connect for no longer than the overlap. Keeps the address of
    /// the core and the validity, if there are no other ones. Returns the address and the next certificate.
    pub fn renew(
        &mut self,
        name: &AgentId,
        core: Option<&CoreEndpoint>,
        validity: Option<Duration>,
        overlap: Duration,
        now: DateTime<Utc>,
    ) -> Result<(CoreEndpoint, AgentCertificate), EnrolmentError> {
        let mut record = self.record(name)?.clone();
        if record.is_revoked() {
            return Err(EnrolmentError::Revoked { name: name.clone() });
        }
        let core = core.unwrap_or(&record.core).clone();
        record.core = core.clone();
        let validity = validity.unwrap_or(Duration::from_secs(record.valid_s));
        let end = after(now, overlap);
        record.granted.retain_mut(|grant| {
            grant.until = grant.until.min(end);
            now < grant.until
        });
        if record.granted.len() >= MOST_GRANTS {
            return Err(EnrolmentError::TooMany { what: "generations that overlap", most: MOST_GRANTS });
        }
        Ok((core, self.add_generation(name, record, validity, now)?))
    }

    fn add_generation(
        &mut self,
        name: &AgentId,
        mut record: Record,
        validity: Duration,
        now: DateTime<Utc>,
    ) -> Result<AgentCertificate, EnrolmentError> {
        let mut hosts = self.hosts();
        hosts.insert(record.core.host().to_owned());
        if hosts.len() > MOST_HOSTS {
            return Err(EnrolmentError::TooMany { what: "hosts of the core", most: MOST_HOSTS });
        }
        let next = record.generation.checked_add(1);
        record.generation =
            next.ok_or(EnrolmentError::TooMany { what: "generations", most: u32::MAX as usize })?;
        record.not_after = after(now, validity);
        record.valid_s = validity.as_secs();
        let (generation, not_after) = (record.generation, record.not_after);
        record.granted.push(Grant { generation, until: not_after });
        self.agents.insert(name.clone(), record);
        Ok(AgentCertificate { name: name.clone(), generation, not_after })
    }

    /// Ends all generations of an agent. Returns their common names.
    pub fn revoke(&mut self, name: &AgentId) -> Result<Vec<String>, EnrolmentError> {
        self.record(name)?;
        let record = self.agents.get_mut(name).expect("it was found");
        Ok(record.granted.drain(..).map(|grant| common_name(name, grant.generation)).collect())
    }

    pub fn agents(&self) -> Vec<Enrolled> {
        let enrolled = |(name, record): (&AgentId, &Record)| Enrolled {
            name: name.clone(),
            generation: record.generation,
            not_after: record.not_after,
            state: if record.is_revoked() { AgentState::Revoked } else { AgentState::Enrolled },
        };
        self.agents.iter().map(enrolled).collect()
    }

    pub fn granted(&self, now: DateTime<Utc>) -> Vec<Granted> {
        let mut granted = Vec::new();
        for (name, record) in &self.agents {
            let current = record.granted.iter().filter(|grant| now < grant.until);
            granted.extend(current.map(|grant| Granted {
                name: name.clone(),
                common_name: common_name(name, grant.generation),
            }));
        }
        granted
    }

    /// Returns the hosts at which agents reach the core.
    pub fn hosts(&self) -> BTreeSet<String> {
        let enrolled = self.agents.values().filter(|record| !record.is_revoked());
        enrolled.map(|record| record.core.host().to_owned()).collect()
    }

    fn record(&self, name: &AgentId) -> Result<&Record, EnrolmentError> {
        self.agents.get(name).ok_or_else(|| EnrolmentError::NotEnrolled {
            name: name.clone(),
            known: self.agents.keys().cloned().collect(),
        })
    }
}

/// Returns the time in so many whole seconds. Durations that are too long end at the last time that exists.
pub fn after(now: DateTime<Utc>, duration: Duration) -> DateTime<Utc> {
    let seconds = i64::try_from(duration.as_secs()).ok().and_then(TimeDelta::try_seconds);
    seconds.and_then(|seconds| now.checked_add_signed(seconds)).unwrap_or(DateTime::<Utc>::MAX_UTC)
}
