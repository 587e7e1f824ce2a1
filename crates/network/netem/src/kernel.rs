//! The netlink socket: sends requests to the kernel and receives its answers.

use std::io;

use cotorra_graph::IpNetwork;
use netlink_sys::{Socket, protocols::NETLINK_ROUTE};

use crate::{
    device::{Device, DisciplineInfo, Interface, Plan, Snapshot, decode_filter},
    netem::Netem,
    request::{Dump, Object, Request, Verb},
    route,
    rule::{Rule, Side},
    structure::word,
};
use cotorra_netlink::{Answers, DecodeError, ERROR, Message, State, attributes, messages, text};

/// A failure in the exchange with the kernel.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The kernel lacks a module.
    #[error(
        "this kernel has no {module} and cannot load it: run `modprobe {module}`, or install it from \
         linux-modules-extra or similar"
    )]
    Missing {
        /// Name of the module.
        module: &'static str,
    },
    /// The kernel rejected a request.
    #[error("the kernel refuses `{request}`: {source}{}", if message.is_empty() { String::new() } else { format!(" ({message})") })]
    Refused {
        /// The request as a `tc` or `ip` command.
        request: String,
        /// The kernel's explanation; may be empty.
        message: String,
        /// The kernel's error code.
        source: io::Error,
    },
    /// The process lacks CAP_NET_ADMIN.
    #[error("changing an interface's conditions needs root or CAP_NET_ADMIN: run it as root")]
    NoRights,
    /// No interface has this name.
    #[error("there is no interface `{name}` here{}", if others.is_empty() { String::new() } else { format!(": there are {others}") })]
    NoInterface {
        /// Requested name.
        name: String,
        /// Names of the existing interfaces, separated by commas.
        others: String,
    },
    /// The netlink socket failed.
    #[error("netlink socket failed: {0}")]
    Socket(#[from] io::Error),
    /// The answer could not be decoded.
    #[error(transparent)]
    Decode(#[from] DecodeError),
}

/// Traffic control of one network namespace.
#[derive(Debug)]
pub struct Kernel {
    socket: Socket,
}

impl Error {
    /// Returns the error for an interface that has disappeared.
    pub(crate) fn gone(name: &str) -> Self {
        Self::NoInterface { name: name.to_owned(), others: String::new() }
    }
}

/// Number of all requests: each is answered before the next.
const NUMBER: u32 = 1;
const HEADER: usize = 16;
/// `NLM_F_ACK_TLVS`: attributes follow the error code.
const HAS_TEXT: u16 = 0x200;

const ENOENT: i32 = 2;
const EPERM: i32 = 1;
const EOPNOTSUPP: i32 = 95;

impl Kernel {
    /// Opens a netlink socket in the calling thread's network namespace. It stays in that namespace when the thread
    /// changes to another.
    ///
    /// # Errors
    /// [`Error::Socket`].
    pub fn open() -> Result<Self, Error> {
        let mut socket = Socket::new(NETLINK_ROUTE)?;
        socket.bind_auto()?;
        socket.set_cap_ack(true)?;
        // Older kernels lack extended error messages.
        let _ = socket.set_ext_ack(true);
        Ok(Self { socket })
    }

    /// Returns the interface of that name and its rules.
    ///
    /// # Errors
    /// [`Error`].
    pub fn device(&self, name: &str) -> Result<Device, Error> {
        let snapshot = self.snapshot()?;
        let Some(interface) = snapshot.interfaces.iter().find(|interface| interface.name == name).cloned()
        else {
            let others = snapshot.interfaces.into_iter().map(|i| i.name).collect::<Vec<_>>().join(", ");
            return Err(Error::NoInterface { name: name.to_owned(), others });
        };
        self.device_of(snapshot, &interface)
    }

    /// Returns all interfaces and their rules.
    ///
    /// # Errors
    /// [`Error`].
    pub fn devices(&self) -> Result<Vec<Device>, Error> {
        let snapshot = self.snapshot()?;
        snapshot
            .interfaces
            .clone()
            .iter()
            .map(|interface| self.device_of(snapshot.clone(), interface))
            .collect()
    }

    /// Returns the indices of the interfaces that default routes lead over.
    ///
    /// # Errors
    /// [`Error`].
    pub fn default_routes(&self) -> Result<Vec<u32>, Error> {
        let mut interfaces = Vec::new();
        for body in self.dump(Dump::Routes)? {
            interfaces.extend(route::default_route_interfaces(&body)?);
        }
        Ok(interfaces)
    }

    /// Returns the modules that this kernel neither has nor can load. Tries rules on the loopback interface: call it
    /// in a network namespace of its own.
    ///
    /// # Errors
    /// [`Error`], except [`Error::Missing`].
    pub fn lacks(&self) -> Result<Vec<&'static str>, Error> {
        let mut lacks = Vec::new();
        let sides = [
            (Side::Egress, None),
            (Side::Egress, IpNetwork::new([10, 0, 0, 1].into(), 32)),
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

    /// Whether this kernel's NetEm accepts a seed, as Linux 6.7 and later do. Older kernels ignore it silently. Tries
    /// it on the loopback interface, as [`Self::lacks`] does.
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

    fn snapshot(&self) -> Result<Snapshot, Error> {
        let interfaces =
            self.dump(Dump::Links)?.iter().map(|body| Interface::decode(body)).collect::<Result<_, _>>()?;
        let disciplines = self
            .dump(Dump::Disciplines)?
            .iter()
            .map(|body| DisciplineInfo::decode(body))
            .collect::<Result<_, _>>()?;
        Ok(Snapshot { interfaces, disciplines, filters: Vec::new() })
    }

    fn device_of(&self, mut snapshot: Snapshot, interface: &Interface) -> Result<Device, Error> {
        for (index, parent) in snapshot.filter_places(interface) {
            for body in self.dump(Dump::Filters(index, parent))? {
                snapshot.filters.extend(decode_filter(&body)?);
            }
        }
        Ok(Device::new(&snapshot, interface)?)
    }

    /// Applies a plan. If the kernel rejects one request, the requests before it are undone.
    ///
    /// # Errors
    /// [`Error`]; then nothing has changed.
    pub fn apply(&self, plan: &Plan) -> Result<(), Error> {
        for (place, request) in plan.0.iter().enumerate() {
            if let Err(error) = self.send(request) {
                for done in plan.0[..place].iter().rev() {
                    // A request that cannot be undone, such as a filter whose discipline is gone, needs no undoing.
                    let _ = self.send(&done.undo());
                }
                return Err(error);
            }
        }
        Ok(())
    }

    fn send(&self, request: &Request) -> Result<(), Error> {
        self.socket.send(&request.encode(NUMBER), 0)?;
        let mut answer = Vec::with_capacity(16 << 10);
        self.socket.recv(&mut answer, 0)?;
        let answer = messages(&answer).next().ok_or(DecodeError("an answer is empty"))??;
        let Message { kind, flags, body, .. } = answer;
        if kind != ERROR {
            return Err(DecodeError("the kernel did not acknowledge a request").into());
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
            _ => Error::Refused { request: request.to_string(), message: message(flags, body)?, source },
        })
    }

    /// Sends a dump request and returns the bodies of all answers.
    fn dump(&self, question: Dump) -> Result<Vec<Vec<u8>>, Error> {
        self.socket.send(&question.encode(NUMBER), 0)?;
        let mut answers = Answers::new(NUMBER);
        let mut datagram = Vec::with_capacity(64 << 10);
        loop {
            datagram.clear();
            self.socket.recv(&mut datagram, 0)?;
            match answers.take(&datagram, &|body| Ok(Some(body.to_vec())))? {
                State::Incomplete => {}
                State::Complete(_) => return Ok(answers.found),
                State::Rejected(error) => return Err(error.into()),
            }
        }
    }
}

/// Returns the kernel's text beside an error code.
fn message(flags: u16, body: &[u8]) -> Result<String, DecodeError> {
    if flags & HAS_TEXT == 0 {
        return Ok(String::new());
    }
    // The error code is followed by the request's header, without its body.
    for attribute in attributes(body.get(4 + HEADER..).unwrap_or_default()) {
        if let (1, message) = attribute? {
            return Ok(text(message));
        }
    }
    Ok(String::new())
}
