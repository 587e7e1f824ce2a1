//! Makes and reads the X.509 certificates of the authority, the core and agents.

use std::{
    collections::BTreeSet,
    fmt::Display,
    net::{Ipv4Addr, Ipv6Addr},
};

use chrono::{DateTime, TimeDelta, Utc};
use cotorra_graph::AgentId;
use rcgen::{
    BasicConstraints, Certificate, CertificateParams, DistinguishedName, DnType, ExtendedKeyUsagePurpose,
    IsCa, Issuer, KeyPair, KeyUsagePurpose, PublicKeyData,
};
use x509_parser::{
    certificate::X509Certificate,
    extensions::GeneralName,
    pem::{Pem, parse_x509_pem},
    prelude::{ASN1Time, FromDer},
};

use crate::EnrolmentError;

/// Common name of the core's certificate. Public authorities certify domain names only, which have no blank.
pub const CORE_COMMON_NAME: &str = "cotorra core";
/// Common name of the HTTP API's certificate, which agents do not take for the core's.
pub const API_COMMON_NAME: &str = "cotorra API";

/// Time by which clocks of agents may be behind.
const CLOCK_SKEW: TimeDelta = TimeDelta::minutes(5);

/// Content of an agent's certificate.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AgentCertificate {
    /// The agent.
    pub name: AgentId,
    /// Number of its certificate, from 1.
    pub generation: u32,
    /// End of its validity.
    pub not_after: DateTime<Utc>,
}

impl AgentCertificate {
    /// Returns the certificate's common name, such as `robot.2`.
    pub fn common_name(&self) -> String {
        common_name(&self.name, self.generation)
    }
}

/// Returns the common name of a generation of an agent.
pub fn common_name(name: &AgentId, generation: u32) -> String {
    format!("{name}.{generation}")
}

/// A certificate and its key, as PEM.
pub struct Credentials {
    pub certificate_pem: String,
    pub key_pem: String,
}

impl Credentials {
    /// Returns both as the text of one file.
    pub fn text(&self) -> String {
        format!("{}{}", self.certificate_pem, self.key_pem)
    }

    /// Splits the text of a file. Nothing is checked.
    pub fn split(text: &str) -> Option<Self> {
        let (certificate, key) = text.split_at(text.find("-----BEGIN PRIVATE KEY-----")?);
        Some(Self { certificate_pem: certificate.to_owned(), key_pem: key.to_owned() })
    }

    /// Returns the certificate if it can be read, and the key is its own.
    fn read(&self) -> Result<Pem, String> {
        let pem = certificate_block(&self.certificate_pem)?;
        let key = KeyPair::from_pem(&self.key_pem).map_err(|_| "the key cannot be read")?;
        let is_its = parse(&pem)?.public_key().raw == key.subject_public_key_info();
        if is_its { Ok(pem) } else { Err("the key is not that of the certificate".to_owned()) }
    }

    /// Returns the end of the validity of an authority's certificate, if these are the credentials of one.
    pub fn authority_ends(&self) -> Result<DateTime<Utc>, String> {
        let pem = self.read()?;
        let certificate = parse(&pem)?;
        if !certificate.is_ca() {
            return Err("the certificate is not that of an authority".to_owned());
        }
        not_after(&certificate)
    }

    /// Returns what an agent's certificate says, if the authority signed it, and the key is its own.
    pub fn agent(&self, authority_pem: &str) -> Result<AgentCertificate, String> {
        let pem = self.read()?;
        let certificate = parse(&pem)?;
        let usage = certificate.extended_key_usage().ok().flatten().map(|found| found.value);
        if !usage.is_some_and(|usage| usage.client_auth && !usage.server_auth && !usage.any) {
            return Err("the certificate is not that of a client".to_owned());
        }
        check_signature(&certificate, authority_pem)?;
        let text = subject(&certificate)?;
        let (name, number) =
            text.split_once('.').ok_or_else(|| format!("`{text}` is not an agent and a generation"))?;
        let name = AgentId::new(name).map_err(|error| error.to_string())?;
        let generation = number.parse().map_err(|_| format!("`{number}` is not a generation"))?;
        let found = AgentCertificate { name, generation, not_after: not_after(&certificate)? };
        // Rejects `robot.01`, too.
        if found.common_name() == text { Ok(found) } else { Err(format!("`{number}` is not a generation")) }
    }

    /// Returns the end of validity of a server's certificate, and its hosts, if it has this name, the authority signed it,
    /// and the key is its own.
    pub fn server(
        &self,
        common_name: &str,
        authority_pem: &str,
    ) -> Result<(DateTime<Utc>, BTreeSet<String>), String> {
        let pem = self.read()?;
        let certificate = parse(&pem)?;
        check_signature(&certificate, authority_pem)?;
        if subject(&certificate)? != common_name {
            return Err(format!("the certificate is not that of `{common_name}`"));
        }
        let names = certificate.subject_alternative_name().ok().flatten();
        let hosts = names.into_iter().flat_map(|names| &names.value.general_names).filter_map(host).collect();
        Ok((not_after(&certificate)?, hosts))
    }
}

