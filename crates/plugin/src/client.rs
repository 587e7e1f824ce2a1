//! The client of a testbed's HTTP API, for plug-ins that are programs of their own.
//!
//! [`run()`] drives any [`Plugin`] over the API, so that one plug-in runs in process or apart; [`Client`] asks and
//! instructs directly. Both block, as a plug-in has nothing else to do.

mod events;
mod local;
mod map;
mod run;
mod trust;

use std::{
    io::Read,
    path::{Path, PathBuf},
    time::Duration,
};

use cotorra_graph::{
    Candidate, Emulation, HostAddress, Instruction, InvalidId, LinkContext, LinkId, MachineContext, NodeId,
    Placement, PluginId, PluginSpec, RadioContext, RobotContext, SensorReading, Service, ServiceTime,
    Testbed, Timestamp, VirtualLinkMapping, WaisSettings, Walk,
};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::{
    Plugin,
    runs::{RunEntry, Runs, RunsError},
};
pub use events::Events;
use map::GraphBody;

/// Everything but a stream is answered within this time, or not at all.
const PATIENCE: Duration = Duration::from_secs(10);
/// A stream that is silent for so long, though the server keeps it alive every 15 s, has ended.
const SILENCE: Duration = Duration::from_secs(60);
/// Status of a testbed whose run has ended.
const ENDED: u16 = 503;
/// Advice about an unknown API.
const HINT: &str = "let COTORRA_CA name a copy of the file that the run printed";
/// The largest answer that is read, bytes: 10,000 contexts of a testbed with a few hundred radio units.
const LARGEST_ANSWER: u64 = 256 << 20;

/// Runs a plug-in against the testbed that `COTORRA_API` names, until the testbed's run ends.
///
/// # Errors
/// [`ClientError`] if the environment names no API, or that cannot be used. What the testbed refuses is none: it is
/// recorded there, and told as a decision.
pub fn run(plugin: &mut dyn Plugin) -> Result<(), ClientError> {
    Client::from_env()?.run(plugin)
}

/// The plug-in's settings in the testbed file, which a testbed passes on in `COTORRA_SETTINGS`; empty without it.
///
/// # Errors
/// [`ClientError::Settings`] if that is no JSON object.
pub fn settings() -> Result<serde_json::Map<String, serde_json::Value>, ClientError> {
    match std::env::var("COTORRA_SETTINGS") {
        Ok(settings) if !settings.is_empty() => {
            serde_json::from_str(&settings).map_err(ClientError::Settings)
        }
        _ => Ok(serde_json::Map::new()),
    }
}

/// A connection to a testbed's API.
#[derive(Debug, Clone)]
pub struct Client {
    agent: ureq::Agent,
    api: String,
    token: Option<String>,
    plugin: Option<PluginId>,
}

/// Error of a call to the API.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// The environment does not say where the API is, nor does one run alone on this machine.
    #[error("COTORRA_API is not set, and {0}: let it name the testbed's API, as in http://127.0.0.1:7700")]
    NotSet(#[from] RunsError),
    /// The text is not an address of an API.
    #[error("`{0}` is not the address of an API: write it like http://127.0.0.1:7700 or https://lab:7700")]
    Address(String),
    /// An address with TLS, and nothing says by which authority it is known.
    #[error("{0} needs the certificate of its authority: {HINT}")]
    NoAuthority(String),
    /// The file of an authority cannot be used.
    #[error("{} is not the certificate of an authority: {reason}; {HINT}", path.display())]
    Authority {
        /// The file.
        path: PathBuf,
        /// Its mistake.
        reason: String,
    },
    /// Whoever answers has no certificate by the authority for that address.
    #[error("{url} is not trusted: {reason}; {HINT}")]
    NotTrusted {
        /// URL of the request.
        url: String,
        /// Mistake of the certificate.
        reason: String,
    },
    /// The plug-in's name can be none.
    #[error("COTORRA_PLUGIN: {0}")]
    Name(#[from] InvalidId),
    /// The plug-in's settings cannot be read.
    #[error("COTORRA_SETTINGS is not a JSON object: {0}")]
    Settings(#[source] serde_json::Error),
    /// There is no answer.
    #[error("the API at {url} cannot be reached: {source}")]
    Unreachable {
        /// URL of the request.
        url: String,
        /// Cause.
        source: Box<ureq::Error>,
    },
    /// The testbed does not do what an instruction asks for.
    #[error("refused: {0}")]
    Refused(String),
    /// The request cannot be answered.
    #[error("{url} answers {status}: {reason}")]
    Failed {
        /// URL of the request.
        url: String,
        /// HTTP status.
        status: u16,
        /// The API's reason.
        reason: String,
    },
    /// The answer is not what this version of cotorra expects.
    #[error("{url} gives an answer that this client does not understand: {reason}")]
    Malformed {
        /// URL of the request.
        url: String,
        /// Mistake in the answer.
        reason: String,
    },
}

impl ClientError {
    /// Whether it says that the testbed's run has ended: while that says so, or by having closed.
    fn is_end(&self) -> bool {
        matches!(self, Self::Failed { status: ENDED, .. } | Self::Unreachable { .. })
    }
}

/// Part of a history; by default all of it from the beginning, up to the server's limit.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Part {
    /// Earliest time.
    pub from: Timestamp,
    /// Up to here, this excluded.
    pub to: Option<Timestamp>,
    /// Highest number of items.
    pub limit: Option<usize>,
    /// The [`Page::next`] of the page before.
    pub after: Option<String>,
}

/// A part of a history.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Page<T> {
    /// Items in order of time.
    pub items: Vec<T>,
    /// Start of the next page; `None` on the last.
    pub next: Option<String>,
}

