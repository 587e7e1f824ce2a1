//! A node's connections by purpose, and the handling that needs one alone.

use std::{
    io::{self, ErrorKind, Read},
    sync::Arc,
    time::Duration,
};

use cotorra_ros_messages::EmptyResponse;
use mio::{Token, net::TcpStream};
use socket2::{SockRef, TcpKeepalive};

use crate::{
    buffers::Buffers,
    node::{
        offer::{self, Offer},
        publication::{Outgoing, Publication},
        shared::Shared,
        subscription::Subscription,
    },
    queue::SendQueue,
    tcpros::{FrameReader, Header, MAX_MESSAGE_LEN},
};

/// Reads of one connection before others get their turn.
pub(super) const READS_A_TURN: usize = 16;
/// Bytes that the kernel may hold for a stalled connection. Later frames wait in a queue that drops the oldest, so that
/// a peer gets news, not history, after its network was away.
const UNSENT: u32 = 16 << 10;

/// A connection, by purpose.
pub(super) enum Connection {
    /// From a client of the slave API.
    Caller { stream: TcpStream, input: Vec<u8>, held: Buffers, output: SendQueue, last: bool, active: bool },
    /// To TCPROS, before its connection header.
    New { stream: TcpStream, frames: FrameReader },
    /// To a subscriber.
    Subscriber { outgoing: Arc<Outgoing>, publication: Arc<Publication> },
    /// To a publisher.
    Publisher {
        stream: TcpStream,
        frames: FrameReader,
        subscription: Arc<Subscription>,
        publisher: String,
        flow: Flow,
    },
    /// To a client of a service.
    Client { stream: TcpStream, frames: FrameReader, output: SendQueue, offer: Arc<Offer>, phase: Phase },
    /// Ends once its last answer is sent.
    Ending { stream: TcpStream, output: SendQueue },
}

/// Traffic from a publisher.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Flow {
    /// Whether its connection header arrived.
    pub begun: bool,
    pub messages: u64,
    pub bytes: u64,
}

/// State of a service's client.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Phase {
    /// Waits for nothing: its next request is due.
    Idle { persistent: bool },
    /// Waits for the service.
    Pending { persistent: bool },
    /// Waits for the last bytes of its only response.
    Answered,
}

/// Next step of a connection.
pub(super) enum Next {
    /// Waits for events.
    Wait(Connection),
    /// Has work left in the next turn.
    Again(Connection),
    /// Ends.
    End(Connection),
}

impl Connection {
    /// Whether it has not stated its purpose, was silent for long, or is ending.
    pub fn is_undecided(&self) -> bool {
        match self {
            Self::Caller { active, .. } => !active,
            Self::New { .. } | Self::Ending { .. } => true,
            Self::Publisher { flow, .. } => !flow.begun,
            Self::Subscriber { .. } | Self::Client { .. } => false,
        }
    }
}

/// Sets the options of a connection: no Nagle's algorithm, which turns 10 ms of network into 20 ms, keepalive probes for
/// silent peers, and a bound on unsent bytes in the kernel.
pub(super) fn prepare(stream: &TcpStream) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let socket = SockRef::from(stream);
    let keepalive =
        TcpKeepalive::new().with_time(Duration::from_secs(15)).with_interval(Duration::from_secs(5));
    socket.set_tcp_keepalive(&keepalive.with_retries(3))?;
    socket.set_tcp_notsent_lowat(UNSENT)
}

/// Whether the peer ended a connection on which it should send nothing. Drops received bytes.
pub(super) fn is_over(mut stream: &TcpStream) -> bool {
    let mut piece = [0; 1024];
    for _ in 0..READS_A_TURN {
        match stream.read(&mut piece) {
            Ok(0) => return true,
            Ok(_) => {}
            Err(error) if error.kind() == ErrorKind::WouldBlock => return false,
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(_) => return true,
        }
    }
    // The peer floods a connection on which it should send nothing.
    true
}

