//! A master for networks without roscore: sockets and threads around a [`Registry`].

use std::{
    io::{self, Read, Write},
    net::{IpAddr, Shutdown, TcpListener, TcpStream},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
    time::Duration,
};

use cotorra_admission::{Place, Strangers};
use parking_lot::{Condvar, Mutex};

use crate::{
    buffers::{Buffers, Held},
    http, master,
    notices::Notices,
    registry::Registry,
    uri::Endpoint,
    xmlrpc::{self, Call, Fault},
};

/// Longest call, bytes. Parameters may be large.
const MAX_CALL: usize = 1 << 20;
/// Most open connections. Each has a thread. A new one replaces the oldest.
const MAX_CONNECTIONS: usize = 256;
/// Most bytes of calls and answers under way.
const MOST_HELD: usize = 32 << 20;
/// Most of these with the callers at one address.
const MOST_HELD_OF_ADDRESS: usize = 8 << 20;
/// Threads that send notices.
const SENDERS: usize = 8;
/// Time after which an idle connection is closed.
const IDLE: Duration = Duration::from_secs(60);

/// A ROS master with its parameter server. Ends when it is dropped.
///
/// It suits a few robots. It notifies the nodes of an address one after another: one that does not answer delays the others of
/// its address by some seconds. Memory is bounded in total, and for the callers at each address.
#[derive(Debug)]
pub struct MasterServer {
    endpoint: Endpoint,
    state: Arc<State>,
    thread: Option<JoinHandle<()>>,
}

/// State that the threads of a master share.
#[derive(Debug)]
struct State {
    registry: Mutex<Registry>,
    notices: Mutex<Notices>,
    /// Wakes those that send notices.
    waker: Condvar,
    connections: Mutex<Strangers<TcpStream>>,
    held: Arc<Held>,
    stopped: AtomicBool,
}

impl MasterServer {
    /// Starts a master that others reach under a host name or address, on any free port if `port` is 0.
    ///
    /// # Errors
    /// If it cannot listen there or start threads.
    pub fn start(host: &str, port: u16) -> io::Result<Self> {
        let listener = crate::node::listen(host, port)?;
        let endpoint = Endpoint { host: host.to_owned(), port: listener.local_addr()?.port() };
        let state = Arc::new(State {
            registry: Mutex::new(Registry::new(endpoint.http())),
            notices: Mutex::default(),
            waker: Condvar::new(),
            connections: Mutex::new(Strangers::new(MAX_CONNECTIONS)),
            held: Held::new(MOST_HELD, MOST_HELD_OF_ADDRESS),
            stopped: AtomicBool::new(false),
        });
        let mut server = Self { endpoint, state: Arc::clone(&state), thread: None };
        for _ in 0..SENDERS {
            let state = Arc::clone(&state);
            thread::Builder::new().name("ros1-notices".to_owned()).spawn(move || state.tell())?;
        }
        let accept = move || state.accept(&listener);
        server.thread = Some(thread::Builder::new().name("ros1-master".to_owned()).spawn(accept)?);
        Ok(server)
    }

    /// Address of the master.
    pub fn endpoint(&self) -> &Endpoint {
        &self.endpoint
    }
}

impl Drop for MasterServer {
    fn drop(&mut self) {
        self.state.stopped.store(true, Ordering::Release);
        // A sender that is about to wait holds the lock, and one that waits is woken.
        drop(self.state.notices.lock());
        self.state.waker.notify_all();
        // It waits for connections, and sees the flag at the next one.
        if TcpStream::connect((self.endpoint.host.as_str(), self.endpoint.port)).is_ok() {
            // A panicked thread has ended, too.
            let _ = self.thread.take().map(JoinHandle::join);
        }
    }
}

impl State {
    /// Sends notices until the master ends.
    fn tell(&self) {
        let mut notices = self.notices.lock();
        while !self.stopped.load(Ordering::Acquire) {
            let Some(notice) = notices.next() else {
                self.waker.wait(&mut notices);
                continue;
            };
            drop(notices);
            let (method, arguments) = self.registry.lock().call_of(&notice);
            let told = notice.node.parse().map_err(|error| format!("{error}")).and_then(|endpoint| {
                master::ask(&endpoint, method, arguments).map_err(|error| error.to_string())
            });
            if let Err(error) = told {
                tracing::debug!("{} was not notified by {method}: {error}", notice.node);
            }
            notices = self.notices.lock();
            notices.done(notice.owner);
        }
    }

