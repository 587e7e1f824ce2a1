//! TLS for addresses beyond loopback: the API's certificate, and how a connection begins.

use std::{
    collections::BTreeSet,
    fmt, fs, io,
    net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr},
    path::{Path, PathBuf},
    sync::Arc,
};

use cotorra_enrolment::{Authority, EnrolmentError};
use rustls::{
    ServerConfig,
    pki_types::{CertificateDer, PrivateKeyDer, pem::PemObject},
    version::TLS13,
};
use sha2::{Digest as _, Sha256};
use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _},
    net::{TcpListener, TcpStream},
};
use tokio_rustls::{TlsAcceptor, server::TlsStream};
use tokio_util::either::Either;

/// Type of a record with which each connection of TLS begins (RFC 8446, 5.1).
const HANDSHAKE: u8 = 22;
/// Most of a request that is read before a client without TLS is hung up on, bytes.
const LONGEST_REQUEST: u64 = 16 << 10;
/// Most hosts in the API's certificate.
const MOST_HOSTS: usize = 256;
/// Scope of addresses in `/proc/net/if_inet6` that lead beyond their network.
const GLOBAL: &str = "00";

/// Protection of the API on an address beyond loopback.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Encryption {
    /// TLS with a certificate by the authority in this folder, or else in the user's folder. Both are made if they are
    /// missing.
    Authority(Option<PathBuf>),
    /// TLS with a certificate and key of the user, in files of PEM.
    Own {
        /// The certificate, and then those that lead to its authority.
        certificate: PathBuf,
        /// The key.
        key: PathBuf,
    },
    /// None: everyone who sees a packet sees the token.
    Off,
}

impl Default for Encryption {
    fn default() -> Self {
        Self::Authority(None)
    }
}

/// Error of the API's certificate.
#[derive(Debug, thiserror::Error)]
pub enum TlsError {
    /// The authority cannot be used.
    #[error("{}{}", .0, advice(.0))]
    Authority(#[from] EnrolmentError),
    /// The environment names no folder for an authority.
    #[error("neither XDG_CONFIG_HOME nor HOME names a folder for the authority: set one of them")]
    NoFolder,
    /// A file has no certificate or key.
    #[error("{}: {reason}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Its mistake.
        reason: String,
    },
    /// The certificate and the key cannot be used.
    #[error(transparent)]
    Certificate(#[from] rustls::Error),
}

/// Returns what to do about an authority that cannot be used.
fn advice(error: &EnrolmentError) -> String {
    error.help().map(|help| format!("; {help}")).unwrap_or_default()
}

/// Address and identity of the API for other machines.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NetworkApi {
    /// URL of the API.
    pub url: String,
    /// Identity of the API; `None` without TLS.
    pub identity: Option<Identity>,
}

/// Identity of the API for clients.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Identity {
    /// Certificate of the authority, for clients; `None` if the certificate is the user's own.
    pub authority: Option<PathBuf>,
    /// SHA-256 of the authority's certificate, or else of the user's, as `openssl x509 -fingerprint -sha256` prints it.
    pub fingerprint: String,
}

impl fmt::Display for NetworkApi {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.url)?;
        match &self.identity {
            None => write!(f, ", without TLS"),
            Some(Identity { authority: Some(authority), fingerprint }) => {
                write!(f, " with COTORRA_CA={} (SHA-256 {fingerprint})", authority.display())
            }
            Some(Identity { authority: None, fingerprint }) => {
                write!(f, " with your certificate (SHA-256 {fingerprint})")
            }
        }
    }
}

/// Returns the configuration of TLS at an address, and how clients know it.
pub(super) fn configure(
    encryption: &Encryption,
    address: SocketAddr,
) -> Result<Option<(Arc<ServerConfig>, Identity)>, TlsError> {
    let (chain, key, authority) = match encryption {
        Encryption::Off => return Ok(None),
        Encryption::Own { certificate, key } => (read_chain(certificate)?, read_key(key)?, None),
        Encryption::Authority(folder) => {
            let folder = folder.clone().or_else(Authority::default_folder).ok_or(TlsError::NoFolder)?;
            let authority = Authority::create_or_open(folder, today())?;
            let credentials = authority.api(&hosts(address), today())?;
            let damaged = |reason: rustls::pki_types::pem::Error| TlsError::File {
                path: authority.folder().to_owned(),
                reason: reason.to_string(),
            };
            let pem = |pem: &str| CertificateDer::from_pem_slice(pem.as_bytes()).map_err(damaged);
            let key = PrivateKeyDer::from_pem_slice(credentials.key_pem.as_bytes()).map_err(damaged)?;
            let known = (authority.publish()?, pem(&credentials.authority_pem)?);
            (vec![pem(&credentials.certificate_pem)?], key, Some(known))
        }
    };
    let identity = match authority {
        Some((path, certificate)) => {
            Identity { authority: Some(path), fingerprint: fingerprint(&certificate) }
        }
        None => Identity { authority: None, fingerprint: chain.first().map(fingerprint).unwrap_or_default() },
    };
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let mut config = ServerConfig::builder_with_provider(provider)
        .with_protocol_versions(&[&TLS13])?
        .with_no_client_auth()
        .with_single_cert(chain, key)?;
    config.alpn_protocols = vec![b"http/1.1".to_vec()];
    Ok(Some((Arc::new(config), identity)))
}

