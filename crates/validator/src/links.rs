//! The links between validators: one TCP connection each way, on which the one that connected shows who it is and then speaks.
//! What is said is public, and what must not be forged is signed by itself, so nothing is encrypted.

use std::{
    io::{self, Read, Write},
    net::{Shutdown, SocketAddr, TcpListener, TcpStream, ToSocketAddrs},
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
        mpsc::{Receiver, SyncSender, TrySendError, sync_channel},
    },
    thread,
    time::Duration,
};

use ed25519_dalek::SigningKey;
use serde::{Deserialize, Serialize};

use crate::{
    context::{Signature, Validators},
    sign::{NetworkId, sign, verifies},
    wire::{MAX_MESSAGE, Message},
};

/// How long a connection may take to begin, and a message to be written.
const HANDSHAKE: Duration = Duration::from_secs(5);
/// Who says nothing for so long is gone: all say twice a second how far they are.
const SILENCE: Duration = Duration::from_secs(15);
/// Between two attempts to connect.
const RECONNECT: Duration = Duration::from_millis(200);
/// Messages that wait for a slow link; more are dropped, and said again by whoever still needs them heard.
const WAITING: usize = 1024;
/// Connections at once, of whoever.
const CONNECTIONS: usize = 64;
/// What a stranger may send before it is known.
const MAX_GREETING: usize = 1024;

/// What the links tell.
pub(crate) enum Heard {
    /// A validator said something.
    Message(usize, Message),
    /// A validator can be spoken to again.
    Connected,
}

/// Who connects, and the proof of it.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Greeting {
    from: usize,
    signature: Signature,
}

/// What all links need.
pub(crate) struct Settings {
    pub(crate) validators: Validators,
    pub(crate) me: usize,
    pub(crate) key: SigningKey,
    pub(crate) network: NetworkId,
}

/// The way to all others.
pub(crate) struct Links {
    others: Vec<Option<SyncSender<Arc<[u8]>>>>,
}

impl Links {
    /// Listens, and connects to all others, again and again.
    pub(crate) fn start<F>(
        settings: Settings,
        listener: TcpListener,
        addresses: &[String],
        hear: F,
    ) -> io::Result<Self>
    where
        F: Fn(Heard) + Clone + Send + Sync + 'static,
    {
        let settings = Arc::new(settings);
        let (of_listener, heard) = (settings.clone(), hear.clone());
        spawn("listener", move || listen(&of_listener, &listener, &heard))?;
        let mut others = Vec::new();
        for (index, address) in addresses.iter().enumerate() {
            if index == settings.me {
                others.push(None);
                continue;
            }
            let (sender, receiver) = sync_channel(WAITING);
            let (settings, address, hear) = (settings.clone(), address.clone(), hear.clone());
            spawn("link", move || speak(&settings, index, &address, &receiver, &hear))?;
            others.push(Some(sender));
        }
        Ok(Self { others })
    }

    /// Says something to one, or to all others. Whoever cannot be reached does not hear it.
    pub(crate) fn say(&self, to: Option<usize>, message: &Message) {
        let frame: Arc<[u8]> = frame(message).into();
        let others = self.others.iter().enumerate().filter(|(index, _)| to.is_none_or(|to| to == *index));
        for sender in others.filter_map(|(_, sender)| sender.as_ref()) {
            match sender.try_send(frame.clone()) {
                Ok(()) | Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => {}
            }
        }
    }
}

fn spawn(name: &str, run: impl FnOnce() + Send + 'static) -> io::Result<()> {
    thread::Builder::new().name(name.to_owned()).spawn(run).map(drop)
}

fn frame(item: &impl Serialize) -> Vec<u8> {
    let mut bytes = vec![0; 4];
    serde_json::to_writer(&mut bytes, item).expect("it has no maps");
    let length = (bytes.len() - 4) as u32;
    bytes[..4].copy_from_slice(&length.to_be_bytes());
    bytes
}

/// A frame: its length in four bytes, most significant first, and so much JSON.
fn read_frame<T: for<'de> Deserialize<'de>>(stream: &mut TcpStream, most: usize) -> io::Result<T> {
    let mut length = [0; 4];
    stream.read_exact(&mut length)?;
    let length = u32::from_be_bytes(length) as usize;
    if length > most {
        return Err(io::Error::new(io::ErrorKind::InvalidData, format!("a message of {length} bytes")));
    }
    let mut text = Vec::new();
    stream.take(length as u64).read_to_end(&mut text)?;
    Ok(serde_json::from_slice(&text)?)
}