/// Something measured, and when.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Sample<T> {
    /// Time of the sample.
    #[serde(rename = "at_ns")]
    pub at: Timestamp,
    /// Sampled value.
    #[serde(flatten)]
    pub value: T,
}

/// State of the whole graph at a time: the last sample of every embedding.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct GraphState {
    /// Time of the state.
    #[serde(rename = "at_ns")]
    pub at: Timestamp,
    /// κ(r).
    pub robots: Vec<Sample<RobotContext>>,
    /// ι(R).
    pub radio_units: Vec<Sample<RadioContext>>,
    /// d, λ, ψ, δ, by link and direction.
    pub links: Vec<Sample<LinkContext>>,
    /// a(n).
    pub placements: Vec<Sample<Placement>>,
    /// a(n1,n2).
    pub virtual_links: Vec<Sample<VirtualLinkMapping>>,
    /// Readings, by robot and sensor.
    #[serde(default)]
    pub sensors: Vec<Sample<SensorReading>>,
    /// Contexts of machines, by node.
    #[serde(default)]
    pub machines: Vec<Sample<MachineContext>>,
}

#[derive(Serialize)]
struct InstructionBody<'a> {
    instruction: &'a Instruction,
    #[serde(skip_serializing_if = "Option::is_none")]
    reason: Option<&'a str>,
}

#[derive(Deserialize)]
struct Done {}

#[derive(Deserialize)]
struct TestbedBody {
    name: String,
    #[serde(default)]
    description: String,
    graph: GraphBody,
    services: Vec<Service>,
    walks: Vec<Walk>,
    #[serde(default)]
    plugins: Vec<PluginSpec>,
    #[serde(default)]
    seed: u64,
}

/// A page of the dashboard that a code signs in, once.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SignIn {
    /// A file that only the run's user can read, and that leads a browser to the page. It is removed once the page is
    /// signed in.
    pub file: PathBuf,
    /// The page's address with the code.
    pub address: String,
}

/// Access to a node from this machine.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
pub struct NodeAccess {
    /// Addresses in the emulated network; none for a switch and a real machine.
    pub address: Option<HostAddress>,
    /// A file that stands for its network namespace, as `nsenter --net=` takes it; none for a switch and a real machine.
    pub namespace: Option<PathBuf>,
}

/// Body of a failure: `refused` for a rejected instruction, else `error`.
#[derive(Default, Deserialize)]
struct Failure {
    refused: Option<String>,
    error: Option<String>,
}

impl Client {
    /// The client of the API that `COTORRA_API` names, with the token in `COTORRA_TOKEN` if one is set, under the
    /// name in `COTORRA_PLUGIN`: what a testbed sets for the plug-ins that it starts. An address with TLS is known by the
    /// authority in the file that `COTORRA_CA` names. Without a token, the client of this user's run on this machine with that address, as [`Client::of`] gives it, and without `COTORRA_API` that of the only
    /// one.
    ///
    /// # Errors
    /// [`ClientError`] if one of them is missing or cannot be used. Whether somebody answers shows later.
    pub fn from_env() -> Result<Self, ClientError> {
        let variable = |name| std::env::var(name).ok().filter(|value| !value.is_empty());
        let token = variable("COTORRA_TOKEN");
        let mut client = match variable("COTORRA_API") {
            // Without a token, a run of this user knows it by its socket only.
            Some(api) => match Runs::of_user().find(Some(&api)) {
                Ok(run) if token.is_none() => Self::of(&run)?,
                _ => Self::at(&api, variable("COTORRA_CA").as_deref().map(Path::new))?,
            },
            None => Self::of(&Runs::of_user().find(None)?)?,
        };
        client.token = token;
        client.plugin = variable("COTORRA_PLUGIN").as_deref().map(PluginId::new).transpose()?;
        Ok(client)
    }

