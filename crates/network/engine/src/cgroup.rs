//! Limits VNFs in CPU, memory and processes by cgroups, version 2 or 1, if this process may create them.
//!
//! A run's groups are named `cotorra-<pid>/<instance>`, or `cotorra-<pid>/node-<node>/<instance>` if the instances of a node
//! share its CPUs. The leftovers of a killed run can therefore be found: their process no longer exists. They are at the
//! root of the hierarchy, which root may change, or in a group that systemd delegated to the run's user.

use std::{
    collections::BTreeMap,
    fs, io,
    iter::successors,
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
    thread,
    time::Duration,
};

use cotorra_graph::NodeId;

use crate::engine::InstanceId;

const ROOT: &str = "/sys/fs/cgroup";
const PREFIX: &str = "cotorra-";
/// The file of version 2 that passes controllers on to the groups in a group.
const SUBTREE_CONTROL: &str = "cgroup.subtree_control";
/// Name of the group of cotorra itself among those of a run in a delegated group.
const CORE: &str = "core";
const CPU_PERIOD_US: f64 = 100_000.0;
/// Period of limits where instances share their node's CPUs. The shorter it is, the less they use more CPUs than they have
/// at a time, and then stand still.
const SHARED_CPU_PERIOD_US: f64 = 10_000.0;
/// Least quota of a period that the kernel takes.
const LEAST_QUOTA_US: f64 = 1000.0;
/// Most time of a run's real-time threads per second, µs. The kernel has 950,000 for all groups together, and other runs
/// need their share.
const REAL_TIME_US: u64 = 100_000;
/// Most time of one VNF's real-time threads per second, µs. This is too little to block others, and many times what answers
/// take. A group that used up its time stands still for the rest of the second.
const VNF_REAL_TIME_US: u64 = 20_000;
/// Most processes and threads of one VNF.
const PROCESSES: u32 = 512;
/// Attempts to remove a group while its processes are ending.
const REMOVAL_ATTEMPTS: u32 = 300;
/// Time between two attempts.
const REMOVAL_INTERVAL: Duration = Duration::from_millis(10);

/// An error in creating, changing or removing a group.
#[derive(Debug, thiserror::Error)]
#[error("{what} {}: {source}", path.display())]
pub struct CgroupError {
    what: &'static str,
    path: PathBuf,
    source: io::Error,
}

fn at(what: &'static str, path: &Path) -> impl FnOnce(io::Error) -> CgroupError {
    let path = path.to_owned();
    move |source| CgroupError { what, path, source }
}

/// The hierarchy of controllers on this machine.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Hierarchy {
    /// One tree with all controllers.
    V2(PathBuf),
    /// One tree per controller. Few machines lack the one for processes.
    V1 { cpu: PathBuf, memory: PathBuf, pids: Option<PathBuf> },
}

impl Hierarchy {
    fn find(root: &Path) -> Option<Self> {
        if has_controllers(&root.join(SUBTREE_CONTROL)) {
            return Some(Self::V2(root.to_owned()));
        }
        let (cpu, memory) = (root.join("cpu"), root.join("memory"));
        let both = cpu.join("cpu.cfs_quota_us").exists() || cpu.join("cgroup.procs").exists();
        let pids = Some(root.join("pids")).filter(|pids| pids.join("cgroup.procs").exists());
        (both && memory.join("cgroup.procs").exists()).then_some(Self::V1 { cpu, memory, pids })
    }

    fn trees(&self) -> Vec<&Path> {
        match self {
            Self::V2(root) => vec![root],
            Self::V1 { cpu, memory, pids } => {
                [cpu, memory].into_iter().chain(pids).map(|tree| &**tree).collect()
            }
        }
    }
}

/// The groups of one run.
#[derive(Debug)]
pub struct Cgroups {
    hierarchy: Hierarchy,
    name: String,
    /// CPUs of the nodes whose instances share them.
    shared: BTreeMap<NodeId, f64>,
}

impl Cgroups {
    /// Creates this process's groups: at the root, or else in the group of this process, if that was delegated to its user.
    ///
    /// # Errors
    /// [`CgroupError`] if there are no controllers, or this user may not create groups.
    pub fn new() -> Result<Self, CgroupError> {
        let root = Path::new(ROOT);
        Self::under(root).or_else(|error| match own_group(root) {
            Some(own) if own != root => Self::delegated(&own)?.ok_or(error),
            _ => Err(error),
        })
    }

