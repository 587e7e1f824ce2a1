//! Robots in ROS: their master or domain, and the names of their topics.

use std::{collections::BTreeMap, net::IpAddr};

use cotorra_graph::{Driver, NodeId, Offer, Rmw, Ros, Ros1, Ros2, RosMaster, RosNetwork, RosTopics};

use super::{kobuki, sensors};
use crate::{
    records::{
        DriverRecord, DriverWord, OfferRecord, OfferWord, RmwWord, RobotRecord, Ros1Record, Ros2Record,
        RosTopicsRecord,
    },
    yaml::{
        Sink,
        decode::{Either, Spanned},
    },
};

/// Settings of a robot in ROS, or their defaults.
enum RosSettings<'a> {
    Ros1(&'a Ros1Record),
    Ros2(&'a Ros2Record),
}

impl RosSettings<'_> {
    fn clock(&self) -> Option<&Spanned<bool>> {
        match self {
            RosSettings::Ros1(ros1) => ros1.clock.as_ref(),
            RosSettings::Ros2(ros2) => ros2.clock.as_ref(),
        }
    }
}

/// Builds the driver of a robot, and the ROS interface of a simulated one. `host` looks up a node with a network
/// namespace, and reports an unknown name. `at_ports` is whether its agent, if it has one, is for serial ports alone.
pub(super) fn driver(
    record: &RobotRecord,
    robot: &NodeId,
    at_ports: bool,
    host: &mut dyn FnMut(&Spanned<NodeId>, &mut Sink) -> Option<NodeId>,
    sink: &mut Sink,
) -> Option<Driver> {
    let (ros1, ros2) = (Ros1Record::default(), Ros2Record::default());
    let driven = match &record.driver.value {
        Either::Short(DriverWord::Kobuki) => return kobuki::driver(record, None, sink),
        Either::Long(DriverRecord::Kobuki(its)) => return kobuki::driver(record, Some(its), sink),
        Either::Short(DriverWord::Simulated) | Either::Long(DriverRecord::Simulated(_)) => None,
        Either::Short(DriverWord::Ros1) => Some(RosSettings::Ros1(&ros1)),
        Either::Short(DriverWord::Ros2) => Some(RosSettings::Ros2(&ros2)),
        Either::Long(DriverRecord::Ros1(ros1)) => Some(RosSettings::Ros1(ros1)),
        Either::Long(DriverRecord::Ros2(ros2)) => Some(RosSettings::Ros2(ros2)),
    };
    if let Some(agent) = record.agent.as_ref().filter(|_| at_ports) {
        sink.error(&agent.span, format!("`{robot}` has an agent, but no serial ports"))
            .help("write `driver: kobuki`, or leave out `agent`");
    }
    let offered = record.offer.as_ref().map(|offer| match &offer.value {
        Either::Short(OfferWord::Ros1) => (RosSettings::Ros1(&ros1), &offer.span),
        Either::Short(OfferWord::Ros2) => (RosSettings::Ros2(&ros2), &offer.span),
        Either::Long(OfferRecord::Ros1(ros1)) => (RosSettings::Ros1(ros1), &offer.span),
        Either::Long(OfferRecord::Ros2(ros2)) => (RosSettings::Ros2(ros2), &offer.span),
    });
    let mut place = |given: RosSettings<'_>, usual: RosNetwork| match given {
        RosSettings::Ros1(ros1) => build(ros1, usual, robot, host, sink).map(Ros::Ros1),
        RosSettings::Ros2(ros2) => build_ros2(ros2, usual, sink).map(Ros::Ros2),
    };
    match (driven, offered) {
        (Some(driven), None) => {
            if let Some(clock) = driven.clock() {
                sink.error(&clock.span, format!("`{robot}` is out there, and has a clock of its own"))
                    .help("leave out `clock`: it is for an `offer`");
                return None;
            }
            Some(match place(driven, RosNetwork::Machine)? {
                Ros::Ros1(mut ros1) => {
                    ros1.topics.sensors = sensors::topics(record, |given| name(given, "topic", sink));
                    Driver::Ros1(ros1)
                }
                Ros::Ros2(mut ros2) => {
                    let ros2_name =
                        |given: &_| (!is_doubled(given, sink)).then(|| name(given, "topic", sink))?;
                    ros2.topics.sensors = sensors::topics(record, ros2_name);
                    Driver::Ros2(ros2)
                }
            })
        }
        (Some(_), Some((_, span))) => {
            sink.error(span, format!("`{robot}` is driven over ROS, and offered"))
                .help("leave out `offer`: it is out there already; only a simulated robot can be offered");
            None
        }
        (None, None) => Some(Driver::default()),
        (None, Some((offered, _))) => {
            let clock = offered.clock().is_some_and(|given| given.value);
            let ros = place(offered, RosNetwork::Testbed)?;
            Some(Driver::Simulated { offer: Some(Offer { ros, clock }) })
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
    let namespace = namespace(record.namespace.as_ref(), sink);
    let topics = topics(&record.topics, sink);
    Some(Box::new(Ros1 { master: master?, namespace: namespace?, topics: topics? }))
}

/// Beyond that, the UDP ports of a domain would be over 65535 (DDSI-RTPS 2.5, 9.6.2.3).
const LAST_DOMAIN: u16 = 232;

fn build_ros2(record: &Ros2Record, usual: RosNetwork, sink: &mut Sink) -> Option<Box<Ros2>> {
    let domain = match &record.domain {
        None => Some(None),
        Some(given) => {
            let domain = u16::try_from(given.value).ok().filter(|domain| *domain <= LAST_DOMAIN);
            if domain.is_none() {
                sink.error(&given.span, format!("{} is not a ROS 2 domain", given.value))
                    .help(format!("write a number from 0 to {LAST_DOMAIN}"));
            }
            domain.map(Some)
        }
    };
    let rmw = rmw(record, usual, sink);
    let RosTopicsRecord { scan, odom, cmd_vel, tf, amcl_pose, map } = &record.topics;
    let names = [&record.namespace, scan, odom, cmd_vel, tf, amcl_pose, map];
    let doubled = names.into_iter().flatten().filter(|given| is_doubled(given, sink)).count();
    let namespace = namespace(record.namespace.as_ref(), sink);
    let topics = topics(&record.topics, sink);
    let ros2 = Ros2 { rmw: rmw?, domain: domain?, namespace: namespace?, topics: topics? };
    (doubled == 0).then(|| Box::new(ros2))
}

/// Whether a name has what ROS 2's have not, two `_` behind each other; reports that.
fn is_doubled(given: &Spanned<String>, sink: &mut Sink) -> bool {
    let doubled = given.value.contains("__");
    if doubled {
        sink.error(&given.span, format!("`{}` is not a ROS 2 name", given.value))
            .help("write no two `_` behind each other");
    }
    doubled
}

/// The router that `rmw_zenoh`'s nodes look for by default.
const ROUTER: &str = "tcp/localhost:7447";

fn rmw(record: &Ros2Record, usual: RosNetwork, sink: &mut Sink) -> Option<Rmw> {
    let network = record.network.as_ref().map_or(usual, |network| network.value);
    let zenoh = record.rmw.as_ref().filter(|given| given.value == RmwWord::Zenoh);
    match (zenoh, &record.router, &record.interface) {
        (None, Some(router), _) => {
            sink.error(&router.span, "DDS has no router").help("leave it out, or write `rmw: zenoh`");
            None
        }
        (Some(_), _, Some(interface)) => {
            sink.error(&interface.span, "Zenoh takes the interface that leads to its router")
                .help("leave out `interface`");
            None
        }
        (Some(zenoh), ..) if network == RosNetwork::Testbed => {
            let span = record.network.as_ref().map_or(&zenoh.span, |network| &network.span);
            sink.error(span, "Zenoh is spoken in the network of this machine only")
                .help("write `network: machine`, or leave out `rmw`: DDS crosses the emulated network, too");
            None
        }
        (Some(_), None, None) => Some(Rmw::Zenoh { router: ROUTER.to_owned() }),
        (Some(_), Some(router), None) => {
            let place = router.value.strip_prefix("tcp/").and_then(|place| place.rsplit_once(':'));
            let named = place.filter(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok());
            if named.is_none() {
                sink.error(&router.span, format!("`{}` is not a Zenoh router", router.value))
                    .help(format!("write its address such as `{ROUTER}`; others than TCP are not there"));
            }
            named.map(|_| Rmw::Zenoh { router: router.value.clone() })
        }
        (None, None, None) => Some(Rmw::Dds { network, interface: None }),
        (None, None, Some(given)) => {
            let address = given.value.parse().ok();
            if address.is_none() {
                sink.error(&given.span, format!("`{}` is not an address", given.value))
                    .help("write the address of one of this machine's interfaces, such as `192.168.0.10`");
            }
            address.map(|address| Rmw::Dds { network, interface: Some(address) })
        }
    }
}

fn namespace(given: Option<&Spanned<String>>, sink: &mut Sink) -> Option<String> {
    given.map_or(Some("/".to_owned()), |given| {
        name(given, "namespace", sink).map(|name| format!("/{}", name.trim_matches('/')))
    })
}

fn master(
    record: &Ros1Record,
    usual: RosNetwork,
    robot: &NodeId,
    host: &mut dyn FnMut(&Spanned<NodeId>, &mut Sink) -> Option<NodeId>,
    sink: &mut Sink,
) -> Option<RosMaster> {
    let network = record.network.as_ref().map(|network| network.value);
    let Some(given) = &record.master else {
        return Some(match network.unwrap_or(usual) {
            RosNetwork::Machine => RosMaster::Machine { uri: None },
            RosNetwork::Testbed => RosMaster::Node { node: robot.clone() },
        });
    };
    if given.value.contains("://") {
        let uri = given.value.clone();
        if !is_address(&uri) {
            sink.error(&given.span, format!("`{uri}` is not the address of a ROS 1 master"))
                .help("write one such as `http://192.168.0.10:11311`");
            return None;
        }
        return Some(match network.unwrap_or(usual) {
            RosNetwork::Machine => RosMaster::Machine { uri: Some(uri) },
            RosNetwork::Testbed => RosMaster::Testbed { uri },
        });
    }
    let Ok(node) = NodeId::new(&given.value) else {
        sink.error(&given.span, format!("`{}` is neither an address nor a node", given.value))
            .help("write an address such as `http://192.168.0.10:11311`, or the name of a node");
        return None;
    };
    let node = host(&Spanned { value: node, span: given.span.clone() }, sink)?;
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
    let mut topic = |given: &Option<Spanned<String>>, usual: String| match given {
        None => Some(usual),
        Some(given) => name(given, "topic", sink),
    };
    let RosTopics { scan, odom, cmd_vel, tf, amcl_pose, map, .. } = RosTopics::default();
    // All are read before any that failed ends it, so that each one's mistakes show.
    let (scan, odom, cmd_vel) =
        (topic(&record.scan, scan), topic(&record.odom, odom), topic(&record.cmd_vel, cmd_vel));
    let (tf, amcl_pose, map) =
        (topic(&record.tf, tf), topic(&record.amcl_pose, amcl_pose), topic(&record.map, map));
    let sensors = BTreeMap::new();
    let (scan, odom, cmd_vel, tf, amcl_pose, map) = (scan?, odom?, cmd_vel?, tf?, amcl_pose?, map?);
    Some(RosTopics { scan, odom, cmd_vel, tf, amcl_pose, map, sensors })
}

/// A name of ROS's, for which ROS 1 and 2 have the same characters. Private names, `~…`, would be of cotorra's node.
fn name(given: &Spanned<String>, what: &str, sink: &mut Sink) -> Option<String> {
    let parts = given.value.strip_prefix('/').unwrap_or(&given.value).split('/');
    let is_part = |part: &str| {
        part.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
            && part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
    };
    let root = what == "namespace" && given.value == "/";
    if !root && !parts.clone().all(is_part) {
        sink.error(&given.span, format!("`{}` is not a {what} of ROS", given.value)).help(
            "use letters, digits and `_` between slashes, each part beginning with a letter, such as `/tb2/scan`",
        );
        return None;
    }
    Some(given.value.clone())
}
