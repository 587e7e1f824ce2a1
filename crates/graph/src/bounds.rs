//! Bounds of what instructions hold. An instruction is checked wherever it is read, so that nobody can give one that takes
//! much memory.

use std::{mem::size_of, path::Path};

use crate::{
    access::AccessPoint,
    conditions::{ConditionChange, Rate, TraceName},
    container::Image,
    event::{Decision, Event, Instruction, VnfEvent},
    goal::GoalEvent,
    id::{ComponentId, LinkId},
    nodes::Nodes,
    sensor::SensorKind,
    service::{Granted, Program, Rights, Vnf},
};

/// A text or list of an instruction is too long.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("its `{what}` has {given} {unit}: at most {most} are taken")]
pub struct TooLong {
    what: &'static str,
    given: usize,
    unit: &'static str,
    most: usize,
}

/// Counts the bytes of texts and lists, and rejects those beyond their bounds.
#[derive(Default)]
struct Meter {
    bytes: usize,
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
        check(what, path.as_os_str().len(), "bytes", Instruction::LONGEST_PATH)
    }

    fn list<T>(&mut self, what: &'static str, list: &[T], most: usize) -> Result<(), TooLong> {
        self.bytes += size_of_val(list);
        check(what, list.len(), "items", most)
    }

    fn nodes(&mut self, nodes: &Nodes) {
        nodes.all().iter().for_each(|node| self.name(node.as_str()));
    }

    fn links(&mut self, links: &[LinkId]) -> Result<(), TooLong> {
        self.list("links", links, Instruction::MOST_LINKS)?;
        links.iter().for_each(|link| self.name(link.as_str()));
        Ok(())
    }

    fn words(&mut self, what: &'static str, words: &[String]) -> Result<(), TooLong> {
        self.list(what, words, Instruction::MOST_WORDS)?;
        words.iter().try_for_each(|word| self.text(what, word, Instruction::LONGEST))
    }

    fn access_point(&mut self, access_point: &AccessPoint) -> Result<(), TooLong> {
        let AccessPoint { ssid, mobility_domain, key: _, core } = access_point;
        fixed(mobility_domain);
        fixed(core);
        self.text("ssid", ssid, AccessPoint::LONGEST_SSID)
    }

    fn change(&mut self, change: &ConditionChange) -> Result<(), TooLong> {
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
        } = change;
        fixed(&(delay_ms, jitter, loss, duplication, corruption, reordering));
        fixed(&(queue, queue_discipline, delay_scale, drop_scale));
        match rate {
            None | Some(Rate::Unlimited | Rate::Fixed { .. }) => Ok(()),
            Some(Rate::Trace { trace }) => {
                self.list("trace_ms", trace.opportunities_ms(), Instruction::MOST_OPPORTUNITIES)
            }
            Some(Rate::NamedTrace(name)) => {
                let TraceName { file, sha256, opportunities, period_ms } = &**name;
                fixed(&(opportunities, period_ms));
                file.iter().try_for_each(|file| self.text("file", file, Instruction::LONGEST_PATH))?;
                self.text("sha256", sha256, 64)
            }
        }
    }

    fn vnf(&mut self, vnf: &Vnf) -> Result<(), TooLong> {
        let Vnf { id, program, cpus, memory_bytes, pinned_to, node, env, rights, keep, image } = vnf;
        fixed(&(cpus, memory_bytes, keep));
        self.name(id.as_str());
        pinned_to.iter().for_each(|node| self.name(node.as_str()));
        self.nodes(node);
        match program {
            Program::RobotDriver | Program::Navigation | Program::Localization => {}
            Program::Command(words) | Program::Host(words) => self.words("command", words)?,
        }
        self.words("env", env)?;
        match rights {
            Rights::Trusted => {}
            Rights::Confined(Granted { capabilities, readable }) => {
                self.list("capabilities", capabilities, Instruction::MOST_WORDS)?;
                self.list("readable", readable, Instruction::MOST_WORDS)?;
                readable.iter().try_for_each(|path| self.path("readable", path))?;
            }
        }
        let Some(image) = image else { return Ok(()) };
        let Image { reference, pull, volumes, devices, ports, init, start, processing } = &**image;
        fixed(&(pull, init, start, processing));
        self.text("reference", reference, Instruction::LONGEST_PATH)?;
        self.list("volumes", volumes, Instruction::MOST_WORDS)?;
        for volume in volumes {
            self.path("volumes", &volume.source)?;
            self.path("volumes", &volume.target)?;
        }
        self.list("devices", devices, Instruction::MOST_WORDS)?;
        devices.iter().try_for_each(|path| self.path("devices", path))?;
        self.list("ports", ports, Instruction::MOST_WORDS)
    }
}

