//! Confines a program in a node. It gets a root folder of its own with programs, libraries and shared files, all
//! read-only, and one writable folder. It has only the capabilities that it was given, and no system call that
//! reaches beyond the node.
//!
//! [`Confinement::build`] prepares this with ordinary code on a throw-away thread. The remaining steps between fork
//! and exec are in [`crate::init`].

use std::{
    collections::BTreeSet,
    env,
    fs::{self, File},
    io,
    os::{
        fd::{AsFd, OwnedFd},
        unix::fs::{MetadataExt, symlink},
    },
    path::{Path, PathBuf},
    sync::OnceLock,
};

use cotorra_graph::LinuxCapability;

use crate::{
    privilege, seccomp,
    sys::{self, Access, Attributes},
};

/// System folders visible to every program.
const SYSTEM: &[&str] =
    &["/usr", "/bin", "/sbin", "/lib", "/lib32", "/lib64", "/libx32", "/opt", "/nix", "/etc"];
const DEVICES: &str = "/dev";
const DEVICE_NAMES: &[&str] = &["null", "zero", "full", "random", "urandom"];
/// In-memory folders private to the program.
const IN_MEMORY: &[&str] = &["/tmp", "/dev/shm"];

/// Confinement of a program. Paths are absolute.
#[derive(Debug, Clone)]
pub struct Confinement {
    /// The program's own folder, which exists. It can write only here and to memory.
    pub home: PathBuf,
    /// Files and folders that it can read beside the system's.
    pub readable: Vec<PathBuf>,
    /// Files and folders that appear empty, although a readable folder contains them.
    pub hidden: Vec<PathBuf>,
    /// Capabilities over its network namespace and its own threads.
    pub capabilities: Vec<LinuxCapability>,
    /// Maximum number of processes and threads if no control group limits them.
    pub processes: u64,
    /// Maximum memory of each process, and of its in-memory files, bytes.
    pub memory_bytes: u64,
}

/// The restrictions that [`crate::init`] puts in force between fork and exec.
#[derive(Debug)]
pub(crate) struct Restrictions {
    /// The old root folder, to be unmounted once `/proc` is mounted.
    pub(crate) outside: OwnedFd,
    /// Landlock rules; `None` on kernels without Landlock, where only mounts confine the program.
    pub(crate) access: Option<OwnedFd>,
    pub(crate) filter: Vec<libc::sock_filter>,
    /// One bit per capability.
    pub(crate) capabilities: u64,
    /// Processes and bytes of memory; `None` if a control group limits them.
    pub(crate) limits: Option<[u64; 2]>,
}

impl Confinement {
    /// Moves the calling thread into the program's root folder. The thread must have a mount namespace of its own.
    pub(crate) fn build(&self, program: Option<&Path>, is_limited: bool) -> io::Result<Restrictions> {
        // Open the sources first, so that they do not include the mounts made below.
        let home = Tree::open(&self.home, Attributes::NO_SUID | Attributes::NO_DEV)?;
        let system = Path::new("/").read_dir()?.flatten().map(|entry| entry.path());
        let system = system.filter(|path| SYSTEM.iter().any(|name| path == Path::new(name)));
        let (links, folders): (Vec<_>, Vec<_>) = system.partition(|path| path.is_symlink());
        let only_read = Attributes::READ_ONLY | Attributes::NO_SUID | Attributes::NO_DEV;
        let show = |path: &PathBuf| Tree::open(&path.canonicalize().map_err(about(path))?, only_read);
        let folders = folders.iter().map(show).collect::<io::Result<Vec<_>>>()?;
        let more = self.readable.iter().map(|path| path.to_owned()).chain(program.map(Path::to_owned));
        let more = more.map(|path| show(&path)).collect::<io::Result<Vec<_>>>()?;
        let use_device =
            |name| Tree::open(&Path::new(DEVICES).join(name), Attributes::NO_SUID | Attributes::NO_EXEC);
        let devices = DEVICE_NAMES.iter().map(use_device).collect::<io::Result<Vec<_>>>()?;
        let covered = own_of_root();

        sys::mount_tmpfs(&self.home, "size=1m,mode=755").map_err(about(&self.home))?;
        // From here on, relative paths are inside the new root.
        env::set_current_dir(&self.home)?;
        for folder in ["proc", "run", "tmp", "var", "dev", "dev/shm"] {
            fs::create_dir(folder)?;
        }
        symlink("../tmp", "var/tmp")?;
        symlink("../run", "var/run")?;
        for (name, target) in [("fd", ""), ("stdin", "/0"), ("stdout", "/1"), ("stderr", "/2")] {
            symlink(format!("/proc/self/fd{target}"), Path::new("dev").join(name))?;
        }
        for memory in IN_MEMORY {
            sys::mount_tmpfs(inside(Path::new(memory)), &format!("size={},mode=1777", self.memory_bytes))?;
        }
        for link in &links {
            // Relative, so that it does not lead out of the new root while that is being built.
            let target = fs::read_link(link)?;
            symlink(inside(&target), inside(link))?;
        }
        for tree in folders.iter().chain(&devices).chain(&more) {
            tree.attach_if_new()?;
        }
        let mut covers = Vec::new();
        // A folder comes before what is in it, which is no longer there then.
        for path in covered.iter().chain(&self.hidden).collect::<BTreeSet<_>>() {
            covers.extend(cover(inside(path))?);
        }
        home.attach()?;
        for read_only in covers.iter().map(PathBuf::as_path).chain([Path::new(".")]) {
            sys::set_mount_attributes(None, read_only, Attributes::READ_ONLY)?;
        }
        let outside = File::open("/")?.into();
        sys::pivot_root_here()?;
        Ok(Restrictions {
            outside,
            access: self.access()?,
            filter: seccomp::filter(),
            capabilities: self.capabilities.iter().fold(0, |all, one| all | 1 << number(*one)),
            limits: (!is_limited).then_some([self.processes, self.memory_bytes]),
        })
    }

