//! What can go wrong between cotorra and the kernel, and what to do about it.

use std::io;

use cotorra_graph::NodeId;

/// Why the datapath could not do something.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The kernel refused.
    #[error("cannot {action}: {source}{}", remedy(source))]
    Kernel {
        /// What was tried.
        action: &'static str,
        /// What the kernel said.
        source: io::Error,
    },
    /// A user namespace can only be entered by a process with one thread.
    #[error("cannot enter a user namespace from a process with several threads: do it first thing in main")]
    SeveralThreads,
    /// The kernel lets this user have a user namespace, but no rights in it.
    #[error(
        "user namespaces give no rights here (AppArmor or a security module forbids it): \
         set kernel.apparmor_restrict_unprivileged_userns=0, or run as root"
    )]
    RightsWithheld,
    /// The graph has no host of that name; switches have no namespace.
    #[error("`{0}` is no host of this testbed: robots, radio units and servers are")]
    NoSuchHost(NodeId),
    /// A program could not be started.
    #[error("cannot start `{program}`: {source}")]
    Spawn {
        /// Which.
        program: String,
        /// Why.
        source: io::Error,
    },
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

/// Says what was tried when the kernel refuses.
pub(crate) trait Action<T> {
    fn action(self, action: &'static str) -> Result<T, Error>;
}

impl<T> Action<T> for io::Result<T> {
    fn action(self, action: &'static str) -> Result<T, Error> {
        self.map_err(|source| Error::Kernel { action, source })
    }
}
