//! Services and their VNFs.

use std::path::PathBuf;

use cotorra_graph::{
    Granted, Kpis, NodeId, Nodes, Program, Requests, Rights, Service, ServiceId, VirtualLink, Vnf,
};

use super::builder::{Builder, each};
use crate::{
    records::{ProgramWord, ServiceRecord, VnfRecord},
    yaml::{
        Span,
        decode::{Either, Spanned},
    },
};

impl Builder<'_> {
    pub(super) fn service(&mut self, id: &Spanned<ServiceId>, record: &ServiceRecord) -> Option<Service> {
        let robot = self.robot(&record.robot);
        let vnfs: Option<Vec<_>> = each(&record.vnfs.0, |(vnf, r)| {
            let (program, pinned_to, node) = self.vnf(&vnf.span, r)?;
            let id = vnf.value.clone();
            let is_command = matches!(program, Program::Command(_));
            let (env, rights) = (self.env(&r.env, is_command), self.rights(r, is_command));
            let (env, rights) = (env?, rights?);
            Some(Vnf {
                id,
                program,
                cpus: r.cpus.0,
                memory_bytes: r.memory.0,
                pinned_to,
                node,
                env,
                rights,
                keep: r.keep,
                image: None,
            })
        });
        let virtual_links: Option<Vec<_>> = each(&record.virtual_links, |link| {
            for end in [&link.from, &link.to] {
                if !record.vnfs.0.iter().any(|(vnf, _)| vnf.value == end.value) {
                    let vnfs = record.vnfs.0.iter().map(|(vnf, _)| vnf.value.as_str());
                    self.sink.unknown_name(&end.span, "VNF in this service named", end.value.as_str(), vnfs);
                }
            }
            if link.from.value == link.to.value {
                self.sink
                    .error(&link.to.span, format!("a virtual link from `{}` to itself", link.to.value))
                    .help("name two different VNFs");
            }
            Some(VirtualLink { from: link.from.value.clone(), to: link.to.value.clone(), rate: link.rate })
        });
        let kpis = Kpis {
            service_time: record.kpis.service_time.value,
            reliability: record.kpis.reliability.as_ref().map(|r| r.value.get()),
            area: record.kpis.area.as_ref().map(|a| a.value.clone()),
            radio: record.kpis.radio.as_ref().map(|r| r.value),
            flow: self.flow(record)?,
        };
        Some(Service {
            id: id.value.clone(),
            robot: robot?,
            vnfs: vnfs?,
            virtual_links: virtual_links?,
            kpis,
            requests: record.requests.as_ref().map_or_else(Requests::default, |requests| requests.value),
        })
    }

    /// Builds the program of a VNF, the node that it is pinned to, and the nodes where it starts.
    fn vnf(&mut self, span: &Span, record: &VnfRecord) -> Option<(Program, Option<NodeId>, Nodes)> {
        let program = match (&record.program, &record.command) {
            (Some(word), None) => match word.value {
                ProgramWord::RobotDriver => Some(Program::RobotDriver),
                ProgramWord::Navigation => Some(Program::Navigation),
                ProgramWord::Localization => Some(Program::Localization),
            },
            (None, Some(command)) => self.command(command).map(Program::Command),
            (None, None) => {
                self.sink.error(span, "nothing says what this VNF runs").help(
                    "add `program: navigation`, `program: localization`, `program: robot_driver`, or \
                     `command: [program, argument]`",
                );
                None
            }
            (Some(_), Some(command)) => {
                self.sink
                    .error(&command.span, "both a program and a command")
                    .help("keep one of `program` and `command`");
                None
            }
        };
        let (pinned, node) = match (&record.pinned_to, &record.node) {
            (Some(pinned), None) => {
                let node = self.node(pinned);
                (node.clone(), node.map(Nodes::from))
            }
            (None, Some(node)) => (None, self.hosts_of(node)),
            (None, None) => {
                self.sink
                    .error(span, "nothing says where this VNF runs")
                    .help("add `node:` where it starts, or `pinned_to:` if it cannot move");
                (None, None)
            }
            (Some(_), Some(node)) => {
                self.sink
                    .error(&node.span, "both pinned and started on a node")
                    .help("keep `pinned_to` if it cannot move, else `node`");
                (None, None)
            }
        };
        let node = node?;
        if let Some(replicas) = record.replicas.as_ref().filter(|r| usize::from(r.value) != node.all().len())
        {
            let (wanted, nodes) = (replicas.value, node.all().len());
            let s = if nodes == 1 { "" } else { "s" };
            let help = if pinned.is_some() {
                "leave `replicas` out: a VNF that is pinned has one instance".to_owned()
            } else {
                let most = Nodes::MOST;
                format!(
                    "each has a node of its own: list as many under `node:`, such as `[a, b]`, {most} at most"
                )
            };
            self.sink.error(&replicas.span, format!("{wanted} instances on {nodes} node{s}")).help(help);
            return None;
        }
        Some((program?, pinned, node))
    }

    /// The nodes of a VNF's instances.
    fn hosts_of(&mut self, record: &Spanned<Either<Spanned<NodeId>, Vec<Spanned<NodeId>>>>) -> Option<Nodes> {
        let several = match &record.value {
            Either::Short(one) => return self.node(one).map(Nodes::from),
            Either::Long(several) => each(several, |node| self.node(node))?,
        };
        Nodes::new(several)
            .map_err(|wrong| {
                let help = "name different nodes, one for each instance, such as `[a, b]`";
                self.sink.error(&record.span, wrong.to_string()).help(help);
            })
            .ok()
    }

    /// Builds the rights of a command on this machine.
    fn rights(&mut self, record: &VnfRecord, is_command: bool) -> Option<Rights> {
        let VnfRecord { capabilities, readable, trusted, .. } = record;
        let given = [
            ("capabilities", &capabilities.span, !capabilities.value.is_empty()),
            ("readable", &readable.span, !readable.value.is_empty()),
        ];
        let mut well = true;
        for (key, span, is_given) in given {
            if is_given && trusted.value {
                self.sink
                    .error(span, format!("`{key}` of a VNF that is trusted"))
                    .help("keep one of the two: what is trusted may do all that cotorra may");
                well = false;
            }
            if is_given && !is_command {
                self.sink
                    .error(span, format!("only a `command` has `{key}`"))
                    .help(format!("leave out `{key}`: what is bundled has what it needs"));
                well = false;
            }
        }
        if trusted.value && !is_command {
            self.sink
                .error(&trusted.span, "only a `command` can be trusted or not")
                .help("leave out `trusted`: what is bundled is cotorra itself");
            well = false;
        }
        let readable = readable.value.iter().map(PathBuf::from).collect();
        let confined = Rights::Confined(Granted { capabilities: capabilities.value.clone(), readable });
        well.then_some(if trusted.value { Rights::Trusted } else { confined })
    }
}
