//! Bounds of what instructions hold. An instruction is checked wherever it is read, so that no caller can give one that takes
//! much memory.

use std::{path::Path, time::Duration};

use crate::{
    access::AccessPoint,
    active::ThroughputTest,
    computing::{Computing, Demand},
    conditions::{ConditionChange, Loss, Rate, TraceName},
    container::Image,
    context::Velocity,
    hardware::Direction,
    id::{LinkId, NodeId, SensorId, VnfId},
    nodes::Nodes,
    reservation::MapReservation,
    sensor::SensorKind,
    service::{Granted, Program, Rights, Vnf},
    units::Position,
};

/// The most bytes of all texts and lists of an instruction together.
pub(crate) const LONGEST: usize = 80 * 1024;
/// The most characters of a name in a note.
pub(crate) const LONGEST_NAME: usize = 128;
/// The most bytes of a path.
pub(crate) const LONGEST_PATH: usize = 4096;
/// The most links of a mapping.
pub(crate) const MOST_LINKS: usize = 256;
/// The most delivery opportunities of a trace.
pub(crate) const MOST_OPPORTUNITIES: usize = 8192;
/// The most words of a command, variables, paths and ports of a VNF that is added, of each.
pub(crate) const MOST_WORDS: usize = 256;

/// A text or list of an instruction is too long.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("its `{what}` has {given} {unit}: at most {most} are taken")]
pub struct TooLong {
    what: &'static str,
    given: usize,
    unit: &'static str,
    most: usize,
}

/// A field of an instruction. It has a bound if it owns memory.
pub(crate) trait Bounded {
    /// Counts the bytes of its texts and lists. `what` is the field's name.
    fn count(&self, what: &'static str, meter: &mut Meter) -> Result<(), TooLong>;

    /// Whether its figures are finite, as far as they are kept as JSON.
    fn survives_json(&self) -> bool {
        true
    }
}

/// Counts the bytes of texts and lists, and rejects those beyond their bounds.
#[derive(Default)]
pub(crate) struct Meter {
    pub(crate) bytes: usize,
}

impl Meter {
    /// Counts a name, whose type bounds its length.
    fn name(&mut self, name: &str) {
        self.bytes += name.len();
    }

    fn text(&mut self, what: &'static str, text: &str, most: usize) -> Result<(), TooLong> {
        self.bytes += text.len();
        check(what, text.len(), "bytes", most)
    }

    fn path(&mut self, what: &'static str, path: &Path) -> Result<(), TooLong> {
        self.bytes += path.as_os_str().len();
        check(what, path.as_os_str().len(), "bytes", LONGEST_PATH)
    }

    fn list<T>(&mut self, what: &'static str, list: &[T], most: usize) -> Result<(), TooLong> {
        self.bytes += size_of_val(list);
        check(what, list.len(), "items", most)
    }

    fn nodes(&mut self, nodes: &Nodes) {
        nodes.all().iter().for_each(|node| self.name(node.as_str()));
    }

    fn words(&mut self, what: &'static str, words: &[String]) -> Result<(), TooLong> {
        self.list(what, words, MOST_WORDS)?;
        words.iter().try_for_each(|word| self.text(what, word, LONGEST))
    }
}

macro_rules! names {
    ($($id:ident)*) => { $(
        impl Bounded for $id {
            fn count(&self, _: &'static str, meter: &mut Meter) -> Result<(), TooLong> {
                meter.name(self.as_str());
                Ok(())
            }
        }
    )* };
}
names!(LinkId NodeId SensorId VnfId);

/// For values of a fixed size.
macro_rules! fixed {
    ($($type:ty $(: $survives_json:expr)?;)*) => { $(
        impl Bounded for $type {
            fn count(&self, _: &'static str, _: &mut Meter) -> Result<(), TooLong> {
                fixed(self);
                Ok(())
            }
            $(
                fn survives_json(&self) -> bool {
                    let survives_json: fn($type) -> bool = $survives_json;
                    survives_json(*self)
                }
            )?
        }
    )* };
}
fixed! {
    u32;
    Direction;
    Option<Direction>;
    Option<Duration>;
    ThroughputTest;
    Option<MapReservation>;
    // A velocity is not kept as JSON.
    Velocity;
    Option<f64>: |figure| figure.is_none_or(f64::is_finite);
    Option<Position>: |goal| goal.is_none_or(|Position { x, y, z }| [x, y, z].into_iter().all(f64::is_finite));
}

/// The name of a process or of its step.
impl Bounded for String {
    fn count(&self, what: &'static str, meter: &mut Meter) -> Result<(), TooLong> {
        // A character has at most four bytes.
        meter.text(what, self, 4 * LONGEST_NAME)
    }
}

impl Bounded for Vec<f64> {
    fn count(&self, what: &'static str, meter: &mut Meter) -> Result<(), TooLong> {
        meter.list(what, self, SensorKind::LARGEST.into())
    }

