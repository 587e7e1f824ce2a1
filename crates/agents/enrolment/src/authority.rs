//! The folder that makes credentials and knows who may connect.

use std::{
    collections::BTreeSet,
    env, fmt,
    fs::File,
    path::{Path, PathBuf},
    time::Duration,
};

use chrono::{DateTime, Utc};
use cotorra_graph::AgentId;

use crate::{
    AgentCertificate, Bundle, CoreEndpoint, Enrolled, EnrolmentError, Granted,
    certificates::{self, API_COMMON_NAME, CORE_COMMON_NAME, Credentials},
    files,
    registry::{Registry, after},
    time_text::whole_seconds,
};

/// Certificate and key of the authority.
const AUTHORITY: &str = "authority.pem";
/// Certificate of the authority, for clients of the API. It has no key.
const CA: &str = "ca.pem";
/// Certificate and key of the core.
const CORE: &str = "core.pem";
/// Certificate and key of the HTTP API.
const API: &str = "api.pem";
const REGISTRY: &str = "agents.json";

/// Longest file with a certificate and a key, in bytes.
const LONGEST_PEM: u64 = 64 << 10;
/// Longest registry in bytes: its bounds allow less.
const LONGEST_REGISTRY: u64 = 16 << 20;

const AUTHORITY_VALIDITY: Duration = Duration::from_hours(24 * 3652);
const SERVER_VALIDITY: Duration = Duration::from_hours(24 * 365);
/// The certificates of servers are made anew when they are valid for less.
const SERVER_REST: Duration = Duration::from_hours(24 * 120);

/// A folder of the user with a certificate authority, the certificates of the core and of its HTTP API, and a registry of
/// agents.
///
/// Every call reads the files, so that a running core sees what commands change. Files change one at a time and as a
/// whole, while the folder is locked: a process can be killed at any time.
#[derive(Debug, Clone)]
pub struct Authority {
    folder: PathBuf,
}

/// Credentials of a server of the core: that for agents, or that of the HTTP API.
#[derive(Clone)]
pub struct ServerCredentials {
    /// The authority's certificate, by which the core knows agents.
    pub authority_pem: String,
    /// The server's certificate. It has the hosts at which clients reach the server.
    pub certificate_pem: String,
    /// The server's key, which is secret.
    pub key_pem: String,
}

/// Leaves the key out.
impl fmt::Debug for ServerCredentials {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let certificate = &self.certificate_pem;
        f.debug_struct("ServerCredentials").field("certificate_pem", certificate).finish_non_exhaustive()
    }
}

/// Choices of a renewal.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Renewal {
    /// Address of the core; `None` keeps the address.
    pub core: Option<CoreEndpoint>,
    /// Validity of the new certificate; `None` keeps that of the one before.
    pub validity: Option<Duration>,
    /// Time for which earlier generations may still connect.
    pub overlap: Duration,
}

/// Keeps the address and the validity. The overlap is an hour.
impl Default for Renewal {
    fn default() -> Self {
        Self { core: None, validity: None, overlap: Duration::from_hours(1) }
    }
}

impl Authority {
    /// Returns the default folder: `cotorra/agents` in the user's folder for configuration, as the XDG base directory
    /// specification says. `None` if the environment names neither that nor a home.
    pub fn default_folder() -> Option<PathBuf> {
        let set = |name: &str| env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
        let config = set("XDG_CONFIG_HOME").or_else(|| set("HOME").map(|home| home.join(".config")));
        config.map(|config| config.join("cotorra/agents"))
    }

    /// Opens an authority. Changes nothing.
    ///
    /// # Errors
    /// [`EnrolmentError::NoAuthority`] if there is none; others if it cannot be read or trusted.
    pub fn open(folder: impl Into<PathBuf>) -> Result<Self, EnrolmentError> {
        let authority = Self { folder: folder.into() };
        authority.opened()?;
        authority.credentials()?;
        authority.registry()?;
        Ok(authority)
    }

