//! Requests to the kernel, one netlink message each (rtnetlink(7), linux/rtnetlink.h). A request is encoded for the
//! kernel and displayed as a `tc` or `ip` command.

use std::fmt;

use crate::{
    filter::{Field, Filter, Packets, Verdict},
    handle::Handle,
    loss::Loss,
    netem::Netem,
};
use cotorra_netlink::{
    ACK, CREATE, DUMP, EXCLUSIVE, REQUEST, Writer, message,
    rtnetlink::{self, NEW_LINK},
};

/// Action of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Verb {
    Add,
    Change,
    Delete,
}

/// A queueing discipline.
#[derive(Debug, Clone, PartialEq)]
#[allow(clippy::large_enum_variant, reason = "a plan has a few of them")]
pub(crate) enum Discipline {
    /// NetEm; `before` is its state before a change.
    Netem { netem: Netem, before: Option<Netem> },
    /// Hierarchical token buckets. Packets that match no filter are in the class `default`; those without one pass at once.
    Htb { default: u16 },
    /// Attachment point of ingress filters.
    Ingress,
    /// A foreign discipline as it was found.
    Foreign { kind: String, options: Vec<u8> },
}

/// The rates of a class of HTB.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Shape {
    pub(crate) parent: Handle,
    /// Assured rate, bit/s.
    pub(crate) rate_bps: u64,
    /// The most, bit/s.
    pub(crate) ceiling_bps: u64,
    /// Bytes of a turn.
    pub(crate) quantum: u32,
    /// Bytes of tokens that it keeps, of each rate.
    pub(crate) burst: u64,
}

impl Shape {
    /// A rate that no packet waits for, bit/s: 1 Tbit/s.
    pub(crate) const UNLIMITED_BPS: u64 = 1_000_000_000_000;
    /// A class that delays nothing, with 1 ms of tokens.
    pub(crate) const OPEN: Self = Self {
        parent: Handle::OURS,
        rate_bps: Self::UNLIMITED_BPS,
        ceiling_bps: Self::UNLIMITED_BPS,
        quantum: 60_000,
        burst: 125_000_000,
    };
}

/// Object of a request.
#[derive(Debug, Clone, PartialEq)]
#[allow(clippy::large_enum_variant, reason = "a plan has a few of them")]
pub(crate) enum Object {
    Discipline {
        parent: Handle,
        handle: Handle,
        discipline: Discipline,
    },
    /// Our class with this number; `before` is its shape before a change.
    Class {
        number: u16,
        shape: Shape,
        before: Option<Shape>,
    },
    Filter {
        parent: Handle,
        filter: Filter,
    },
    /// An intermediate functional block: an interface that exists only for its discipline.
    Ifb,
}

/// One request to the kernel.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Request {
    pub(crate) verb: Verb,
    /// Index and name of the interface.
    pub(crate) interface: (u32, String),
    pub(crate) object: Object,
}

/// Message kinds `RTM_NEW…`. Deletion is the next number, retrieval the one after.
const ROUTE: u16 = 24;
const QDISC: u16 = 36;
const CLASS: u16 = 40;
const FILTER: u16 = 44;

const KIND: u16 = 1;
const OPTIONS: u16 = 2;

impl Request {
    /// Returns the request that undoes this one.
    pub(crate) fn undo(&self) -> Self {
        let mut object = self.object.clone();
        let verb = match self.verb {
            Verb::Add => Verb::Delete,
            Verb::Delete => Verb::Add,
            Verb::Change => {
                match &mut object {
                    Object::Discipline {
                        discipline: Discipline::Netem { netem, before: Some(before) },
                        ..
                    } => std::mem::swap(netem, before),
                    Object::Class { shape, before: Some(before), .. } => std::mem::swap(shape, before),
                    _ => {}
                }
                Verb::Change
            }
        };
        Self { verb, interface: self.interface.clone(), object }
    }

