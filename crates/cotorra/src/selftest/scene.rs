//! A scene, and the room that most scenes are variants of.

use std::{
    fmt::Write as _,
    fs, io,
    path::{Path, PathBuf},
};

use super::{check::Check, observed::Observed};

/// A small testbed, and what is known about it without running it.
#[derive(Debug, Clone)]
pub struct Scene {
    /// Its name on the command line.
    pub name: &'static str,
    /// Its purpose, in a sentence.
    pub promise: &'static str,
    /// The testbed file.
    pub testbed: String,
    /// Further files by name, with their contents.
    pub files: &'static [(&'static str, &'static str)],
    /// Duration with real packets, s.
    pub seconds: u32,
    /// Duration in virtual time, s; `None` if virtual time lacks what it shows.
    pub virtual_seconds: Option<u32>,
    /// The failure that a run of it must have.
    pub dies: Dies,
    /// Compares what a run left with what is right.
    pub check: fn(&Observed) -> Vec<Check>,
}

/// The end that a run must have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Dies {
    /// In order.
    Not,
    /// Its figures are void.
    Void,
    /// The same, because its process is stopped for a while.
    Stopped,
    /// It keeps less than the file demands.
    Missed,
    /// In order, or void: no figure depends on how late packets were.
    EitherWay,
}

impl Scene {
    /// A scene without contents.
    pub const DEFAULT: Self = Self {
        name: "",
        promise: "",
        testbed: String::new(),
        files: &[],
        seconds: 8,
        virtual_seconds: Some(60),
        dies: Dies::Not,
        check: |_| Vec::new(),
    };

    /// Whether other runs would disturb it, or it them.
    pub fn is_alone(&self) -> bool {
        matches!(self.dies, Dies::Stopped | Dies::EitherWay)
    }

    /// Writes its files into a folder. Returns the path of the testbed file.
    ///
    /// # Errors
    /// Errors of [`fs::write`].
    pub fn write(&self, folder: &Path) -> io::Result<PathBuf> {
        for (name, text) in self.files {
            fs::write(folder.join(name), text)?;
        }
        let file = folder.join(format!("{}.yaml", self.name));
        fs::write(&file, &self.testbed)?;
        Ok(file)
    }
}

/// A robot beside a radio unit, which a server behind a switch navigates.
#[derive(Debug, Clone)]
pub struct Room {
    wireless: String,
    access: String,
    links: Vec<String>,
    nodes: Vec<String>,
    roaming: &'static str,
    kept: &'static str,
    interval: String,
    speed: &'static str,
    navigation: &'static str,
    requests: &'static str,
    rest: String,
}

impl Room {
    /// Creates a room. The link to the server has these keys.
    pub fn new(link: &str) -> Self {
        Self {
            wireless: String::new(),
            access: String::new(),
            links: vec![format!("{{ ends: [lan, edge], {link} }}")],
            nodes: Vec::new(),
            roaming: "instructed",
            kept: "",
            interval: "20 ms".to_owned(),
            speed: "0.01 m/s",
            navigation: "edge",
            requests: "one",
            rest: String::new(),
        }
    }

    /// Adds keys to the wireless network.
    pub fn wireless(self, keys: &str) -> Self {
        Self { wireless: format!(", {keys}"), ..self }
    }

    /// Adds keys to the link of the radio unit.
    pub fn access(self, keys: &str) -> Self {
        Self { access: format!(", {keys}"), ..self }
    }

    /// Adds a node.
    pub fn node(mut self, node: &str) -> Self {
        self.nodes.push(node.to_owned());
        self
    }

    /// Adds a link.
    pub fn link(mut self, link: &str) -> Self {
        self.links.push(link.to_owned());
        self
    }

    /// Adds a radio unit, and its link.
    pub fn unit(self, unit: &str, name: &str) -> Self {
        self.node(unit).link(&format!("{{ ends: [{name}, lan] }}"))
    }

    pub fn roaming(self, roaming: &'static str) -> Self {
        Self { roaming, ..self }
    }

    pub fn speed(self, speed: &'static str) -> Self {
        Self { speed, ..self }
    }

    /// Sets the interval of position packets.
    pub fn every(self, interval: &str) -> Self {
        Self { interval: interval.to_owned(), ..self }
    }

    /// Demands a share of samples.
    pub fn kept(self, kept: &'static str) -> Self {
        Self { kept, ..self }
    }

    /// Sends each packet to all of these nodes.
    pub fn requests_to_all(self, nodes: &'static str) -> Self {
        Self { navigation: nodes, requests: "all", ..self }
    }

    /// Adds keys at the top.
    pub fn with(mut self, keys: &str) -> Self {
        self.rest += keys;
        self
    }

    /// Returns the testbed file.
    pub fn text(&self) -> String {
        let Self {
            wireless,
            access,
            links,
            nodes,
            roaming,
            kept,
            interval,
            speed,
            navigation,
            requests,
            rest,
        } = self;
        let kept = if kept.is_empty() { String::new() } else { format!(", kept: {kept}") };
        let mut text = format!(
            "name: selftest
wireless:
  lab: {{ delay: 1 ms, shadowing: {{ deviation: 0 dB, correlation: 5 m }}{wireless} }}
nodes:
  robot: {{ kind: robot, position: [1, 0], roaming: {roaming} }}
  unit: {{ kind: radio_unit, position: [0, 0], channel: 1 }}
  lan: {{ kind: switch }}
  edge: {{ kind: server, tier: edge, cpus: 1, memory: 1 GB }}
"
        );
        for node in nodes {
            writeln!(text, "  {node}").expect("writing into a string cannot fail");
        }
        write!(text, "links:\n  - {{ ends: [unit, lan]{access} }}\n")
            .expect("writing into a string cannot fail");
        for link in links {
            writeln!(text, "  - {link}").expect("writing into a string cannot fail");
        }
        text + &format!(
            "services:
  navigation:
    robot: robot
    kpis: {{ service_time: 50 ms{kept} }}
    requests: {requests}
    vnfs:
      driver: {{ program: robot_driver, pinned_to: robot, cpus: 0 }}
      navigation: {{ program: navigation, node: {navigation}, memory: 64 MB }}
    virtual_links: [{{ from: driver, to: navigation, rate: 0.1 Mbit/s }}]
walks:
  robot: {{ waypoints: [[1, 0], [60, 0]], speed_limit: {speed}, position_interval: {interval} }}
{rest}"
        )
    }
}
