//! Output of `run --dry-run`: everything that a run would start.

use cotorra_graph::{HostAddress, Node, NodeKind, Program, Tier, Vnf};
use cotorra_measurements::Location;
use cotorra_testbed::InterfacePlan;

use super::args::{DEFAULT_API, RunArgs};
use crate::{
    netem::show,
    table::Table,
    testbed_file::{length, overview},
};
use cotorra_graph::{PluginProgram, Testbed};

/// Describes what a run with these arguments would start.
pub fn describe(
    testbed: &Testbed,
    args: &RunArgs,
    history: Option<&Location>,
    interfaces: &[(String, InterfacePlan)],
) -> String {
    let mut text =
        format!("{}: {}\n\nHosts, each with a network namespace:\n", args.file.display(), overview(testbed));
    let mut hosts = Table::new("<<<<<");
    for node in testbed.graph.hosts() {
        let Some(address) = testbed.graph.address(&node.id) else { continue };
        hosts.row([
            node.id.to_string(),
            kind(&node.kind).to_owned(),
            address.ipv4.to_string(),
            address.ipv6.to_string(),
            vnfs(testbed, node),
        ]);
    }
    text += &hosts.render("  ");
    text += &real_servers(testbed);
    text += &robots_at_agents(testbed);
    text += &agents(testbed);
    text += &gateways(testbed);
    text += &border(testbed);
    for (name, plan) in interfaces {
        match plan {
            InterfacePlan::Here(plan) => {
                text += &format!(
                    "\nInterface {name} of this machine, restored at the end, as commands of tc and ip:\n"
                );
                plan.to_string().lines().for_each(|line| text += &format!("  {line}\n"));
            }
            InterfacePlan::AtAgent(agent, rules) => {
                text += &format!(
                    "\nInterface {name} of the machine of agent {agent}, restored at the end, by NetEm there:\n"
                );
                let mut lines = Table::new("<<");
                rules.iter().for_each(|rule| lines.row([show::packets(rule), show::conditions(&rule.netem)]));
                text += &lines.render("  ");
            }
        }
    }
    if !testbed.walks.is_empty() {
        text += "\nWalks:\n";
        let mut walks = Table::new("<>>");
        for walk in &testbed.walks {
            let metres = length(&walk.waypoints);
            let at_least = format!("{:.0} s or more", metres / walk.speed_limit);
            walks.row([walk.robot.to_string(), format!("{metres:.1} m"), at_least]);
        }
        text += &walks.render("  ");
    }
    if !testbed.plugins.is_empty() {
        text += "\nPlug-ins:\n";
        let mut plugins = Table::new("<<");
        for plugin in &testbed.plugins {
            let program = match &plugin.program {
                PluginProgram::Bundled(name) => format!("bundled `{name}`"),
                PluginProgram::Command(words) => words.join(" "),
            };
            plugins.row([plugin.id.to_string(), program]);
        }
        text += &plugins.render("  ");
    }
    let mut rest = Table::new("<<");
    rest.row(["seed".to_owned(), args.seed.unwrap_or(testbed.seed).to_string()]);
    let until = args.until.map_or(String::new(), |until| format!(", or after {} s", until.as_secs_f64()));
    rest.row(["ends".to_owned(), format!("at the end of the walks{until}, or with Ctrl-C")]);
    let api = args.api.map_or(DEFAULT_API.to_owned(), |api| api.to_string());
    let is_encrypted = args.api.is_some_and(|api| !api.ip().is_loopback()) && !args.access.no_tls;
    let api = format!("{}://{api}", if is_encrypted { "https" } else { "http" });
    rest.row(["API".to_owned(), api]);
    rest.row(["folder".to_owned(), args.out.join(format!("{}-<time>", testbed.name)).display().to_string()]);
    if let Some(history) = history {
        rest.row(["history".to_owned(), history.to_string()]);
    }
    if let Some(after) = &args.after {
        rest.row(["after".to_owned(), format!("the run {after}")]);
    }
    if let Some(recording) = &args.record {
        let file =
            recording.as_ref().map_or("recording.mcap in the folder".to_owned(), |f| f.display().to_string());
        rest.row(["recording".to_owned(), file]);
    }
    if let Some(foxglove) = args.foxglove {
        rest.row(["Foxglove".to_owned(), format!("ws://{foxglove}")]);
    }
    text + "\n" + &rest.render("")
}

/// Lists the VNFs that start on a node.
fn vnfs(testbed: &Testbed, node: &Node) -> String {
    let its = testbed.vnfs().filter(|vnf| vnf.node.all().contains(&node.id));
    its.map(program).collect::<Vec<_>>().join(", ")
}