    /// Returns the kernel module that the request needs.
    pub(crate) fn module(&self) -> &'static str {
        match &self.object {
            Object::Discipline { discipline: Discipline::Netem { .. }, .. } => "sch_netem",
            Object::Discipline { discipline: Discipline::Ingress, .. } => "sch_ingress",
            Object::Discipline { discipline: Discipline::Htb { .. }, .. } | Object::Class { .. } => "sch_htb",
            Object::Discipline { .. } => "discipline of that kind",
            Object::Filter { filter: Filter { verdict: Verdict::Redirect(_), .. }, .. } => {
                "cls_u32 or act_mirred"
            }
            Object::Filter { .. } => "cls_u32",
            Object::Ifb => "ifb",
        }
    }

    /// Encodes the message with its sequence number.
    pub(crate) fn encode(&self, number: u32) -> Vec<u8> {
        let flags = REQUEST
            | ACK
            | match self.verb {
                Verb::Add => CREATE | EXCLUSIVE,
                Verb::Change | Verb::Delete => 0,
            };
        let delete = u16::from(self.verb == Verb::Delete);
        let index = self.interface.0;
        let mut w = Writer::default();
        let kind = match &self.object {
            Object::Discipline { parent, handle, discipline } => {
                w.raw(&tc(index, *handle, *parent, 0));
                if delete == 0 {
                    discipline.encode(&mut w);
                }
                QDISC
            }
            Object::Class { number, shape, .. } => {
                w.raw(&tc(index, Handle::class(*number), shape.parent, 0));
                if delete == 0 {
                    shape.encode(&mut w);
                }
                CLASS
            }
            Object::Filter { parent, filter } => {
                let info = u32::from(filter.priority) << 16 | u32::from(filter.protocol().to_be());
                w.raw(&tc(index, Handle(0), *parent, info));
                if delete == 0 {
                    w.text(KIND, "u32").bytes(OPTIONS, &filter.encode());
                }
                FILTER
            }
            Object::Ifb => {
                w = rtnetlink::link_up(index);
                if delete == 0 {
                    w.text(3, &self.interface.1).words(13, &[crate::netem::QUEUE]);
                    w.with(18, |w| {
                        w.text(1, "ifb");
                    });
                }
                NEW_LINK
            }
        };
        message(kind + delete, flags, number, &w.finish())
    }
}

/// A request to list objects.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Dump {
    Links,
    Disciplines,
    Routes,
    /// Filters of an interface at a parent.
    Filters(u32, Handle),
}

impl Dump {
    pub(crate) fn encode(self, number: u32) -> Vec<u8> {
        let (kind, body) = match self {
            Self::Links => (NEW_LINK, rtnetlink::link(0).finish()),
            Self::Disciplines => (QDISC, tc(0, Handle(0), Handle(0), 0)),
            // An empty `struct rtmsg` selects all address families.
            Self::Routes => (ROUTE, vec![0; 12]),
            Self::Filters(index, parent) => (FILTER, tc(index, Handle(0), parent, 0)),
        };
        message(kind + 2, REQUEST | DUMP, number, &body)
    }
}

/// Encodes `struct tcmsg`.
fn tc(index: u32, handle: Handle, parent: Handle, info: u32) -> Vec<u8> {
    [0, index, handle.0, parent.0, info].map(u32::to_ne_bytes).concat()
}

impl Discipline {
    pub(crate) fn kind(&self) -> &str {
        match self {
            Self::Netem { .. } => "netem",
            Self::Htb { .. } => "htb",
            Self::Ingress => "ingress",
            Self::Foreign { kind, .. } => kind,
        }
    }

    fn encode(&self, w: &mut Writer) {
        w.text(KIND, self.kind());
        match self {
            Self::Netem { netem, before } => drop(w.bytes(OPTIONS, &netem.encode(before.as_ref()))),
            // `struct tc_htb_glob`: version, rate to quantum, default class, debug, direct packets. Then the queue
            // length for packets that match no class.
            Self::Htb { default } => {
                w.with(OPTIONS, |w| {
                    w.words(2, &[3, 10, u32::from(*default), 0, 0]).words(5, &[crate::netem::QUEUE]);
                });
            }
            Self::Ingress => {}
            Self::Foreign { options, .. } if options.is_empty() => {}
            Self::Foreign { options, .. } => drop(w.bytes(OPTIONS, options)),
        }
    }
}

impl Shape {
    fn encode(&self, w: &mut Writer) {
        let [rate, ceiling] = [self.rate_bps, self.ceiling_bps].map(|bps| bps.div_ceil(8));
        // `struct tc_ratespec` for Ethernet. A rate that does not fit follows in a 64-bit attribute.
        let ratespec = |bytes: u64| {
            let bytes = u32::try_from(bytes).unwrap_or(u32::MAX);
            [[0, 1, 0, 0], [0; 4], bytes.to_ne_bytes()].concat()
        };
        // Tokens in ticks of 64 ns.
        let tokens = |bytes: u64| {
            let ticks = u128::from(self.burst) * 1_000_000_000 / 64 / u128::from(bytes.max(1));
            u32::try_from(ticks).unwrap_or(u32::MAX)
        };
        // Buffers, quantum in bytes, level, priority.
        let rest = [tokens(rate), tokens(ceiling), self.quantum, 0, 0].map(u32::to_ne_bytes).concat();
        w.text(KIND, "htb").with(OPTIONS, |w| {
            w.bytes(1, &[ratespec(rate), ratespec(ceiling), rest].concat()).u64(6, rate).u64(7, ceiling);
        });
    }
}