    /// Opens an authority, or creates it.
    ///
    /// # Errors
    /// [`EnrolmentError`] if that fails. A folder may be left.
    pub fn create_or_open(folder: impl Into<PathBuf>, now: DateTime<Utc>) -> Result<Self, EnrolmentError> {
        let authority = Self { folder: folder.into() };
        files::create_folder(&authority.folder)?;
        let _alone = authority.lock()?;
        let [its, registry] = [AUTHORITY, REGISTRY].map(|name| authority.folder.join(name));
        if files::read(&its, LONGEST_PEM)?.is_none() {
            // The registry comes first: without one beside the credentials, generations might begin again.
            match authority.read_registry()? {
                None => files::save(&registry, &Registry::new().text())?,
                Some(registry) if registry.is_empty() => {}
                Some(_) => {
                    let reason = format!("it is missing, and {REGISTRY} has agents");
                    return Err(EnrolmentError::Damaged { path: its, reason });
                }
            }
            let now = whole_seconds(now);
            files::save(&its, &certificates::make_authority(now, after(now, AUTHORITY_VALIDITY))?.text())?;
        }
        Self::open(authority.folder)
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Enrols an agent that is new or revoked. If the process is killed before it has written the bundle, a renewal makes
    /// another.
    ///
    /// # Errors
    /// [`EnrolmentError`] if it is enrolled, the validity is not possible, or a file cannot be used.
    pub fn enrol(
        &self,
        name: &AgentId,
        core: &CoreEndpoint,
        validity: Duration,
        now: DateTime<Utc>,
    ) -> Result<Bundle, EnrolmentError> {
        self.issue(now, |registry, now| Ok((core.clone(), registry.enrol(name, core, validity, now)?)))
    }

    /// Makes the next generation of an agent. Those before may connect until the overlap ends.
    ///
    /// # Errors
    /// [`EnrolmentError`] if it is not enrolled, the validity is not possible, or a file cannot be used.
    pub fn renew(
        &self,
        name: &AgentId,
        renewal: &Renewal,
        now: DateTime<Utc>,
    ) -> Result<Bundle, EnrolmentError> {
        let Renewal { core, validity, overlap } = renewal;
        self.issue(now, |registry, now| registry.renew(name, core.as_ref(), *validity, *overlap, now))
    }

    /// Saves the registry before the credentials leave, so that no two certificates have one common name.
    fn issue(
        &self,
        now: DateTime<Utc>,
        change: impl FnOnce(
            &mut Registry,
            DateTime<Utc>,
        ) -> Result<(CoreEndpoint, AgentCertificate), EnrolmentError>,
    ) -> Result<Bundle, EnrolmentError> {
        let now = whole_seconds(now);
        let _alone = self.lock()?;
        let (authority, authority_ends) = self.unexpired(now)?;
        let mut registry = self.registry()?;
        let (core, agent) = change(&mut registry, now)?;
        if agent.not_after <= now || agent.not_after > authority_ends {
            return Err(EnrolmentError::Validity { authority_ends });
        }
        let credentials = certificates::make_agent(&authority, &agent, now)?;
        self.save_registry(&registry)?;
        Ok(Bundle::new(core, authority.certificate_pem, credentials, agent))
    }

    /// Ends all generations of an agent at once. Returns their common names: none, if it was revoked before.
    ///
    /// # Errors
    /// [`EnrolmentError`] if the authority does not know it, or a file cannot be used.
    pub fn revoke(&self, name: &AgentId) -> Result<Vec<String>, EnrolmentError> {
        let _alone = self.lock()?;
        let mut registry = self.registry()?;
        let ended = registry.revoke(name)?;
        self.save_registry(&registry)?;
        Ok(ended)
    }

    /// Returns all agents by name, with revoked ones.
    ///
    /// # Errors
    /// [`EnrolmentError`] if the registry cannot be read.
    pub fn agents(&self) -> Result<Vec<Enrolled>, EnrolmentError> {
        Ok(self.registry()?.agents())
    }

    /// Returns who may connect now, by name and generation.
    ///
    /// # Errors
    /// [`EnrolmentError`] if the registry cannot be read.
    pub fn granted(&self, now: DateTime<Utc>) -> Result<Vec<Granted>, EnrolmentError> {
        Ok(self.registry()?.granted(now))
    }

    /// Returns the core's credentials. Makes them if there are none, if they expire within 120 days, or if agents reach
    /// the core at a host that the certificate lacks.
    ///
    /// # Errors
    /// [`EnrolmentError`] if the authority expired, or a file cannot be used.
    pub fn core(&self, now: DateTime<Utc>) -> Result<ServerCredentials, EnrolmentError> {
        self.server(CORE, CORE_COMMON_NAME, |authority| Ok(authority.registry()?.hosts()), now)
    }

    /// Returns the credentials of the HTTP API for these hosts. Makes them as [`Self::core`] does.
    ///
    /// # Errors
    /// [`EnrolmentError`] if the authority expired, a host is no name, or a file cannot be used.
    pub fn api(
        &self,
        hosts: &BTreeSet<String>,
        now: DateTime<Utc>,
    ) -> Result<ServerCredentials, EnrolmentError> {
        self.server(API, API_COMMON_NAME, |_| Ok(hosts.clone()), now)
    }

    fn server(
        &self,
        file: &str,
        common_name: &str,
        hosts: impl FnOnce(&Self) -> Result<BTreeSet<String>, EnrolmentError>,
        now: DateTime<Utc>,
    ) -> Result<ServerCredentials, EnrolmentError> {
        let now = whole_seconds(now);
        let _alone = self.lock()?;
        let (authority, authority_ends) = self.unexpired(now)?;
        let hosts = hosts(self)?;
        let path = self.folder.join(file);
        let found = files::read(&path, LONGEST_PEM)?.and_then(|text| Credentials::split(&text));
        let serves = |found: &Credentials| {
            found.server(common_name, &authority.certificate_pem).is_ok_and(|(not_after, has)| {
                not_after >= authority_ends.min(after(now, SERVER_REST)) && hosts.is_subset(&has)
            })
        };
        let server = match found.filter(serves) {
            Some(server) => server,
            None => {
                let until = authority_ends.min(after(now, SERVER_VALIDITY));
                let server = certificates::make_server(&authority, common_name, &hosts, now, until)?;
                files::save(&path, &server.text())?;
                server
            }
        };
        let Credentials { certificate_pem, key_pem } = server;
        Ok(ServerCredentials { authority_pem: authority.certificate_pem, certificate_pem, key_pem })
    }

    /// Writes the authority's certificate into a file without its key, for clients of the API. Returns the file's path.
    ///
    /// # Errors
    /// [`EnrolmentError`] if a file cannot be used.
    pub fn publish(&self) -> Result<PathBuf, EnrolmentError> {
        let _alone = self.lock()?;
        let (authority, _) = self.credentials()?;
        let path = self.folder.join(CA);
        if files::read(&path, LONGEST_PEM)?.as_ref() != Some(&authority.certificate_pem) {
            files::save(&path, &authority.certificate_pem)?;
        }
        Ok(path)
    }

    fn opened(&self) -> Result<File, EnrolmentError> {
        let missing = || EnrolmentError::NoAuthority { folder: self.folder.clone() };
        files::open_folder(&self.folder)?.ok_or_else(missing)
    }

    fn lock(&self) -> Result<File, EnrolmentError> {
        files::lock(self.opened()?, &self.folder)
    }

    /// Returns the authority's credentials, and the end of their validity.
    fn credentials(&self) -> Result<(Credentials, DateTime<Utc>), EnrolmentError> {
        let path = self.folder.join(AUTHORITY);
        let text = files::read(&path, LONGEST_PEM)?;
        let text = text.ok_or_else(|| EnrolmentError::NoAuthority { folder: self.folder.clone() })?;
        let read = || {
            let credentials = Credentials::split(&text).ok_or("it has no key")?;
            let ends = credentials.authority_ends()?;
            Ok((credentials, ends))
        };
        read().map_err(|reason: String| EnrolmentError::Damaged { path, reason })
    }

    fn unexpired(&self, now: DateTime<Utc>) -> Result<(Credentials, DateTime<Utc>), EnrolmentError> {
        let (credentials, at) = self.credentials()?;
        if now < at {
            Ok((credentials, at))
        } else {
            Err(EnrolmentError::AuthorityExpired { folder: self.folder.clone(), at })
        }
    }

    fn registry(&self) -> Result<Registry, EnrolmentError> {
        let missing = || EnrolmentError::Damaged {
            path: self.folder.join(REGISTRY),
            reason: "it is missing".to_owned(),
        };
        self.read_registry()?.ok_or_else(missing)
    }

    fn read_registry(&self) -> Result<Option<Registry>, EnrolmentError> {
        let path = self.folder.join(REGISTRY);
        let Some(text) = files::read(&path, LONGEST_REGISTRY)? else { return Ok(None) };
        Registry::parse(&text).map(Some).map_err(|reason| EnrolmentError::Damaged { path, reason })
    }

    fn save_registry(&self, registry: &Registry) -> Result<(), EnrolmentError> {
        files::save(&self.folder.join(REGISTRY), &registry.text())
    }
}
