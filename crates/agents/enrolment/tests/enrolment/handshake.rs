//! Agents and the core know only each other, by TLS. All handshakes are in memory, at a given time.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{fmt, sync::Arc, time::Duration};

use chrono::{DateTime, TimeDelta, Utc};
use cotorra_enrolment::{
    Authority, Bundle, CORE_COMMON_NAME, CoreEndpoint, EnrolmentError, ServerCredentials,
};
use cotorra_graph::AgentId;
use rustls::{
    CertificateError, ClientConfig, ClientConnection, DigitallySignedStruct, Error, RootCertStore,
    ServerConfig, ServerConnection, SignatureScheme,
    client::{
        danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier},
        verify_server_cert_signed_by_trust_anchor,
    },
    crypto::{CryptoProvider, ring, verify_tls12_signature, verify_tls13_signature},
    pki_types::{CertificateDer, PrivateKeyDer, ServerName, UnixTime, pem::PemObject},
    server::{ParsedCertificate, WebPkiClientVerifier},
    time_provider::TimeProvider,
    version::TLS13,
};
use tempfile::TempDir;

const HOST: &str = "lab.example.org";
const DAY: Duration = Duration::from_hours(24);

fn start() -> DateTime<Utc> {
    DateTime::from_timestamp(1_800_000_000, 0).unwrap()
}

/// A certificate and its key.
#[derive(Clone, Copy)]
struct Shown<'a> {
    certificate: &'a str,
    key: &'a str,
}

fn agents(bundle: &Bundle) -> Shown<'_> {
    Shown { certificate: bundle.certificate_pem(), key: bundle.key_pem() }
}

fn cores(core: &ServerCredentials) -> Shown<'_> {
    Shown { certificate: &core.certificate_pem, key: &core.key_pem }
}

/// An authority with an enrolled agent, and its core.
struct Lab {
    _folder: TempDir,
    authority: Authority,
    agent: Bundle,
    core: ServerCredentials,
}

impl Lab {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let authority = Authority::create_or_open(folder.path().join("agents"), start()).unwrap();
        let endpoint: CoreEndpoint = format!("{HOST}:7448").parse().unwrap();
        let agent = authority.enrol(&AgentId::new("robot").unwrap(), &endpoint, 90 * DAY, start()).unwrap();
        let core = authority.core(start()).unwrap();
        Self { _folder: folder, authority, agent, core }
    }

    /// Connects this agent to this core, a minute after the start.
    fn connect(&self, agent: Option<Shown<'_>>, core: Shown<'_>) -> Result<Connected, Refused> {
        let trusted = (self.agent.authority_pem(), &*self.core.authority_pem);
        handshake(agent, core, trusted, start() + TimeDelta::minutes(1), HOST)
    }
}

#[derive(Debug, Clone)]
struct Clock(DateTime<Utc>);

impl TimeProvider for Clock {
    fn current_time(&self) -> Option<UnixTime> {
        Some(UnixTime::since_unix_epoch(Duration::from_secs(self.0.timestamp().try_into().unwrap())))
    }
}

/// Verifies all but the host's name, so that a refusal has another reason.
#[derive(Debug)]
struct AnyName(RootCertStore, CryptoProvider);

impl ServerCertVerifier for AnyName {
    fn verify_server_cert(
        &self,
        certificate: &CertificateDer<'_>,
        intermediates: &[CertificateDer<'_>],
        _name: &ServerName<'_>,
        _ocsp: &[u8],
        now: UnixTime,
    ) -> Result<ServerCertVerified, Error> {
        let parsed = ParsedCertificate::try_from(certificate)?;
        let algorithms = self.1.signature_verification_algorithms.all;
        verify_server_cert_signed_by_trust_anchor(&parsed, &self.0, intermediates, now, algorithms)?;
        Ok(ServerCertVerified::assertion())
    }

    fn verify_tls12_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        verify_tls12_signature(message, certificate, signed, &self.1.signature_verification_algorithms)
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        verify_tls13_signature(message, certificate, signed, &self.1.signature_verification_algorithms)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.1.signature_verification_algorithms.supported_schemes()
    }
}

#[derive(Debug)]
struct Connected {
    /// First certificate that the core received.
    agent: CertificateDer<'static>,
    /// First certificate that the agent received.
    core: CertificateDer<'static>,
}

#[derive(Debug, PartialEq)]
enum Refused {
    ByAgent(Error),
    ByCore(Error),
}

impl fmt::Display for Refused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::ByAgent(error) => write!(f, "the agent refuses: {error}"),
            Self::ByCore(error) => write!(f, "the core refuses: {error}"),
        }
    }
}

fn roots(pem: &str) -> RootCertStore {
    let mut roots = RootCertStore::empty();
    for certificate in CertificateDer::pem_slice_iter(pem.as_bytes()) {
        roots.add(certificate.unwrap()).unwrap();
    }
    roots
}

