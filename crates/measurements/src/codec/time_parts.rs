//! Rows of the parts of a service time, in the order of the way.

use std::time::Duration;

use cotorra_graph::{LinkTime, TimeParts};

const SENDER: &str = "sender";
const VNF: &str = "vnf";
const RECEIVER: &str = "receiver";
const UNKNOWN: &str = "unknown";

/// A row.
pub(crate) enum Row<'a> {
    /// A part that is no link.
    Host(&'static str, Duration),
    Link(&'a LinkTime),
}

impl Row<'_> {
    /// Returns the name of the part.
    pub fn name(&self) -> &str {
        match self {
            Self::Host(name, _) => name,
            Self::Link(on) => on.link.as_str(),
        }
    }

    /// Returns the time in the part.
    pub fn total(&self) -> Duration {
        match self {
            Self::Host(_, took) => *took,
            Self::Link(on) => on.total(),
        }
    }
}

/// Returns the rows of a sample. Parts that took no time are left out, except for the VNF, which separates both ways.
pub(crate) fn rows(parts: &TimeParts) -> impl Iterator<Item = Row<'_>> {
    let links = |back| parts.links.iter().filter(move |on| on.back == back).map(Row::Link);
    let host = |name, took: Duration| Some(Row::Host(name, took)).filter(|_| name == VNF || !took.is_zero());
    host(SENDER, parts.sender)
        .into_iter()
        .chain(links(false))
        .chain(host(VNF, parts.vnf))
        .chain(links(true))
        .chain(host(RECEIVER, parts.receiver))
        .chain(host(UNKNOWN, parts.unknown))
}

/// Sets the part of a name that is no link. Returns whether there is one.
pub(super) fn set_host(parts: &mut TimeParts, name: &str, took: Duration) -> bool {
    let part = match name {
        SENDER => &mut parts.sender,
        VNF => &mut parts.vnf,
        RECEIVER => &mut parts.receiver,
        UNKNOWN => &mut parts.unknown,
        _ => return false,
    };
    *part = took;
    true
}

/// Whether the way back begins behind this part.
pub(super) fn is_turn(name: &str) -> bool {
    name == VNF
}
