//! A master for networks without roscore: sockets and threads around a [`Registry`].

use std::{
    io::{self, Read, Write},
    net::{TcpListener, TcpStream},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
        mpsc,
    },
    thread::{self, JoinHandle},
    time::Duration,
};

use parking_lot::Mutex;

use crate::{
    http, master,
    registry::{Notice, Registry},
    uri::Endpoint,
    xmlrpc::{self, Call, Fault},
};

/// Longest call, bytes. Parameters may be large.
const MAX_CALL: usize = 16 << 20;
/// Most open connections. Each has a thread.
const MAX_CONNECTIONS: usize = 256;
/// Time after which an idle connection is closed.
const IDLE: Duration = Duration::from_secs(60);

/// A ROS master with its parameter server. Ends when it is dropped.
///
/// It suits a few robots. It notifies nodes one after another: one that does not answer delays the others by some
/// seconds.
#[derive(Debug)]
pub struct MasterServer {
    endpoint: Endpoint,
    stopped: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl MasterServer {
    /// Starts a master that others reach under a host name or address, on any free port if `port` is 0.
    ///
    /// # Errors
    /// If it cannot listen there or start threads.
    pub fn start(host: &str, port: u16) -> io::Result<Self> {
        let listener = crate::node::listen(host, port)?;
        let endpoint = Endpoint { host: host.to_owned(), port: listener.local_addr()?.port() };
        let registry = Arc::new(Mutex::new(Registry::new(endpoint.http())));
        let stopped = Arc::new(AtomicBool::new(false));
        let (notices, to_tell) = mpsc::channel();
        thread::Builder::new().name("ros1-notices".to_owned()).spawn(move || tell(&to_tell))?;
        let is_stopped = Arc::clone(&stopped);
        let accept = move || accept(&listener, &registry, &notices, &is_stopped);
        let thread = Some(thread::Builder::new().name("ros1-master".to_owned()).spawn(accept)?);
        Ok(Self { endpoint, stopped, thread })
    }

    /// Address of the master.
    pub fn endpoint(&self) -> &Endpoint {
        &self.endpoint
    }
}

impl Drop for MasterServer {
    fn drop(&mut self) {
        self.stopped.store(true, Ordering::Release);
        // It waits for connections, and sees the flag at the next one.
        if TcpStream::connect((self.endpoint.host.as_str(), self.endpoint.port)).is_ok() {
            // A panicked thread has ended, too.
            let _ = self.thread.take().map(JoinHandle::join);
        }
    }
}

fn tell(notices: &mpsc::Receiver<Notice>) {
    for Notice { node, method, arguments } in notices {
        let told = node.parse().map_err(|error| format!("{error}")).and_then(|endpoint| {
            master::ask(&endpoint, method, arguments).map_err(|error| error.to_string())
        });
        if let Err(error) = told {
            tracing::debug!("{node} was not notified by {method}: {error}");
        }
    }
}

fn accept(
    listener: &TcpListener,
    registry: &Arc<Mutex<Registry>>,
    notices: &mpsc::Sender<Notice>,
    stopped: &Arc<AtomicBool>,
) {
    let open = Arc::new(AtomicUsize::new(0));
    for stream in listener.incoming() {
        if stopped.load(Ordering::Acquire) {
            return;
        }
        let Ok(stream) = stream else { continue };
        if open.fetch_add(1, Ordering::Relaxed) >= MAX_CONNECTIONS {
            open.fetch_sub(1, Ordering::Relaxed);
            continue;
        }
        let (registry, notices) = (Arc::clone(registry), notices.clone());
        let (stopped, counted) = (Arc::clone(stopped), Arc::clone(&open));
        let serve = move || {
            if let Err(error) = serve(stream, &registry, &notices, &stopped) {
                tracing::debug!("a connection to the master: {error}");
            }
            counted.fetch_sub(1, Ordering::Relaxed);
        };
        if thread::Builder::new().name("ros1-master".to_owned()).spawn(serve).is_err() {
            open.fetch_sub(1, Ordering::Relaxed);
        }
    }
}

/// Answers the calls of one connection.
fn serve(
    mut stream: TcpStream,
    registry: &Mutex<Registry>,
    notices: &mpsc::Sender<Notice>,
    stopped: &AtomicBool,
) -> io::Result<()> {
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(IDLE))?;
    stream.set_write_timeout(Some(IDLE))?;
    let (mut input, mut piece) = (Vec::new(), vec![0; 16 << 10]);
    loop {
        match http::parse_request(&input, MAX_CALL) {
            // Callers see that the master ended.
            Ok(Some(_)) if stopped.load(Ordering::Acquire) => return Ok(()),
            Ok(Some(request)) => {
                let call = Call::from_xml(request.body).map_err(|error| Fault::from(&error));
                let mut to_tell = Vec::new();
                let answer = {
                    let mut registry = registry.lock();
                    let answer = call.and_then(|call| registry.answer(&call, &mut to_tell));
                    // Within the lock, so that notices keep the order of changes.
                    to_tell.into_iter().for_each(|notice| drop(notices.send(notice)));
                    answer
                };
                stream.write_all(&http::response(&xmlrpc::answer_to_xml(&answer), request.keep_alive))?;
                let (len, keep_alive) = (request.len, request.keep_alive);
                if !keep_alive {
                    return Ok(());
                }
                input.drain(..len);
            }
            Ok(None) => match stream.read(&mut piece)? {
                0 => return Ok(()),
                read => input.extend_from_slice(&piece[..read]),
            },
            Err(error) => {
                stream.write_all(&http::refusal())?;
                return Err(io::Error::new(io::ErrorKind::InvalidData, error));
            }
        }
    }
}

#[cfg(test)]
mod tests {
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