    /// Creates the groups in a group of version 2 that holds this process, as systemd delegates one with `Delegate=yes`.
    /// `None` if it is not this user's.
    ///
    /// Groups that pass controllers on hold no processes, so this process and those that it has started move into a group
    /// beside those of its VNFs. systemd removes all with its own.
    fn delegated(own: &Path) -> Result<Option<Self>, CgroupError> {
        let core = own.join(format!("{PREFIX}{}", std::process::id())).join(CORE);
        if !has_controllers(&own.join("cgroup.controllers")) || fs::create_dir_all(&core).is_err() {
            return Ok(None);
        }
        let move_to = |group: &Path| {
            let procs = group.join("cgroup.procs");
            let join = |pid: u32| fs::write(&procs, pid.to_string());
            own_processes()
                .into_iter()
                .try_for_each(join)
                .map_err(at("move cotorra into the group of", &procs))
        };
        let control = own.join(SUBTREE_CONTROL);
        let pass_on = || fs::write(&control, "+cpu +memory").map_err(at("pass controllers on in", &control));
        if let Err(error) = move_to(&core).and_then(|()| pass_on()) {
            let _ = move_to(own);
            let _ = core.parent().map(remove_group);
            return Err(error);
        }
        let _ = fs::write(&control, "+pids");
        Self::under(own).map(Some)
    }

    fn under(root: &Path) -> Result<Self, CgroupError> {
        let missing = || io::Error::new(io::ErrorKind::NotFound, "no cpu and memory controllers");
        let hierarchy =
            Hierarchy::find(root).ok_or_else(missing).map_err(at("look for controllers in", root))?;
        let name = format!("{PREFIX}{}", std::process::id());
        let groups = Self { hierarchy, name, shared: BTreeMap::new() };
        groups.paths().iter().try_for_each(|path| groups.make_parent(path))?;
        if let Hierarchy::V1 { cpu, .. } = &groups.hierarchy {
            allow_real_time(&cpu.join(&groups.name), REAL_TIME_US);
        }
        Ok(groups)
    }

    /// Lets the instances on each of these nodes share so many CPUs, above 0, from their next start on.
    #[must_use]
    pub fn with_shared_cpus(mut self, shared: BTreeMap<NodeId, f64>) -> Self {
        self.shared = shared;
        self
    }

    /// Makes a group that has groups in it.
    fn make_parent(&self, path: &Path) -> Result<(), CgroupError> {
        fs::create_dir_all(path).map_err(at("make the cgroup", path))?;
        if matches!(self.hierarchy, Hierarchy::V2(_)) {
            let control = path.join(SUBTREE_CONTROL);
            fs::write(&control, "+cpu +memory").map_err(at("pass controllers on in", &control))?;
            if let Err(error) = fs::write(&control, "+pids") {
                tracing::info!("VNFs may have any number of processes: {}: {error}", control.display());
            }
        }
        Ok(())
    }

    /// Returns the group in which a node's instances are, in a tree.
    fn parent(&self, tree: &Path, node: &NodeId) -> PathBuf {
        let run = tree.join(&self.name);
        if self.shared.contains_key(node) { run.join(format!("node-{node}")) } else { run }
    }

    fn group(&self, tree: &Path, node: &NodeId, instance: InstanceId) -> PathBuf {
        self.parent(tree, node).join(instance.0.to_string())
    }

    /// Limits the CPUs of a group.
    fn limit_cpus(&self, group: &Path, cpus: f64, period_us: f64) -> Result<(), CgroupError> {
        let quota = (cpus * period_us).max(LEAST_QUOTA_US) as u64;
        match self.hierarchy {
            Hierarchy::V2(_) => set(group.join("cpu.max"), format!("{quota} {period_us}")),
            Hierarchy::V1 { .. } => {
                set(group.join("cpu.cfs_period_us"), format!("{period_us}"))?;
                set(group.join("cpu.cfs_quota_us"), quota.to_string())
            }
        }
    }

    /// Makes the group of a node whose instances share its CPUs. Groups in it have equal weights, so that each gets what it
    /// wants, or as much as any other.
    fn make_node(&self, node: &NodeId, cpus: f64) -> Result<(), CgroupError> {
        for tree in self.hierarchy.trees() {
            self.make_parent(&self.parent(tree, node))?;
        }
        let (Hierarchy::V2(cpu) | Hierarchy::V1 { cpu, .. }) = &self.hierarchy;
        let group = self.parent(cpu, node);
        self.limit_cpus(&group, cpus, period_us(cpus))?;
        allow_real_time(&group, VNF_REAL_TIME_US);
        Ok(())
    }

