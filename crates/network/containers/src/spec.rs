//! Turns VNFs into containers, as the engines' interface describes them.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use cotorra_engine::{Variable, replica_name};
use cotorra_graph::{Granted, LinuxCapability, NodeId, Program, Rights, Vnf};
use rustix::process::{Resource, getrlimit};

use crate::container::{Container, Device, HostConfig, Limits, LogConfig, Mount, Ulimit};

/// Label of all containers of cotorra, with the name of their run.
pub(crate) const RUN: &str = "cotorra.run";
/// Most processes and threads of one container.
const PROCESSES: i64 = 512;
/// Most open files of a process in a container.
const MOST_FILES: u64 = 1 << 16;
/// Most processes of the container's user on the whole machine. podman lowers its own limit to the kernel's default of process
/// IDs, 32,768.
const MOST_PROCESSES: u64 = 1 << 14;
/// Shortest CPU time per second of a container, ns. Engines take 0 for no limit.
const LEAST_CPU_NS: i64 = 10_000_000;

/// The network of a container.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Network {
    /// A network namespace, by a path at which the engine can open it.
    Namespace(PathBuf),
    /// That of the machine.
    Machine,
}

/// Specification of a container.
#[derive(Debug)]
pub(crate) struct Spec<'a> {
    pub(crate) vnf: &'a Vnf,
    pub(crate) replica: u32,
    pub(crate) node: &'a NodeId,
    /// The engine's word for its network.
    pub(crate) network: String,
    /// Host name; `None` if it is that of another container.
    pub(crate) hostname: Option<String>,
    pub(crate) environment: Vec<(String, String)>,
    /// Files that it reads, each with its path in the container.
    pub(crate) files: Vec<(PathBuf, PathBuf)>,
    /// Folder from which sources of volumes start.
    pub(crate) folder: &'a Path,
    /// Name of the run.
    pub(crate) run: &'a str,
}

impl Spec<'_> {
    /// Returns the container.
    ///
    /// # Errors
    /// The reason for which there can be none, for people.
    pub(crate) fn container(self) -> Result<Container, String> {
        let image = self.vnf.image.as_deref().ok_or("it has no image")?;
        let words = match &self.vnf.program {
            Program::Command(words) | Program::Host(words) if !words.is_empty() => Some(words.clone()),
            _ => None,
        };
        let volumes =
            image.volumes.iter().map(|v| Mount::bind(&self.folder.join(&v.source), &v.target, !v.writable));
        let files = self.files.iter().map(|(source, target)| Mount::bind(source, target, true));
        let devices = image.devices.iter().map(|device| {
            let path = device.to_string_lossy().into_owned();
            Device { path_on_host: path.clone(), path_in_container: path, cgroup_permissions: "rw" }
        });
        let memory = i64::try_from(self.vnf.memory_bytes).ok();
        let limits = Limits {
            nano_cpus: ((self.vnf.most_cpus() * 1e9) as i64).max(LEAST_CPU_NS),
            memory,
            memory_swap: memory,
            pids_limit: PROCESSES,
            init: image.init.then_some(true),
            devices: devices.collect(),
            security_opt: vec!["no-new-privileges".to_owned()],
            ulimits: ulimits(),
            log_config: LogConfig { r#type: "json-file" },
        };
        let host_config = HostConfig {
            network_mode: self.network,
            mounts: volumes.chain(files).collect(),
            cap_drop: vec!["ALL".to_owned()],
            cap_add: capabilities(&self.vnf.rights),
            limits: Some(limits),
        };
        Ok(Container {
            image: image.reference.clone(),
            cmd: words,
            entrypoint: None,
            env: environment(self.vnf, self.replica, self.node, self.environment),
            hostname: self.hostname,
            labels: labels(self.run, &replica_name(&self.vnf.id, self.replica), self.node),
            host_config,
        })
    }
}

/// Returns the labels of a container of a run.
pub(crate) fn labels(run: &str, vnf: &str, node: &NodeId) -> BTreeMap<String, String> {
    let labels = [(RUN, run), ("cotorra.vnf", vnf), ("cotorra.node", node.as_str())];
    labels.map(|(name, value)| (name.to_owned(), value.to_owned())).into()
}

/// Returns the variables of a container: those that its VNF names, then cotorra's.
fn environment(vnf: &Vnf, replica: u32, node: &NodeId, ours: Vec<(String, String)>) -> Vec<String> {
    let named = vnf.env.iter().map(|text| Variable::parse(text));
    let named = named.filter_map(|variable| Some(format!("{}={}", variable.name, variable.value()?)));
    let always = [
        ("COTORRA_VNF", vnf.id.to_string()),
        ("COTORRA_NODE", node.to_string()),
        ("COTORRA_REPLICA", replica.to_string()),
    ];
    let always = always.into_iter().map(|(name, value)| format!("{name}={value}"));
    named.chain(always).chain(ours.into_iter().map(|(name, value)| format!("{name}={value}"))).collect()
}

