//! A testbed of a robot near one or two radio units, with its navigation at a server.

use std::fmt::{self, Display, Formatter};

/// The parts that differ. Displayed, it is the text of a testbed file.
///
/// With the default, a service time is 8 ms and the time that frames take, and 15 ms are allowed.
pub struct Lab<'a> {
    /// Deviation of shadowing, dB. Without one, the seed changes nothing.
    pub shadowing_db: u8,
    pub roaming: &'a str,
    /// Place of the radio unit `B` on the x axis, m; `A` is at 0.
    pub b: Option<u8>,
    /// Ends of links with their delays. `lan` is a switch.
    pub links: &'a [(&'a str, &'a str)],
    pub walk: &'a str,
    /// Lines behind these.
    pub rest: &'a str,
}

impl Default for Lab<'_> {
    fn default() -> Self {
        Self {
            shadowing_db: 0,
            roaming: "signal",
            b: Some(9),
            links: &[("lan, [A, B]", "1 ms"), ("lan, edge", "2 ms")],
            walk: "{ waypoints: [[0, 0], [3, 0]], speed_limit: 0.5 m/s, position_interval: 50 ms }",
            rest: "",
        }
    }
}

impl Lab<'_> {
    /// Returns a testbed with one radio unit, a plug-in that is the program `mine.py`, and a bundled one that is off.
    pub fn with_program() -> String {
        let lab = Self {
            b: None,
            links: &[("A, edge", "2 ms")],
            walk: "{ waypoints: [[0, 0], [2, 0]], speed_limit: 0.5 m/s, position_interval: 50 ms }",
            rest: "plugins:
  - { bundled: probing, enabled: false }
  - { id: mine, command: [python3, mine.py] }
",
            ..Self::default()
        };
        lab.to_string()
    }
}

impl Display for Lab<'_> {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let Self { shadowing_db, roaming, b, links, walk, rest } = self;
        writeln!(
            f,
            "name: lab
wireless: {{ w: {{ delay: 1 ms, fast_transition: true, shadowing: {{ deviation: {shadowing_db} dB }} }} }}
nodes:
  robot: {{ kind: robot, roaming: {roaming} }}
  A: {{ kind: radio_unit, position: [0, 1], channel: 1 }}"
        )?;
        if let Some(x) = b {
            writeln!(f, "  B: {{ kind: radio_unit, position: [{x}, 1], channel: 6 }}")?;
        }
        if links.iter().any(|(ends, _)| ends.contains("lan")) {
            writeln!(f, "  lan: {{ kind: switch }}")?;
        }
        writeln!(f, "  edge: {{ kind: server, tier: edge, cpus: 4, memory: 8 GB }}\nlinks:")?;
        for (ends, delay) in *links {
            writeln!(f, "  - {{ ends: [{ends}], delay: {delay} }}")?;
        }
        write!(
            f,
            "services:
  navigation:
    robot: robot
    kpis: {{ service_time: 15 ms }}
    vnfs:
      driver: {{ program: robot_driver, pinned_to: robot }}
      navigation: {{ program: navigation, node: edge }}
walks:
  robot: {walk}
{rest}"
        )
    }
}

/// A plug-in that sets the delay of the link of [`Lab::with_program`] to `AMOUNT_MS`.
pub const SETS_DELAY: &str = "import json, os
from urllib import request
HEADERS = {'Content-Type': 'application/json', 'Authorization': 'Bearer ' + os.environ['COTORRA_TOKEN']}
def ask(path, body=None):
    data = None if body is None else json.dumps(body).encode()
    return request.urlopen(request.Request(os.environ['COTORRA_API'] + '/api/v1/' + path, data, HEADERS))
first = True
for line in ask('events?kinds=robot'):
    if line.startswith(b'id: '):
        if first:
            change = {'instruction': 'condition', 'link': 'A-edge', 'change': {'delay_ms': AMOUNT_MS}}
            ask('instructions', {'instruction': change, 'reason': ''})
        first = False
        ask('marks/%d' % int(line[4:]), {})
";