    fn paths(&self) -> Vec<PathBuf> {
        self.hierarchy.trees().into_iter().map(|tree| tree.join(&self.name)).collect()
    }

    /// Creates an instance's group with its limits. Returns the `cgroup.procs` files to write its process to.
    ///
    /// # Errors
    /// [`CgroupError`] if the kernel rejects the group or a limit.
    pub fn limit(
        &self,
        instance: InstanceId,
        node: &NodeId,
        cpus: f64,
        memory_bytes: u64,
    ) -> Result<Vec<PathBuf>, CgroupError> {
        let (cpus, period_us) = match self.shared.get(node) {
            Some(&all) => {
                self.make_node(node, all)?;
                // Version 1 rejects a limit above that of the group around it.
                let cpus = cpus.min(all);
                (cpus, period_us(cpus))
            }
            None => (cpus, CPU_PERIOD_US),
        };
        let mut procs = Vec::new();
        for path in self.hierarchy.trees().into_iter().map(|tree| self.group(tree, node, instance)) {
            fs::create_dir_all(&path).map_err(at("make the cgroup", &path))?;
            procs.push(path.join("cgroup.procs"));
        }
        match &self.hierarchy {
            Hierarchy::V2(root) => {
                let group = self.group(root, node, instance);
                self.limit_cpus(&group, cpus, period_us)?;
                set(group.join("memory.max"), memory_bytes.to_string())?;
                if group.join("memory.swap.max").exists() {
                    set(group.join("memory.swap.max"), "0".to_owned())?;
                }
                if group.join("pids.max").exists() {
                    set(group.join("pids.max"), PROCESSES.to_string())?;
                }
            }
            Hierarchy::V1 { cpu, memory, pids } => {
                let group = |tree: &Path| self.group(tree, node, instance);
                self.limit_cpus(&group(cpu), cpus, period_us)?;
                allow_real_time(&group(cpu), VNF_REAL_TIME_US);
                set(group(memory).join("memory.limit_in_bytes"), memory_bytes.to_string())?;
                if let Some(pids) = pids {
                    set(group(pids).join("pids.max"), PROCESSES.to_string())?;
                }
            }
        }
        Ok(procs)
    }

    /// Returns the files with the times for which limits of the processor kept an instance from running: its own, and that
    /// of its node.
    pub(crate) fn cpu_stats(&self, instance: InstanceId, node: &NodeId) -> Vec<PathBuf> {
        let (Hierarchy::V2(tree) | Hierarchy::V1 { cpu: tree, .. }) = &self.hierarchy;
        let of_node = self.shared.contains_key(node).then(|| self.parent(tree, node));
        let groups = [self.group(tree, node, instance)].into_iter().chain(of_node);
        groups.map(|group| group.join("cpu.stat")).collect()
    }

    /// Removes an instance's group. Leaves one that still has processes to [`Cgroups::clean`].
    pub fn release(&self, instance: InstanceId, node: &NodeId) {
        for tree in self.hierarchy.trees() {
            let _ = fs::remove_dir(self.group(tree, node, instance));
        }
    }

    /// Removes the groups of runs whose process no longer exists, and waits for the end of processes in them. Returns the
    /// removed groups, and the errors of others.
    pub fn clean() -> (Vec<PathBuf>, Vec<CgroupError>) {
        let (mut removed, mut kept) = (Vec::new(), Vec::new());
        for group in Self::leftovers() {
            match remove_when_empty(&group) {
                Ok(()) => removed.push(group),
                Err(error) => kept.push(error),
            }
        }
        (removed, kept)
    }

    /// Returns the groups that [`Self::clean`] would remove.
    pub fn leftovers() -> Vec<PathBuf> {
        Self::leftovers_under(Path::new(ROOT), lives)
    }

    fn leftovers_under(root: &Path, lives: impl Fn(u32) -> bool) -> Vec<PathBuf> {
        let Some(hierarchy) = Hierarchy::find(root) else { return Vec::new() };
        let groups = hierarchy.trees().into_iter().flat_map(fs::read_dir).flatten().flatten();
        // Other users remove their own groups.
        let user = fs::metadata("/proc/self").map(|own| own.uid()).ok();
        let is_ours = |group: &fs::DirEntry| group.metadata().is_ok_and(|found| Some(found.uid()) == user);
        let is_left = |group: &fs::DirEntry| {
            let name = group.file_name();
            let pid =
                name.to_str().and_then(|name| name.strip_prefix(PREFIX)).and_then(|pid| pid.parse().ok());
            pid.is_some_and(|pid| !lives(pid)) && is_ours(group)
        };
        groups.filter(is_left).map(|group| group.path()).collect()
    }
}

