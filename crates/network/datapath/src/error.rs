//! Errors between cotorra and the kernel, with remedies.

use std::io;

use cotorra_graph::NodeId;

use crate::gateway::error::GatewayError;

/// A failure of the datapath.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The kernel rejected an action.
    #[error("cannot {action}: {source}{}", remedy(source))]
    Kernel { action: &'static str, source: io::Error },
    /// A user namespace can only be entered by a process with one thread.
    #[error("cannot enter a user namespace from a process with several threads: do it first thing in main")]
    SeveralThreads,
    /// The kernel allows this user a user namespace, but no rights in it.
    #[error(
        "user namespaces give no rights here (AppArmor or a security module forbids it): \
         set kernel.apparmor_restrict_unprivileged_userns=0, or run as root"
    )]
    RightsWithheld,
    /// The interface of a gateway or a real server cannot be used.
    #[error("interface of `{gateway}`: {source}")]
    Gateway { gateway: NodeId, source: GatewayError },
    /// This kernel or this user cannot have simulated radios.
    #[error("no radios for hostapd and wpa_supplicant: {0}")]
    Wifi(#[from] cotorra_hwsim::Error),
    /// The fabric lends no antenna to a simulated radio.
    #[error("no antenna for a simulated radio: {0}")]
    Antenna(#[from] cotorra_fabric::FabricError),
    /// The graph has no host of that name with a namespace. Switches and real servers have none.
    #[error("`{0}` is not a host of this machine: those are robots, radio units and emulated servers")]
    NoSuchHost(NodeId),
    /// A program could not be started.
    #[error("cannot start `{program}`: {source}")]
    Spawn { program: String, source: io::Error },
    /// The fabric's thread has ended.
    #[error("the datapath has stopped")]
    Stopped,
}

fn remedy(error: &io::Error) -> &'static str {
    match error.raw_os_error() {
        Some(libc::EPERM | libc::EACCES) => " (run as root, or allow user namespaces; see `cotorra doctor`)",
        Some(libc::EMFILE | libc::ENFILE) => " (raise the limit of open files: `ulimit -Hn`)",
        Some(libc::ENOSPC) => " (raise user.max_net_namespaces, user.max_pid_namespaces)",
        _ => "",
    }
}

/// Adds the attempted action to an error of the kernel.
pub(crate) trait Action<T> {
    fn action(self, action: &'static str) -> Result<T, Error>;
}

impl<T> Action<T> for io::Result<T> {
    fn action(self, action: &'static str) -> Result<T, Error> {
        self.map_err(|source| Error::Kernel { action, source })
    }
}
