//! Sensors: images go to VNFs that can take them.

use cotorra_graph::{Program, Testbed};

use crate::{
    records::{CameraRecord, DriverRecord, DriverWord, NodeRecord, RobotRecord, SensorRecord, TestbedRecord},
    yaml::{Sink, decode::Either},
};

/// Images go to VNFs that can take them.
pub(super) fn receivers(record: &TestbedRecord, testbed: &Testbed, sink: &mut Sink) {
    // Images of others go nowhere, which is reported elsewhere.
    let is_simulated = |robot: &RobotRecord| {
        let driver = &robot.driver.value;
        matches!(driver, Either::Short(DriverWord::Simulated) | Either::Long(DriverRecord::Simulated(_)))
    };
    let robots = record.nodes.0.iter().filter_map(|(_, node)| match node {
        NodeRecord::Robot(robot) if is_simulated(robot) => Some(robot),
        _ => None,
    });
    let vnfs = || testbed.services.iter().flat_map(|service| &service.vnfs);
    for (_, sensor) in robots.flat_map(|robot| &robot.sensors.0) {
        let SensorRecord::Camera(CameraRecord { to: Some(to), .. }) = sensor else { continue };
        match vnfs().find(|vnf| vnf.id == to.value).map(|vnf| &vnf.program) {
            Some(Program::Command(_)) => {}
            Some(_) => {
                sink.error(&to.span, format!("`{}` is a bundled VNF, which takes no images", to.value))
                    .help("name a VNF with a `command`");
            }
            None => {
                sink.unknown_name(&to.span, "VNF", to.value.as_str(), vnfs().map(|vnf| vnf.id.as_str()));
            }
        }
    }
}