    /// The client of the API at that address, as in `http://127.0.0.1:7700`. Whoever listens there gets the token: prefer
    /// [`Client::of`] for a run of this user on this machine.
    ///
    /// # Errors
    /// [`ClientError::Address`] if it is none.
    pub fn new(api: &str) -> Result<Self, ClientError> {
        Self::at(api, None)
    }

    /// The client of the API at that address. One with TLS, as in `https://lab:7700`, is known by the authority in the
    /// file `ca`, which the run prints.
    ///
    /// # Errors
    /// [`ClientError`] if the address or the file cannot be used.
    pub fn at(api: &str, ca: Option<&Path>) -> Result<Self, ClientError> {
        let api = api.trim_end_matches('/').to_owned();
        let is_address = |host: &str| !host.is_empty() && !host.contains(['/', ' ', '?']);
        let config = match api.split_once("://") {
            Some(("http", host)) if is_address(host) => config().build(),
            Some(("https", host)) if is_address(host) => {
                let ca = ca.ok_or_else(|| ClientError::NoAuthority(api.clone()))?;
                config().tls_config(trust::authority(ca)?).https_only(true).build()
            }
            _ => return Err(ClientError::Address(api)),
        };
        Ok(Self { agent: config.into(), api, token: None, plugin: None })
    }

    /// The client of a run of this user on this machine, over its Unix socket, where no other user can listen.
    ///
    /// # Errors
    /// [`ClientError::Address`] if the run's address can be none.
    pub fn of(run: &RunEntry) -> Result<Self, ClientError> {
        let agent = local::agent(config().build(), run);
        Ok(Self { agent, ..Self::new(&format!("http://{}", run.api))? })
    }

    /// The same with a token.
    pub fn with_token(self, token: impl Into<String>) -> Self {
        Self { token: Some(token.into()), ..self }
    }

    /// The same under that name: decisions are recorded with it.
    pub fn named(self, plugin: PluginId) -> Self {
        Self { plugin: Some(plugin), ..self }
    }