    fn accept(self: &Arc<Self>, listener: &TcpListener) {
        for stream in listener.incoming() {
            if self.stopped.load(Ordering::Acquire) {
                return;
            }
            let Ok(stream) = stream else { continue };
            let (Ok(from), Ok(handle)) = (stream.peer_addr(), stream.try_clone()) else { continue };
            let from = from.ip().to_canonical();
            let Place { number, replaced } = self.connections.lock().arrive(from, handle);
            if let Some(replaced) = replaced {
                // Its thread reads the end of the stream. It may have ended by itself.
                let _ = replaced.shutdown(Shutdown::Both);
            }
            let state = Arc::clone(self);
            let serve = move || {
                if let Err(error) = state.serve(stream, from) {
                    tracing::debug!("a connection to the master: {error}");
                }
                drop(state.connections.lock().leave(number));
            };
            if thread::Builder::new().name("ros1-master".to_owned()).spawn(serve).is_err() {
                drop(self.connections.lock().leave(number));
            }
        }
    }

    /// Answers the calls of one connection.
    fn serve(&self, mut stream: TcpStream, from: IpAddr) -> io::Result<()> {
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(IDLE))?;
        stream.set_write_timeout(Some(IDLE))?;
        let mut buffers = Buffers::new(&self.held, from);
        let (mut input, mut piece) = (Vec::new(), vec![0; 16 << 10]);
        loop {
            match http::parse_request(&input, MAX_CALL) {
                // Callers see that the master ended.
                Ok(Some(_)) if self.stopped.load(Ordering::Acquire) => return Ok(()),
                Ok(Some(request)) => {
                    let (len, keep_alive) = (request.len, request.keep_alive);
                    let answer = self.answer(from, request.body);
                    // A call is read again from the beginning of what is left.
                    input = input.split_off(len);
                    let answer = if buffers.hold(input.len() + answer.len()) {
                        answer
                    } else {
                        let message = format!(
                            "an answer of {} bytes has no room beside the others to {from}: ask for a part of it, or later",
                            answer.len()
                        );
                        xmlrpc::answer_to_xml(&Err(Fault { code: 1, message }))
                    };
                    stream.write_all(&http::response(&answer, keep_alive))?;
                    drop(answer);
                    buffers.hold(input.len());
                    if !keep_alive {
                        return Ok(());
                    }
                }
                Ok(None) => match stream.read(&mut piece)? {
                    0 => return Ok(()),
                    read if buffers.hold(input.len() + read) => input.extend_from_slice(&piece[..read]),
                    _ => {
                        stream.write_all(&http::refusal())?;
                        return Err(io::Error::other(format!("calls from {from} take too much memory")));
                    }
                },
                Err(error) => {
                    stream.write_all(&http::refusal())?;
                    return Err(io::Error::new(io::ErrorKind::InvalidData, error));
                }
            }
        }
    }

    /// Answers a call. One at a time is read and answered, because both take many times the memory of its text.
    fn answer(&self, from: IpAddr, body: &[u8]) -> String {
        let mut registry = self.registry.lock();
        let call = Call::from_xml(body).map_err(|error| Fault::from(&error));
        let mut to_tell = Vec::new();
        let answer = call.and_then(|call| registry.answer(from, &call, &mut to_tell));
        let answer = xmlrpc::answer_to_xml(&answer);
        if !to_tell.is_empty() {
            // Within the lock, so that notices keep the order of changes.
            let mut notices = self.notices.lock();
            to_tell.into_iter().for_each(|notice| notices.push(notice));
            self.waker.notify_all();
        }
        answer
    }
}

#[cfg(test)]
mod tests {
    use std::net::SocketAddr;

    use socket2::{Domain, Socket, Type};

    use super::*;
    use crate::{
        Node, NodeConfig, PublishOptions, SubscribeOptions,
        messages::{SetBool, SetBoolRequest, SetBoolResponse, Text},
    };

    const PATIENCE: Duration = Duration::from_secs(60);

    fn node(master: &MasterServer, name: &str) -> Node {
        Node::new(NodeConfig { master: master.endpoint().clone(), ..NodeConfig::new(name) }).unwrap()
    }

