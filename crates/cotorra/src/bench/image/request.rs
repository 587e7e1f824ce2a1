//! Requests to a container, from within its network namespace.

use std::{
    fmt,
    io::{self, Read as _, Write as _},
    net::{Ipv4Addr, SocketAddr, TcpStream, UdpSocket},
    time::Duration,
};

use cotorra_datapath::be_punctual;
use cotorra_graph::{ListenPort, Transport};

/// Longest wait for an answer.
const LONGEST: Duration = Duration::from_secs(5);
/// Longest answer, bytes.
const LARGEST: u64 = 64 << 20;

/// A request whose answer is timed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Request {
    /// A datagram.
    Udp { port: u16, payload: String },
    /// A GET request over a connection of its own.
    Http { port: u16, path: String },
}

/// Parses a port and a path.
pub fn parse_http(text: &str) -> Result<Request, String> {
    let (port, path) = text.split_at(text.find('/').unwrap_or(text.len()));
    let path = if path.is_empty() { "/" } else { path };
    match port.parse() {
        Ok(port @ 1..) if path.chars().all(|c| c.is_ascii_graphic()) => {
            Ok(Request::Http { port, path: path.to_owned() })
        }
        _ => Err("write it like 8080 or 8080/plan, without spaces".to_owned()),
    }
}

impl fmt::Display for Request {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Udp { port, .. } => write!(f, "a datagram to {port}/udp"),
            Self::Http { port, path } => write!(f, "GET {path} at {port}/tcp"),
        }
    }
}

impl Request {
    /// Returns the port that answers.
    pub fn port(&self) -> ListenPort {
        match *self {
            Self::Udp { port, .. } => ListenPort { port, transport: Transport::Udp },
            Self::Http { port, .. } => ListenPort { port, transport: Transport::Tcp },
        }
    }

    /// Measures the times of requests from the calling thread's namespace, one after the other while `goes_on`. A first one
    /// is not counted.
    pub fn repeat(&self, times: usize, goes_on: &dyn Fn() -> bool) -> io::Result<Vec<Duration>> {
        be_punctual();
        let to = SocketAddr::from((Ipv4Addr::LOCALHOST, self.port().port));
        match self {
            Self::Udp { payload, .. } => {
                let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
                socket.set_read_timeout(Some(LONGEST))?;
                socket.connect(to)?;
                series(times, goes_on, || {
                    socket.send(payload.as_bytes())?;
                    socket.recv(&mut [0]).map(drop).map_err(timed_out)
                })
            }
            Self::Http { path, .. } => series(times, goes_on, || get(to, path).map_err(timed_out)),
        }
    }
}

#[allow(clippy::disallowed_types, reason = "real requests take real time")]
fn series(
    times: usize,
    goes_on: &dyn Fn() -> bool,
    mut once: impl FnMut() -> io::Result<()>,
) -> io::Result<Vec<Duration>> {
    let timed = |_| {
        let began = std::time::Instant::now();
        once().map(|()| began.elapsed())
    };
    let mut series: Vec<_> = (0..=times).take_while(|_| goes_on()).map(timed).collect::<io::Result<_>>()?;
    series.drain(..series.len().min(1));
    Ok(series)
}

/// Says that an answer did not come, in words.
fn timed_out(error: io::Error) -> io::Error {
    match error.kind() {
        io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut => {
            io::Error::new(io::ErrorKind::TimedOut, format!("no answer within {} s", LONGEST.as_secs()))
        }
        _ => error,
    }
}

/// Gets a page, and reads it to its end.
fn get(to: SocketAddr, path: &str) -> io::Result<()> {
    let mut stream = TcpStream::connect(to)?;
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(LONGEST))?;
    let request = format!("GET {path} HTTP/1.0\r\nHost: localhost\r\nConnection: close\r\n\r\n");
    // In one piece: a server may answer the first.
    stream.write_all(request.as_bytes())?;
    let mut answer = Vec::new();
    stream.take(LARGEST).read_to_end(&mut answer)?;
    let status = answer.split(|byte| *byte == b'\r' || *byte == b'\n').next().unwrap_or_default();
    let status = String::from_utf8_lossy(&status[..status.len().min(80)]);
    match status.split_once(' ') {
        Some((version, code)) if version.starts_with("HTTP/") && code.starts_with('2') => Ok(()),
        _ => Err(io::Error::other(format!("the answer is `{status}`"))),
    }
}

#[cfg(test)]
mod tests {
    use std::{
        io::{BufRead as _, BufReader},
        net::TcpListener,
        thread,
    };

    use super::*;

    #[test]
    fn a_request_has_a_port_and_maybe_a_path() {
        let http = |port, path: &str| Ok(Request::Http { port, path: path.to_owned() });
        assert_eq!(parse_http("80"), http(80, "/"));
        assert_eq!(parse_http("8080/plan?x=1"), http(8080, "/plan?x=1"));
        for wrong in ["", "/plan", "0/", "70000", "80/a b", "80/a\r\nHost: b", "http://a"] {
            assert!(parse_http(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn answers_to_datagrams_are_counted_but_the_first() {
        let server = UdpSocket::bind("127.0.0.1:0").unwrap();
        let request = Request::Udp { port: server.local_addr().unwrap().port(), payload: "hello".to_owned() };
        let answering = thread::spawn(move || {
            for _ in 0..4 {
                let mut buffer = [0; 16];
                let (length, from) = server.recv_from(&mut buffer).unwrap();
                assert_eq!(&buffer[..length], b"hello");
                server.send_to(&buffer[..length], from).unwrap();
            }
        });
        assert_eq!(request.repeat(3, &|| true).unwrap().len(), 3);
        answering.join().unwrap();
        assert!(request.repeat(3, &|| false).unwrap().is_empty(), "Ctrl-C ends it");
    }

    #[test]
    fn only_pages_that_are_there_are_answers() {
        let server = TcpListener::bind("127.0.0.1:0").unwrap();
        let request = Request::Http { port: server.local_addr().unwrap().port(), path: "/x".to_owned() };
        let serve = move |answers: &[&str]| {
            for answer in answers {
                let (mut stream, _) = server.accept().unwrap();
                let lines = BufReader::new(stream.try_clone().unwrap()).lines().map_while(Result::ok);
                let asked: Vec<_> = lines.take_while(|line| !line.is_empty()).collect();
                assert_eq!(asked[0], "GET /x HTTP/1.0");
                stream.write_all(answer.as_bytes()).unwrap();
            }
        };
        let serving = thread::spawn(move || {
            serve(&["HTTP/1.0 200 OK\r\n\r\nhi"; 3]);
            serve(&["HTTP/1.1 404 Not Found\r\n\r\n"]);
        });
        assert_eq!(request.repeat(2, &|| true).unwrap().len(), 2);
        let error = request.repeat(2, &|| true).unwrap_err().to_string();
        assert_eq!(error, "the answer is `HTTP/1.1 404 Not Found`");
        serving.join().unwrap();
    }
}
