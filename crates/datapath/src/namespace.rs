//! Network namespaces that nobody has to clean up: each is held by a descriptor alone, so that the kernel removes it,
//! with all that is in it, when the process ends, however it ends.

use std::{
    env,
    fs::File,
    io,
    net::{ToSocketAddrs, UdpSocket},
    os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd},
    path::{Path, PathBuf},
    thread,
};

use crate::{
    error::{Action, Error},
    privilege, sys,
};

/// A network namespace.
#[derive(Debug)]
pub struct Namespace(OwnedFd);

impl Namespace {
    /// Makes an empty one: a loopback interface that is down.
    ///
    /// # Errors
    /// [`Error::Kernel`] without the right to make one; see [`crate::enter_user_namespace_if_needed`].
    pub fn new() -> Result<Self, Error> {
        on_a_thread(Self::enter_new).action("make a network namespace")
    }

    /// Makes one and leaves the calling thread, which others must not share, in it.
    pub(crate) fn enter_new() -> io::Result<Self> {
        sys::unshare(libc::CLONE_NEWNET)?;
        Self::current()
    }

    /// The calling thread's.
    pub(crate) fn current() -> io::Result<Self> {
        Ok(Self(File::open("/proc/thread-self/ns/net")?.into()))
    }

    /// Moves the calling thread there, which must be a short-lived one.
    pub(crate) fn enter(&self) -> io::Result<()> {
        sys::setns(self.as_fd(), libc::CLONE_NEWNET)
    }

    /// Runs a closure inside, on a short-lived thread. Sockets that it opens stay inside for good; it must not hand
    /// work to other threads, which are elsewhere.
    ///
    /// # Panics
    /// If the closure does.
    pub fn run<T: Send>(&self, inside: impl FnOnce() -> T + Send) -> T {
        on_a_thread(|| {
            self.enter().expect("whoever made a namespace may enter it");
            inside()
        })
    }

    /// A UDP socket inside, bound to the address.
    ///
    /// # Errors
    /// As [`UdpSocket::bind`].
    pub fn udp_socket(&self, bind: impl ToSocketAddrs + Send) -> io::Result<UdpSocket> {
        self.run(|| UdpSocket::bind(bind))
    }

    /// A path under which another process of the same user finds it, as long as this process lives and holds it:
    /// what [`enter`] takes.
    pub fn path(&self) -> PathBuf {
        path_of(self.as_fd())
    }
}

impl AsFd for Namespace {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.0.as_fd()
    }
}

/// Moves this process, which must have one thread, into namespaces that another process holds, entering its user
/// namespace first where need be: what it runs next (`exec`) runs there. [`crate::Datapath::paths`] tells the paths
/// of a node. Call it instead of [`crate::enter_user_namespace_if_needed`].
///
/// # Errors
/// [`Error::Kernel`] when a path leads to no namespace, or to one of another user;
/// [`Error::SeveralThreads`].
pub fn enter(paths: &[impl AsRef<Path>]) -> Result<(), Error> {
    let namespaces = paths.iter().map(File::open).collect::<io::Result<Vec<_>>>();
    let namespaces = namespaces.action("open a namespace (does its run still go on?)")?;
    let here = env::current_dir();
    if let Some(any) = namespaces.first().filter(|_| !privilege::have_rights()) {
        let user = sys::owner_of(any.as_fd()).action("find the namespace's user namespace")?;
        sys::setns(user.as_fd(), libc::CLONE_NEWUSER).map_err(privilege::several_threads)?;
    }
    for namespace in &namespaces {
        const OF_ANY_KIND: i32 = 0;
        sys::setns(namespace.as_fd(), OF_ANY_KIND).action("enter a namespace")?;
    }
    // Entering a mount namespace goes to its root.
    here.and_then(env::set_current_dir).action("go back to the working directory")
}

/// Where another process finds what a descriptor of ours holds.
pub(crate) fn path_of(fd: BorrowedFd<'_>) -> PathBuf {
    format!("/proc/{}/fd/{}", std::process::id(), fd.as_raw_fd()).into()
}

/// Runs a closure on a thread of its own, because what a thread unshares it cannot get back.
pub(crate) fn on_a_thread<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    thread::scope(|scope| match scope.spawn(work).join() {
        Ok(result) => result,
        Err(panic) => std::panic::resume_unwind(panic),
    })
}
