//! Why a connection does not come about. Zenoh itself only reports a timeout.

use std::{
    io::{self, Read, Write},
    net::{TcpStream, ToSocketAddrs},
    sync::Arc,
    time::Duration,
};

use rustls::{
    AlertDescription, ClientConfig, ClientConnection, RootCertStore, StreamOwned,
    pki_types::{CertificateDer, PrivateKeyDer, ServerName, pem::PemObject},
};

use crate::config::Credentials;

/// Time for each step.
const TIMEOUT: Duration = Duration::from_secs(2);

/// Connects to the core by TLS alone, and returns at once.
///
/// # Errors
/// The reason for which the core cannot be reached, or for which one of the two ends refuses the other, for people.
pub fn diagnose(core: &str, credentials: Credentials<'_>) -> Result<(), String> {
    let (host, _) = core.rsplit_once(':').ok_or("the core's address has no port")?;
    let mut addresses = core.to_socket_addrs().map_err(|e| format!("`{host}` is not known: {e}"))?;
    let address = addresses.next().ok_or_else(|| format!("`{host}` has no address"))?;
    let stream = TcpStream::connect_timeout(&address, TIMEOUT)
        .map_err(|e| format!("nobody listens there, or a firewall is between: {e}"))?;
    for set in [TcpStream::set_read_timeout, TcpStream::set_write_timeout] {
        set(&stream, Some(TIMEOUT)).map_err(|e| e.to_string())?;
    }
    let config = config(credentials)?;
    let name = host.trim_matches(['[', ']']);
    let name = ServerName::try_from(name.to_owned()).map_err(|e| format!("`{name}`: {e}"))?;
    let connection = ClientConnection::new(Arc::new(config), name).map_err(|e| e.to_string())?;
    let mut stream = StreamOwned::new(connection, stream);
    // The core checks the agent's certificate after the handshake, and refuses it by an alert in place of data.
    match stream.flush().and_then(|()| stream.read(&mut [0; 1])) {
        Ok(_) => Ok(()),
        Err(error) if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) => Ok(()),
        Err(error) => Err(explained(&error)),
    }
}

fn config(credentials: Credentials<'_>) -> Result<ClientConfig, String> {
    let text = |e: &dyn std::fmt::Display| format!("the credentials are not valid: {e}");
    let mut roots = RootCertStore::empty();
    for certificate in CertificateDer::pem_slice_iter(credentials.authority.as_bytes()) {
        roots.add(certificate.map_err(|e| text(&e))?).map_err(|e| text(&e))?;
    }
    let chain: Result<Vec<_>, _> =
        CertificateDer::pem_slice_iter(credentials.certificate.as_bytes()).collect();
    let key = PrivateKeyDer::from_pem_slice(credentials.key.as_bytes()).map_err(|e| text(&e))?;
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .map_err(|e| text(&e))?
        .with_root_certificates(roots)
        .with_client_auth_cert(chain.map_err(|e| text(&e))?, key)
        .map_err(|e| text(&e))
}

fn explained(error: &io::Error) -> String {
    let tls = error.get_ref().and_then(|inner| inner.downcast_ref::<rustls::Error>());
    match tls {
        Some(rustls::Error::AlertReceived(alert)) => match alert {
            AlertDescription::CertificateExpired => {
                "this agent's certificate has expired; `cotorra agent renew` makes a new one".to_owned()
            }
            AlertDescription::UnknownCA | AlertDescription::DecryptError => {
                "the core does not know the authority of this agent's certificate; was the agent enrolled on that machine?"
                    .to_owned()
            }
            other => format!("the core refuses this agent's certificate: {other:?}"),
        },
        Some(rustls::Error::InvalidCertificate(reason)) => {
            format!("the machine there is not the core that enrolled this agent: {reason}")
        }
        _ => format!("no TLS is spoken there: {error}"),
    }
}
