//! Tests what this machine allows, in ways that leave nothing behind. `cotorra doctor` prints the results.

use std::{
    fs::{self, OpenOptions},
    io,
    os::fd::AsFd,
    path::Path,
};

use cotorra_graph::HostAddress;

use crate::{
    namespace::{Namespace, on_a_thread},
    neighbours,
    netlink::{self, Netlink},
    privilege, sys,
};

/// Something that a machine may be able to do.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Capability {
    pub name: &'static str,
    /// cotorra's use of it.
    pub purpose: &'static str,
    pub state: CapabilityState,
}

/// Result of testing a capability.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CapabilityState {
    /// Available, with details for display, which may be empty.
    Available(String),
    /// It could not be tried out.
    Unknown {
        reason: String,
        /// Advice to find out.
        trial: &'static str,
    },
    Missing {
        reason: String,
        /// Advice to make it available.
        remedy: &'static str,
    },
}

impl CapabilityState {
    fn of(result: io::Result<String>, remedy: &'static str) -> Self {
        match result {
            Ok(detail) => Self::Available(detail),
            Err(e) => Self::Missing { reason: e.to_string(), remedy },
        }
    }

    pub fn is_available(&self) -> bool {
        matches!(self, Self::Available(_))
    }
}

fn capability(
    name: &'static str,
    purpose: &'static str,
    result: io::Result<String>,
    remedy: &'static str,
) -> Capability {
    Capability { name, purpose, state: CapabilityState::of(result, remedy) }
}

/// Tests all capabilities. Call it after [`crate::enter_user_namespace_if_needed`], whose rights it uses.
pub fn probe() -> Vec<Capability> {
    vec![
        capability(
            "network namespaces",
            "one for each host: required",
            network_namespaces(),
            "run as root, or allow user namespaces: sysctl kernel.unprivileged_userns_clone=1 (Debian), \
             kernel.apparmor_restrict_unprivileged_userns=0 (Ubuntu), user.max_user_namespaces=10000",
        ),
        capability(
            "user namespaces",
            "emulation as an ordinary user",
            sys::try_unshare(libc::CLONE_NEWUSER).map(|()| String::new()),
            "run as root, or allow them: sysctl kernel.unprivileged_userns_clone=1, user.max_user_namespaces=10000",
        ),
        capability(
            "process and mount namespaces",
            "programs in nodes end with the run and see node names",
            process_namespaces(),
            "run as root, or allow user namespaces",
        ),
        capability(
            "TAP with offloads",
            "faster ports",
            tap(),
            "not needed: ports are packet sockets then; otherwise run as root, or `chmod 0666 /dev/net/tun` \
             (in a container: `--device /dev/net/tun`)",
        ),
        capability(
            "packet sockets with offloads",
            "ports without /dev/net/tun",
            packet_sockets(),
            "load the module veth: `modprobe veth`",
        ),
        capability(
            "real-time scheduling",
            "packets leave on time on a busy machine",
            on_a_thread(|| sys::set_fifo(1)).map(|()| "SCHED_FIFO".into()),
            "run as root, or grant it: `setcap cap_sys_nice+ep` on the program, or rtprio in limits.conf",
        ),
        capability(
            "spare core",
            "packets leave on time to the microsecond",
            spare_core(),
            "give the machine more than two cores; the run report says what lateness it had",
        ),
        capability(
            "neighbour table",
            "nodes of large testbeds find each other",
            neighbour_table(),
            "packets to neighbours beyond it are lost, and all namespaces of this machine share it; as root: \
             `sysctl -w net.ipv4.neigh.default.gc_thresh3=4096 net.ipv6.neigh.default.gc_thresh3=4096`",
        ),
        capability(
            "NetEm",
            "emulation on real links by the kernel",
            netem(),
            "not needed for emulated links; otherwise `modprobe sch_netem`, from linux-modules-extra or similar",
        ),
        simulated_radios(),
        capability(
            "control groups",
            "limits on CPU and memory of programs in nodes",
            control_groups(),
            "not needed: programs run without limits then; otherwise run as root, or in a delegated group: \
             `systemd-run --user --scope -p Delegate=yes …`",
        ),
    ]
}

/// Tests what confines programs of others. Call it after [`crate::enter_user_namespace_if_needed`], whose rights it uses.
pub fn probe_confinement() -> Vec<Capability> {
    vec![
        capability(
            "process and mount namespaces",
            "VNFs see their node and named files only, and end with the run",
            process_namespaces(),
            "run as root, or allow user namespaces",
        ),
        capability(
            "a user of its own",
            "VNFs read what all users may, and nothing of the user who starts the run",
            own_user(),
            "run as root: an ordinary user cannot become another one; VNFs are then kept from your files by what they are shown",
        ),
        capability(
            "Landlock",
            "files stay closed to VNFs even if a mount can be circumvented",
            landlock(),
            "not needed: mounts close them; otherwise a kernel from 5.13 on with CONFIG_SECURITY_LANDLOCK, and `landlock` in lsm=",
        ),
        capability(
            "control groups",
            "limits on CPU, memory and processes of each VNF",
            control_groups(),
            "run as root, or in a delegated group: `systemd-run --user --scope -p Delegate=yes …`; else limits are those of \
             single processes",
        ),
    ]
}

fn own_user() -> io::Result<String> {
    if privilege::is_root() {
        Ok("as root".into())
    } else {
        Err(io::Error::other("this is an ordinary user"))
    }
}

fn landlock() -> io::Result<String> {
    match sys::Access::new()? {
        Some(_) => Ok(String::new()),
        None => Err(io::Error::other("this kernel has no Landlock")),
    }
}

