//! A proxy between an operator and its node, which can be interrupted.

use std::{
    io,
    net::{Shutdown, SocketAddr, TcpListener, TcpStream},
    sync::Arc,
    thread,
};

use parking_lot::Mutex;

pub struct Proxy {
    address: SocketAddr,
    /// The connections; `None` while interrupted.
    connections: Arc<Mutex<Option<Vec<TcpStream>>>>,
}

impl Proxy {
    /// Starts a proxy before a node's WebSocket.
    pub fn before(url: &str) -> Self {
        let node = url.strip_prefix("ws://").unwrap().to_owned();
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let connections = Arc::new(Mutex::new(Some(Vec::new())));
        let open = Arc::clone(&connections);
        thread::spawn(move || {
            for operator in listener.incoming() {
                let (Ok(operator), Some(open)) = (operator, &mut *open.lock()) else { continue };
                let Ok(node) = TcpStream::connect(&node) else { continue };
                for (mut from, mut to) in [(&operator, &node), (&node, &operator)]
                    .map(|(from, to)| (from.try_clone().unwrap(), to.try_clone().unwrap()))
                {
                    thread::spawn(move || {
                        let _ = io::copy(&mut from, &mut to);
                        let _ = to.shutdown(Shutdown::Both);
                    });
                }
                open.extend([operator, node]);
            }
        });
        Self { address, connections }
    }

    pub fn url(&self) -> String {
        format!("ws://{}", self.address)
    }

    /// Makes the node unreachable, and drops what is in flight.
    pub fn cut(&self) {
        for connection in self.connections.lock().take().into_iter().flatten() {
            let _ = connection.shutdown(Shutdown::Both);
        }
    }

    /// Makes the node reachable again.
    pub fn mend(&self) {
        self.connections.lock().get_or_insert_default();
    }
}
