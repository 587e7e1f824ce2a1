//! Options of an agent.

use std::{
    collections::BTreeSet,
    env, fs,
    path::{Path, PathBuf},
    str::FromStr,
};

use cotorra_agent_transport::Credentials;
use cotorra_enrolment::Bundle;
use cotorra_netem::Confirmed;
use cotorra_wifi::InterfaceName;

use crate::error::{AgentError, at};

/// A user and a group, as numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct User {
    pub(crate) uid: u32,
    pub(crate) gid: u32,
}

impl FromStr for User {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parsed = text.split_once(':').and_then(|(uid, gid)| Some((uid.parse().ok()?, gid.parse().ok()?)));
        let (uid, gid) = parsed.ok_or("use two numbers, such as 65534:65534")?;
        Ok(Self { uid, gid })
    }
}

/// The engine for images.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum ImageEngine {
    Podman,
    Docker,
}

impl From<ImageEngine> for cotorra_graph::EngineKind {
    fn from(engine: ImageEngine) -> Self {
        match engine {
            ImageEngine::Podman => Self::Podman,
            ImageEngine::Docker => Self::Docker,
        }
    }
}

/// Options of an agent.
#[derive(Debug, Clone)]
pub(crate) struct Options {
    /// The file with its credentials.
    pub(crate) credentials: PathBuf,
    /// Folder of its state.
    pub(crate) state: PathBuf,
    /// User of commands that are not trusted; `None` if the agent is not root, and cannot change its user.
    pub(crate) user: Option<User>,
    /// Whether commands can have the agent's own rights.
    pub(crate) allow_trusted: bool,
    /// The engine for images; `None` if the machine's owner does not permit any.
    pub(crate) images: Option<ImageEngine>,
    /// Changes to interfaces that the core may make.
    pub(crate) confirmed: Confirmed,
    /// Wi-Fi interfaces that the core may use.
    pub(crate) wifi: BTreeSet<InterfaceName>,
}

impl Options {
    /// Completes the options with what depends on the user. No Wi-Fi interface may be used.
    pub(crate) fn new(
        credentials: PathBuf,
        state: Option<PathBuf>,
        user: User,
        allow_trusted: bool,
        images: Option<ImageEngine>,
        confirmed: Confirmed,
    ) -> Result<Self, AgentError> {
        let is_root = rustix::process::geteuid().is_root();
        let state = match state {
            Some(state) => state,
            None if is_root => PathBuf::from("/var/lib/cotorra-agent"),
            None => users_state()?,
        };
        // VNFs have another working folder.
        let state = std::path::absolute(&state).map_err(at("find", &state))?;
        Ok(Self {
            credentials,
            state,
            user: is_root.then_some(user),
            allow_trusted,
            images,
            confirmed,
            wifi: BTreeSet::new(),
        })
    }
}

fn users_state() -> Result<PathBuf, AgentError> {
    let given = |name| env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let state = given("XDG_STATE_HOME").or_else(|| Some(given("HOME")?.join(".local/state")));
    Ok(state.ok_or(AgentError::NoState)?.join("cotorra-agent"))
}

/// Most that is read of a file with credentials.
const LONGEST: u64 = 64 << 10;

/// Reads a file with credentials.
pub(crate) fn bundle(path: &Path) -> Result<Bundle, AgentError> {
    use std::io::Read;
    let mut text = String::new();
    let file = fs::File::open(path).map_err(at("read", path))?;
    file.take(LONGEST).read_to_string(&mut text).map_err(at("read", path))?;
    Bundle::parse(&text).map_err(|source| AgentError::Credentials { path: path.to_owned(), source })
}

/// Returns the credentials for the transport.
pub(crate) fn credentials(bundle: &Bundle) -> Credentials<'_> {
    Credentials {
        authority: bundle.authority_pem(),
        certificate: bundle.certificate_pem(),
        key: bundle.key_pem(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn users_are_two_numbers() {
        assert_eq!("65534:65534".parse(), Ok(User { uid: 65534, gid: 65534 }));
        for wrong in ["", "nobody", "1", "1:", ":1", "1:2:3", "-1:2"] {
            assert!(wrong.parse::<User>().is_err(), "{wrong}");
        }
    }
}