fn check(what: &'static str, given: usize, unit: &'static str, most: usize) -> Result<(), TooLong> {
    if given <= most { Ok(()) } else { Err(TooLong { what, given, unit, most }) }
}

/// Does not compile for a value that owns memory beyond its size, and so needs a bound.
fn fixed<T: Copy>(_: &T) {}

impl AccessPoint {
    /// The most bytes of an SSID (IEEE 802.11-2020, 9.4.2.2).
    pub const LONGEST_SSID: usize = 32;
}

impl Instruction {
    /// The most bytes of all texts and lists of an instruction together.
    pub const LONGEST: usize = 80 * 1024;
    /// The most bytes of the reason that is given with an instruction.
    pub const LONGEST_REASON: usize = 1024;
    /// The most characters of a name in a note.
    pub const LONGEST_NAME: usize = 128;
    /// The most bytes of a path.
    pub const LONGEST_PATH: usize = 4096;
    /// The most links of a mapping.
    pub const MOST_LINKS: usize = 256;
    /// The most delivery opportunities of a trace.
    pub const MOST_OPPORTUNITIES: usize = 8192;
    /// The most words of a command, variables, paths and ports of a VNF that is added, of each.
    pub const MOST_WORDS: usize = 256;

    /// Returns the bytes of all its texts and lists.
    ///
    /// # Errors
    /// [`TooLong`] if one of them is beyond its bound, or all together are.
    pub fn measure(&self) -> Result<usize, TooLong> {
        // Variants and fields are all named, so that a new one does not compile without a bound.
        let mut meter = Meter::default();
        match self {
            Self::Move { robot, velocity, waypoint } => {
                fixed(&(velocity, waypoint));
                meter.name(robot.as_str());
            }
            Self::LimitSpeed { robot, speed_limit_mps } => {
                fixed(speed_limit_mps);
                meter.name(robot.as_str());
            }
            Self::NavigateTo { robot, goal } => {
                fixed(goal);
                meter.name(robot.as_str());
            }
            Self::Report { robot, sensor, values } => {
                meter.name(robot.as_str());
                meter.name(sensor.as_str());
                meter.list("values", values, SensorKind::LARGEST.into())?;
            }
            Self::Scan { robot } | Self::Halt { robot } | Self::Go { robot } => meter.name(robot.as_str()),
            Self::Attach { robot, radio_unit } | Self::Suggest { robot, radio_unit } => {
                meter.name(robot.as_str());
                meter.name(radio_unit.as_str());
            }
            Self::Place { vnf, node } => {
                meter.name(vnf.as_str());
                meter.nodes(node);
            }
            Self::AddVnf { vnf } => meter.vnf(vnf)?,
            Self::RemoveVnf { vnf } => meter.name(vnf.as_str()),
            Self::Map { from, to, links } => {
                meter.name(from.as_str());
                meter.name(to.as_str());
                meter.links(links)?;
            }
            Self::Condition { link, direction, change } => {
                fixed(direction);
                meter.name(link.as_str());
                meter.change(change)?;
            }
            Self::Deploy { radio_unit, access_point } => {
                meter.name(radio_unit.as_str());
                meter.access_point(access_point)?;
            }
            Self::Remove { radio_unit } => meter.name(radio_unit.as_str()),
            Self::Provision { robot, radio_unit, access_point } => {
                meter.name(robot.as_str());
                meter.name(radio_unit.as_str());
                meter.access_point(access_point)?;
            }
            Self::Note { process, step, ago } => {
                fixed(ago);
                // A character has at most four bytes.
                meter.text("process", process, 4 * Self::LONGEST_NAME)?;
                meter.text("step", step, 4 * Self::LONGEST_NAME)?;
            }
            Self::TestThroughput { link, direction, test } => {
                fixed(&(direction, test));
                meter.name(link.as_str());
            }
        }
        check("instruction", meter.bytes, "bytes", Self::LONGEST)?;
        Ok(meter.bytes)
    }
}

