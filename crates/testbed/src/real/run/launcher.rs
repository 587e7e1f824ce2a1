//! Starts VNFs as processes in the nodes of a datapath.

use std::{
    collections::BTreeMap,
    io,
    path::PathBuf,
    process::{ChildStdout, Command, ExitStatus},
    sync::{Arc, mpsc::Sender},
};

use cotorra_datapath::{Child, Datapath, SpawnOptions};
use cotorra_engine::{Launcher, Process, program_of, program_of_others};
use cotorra_graph::{NodeId, Program, Service, Testbed, Vnf, VnfId};
use cotorra_plugin::wire;

use crate::{api::Applications, core::message::Message, real::confined::Confined};

/// Starts VNFs as processes in the nodes of a datapath.
pub(super) struct NodeLauncher {
    testbed: Arc<Testbed>,
    datapath: Arc<Datapath>,
    testbed_file: PathBuf,
    seed: u64,
    confined: Confined,
    robots: BTreeMap<VnfId, NodeId>,
    messages: Sender<Message>,
    applications: Applications,
}

impl NodeLauncher {
    pub(super) fn new(
        testbed: Arc<Testbed>,
        datapath: Arc<Datapath>,
        testbed_file: PathBuf,
        seed: u64,
        confined: Confined,
        messages: Sender<Message>,
        applications: Applications,
    ) -> Self {
        let robots = robots_by_vnf(&testbed);
        Self { testbed, datapath, testbed_file, seed, confined, robots, messages, applications }
    }
}

/// Returns the robot that each VNF of a service serves.
pub(super) fn robots_by_vnf(testbed: &Testbed) -> BTreeMap<VnfId, NodeId> {
    let of_service = |service: &Service| {
        let robot = service.robot.clone();
        service.vnfs.iter().map(move |vnf| (vnf.id.clone(), robot.clone())).collect::<Vec<_>>()
    };
    testbed.services.iter().flat_map(of_service).collect()
}

impl Launcher for NodeLauncher {
    fn launch(
        &self,
        vnf: &Vnf,
        replica: u32,
        node: &NodeId,
        mut command: Command,
        cgroups: Vec<PathBuf>,
    ) -> io::Result<Box<dyn Process>> {
        command.envs(self.testbed.graph.ros1_environment(node));
        command.envs(self.applications.environment(&vnf.id, node)?);
        if matches!(vnf.program, Program::Command(_)) {
            if let Some(folder) = self.confined.folder(vnf) {
                command.current_dir(folder);
            }
            // A VNF that receives images listens there.
            command
                .envs(wire::port(&self.testbed, &vnf.id).map(|port| (cotorra_vnfs::PORT, port.to_string())));
        }
        let confinement = self.confined.of(vnf, replica)?;
        let options = SpawnOptions { cgroups, confinement: confinement.as_ref(), ..SpawnOptions::default() };
        let child = self.datapath.spawn(node, command, options).map_err(io::Error::other)?;
        Ok(Box::new(NodeProcess(child)))
    }

    fn command(&self, vnf: &Vnf, _replica: u32, _node: &NodeId) -> Result<Command, String> {
        if let Program::Command(words) = &vnf.program {
            return program_of(words, &vnf.env);
        }
        let word = match vnf.program {
            Program::Localization => "localization",
            Program::RosNavigation => "ros-navigation",
            Program::PolicyServer(_) => return Err("a policy server runs in virtual time only".to_owned()),
            _ => "navigation",
        };
        // The file of this process, even if it was replaced on the disk since.
        let mut command = program_of_others("/proc/self/exe", &[]);
        command.args(["vnf", word]).env(cotorra_vnfs::TESTBED, &self.testbed_file);
        command.env(cotorra_vnfs::SEED, self.seed.to_string());
        if let Some(robot) = self.robots.get(&vnf.id) {
            command.env(cotorra_vnfs::ROBOT, robot.as_str());
        }
        if let Some(port) = wire::port(&self.testbed, &vnf.id) {
            command.env(cotorra_vnfs::PORT, port.to_string());
        }
        Ok(command)
    }

    fn wake(&self) {
        let _ = self.messages.send(Message::Wake);
    }
}

/// A process in a node.
pub(super) struct NodeProcess(pub(super) Child);

impl Process for NodeProcess {
    fn try_wait(&mut self) -> io::Result<Option<ExitStatus>> {
        self.0.try_wait()
    }

    fn terminate(&mut self) {
        if let Err(error) = self.0.terminate() {
            tracing::warn!("{error}");
        }
    }

    fn kill(&mut self) {
        if let Err(error) = self.0.kill() {
            tracing::warn!("cannot kill a node's process: {error}");
        }
    }

    fn stdout(&mut self) -> Option<ChildStdout> {
        self.0.pipes().1
    }

    fn id(&self) -> Option<u32> {
        Some(self.0.id())
    }
}
