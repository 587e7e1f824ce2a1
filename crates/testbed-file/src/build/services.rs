//! Services and their VNFs.

use std::{path::PathBuf, time::Duration};

use cotorra_graph::{
    Granted, Kpis, NodeId, Nodes, Probability, Program, Requests, Rights, Service, ServiceId, VirtualLink,
    Vnf, VnfId,
};

use super::builder::{Builder, each};
use crate::{
    records::{ContainerRecord, ProgramWord, ServiceRecord, VnfRecord},
    yaml::{
        Span,
        decode::{Either, Spanned},
    },
};

impl Builder<'_> {
    pub(super) fn service(&mut self, id: &Spanned<ServiceId>, record: &ServiceRecord) -> Option<Service> {
        let robot = self.robot(&record.robot);
        let vnfs: Option<Vec<_>> = each(&record.vnfs.0, |(vnf, r)| self.vnf(vnf, r));
        let composed = record.compose.as_ref().map_or(Some(Vec::new()), |compose| self.compose(compose));
        let virtual_links: Option<Vec<_>> = each(&record.virtual_links, |link| {
            for end in [&link.from, &link.to] {
                // Without those of a compose file that cannot be read, names would seem unknown.
                let Some(composed) = &composed else { continue };
                let names = record.vnfs.0.iter().map(|(vnf, _)| &vnf.value);
                let names = names.chain(composed.iter().map(|vnf| &vnf.id));
                if !names.clone().any(|vnf| *vnf == end.value) {
                    let vnfs = names.map(VnfId::as_str);
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
        let policy = self.policy(record);
        let kpis = Kpis {
            service_time: record.kpis.service_time.value,
            kept: record.kpis.kept.as_ref().map(|kept| as_written(kept.value)),
            reliability: record.kpis.reliability.as_ref().map(|r| r.value.get()),
            area: record.kpis.area.as_ref().map(|a| a.value.clone()),
            radio: record.kpis.radio.as_ref().map(|r| r.value),
            flow: self.flow(record)?,
            require: record.kpis.require.iter().map(|bound| bound.value.clone()).collect(),
        };
        let mut vnfs = vnfs?;
        vnfs.extend(composed?);
        Some(Service {
            id: id.value.clone(),
            robot: robot?,
            vnfs,
            virtual_links: virtual_links?,
            kpis,
            requests: record.requests.as_ref().map_or_else(Requests::default, |requests| requests.value),
            policy: policy?,
        })
    }

    fn vnf(&mut self, id: &Spanned<VnfId>, record: &VnfRecord) -> Option<Vnf> {
        let program = self.program(&id.span, record);
        let place = self.pinned_and_started(&id.span, record);
        let start = record.start_time.unwrap_or_default();
        let image = self.image(&record.container, start, record.processing_delay.as_ref());
        self.no_inference(record);
        let computing = self.computing(record, program.as_ref());
        let state = self.state(record, program.as_ref());
        let cpu_limit = self.cpu_limit(record);
        let runs_others = record.container.image.is_some() || matches!(program, Some(Program::Command(_)));
        let program = program?;
        let (env, rights) = (self.env(&record.container.env, runs_others), self.rights(record, runs_others));
        let (pinned_to, node) = place?;
        Some(Vnf {
            id: id.value.clone(),
            program,
            cpus: record.cpus.0,
            cpu_limit: cpu_limit?,
            memory_bytes: record.memory.0,
            pinned_to,
            node,
            env: env?,
            rights: rights?,
            keep: record.keep,
            start: if record.container.image.is_some() { Duration::ZERO } else { start },
            image: image?.map(Box::new),
            computing: computing?,
            state: state?,
        })
    }

    /// Builds the program of a VNF.
    fn program(&mut self, span: &Span, record: &VnfRecord) -> Option<Program> {
        let ContainerRecord { image, command, .. } = &record.container;
        match (&record.program, command, image) {
            (Some(_), Some(command), None) => {
                self.sink
                    .error(&command.span, "both a program and a command")
                    .help("keep one of `program` and `command`");
                None
            }
            (Some(_), Some(command), Some(_)) => {
                self.sink.error(&command.span, "a command beside a `program` and an `image`").help(
                    "leave out `command`: the image's own runs in the bundled program's place; or leave out `program`",
                );
                None
            }
            (Some(word), None, image) => match (word.value, image) {
                (ProgramWord::RobotDriver, Some(image)) => {
                    self.sink
                        .error(&image.span, "an image of a robot driver")
                        .help("leave out `image`: the robot driver is part of cotorra");
                    None
                }
                (ProgramWord::RosNavigation, Some(image)) => {
                    self.sink
                        .error(&image.span, "an image of the brain in ROS")
                        .help("leave out `image`, or leave out `program`: any image may be a ROS node");
                    None
                }
                (ProgramWord::RobotDriver, None) => Some(Program::RobotDriver),
                (ProgramWord::RosNavigation, None) => Some(Program::RosNavigation),
                (ProgramWord::Navigation, _) => Some(Program::Navigation),
                (ProgramWord::Localization, _) => Some(Program::Localization),
                (ProgramWord::PolicyServer, Some(image)) => {
                    self.sink
                        .error(&image.span, "an image of a policy server")
                        .help("leave out `image`: it runs in virtual time only, as a part of cotorra");
                    None
                }
                (ProgramWord::PolicyServer, None) => self.policy_server(span, record),
            },
            (None, command, Some(_)) => self.words_in_image(command.as_ref()).map(Program::Command),
            (None, Some(command), None) => self.command(command).map(Program::Command),
            (None, None, None) => {
                self.sink.error(span, "nothing says what this VNF runs").help(
                    "add `program: navigation`, `program: ros_navigation`, `program: localization`, \
                     `program: robot_driver`, `command: [program, argument]`, or `image: NAME:TAG`",
                );
                None
            }
        }
    }

    /// Builds the node that a VNF is pinned to, and the nodes where it starts.
    fn pinned_and_started(&mut self, span: &Span, record: &VnfRecord) -> Option<(Option<NodeId>, Nodes)> {
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
        Some((pinned, node))
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

    /// Builds the rights on this machine of a command or an image's containers.
    fn rights(&mut self, record: &VnfRecord, runs_others: bool) -> Option<Rights> {
        let VnfRecord { readable, trusted, container: ContainerRecord { image, capabilities, .. }, .. } =
            record;
        let given = [
            ("capabilities", &capabilities.span, !capabilities.value.is_empty()),
            ("readable", &readable.span, !readable.value.is_empty()),
        ];
        let mut well = true;
        let mut error = |span: &Span, message: String, help: String| {
            self.sink.error(span, message).help(help);
            well = false;
        };
        if image.is_some() && trusted.value {
            error(
                &trusted.span,
                "an image that is trusted".to_owned(),
                "leave out `trusted`: name what its containers need under `volumes`, `devices` or `capabilities`".to_owned(),
            );
        }
        for (key, span, is_given) in given {
            if is_given && trusted.value && image.is_none() {
                error(
                    span,
                    format!("`{key}` of a VNF that is trusted"),
                    "keep one of the two: what is trusted may do all that cotorra may".to_owned(),
                );
            }
            if is_given && key == "readable" && image.is_some() {
                error(
                    span,
                    "`readable` of a VNF with an image".to_owned(),
                    "name what its containers see under `volumes`, such as `volumes: [data:/data]`"
                        .to_owned(),
                );
            }
            if is_given && !runs_others {
                error(
                    span,
                    format!("what is bundled has no `{key}`"),
                    format!("leave out `{key}`: it has what it needs"),
                );
            }
        }
        if trusted.value && !runs_others {
            error(
                &trusted.span,
                "only a `command` can be trusted or not".to_owned(),
                "leave out `trusted`: what is bundled is cotorra itself".to_owned(),
            );
        }
        let readable = readable.value.iter().map(PathBuf::from).collect();
        let confined = Rights::Confined(Granted { capabilities: capabilities.value.clone(), readable });
        well.then_some(if trusted.value { Rights::Trusted } else { confined })
    }
}

/// Returns the share that is nearest to a percentage as it was written: 99.9 % is 0.999, so that 999 of 1000 samples keep it.
fn as_written(share: Probability) -> Probability {
    Probability::new((share.get() * 1e12).round() / 1e12).unwrap_or(share)
}
