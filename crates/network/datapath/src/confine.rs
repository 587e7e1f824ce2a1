//! Confines a program in a node. It gets a root folder of its own with programs, libraries and shared files, all
//! read-only, and one writable folder. It has only the capabilities that it was given, and no system call that
//! reaches beyond the node.
//!
//! [`Confinement::build`] prepares this with ordinary code on a throw-away thread. The remaining steps between fork
//! and exec are in [`crate::init`].

use std::{
    collections::{BTreeMap, BTreeSet},
    env,
    fs::{self, File},
    hash::{DefaultHasher, Hash, Hasher},
    io,
    os::{
        fd::{AsFd, OwnedFd},
        unix::fs::{MetadataExt, lchown, symlink},
    },
    path::{Path, PathBuf},
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
/// Most files and folders that are shown one by one.
const MOST_SHOWN: usize = 4096;
/// Users of programs that root starts: from this number on, which no account of a person or a service has.
const FIRST_USER: u32 = 1_000_000_000;
const USERS: u64 = 1 << 28;
/// Rights of users other than a file's owner and group.
const OTHERS_READ: u32 = 0o4;
const OTHERS_RUN: u32 = 0o1;

/// Confinement of a program. Paths are absolute and contain no symbolic links, except for those in `readable`.
///
/// A program that root starts runs as an unprivileged user, who can read only what all users may, whatever its path and
/// whenever it was made.
#[derive(Debug, Clone)]
pub struct Confinement {
    /// The program's own folder, which exists. It can write only here and to memory.
    pub home: PathBuf,
    /// Files and folders that it can read beside the system's.
    pub readable: Vec<PathBuf>,
    /// Files and folders that are missing, although a readable folder contains them. A folder that contains one is shown
    /// by what else is in it at the start, so that nothing comes into sight by a rename.
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
    /// The number of the user and group that it becomes; `None` if it stays who it is.
    pub(crate) user: Option<u32>,
}

impl Confinement {
    /// Moves the calling thread into the program's root folder. The thread must have a mount namespace of its own.
    pub(crate) fn build(&self, program: Option<&Path>, is_limited: bool) -> io::Result<Restrictions> {
        let user = privilege::is_root().then(|| user_of(&self.home));
        if let Some(user) = user {
            lchown(&self.home, Some(user), Some(user)).map_err(about(&self.home))?;
        }
        // Open the sources first, so that they do not include the mounts made below.
        let home = Tree::open(&self.home, Attributes::NO_SUID | Attributes::NO_DEV)?;
        let system = Path::new("/").read_dir()?.flatten().map(|entry| entry.path());
        let system = system.filter(|path| SYSTEM.iter().any(|name| path == Path::new(name)));
        let (links, folders): (Vec<_>, Vec<_>) = system.partition(|path| path.is_symlink());
        let view = self.view(folders, program, user.is_some())?;
        let use_device =
            |name| Tree::open(&Path::new(DEVICES).join(name), Attributes::NO_SUID | Attributes::NO_EXEC);
        let devices = DEVICE_NAMES.iter().map(use_device).collect::<io::Result<Vec<_>>>()?;

        // The program must get through the folders that are made here.
        let umask = sys::set_umask(0o022);
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
        for device in &devices {
            device.attach()?;
        }
        // A folder comes before what is in it.
        let mut made = vec![Path::new(".")];
        for (path, part) in &view {
            let is_made = |path: &Path| matches!(view.get(path), Some(Part::Folder));
            if part.attach_if_new(path)? && is_made(path) && !path.parent().is_some_and(is_made) {
                // Else it could be written in the program's own `/tmp`.
                sys::mount_tmpfs(inside(path), "size=1m,mode=755").map_err(about(path))?;
                made.push(inside(path));
            }
        }
        home.attach()?;
        for folder in made {
            sys::set_mount_attributes(None, folder, Attributes::READ_ONLY).map_err(about(folder))?;
        }
        let outside = File::open("/")?.into();
        sys::pivot_root_here()?;
        sys::set_umask(umask);
        Ok(Restrictions {
            outside,
            access: self.access()?,
            filter: seccomp::filter(),
            capabilities: self.capabilities.iter().fold(0, |all, one| all | 1 << number(*one)),
            limits: (!is_limited).then_some([self.processes, self.memory_bytes]),
            user,
        })
    }

    /// Opens everything that the program is shown beside its own folder and the devices.
    fn view(
        &self,
        system: Vec<PathBuf>,
        program: Option<&Path>,
        is_another_user: bool,
    ) -> io::Result<BTreeMap<PathBuf, Part>> {
        let real = |path: &Path| path.canonicalize().map_err(about(path));
        let named = self.readable.iter().map(|path| real(path)).collect::<io::Result<BTreeSet<_>>>()?;
        let mut view = View { hidden: &self.hidden, named, is_another_user, parts: BTreeMap::new() };
        for path in view.named.iter().filter(|path| !path.is_dir()) {
            view.check(path, OTHERS_READ, "read it", "o+r")?;
        }
        let named: Vec<_> = view.named.iter().cloned().collect();
        for path in system.iter().chain(&named) {
            view.add(path).map_err(about(path))?;
        }
        if let Some(program) = program {
            let program = real(program)?;
            view.check(&program, OTHERS_RUN, "run it", "o+rx")?;
            view.add(&program).map_err(about(&program))?;
        }
        Ok(view.parts)
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

/// Returns the user of a program that root starts, by its own folder. It is the same at each start, because files remain
/// there.
fn user_of(home: &Path) -> u32 {
    let mut hash = DefaultHasher::new();
    home.hash(&mut hash);
    FIRST_USER + (hash.finish() % USERS) as u32
}

/// The part of the outside that a program sees. A folder is shown as a whole, with what is made in it later, unless it
/// contains something hidden, or is a named one that other users may not enter. It is then shown by what is in it now.
struct View<'a> {
    hidden: &'a [PathBuf],
    named: BTreeSet<PathBuf>,
    /// Whether the program runs as another user, who needs the rights of others.
    is_another_user: bool,
    parts: BTreeMap<PathBuf, Part>,
}

impl View<'_> {
    /// Adds a file or folder at a path whose folders contain no symbolic links.
    fn add(&mut self, path: &Path) -> io::Result<()> {
        if self.hidden.iter().any(|hidden| path.starts_with(hidden)) {
            return Ok(());
        }
        let its = fs::symlink_metadata(path)?;
        let is_named = self.named.contains(path);
        let is_closed = self.is_closed(&its);
        let is_beneath = |other: &PathBuf| other != path && other.starts_with(path);
        let is_apart =
            |other: &PathBuf| is_beneath(other) && fs::metadata(other).is_ok_and(|its| self.is_closed(&its));
        let in_parts = its.is_dir()
            && (is_named && is_closed
                || self.hidden.iter().any(is_beneath)
                || self.named.iter().any(is_apart));
        let part = match (its.is_symlink(), in_parts) {
            (true, _) => Part::Link(fs::read_link(path)?),
            (_, false) => {
                let only_read = Attributes::READ_ONLY | Attributes::NO_SUID | Attributes::NO_DEV;
                Part::Tree(Tree::open(path, only_read)?)
            }
            // Its contents must not become open by being shown one by one.
            (_, true) if is_closed && !is_named => return Ok(()),
            (_, true) => Part::Folder,
        };
        if self.parts.len() >= MOST_SHOWN {
            return Err(io::Error::other(format!(
                "it holds more than {MOST_SHOWN} files and folders: put those that the program needs into a folder of \
                 their own"
            )));
        }
        self.parts.insert(path.to_owned(), part);
        if in_parts {
            for entry in fs::read_dir(path)? {
                match self.add(&entry?.path()) {
                    // It was removed meanwhile.
                    Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                    done => done?,
                }
            }
        }
        Ok(())
    }

    /// Whether the program's user may not enter or list a folder.
    fn is_closed(&self, its: &fs::Metadata) -> bool {
        let needed = OTHERS_READ | OTHERS_RUN;
        self.is_another_user && its.is_dir() && its.mode() & needed != needed
    }

    /// Checks that the program's user has a right to a file.
    fn check(&self, path: &Path, right: u32, what: &str, mode: &str) -> io::Result<()> {
        let its = fs::metadata(path).map_err(about(path))?;
        if self.is_another_user && its.mode() & right == 0 {
            return Err(io::Error::new(
                io::ErrorKind::PermissionDenied,
                format!(
                    "other users may not {what}, and what root confines runs as another user: `chmod {mode} {}`",
                    path.display()
                ),
            ));
        }
        Ok(())
    }
}

/// A part of what a program is shown.
enum Part {
    /// A file or folder as a whole.
    Tree(Tree),
    /// A folder whose contents are other parts.
    Folder,
    /// A symbolic link to this.
    Link(PathBuf),
}

impl Part {
    /// Puts it at its path in the new root, unless another part already provides that path. Returns whether it did.
    fn attach_if_new(&self, path: &Path) -> io::Result<bool> {
        let to = inside(path);
        if fs::symlink_metadata(to).is_ok() {
            return Ok(false);
        }
        match self {
            Self::Tree(tree) => tree.attach(),
            Self::Folder => fs::create_dir_all(to).map_err(about(path)),
            Self::Link(target) => symlink(target, to).map_err(about(path)),
        }
        .map(|()| true)
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
        let is_folder = fs::symlink_metadata(path)?.is_dir();
        let mount = sys::open_tree(path)?;
        sys::set_mount_attributes(Some(mount.as_fd()), Path::new(""), attributes)?;
        Ok(Self { mount, path: path.to_owned(), is_folder })
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
