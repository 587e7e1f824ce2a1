//! Turns VNFs into containers, as the engines' interface describes them.

use std::{
    collections::HashMap,
    path::{Path, PathBuf},
};

use bollard::models::{
    ContainerCreateBody, DeviceMapping, HostConfig, HostConfigLogConfig, Mount, MountType, ResourcesUlimits,
};
use cotorra_engine::{Variable, replica_name};
use cotorra_graph::{Granted, LinuxCapability, NodeId, Program, Rights, Vnf};
use rustix::process::{Resource, getrlimit};

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

/// What a container is made from.
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
    pub(crate) fn container(self) -> Result<ContainerCreateBody, String> {
        let image = self.vnf.image.as_deref().ok_or("it has no image")?;
        let words = match &self.vnf.program {
            Program::Command(words) | Program::Host(words) if !words.is_empty() => Some(words.clone()),
            _ => None,
        };
        let bind = |source: &Path, target: &Path, read_only: bool| Mount {
            typ: Some(MountType::BIND),
            source: Some(source.to_string_lossy().into_owned()),
            target: Some(target.to_string_lossy().into_owned()),
            read_only: Some(read_only),
            ..Mount::default()
        };
        let volumes =
            image.volumes.iter().map(|v| bind(&self.folder.join(&v.source), &v.target, !v.writable));
        let files = self.files.iter().map(|(source, target)| bind(source, target, true));
        let devices = image.devices.iter().map(|device| {
            let path = Some(device.to_string_lossy().into_owned());
            let (path_on_host, path_in_container) = (path.clone(), path);
            DeviceMapping { path_on_host, path_in_container, cgroup_permissions: Some("rw".to_owned()) }
        });
        let config = HostConfig {
            network_mode: Some(self.network),
            nano_cpus: Some(((self.vnf.cpus * 1e9) as i64).max(LEAST_CPU_NS)),
            memory: i64::try_from(self.vnf.memory_bytes).ok(),
            memory_swap: i64::try_from(self.vnf.memory_bytes).ok(),
            pids_limit: Some(PROCESSES),
            init: image.init.then_some(true),
            mounts: Some(volumes.chain(files).collect()),
            devices: Some(devices.collect()),
            cap_drop: Some(vec!["ALL".to_owned()]),
            cap_add: Some(capabilities(&self.vnf.rights)),
            security_opt: Some(vec!["no-new-privileges".to_owned()]),
            ulimits: Some(limits()),
            log_config: Some(HostConfigLogConfig { typ: Some("json-file".to_owned()), config: None }),
            ..HostConfig::default()
        };
        Ok(ContainerCreateBody {
            image: Some(image.reference.clone()),
            cmd: words,
            env: Some(environment(self.vnf, self.replica, self.node, self.environment)),
            hostname: self.hostname,
            labels: Some(labels(self.run, &replica_name(&self.vnf.id, self.replica), self.node)),
            host_config: Some(config),
            ..ContainerCreateBody::default()
        })
    }
}

/// Returns the labels of a container of a run.
pub(crate) fn labels(run: &str, vnf: &str, node: &NodeId) -> HashMap<String, String> {
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
fn limits() -> Vec<ResourcesUlimits> {
    let of = |name: &str, resource, most: u64| {
        let limit = getrlimit(resource);
        let value = |limit: Option<u64>| i64::try_from(limit.unwrap_or(most).min(most)).ok();
        let (soft, hard) = (value(limit.current), value(limit.maximum));
        ResourcesUlimits { name: Some(name.to_owned()), soft, hard }
    };
    vec![of("nofile", Resource::Nofile, MOST_FILES), of("nproc", Resource::Nproc, MOST_PROCESSES)]
}

#[cfg(test)]
pub(crate) mod tests {
    use cotorra_graph::{Image, Volume};

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
        }
    }

    fn container(vnf: &Vnf) -> ContainerCreateBody {
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
        let config = container(&vnf()).host_config.unwrap();
        assert_eq!(config.cap_drop.unwrap(), ["ALL"]);
        assert_eq!(config.cap_add.unwrap(), ["NET_RAW"]);
        assert_eq!(config.security_opt.unwrap(), ["no-new-privileges"]);
        assert_eq!((config.privileged, config.pid_mode, config.ipc_mode), (None, None, None));
        assert_eq!(config.network_mode.unwrap(), "ns:/proc/1/fd/2");
    }

    #[test]
    fn limits_are_those_of_the_vnf() {
        let config = container(&vnf()).host_config.unwrap();
        assert_eq!(config.nano_cpus, Some(500_000_000));
        assert_eq!((config.memory, config.memory_swap), (Some(64 << 20), Some(64 << 20)));
        assert_eq!(config.pids_limit, Some(PROCESSES));
        let config = container(&Vnf { cpus: 0.0, ..vnf() }).host_config.unwrap();
        assert_eq!(config.nano_cpus, Some(LEAST_CPU_NS), "engines take 0 for no limit");
    }

    #[test]
    fn volumes_start_from_the_testbed_files_folder_and_are_read_only() {
        let mounts = container(&vnf()).host_config.unwrap().mounts.unwrap();
        let mounts: Vec<_> = mounts
            .into_iter()
            .map(|mount| (mount.source.unwrap(), mount.target.unwrap(), mount.read_only.unwrap()))
            .collect();
        let expected = [
            ("/testbeds/maps", "/maps", true),
            ("/srv/out", "/out", false),
            ("/run/hosts", "/etc/hosts", true),
        ];
        assert_eq!(mounts, expected.map(|(from, to, read)| (from.to_owned(), to.to_owned(), read)));
    }

    #[test]
    fn variables_are_those_named_and_cotorras() {
        let env = container(&vnf()).env.unwrap();
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
