//! Trust in an API with TLS: an authority from a file.

use std::{fs, path::Path, sync::Arc};

use rustls::crypto::ring;
use ureq::{
    Error,
    tls::{Certificate, PemItem, RootCerts, TlsConfig, parse_pem},
};

use super::ClientError;

/// Returns a configuration that trusts the authorities in a file of PEM, and no other.
pub(super) fn authority(path: &Path) -> Result<TlsConfig, ClientError> {
    let wrong = |reason: String| ClientError::Authority { path: path.to_owned(), reason };
    let text = fs::read(path).map_err(|error| wrong(error.to_string()))?;
    let certificates: Vec<Certificate<'static>> = parse_pem(&text)
        .filter_map(|item| match item {
            Ok(PemItem::Certificate(certificate)) => Some(Ok(certificate)),
            Ok(_) => None,
            Err(error) => Some(Err(wrong(error.to_string()))),
        })
        .collect::<Result<_, _>>()?;
    if certificates.is_empty() {
        return Err(wrong("it has no certificate in PEM".to_owned()));
    }
    Ok(TlsConfig::builder()
        .root_certs(RootCerts::new_with_certs(&certificates))
        .unversioned_rustls_crypto_provider(Arc::new(ring::default_provider()))
        .build())
}

/// Returns the mistake of a certificate, if that is why a request failed.
pub(super) fn mistake(error: &Error) -> Option<String> {
    let Error::Io(error) = error else { return None };
    match error.get_ref()?.downcast_ref()? {
        rustls::Error::InvalidCertificate(reason) => Some(reason.to_string()),
        _ => None,
    }
}
