//! Both ends of the transport over TLS on the loopback interface.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    collections::BTreeMap,
    io::{Read, Write},
    net::{SocketAddr, TcpListener, TcpStream},
    path::PathBuf,
    sync::{Arc, mpsc},
    thread,
    time::Duration,
};

use chrono::{DateTime, TimeDelta, Utc};
use cotorra_agent_protocol::{Beat, Report, Run, Transmit, Wanted};
use cotorra_agent_transport::{
    Credentials, Dialer, FromAgent, FromCore, Granted, Receiver, Router, TransportError, diagnose,
    frame::{Frame, Kind},
};
use cotorra_enrolment::{Authority, Bundle, CORE_COMMON_NAME};
use cotorra_graph::AgentId;
use rustls::{
    ClientConfig, ClientConnection, RootCertStore, StreamOwned,
    pki_types::{CertificateDer, PrivateKeyDer, ServerName, pem::PemObject},
};

/// Longer than any step takes on a busy machine. A test that waits so long fails.
const PATIENCE: Duration = Duration::from_secs(60);
const RUN: Run = Run(7);

fn name(name: &str) -> AgentId {
    AgentId::new(name).unwrap()
}

#[allow(clippy::disallowed_methods, reason = "certificates end at a time of the calendar")]
fn today() -> DateTime<Utc> {
    Utc::now()
}

/// An authority, and the address of its core.
struct Lab {
    authority: Authority,
    address: SocketAddr,
    _folder: tempfile::TempDir,
}

impl Lab {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let authority = Authority::create_or_open(folder.path().join("authority"), today()).unwrap();
        // The port is opened again later. At a loopback address of its own, no other process takes it meanwhile.
        let [_, a, b, c] = std::process::id().to_be_bytes();
        let address = TcpListener::bind(SocketAddr::from(([127, a | 0x80, b, c], 0))).unwrap();
        Self { authority, address: address.local_addr().unwrap(), _folder: folder }
    }

    fn enrol(&self, agent: &str) -> Bundle {
        self.enrol_at(agent, today(), Duration::from_secs(86400))
    }

    fn enrol_at(&self, agent: &str, at: DateTime<Utc>, validity: Duration) -> Bundle {
        let core = self.address.to_string().parse().unwrap();
        self.authority.enrol(&name(agent), &core, validity, at).unwrap()
    }

    fn granted(&self) -> Vec<Granted> {
        let all = self.authority.granted(today()).unwrap();
        all.into_iter().map(|its| Granted { agent: its.name, common_name: its.common_name }).collect()
    }

    /// Opens the router for agents that are granted now.
    fn router(&self, files: BTreeMap<String, PathBuf>) -> (Router, mpsc::Receiver<(AgentId, FromAgent)>) {
        let (send, received) = mpsc::channel();
        let receiver: Receiver = Arc::new(move |agent, message, _| drop(send.send((agent, message))));
        let core = self.authority.core(today()).unwrap();
        let credentials = Credentials {
            authority: &core.authority_pem,
            certificate: &core.certificate_pem,
            key: &core.key_pem,
        };
        let router = Router::open(self.address, credentials, &self.granted(), files, &receiver).unwrap();
        (router, received)
    }
}

fn credentials(bundle: &Bundle) -> Credentials<'_> {
    Credentials {
        authority: bundle.authority_pem(),
        certificate: bundle.certificate_pem(),
        key: bundle.key_pem(),
    }
}

/// Connects with these credentials as this agent.
fn dial(bundle: &Bundle, agent: &str) -> (Dialer, mpsc::Receiver<FromCore>) {
    let (send, received) = mpsc::channel();
    let core = bundle.core().to_string();
    let receive = move |message| drop(send.send(message));
    let dialer = Dialer::open(&core, CORE_COMMON_NAME, name(agent), credentials(bundle), receive);
    (dialer.unwrap(), received)
}