fn host(name: &GeneralName<'_>) -> Option<String> {
    match name {
        GeneralName::DNSName(name) => Some((*name).to_owned()),
        GeneralName::IPAddress(octets) => match **octets {
            [a, b, c, d] => Some(Ipv4Addr::new(a, b, c, d).to_string()),
            _ => <[u8; 16]>::try_from(*octets).ok().map(|octets| Ipv6Addr::from(octets).to_string()),
        },
        _ => None,
    }
}

fn certificate_block(pem: &str) -> Result<Pem, &'static str> {
    let found = parse_x509_pem(pem.as_bytes()).ok().map(|(_, pem)| pem);
    found.filter(|pem| pem.label == "CERTIFICATE").ok_or("the certificate cannot be read")
}

fn parse(pem: &Pem) -> Result<X509Certificate<'_>, &'static str> {
    match X509Certificate::from_der(&pem.contents) {
        Ok(([], certificate)) => Ok(certificate),
        _ => Err("the certificate cannot be read"),
    }
}

fn subject(certificate: &X509Certificate<'_>) -> Result<String, String> {
    let mut names = certificate.subject().iter_common_name();
    match (names.next().and_then(|name| name.as_str().ok()), names.next()) {
        (Some(name), None) => Ok(name.to_owned()),
        _ => Err("the certificate does not have one common name".to_owned()),
    }
}

fn not_after(certificate: &X509Certificate<'_>) -> Result<DateTime<Utc>, String> {
    let seconds = certificate.validity().not_after.timestamp();
    DateTime::from_timestamp(seconds, 0).ok_or_else(|| "the certificate's validity cannot be read".to_owned())
}

fn check_signature(certificate: &X509Certificate<'_>, authority_pem: &str) -> Result<(), String> {
    let pem = certificate_block(authority_pem).map_err(|_| "the authority's certificate cannot be read")?;
    let authority = parse(&pem).map_err(|_| "the authority's certificate cannot be read")?;
    if !authority.is_ca() {
        return Err("the authority's certificate is not that of an authority".to_owned());
    }
    certificate
        .verify_signature(Some(authority.public_key()))
        .map_err(|_| "the authority did not sign the certificate".to_owned())
}

/// Makes the credentials of an authority.
pub fn make_authority(now: DateTime<Utc>, until: DateTime<Utc>) -> Result<Credentials, EnrolmentError> {
    let key = KeyPair::generate().map_err(failed)?;
    let mut params = params(now, until)?;
    let id: String = params.key_identifier(&key).iter().take(4).map(|byte| format!("{byte:02x}")).collect();
    params.distinguished_name = named(&format!("cotorra authority {id}"));
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    Ok(credentials(&params.self_signed(&key).map_err(failed)?, &key))
}

/// Makes the credentials of an agent, for clients only.
pub fn make_agent(
    authority: &Credentials,
    agent: &AgentCertificate,
    now: DateTime<Utc>,
) -> Result<Credentials, EnrolmentError> {
    let mut params = params(now, agent.not_after)?;
    params.distinguished_name = named(&agent.common_name());
    params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ClientAuth];
    signed(params, authority)
}

/// Makes the credentials of a server with this common name and these hosts only.
pub fn make_server(
    authority: &Credentials,
    common_name: &str,
    hosts: &BTreeSet<String>,
    now: DateTime<Utc>,
    until: DateTime<Utc>,
) -> Result<Credentials, EnrolmentError> {
    let hosts = hosts.iter().cloned().collect::<Vec<_>>();
    let mut params = params(now, until)?;
    params.subject_alt_names = CertificateParams::new(hosts).map_err(failed)?.subject_alt_names;
    params.distinguished_name = named(common_name);
    params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth];
    signed(params, authority)
}

fn params(now: DateTime<Utc>, until: DateTime<Utc>) -> Result<CertificateParams, EnrolmentError> {
    let time = |time: DateTime<Utc>| ASN1Time::from_timestamp(time.timestamp()).map_err(failed);
    let mut params = CertificateParams::default();
    params.not_before = time(now - CLOCK_SKEW)?.to_datetime();
    params.not_after = time(until)?.to_datetime();
    params.use_authority_key_identifier_extension = true;
    Ok(params)
}

fn signed(mut params: CertificateParams, authority: &Credentials) -> Result<Credentials, EnrolmentError> {
    params.is_ca = IsCa::ExplicitNoCa;
    params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    let authority_key = KeyPair::from_pem(&authority.key_pem).map_err(failed)?;
    let issuer = Issuer::from_ca_cert_pem(&authority.certificate_pem, authority_key).map_err(failed)?;
    let key = KeyPair::generate().map_err(failed)?;
    Ok(credentials(&params.signed_by(&key, &issuer).map_err(failed)?, &key))
}

fn credentials(certificate: &Certificate, key: &KeyPair) -> Credentials {
    let lines = |pem: String| pem.replace("\r\n", "\n");
    Credentials { certificate_pem: lines(certificate.pem()), key_pem: lines(key.serialize_pem()) }
}

fn named(common_name: &str) -> DistinguishedName {
    let mut name = DistinguishedName::new();
    name.push(DnType::CommonName, common_name);
    name
}

fn failed(error: impl Display) -> EnrolmentError {
    EnrolmentError::Certificate(error.to_string())
}
