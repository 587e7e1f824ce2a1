//! Mutual TLS 1.3 with the authority of a testbed.
#![allow(clippy::disallowed_types, reason = "certificates end at a time of the calendar")]

use std::{
    sync::Arc,
    time::{Duration, SystemTime},
};

use rustls::{
    ClientConfig, CommonState, RootCertStore, ServerConfig,
    client::Resumption,
    crypto::CryptoProvider,
    pki_types::{CertificateDer, PrivateKeyDer, pem::PemObject},
    server::{NoServerSessionStorage, WebPkiClientVerifier},
};

use crate::error::TransportError;

/// Protocol of both ends, which shows them that the other is of another version (RFC 7301).
pub(crate) const PROTOCOL: &[u8] = b"cotorra-agent/1";

/// Key and certificate of one end, and the authority that signed those of the other, in PEM.
#[derive(Debug, Clone, Copy)]
pub struct Credentials<'a> {
    pub authority: &'a str,
    pub certificate: &'a str,
    pub key: &'a str,
}

/// Converts an error of reading credentials.
fn invalid(error: impl std::fmt::Display) -> TransportError {
    TransportError::Credentials(error.to_string())
}

impl Credentials<'_> {
    fn roots(&self) -> Result<RootCertStore, TransportError> {
        let mut roots = RootCertStore::empty();
        for certificate in CertificateDer::pem_slice_iter(self.authority.as_bytes()) {
            roots.add(certificate.map_err(invalid)?).map_err(invalid)?;
        }
        Ok(roots)
    }

    fn own(&self) -> Result<(Vec<CertificateDer<'static>>, PrivateKeyDer<'static>), TransportError> {
        let chain = CertificateDer::pem_slice_iter(self.certificate.as_bytes()).collect::<Result<_, _>>();
        let key = PrivateKeyDer::from_pem_slice(self.key.as_bytes());
        Ok((chain.map_err(invalid)?, key.map_err(invalid)?))
    }
}

fn provider() -> Arc<CryptoProvider> {
    Arc::new(rustls::crypto::ring::default_provider())
}

/// Returns the configuration of an agent's end. It accepts a core whose certificate names the host that was dialed.
pub(crate) fn client(credentials: Credentials<'_>) -> Result<Arc<ClientConfig>, TransportError> {
    let (chain, key) = credentials.own()?;
    let mut config = ClientConfig::builder_with_provider(provider())
        .with_safe_default_protocol_versions()
        .map_err(invalid)?
        .with_root_certificates(credentials.roots()?)
        .with_client_auth_cert(chain, key)
        .map_err(invalid)?;
    config.alpn_protocols = vec![PROTOCOL.to_vec()];
    config.resumption = Resumption::disabled();
    Ok(Arc::new(config))
}

/// Returns the configuration of the core's end. It accepts agents of the authority, whether they are granted or not.
pub(crate) fn server(credentials: Credentials<'_>) -> Result<Arc<ServerConfig>, TransportError> {
    let roots = Arc::new(credentials.roots()?);
    let verifier = WebPkiClientVerifier::builder_with_provider(roots, provider()).build().map_err(invalid)?;
    let (chain, key) = credentials.own()?;
    let mut config = ServerConfig::builder_with_provider(provider())
        .with_safe_default_protocol_versions()
        .map_err(invalid)?
        .with_client_cert_verifier(verifier)
        .with_single_cert(chain, key)
        .map_err(invalid)?;
    config.alpn_protocols = vec![PROTOCOL.to_vec()];
    config.session_storage = Arc::new(NoServerSessionStorage {});
    config.send_tls13_tickets = 0;
    Ok(Arc::new(config))
}

/// Identity of the other end.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Identity {
    pub(crate) common_name: String,
    /// End of its certificate's validity.
    pub(crate) expires: SystemTime,
}

/// Returns who the other end of a connection is, once the handshake is over.
///
/// # Errors
/// Reason for which the other end is rejected, for people.
pub(crate) fn identity(tls: &CommonState) -> Result<Identity, String> {
    if tls.alpn_protocol() != Some(PROTOCOL) {
        return Err("the other end speaks another version of the protocol".to_owned());
    }
    let der = tls.peer_certificates().and_then(<[_]>::first).ok_or("the other end has no certificate")?;
    let (_, certificate) = x509_parser::parse_x509_certificate(der)
        .map_err(|e| format!("its certificate cannot be read: {e}"))?;
    let mut names = certificate.subject().iter_common_name();
    let (Some(Ok(name)), None) = (names.next().map(|name| name.as_str()), names.next()) else {
        return Err("its certificate does not have one common name".to_owned());
    };
    let seconds = u64::try_from(certificate.validity().not_after.timestamp()).unwrap_or(0);
    Ok(Identity {
        common_name: name.to_owned(),
        expires: SystemTime::UNIX_EPOCH + Duration::from_secs(seconds),
    })
}
