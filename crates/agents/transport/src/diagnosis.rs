//! Why a connection does not come about.

use std::{
    io::{self, Read, Write},
    net::{TcpStream, ToSocketAddrs},
    time::Duration,
};

use rustls::{AlertDescription, ClientConnection, StreamOwned};

use crate::{
    dialer::server_name,
    tls::{self, Credentials},
};

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
    let config = tls::client(credentials).map_err(|e| e.to_string())?;
    let name = server_name(core).map_err(|e| e.to_string())?;
    let connection = ClientConnection::new(config, name).map_err(|e| e.to_string())?;
    let mut stream = StreamOwned::new(connection, stream);
    // The core checks the agent's certificate after the handshake, and refuses it by an alert in place of data.
    match stream.flush().and_then(|()| stream.read(&mut [0; 1])) {
        Ok(_) => Ok(()),
        Err(error) if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) => Ok(()),
        Err(error) => Err(explained(&error)),
    }
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
            AlertDescription::NoApplicationProtocol => {
                "the core is of another version; use the agent and the core of one release".to_owned()
            }
            other => format!("the core refuses this agent's certificate: {other:?}"),
        },
        Some(rustls::Error::InvalidCertificate(reason)) => {
            format!("the machine there is not the core that enrolled this agent: {reason}")
        }
        _ => format!("no TLS is spoken there: {error}"),
    }
}
