//! The HTTP API on an address that other machines can reach.

#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    fs,
    io::{self, Read as _, Write as _},
    net::{IpAddr, Shutdown, SocketAddr, TcpListener, TcpStream, UdpSocket},
    os::unix::fs::PermissionsExt as _,
    path::{Path, PathBuf},
    process::{Command, Output},
    sync::Arc,
    thread,
};

use cotorra_plugin::client::{Client, ClientError};
use parking_lot::Mutex;
use tempfile::TempDir;

use crate::harness::{Run, agent, corridor, cotorra, project_file, stderr, stdout};

const TOKEN: &str = "a-secret-of-some-length";

/// Returns an address of this machine beyond loopback. Nothing is sent.
fn own_address() -> IpAddr {
    let socket = UdpSocket::bind("0.0.0.0:0").unwrap();
    socket.connect("192.0.2.1:9").expect("this test needs an address beyond loopback");
    socket.local_addr().unwrap().ip()
}

/// A run whose API has an address of the network.
struct Network {
    run: Run,
    /// URL of the API on the network.
    url: String,
    /// Certificate of the authority.
    ca: PathBuf,
    folder: TempDir,
}

impl Network {
    fn start(api: &str, arguments: &[&str]) -> Self {
        let folder = TempDir::new().unwrap();
        let authority = folder.path().join("agents");
        let authority = ["--authority", authority.to_str().unwrap(), "--api", api, "--until", "5min"];
        let run = Run::start_beside_with(&corridor(), &[&authority[..], arguments].concat(), |command| {
            command.env("COTORRA_TOKEN", TOKEN);
        });
        let url =
            run.notes.iter().find_map(|note| note.strip_prefix("Network on ")?.split([' ', ',']).next());
        let url = url.unwrap_or_else(|| panic!("{:?}", run.notes)).to_owned();
        let ca = folder.path().join("agents/ca.pem");
        Self { run, url, ca, folder }
    }

    fn port(&self) -> &str {
        self.url.rsplit_once(':').unwrap().1
    }

    fn client(&self, url: &str) -> Client {
        Client::at(url, Some(&self.ca)).unwrap().with_token(TOKEN)
    }

    /// Runs `cotorra link show` against a URL.
    fn link_show(url: &str, ca: Option<&Path>) -> Output {
        let mut command = cotorra(["link", "show", "--run", url]);
        command.env("COTORRA_TOKEN", TOKEN).env_remove("COTORRA_CA");
        ca.into_iter().for_each(|ca| _ = command.env("COTORRA_CA", ca));
        command.output().unwrap()
    }
}

/// Runs a script of Python with the client of a run.
fn python(script: &str, url: &str, ca: &Path) -> Output {
    let mut python = Command::new("python3");
    python.args(["-c", script]).env("PYTHONPATH", project_file("clients/python"));
    python.env("COTORRA_API", url).env("COTORRA_TOKEN", TOKEN).env("COTORRA_CA", ca).output().unwrap()
}

/// Relays connections to an address, and records the bytes of both directions.
fn relay(to: SocketAddr) -> (SocketAddr, Arc<Mutex<Vec<u8>>>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let own = listener.local_addr().unwrap();
    let recorded = Arc::default();
    let record = Arc::clone(&recorded);
    thread::spawn(move || {
        for client in listener.incoming().map_while(Result::ok) {
            let server = TcpStream::connect(to).unwrap();
            let [from_client, from_server] = [&client, &server].map(|end| end.try_clone().unwrap());
            pass(from_client, server, Arc::clone(&record));
            pass(from_server, client, Arc::clone(&record));
        }
    });
    (own, recorded)
}

fn pass(mut from: TcpStream, mut to: TcpStream, record: Arc<Mutex<Vec<u8>>>) {
    thread::spawn(move || {
        let mut part = [0; 4096];
        while let Ok(read @ 1..) = from.read(&mut part) {
            record.lock().extend_from_slice(&part[..read]);
            if to.write_all(&part[..read]).is_err() {
                break;
            }
        }
        let _ = to.shutdown(Shutdown::Write);
    });
}

/// Makes a certificate that is its own authority, and its key.
fn self_signed(folder: &Path, own: IpAddr) -> [PathBuf; 2] {
    let [certificate, key] = ["certificate.pem", "key.pem"].map(|name| folder.join(name));
    let mut openssl = Command::new("openssl");
    openssl.args(["req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes"]);
    openssl.args(["-subj", "/CN=lab", "-addext", &format!("subjectAltName=IP:{own}")]);
    let made = openssl.arg("-keyout").arg(&key).arg("-out").arg(&certificate).output().unwrap();
    assert!(made.status.success(), "{}", stderr(&made));
    [certificate, key]
}

