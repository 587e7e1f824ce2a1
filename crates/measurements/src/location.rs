//! Location of a history, as a user names it: a file, or a database of a server.

use std::{
    fmt,
    path::{Path, PathBuf},
    str::FromStr,
    sync::Arc,
};

use crate::error::Error;

/// Location of a history. Parsed from a path, or from `mysql://user:password@host:port/database`, which serves MariaDB as
/// well. After a `?`, a server's URL may have `socket=PATH` (a Unix socket instead of host and port) and `spool=FOLDER`
/// (the folder for events recorded during an outage), joined by `&`.
///
/// Neither its text nor its debug output holds the password.
#[derive(Clone, PartialEq, Eq)]
pub enum Location {
    /// A SQLite database.
    File(PathBuf),
    /// A database of a MySQL or MariaDB server.
    Server(Server),
}

/// A database of a server, and the credentials for it.
#[derive(Clone, PartialEq, Eq)]
pub struct Server {
    pub(crate) user: String,
    pub(crate) password: Option<String>,
    pub(crate) host: String,
    pub(crate) port: u16,
    pub(crate) socket: Option<String>,
    pub(crate) database: String,
    pub(crate) spool: PathBuf,
    /// Name in errors, without the password.
    pub(crate) name: Arc<str>,
}

/// A text that is not a location of a history.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{problem}: name a server as mysql://user:password@host:port/database")]
pub struct InvalidLocation {
    problem: String,
}

fn invalid(problem: impl Into<String>) -> InvalidLocation {
    InvalidLocation { problem: problem.into() }
}

/// Returns the default folder of spools: `cotorra/spool` in the user's folder for state, as the XDG base directory
/// specification says, or else in the folder for temporary files.
fn default_spool() -> PathBuf {
    let set = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let state = set("XDG_STATE_HOME").or_else(|| set("HOME").map(|home| home.join(".local/state")));
    state.unwrap_or_else(std::env::temp_dir).join("cotorra/spool")
}

impl FromStr for Location {
    type Err = InvalidLocation;
    fn from_str(text: &str) -> Result<Self, InvalidLocation> {
        match text.split_once("://") {
            Some(("mysql" | "mariadb", rest)) => Server::parse(rest).map(Self::Server),
            Some((scheme, _)) if scheme.chars().all(|c| c.is_ascii_alphanumeric()) => {
                Err(invalid(format!("`{scheme}` is not a kind of server that keeps histories")))
            }
            _ if text.is_empty() => Err(invalid("the name of a history is empty")),
            _ => Ok(Self::File(PathBuf::from(text))),
        }
    }
}

impl Location {
    /// Returns the location with this password for a server whose URL has none.
    pub fn with_password(self, password: &str) -> Self {
        match self {
            Self::Server(server) if server.password.is_none() => {
                Self::Server(Server { password: Some(password.to_owned()), ..server })
            }
            other => other,
        }
    }

    /// Rejects a server if this cotorra was built without the feature `databases`.
    ///
    /// # Errors
    /// [`Error::WithoutServers`].
    pub fn check(&self) -> Result<(), Error> {
        match self {
            Self::Server(_) if cfg!(not(feature = "databases")) => Err(self.unsupported()),
            _ => Ok(()),
        }
    }

    pub(crate) fn unsupported(&self) -> Error {
        Error::WithoutServers { history: self.to_string().into() }
    }

    /// Whether it has a password.
    pub fn has_password(&self) -> bool {
        matches!(self, Self::Server(server) if server.password.is_some())
    }
}

impl Server {
    fn parse(rest: &str) -> Result<Self, InvalidLocation> {
        let (place, options) = rest.split_once('?').unwrap_or((rest, ""));
        let (authority, database) = place.split_once('/').unwrap_or((place, ""));
        // A password may hold an unescaped @; a host never does.
        let (user, host) = authority.rsplit_once('@').unwrap_or(("", authority));
        let (user, password) = match user.split_once(':') {
            Some((user, password)) => (user, Some(decoded(password)?)),
            None => (user, None),
        };
        let (host, port) = match host.rsplit_once(':').filter(|(_, port)| !port.contains(']')) {
            Some((host, port)) => {
                // Not shown: in a URL without an @, this is the password.
                (host, port.parse().map_err(|_| invalid("the port is not a number from 0 to 65535"))?)
            }
            None => (host, 3306),
        };
        let host = host.trim_start_matches('[').trim_end_matches(']');
        let mut server = Self {
            user: if user.is_empty() { "cotorra".to_owned() } else { decoded(user)? },
            password,
            host: if host.is_empty() { "localhost".to_owned() } else { host.to_owned() },
            port,
            socket: None,
            database: decoded(database)?,
            spool: default_spool(),
            name: "".into(),
        };
        if server.database.is_empty() || server.database.contains('/') {
            return Err(invalid("a server's URL ends with the name of one database"));
        }
        for option in options.split('&').filter(|option| !option.is_empty()) {
            match option.split_once('=') {
                Some(("socket", path)) => server.socket = Some(decoded(path)?),
                Some(("spool", folder)) => server.spool = PathBuf::from(decoded(folder)?),
                _ => {
                    let name = option.split('=').next().unwrap_or_default();
                    return Err(invalid(format!(
                        "`{name}` is not an option of a server; socket and spool are"
                    )));
                }
            }
        }
        server.name = match &server.socket {
            Some(socket) => format!("mysql://{socket}/{}", server.database),
            None if server.host.contains(':') => {
                format!("mysql://[{}]:{port}/{}", server.host, server.database)
            }
            None => format!("mysql://{}:{port}/{}", server.host, server.database),
        }
        .into();
        Ok(server)
    }
}