fn report(boot: u64) -> Report {
    Report {
        boot,
        run: RUN,
        generation: 0,
        echo: None,
        instances: BTreeMap::new(),
        stopping: 0,
        robot: None,
        links: BTreeMap::new(),
        wifi: Default::default(),
    }
}

fn beat(router: &Router, agent: &str) {
    let beat = Beat { run: RUN, generation: 1, sent_ns: 2, last_event: None };
    router.send(&Transmit::Beat(name(agent), beat));
}

/// Sends beats until the agent receives one.
fn wait_for_core(router: &Router, agent: &str, received: &mpsc::Receiver<FromCore>) {
    for _ in 0..600 {
        beat(router, agent);
        match received.recv_timeout(PATIENCE / 600) {
            Ok(FromCore::Beat(_)) => return,
            Ok(other) => panic!("{other:?}"),
            Err(_) => {}
        }
    }
    panic!("`{agent}` receives nothing");
}

/// Returns the next report that arrives, with its agent.
fn next_report(received: &mpsc::Receiver<(AgentId, FromAgent)>) -> (AgentId, Report) {
    loop {
        if let (agent, FromAgent::Report(report)) = received.recv_timeout(PATIENCE).unwrap() {
            return (agent, report);
        }
    }
}

#[test]
fn both_ends_exchange_messages_and_files() {
    let lab = Lab::new();
    let bundle = lab.enrol("edge1");
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(&file, [7; 100_000]).unwrap();
    let (router, arrived) = lab.router(BTreeMap::from([("abc".to_owned(), file.path().to_owned())]));
    let (mut dialer, received) = dial(&bundle, "edge1");
    wait_for_core(&router, "edge1", &received);
    dialer.report(&report(5));
    let mut is_connected = false;
    let (agent, reported) = loop {
        match arrived.recv_timeout(PATIENCE).unwrap() {
            (agent, FromAgent::Report(report)) => break (agent, report),
            (_, FromAgent::Connection { boot: 5, is_there }) => is_connected = is_there,
            other => panic!("{other:?}"),
        }
    };
    assert_eq!((agent, reported), (name("edge1"), report(5)));
    let wanted = Wanted {
        run: RUN,
        generation: 3,
        lease_ms: 2000,
        files: Vec::new(),
        instances: BTreeMap::new(),
        robot: None,
        links: BTreeMap::new(),
        wifi: Default::default(),
    };
    router.send(&Transmit::Wanted(name("edge1"), Box::new(wanted.clone())));
    loop {
        match received.recv_timeout(PATIENCE).unwrap() {
            FromCore::Wanted(got) => break assert_eq!(*got, wanted),
            FromCore::Beat(_) => {}
            other => panic!("{other:?}"),
        }
    }
    dialer.context(b"{}".to_vec());
    loop {
        match arrived.recv_timeout(PATIENCE).unwrap().1 {
            FromAgent::Context(context) => break assert_eq!(context, b"{}"),
            FromAgent::Connection { is_there, .. } => is_connected = is_there,
            other => panic!("{other:?}"),
        }
    }
    assert_eq!(dialer.fetcher().fetch("abc", 100_000).unwrap(), [7; 100_000]);
    drop(dialer);
    while is_connected || matches!(arrived.try_recv(), Ok((_, FromAgent::Connection { is_there: true, .. })))
    {
        if let FromAgent::Connection { is_there, .. } = arrived.recv_timeout(PATIENCE).unwrap().1 {
            is_connected = is_there;
        }
    }
}

#[test]
fn a_file_that_is_not_of_the_run_is_not_sent() {
    let lab = Lab::new();
    let bundle = lab.enrol("edge1");
    let (router, _arrived) = lab.router(BTreeMap::new());
    let (dialer, received) = dial(&bundle, "edge1");
    wait_for_core(&router, "edge1", &received);
    let fetched = dialer.fetcher().fetch("passwd", 100);
    assert!(matches!(fetched, Err(TransportError::NoFile { .. })), "{fetched:?}");
}