fn set(path: PathBuf, value: String) -> Result<(), CgroupError> {
    fs::write(&path, value).map_err(at("set the limit in", &path))
}

/// Returns the period of a limit where instances share their node's CPUs.
fn period_us(cpus: f64) -> f64 {
    if cpus * SHARED_CPU_PERIOD_US >= LEAST_QUOTA_US { SHARED_CPU_PERIOD_US } else { CPU_PERIOD_US }
}

/// Whether a file of version 2 lists the controllers that limits need.
fn has_controllers(list: &Path) -> bool {
    let list = fs::read_to_string(list).unwrap_or_default();
    ["cpu", "memory"].iter().all(|needed| list.split_whitespace().any(|has| has == *needed))
}

/// Returns this process's group of version 2.
fn own_group(root: &Path) -> Option<PathBuf> {
    let groups = fs::read_to_string("/proc/self/cgroup").ok()?;
    groups.lines().find_map(|line| line.strip_prefix("0::/")).map(|path| root.join(path))
}

/// Returns this process, and all that descend from it.
fn own_processes() -> Vec<u32> {
    let parent = |pid: u32| -> Option<u32> {
        let stat = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
        stat.rsplit(')').next()?.split_whitespace().nth(1)?.parse().ok()
    };
    let own = std::process::id();
    let all = fs::read_dir("/proc").into_iter().flatten().flatten();
    let all = all.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    let descends = |pid: &u32| successors(Some(*pid), |pid| parent(*pid)).any(|pid| pid == own);
    all.filter(descends).collect()
}

/// Allows real-time threads in a group. Version 1 forbids them by default if the kernel counts their time. If the kernel
/// rejects this, VNFs that ask for real-time priority are scheduled like all others.
fn allow_real_time(group: &Path, runtime_us: u64) {
    let runtime = group.join("cpu.rt_runtime_us");
    if !runtime.exists() {
        return;
    }
    if let Err(error) = fs::write(&runtime, runtime_us.to_string()) {
        tracing::debug!("no real-time threads in {}: {error}", group.display());
    }
}

/// Whether a process exists. Zombies do not count.
fn lives(pid: u32) -> bool {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat"));
    stat.is_ok_and(|stat| !stat.rsplit(')').next().unwrap_or_default().trim_start().starts_with(['Z', 'X']))
}

fn remove_group(group: &Path) -> io::Result<()> {
    for child in fs::read_dir(group)?.flatten() {
        if child.file_type().is_ok_and(|t| t.is_dir()) {
            remove_group(&child.path())?;
        }
    }
    fs::remove_dir(group)
}

/// Removes a group whose processes are ending because their run has ended.
#[allow(clippy::disallowed_methods, reason = "version 1 has no notification of empty groups")]
fn remove_when_empty(group: &Path) -> Result<(), CgroupError> {
    use io::ErrorKind::{NotFound, ResourceBusy};
    for _ in 0..REMOVAL_ATTEMPTS {
        match remove_group(group) {
            // Another process has removed it.
            Err(_) if !group.exists() => return Ok(()),
            Err(error) if matches!(error.kind(), ResourceBusy | NotFound) => thread::sleep(REMOVAL_INTERVAL),
            done => return done.map_err(at("remove the cgroup", group)),
        }
    }
    remove_group(group).map_err(at("remove the cgroup of a killed run, in which processes still end,", group))
}