    /// The testbed, without its currency, its map, its emulation, the settings of its WAIS, its history's retention and its border, which
    /// the API does not give with it. Walls of its wireless networks have the map.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn testbed(&self) -> Result<Testbed, ClientError> {
        let TestbedBody { name, description, graph, services, walks, plugins, seed } =
            self.get("testbed", &[])?;
        let graph = self.walled(graph)?;
        let wais = WaisSettings::default();
        let (emulation, probes, retention) = (Emulation::default(), None, Default::default());
        let map = None;
        Ok(Testbed {
            name,
            description,
            currency: None,
            folder: Default::default(),
            graph,
            services,
            map,
            walks,
            plugins,
            wais,
            core: None,
            seed,
            emulation,
            script: Default::default(),
            probes,
            retention,
            border: None,
            without_port_security: Vec::new(),
            traffic: Vec::new(),
            reservations: Default::default(),
            containers: Default::default(),
        })
    }

    /// Prepares a page of the dashboard for a browser of the run's user.
    ///
    /// # Errors
    ///
    /// [`ClientError`], with status 401 or 403 for callers other than the operator.
    pub fn sign_in(&self) -> Result<SignIn, ClientError> {
        let url = self.url("sign-in/pages");
        let request = self.identify(self.agent.post(&url)).config().timeout_global(Some(PATIENCE)).build();
        read(&url, self.answer(&url, request.send_empty())?)
    }

    /// Returns how a node is reached.
    ///
    /// # Errors
    ///
    /// [`ClientError`], with status 404 for an unknown node.
    pub fn node(&self, node: &NodeId) -> Result<NodeAccess, ClientError> {
        self.get(&format!("network/nodes/{node}"), &[])
    }

    /// κ of every robot.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn robots(&self) -> Result<Vec<RobotContext>, ClientError> {
        self.get("robots", &[])
    }

    /// κ of a robot.
    ///
    /// # Errors
    /// [`ClientError`], with status 404 if nothing is known of it.
    pub fn robot(&self, robot: &NodeId) -> Result<RobotContext, ClientError> {
        self.get(&format!("robots/{robot}"), &[])
    }

    /// Radio units that a robot can use, with the delay over the air to each.
    ///
    /// # Errors
    /// [`ClientError`], with status 404 if nothing is known of the robot.
    pub fn candidates(&self, robot: &NodeId) -> Result<Vec<Candidate>, ClientError> {
        self.get(&format!("robots/{robot}/candidates"), &[])
    }

    /// d, λ and conditions of every link, in both directions. [`LinkContext::figures`] returns configured, measured and
    /// available figures.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn links(&self) -> Result<Vec<LinkContext>, ClientError> {
        self.get("network/links", &[])
    }

    /// ι of every radio unit.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn radio_units(&self) -> Result<Vec<RadioContext>, ClientError> {
        self.get("network/radio-units", &[])
    }

    /// CPU, memory and interfaces of a node's machine, and the time of their reading.
    ///
    /// # Errors
    /// [`ClientError`], with status 404 if nothing is known of it.
    pub fn machine(&self, node: &NodeId) -> Result<MachineContext, ClientError> {
        self.get(&format!("network/nodes/{node}/machine"), &[])
    }

    /// a(n): where every VNF runs.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn placements(&self) -> Result<Vec<Placement>, ClientError> {
        self.get("network/placements", &[])
    }

    /// a(n1,n2): which links carry each direction of every virtual link.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn virtual_links(&self) -> Result<Vec<VirtualLinkMapping>, ClientError> {
        self.get("network/virtual-links", &[])
    }

    /// κ of a robot over time.
    ///
    /// # Errors
    /// [`ClientError`], with status 404 if there is no such robot.
    pub fn robot_history(
        &self,
        robot: &NodeId,
        part: &Part,
    ) -> Result<Page<Sample<RobotContext>>, ClientError> {
        self.get(&format!("measurements/robots/{robot}"), &part.query())
    }

    /// d, λ and conditions of a link over time, forward.
    ///
    /// # Errors
    /// [`ClientError`], with status 404 if there is no such link.
    pub fn link_history(&self, link: &LinkId, part: &Part) -> Result<Page<Sample<LinkContext>>, ClientError> {
        self.get(&format!("measurements/links/{link}"), &part.query())
    }

    /// Service times.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn service_times(&self, part: &Part) -> Result<Page<Sample<ServiceTime>>, ClientError> {
        self.get("measurements/service-times", &part.query())
    }

    /// The whole graph at a time; now if it is `None`.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn state(&self, at: Option<Timestamp>) -> Result<GraphState, ClientError> {
        let query = at.map(|at| ("at_ns", at.as_nanos().to_string()));
        self.get("measurements/state", query.as_slice())
    }

    /// Gives an instruction; done, or begun, when this returns.
    ///
    /// # Errors
    /// [`ClientError::Refused`], with the testbed's reason, if it does not do it.
    pub fn instruct(&self, instruction: &Instruction, reason: Option<&str>) -> Result<(), ClientError> {
        let url = self.url("instructions");
        let body = InstructionBody { instruction, reason };
        let request = self.identify(self.agent.post(&url)).config().timeout_global(Some(PATIENCE)).build();
        let _: Done = read(&url, self.answer(&url, request.send_json(&body))?)?;
        Ok(())
    }

    /// Opens a stream of events from now on, of these kinds (`robot`, `handover`, …), or of all if none is named.
    /// Virtual time stands still between an event and the request for the next: instructions in between are applied at
    /// once.
    ///
    /// # Errors
    ///
    /// [`ClientError`].
    pub fn events(&self, kinds: &[&str]) -> Result<Events, ClientError> {
        let url = self.url("events");
        let mut request =
            self.identify(self.agent.get(&url)).config().timeout_per_read(Some(SILENCE)).build();
        if !kinds.is_empty() {
            request = request.query("kinds", kinds.join(","));
        }
        let stream = self.answer(&url, request.call())?.into_body().into_reader();
        Ok(Events::new(self.clone(), url, stream))
    }

    /// Opens a capture of the packets that cross a link, or the links of a node: a pcapng file without an end. `filter` is
    /// a subset of pcap-filter(7), `snap` the bytes to keep of each packet; by default they are all packets as a whole.
    ///
    /// # Errors
    /// [`ClientError`], with status 404 if there is no such link or node.
    pub fn capture(
        &self,
        of: &LinkId,
        filter: Option<&str>,
        snap: Option<u32>,
    ) -> Result<impl Read + Send + use<>, ClientError> {
        let url = self.url(&format!("network/captures/{of}"));
        let mut request = self.identify(self.agent.get(&url));
        if let Some(filter) = filter {
            request = request.query("filter", filter);
        }
        if let Some(snap) = snap {
            request = request.query("snap_bytes", snap.to_string());
        }
        Ok(self.answer(&url, request.call())?.into_body().into_reader())
    }

    /// Says that everything up to a mark was taken in; virtual time goes on, and stops at `wake_at` at the latest.
    fn done(&self, mark: u64, wake_at: Option<Timestamp>) -> Result<(), ClientError> {
        let url = self.url(&format!("marks/{mark}"));
        let wake_at = wake_at.map(|at| at.as_nanos().to_string());
        let request =
            wake_at.iter().fold(self.agent.post(&url), |request, at| request.query("wake_at_ns", at));
        let request = self.identify(request).config().timeout_global(Some(PATIENCE)).build();
        let _: Done = read(&url, self.answer(&url, request.send_empty())?)?;
        Ok(())
    }

    fn get<T: DeserializeOwned>(&self, path: &str, query: &[(&str, String)]) -> Result<T, ClientError> {
        let url = self.url(path);
        let request =
            query.iter().fold(self.agent.get(&url), |request, (name, value)| request.query(*name, value));
        let request = self.identify(request).config().timeout_global(Some(PATIENCE)).build();
        read(&url, self.answer(&url, request.call())?)
    }

    fn url(&self, path: &str) -> String {
        format!("{}/api/v1/{path}", self.api)
    }

    fn identify<B>(&self, request: ureq::RequestBuilder<B>) -> ureq::RequestBuilder<B> {
        let request = match &self.token {
            Some(token) => request.header("authorization", format!("Bearer {token}")),
            None => request,
        };
        match &self.plugin {
            Some(plugin) => request.header("x-cotorra-plugin", plugin.as_str()),
            None => request,
        }
    }

    /// The answer, if it is a good one.
    fn answer(&self, url: &str, response: Result<Response, ureq::Error>) -> Result<Response, ClientError> {
        let mut response = response.map_err(|source| {
            let url = url.to_owned();
            match trust::mistake(&source) {
                Some(reason) => ClientError::NotTrusted { url, reason },
                None => ClientError::Unreachable { url, source: source.into() },
            }
        })?;
        let status = response.status();
        if status.is_success() {
            return Ok(response);
        }
        let said = response.body_mut().read_to_string().unwrap_or_default();
        let failure: Failure = serde_json::from_str(&said).unwrap_or_default();
        match failure {
            Failure { refused: Some(reason), .. } => Err(ClientError::Refused(reason)),
            Failure { error, .. } => {
                let reason =
                    error.or_else(|| status.canonical_reason().map(str::to_owned)).unwrap_or_default();
                Err(ClientError::Failed { url: url.to_owned(), status: status.as_u16(), reason })
            }
        }
    }
}

