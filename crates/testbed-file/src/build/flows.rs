//! Flows of programs, whose time is a service's: the user's own, and the brain in ROS.

use std::time::Duration;

use cotorra_graph::{Flow, FlowId, FlowProtocol, Node, NodeKind, Program, Service};

use super::builder::Builder;
use crate::{
    records::{FlowIdRecord, FlowRecord, FlowWhereRecord, KpisRecord, ServiceRecord},
    yaml::decode::Spanned,
};

/// Shortest timeout of an answer, where answers can be told from one another.
const PATIENCE: Duration = Duration::from_secs(1);

/// Measures each service of a brain in ROS from the robot's poses to the commands that answer them, unless its KPIs name a
/// flow.
pub(super) fn of_brains(nodes: &[Node], services: &mut [Service]) {
    for Service { robot: id, vnfs, kpis, .. } in services {
        let node = nodes.iter().find(|node| node.id == *id);
        if let Some(NodeKind::Robot(robot)) = node.map(|node| &node.kind)
            && let Some(ros) = robot.driver.ros()
            && kpis.flow.is_none()
            && vnfs.iter().any(|vnf| vnf.program == Program::RosNavigation)
        {
            let timeout = kpis.service_time * 2;
            kpis.flow = Some(Flow { from: id.clone(), timeout, protocol: ros.poses_to_commands() });
        }
    }
}

impl Builder<'_> {
    /// The flow that a service's KPIs name; `None` if it cannot be.
    pub(super) fn flow(&mut self, record: &ServiceRecord) -> Option<Option<Flow>> {
        let KpisRecord { flow: Some(flow), service_time, .. } = &record.kpis else { return Some(None) };
        let (at, protocol) = match &flow.value {
            FlowRecord::Udp(udp) => {
                let id = udp.id.as_ref().map(|id| self.flow_id(id));
                (&udp.at, FlowProtocol::Udp { port: self.port(&udp.port), id })
            }
            FlowRecord::Tcp(tcp) => (&tcp.at, FlowProtocol::Tcp { port: self.port(&tcp.port) }),
            FlowRecord::Http(http) => {
                let path = http.path.as_ref().inspect(|path| self.path(path)).map(|path| path.value.clone());
                (&http.at, FlowProtocol::Http { port: self.port(&http.port), path })
            }
            FlowRecord::Ros1(ros) => {
                let id = ros.id.as_ref().map(|id| self.flow_id(id));
                let (request, answer) = (self.ros_name(&ros.request), self.ros_name(&ros.answer));
                (&ros.at, FlowProtocol::Ros1 { request, answer, id })
            }
            FlowRecord::Ros1Service(ros) => {
                (&ros.at, FlowProtocol::Ros1Service { service: self.ros_name(&ros.service) })
            }
            FlowRecord::Ros2(ros) => {
                let id = ros.id.as_ref().map(|id| self.flow_id(id));
                let (request, answer) = (self.ros_name(&ros.request), self.ros_name(&ros.answer));
                (&ros.at, FlowProtocol::Ros2 { request, answer, id })
            }
            FlowRecord::Ros2Service(ros) => {
                (&ros.at, FlowProtocol::Ros2Service { service: self.ros_name(&ros.service) })
            }
            FlowRecord::Ros2Action(ros) => {
                (&ros.at, FlowProtocol::Ros2Action { action: self.ros_name(&ros.action) })
            }
        };
        let FlowWhereRecord { from, timeout } = at;
        let target = service_time.value;
        if let Some(timeout) = timeout.as_ref().filter(|timeout| timeout.value < target) {
            self.sink
                .error(&timeout.span, "requests are given up before the target of their time")
                .help(format!("write a `timeout` of {target:?} or more"));
        }
        let from = match from {
            Some(from) => self.host(from)?,
            None => record.robot.value.clone(),
        };
        let usual = match protocol {
            FlowProtocol::Udp { id: None, .. }
            | FlowProtocol::Ros1 { id: None, .. }
            | FlowProtocol::Ros2 { id: None, .. } => target * 2,
            _ => PATIENCE.max(target * 2),
        };
        Some(Some(Flow { from, timeout: timeout.as_ref().map_or(usual, |timeout| timeout.value), protocol }))
    }

    fn port(&mut self, port: &Spanned<u16>) -> u16 {
        if port.value == 0 {
            self.sink
                .error(&port.span, "no server has the port 0")
                .help("write the port at which it listens, from 1 to 65535");
        }
        port.value
    }

    fn ros_name(&mut self, name: &Spanned<String>) -> String {
        if !name.value.starts_with('/') {
            self.sink
                .error(&name.span, format!("`{}` is not a global ROS name", name.value))
                .help("write it as ROS lists it, such as `/scan`");
        }
        name.value.clone()
    }

    fn flow_id(&mut self, id: &Spanned<FlowIdRecord>) -> FlowId {
        let FlowIdRecord { offset, length } = id.value;
        if !(1..=FlowId::MOST).contains(&length) || offset > FlowId::FARTHEST {
            self.sink
                .error(&id.span, format!("an `id` of {length} bytes from byte {offset} on"))
                .help(format!("name 1 to {} bytes, from byte 0 to {} on", FlowId::MOST, FlowId::FARTHEST));
        }
        FlowId { offset, length }
    }

    fn path(&mut self, path: &Spanned<String>) {
        if !path.value.starts_with('/') || path.value.contains(['?', '#']) {
            self.sink
                .error(&path.span, format!("`{}` is not the path of a request", path.value))
                .help("write what is between the host and the `?`, such as `/detect`");
        }
    }
}