impl Drop for Cgroups {
    fn drop(&mut self) {
        for path in self.paths() {
            // The next run removes groups whose processes still end.
            let _ = remove_group(&path);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn node(name: &str) -> NodeId {
        NodeId::new(name).unwrap()
    }

    /// A folder with the layout of a v1 hierarchy.
    fn v1() -> tempfile::TempDir {
        let root = tempfile::tempdir().unwrap();
        for tree in ["cpu", "memory", "pids"] {
            fs::create_dir(root.path().join(tree)).unwrap();
            fs::write(root.path().join(tree).join("cgroup.procs"), "").unwrap();
        }
        root
    }

    #[test]
    fn limits_are_written_to_the_files_of_version_1() {
        let root = v1();
        let groups = Cgroups::under(root.path()).unwrap();
        let procs = groups.limit(InstanceId(7), &node("edge"), 1.5, 1 << 20).unwrap();
        assert_eq!(procs.len(), 3);
        let read = |file: &str| {
            let group = format!("{PREFIX}{}/7", std::process::id());
            let (tree, file) = file.split_once('/').unwrap();
            fs::read_to_string(root.path().join(tree).join(group).join(file)).unwrap()
        };
        assert_eq!(read("cpu/cpu.cfs_quota_us"), "150000");
        assert_eq!(read("memory/memory.limit_in_bytes"), "1048576");
        assert_eq!(read("pids/pids.max"), "512");
    }

    #[test]
    fn instances_on_a_node_with_shared_cpus_are_in_its_group() {
        let root = v1();
        let shared = BTreeMap::from([(node("edge"), 1.0)]);
        let groups = Cgroups::under(root.path()).unwrap().with_shared_cpus(shared);
        let run = root.path().join("cpu").join(format!("{PREFIX}{}", std::process::id()));
        let read = |file: &str| fs::read_to_string(run.join(file)).unwrap();
        for (instance, on, cpus) in [(1, "edge", 0.03), (2, "edge", 4.0), (3, "cloud", 4.0)] {
            groups.limit(InstanceId(instance), &node(on), cpus, 1 << 20).unwrap();
        }
        let quota = |group: &str| {
            [read(&format!("{group}/cpu.cfs_quota_us")), read(&format!("{group}/cpu.cfs_period_us"))]
        };
        assert_eq!(quota("node-edge"), ["10000", "10000"]);
        assert_eq!(quota("node-edge/1"), ["3000", "100000"], "the kernel takes no less than 1 ms");
        assert_eq!(quota("node-edge/2"), ["10000", "10000"], "no more than the node has");
        assert_eq!(quota("3"), ["400000", "100000"]);
        let stats = groups.cpu_stats(InstanceId(2), &node("edge"));
        assert_eq!(stats, ["node-edge/2", "node-edge"].map(|group| run.join(group).join("cpu.stat")));
        assert_eq!(groups.cpu_stats(InstanceId(3), &node("cloud")), [run.join("3/cpu.stat")]);
    }

    #[test]
    fn groups_of_nodes_are_removed_with_those_in_them() {
        let root = v1();
        let group = root.path().join(format!("cpu/{PREFIX}11"));
        fs::create_dir_all(group.join("node-edge/1")).unwrap();
        remove_when_empty(&group).unwrap();
        assert!(!group.exists());
    }

    #[test]
    fn only_groups_of_ended_processes_are_removed() {
        let root = v1();
        for pid in [11, 12] {
            fs::create_dir_all(root.path().join(format!("cpu/{PREFIX}{pid}/1"))).unwrap();
        }
        fs::create_dir(root.path().join("cpu/somebody-elses")).unwrap();
        let left = Cgroups::leftovers_under(root.path(), |pid| pid == 12);
        assert_eq!(left, [root.path().join(format!("cpu/{PREFIX}11"))]);
        remove_when_empty(&left[0]).unwrap();
        assert!(root.path().join(format!("cpu/{PREFIX}12/1")).exists());
        assert!(root.path().join("cpu/somebody-elses").exists());
    }

    #[test]
    fn a_group_that_cannot_be_removed_is_reported_with_the_reason() {
        let root = v1();
        let group = root.path().join("cpu/cotorra-11");
        fs::create_dir(&group).unwrap();
        fs::write(group.join("tasks"), "12").unwrap();
        let error = remove_when_empty(&group).unwrap_err().to_string();
        assert!(error.contains("cotorra-11") && error.contains("not empty"), "{error}");
    }

    #[test]
    fn removal_by_another_process_is_no_error() {
        let root = v1();
        remove_when_empty(&root.path().join("cpu/cotorra-11")).unwrap();
    }

    #[test]
    fn zombies_do_not_count_as_processes() {
        let mut child = std::process::Command::new("sleep").arg("1000").spawn().unwrap();
        assert!(lives(child.id()));
        child.kill().unwrap();
        while lives(child.id()) {
            thread::yield_now();
        }
        assert!(Path::new("/proc").join(child.id().to_string()).exists());
        child.wait().unwrap();
    }

    #[test]
    fn missing_controllers_are_reported() {
        let root = tempfile::tempdir().unwrap();
        let error = Cgroups::under(root.path()).unwrap_err().to_string();
        assert!(error.contains("no cpu and memory controllers"), "{error}");
    }
}