#[test]
fn an_agent_starts_before_its_core() {
    let lab = Lab::new();
    let bundle = lab.enrol("edge1");
    let (_edge, received) = dial(&bundle, "edge1");
    let (router, _) = lab.router(BTreeMap::new());
    wait_for_core(&router, "edge1", &received);
}

#[test]
fn an_agent_connects_again_when_the_core_is_back() {
    let lab = Lab::new();
    let bundle = lab.enrol("edge1");
    let (router, _arrived) = lab.router(BTreeMap::new());
    let (mut dialer, received) = dial(&bundle, "edge1");
    wait_for_core(&router, "edge1", &received);
    drop(router);
    let (router, arrived) = lab.router(BTreeMap::new());
    wait_for_core(&router, "edge1", &received);
    dialer.report(&report(9));
    assert_eq!(next_report(&arrived).1.boot, 9);
}

#[test]
fn an_agent_cannot_speak_for_another() {
    let lab = Lab::new();
    let (first, second) = (lab.enrol("edge1"), lab.enrol("edge2"));
    let (router, arrived) = lab.router(BTreeMap::new());
    // It has the first one's certificate and the second one's name.
    let (mut liar, _) = dial(&first, "edge2");
    let (mut honest, received) = dial(&second, "edge2");
    wait_for_core(&router, "edge2", &received);
    let (mut same_session, received) = dial(&first, "edge1");
    wait_for_core(&router, "edge1", &received);
    for _ in 0..50 {
        liar.report(&report(66));
    }
    same_session.report(&report(1));
    honest.report(&report(2));
    let mut reports = [next_report(&arrived), next_report(&arrived)];
    reports.sort_by_key(|(agent, _)| agent.clone());
    assert_eq!(reports, [(name("edge1"), report(1)), (name("edge2"), report(2))]);
}

#[test]
fn a_revoked_agent_is_not_heard() {
    let lab = Lab::new();
    let (revoked, other) = (lab.enrol("edge1"), lab.enrol("edge2"));
    lab.authority.revoke(&name("edge1")).unwrap();
    // The core still follows the agent, as after a revocation during a run.
    let again = lab.enrol("edge1");
    let (router, arrived) = lab.router(BTreeMap::new());
    let (mut dialer, _) = dial(&revoked, "edge1");
    let (mut second, received) = dial(&other, "edge2");
    wait_for_core(&router, "edge2", &received);
    let (mut renewed, received) = dial(&again, "edge1");
    wait_for_core(&router, "edge1", &received);
    for _ in 0..50 {
        dialer.report(&report(66));
    }
    second.report(&report(1));
    renewed.report(&report(2));
    let boots = [next_report(&arrived).1.boot, next_report(&arrived).1.boot];
    assert!(!boots.contains(&66), "{boots:?}");
}

#[test]
fn both_ends_explain_a_connection_that_is_refused() {
    let (lab, other_lab) = (Lab::new(), Lab::new());
    let bundle = lab.enrol("edge1");
    let core = bundle.core().to_string();
    let refused = diagnose(&core, credentials(&bundle)).unwrap_err();
    assert!(refused.contains("nobody listens there"), "{refused}");
    let (_router, _arrived) = lab.router(BTreeMap::new());
    diagnose(&core, credentials(&bundle)).unwrap();
    // The authority is that of this lab, and the certificate is not.
    let foreign = other_lab.enrol("edge1");
    let mixed = Credentials { authority: bundle.authority_pem(), ..credentials(&foreign) };
    let refused = diagnose(&core, mixed).unwrap_err();
    assert!(refused.contains("does not know the authority"), "{refused}");
    let refused = diagnose(&core, credentials(&foreign)).unwrap_err();
    assert!(refused.contains("not the core that enrolled this agent"), "{refused}");
    let expired = lab.enrol_at("edge2", today() - TimeDelta::days(30), Duration::from_secs(86400));
    let refused = diagnose(&core, credentials(&expired)).unwrap_err();
    assert!(refused.contains("has expired"), "{refused}");
    // Somebody else listens there.
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let server = thread::spawn(move || {
        listener.accept().unwrap().0.write_all(b"SSH-2.0-x\r\n").unwrap();
    });
    let refused = diagnose(&address, credentials(&bundle)).unwrap_err();
    assert!(refused.contains("no TLS is spoken there"), "{refused}");
    server.join().unwrap();
}