/// Reads a connection header, and turns the connection into that of its purpose.
pub(super) fn introduce(shared: &Arc<Shared>, stream: TcpStream, mut frames: FrameReader) -> Next {
    loop {
        match frames.next_frame() {
            Ok(Some(header)) => {
                let header = Header::from_bytes(header).map_err(|error| error.to_string());
                return match header.and_then(|header| Purpose::of(shared, &header)) {
                    Ok(purpose) => purpose.connection(shared, stream, frames),
                    Err(reason) => {
                        tracing::debug!("{} rejects a connection: {reason}", shared.names.node());
                        let refusal = Header::new([("error", reason.as_str())]).to_frame();
                        Next::Again(Connection::Ending { stream, output: SendQueue::new(1, Some(refusal)) })
                    }
                };
            }
            Ok(None) => {}
            Err(_) => return Next::End(Connection::New { stream, frames }),
        }
        match frames.read_from(&mut &stream) {
            Ok(0) => return Next::End(Connection::New { stream, frames }),
            Ok(_) => {}
            Err(error) if error.kind() == ErrorKind::WouldBlock => {
                return Next::Wait(Connection::New { stream, frames });
            }
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(_) => return Next::End(Connection::New { stream, frames }),
        }
    }
}

/// Purpose of a connection to TCPROS.
enum Purpose {
    Subscribe {
        publication: Arc<Publication>,
        subscriber: String,
    },
    Call {
        offer: Arc<Offer>,
        persistent: bool,
    },
    /// Asks for the type of a service.
    Probe {
        offer: Arc<Offer>,
    },
}

impl Purpose {
    fn of(shared: &Shared, header: &Header) -> Result<Self, String> {
        let state = shared.state.lock();
        let subscriber = header.get("callerid").unwrap_or_default().to_owned();
        if let Some(name) = header.get("service") {
            let offer = state.services.get(name).ok_or_else(|| format!("{name} is not served here"))?;
            let offer = Arc::clone(offer);
            match header.get("md5sum") {
                _ if header.flag("probe") => Ok(Self::Probe { offer }),
                Some(md5sum) if md5sum == "*" || md5sum == offer.md5sum => {
                    Ok(Self::Call { offer, persistent: header.flag("persistent") })
                }
                Some(md5sum) => {
                    Err(format!("{name} is a {} with md5sum {}, not {md5sum}", offer.kind, offer.md5sum))
                }
                None => Err("the connection header has no md5sum".to_owned()),
            }
        } else if let Some(topic) = header.get("topic") {
            let publication = state.publications.get(topic);
            let publication = publication.ok_or_else(|| format!("{topic} is not published here"))?;
            publication.kind.check(header.get("md5sum"), header.get("type"))?;
            Ok(Self::Subscribe { publication: Arc::clone(publication), subscriber })
        } else {
            Err("the connection header has neither a topic nor a service".to_owned())
        }
    }

    fn connection(self, shared: &Shared, stream: TcpStream, mut frames: FrameReader) -> Next {
        let node = shared.names.node();
        match self {
            Self::Subscribe { publication, subscriber } => {
                let outgoing = publication.connect(stream, &subscriber, node);
                Next::Again(Connection::Subscriber { outgoing, publication })
            }
            Self::Call { offer, persistent } => {
                frames.set_limit(MAX_MESSAGE_LEN);
                let output = SendQueue::new(1, Some(offer.header(node).to_frame()));
                Next::Again(Connection::Client {
                    stream,
                    frames,
                    output,
                    offer,
                    phase: Phase::Idle { persistent },
                })
            }
            Self::Probe { offer } => {
                let output = SendQueue::new(1, Some(offer.header(node).to_frame()));
                Next::Again(Connection::Ending { stream, output })
            }
        }
    }
}

/// Passes requests to a service, one at a time.
pub(super) fn ask_service(
    token: Token,
    stream: TcpStream,
    mut frames: FrameReader,
    mut output: SendQueue,
    offer: Arc<Offer>,
    mut phase: Phase,
) -> Next {
    let over = loop {
        if output.flush(&mut &stream).is_err() {
            break true;
        }
        let Phase::Idle { persistent } = phase else {
            break phase == Phase::Answered && output.is_empty();
        };
        match frames.next_frame() {
            Ok(Some(request)) => {
                phase = Phase::Pending { persistent };
                if offer.requests.send((token, request.to_vec())).is_err() {
                    output.push(Arc::new(offer::response::<EmptyResponse>(Err(
                        "the service ended".to_owned()
                    ))));
                    phase = Phase::Answered;
                }
                continue;
            }
            Ok(None) => {}
            Err(error) => {
                tracing::debug!("a client of {} does not speak TCPROS: {error}", offer.name);
                break true;
            }
        }
        match frames.read_from(&mut &stream) {
            Ok(0) => break true,
            Ok(_) => {}
            Err(error) if error.kind() == ErrorKind::WouldBlock => break false,
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(_) => break true,
        }
    };
    let connection = Connection::Client { stream, frames, output, offer, phase };
    if over { Next::End(connection) } else { Next::Wait(connection) }
}