impl Decision {
    /// Returns the bytes of all its texts and lists.
    fn bytes(&self) -> usize {
        let Self { plugin, instruction, reason, refused } = self;
        // What is beyond a bound was never applied, and is counted as the most.
        let instruction = instruction.measure().unwrap_or(Instruction::LONGEST);
        let texts = [reason, refused].into_iter().flatten().map(String::len).sum::<usize>();
        plugin.as_str().len() + instruction + texts
    }
}

impl Event {
    /// Returns the bytes that it holds in memory: its own, and those of its texts and lists. Names count as nothing, because
    /// events share them.
    pub fn bytes(&self) -> usize {
        let text = |text: &Option<String>| text.as_ref().map_or(0, String::len);
        let beyond = match self {
            Self::Robot(robot) => size_of_val(&robot.attachments[..]) + size_of_val(&robot.health[..]),
            Self::Radio(radio) => size_of_val(&radio.stations[..]),
            Self::VirtualLink(link) => {
                let others = link.others.iter().map(|other| size_of_val(&other.links[..]));
                size_of_val(&link.links[..]) + size_of_val(&link.others[..]) + others.sum::<usize>()
            }
            Self::Placement(placement) => size_of_val(placement.node.all()),
            Self::ServiceTime(sample) => {
                let parts = |parts: &crate::TimeParts| size_of_val(parts) + size_of_val(&parts.links[..]);
                sample.parts.as_deref().map_or(0, parts) + sample.lost_at.as_deref().map_or(0, size_of_val)
            }
            Self::Vnf(VnfEvent { vnf: _, node: _, state: _, detail }) => text(detail),
            Self::Decision(decision) => decision.bytes(),
            Self::PluginFault { plugin: _, reason } => reason.len(),
            Self::Goal(GoalEvent { robot: _, goal: _, state: _, remaining_m: _, reason }) => text(reason),
            Self::Sensor(reading) => reading.values.len() * size_of::<(ComponentId, f64)>(),
            Self::Machine(machine) => {
                let interfaces = machine.interfaces.iter().map(|of| size_of_val(of) + of.name.len());
                let wifi = machine.wifi.iter().map(|of| {
                    let stations = of.stations.iter().map(|of| size_of_val(of) + of.mac.len());
                    let texts = of.interface.len() + text(&of.ssid);
                    size_of_val(of) + texts + size_of_val(&of.channels[..]) + stations.sum::<usize>()
                });
                interfaces.sum::<usize>() + wifi.sum::<usize>()
            }
            Self::Notice { message } => message.len(),
            Self::Link(_)
            | Self::AnswersRejected(_)
            | Self::Handover(_)
            | Self::Detached { .. }
            | Self::Scanned { .. }
            | Self::SuggestionAnswered { .. }
            | Self::Lateness(_)
            | Self::WalkFinished { .. } => 0,
        };
        size_of::<Self>() + beyond
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::id::NodeId;

    #[test]
    fn an_instruction_beyond_a_bound_cannot_be_read() {
        let deploy = |bytes: usize| {
            let json = serde_json::json!({
                "instruction": "deploy", "radio_unit": "R",
                "access_point": { "ssid": "s".repeat(bytes), "mobility_domain": 1 },
            });
            serde_json::from_value::<Instruction>(json).map_err(|error| error.to_string())
        };
        assert!(deploy(32).is_ok());
        assert_eq!(deploy(33).unwrap_err(), "its `ssid` has 33 bytes: at most 32 are taken");
    }

    #[test]
    fn all_texts_of_an_instruction_together_have_a_bound() {
        let links = vec![LinkId::new(&"l".repeat(LinkId::LONGEST)).unwrap(); Instruction::MOST_LINKS];
        let node = || NodeId::new(&"n".repeat(NodeId::LONGEST)).unwrap();
        let longest = Instruction::Map { from: node(), to: node(), links };
        let bytes = longest.measure().unwrap();
        assert!(bytes > 256 * LinkId::LONGEST && bytes < Instruction::LONGEST, "{bytes}");
        let words = |words: usize| {
            let mut json = serde_json::json!({
                "instruction": "add_vnf", "vnf": {
                    "id": "v", "program": { "command": [] }, "cpus": 1.0, "memory_bytes": 1, "node": "n"
                },
            });
            json["vnf"]["program"]["command"] = vec!["w".repeat(1000); words].into();
            serde_json::from_value::<Instruction>(json).map_err(|error| error.to_string())
        };
        assert!(words(70).is_ok());
        let refused = words(90).unwrap_err();
        assert!(refused.contains("its `instruction` has 92"), "{refused}");
    }
}