#[test]
fn a_flood_by_one_agent_leaves_room_for_others() {
    let lab = Lab::new();
    let (loud, quiet) = (lab.enrol("loud"), lab.enrol("quiet"));
    // A core that handles nothing: all messages wait.
    let (send, received) = mpsc::channel();
    let receiver: Receiver =
        Arc::new(move |agent, message, waiting| drop(send.send((agent, message, waiting))));
    let core = lab.authority.core(today()).unwrap();
    let credentials = Credentials {
        authority: &core.authority_pem,
        certificate: &core.certificate_pem,
        key: &core.key_pem,
    };
    let router = Router::open(lab.address, credentials, &lab.granted(), BTreeMap::new(), &receiver).unwrap();
    let (mut loud, from_core) = dial(&loud, "loud");
    wait_for_core(&router, "loud", &from_core);
    let (mut quiet, from_core) = dial(&quiet, "quiet");
    wait_for_core(&router, "quiet", &from_core);
    for boot in 0..5000 {
        loud.report(&report(boot));
    }
    let mut kept = Vec::new();
    let mut of_loud = 0;
    loop {
        quiet.report(&report(1));
        let (agent, message, waiting) = received.recv_timeout(PATIENCE).unwrap();
        kept.push(waiting);
        match message {
            FromAgent::Report(_) if agent == "quiet" => break,
            FromAgent::Report(_) => of_loud += 1,
            _ => {}
        }
    }
    assert!((1..=64).contains(&of_loud), "{of_loud}");
}

/// Speaks TLS to the core with these credentials and this protocol (RFC 7301).
fn speak(bundle: &Bundle, protocol: &[u8]) -> StreamOwned<ClientConnection, TcpStream> {
    let mut roots = RootCertStore::empty();
    roots.add(CertificateDer::from_pem_slice(bundle.authority_pem().as_bytes()).unwrap()).unwrap();
    let chain = vec![CertificateDer::from_pem_slice(bundle.certificate_pem().as_bytes()).unwrap()];
    let key = PrivateKeyDer::from_pem_slice(bundle.key_pem().as_bytes()).unwrap();
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let config = ClientConfig::builder_with_provider(provider).with_safe_default_protocol_versions().unwrap();
    let mut config = config.with_root_certificates(roots).with_client_auth_cert(chain, key).unwrap();
    config.alpn_protocols = vec![protocol.to_vec()];
    let host = ServerName::try_from(bundle.core().host().to_owned()).unwrap();
    let connection = ClientConnection::new(Arc::new(config), host).unwrap();
    StreamOwned::new(connection, TcpStream::connect(bundle.core().to_string()).unwrap())
}

fn frame(kind: Kind, message: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    Frame { kind, message: message.to_vec() }.write(&mut bytes).unwrap();
    bytes
}

/// Says this, and reads until the core closes the connection.
fn say(bundle: &Bundle, frames: &[Vec<u8>]) {
    let mut stream = speak(bundle, b"cotorra-agent/1");
    stream.write_all(&frames.concat()).unwrap();
    stream.read_to_end(&mut Vec::new()).unwrap();
}