impl fmt::Display for Request {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let verb = match self.verb {
            Verb::Add => "add",
            Verb::Change => "change",
            Verb::Delete => "delete",
        };
        let dev = &self.interface.1;
        let describe = self.verb != Verb::Delete;
        match &self.object {
            Object::Discipline { parent, handle, discipline } => {
                let place = match *parent {
                    Handle::ROOT | Handle::INGRESS => parent.to_string(),
                    parent => format!("parent {parent}"),
                };
                write!(f, "tc qdisc {verb} dev {dev} {place} handle {handle}")?;
                match discipline {
                    Discipline::Netem { netem, .. } if describe => write!(f, " {netem}"),
                    Discipline::Ingress => Ok(()),
                    Discipline::Htb { default: 0 } if describe => f.write_str(" htb"),
                    Discipline::Htb { default } if describe => write!(f, " htb default {default:x}"),
                    Discipline::Foreign { kind, .. } => write!(f, " {kind}"),
                    _ => Ok(()),
                }
            }
            Object::Class { number, shape, .. } => {
                let (parent, class) = (shape.parent, Handle::class(*number));
                write!(f, "tc class {verb} dev {dev} parent {parent} classid {class}")?;
                match shape {
                    _ if !describe => Ok(()),
                    &Shape::OPEN => f.write_str(" htb rate 1tbit"),
                    Shape { rate_bps, ceiling_bps, quantum, burst, .. } => write!(
                        f,
                        " htb rate {rate_bps}bit ceil {ceiling_bps}bit quantum {quantum} burst {burst}b cburst {burst}b"
                    ),
                }
            }
            Object::Filter { parent, filter } => {
                let protocol = match filter.protocol() {
                    0x0800 => "ip",
                    0x86dd => "ipv6",
                    _ => "all",
                };
                let parent = if *parent == Handle::ARRIVING { Handle::INGRESS_DISCIPLINE } else { *parent };
                write!(
                    f,
                    "tc filter {verb} dev {dev} parent {parent} protocol {protocol} pref {}",
                    filter.priority
                )?;
                if !describe {
                    return Ok(());
                }
                match filter.packets {
                    Packets::Network(field, network) => {
                        let ip = if protocol == "ip" { "ip" } else { "ip6" };
                        let field = if field == Field::Source { "src" } else { "dst" };
                        write!(f, " u32 match {ip} {field} {}/{}", network.address(), network.prefix())?;
                    }
                    Packets::Frames { .. } => {
                        f.write_str(" u32")?;
                        for (mask, value, offset) in filter.keys() {
                            let [mask, value] = [mask, value].map(u32::from_be_bytes);
                            write!(f, " match u32 {value:#010x} {mask:#010x} at {}", offset as i32)?;
                        }
                    }
                    Packets::All => f.write_str(" u32 match u32 0 0")?,
                }
                match filter.verdict {
                    Verdict::Class(class) => write!(f, " flowid {class}"),
                    Verdict::Redirect(index) => write!(f, " action mirred egress redirect index {index}"),
                }
            }
            Object::Ifb => match self.verb {
                Verb::Delete => write!(f, "ip link delete {dev}"),
                _ => write!(f, "ip link {verb} {dev} type ifb && ip link set {dev} up"),
            },
        }
    }
}

impl fmt::Display for Netem {
    /// Writes the options of a `tc qdisc` command.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let percent = |p: cotorra_graph::Probability| format!("{}%", p.get() * 100.0);
        let time = |d: std::time::Duration| format!("{}ms", d.as_secs_f64() * 1e3);
        write!(f, "netem limit {}", self.limit())?;
        match &self.jitter {
            Some(jitter) => {
                write!(f, " delay {} {}", time(self.delay), time(jitter.deviation))?;
                if let Some(distribution) = jitter.distribution {
                    write!(f, " distribution {}", distribution.name())?;
                }
            }
            None => write!(f, " delay {}", time(self.delay))?,
        }
        match self.loss {
            Loss::None => {}
            Loss::Independent { rate } => write!(f, " loss {}", percent(rate))?,
            Loss::GilbertElliott { to_bad, to_good, lost_in_bad, lost_in_good } => {
                let [p, r, bad, good] = [to_bad, to_good, lost_in_bad, lost_in_good].map(percent);
                write!(f, " loss gemodel {p} {r} {bad} {good}")?;
            }
        }
        for (word, share) in
            [("duplicate", self.duplication), ("corrupt", self.corruption), ("reorder", self.reordering)]
        {
            if share.get() > 0.0 {
                write!(f, " {word} {}", percent(share))?;
            }
        }
        match self.rate {
            Some(rate) => write!(f, " rate {}bit", rate.bits_per_second())?,
            None if self.in_order => f.write_str(" rate 8796093022208bit")?,
            None => {}
        }
        if let Some(seed) = self.seed {
            write!(f, " seed {seed}")?;
        }
        Ok(())
    }
}
