//! Network namespaces held by descriptors alone. The kernel removes them with everything inside when the process
//! ends, however it ends.

use std::{
    fs::File,
    io,
    net::{ToSocketAddrs, UdpSocket},
    os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd},
    path::{Path, PathBuf},
    thread,
    time::Duration,
};

use crate::{
    error::{Action, Error},
    netlink::{self, LOOPBACK, Netlink},
    privilege, sys,
};

#[derive(Debug)]
pub struct Namespace(OwnedFd);

impl Namespace {
    /// Makes an empty namespace, whose loopback interface is down.
    ///
    /// # Errors
    /// [`Error::Kernel`] without the right to make one; see [`crate::enter_user_namespace_if_needed`].
    pub fn new() -> Result<Self, Error> {
        on_a_thread(Self::enter_new).action("make a network namespace")
    }

    /// Makes an empty namespace, whose loopback interface is up.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_loopback() -> Result<Self, Error> {
        on_a_thread(|| {
            let namespace = Self::enter_new().action("make a network namespace")?;
            let netlink = Netlink::open().action("open a netlink socket")?;
            netlink.execute(vec![netlink::up(LOOPBACK)]).action("bring up loopback")?;
            Ok(namespace)
        })
    }

    /// Opens a namespace that another process holds, at its [`path`](Self::path) there, and moves this process into the user
    /// namespace that it belongs to, if needed. This process must have one thread. Call it instead of
    /// [`crate::enter_user_namespace_if_needed`].
    ///
    /// # Errors
    /// [`Error::Kernel`] if the path is no namespace or belongs to another user; [`Error::SeveralThreads`].
    pub fn open(path: &Path) -> Result<Self, Error> {
        let namespace = File::open(path).action("open the namespace (is its run still going?)")?;
        if !privilege::have_rights() {
            let user = sys::owner_of(namespace.as_fd()).action("find the namespace's user namespace")?;
            enter_user(user.as_fd()).map_err(privilege::several_threads)?;
        }
        let namespace = Self(namespace.into());
        on_a_thread(|| namespace.enter()).action("enter the network namespace")?;
        Ok(namespace)
    }

    /// Makes a namespace and leaves the calling thread in it. No other work may share the thread.
    pub(crate) fn enter_new() -> io::Result<Self> {
        sys::unshare(libc::CLONE_NEWNET)?;
        Self::current()
    }

    /// Returns the calling thread's namespace.
    pub(crate) fn current() -> io::Result<Self> {
        Ok(Self(File::open("/proc/thread-self/ns/net")?.into()))
    }

    /// Moves the calling thread into this namespace. It must be a short-lived thread.
    pub(crate) fn enter(&self) -> io::Result<()> {
        sys::setns(self.as_fd(), libc::CLONE_NEWNET)
    }

    /// Runs a closure inside, on a short-lived thread. Sockets that it opens stay inside for good. It must not hand
    /// work to other threads, which are outside.
    ///
    /// # Panics
    /// If the closure does.
    pub fn run<T: Send>(&self, inside: impl FnOnce() -> T + Send) -> T {
        on_a_thread(|| {
            self.enter().expect("whoever made a namespace may enter it");
            inside()
        })
    }

    /// Opens a UDP socket inside, bound to the address.
    ///
    /// # Errors
    /// As [`UdpSocket::bind`].
    pub fn udp_socket(&self, bind: impl ToSocketAddrs + Send) -> io::Result<UdpSocket> {
        self.run(|| UdpSocket::bind(bind))
    }

    /// Returns a path by which another process of the same user can [`open`](Self::open) this namespace, for as long as this
    /// process holds it.
    pub fn path(&self) -> PathBuf {
        format!("/proc/{}/fd/{}", std::process::id(), self.0.as_raw_fd()).into()
    }
}

impl AsFd for Namespace {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.0.as_fd()
    }
}

/// Enters a user namespace, which only a process with one thread may. Threads that were joined or that resolved a
/// name may take a moment to disappear.
#[allow(clippy::disallowed_methods, reason = "the kernel tells nobody when a thread is gone")]
fn enter_user(user: BorrowedFd<'_>) -> io::Result<()> {
    const TRIES: u32 = 500;
    let enter = || sys::setns(user, libc::CLONE_NEWUSER);
    for _ in 0..TRIES {
        match enter() {
            Err(error) if error.raw_os_error() == Some(libc::EINVAL) => {
                thread::sleep(Duration::from_millis(1))
            }
            done => return done,
        }
    }
    enter()
}

/// Waits until the kernel has removed all namespaces that were closed before. It removes them in order, so this closes one
/// more, whose interface is visible from outside.
///
/// # Errors
/// [`Error::Kernel`].
#[allow(clippy::disallowed_methods, reason = "the kernel tells nobody when a namespace is gone")]
pub fn wait_until_removed() -> Result<(), Error> {
    on_a_thread(|| {
        let outside = Namespace::enter_new().action("make a network namespace")?;
        on_a_thread(|| {
            Namespace::enter_new()?;
            Netlink::open()?.execute(vec![netlink::veth("inside", "outside", 100, outside.as_fd())])
        })
        .action("make a virtual Ethernet pair")?;
        while sys::interface_index("outside").is_ok() {
            thread::sleep(Duration::from_millis(1));
        }
        Ok(())
    })
}

/// Runs a closure on a thread of its own, because a thread cannot undo an unshare.
pub(crate) fn on_a_thread<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    thread::scope(|scope| match scope.spawn(work).join() {
        Ok(result) => result,
        Err(panic) => std::panic::resume_unwind(panic),
    })
}
