//! The node against Fast DDS.

use cotorra_ros2::Node;
use cotorra_testing::{process::Process, ros2::Meeting};

use crate::both_ways::{Place, both_ways};

struct FastDds(Meeting);

impl Place for FastDds {
    const FRAME: &'static str = "from fast dds";
    const SCAN: &'static [&'static str] = &["3 9 laser 0 0 0.5 0 0 0 12 1.5 inf 2.25"];
    const MAP: &'static [&'static str] = &["500 400 0 0 0 0 0 0 1 -1 0 1 2 3 4"];
    const COMMANDS: [&'static str; 2] = ["0.75 0 0 0 0 0", "0 0 base 0.75 0 0 0 0 0"];

    fn node(&self, name: &str) -> Node {
        self.0.node(name)
    }

    fn peer(&self, action: &str, kind: &str, topic: &str, qos: &str) -> Option<Process> {
        self.0.fast_dds(action, kind, topic, qos)
    }
}

both_ways!(|| Some(FastDds(Meeting::new())));