#[test]
fn clients_beyond_loopback_are_served_by_tls_alone() {
    let own = own_address();
    let network = Network::start(&format!("{own}:0"), &[]);
    let Network { run, url, ca, folder } = &network;
    assert_eq!(*url, format!("https://{own}:{}", network.port()));
    for (file, mode) in [("agents", 0o700), ("agents/api.pem", 0o600), ("agents/ca.pem", 0o600)] {
        assert_eq!(
            fs::metadata(folder.path().join(file)).unwrap().permissions().mode() & 0o777,
            mode,
            "{file}"
        );
    }
    let mut openssl = Command::new("openssl");
    let fingerprint =
        openssl.args(["x509", "-noout", "-fingerprint", "-sha256", "-in"]).arg(ca).output().unwrap();
    let fingerprint = stdout(&fingerprint).trim().rsplit_once('=').unwrap().1.to_owned();
    let note = format!("Network on {url} with COTORRA_CA={} (SHA-256 {fingerprint})", ca.display());
    assert!(run.notes.contains(&note), "{note}: {:?}", run.notes);

    // Clients in Rust and Python, with events, over a network that is listened to.
    let (relay, recorded) = relay(url.strip_prefix("https://").unwrap().parse().unwrap());
    let relayed = format!("https://{relay}");
    let client = network.client(&relayed);
    assert!(!client.links().unwrap().is_empty());
    client.events(&["robot"]).unwrap().next().unwrap().unwrap();
    let shown = Network::link_show(&relayed, Some(ca));
    assert!(stdout(&shown).contains("lan-cloud"), "{}", stderr(&shown));
    let script =
        "from cotorra import Client; c = Client(); print(len(c.links()), next(c.stream('robot'))['event'])";
    let told = python(script, &relayed, ca);
    assert!(stdout(&told).ends_with(" robot\n"), "{}", stderr(&told));
    let recorded = recorded.lock().clone();
    assert_eq!(recorded.first(), Some(&22));
    for clear in [TOKEN, "lan-cloud", "HTTP/1.1"] {
        assert!(
            !recorded.windows(clear.len()).any(|part| part == clear.as_bytes()),
            "{clear} crossed in clear"
        );
    }

    // Nothing is sent to a server that is not known.
    let [other, _] = self_signed(folder.path(), own);
    let failed = Client::at(url, Some(&other)).unwrap().with_token(TOKEN).links().unwrap_err();
    assert!(matches!(failed, ClientError::NotTrusted { .. }), "{failed}");
    for ca in [None, Some(&*other)] {
        let failed = Network::link_show(url, ca);
        assert!(!failed.status.success() && stdout(&failed).is_empty());
        assert!(stderr(&failed).contains("COTORRA_CA"), "{}", stderr(&failed));
    }
    // Without a scheme, an address beyond loopback has TLS.
    for url in [url.as_str(), url.strip_prefix("https://").unwrap()] {
        let failed = python(script, url, &other);
        assert!(!failed.status.success() && stdout(&failed).is_empty());
        assert!(stderr(&failed).contains("let COTORRA_CA name"), "{}", stderr(&failed));
    }

    // Without TLS, a client learns the address and nothing else.
    let mut rejected = agent().get(format!("http://{own}:{}/api/v1/links", network.port())).call().unwrap();
    let said = rejected.body_mut().read_to_string().unwrap();
    assert_eq!((rejected.status().as_u16(), said.contains(url) && !said.contains("lan-cloud")), (400, true));

    // On this machine, loopback and the socket stay as they are.
    assert!(run.api.starts_with("http://127.0.0.1:"), "{}", run.api);
    assert_eq!(run.ask("/api/v1/robots", None).0, 401);
    assert_eq!(run.ask("/api/v1/robots", Some(TOKEN)).0, 200);
    let shown = Network::link_show(run.address(), None);
    assert!(stdout(&shown).contains("lan-cloud"), "{}", stderr(&shown));
}

#[test]
fn handshakes_that_are_not_finished_keep_nobody_out() {
    let network = Network::start("0.0.0.0:0", &[]);
    let port = network.port().parse().unwrap();
    let at = SocketAddr::new(own_address(), port);
    // More than there are places for connections that are not known.
    let mut stalled: Vec<_> = (0..300)
        .map(|_| {
            let mut stream = TcpStream::connect(at).unwrap();
            stream.write_all(&[22, 3, 1]).unwrap();
            stream
        })
        .collect();
    assert!(!network.client(&format!("https://{at}")).links().unwrap().is_empty());
    // The oldest gave up its place.
    let end = stalled[0].read(&mut [0]);
    assert!(matches!(&end, Ok(0)) || end.is_err_and(|error| error.kind() == io::ErrorKind::ConnectionReset));
    // The certificate is for loopback, too. There, the same port has the API without TLS.
    assert!(!network.client(&format!("https://localhost:{port}")).links().unwrap().is_empty());
    assert_eq!(network.run.api, format!("http://127.0.0.1:{port}"));
    assert_eq!(network.run.ask("/api/v1/robots", Some(TOKEN)).0, 200);
}

#[test]
fn tls_is_left_out_and_certificates_are_brought_by_option_only() {
    let own = own_address();
    let plain = Network::start(&format!("{own}:0"), &["--no-tls"]);
    assert!(plain.run.notes.iter().any(|note| note.contains("sees the token")), "{:?}", plain.run.notes);
    assert_eq!((&plain.url, plain.ca.exists()), (&plain.run.api, false));
    let client = Client::new(&plain.url).unwrap().with_token(TOKEN);
    assert!(!client.links().unwrap().is_empty());
    drop(plain);

    let folder = TempDir::new().unwrap();
    let paths = self_signed(folder.path(), own).map(|path| path.into_os_string().into_string().unwrap());
    let [certificate, key] = paths;
    let options = ["--api-certificate", &certificate, "--api-key", &key];
    let network = Network::start(&format!("{own}:0"), &options);
    assert!(!network.ca.exists());
    let verified = Command::new("openssl")
        .args(["s_client", "-verify_return_error", "-brief", "-CAfile", &certificate, "-connect"])
        .arg(network.url.strip_prefix("https://").unwrap())
        .output()
        .unwrap();
    let said = stderr(&verified) + &stdout(&verified);
    assert!(said.contains("Verification: OK") && said.contains("TLSv1.3"), "{said}");
}