fn read_chain(path: &Path) -> Result<Vec<CertificateDer<'static>>, TlsError> {
    let chain = CertificateDer::pem_file_iter(path).and_then(Iterator::collect::<Result<Vec<_>, _>>);
    match chain {
        Ok(chain) if chain.is_empty() => Err(wrong(path, "it has no certificate in PEM")),
        chain => chain.map_err(|error| wrong(path, error)),
    }
}

fn read_key(path: &Path) -> Result<PrivateKeyDer<'static>, TlsError> {
    PrivateKeyDer::from_pem_file(path).map_err(|error| wrong(path, error))
}

fn wrong(path: &Path, reason: impl fmt::Display) -> TlsError {
    TlsError::File { path: path.to_owned(), reason: reason.to_string() }
}

fn fingerprint(certificate: &CertificateDer<'_>) -> String {
    let digest = Sha256::digest(certificate);
    digest.iter().map(|byte| format!("{byte:02X}")).collect::<Vec<_>>().join(":")
}

/// Returns the time of the calendar, at which certificates end.
#[allow(clippy::disallowed_methods, reason = "certificates end at a time of the calendar")]
fn today() -> chrono::DateTime<chrono::Utc> {
    chrono::Utc::now()
}

/// Returns the URL of the API on an address, for other machines.
pub(super) fn url(scheme: &str, address: SocketAddr) -> String {
    match host_name().filter(|_| address.ip().is_unspecified()) {
        Some(name) => format!("{scheme}://{name}:{}", address.port()),
        None => format!("{scheme}://{address}"),
    }
}

/// Returns the names and addresses at which clients reach the API on an address.
fn hosts(address: SocketAddr) -> BTreeSet<String> {
    let own = match address.ip() {
        ip if ip.is_unspecified() => addresses(),
        ip => vec![ip],
    };
    let own = own.into_iter().map(|ip| ip.to_string());
    let loopback = ["localhost", "127.0.0.1", "::1"].map(str::to_owned);
    loopback.into_iter().chain(host_name()).chain(own).take(MOST_HOSTS).collect()
}

/// Returns this machine's name, if it can be one in a certificate.
fn host_name() -> Option<String> {
    let name = fs::read_to_string("/proc/sys/kernel/hostname").ok()?.trim().to_ascii_lowercase();
    let is_part = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '.';
    (!name.is_empty() && name.chars().all(is_part)).then_some(name)
}

/// Returns this machine's addresses beyond loopback.
fn addresses() -> Vec<IpAddr> {
    let read = |name| fs::read_to_string(Path::new("/proc/thread-self/net").join(name)).unwrap_or_default();
    let v4 = ipv4_addresses(&read("fib_trie")).into_iter().map(IpAddr::V4);
    let all = v4.chain(ipv6_addresses(&read("if_inet6")).into_iter().map(IpAddr::V6));
    all.filter(|ip| !ip.is_loopback()).collect()
}

/// Finds the addresses of a machine in its `/proc/net/fib_trie`.
fn ipv4_addresses(routes: &str) -> BTreeSet<Ipv4Addr> {
    let mut last = None;
    let own = routes.lines().filter_map(|line| match line.trim().strip_prefix("|-- ") {
        Some(address) => {
            last = address.parse().ok();
            None
        }
        None => last.filter(|_| line.trim() == "/32 host LOCAL"),
    });
    own.collect()
}

/// Finds the global addresses of a machine in its `/proc/net/if_inet6`.
fn ipv6_addresses(interfaces: &str) -> BTreeSet<Ipv6Addr> {
    let address = |line: &str| {
        let mut words = line.split_whitespace();
        let address = u128::from_str_radix(words.next()?, 16).ok()?;
        (words.nth(2)? == GLOBAL).then(|| Ipv6Addr::from(address))
    };
    interfaces.lines().filter_map(address).collect()
}