fn chain(shown: Shown<'_>) -> (Vec<CertificateDer<'static>>, PrivateKeyDer<'static>) {
    let certificate = CertificateDer::from_pem_slice(shown.certificate.as_bytes()).unwrap();
    (vec![certificate], PrivateKeyDer::from_pem_slice(shown.key.as_bytes()).unwrap())
}

/// Connects an agent to a core, each with the authorities that it trusts. An empty host is not verified.
fn handshake(
    agent: Option<Shown<'_>>,
    core: Shown<'_>,
    (agent_trusts, core_trusts): (&str, &str),
    now: DateTime<Utc>,
    host: &str,
) -> Result<Connected, Refused> {
    let provider = Arc::new(ring::default_provider());
    let clock = Arc::new(Clock(now));

    let verifier = WebPkiClientVerifier::builder_with_provider(roots(core_trusts).into(), provider.clone());
    let (certificates, key) = chain(core);
    let server = ServerConfig::builder_with_details(provider.clone(), clock.clone())
        .with_protocol_versions(&[&TLS13])
        .unwrap()
        .with_client_cert_verifier(verifier.build().unwrap())
        .with_single_cert(certificates, key)
        .unwrap();

    let client = ClientConfig::builder_with_details(provider.clone(), clock);
    let client = client.with_protocol_versions(&[&TLS13]).unwrap();
    let client = if host.is_empty() {
        let any = AnyName(roots(agent_trusts), (*provider).clone());
        client.dangerous().with_custom_certificate_verifier(Arc::new(any))
    } else {
        client.with_root_certificates(roots(agent_trusts))
    };
    let client = match agent {
        Some(agent) => {
            let (certificates, key) = chain(agent);
            client.with_client_auth_cert(certificates, key).unwrap()
        }
        None => client.with_no_client_auth(),
    };
    let host = if host.is_empty() { "192.0.2.1" } else { host };
    let name = ServerName::try_from(host.to_owned()).unwrap();
    let mut client = ClientConnection::new(client.into(), name).unwrap();
    let mut server = ServerConnection::new(server.into()).unwrap();

    while client.is_handshaking() || server.is_handshaking() {
        let mut wire = Vec::new();
        while client.wants_write() {
            client.write_tls(&mut wire).unwrap();
        }
        let mut rest = &*wire;
        while !rest.is_empty() {
            server.read_tls(&mut rest).unwrap();
            server.process_new_packets().map_err(Refused::ByCore)?;
        }
        let mut wire = Vec::new();
        while server.wants_write() {
            server.write_tls(&mut wire).unwrap();
        }
        let mut rest = &*wire;
        while !rest.is_empty() {
            client.read_tls(&mut rest).unwrap();
            client.process_new_packets().map_err(Refused::ByAgent)?;
        }
    }
    let first = |certificates: Option<&[CertificateDer<'static>]>| certificates.unwrap()[0].clone();
    Ok(Connected { agent: first(server.peer_certificates()), core: first(client.peer_certificates()) })
}

/// Returns the common name of a certificate by another reader than the crate's own.
fn common_name(certificate: &CertificateDer<'_>) -> String {
    let (_, certificate) = x509_parser::parse_x509_certificate(certificate).unwrap();
    let names: Vec<_> = certificate.subject().iter_common_name().collect();
    assert_eq!(names.len(), 1);
    names[0].as_str().unwrap().to_owned()
}

/// Each refusal is the same whether the agent verifies the host's name or not.
fn refused(lab: &Lab, agent: Option<Shown<'_>>, core: Shown<'_>) -> Refused {
    let trusted = (lab.agent.authority_pem(), &*lab.core.authority_pem);
    let now = start() + TimeDelta::minutes(1);
    handshake(agent, core, trusted, now, "").expect_err("it is refused")
}

#[test]
fn an_agent_and_the_core_know_each_other() {
    let lab = Lab::new();
    let connected = lab.connect(Some(agents(&lab.agent)), cores(&lab.core)).unwrap();
    assert_eq!(common_name(&connected.agent), "robot.1");
    assert_eq!(common_name(&connected.core), CORE_COMMON_NAME);
    assert_eq!(lab.authority.granted(start()).unwrap()[0].common_name, common_name(&connected.agent));
}

#[test]
fn agents_of_another_authority_are_refused() {
    let [lab, other] = [Lab::new(), Lab::new()];
    let unknown = Error::InvalidCertificate(CertificateError::UnknownIssuer);
    let as_agent = refused(&lab, Some(agents(&other.agent)), cores(&lab.core));
    assert_eq!(as_agent, Refused::ByCore(unknown.clone()), "{as_agent}");
    let as_core = refused(&lab, Some(agents(&lab.agent)), cores(&other.core));
    assert_eq!(as_core, Refused::ByAgent(unknown), "{as_core}");
}

#[test]
fn agents_without_a_certificate_are_refused() {
    let lab = Lab::new();
    assert_eq!(refused(&lab, None, cores(&lab.core)), Refused::ByCore(Error::NoCertificatesPresented));
}

#[test]
fn an_agent_cannot_pass_for_the_core() {
    let lab = Lab::new();
    let name = AgentId::new("spy").unwrap();
    let spy = lab.authority.enrol(&name, lab.agent.core(), 90 * DAY, start()).unwrap();
    let error = refused(&lab, Some(agents(&lab.agent)), agents(&spy));
    let Refused::ByAgent(Error::InvalidCertificate(CertificateError::InvalidPurposeContext { .. })) = error
    else {
        panic!("{error}");
    };
}

#[test]
fn the_core_cannot_pass_for_an_agent() {
    let lab = Lab::new();
    let error = refused(&lab, Some(cores(&lab.core)), cores(&lab.core));
    let Refused::ByCore(Error::InvalidCertificate(CertificateError::InvalidPurposeContext { .. })) = error
    else {
        panic!("{error}");
    };
}

#[test]
fn a_certificate_is_valid_from_five_minutes_before_it_was_made_to_its_end() {
    let lab = Lab::new();
    let at = |now| {
        let trusted = (lab.agent.authority_pem(), &*lab.core.authority_pem);
        handshake(Some(agents(&lab.agent)), cores(&lab.core), trusted, now, HOST)
    };
    let end = lab.agent.certificate().not_after;
    assert_eq!(end, start() + TimeDelta::days(90));
    assert!(at(start() - TimeDelta::minutes(5)).is_ok() && at(end - TimeDelta::seconds(1)).is_ok());
    let early = at(start() - TimeDelta::minutes(6)).unwrap_err();
    let Refused::ByAgent(Error::InvalidCertificate(CertificateError::NotValidYetContext { .. })) = early
    else {
        panic!("{early}");
    };
    let late = at(end + TimeDelta::seconds(1)).unwrap_err();
    let Refused::ByCore(Error::InvalidCertificate(CertificateError::ExpiredContext { .. })) = late else {
        panic!("{late}");
    };
    assert!(lab.authority.granted(end).unwrap().is_empty());
}

#[test]
fn the_core_has_the_hosts_at_which_agents_reach_it() {
    let lab = Lab::new();
    let trusted = (lab.agent.authority_pem(), &*lab.core.authority_pem);
    let at = |core: &ServerCredentials, host| {
        handshake(Some(agents(&lab.agent)), cores(core), trusted, start(), host).map(|_| ())
    };
    let error = at(&lab.core, "10.0.0.7").unwrap_err();
    let Refused::ByAgent(Error::InvalidCertificate(CertificateError::NotValidForNameContext { .. })) = error
    else {
        panic!("{error}");
    };
    let name = AgentId::new("other").unwrap();
    lab.authority.enrol(&name, &"10.0.0.7:7448".parse().unwrap(), DAY, start()).unwrap();
    let anew = lab.authority.core(start()).unwrap();
    assert_eq!((at(&anew, "10.0.0.7"), at(&anew, HOST)), (Ok(()), Ok(())));
    assert!(at(&anew, "10.0.0.8").is_err());
    let name = AgentId::new("third").unwrap();
    lab.authority.enrol(&name, &"[fd00::7]:7448".parse().unwrap(), DAY, start()).unwrap();
    let anew = lab.authority.core(start()).unwrap();
    assert_eq!((at(&anew, "fd00::7"), at(&anew, HOST)), (Ok(()), Ok(())));
    assert!(at(&anew, "fd00::8").is_err());
}

#[test]
fn the_core_is_certified_again_before_it_expires_and_never_after_the_authority() {
    let lab = Lab::new();
    let same = lab.authority.core(start() + TimeDelta::days(200)).unwrap();
    assert_eq!(same.certificate_pem, lab.core.certificate_pem);
    let now = start() + TimeDelta::days(300);
    let core = lab.authority.core(now).unwrap();
    assert_ne!(core.certificate_pem, lab.core.certificate_pem);
    let name = lab.agent.certificate().name.clone();
    let agent = lab.authority.renew(&name, &Default::default(), now).unwrap();
    let trusted = (lab.agent.authority_pem(), &*core.authority_pem);
    let later = now + TimeDelta::days(80);
    assert!(handshake(Some(agents(&agent)), cores(&core), trusted, later, HOST).is_ok());

    // Near the end of the authority, the core's certificate ends with it, and is not made at each call.
    let near = start() + TimeDelta::days(3650);
    let [one, two] = [(); 2].map(|()| lab.authority.core(near).unwrap().certificate_pem);
    assert_eq!(one, two);
    let over = lab.authority.core(start() + TimeDelta::days(3653)).unwrap_err();
    assert!(matches!(over, EnrolmentError::AuthorityExpired { .. }), "{over}");
}
