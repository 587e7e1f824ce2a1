//! Connections to a port with TLS.

use std::time::Duration;

use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _},
    net::{TcpListener, TcpStream},
};

use super::*;
use crate::api::tls::{self, Origin};

#[test]
fn a_stalled_handshake_is_given_up() {
    let folder = tempfile::tempdir().unwrap();
    let encryption = Encryption::Authority(Some(folder.path().join("agents")));
    let address = ([127, 0, 0, 1], 0).into();
    let (config, _) = tls::configure(&encryption, address).unwrap().unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let listener = TcpListener::bind(address).await.unwrap();
        let own = listener.local_addr().unwrap();
        let patience = Patience { begin: Duration::from_millis(1), ..Patience::default() };
        let places = Arc::new(Mutex::new(Connections::new(FEW)));
        let port = Port { listener, tls: Some(config), origin: Origin::Machine };
        let clients = async {
            for said in [&[][..], &[22], &[22, 3, 1, 2, 0]] {
                let mut stream = TcpStream::connect(own).await.unwrap();
                stream.write_all(said).await.unwrap();
                let mut answer = Vec::new();
                let _ = stream.read_to_end(&mut answer).await;
                assert!(answer.is_empty(), "{answer:?}");
            }
        };
        tokio::select! {
            () = serve::serve(port, Router::new(), places, patience) => {}
            () = clients => {}
        }
    });
}