/// Names an interface and its network namespace.
fn interface(name: &str, netns: Option<&str>) -> String {
    match netns {
        Some(netns) => format!("{name} in the network namespace {netns}"),
        None => format!("{name} of this machine"),
    }
}

/// Describes the real servers, and what each needs.
fn real_servers(testbed: &Testbed) -> String {
    let mut servers = Table::new("<<<<<<");
    for (node, real) in testbed.graph.real_servers() {
        servers.row([
            node.id.to_string(),
            kind(&node.kind).to_owned(),
            real.address.to_string(),
            interface(&real.interface, real.netns.as_deref()),
            format!("agent {}", real.agent),
            vnfs(testbed, node),
        ]);
    }
    let servers = servers.render("  ");
    if servers.is_empty() {
        return servers;
    }
    format!(
        "\nReal servers. Each needs a route, as by\n  ip route add {} dev INTERFACE\n{servers}",
        HostAddress::NETWORK
    )
}

/// Describes the robots at agents.
fn robots_at_agents(testbed: &Testbed) -> String {
    let mut robots = Table::new("<<<");
    for (node, kobuki, agent) in testbed.graph.robots_at_agents() {
        let lidar = kobuki.lidar.as_ref().map(|lidar| lidar.port.display().to_string());
        let ports = [Some(kobuki.port.display().to_string()), lidar].into_iter().flatten();
        robots.row([node.id.to_string(), format!("agent {agent}"), ports.collect::<Vec<_>>().join(", ")]);
    }
    let robots = robots.render("  ");
    if robots.is_empty() { robots } else { format!("\nRobots at agents, with their serial ports:\n{robots}") }
}

/// Lists the agents that only report contexts.
fn agents(testbed: &Testbed) -> String {
    let mut agents = Table::new("<<<");
    let only_reports = |node: &Node| matches!(node.kind, NodeKind::Machine(_) | NodeKind::RadioUnit(_));
    for (node, agent) in testbed.graph.agents().filter(|(node, _)| only_reports(node)) {
        agents.row([node.id.to_string(), kind(&node.kind).to_owned(), format!("agent {agent}")]);
    }
    let agents = agents.render("  ");
    if agents.is_empty() {
        agents
    } else {
        format!("\nAgents that report the contexts of machines:\n{agents}")
    }
}

/// Describes the gateways, and what each machine behind them needs.
fn gateways(testbed: &Testbed) -> String {
    let mut text = String::new();
    for (node, gateway) in testbed.graph.gateways() {
        text += &format!(
            "\nGateway {} on the interface {}, for the machines behind it. Each needs a route, as by\n  \
             ip route add {} dev INTERFACE\n",
            node.id,
            interface(&gateway.interface, gateway.netns.as_deref()),
            HostAddress::NETWORK
        );
        let mut machines = Table::new("<<");
        for (name, address) in &gateway.machines {
            machines.row([name.to_string(), address.to_string()]);
        }
        text += &machines.render("  ");
    }
    text
}

/// Describes the border, and what other cores need.
fn border(testbed: &Testbed) -> String {
    let Some(border) = &testbed.border else { return String::new() };
    let mut text = format!(
        "\nBorder to the cores of other domains: they reach this one over UDP at {}. Packets of robots that are with them \
         enter and leave the wired network at {}.\n",
        border.address, border.node
    );
    let visitors: Vec<_> = border.visitors.iter().map(ToString::to_string).collect();
    text += &match visitors.is_empty() {
        true => "  It takes in no robots: no `visitors` stand for them.\n".to_owned(),
        false => format!("  It takes in one robot for each visitor: {}.\n", visitors.join(", ")),
    };
    text
}

fn kind(kind: &NodeKind) -> &'static str {
    match kind {
        NodeKind::Robot(_) => "robot",
        NodeKind::RadioUnit(_) => "radio unit",
        NodeKind::Switch => "switch",
        NodeKind::Gateway(_) => "gateway",
        NodeKind::Machine(_) => "real machine",
        NodeKind::Server(server) => match server.tier {
            Tier::Fog => "server, fog",
            Tier::Edge => "server, edge",
            Tier::Cloud => "server, cloud",
        },
    }
}

fn program(vnf: &Vnf) -> String {
    if let Some(image) = &vnf.image {
        return format!("{} (image {})", vnf.id, image.reference);
    }
    match &vnf.program {
        Program::RobotDriver => format!("{} (robot driver)", vnf.id),
        Program::Navigation => format!("{} (bundled brain)", vnf.id),
        Program::Localization => format!("{} (Monte Carlo localization)", vnf.id),
        Program::RosNavigation => format!("{} (bundled brain, in ROS)", vnf.id),
        Program::PolicyServer(_) => format!("{} (policy server)", vnf.id),
        Program::Command(words) | Program::Host(words) => format!("{} ({})", vnf.id, words.join(" ")),
    }
}