#[test]
fn messages_that_are_not_an_agents_end_its_connection() {
    let lab = Lab::new();
    let bundle = lab.enrol("edge1");
    let (_router, arrived) = lab.router(BTreeMap::new());
    let hello = frame(Kind::Hello, b"edge1");
    for (wrong, part) in [
        (frame(Kind::Wanted, b"{}"), "does not say Wanted"),
        (hello.clone(), "does not say Hello"),
        (frame(Kind::Alive, b"1"), "number of a process"),
        (frame(Kind::Fetch, b"1"), "without a number"),
        (vec![Kind::Report as u8, 0, 0x10, 0, 1], "of at most 1048576"),
        (vec![99, 0, 0, 0, 0], "unknown kind 99"),
    ] {
        say(&bundle, &[hello.clone(), wrong]);
        match arrived.recv_timeout(PATIENCE).unwrap() {
            (agent, FromAgent::Rejected(reason)) => {
                assert!(agent == "edge1" && reason.contains(part), "{reason}")
            }
            other => panic!("{other:?}"),
        }
    }
    // One that cannot be decoded harms nothing else.
    let harmless = [frame(Kind::Report, b"{}"), frame(Kind::Quiet, b"")];
    say(&bundle, &[hello, harmless.concat(), frame(Kind::Wanted, b"")]);
    assert!(matches!(arrived.recv_timeout(PATIENCE).unwrap().1, FromAgent::Rejected(_)));
    assert!(matches!(arrived.recv_timeout(PATIENCE).unwrap().1, FromAgent::Rejected(_)));
    assert!(arrived.try_recv().is_err());
}

#[test]
fn connections_that_do_not_begin_with_the_agents_name_are_closed() {
    let lab = Lab::new();
    let bundle = lab.enrol("edge1");
    let (_router, arrived) = lab.router(BTreeMap::new());
    let report = report(1).encode();
    for first in [
        frame(Kind::Hello, b"edge2"),
        frame(Kind::Hello, &[b'a'; 1000])[..5].to_vec(),
        frame(Kind::Quiet, b""),
        frame(Kind::Report, &report)[..5].to_vec(),
    ] {
        say(&bundle, &[first]);
    }
    assert!(arrived.try_recv().is_err());
}

#[test]
fn another_version_of_the_protocol_is_noticed_in_the_handshake() {
    let lab = Lab::new();
    let bundle = lab.enrol("edge1");
    let (_router, _arrived) = lab.router(BTreeMap::new());
    let error = speak(&bundle, b"cotorra-agent/0").read(&mut [0]).unwrap_err().to_string();
    assert!(error.contains("NoApplicationProtocol"), "{error}");
}

#[test]
fn a_longer_file_than_announced_is_not_taken() {
    let lab = Lab::new();
    let bundle = lab.enrol("edge1");
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(&file, [7; 100_000]).unwrap();
    let (router, _arrived) = lab.router(BTreeMap::from([("abc".to_owned(), file.path().to_owned())]));
    let (dialer, received) = dial(&bundle, "edge1");
    wait_for_core(&router, "edge1", &received);
    let fetched = dialer.fetcher().fetch("abc", 99_999).unwrap_err().to_string();
    assert!(fetched.contains("longer than announced"), "{fetched}");
}

#[test]
fn silent_connections_do_not_keep_agents_out() {
    let lab = Lab::new();
    let bundle = lab.enrol("edge1");
    let (router, _arrived) = lab.router(BTreeMap::new());
    let mut silent: Vec<_> = (0..500).map(|_| TcpStream::connect(lab.address).unwrap()).collect();
    // One more is heard at once, while the others wait. It takes the place of the oldest, which is closed.
    let mut stream = speak(&bundle, b"cotorra-agent/1");
    stream.conn.complete_io(&mut stream.sock).unwrap();
    silent[0].set_read_timeout(Some(PATIENCE)).unwrap();
    if let Err(error) = silent[0].read_to_end(&mut Vec::new()) {
        assert_eq!(error.kind(), std::io::ErrorKind::ConnectionReset, "it is open");
    }
    let (_dialer, received) = dial(&bundle, "edge1");
    wait_for_core(&router, "edge1", &received);
}