fn config() -> ureq::config::ConfigBuilder<ureq::typestate::AgentScope> {
    // A proxy that the environment names is for the world outside, not for the testbed.
    let config = ureq::Agent::config_builder().http_status_as_error(false).proxy(None).max_redirects(0);
    config.timeout_connect(Some(PATIENCE)).timeout_recv_response(Some(PATIENCE))
}

type Response = ureq::http::Response<ureq::Body>;

fn read<T: DeserializeOwned>(url: &str, mut response: Response) -> Result<T, ClientError> {
    let malformed = |reason: String| ClientError::Malformed { url: url.to_owned(), reason };
    let body = response.body_mut().with_config().limit(LARGEST_ANSWER).read_to_vec();
    // From bytes, as all JSON is read: each kind of source would be compiled by itself.
    serde_json::from_slice(&body.map_err(|error| malformed(error.to_string()))?)
        .map_err(|error| malformed(error.to_string()))
}

impl Part {
    fn query(&self) -> Vec<(&'static str, String)> {
        let from = Some(("from_ns", self.from.as_nanos().to_string()));
        let to = self.to.map(|to| ("until_ns", to.as_nanos().to_string()));
        let limit = self.limit.map(|limit| ("limit", limit.to_string()));
        let after = self.after.clone().map(|after| ("after", after));
        [from, to, limit, after].into_iter().flatten().collect()
    }
}

#[cfg(test)]
mod tests;