    #[test]
    fn nodes_find_each_other_without_roscore() {
        let master = MasterServer::start("127.0.0.1", 0).unwrap();
        let (talker, listener) = (node(&master, "talker"), node(&master, "listener"));
        let heard = listener.subscribe::<Text>("words", SubscribeOptions::default()).unwrap();
        let latch = PublishOptions { latch: true, ..PublishOptions::default() };
        let words = talker.publish::<Text>("words", latch).unwrap();
        words.publish(&Text { data: "hello".to_owned() });
        assert_eq!(heard.recv_timeout(PATIENCE).unwrap().data, "hello");

        let answer =
            |request: SetBoolRequest| Ok(SetBoolResponse { success: request.data, ..Default::default() });
        let _server = talker.service::<SetBool>("power", answer).unwrap();
        assert!(listener.call::<SetBool>("power", &SetBoolRequest { data: true }, PATIENCE).unwrap().success);

        let watch = listener.watch_param("speed").unwrap();
        talker.set_param("speed", 0.5).unwrap();
        assert_eq!(watch.changed(PATIENCE).unwrap(), Some(0.5.into()));
        drop((words, talker));
        let state = listener.master().system_state().unwrap();
        assert_eq!((state.publishers, state.services), (vec![], vec![]));
    }

    #[test]
    fn connections_that_say_nothing_do_not_keep_nodes_out() {
        let master = MasterServer::start("127.0.0.1", 0).unwrap();
        let address = ("127.0.0.1", master.endpoint().port);
        let mut silent: Vec<_> =
            (0..2 * MAX_CONNECTIONS).map(|_| TcpStream::connect(address).unwrap()).collect();
        node(&master, "talker").set_param("speed", 0.5).unwrap();
        silent[0].set_read_timeout(Some(PATIENCE)).unwrap();
        assert_eq!(silent[0].read(&mut [0; 1]).unwrap_or(0), 0, "the oldest gave up its place");
    }

    #[test]
    fn nodes_that_do_not_answer_delay_only_those_of_their_own_address() {
        let master = MasterServer::start("127.0.0.1", 0).unwrap();
        // It accepts, and never answers.
        let dead = TcpListener::bind("127.0.0.2:0").unwrap();
        let api = format!("http://127.0.0.2:{}/", dead.local_addr().unwrap().port());
        let call = |arguments: &[&str]| {
            let arguments = arguments.iter().map(|argument| (*argument).into()).collect();
            let body = Call::new("registerSubscriber", arguments).to_xml();
            let request = http::request("127.0.0.2", &body);
            // From another address than the others.
            let socket = Socket::new(Domain::IPV4, Type::STREAM, None).unwrap();
            socket.bind(&SocketAddr::from(([127, 0, 0, 2], 0)).into()).unwrap();
            socket.connect(&SocketAddr::from(([127, 0, 0, 1], master.endpoint().port)).into()).unwrap();
            let mut stream = TcpStream::from(socket);
            stream.write_all(&request).unwrap();
            assert!(stream.read(&mut [0; 100]).unwrap() > 0);
        };
        for i in 0..50 {
            call(&[&format!("/dead{i}"), "/words", "*", &format!("{api}{i}")]);
        }
        let (talker, listener) = (node(&master, "talker"), node(&master, "listener"));
        let heard = listener.subscribe::<Text>("words", SubscribeOptions::default()).unwrap();
        let latch = PublishOptions { latch: true, ..PublishOptions::default() };
        let words = talker.publish::<Text>("words", latch).unwrap();
        words.publish(&Text { data: "hello".to_owned() });
        assert_eq!(heard.recv_timeout(PATIENCE).unwrap().data, "hello");
    }

    #[test]
    fn nodes_register_again_after_the_master_restarts() {
        let master = MasterServer::start("127.0.0.1", 0).unwrap();
        let (talker, listener) = (node(&master, "talker"), node(&master, "listener"));
        let words = talker.publish::<Text>("words", PublishOptions { queue: 1, latch: true }).unwrap();
        words.publish(&Text { data: "hello".to_owned() });
        let port = master.endpoint().port;
        drop(master);
        assert!(listener.subscribe::<Text>("words", SubscribeOptions::default()).is_err());
        let _master = MasterServer::start("127.0.0.1", port).unwrap();
        let heard = listener.subscribe::<Text>("words", SubscribeOptions::default()).unwrap();
        assert_eq!(heard.recv_timeout(PATIENCE).unwrap().data, "hello");
    }
}