    /// Returns the same restrictions as Landlock rules, which hold even if a mount can be circumvented.
    fn access(&self) -> io::Result<Option<OwnedFd>> {
        let Some(access) = Access::new()? else { return Ok(None) };
        access.allow_reading(Path::new("/"))?;
        for folder in IN_MEMORY.iter().map(Path::new).chain([&*self.home]) {
            access.allow_writing(folder)?;
        }
        for device in DEVICE_NAMES {
            access.allow_using(&Path::new(DEVICES).join(device))?;
        }
        Ok(Some(access.into()))
    }
}

/// A detached copy of an outside file or folder with everything mounted below, to be attached in the new root.
struct Tree {
    mount: OwnedFd,
    path: PathBuf,
    is_folder: bool,
}

impl Tree {
    /// Opens a path that contains no symbolic links.
    fn open(path: &Path, attributes: Attributes) -> io::Result<Self> {
        let open = || {
            let is_folder = fs::symlink_metadata(path)?.is_dir();
            let mount = sys::open_tree(path)?;
            sys::set_mount_attributes(Some(mount.as_fd()), Path::new(""), attributes)?;
            Ok(Self { mount, path: path.to_owned(), is_folder })
        };
        open().map_err(about(path))
    }

    /// Attaches the copy at its old path, unless another copy already provides that path.
    fn attach_if_new(&self) -> io::Result<()> {
        if fs::symlink_metadata(inside(&self.path)).is_ok() { Ok(()) } else { self.attach() }
    }

    fn attach(&self) -> io::Result<()> {
        let to = inside(&self.path);
        let attach = || {
            if self.is_folder {
                fs::create_dir_all(to)?;
            } else {
                to.parent().map_or(Ok(()), fs::create_dir_all)?;
                if !to.exists() {
                    File::create(to)?;
                }
            }
            sys::move_mount(self.mount.as_fd(), to)
        };
        attach().map_err(about(&self.path))
    }
}

/// Returns the path relative to the new root, which is the working directory.
fn inside(path: &Path) -> &Path {
    path.strip_prefix("/").unwrap_or(path)
}

fn about(path: &Path) -> impl FnOnce(io::Error) -> io::Error {
    let path = path.to_owned();
    move |error| io::Error::new(error.kind(), format!("cannot show it {}: {error}", path.display()))
}

/// Hides a file or folder, if it exists. Returns the path of a mount that must become read-only.
fn cover(path: &Path) -> io::Result<Option<PathBuf>> {
    match fs::symlink_metadata(path) {
        Ok(found) if found.is_dir() => {
            sys::mount_tmpfs(path, "size=1m,mode=755")?;
            Ok(Some(path.to_owned()))
        }
        Ok(found) if found.is_file() => {
            let nothing = Tree::open(Path::new("/dev/null"), Attributes::READ_ONLY | Attributes::NO_DEV)?;
            sys::move_mount(nothing.mount.as_fd(), path)?;
            Ok(None)
        }
        _ => Ok(None),
    }
}

/// Lists the files in `/etc` that not everyone may read, as found when the first program was confined. A program
/// running as root could read them even without capabilities.
fn own_of_root() -> &'static [PathBuf] {
    static FOUND: OnceLock<Vec<PathBuf>> = OnceLock::new();
    FOUND.get_or_init(|| {
        let mut found = Vec::new();
        if privilege::is_root() {
            collect_own_of_root(Path::new("/etc"), &mut found);
        }
        found
    })
}

fn collect_own_of_root(folder: &Path, found: &mut Vec<PathBuf>) {
    const EVERYONE: u32 = 0o4;
    for path in folder.read_dir().into_iter().flatten().flatten().map(|entry| entry.path()) {
        match fs::symlink_metadata(&path) {
            Ok(its) if its.is_symlink() => {}
            Ok(its) if its.mode() & EVERYONE == 0 => found.push(path),
            Ok(its) if its.is_dir() => collect_own_of_root(&path, found),
            _ => {}
        }
    }
}

/// Returns the number of a capability (capabilities(7)).
fn number(capability: LinuxCapability) -> u32 {
    match capability {
        LinuxCapability::NetBindService => 10,
        LinuxCapability::NetBroadcast => 11,
        LinuxCapability::NetAdmin => 12,
        LinuxCapability::NetRaw => 13,
        LinuxCapability::IpcLock => 14,
        LinuxCapability::SysNice => 23,
    }
}
