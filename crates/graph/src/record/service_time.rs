//! Service times, with the rows of their parts in the order of the way.

use std::{sync::Arc, time::Duration};

use super::{Columns, Fields, Reader, Record, Source, Table, Unreadable, Value, required, unreadable};
use crate::{
    context::ServiceTime,
    id::LinkId,
    time_parts::{LinkTime, TimeParts},
    units::Timestamp,
};

const SENDER: &str = "sender";
const VNF: &str = "vnf";
const RECEIVER: &str = "receiver";
const UNKNOWN: &str = "unknown";

/// A part of a service time.
#[derive(Debug)]
pub enum PartOfTime<'a> {
    /// A part that is no link.
    Host(&'static str, Duration),
    /// The time on a link.
    Link(&'a LinkTime),
}

impl PartOfTime<'_> {
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

impl TimeParts {
    /// Returns the parts in the order of the way. Parts that took no time are left out, except for the VNF, which separates
    /// both ways.
    pub fn rows(&self) -> impl Iterator<Item = PartOfTime<'_>> {
        let links = |back| self.links.iter().filter(move |on| on.back == back).map(PartOfTime::Link);
        let host = |name, took: Duration| {
            Some(PartOfTime::Host(name, took)).filter(|_| name == VNF || !took.is_zero())
        };
        host(SENDER, self.sender)
            .into_iter()
            .chain(links(false))
            .chain(host(VNF, self.vnf))
            .chain(links(true))
            .chain(host(RECEIVER, self.receiver))
            .chain(host(UNKNOWN, self.unknown))
    }

    /// Sets the part of a name that is no link. Returns whether there is one.
    fn set_host(&mut self, name: &str, took: Duration) -> bool {
        let part = match name {
            SENDER => &mut self.sender,
            VNF => &mut self.vnf,
            RECEIVER => &mut self.receiver,
            UNKNOWN => &mut self.unknown,
            _ => return false,
        };
        *part = took;
        true
    }
}

impl Record for ServiceTime {
    #[rustfmt::skip]
    const TABLE: Table = Table {
        columns: &[
            "service", "robot", "sequence", "emitted_ns", "service_time_ms", "attachment", "server", "lost_at",
        ],
        series: &[],
        children: Some(("time_part", &["part", "direction", "total_ms", "queueing_ms", "retries_ms"])),
    };

    fn put<'a>(&'a self, _: Timestamp, row: &mut Fields<'a>, children: &mut Fields<'a>) {
        self.service.put(row);
        self.robot.put(row);
        self.sequence.put(row);
        self.emitted.put(row);
        self.took.put(row);
        self.attachment.put(row);
        self.server.put(row);
        row.json(self.lost_at.as_ref());
        let duration = |took: Duration| Value::Real(crate::millis::of(took));
        let some = |took: Duration| if took.is_zero() { Value::Null } else { duration(took) };
        for part in self.parts.iter().flat_map(|parts| parts.rows()) {
            children.0.extend(match part {
                PartOfTime::Host(name, took) => {
                    [Value::Name(name), Value::Null, duration(took), Value::Null, Value::Null]
                }
                PartOfTime::Link(on) => [
                    Value::Name(on.link.as_str()),
                    Value::Integer(super::code(on.direction)),
                    duration(on.total()),
                    some(on.queueing),
                    some(on.retries),
                ],
            });
        }
    }

    fn take<E: From<Unreadable>>(_: Timestamp, source: &mut dyn Source<E>) -> Result<Self, E> {
        let mut row = Reader(source);
        let mut sample = Self {
            service: row.take()?,
            robot: row.take()?,
            sequence: row.take()?,
            emitted: row.take()?,
            took: row.take()?,
            attachment: row.take()?,
            server: row.take()?,
            lost_at: row.json()?,
            parts: None,
        };
        sample.parts = take_parts(source)?;
        Ok(sample)
    }

    fn bytes(&self) -> usize {
        let parts = |parts: &TimeParts| size_of_val(parts) + size_of_val(&parts.links[..]);
        self.parts.as_deref().map_or(0, parts) + self.lost_at.as_deref().map_or(0, size_of_val)
    }
}

/// Reads the parts of a service time; `None` without any.
fn take_parts<E: From<Unreadable>>(source: &mut dyn Source<E>) -> Result<Option<Box<TimeParts>>, E> {
    let mut parts: Option<Box<TimeParts>> = None;
    let mut back = false;
    source.children(&mut |child| {
        let mut row = Reader(child);
        let parts = parts.get_or_insert_default();
        let part: Arc<str> = required(row.0.name()?)?;
        let (direction, total): (_, Duration) = (row.take()?, row.take()?);
        let (queueing, retries): (Option<Duration>, Option<Duration>) = (row.take()?, row.take()?);
        let [queueing, retries] = [queueing, retries].map(Option::unwrap_or_default);
        let Some(direction) = direction else {
            // The way back begins behind the VNF.
            back |= &*part == VNF;
            let is_known = parts.set_host(&part, total);
            let error = || unreadable(format_args!("`{part}` is not a part of a service time"));
            return is_known.then_some(()).ok_or_else(error);
        };
        let crossing = total.checked_sub(queueing).and_then(|left| left.checked_sub(retries));
        let crossing = crossing.ok_or_else(|| unreadable("the parts of a link's time exceed it"))?;
        let link = part.parse::<LinkId>().map_err(unreadable)?;
        parts.links.push(LinkTime { link, direction, back, queueing, retries, crossing });
        Ok(())
    })?;
    Ok(parts)
}
