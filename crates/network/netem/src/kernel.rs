//! The thin shell around all this: a socket to the kernel, on which requests go out and answers come in.

use std::io;

use netlink_sys::{Socket, protocols::NETLINK_ROUTE};

use crate::{
    attributes::{Malformed, attributes, text, word},
    device::{Device, Interface, Plan, Seen, SeenDiscipline, decode_filter},
    handle::Network,
    netem::Netem,
    request::{Object, Question, Request, Verb},
    route,
    rule::{Rule, Side},
};

/// What can go wrong between this program and the kernel.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The kernel lacks a module.
    #[error(
        "this kernel has no {module}, nor finds the module: `modprobe {module}`, from linux-modules-extra or similar"
    )]
    Missing {
        /// The module.
        module: &'static str,
    },
    /// The kernel refused something else.
    #[error("the kernel refuses `{request}`: {source}{}", if said.is_empty() { String::new() } else { format!(" ({said})") })]
    Refused {
        /// In the words of `tc`.
        request: String,
        /// What the kernel said in words; may be empty.
        said: String,
        /// Its error.
        source: io::Error,
    },
    /// No rights.
    #[error("conditions of interfaces are changed by root only, or with CAP_NET_ADMIN: run it as root")]
    NoRights,
    /// No interface of that name.
    #[error("there is no interface `{name}` here{}", if others.is_empty() { String::new() } else { format!(": there are {others}") })]
    NoInterface {
        /// The name.
        name: String,
        /// Those that there are.
        others: String,
    },
    /// The socket.
    #[error("cannot talk to the kernel by netlink: {0}")]
    Socket(#[from] io::Error),
    /// The answer.
    #[error(transparent)]
    Malformed(#[from] Malformed),
}

/// The kernel's traffic control in one network namespace.
#[derive(Debug)]
pub struct Kernel {
    socket: Socket,
}

impl Error {
    /// An interface was there, and is no more.
    pub(crate) fn gone(name: &str) -> Self {
        Self::NoInterface { name: name.to_owned(), others: String::new() }
    }
}

const ERROR: u16 = 2;
const DONE: u16 = 3;
const HEADER: usize = 16;
/// In a header's flags: there is more than a number in an error.
const HAS_TEXT: u16 = 0x200;

const ENOENT: i32 = 2;
const EPERM: i32 = 1;
const EOPNOTSUPP: i32 = 95;

impl Kernel {
    /// Opens it for the calling thread's network namespace, whichever that thread enters afterwards.
    ///
    /// # Errors
    /// [`Error::Socket`].
    pub fn open() -> Result<Self, Error> {
        let mut socket = Socket::new(NETLINK_ROUTE)?;
        socket.bind_auto()?;
        socket.set_cap_ack(true)?;
        // Older kernels say less.
        let _ = socket.set_ext_ack(true);
        Ok(Self { socket })
    }

    /// The interface of that name and what is at it.
    ///
    /// # Errors
    /// [`Error`].
    pub fn device(&self, name: &str) -> Result<Device, Error> {
        let seen = self.seen()?;
        let Some(interface) = seen.interfaces.iter().find(|interface| interface.name == name).cloned() else {
            let others = seen.interfaces.into_iter().map(|i| i.name).collect::<Vec<_>>().join(", ");
            return Err(Error::NoInterface { name: name.to_owned(), others });
        };
        self.device_of(seen, &interface)
    }

    /// All interfaces and what is at them.
    ///
    /// # Errors
    /// [`Error`].
    pub fn devices(&self) -> Result<Vec<Device>, Error> {
        let seen = self.seen()?;
        seen.interfaces.clone().iter().map(|interface| self.device_of(seen.clone(), interface)).collect()
    }

    /// The interfaces, by index, that packets take to wherever no other route leads.
    ///
    /// # Errors
    /// [`Error`].
    pub fn default_routes(&self) -> Result<Vec<u32>, Error> {
        let mut interfaces = Vec::new();
        for body in self.ask(Question::Routes)? {
            interfaces.extend(route::ways(&body)?);
        }
        Ok(interfaces)
    }

    /// The modules that this kernel neither has nor finds, found by trying on the loopback interface: do it in a network
    /// namespace in which nobody needs that.
    ///
    /// # Errors
    /// [`Error`], but for [`Error::Missing`].
    pub fn lacks(&self) -> Result<Vec<&'static str>, Error> {
        let mut lacks = Vec::new();
        let sides = [
            (Side::Egress, None),
            (Side::Egress, Network::new([10, 0, 0, 1].into(), 32)),
            (Side::Ingress, None),
        ];
        for (side, network) in sides {
            let plan = self.device("lo")?.set(&Rule { side, network, ..Rule::default() }, false);
            match self.apply(&plan.expect("a loopback interface without rules takes any")) {
                Err(Error::Missing { module }) if lacks.contains(&module) => {}
                Err(Error::Missing { module }) => lacks.push(module),
                result => result?,
            }
            self.apply(&self.device("lo")?.clear(side, None))?;
        }
        Ok(lacks)
    }

    /// Whether this kernel's NetEm takes a seed, as Linux 6.7 and later do; tried as by [`Self::lacks`]. An older one
    /// says nothing, and is random in another way each time.
    ///
    /// # Errors
    /// [`Error::Missing`] without NetEm.
    pub fn takes_seeds(&self) -> Result<bool, Error> {
        const SEED: Option<u64> = Some(1);
        let rule = Rule { netem: Netem { seed: SEED, ..Netem::default() }, ..Rule::default() };
        let plan = self.device("lo")?.set(&rule, false);
        self.apply(&plan.expect("a loopback interface without rules takes any"))?;
        let device = self.device("lo")?;
        let kept = device.rules().any(|(rule, _)| rule.netem.seed == SEED);
        self.apply(&device.clear(Side::Egress, None))?;
        Ok(kept)
    }

    fn seen(&self) -> Result<Seen, Error> {
        let interfaces = self
            .ask(Question::Links)?
            .iter()
            .map(|body| Interface::decode(body))
            .collect::<Result<_, _>>()?;
        let disciplines = self
            .ask(Question::Disciplines)?
            .iter()
            .map(|body| SeenDiscipline::decode(body))
            .collect::<Result<_, _>>()?;
        Ok(Seen { interfaces, disciplines, filters: Vec::new() })
    }

    fn device_of(&self, mut seen: Seen, interface: &Interface) -> Result<Device, Error> {
        for (index, parent) in seen.filter_places(interface) {
            for body in self.ask(Question::Filters(index, parent))? {
                seen.filters.extend(decode_filter(&body)?);
            }
        }
        Ok(Device::new(&seen, interface)?)
    }

    /// Does what a plan says. If the kernel refuses one thing, what was done before is undone.
    ///
    /// # Errors
    /// [`Error`]; then nothing has changed.
    pub fn apply(&self, plan: &Plan) -> Result<(), Error> {
        for (place, request) in plan.0.iter().enumerate() {
            if let Err(error) = self.tell(request) {
                for done in plan.0[..place].iter().rev() {
                    // What cannot be undone, such as a filter of a discipline that is gone, is gone already.
                    let _ = self.tell(&done.undo());
                }
                return Err(error);
            }
        }
        Ok(())
    }

    fn tell(&self, request: &Request) -> Result<(), Error> {
        self.socket.send(&request.encode(1), 0)?;
        let mut answer = Vec::with_capacity(16 << 10);
        self.socket.recv(&mut answer, 0)?;
        let (Message { kind, flags, body }, _) = split(&answer)?;
        if kind != ERROR {
            return Err(Malformed("a request was not acknowledged").into());
        }
        let code = -(word(body, 0)? as i32);
        if code == 0 {
            return Ok(());
        }
        let source = io::Error::from_raw_os_error(code);
        let adds = request.verb == Verb::Add;
        Err(match code {
            EPERM => Error::NoRights,
            ENOENT if adds => Error::Missing { module: request.module() },
            EOPNOTSUPP if adds && request.object == Object::Ifb => {
                Error::Missing { module: request.module() }
            }
            _ => Error::Refused { request: request.to_string(), said: said(flags, body)?, source },
        })
    }

    /// The bodies of all answers.
    fn ask(&self, question: Question) -> Result<Vec<Vec<u8>>, Error> {
        self.socket.send(&question.encode(1), 0)?;
        let mut bodies = Vec::new();
        let mut answers = Vec::with_capacity(64 << 10);
        loop {
            answers.clear();
            self.socket.recv(&mut answers, 0)?;
            let mut rest = &answers[..];
            while !rest.is_empty() {
                let (Message { kind, body, .. }, behind) = split(rest)?;
                match kind {
                    DONE => return Ok(bodies),
                    ERROR => return Err(io::Error::from_raw_os_error(-(word(body, 0)? as i32)).into()),
                    _ => bodies.push(body.to_vec()),
                }
                rest = behind;
            }
        }
    }
}

/// One message of the kernel's.
struct Message<'a> {
    kind: u16,
    flags: u16,
    body: &'a [u8],
}

/// The first message, and what is behind it.
fn split(bytes: &[u8]) -> Result<(Message<'_>, &[u8]), Malformed> {
    let header = bytes.get(..HEADER).ok_or(Malformed("a message has no header"))?;
    let length = word(header, 0)? as usize;
    let kind = u16::from_ne_bytes([header[4], header[5]]);
    let flags = u16::from_ne_bytes([header[6], header[7]]);
    let body = bytes.get(HEADER..length).ok_or(Malformed("a message is cut"))?;
    let behind = bytes.get(length.next_multiple_of(4)..).unwrap_or_default();
    Ok((Message { kind, flags, body }, behind))
}

/// What the kernel says beside an error's number.
fn said(flags: u16, body: &[u8]) -> Result<String, Malformed> {
    if flags & HAS_TEXT == 0 {
        return Ok(String::new());
    }
    // The number and the request's header, which alone comes back.
    let told = attributes(body.get(4 + HEADER..).unwrap_or_default())?;
    Ok(told.into_iter().find(|(kind, _)| *kind == 1).map(|(_, said)| text(said)).unwrap_or_default())
}