/// Decodes text of a URL: `%` and two hexadecimal digits are a byte (RFC 3986, section 2.1).
fn decoded(text: &str) -> Result<String, InvalidLocation> {
    let problem = || invalid("the URL has a `%` that no two hexadecimal digits follow, or is not UTF-8");
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.bytes();
    while let Some(byte) = rest.next() {
        if byte == b'%' {
            let mut digit = || rest.next().and_then(|c| char::from(c).to_digit(16)).ok_or_else(problem);
            let (high, low) = (digit()?, digit()?);
            bytes.push((high * 16 + low) as u8);
        } else {
            bytes.push(byte);
        }
    }
    String::from_utf8(bytes).map_err(|_| problem())
}

impl From<&Path> for Location {
    fn from(path: &Path) -> Self {
        Self::File(path.to_owned())
    }
}

impl fmt::Display for Location {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(path) => path.display().fmt(f),
            Self::Server(server) => f.pad(&server.name),
        }
    }
}

impl fmt::Debug for Location {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Location({self})")
    }
}

impl fmt::Debug for Server {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Server({})", self.name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(not(feature = "databases"))]
    #[test]
    fn without_the_feature_the_error_names_it() {
        let location: Location = "mysql://ana:secret@db/cotorra".parse().unwrap();
        for refused in [location.check().err(), crate::History::connect(&location).err()] {
            let shown = refused.unwrap().to_string();
            assert!(shown.contains("`--features databases`") && !shown.contains("secret"), "{shown}");
        }
        Location::from(Path::new("runs/all.sqlite")).check().unwrap();
    }

    fn server(text: &str) -> Server {
        match text.parse().unwrap() {
            Location::Server(server) => server,
            Location::File(path) => panic!("{} is a URL", path.display()),
        }
    }

    #[test]
    fn files_and_servers_are_parsed() {
        assert_eq!("runs/history.sqlite".parse(), Ok(Location::File("runs/history.sqlite".into())));
        let full = server("mysql://ana:p%40ss:w%2Frd@db.lab:3307/cotorra?spool=/var/spool/c%20c");
        assert_eq!((&*full.user, full.password.as_deref()), ("ana", Some("p@ss:w/rd")));
        assert_eq!((&*full.host, full.port, &*full.database), ("db.lab", 3307, "cotorra"));
        assert_eq!(full.spool, PathBuf::from("/var/spool/c c"));
        let short = server("mariadb://[::1]/cotorra?socket=/run/mysqld/mysqld.sock");
        assert_eq!((&*short.user, short.password, &*short.host, short.port), ("cotorra", None, "::1", 3306));
        assert_eq!(short.socket.as_deref(), Some("/run/mysqld/mysqld.sock"));
    }

    #[test]
    fn no_output_holds_the_password() {
        for text in ["mysql://ana:secret@db/cotorra", "mysql://ana:sec@secret@db/cotorra?socket=/s"] {
            let location: Location = text.parse().unwrap();
            let shown = format!("{location} {location:?} {:?}", server(text));
            assert!(!shown.contains("sec"), "{shown}");
        }
        for text in [
            "mysql://ana:secret@db/",
            "mysql://ana:secret@db:x/cotorra",
            "mysql://ana:secret@db/cotorra?tls=1",
            "mysql://ana:secret%4@db/cotorra",
            "mysql://ana:secret@db",
            "mysql://ana:secret/cotorra",
        ] {
            let error = text.parse::<Location>().unwrap_err();
            assert!(!format!("{error} {error:?}").contains("secret"), "{error}");
        }
    }

    #[test]
    fn a_password_may_be_given_apart_from_the_url() {
        let of = |url: &str| match url.parse::<Location>().unwrap().with_password("beside") {
            Location::Server(server) => server.password,
            Location::File(_) => None,
        };
        assert_eq!(of("mysql://ana@db/cotorra").as_deref(), Some("beside"));
        assert_eq!(of("mysql://ana:own@db/cotorra").as_deref(), Some("own"));
        assert_eq!(of("history.sqlite"), None);
    }

    #[test]
    fn other_servers_are_rejected() {
        let error = "postgres://db/cotorra".parse::<Location>().unwrap_err();
        assert!(error.to_string().starts_with("`postgres` is not a kind of server"), "{error}");
    }
}
