//! What stands between an operator and its node, and can be cut.

use std::{
    io,
    net::{Shutdown, SocketAddr, TcpListener, TcpStream},
    sync::Arc,
    thread,
};

use parking_lot::Mutex;

pub struct Proxy {
    address: SocketAddr,
    /// The connections; `None` while it is cut.
    connections: Arc<Mutex<Option<Vec<TcpStream>>>>,
}

impl Proxy {
    /// In front of a node, which is named by its WebSocket.
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

    /// The node cannot be reached, and what is under way is lost.
    pub fn cut(&self) {
        for connection in self.connections.lock().take().into_iter().flatten() {
            let _ = connection.shutdown(Shutdown::Both);
        }
    }

    /// It can be reached again.
    pub fn mend(&self) {
        self.connections.lock().get_or_insert_default();
    }
}