/// Tests whether this kernel can simulate Wi-Fi radios. Unlike [`probe`], it starts no threads.
pub fn simulated_radios() -> Capability {
    let remedy = "not needed for emulated radio; otherwise a kernel with the module, such as Debian's linux-image-amd64, and \
                  `modprobe mac80211_hwsim`";
    Capability {
        name: "mac80211_hwsim",
        purpose: "simulated Wi-Fi hardware for real hostapd and wpa_supplicant",
        state: CapabilityState::of(hwsim(), remedy),
    }
}

fn network_namespaces() -> io::Result<String> {
    on_a_thread(Namespace::enter_new)?;
    Ok(if sys::effective_ids().0 == 0 && fs::read_to_string("/proc/self/uid_map")?.contains("4294967295") {
        "as root".into()
    } else {
        "in a user namespace".into()
    })
}

fn process_namespaces() -> io::Result<String> {
    sys::try_unshare(libc::CLONE_NEWPID | libc::CLONE_NEWNS).map(|()| String::new())
}

fn tap() -> io::Result<String> {
    on_a_thread(|| {
        Namespace::enter_new()?;
        let device = OpenOptions::new().read(true).write(true).open("/dev/net/tun")?;
        sys::make_tap(&device, c"probe").map(|()| String::new())
    })
}

fn packet_sockets() -> io::Result<String> {
    on_a_thread(|| {
        let outside = Namespace::enter_new()?;
        Namespace::enter_new()?;
        sys::packet_socket(1, 1 << 20)?;
        Netlink::open()?.execute(vec![netlink::veth("probe", "peer", 100, outside.as_fd())])?;
        Ok(String::new())
    })
}

fn spare_core() -> io::Result<String> {
    let cores = std::thread::available_parallelism()?.get();
    let cores_are = format!("{cores} cores");
    if crate::punctual::can_spare_a_core() { Ok(cores_are) } else { Err(io::Error::other(cores_are)) }
}

fn netem() -> io::Result<String> {
    const LOOPBACK: u32 = 1;
    on_a_thread(|| {
        Namespace::enter_new()?;
        match Netlink::open()?.execute(vec![netlink::netem(LOOPBACK)]) {
            Err(e) if e.raw_os_error() == Some(libc::ENOENT) => {
                Err(io::Error::other("this kernel has no sch_netem and cannot load it"))
            }
            result => result.map(|()| String::new()),
        }
    })
}

fn neighbour_table() -> io::Result<String> {
    const BRIDGE: u32 = 100;
    on_a_thread(|| {
        Namespace::enter_new()?;
        let HostAddress { ipv4, mac, .. } = HostAddress::of(0);
        let known = netlink::neighbour(BRIDGE, ipv4.into(), mac);
        Netlink::open()?.execute(vec![netlink::bridge("probe", BRIDGE), known])
    })
    .map_err(|error| io::Error::other(format!("the kernel makes no permanent entries: {error}")))?;
    match neighbours::limit() {
        Ok(limit) if limit < neighbours::USUAL_LIMIT => {
            Err(io::Error::other(format!("it has room for {limit} entries beside permanent ones")))
        }
        Ok(limit) => Ok(format!("{limit} entries beside permanent ones")),
        Err(_) => Ok("its size is not shown here".into()),
    }
}

fn hwsim() -> io::Result<String> {
    const NAME: &str = "mac80211_hwsim";
    if Path::new("/sys/class").join(NAME).exists() {
        return Ok("loaded".into());
    }
    let release = fs::read_to_string("/proc/sys/kernel/osrelease")?;
    let modules = Path::new("/lib/modules").join(release.trim());
    let listed = fs::read_to_string(modules.join("modules.dep")).is_ok_and(|list| list.contains(NAME));
    if !listed {
        return Err(io::Error::other("this kernel has no such module"));
    }
    if privilege::have_rights() && sys::effective_ids().0 == 0 {
        Ok("as a module, not loaded yet".into())
    } else {
        Err(io::Error::other("only root can load the module"))
    }
}

/// Lists the controllers of the process's control groups in which it can create groups.
fn control_groups() -> io::Result<String> {
    let own = fs::read_to_string("/proc/self/cgroup")?;
    let mut writable = Vec::new();
    let mut version = "v1";
    for line in own.lines() {
        let mut parts = line.splitn(3, ':').skip(1);
        let (Some(controllers), Some(path)) = (parts.next(), parts.next()) else { continue };
        let path = path.trim_start_matches('/');
        if controllers.is_empty() {
            let group = Path::new("/sys/fs/cgroup").join(path);
            let Ok(list) = fs::read_to_string(group.join("cgroup.controllers")) else { continue };
            version = "v2";
            if may_make_groups_in(&group) {
                writable.extend(list.split_whitespace().map(str::to_owned));
            }
        } else {
            let group = Path::new("/sys/fs/cgroup").join(controllers).join(path);
            if may_make_groups_in(&group) {
                writable.extend(controllers.split(',').map(str::to_owned));
            }
        }
    }
    writable.retain(|controller| ["cpu", "memory", "cpuset", "pids"].contains(&controller.as_str()));
    if writable.is_empty() {
        return Err(io::Error::other("cannot create groups with the controllers cpu or memory"));
    }
    Ok(format!("{version}: {}", writable.join(", ")))
}

fn may_make_groups_in(group: &Path) -> bool {
    let probe = group.join(format!("cotorra-probe-{}", std::process::id()));
    fs::create_dir(&probe).is_ok() && fs::remove_dir(&probe).is_ok()
}