    fn survives_json(&self) -> bool {
        self.iter().all(|figure| figure.is_finite())
    }
}

impl Bounded for Vec<LinkId> {
    fn count(&self, what: &'static str, meter: &mut Meter) -> Result<(), TooLong> {
        meter.list(what, self, MOST_LINKS)?;
        self.iter().for_each(|link| meter.name(link.as_str()));
        Ok(())
    }
}

impl Bounded for Nodes {
    fn count(&self, _: &'static str, meter: &mut Meter) -> Result<(), TooLong> {
        meter.nodes(self);
        Ok(())
    }
}

impl Bounded for AccessPoint {
    fn count(&self, _: &'static str, meter: &mut Meter) -> Result<(), TooLong> {
        let AccessPoint { ssid, mobility_domain, key: _, core } = self;
        fixed(mobility_domain);
        fixed(core);
        meter.text("ssid", ssid, AccessPoint::LONGEST_SSID)
    }
}

impl Bounded for ConditionChange {
    fn count(&self, _: &'static str, meter: &mut Meter) -> Result<(), TooLong> {
        let ConditionChange {
            delay_ms,
            jitter,
            loss,
            duplication,
            corruption,
            reordering,
            rate,
            queue,
            queue_discipline,
            delay_scale,
            drop_scale,
        } = self;
        fixed(&(delay_ms, jitter, loss, duplication, corruption, reordering));
        fixed(&(queue, queue_discipline, delay_scale, drop_scale));
        match rate {
            None | Some(Rate::Unlimited | Rate::Fixed { .. }) => Ok(()),
            Some(Rate::Trace { trace }) => {
                meter.list("trace_ms", trace.opportunities_ms(), MOST_OPPORTUNITIES)
            }
            Some(Rate::NamedTrace(name)) => {
                let TraceName { file, sha256, opportunities, period_ms } = &**name;
                fixed(&(opportunities, period_ms));
                file.iter().try_for_each(|file| meter.text("file", file, LONGEST_PATH))?;
                meter.text("sha256", sha256, 64)
            }
        }
    }

    fn survives_json(&self) -> bool {
        let burst = match self.loss {
            Some(Loss::Bursty { mean_burst, .. }) => Some(mean_burst),
            _ => None,
        };
        [self.delay_ms, self.delay_scale, self.drop_scale, burst].iter().all(Bounded::survives_json)
    }
}

impl Bounded for Box<Vnf> {
    fn count(&self, _: &'static str, meter: &mut Meter) -> Result<(), TooLong> {
        let Vnf {
            id,
            program,
            cpus,
            cpu_limit,
            memory_bytes,
            pinned_to,
            node,
            env,
            rights,
            keep,
            image,
            start,
            computing,
            state,
        } = &**self;
        fixed(&(cpus, cpu_limit, memory_bytes, keep, start, state.as_deref()));
        if let Some(Computing { demand, per_kb, scheduling, backlog, warm_up }) = computing.as_deref() {
            fixed(&(per_kb, scheduling, backlog, warm_up));
            if let Demand::Samples { samples } = demand {
                meter.list("demand", samples.times(), MOST_OPPORTUNITIES)?;
            }
        }
        meter.name(id.as_str());
        pinned_to.iter().for_each(|node| meter.name(node.as_str()));
        meter.nodes(node);
        match program {
            Program::RobotDriver | Program::Navigation | Program::Localization | Program::RosNavigation => {}
            Program::PolicyServer(server) => fixed(server),
            Program::Command(words) | Program::Host(words) => meter.words("command", words)?,
        }
        meter.words("env", env)?;
        match rights {
            Rights::Trusted => {}
            Rights::Confined(Granted { capabilities, readable }) => {
                meter.list("capabilities", capabilities, MOST_WORDS)?;
                meter.list("readable", readable, MOST_WORDS)?;
                readable.iter().try_for_each(|path| meter.path("readable", path))?;
            }
        }
        let Some(image) = image else { return Ok(()) };
        let Image { reference, pull, volumes, devices, ports, init, start, processing } = &**image;
        fixed(&(pull, init, start, processing));
        meter.text("reference", reference, LONGEST_PATH)?;
        meter.list("volumes", volumes, MOST_WORDS)?;
        for volume in volumes {
            meter.path("volumes", &volume.source)?;
            meter.path("volumes", &volume.target)?;
        }
        meter.list("devices", devices, MOST_WORDS)?;
        devices.iter().try_for_each(|path| meter.path("devices", path))?;
        meter.list("ports", ports, MOST_WORDS)
    }
}

pub(crate) fn check(
    what: &'static str,
    given: usize,
    unit: &'static str,
    most: usize,
) -> Result<(), TooLong> {
    if given <= most { Ok(()) } else { Err(TooLong { what, given, unit, most }) }
}

/// Does not compile for a value that owns memory beyond its size, and so needs a bound.
fn fixed<T: Copy>(_: &T) {}

impl AccessPoint {
    /// The most bytes of an SSID (IEEE 802.11-2020, 9.4.2.2).
    pub const LONGEST_SSID: usize = 32;
}