fn listen(
    settings: &Arc<Settings>,
    listener: &TcpListener,
    hear: &(impl Fn(Heard) + Clone + Send + 'static),
) {
    let count = Arc::new(AtomicUsize::new(0));
    for stream in listener.incoming() {
        let Ok(stream) = stream else { continue };
        if count.fetch_add(1, Ordering::Relaxed) >= CONNECTIONS {
            count.fetch_sub(1, Ordering::Relaxed);
            continue;
        }
        let (settings, hear, of_thread) = (settings.clone(), hear.clone(), count.clone());
        let run = move || {
            if let Err(reason) = listen_to(&settings, stream, &hear) {
                tracing::debug!(%reason, "a connection ended");
            }
            of_thread.fetch_sub(1, Ordering::Relaxed);
        };
        if spawn("connection", run).is_err() {
            count.fetch_sub(1, Ordering::Relaxed);
        }
    }
}

/// Hears one that connected until it goes.
fn listen_to(settings: &Settings, mut stream: TcpStream, hear: &impl Fn(Heard)) -> io::Result<()> {
    stream.set_read_timeout(Some(HANDSHAKE))?;
    let challenge: [u8; 32] = rand::random();
    stream.write_all(&challenge)?;
    let Greeting { from, signature } = read_frame(&mut stream, MAX_GREETING)?;
    let said = settings.network.greeting(&challenge, settings.me);
    if !settings.validators.key(from).is_some_and(|key| verifies(key, &said, &signature)) {
        return Err(io::Error::new(io::ErrorKind::PermissionDenied, "it is no validator of this network"));
    }
    stream.set_read_timeout(Some(SILENCE))?;
    loop {
        hear(Heard::Message(from, read_frame(&mut stream, MAX_MESSAGE)?));
    }
}

/// Speaks to one other for ever.
fn speak(
    settings: &Settings,
    to: usize,
    address: &str,
    messages: &Receiver<Arc<[u8]>>,
    hear: &impl Fn(Heard),
) {
    loop {
        match connect(settings, to, address) {
            Ok(mut stream) => {
                // Nobody needs what was said to a validator that was away.
                while messages.try_recv().is_ok() {}
                hear(Heard::Connected);
                while let Ok(message) = messages.recv() {
                    if stream.write_all(&message).is_err() {
                        break;
                    }
                }
                let _ = stream.shutdown(Shutdown::Both);
            }
            Err(reason) => tracing::trace!(%address, %reason, "no connection"),
        }
        #[allow(clippy::disallowed_methods, reason = "a shell that waits for others")]
        thread::sleep(RECONNECT);
    }
}

fn connect(settings: &Settings, to: usize, address: &str) -> io::Result<TcpStream> {
    let nobody = || io::Error::new(io::ErrorKind::NotFound, "the name has no address");
    let address: SocketAddr = address.to_socket_addrs()?.next().ok_or_else(nobody)?;
    let mut stream = TcpStream::connect_timeout(&address, HANDSHAKE)?;
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(HANDSHAKE))?;
    stream.set_write_timeout(Some(HANDSHAKE))?;
    let mut challenge = [0; 32];
    stream.read_exact(&mut challenge)?;
    let signature = sign(&settings.key, &settings.network.greeting(&challenge, to));
    stream.write_all(&frame(&Greeting { from: settings.me, signature }))?;
    Ok(stream)
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;

    use super::*;
    use crate::context::Height;

    fn key(index: u8) -> SigningKey {
        SigningKey::from_bytes(&[index + 1; 32])
    }

    fn settings(me: usize, key: SigningKey, genesis: u8) -> Settings {
        let validators = Validators::new(&[self::key(0).verifying_key(), self::key(1).verifying_key()]);
        let network = NetworkId::new(&[genesis; 32], &validators);
        Settings { validators, me, key, network }
    }

    #[test]
    fn validators_hear_each_other_and_strangers_are_not_heard() {
        let listeners = [(); 2].map(|()| TcpListener::bind("127.0.0.1:0").unwrap());
        let addresses = [0, 1].map(|index| listeners[index].local_addr().unwrap().to_string());
        // One without a validator's key, one that says it is another, and a validator of another network.
        for (key, me, genesis) in [(key(2), 1, 7), (key(1), 0, 7), (key(1), 7, 7), (key(1), 1, 8)] {
            let stranger = settings(me, key, genesis);
            let mut stream = TcpStream::connect(&addresses[0]).unwrap();
            let listening = settings(0, self::key(0), 7);
            let theirs = thread::scope(|scope| {
                let heard = scope.spawn(|| {
                    let (accepted, _) = listeners[0].accept().unwrap();
                    listen_to(&listening, accepted, &|_| unreachable!("nobody is to be heard"))
                        .unwrap_err()
                        .kind()
                });
                let mut challenge = [0; 32];
                stream.read_exact(&mut challenge).unwrap();
                let signature = sign(&stranger.key, &stranger.network.greeting(&challenge, 0));
                stream.write_all(&frame(&Greeting { from: me, signature })).unwrap();
                stream.write_all(&frame(&Message::Status { decided: Height(9) })).unwrap();
                heard.join().unwrap()
            });
            assert_eq!(theirs, io::ErrorKind::PermissionDenied);
        }
        let (tell, heard) = mpsc::channel();
        let links: Vec<Links> = listeners
            .into_iter()
            .enumerate()
            .map(|(me, listener)| {
                let tell = tell.clone();
                let hear = move |heard| _ = tell.send((me, heard));
                Links::start(settings(me, key(me as u8), 7), listener, &addresses, hear).unwrap()
            })
            .collect();
        let mut connected = 0;
        let mut messages = Vec::new();
        while messages.len() < 2 {
            match heard.recv().unwrap() {
                (_, Heard::Connected) => connected += 1,
                (by, Heard::Message(from, message)) => messages.push((by, from, message)),
            }
            if connected == 2 {
                connected += 1;
                links[0].say(None, &Message::Status { decided: Height(3) });
                links[1].say(Some(0), &Message::Status { decided: Height(4) });
            }
        }
        messages.sort_by_key(|(by, ..)| *by);
        let status = |height| Message::Status { decided: Height(height) };
        assert_eq!(messages, [(0, 1, status(4)), (1, 0, status(3))]);
    }
}
