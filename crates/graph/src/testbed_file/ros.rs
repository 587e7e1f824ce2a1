//! What stands in a testbed file about robots in ROS: where their master is, and what their topics are called.

use std::net::IpAddr;

use super::records::{
    DriverRecord, DriverWord, OfferRecord, OfferWord, RobotRecord, Ros1Record, RosNetwork, RosTopicsRecord,
};
use crate::{
    driver::{Driver, Offer, Ros1, RosMaster, RosTopics},
    id::NodeId,
    yaml::{
        Sink,
        decode::{Either, Spanned},
    },
};

/// What moves a robot, and how it is offered. `host` finds a node that has a network namespace, or reports that there
/// is none of that name.
pub(super) fn driver(
    record: &RobotRecord,
    robot: &NodeId,
    host: &mut dyn FnMut(&Spanned<NodeId>, &mut Sink) -> Option<NodeId>,
    sink: &mut Sink,
) -> Option<Driver> {
    let default = Ros1Record::default();
    let ros1 = match &record.driver.value {
        Either::Short(DriverWord::Simulated) | Either::Long(DriverRecord::Simulated(_)) => None,
        Either::Short(DriverWord::Ros1) => Some(&default),
        Either::Long(DriverRecord::Ros1(ros1)) => Some(ros1),
    };
    let offered = record.offer.as_ref().map(|offer| match &offer.value {
        Either::Short(OfferWord::Ros1) => (&default, &offer.span),
        Either::Long(OfferRecord::Ros1(ros1)) => (ros1, &offer.span),
    });
    match (ros1, offered) {
        (Some(ros1), None) => Some(Driver::Ros1(build(ros1, RosNetwork::Machine, robot, host, sink)?)),
        (Some(_), Some((_, span))) => {
            sink.error(span, format!("`{robot}` is driven over ROS, and offered"))
                .help("leave out `offer`: it is out there already; only a simulated robot can be offered");
            None
        }
        (None, None) => Some(Driver::default()),
        (None, Some((ros1, _))) => {
            let offer = Offer::Ros1(build(ros1, RosNetwork::Testbed, robot, host, sink)?);
            Some(Driver::Simulated { offer: Some(offer) })
        }
    }
}

fn build(
    record: &Ros1Record,
    usual: RosNetwork,
    robot: &NodeId,
    host: &mut dyn FnMut(&Spanned<NodeId>, &mut Sink) -> Option<NodeId>,
    sink: &mut Sink,
) -> Option<Box<Ros1>> {
    let master = master(record, usual, robot, host, sink);
    let namespace = match &record.namespace {
        None => Some("/".to_owned()),
        Some(namespace) => {
            name(namespace, "namespace", sink).map(|name| format!("/{}", name.trim_matches('/')))
        }
    };
    let topics = topics(&record.topics, sink);
    Some(Box::new(Ros1 { master: master?, namespace: namespace?, topics: topics? }))
}

fn master(
    record: &Ros1Record,
    usual: RosNetwork,
    robot: &NodeId,
    host: &mut dyn FnMut(&Spanned<NodeId>, &mut Sink) -> Option<NodeId>,
    sink: &mut Sink,
) -> Option<RosMaster> {
    let network = record.network.as_ref().map(|network| network.value);
    let Some(said) = &record.master else {
        return Some(match network.unwrap_or(usual) {
            RosNetwork::Machine => RosMaster::Machine { uri: None },
            RosNetwork::Testbed => RosMaster::Node { node: robot.clone() },
        });
    };
    if said.value.contains("://") {
        let uri = said.value.clone();
        if !is_address(&uri) {
            sink.error(&said.span, format!("`{uri}` is no address of a ROS 1 master"))
                .help("write one such as `http://192.168.0.10:11311`");
            return None;
        }
        return Some(match network.unwrap_or(usual) {
            RosNetwork::Machine => RosMaster::Machine { uri: Some(uri) },
            RosNetwork::Testbed => RosMaster::Testbed { uri },
        });
    }
    let Ok(node) = NodeId::new(&said.value) else {
        sink.error(&said.span, format!("`{}` is neither an address nor a node", said.value))
            .help("write an address such as `http://192.168.0.10:11311`, or the name of a node");
        return None;
    };
    let node = host(&Spanned { value: node, span: said.span.clone() }, sink)?;
    if let (Some(RosNetwork::Machine), Some(network)) = (network, &record.network) {
        sink.error(&network.span, "a master in a node is not reached from the machine's network")
            .help("leave out `network`, or write the master's address in this machine's network");
        return None;
    }
    Some(RosMaster::Node { node })
}

/// Whether it is `http://HOST:PORT`, with a slash behind it or not.
fn is_address(uri: &str) -> bool {
    let Some(rest) = uri.strip_prefix("http://") else { return false };
    let Some((host, port)) = rest.strip_suffix('/').unwrap_or(rest).rsplit_once(':') else { return false };
    let is_name = |host: &str| {
        !host.is_empty()
            && host.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '_' | '~'))
    };
    let bracketed = host.strip_prefix('[').and_then(|host| host.strip_suffix(']'));
    (is_name(host) || bracketed.is_some_and(|host| host.parse::<IpAddr>().is_ok()))
        && port.parse::<u16>().is_ok()
}

fn topics(record: &RosTopicsRecord, sink: &mut Sink) -> Option<RosTopics> {
    let mut topic = |said: &Option<Spanned<String>>, usual: String| match said {
        None => Some(usual),
        Some(said) => name(said, "topic", sink),
    };
    let RosTopics { scan, odom, cmd_vel, tf, amcl_pose, map } = RosTopics::default();
    // All are read before any that failed ends it, so that each one's mistakes show.
    let (scan, odom, cmd_vel) =
        (topic(&record.scan, scan), topic(&record.odom, odom), topic(&record.cmd_vel, cmd_vel));
    let (tf, amcl_pose, map) =
        (topic(&record.tf, tf), topic(&record.amcl_pose, amcl_pose), topic(&record.map, map));
    Some(RosTopics { scan: scan?, odom: odom?, cmd_vel: cmd_vel?, tf: tf?, amcl_pose: amcl_pose?, map: map? })
}

/// A name of ROS's, for which ROS 1 and 2 have the same characters. Private names, `~…`, would be of cotorra's node.
fn name(said: &Spanned<String>, what: &str, sink: &mut Sink) -> Option<String> {
    let parts = said.value.strip_prefix('/').unwrap_or(&said.value).split('/');
    let is_part = |part: &str| {
        part.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
            && part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
    };
    let root = what == "namespace" && said.value == "/";
    if !root && !parts.clone().all(is_part) {
        sink.error(&said.span, format!("`{}` is no {what} of ROS's", said.value)).help(
            "use letters, digits and `_` between slashes, each part beginning with a letter, such as `/tb2/scan`",
        );
        return None;
    }
    Some(said.value.clone())
}