/// A TCP port of the API. With TLS, connections to a loopback address can still be plain: their packets do not leave the
/// machine.
pub(super) struct Port {
    pub(super) listener: TcpListener,
    pub(super) tls: Option<Arc<ServerConfig>>,
    pub(super) origin: Origin,
}

/// Origin of a connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Origin {
    /// The run's socket, which only its user can open.
    User,
    /// A port of this machine.
    Machine,
    /// A port of an emulated node, which its applications reach.
    Node,
}

/// Begins a connection at a port with TLS, which buffers so many bytes of answers.
pub(super) async fn begin(
    tls: Arc<ServerConfig>,
    mut socket: TcpStream,
    buffer: usize,
) -> io::Result<Either<TcpStream, TlsStream<TcpStream>>> {
    let mut first = [0];
    socket.peek(&mut first).await?;
    let own = socket.local_addr()?;
    if first == [HANDSHAKE] {
        let accepted = TlsAcceptor::from(tls).accept_with(socket, |tls| tls.set_buffer_limit(Some(buffer)));
        Ok(Either::Right(accepted.await?))
    } else if own.ip().to_canonical().is_loopback() {
        Ok(Either::Left(socket))
    } else {
        reject(&mut socket, own).await?;
        Err(io::ErrorKind::PermissionDenied.into())
    }
}

/// Answers a client without TLS. Reads its request, because closing before would take the answer back.
async fn reject(socket: &mut TcpStream, own: SocketAddr) -> io::Result<()> {
    let error = format!("this address takes HTTPS only, as in https://{own}");
    let body = serde_json::json!({ "error": error }).to_string();
    let length = body.len();
    let answer = format!(
        "HTTP/1.1 400 Bad Request\r\ncontent-type: application/json\r\ncontent-length: {length}\r\n\
         connection: close\r\n\r\n{body}"
    );
    socket.write_all(answer.as_bytes()).await?;
    socket.shutdown().await?;
    tokio::io::copy(&mut socket.take(LONGEST_REQUEST), &mut tokio::io::sink()).await.map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_of_the_machine_are_found() {
        let routes = "Main:\n  +-- 0.0.0.0/0 3 0 5\n     |-- 192.0.2.0\n        /24 link UNICAST\n     |-- 192.0.2.2\n        \
                      /32 host LOCAL\n     |-- 192.0.2.255\n        /32 link BROADCAST\nLocal:\n     |-- 192.0.2.2\n        \
                      /32 host LOCAL\n     |-- 127.0.0.0\n        /8 host LOCAL\n";
        assert_eq!(ipv4_addresses(routes), BTreeSet::from([Ipv4Addr::new(192, 0, 2, 2)]));
        let interfaces = "fe8000000000000000fc00fffe000001 04 40 20 80     eth0\n\
                          20010db8000000000000000000000002 04 40 00 82     eth0\nnonsense\n";
        assert_eq!(ipv6_addresses(interfaces), BTreeSet::from(["2001:db8::2".parse().unwrap()]));
    }

    #[test]
    fn certificates_name_what_clients_use() {
        let named = hosts("192.0.2.7:7700".parse().unwrap());
        for host in ["192.0.2.7", "localhost", "127.0.0.1", "::1"] {
            assert!(named.contains(host), "{named:?}");
        }
        let all = hosts("[::]:7700".parse().unwrap());
        assert!(addresses().iter().all(|ip| all.contains(&ip.to_string())), "{all:?}");
    }

    #[test]
    fn unusable_certificates_name_their_file() {
        let folder = tempfile::tempdir().unwrap();
        let [certificate, key] = ["certificate.pem", "key.pem"].map(|name| folder.path().join(name));
        let own = Encryption::Own { certificate: certificate.clone(), key: key.clone() };
        let error = || configure(&own, "192.0.2.7:7700".parse().unwrap()).unwrap_err().to_string();
        assert!(error().contains("certificate.pem"), "{}", error());
        fs::write(&certificate, "nothing").unwrap();
        assert!(error().ends_with("certificate.pem: it has no certificate in PEM"), "{}", error());
        let made = Authority::create_or_open(folder.path().join("agents"), today()).unwrap();
        let made = made.api(&BTreeSet::from(["lab".to_owned()]), today()).unwrap();
        fs::write(&certificate, made.certificate_pem).unwrap();
        fs::write(&key, "nothing").unwrap();
        assert!(error().contains("key.pem"), "{}", error());
        fs::write(&key, made.key_pem).unwrap();
        let (_, identity) = configure(&own, "192.0.2.7:7700".parse().unwrap()).unwrap().unwrap();
        assert_eq!((identity.authority, identity.fingerprint.len()), (None, 95));
    }
}