/// Returns the capabilities that a container keeps.
fn capabilities(rights: &Rights) -> Vec<String> {
    let Rights::Confined(Granted { capabilities, .. }) = rights else { return Vec::new() };
    let name = |capability: &LinuxCapability| match capability {
        LinuxCapability::NetBindService => "NET_BIND_SERVICE",
        LinuxCapability::NetBroadcast => "NET_BROADCAST",
        LinuxCapability::NetAdmin => "NET_ADMIN",
        LinuxCapability::NetRaw => "NET_RAW",
        LinuxCapability::IpcLock => "IPC_LOCK",
        LinuxCapability::SysNice => "SYS_NICE",
    };
    capabilities.iter().map(name).map(str::to_owned).collect()
}

/// Returns limits that are no higher than the engine's own. The defaults of engines may exceed them, and no container starts
/// where the engine has no right to raise a limit.
fn ulimits() -> Vec<Ulimit> {
    let of = |name, resource, most: u64| {
        let limit = getrlimit(resource);
        let value = |limit: Option<u64>| limit.unwrap_or(most).min(most);
        Ulimit { name, soft: value(limit.current), hard: value(limit.maximum) }
    };
    vec![of("nofile", Resource::Nofile, MOST_FILES), of("nproc", Resource::Nproc, MOST_PROCESSES)]
}

#[cfg(test)]
pub(crate) mod tests {
    use cotorra_graph::{Image, Volume};
    use serde_json::json;

    use super::*;

    pub(crate) fn vnf() -> Vnf {
        let image = Image {
            reference: "planner:1".to_owned(),
            volumes: vec![
                Volume { source: "maps".into(), target: "/maps".into(), writable: false },
                Volume { source: "/srv/out".into(), target: "/out".into(), writable: true },
            ],
            devices: vec!["/dev/null".into()],
            ..Image::default()
        };
        Vnf {
            id: "planner".parse().unwrap(),
            program: Program::Command(Vec::new()),
            cpus: 0.5,
            memory_bytes: 64 << 20,
            pinned_to: None,
            node: NodeId::new("edge").unwrap().into(),
            env: vec!["COTORRA_SURELY_UNSET".to_owned(), "MODE=fast".to_owned()],
            rights: Rights::Confined(Granted {
                capabilities: vec![LinuxCapability::NetRaw],
                readable: Vec::new(),
            }),
            keep: false,
            image: Some(Box::new(image)),
            cpu_limit: None,
            start: Default::default(),
            computing: None,
            state: None,
        }
    }

    fn container(vnf: &Vnf) -> Container {
        let spec = Spec {
            vnf,
            replica: 1,
            node: vnf.node.first(),
            network: "ns:/proc/1/fd/2".to_owned(),
            hostname: None,
            environment: vec![("COTORRA_PORT".to_owned(), "5000".to_owned())],
            files: vec![("/run/hosts".into(), "/etc/hosts".into())],
            folder: Path::new("/testbeds"),
            run: "7-1",
        };
        spec.container().unwrap()
    }

    #[test]
    fn a_container_has_no_rights_but_those_granted() {
        let config = serde_json::to_value(container(&vnf())).unwrap()["HostConfig"].take();
        assert_eq!(config["CapDrop"], json!(["ALL"]));
        assert_eq!(config["CapAdd"], json!(["NET_RAW"]));
        assert_eq!(config["SecurityOpt"], json!(["no-new-privileges"]));
        assert_eq!(["Privileged", "PidMode", "IpcMode"].map(|key| config.get(key)), [None; 3]);
        assert_eq!(config["NetworkMode"], "ns:/proc/1/fd/2");
    }

    #[test]
    fn limits_are_those_of_the_vnf() {
        let config = serde_json::to_value(container(&vnf())).unwrap()["HostConfig"].take();
        assert_eq!(config["NanoCpus"], 500_000_000);
        assert_eq!([&config["Memory"], &config["MemorySwap"]], [64 << 20, 64 << 20]);
        assert_eq!(config["PidsLimit"], PROCESSES);
        let limits = container(&Vnf { cpus: 0.0, ..vnf() }).host_config.limits.unwrap();
        assert_eq!(limits.nano_cpus, LEAST_CPU_NS, "engines take 0 for no limit");
    }

    #[test]
    fn volumes_start_from_the_testbed_files_folder_and_are_read_only() {
        let mounts = container(&vnf()).host_config.mounts;
        let mounts: Vec<_> =
            mounts.into_iter().map(|mount| (mount.source, mount.target, mount.read_only)).collect();
        let expected = [
            ("/testbeds/maps", "/maps", true),
            ("/srv/out", "/out", false),
            ("/run/hosts", "/etc/hosts", true),
        ];
        assert_eq!(mounts, expected.map(|(from, to, read)| (from.to_owned(), to.to_owned(), read)));
    }

    #[test]
    fn variables_are_those_named_and_cotorras() {
        let env = container(&vnf()).env;
        assert_eq!(
            env,
            [
                "MODE=fast",
                "COTORRA_VNF=planner",
                "COTORRA_NODE=edge",
                "COTORRA_REPLICA=1",
                "COTORRA_PORT=5000"
            ]
        );
    }

    #[test]
    fn without_words_the_image_has_its_own_command() {
        assert_eq!(container(&vnf()).cmd, None);
        let words = vec!["plan".to_owned(), "--fast".to_owned()];
        assert_eq!(container(&Vnf { program: Program::Command(words.clone()), ..vnf() }).cmd, Some(words));
        assert_eq!(container(&Vnf { program: Program::Navigation, ..vnf() }).cmd, None);
    }
}
