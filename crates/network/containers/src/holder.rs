//! Holders: containers through which those of Docker join a node's namespace.
//!
//! Docker joins no namespace by its path, but that of another container's first process. A holder is a container whose first
//! process enters the node's namespace, which is mounted into the holder, and then sleeps. Its image holds that one program,
//! and is made here, without a registry.

use std::{cell::RefCell, collections::BTreeMap, fs, os::unix::fs::MetadataExt as _, path::Path, rc::Rc};

use cotorra_graph::NodeId;
use tokio::sync::Mutex;

use crate::{
    container::{Container, HostConfig, Mount},
    daemon::{Daemon, Retries},
    daemon_error::DaemonError,
    spec::labels,
};

/// The holders' image. Its name changes with its content. podman gives what it imports no other tag.
pub(crate) const REFERENCE: &str = "cotorra/holder-1:latest";
/// Name of its program.
pub(crate) const PROGRAM: &str = "hold";

/// The program, in the machine's instructions:
///
/// ```text
/// if setns(open("/ns", O_RDONLY), CLONE_NEWNET) != 0 { exit(1) }
/// loop { pause() }
/// ```
#[cfg(target_arch = "x86_64")]
const CODE: &[u8] = &[
    0xb8, 0x02, 0x00, 0x00, 0x00, // mov eax, 2 (open)
    0x48, 0x8d, 0x3d, 0x2b, 0x00, 0x00, 0x00, // lea rdi, [rip + path]
    0x31, 0xf6, // xor esi, esi
    0x0f, 0x05, // syscall
    0x89, 0xc7, // mov edi, eax
    0xbe, 0x00, 0x00, 0x00, 0x40, // mov esi, CLONE_NEWNET
    0xb8, 0x34, 0x01, 0x00, 0x00, // mov eax, 308 (setns)
    0x0f, 0x05, // syscall
    0x85, 0xc0, // test eax, eax
    0x75, 0x09, // jnz fail
    0xb8, 0x22, 0x00, 0x00, 0x00, // again: mov eax, 34 (pause)
    0x0f, 0x05, // syscall
    0xeb, 0xf7, // jmp again
    0xbf, 0x01, 0x00, 0x00, 0x00, // fail: mov edi, 1
    0xb8, 0x3c, 0x00, 0x00, 0x00, // mov eax, 60 (exit)
    0x0f, 0x05, // syscall
    b'/', b'n', b's', 0, // path
];
/// As on x86_64, with `ppoll` without descriptors in place of `pause`.
#[cfg(target_arch = "aarch64")]
const CODE: &[u8] = &[
    0x60, 0x0c, 0x80, 0x92, // mov x0, AT_FDCWD
    0x41, 0x02, 0x00, 0x10, // adr x1, path
    0x02, 0x00, 0x80, 0xd2, // mov x2, 0
    0x08, 0x07, 0x80, 0xd2, // mov x8, 56 (openat)
    0x01, 0x00, 0x00, 0xd4, // svc 0
    0x01, 0x00, 0xa8, 0xd2, // mov x1, CLONE_NEWNET
    0x88, 0x21, 0x80, 0xd2, // mov x8, 268 (setns)
    0x01, 0x00, 0x00, 0xd4, // svc 0
    0x00, 0x01, 0x00, 0xb5, // cbnz x0, fail
    0x00, 0x00, 0x80, 0xd2, // again: mov x0, 0
    0x01, 0x00, 0x80, 0xd2, // mov x1, 0
    0x02, 0x00, 0x80, 0xd2, // mov x2, 0
    0x03, 0x00, 0x80, 0xd2, // mov x3, 0
    0x28, 0x09, 0x80, 0xd2, // mov x8, 73 (ppoll)
    0x01, 0x00, 0x00, 0xd4, // svc 0
    0xfa, 0xff, 0xff, 0x17, // b again
    0x20, 0x00, 0x80, 0xd2, // fail: mov x0, 1
    0xa8, 0x0b, 0x80, 0xd2, // mov x8, 93 (exit)
    0x01, 0x00, 0x00, 0xd4, // svc 0
    b'/', b'n', b's', 0, // path
];
#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
const CODE: &[u8] = &[];

/// The program's architecture in the header of an ELF file.
const MACHINE: u16 = if cfg!(target_arch = "aarch64") { 183 } else { 62 };
/// Address at which the file is loaded.
const BASE: u64 = 0x0040_0000;
/// Bytes of the headers before the code: that of the file, and of its one segment.
const HEADERS: u64 = 64 + 56;

/// The holders of one engine.
#[derive(Debug, Default)]
pub(crate) struct Holders {
    /// Each is locked while its node's holder starts.
    nodes: RefCell<BTreeMap<NodeId, Rc<Mutex<()>>>>,
    /// Locked while the image is made.
    image: Mutex<()>,
}

impl Holders {
    /// Makes a holder that is in a node's network namespace, if it does not run yet. Returns its name.
    pub(crate) async fn hold(
        &self,
        daemon: &Daemon,
        node: &NodeId,
        namespace: &Path,
        run: &str,
    ) -> Result<String, DaemonError> {
        let name = format!("cotorra-{run}-{node}");
        let lock = Rc::clone(self.nodes.borrow_mut().entry(node.clone()).or_default());
        let _one_at_a_time = lock.lock().await;
        match daemon.state(&name).await {
            Ok(state) if state.process.is_some() => return Ok(name),
            Err(error) if error.is_missing() => {}
            Err(error) => return Err(error),
            // One that the daemon killed when it was started again.
            Ok(_) => daemon.remove(&name).await?,
        }
        if !Self::has_program() {
            let what = format!("containers of Docker cannot join nodes on {}", std::env::consts::ARCH);
            return Err(rejected(format!("{what}: use podman")));
        }
        let container = container(node, namespace, run);
        match daemon.create(&name, container.clone()).await {
            Err(error) if error.is_missing() => {
                self.make_image(daemon).await?;
                daemon.create(&name, container).await?;
            }
            created => created?,
        }
        daemon.start(&name).await?;
        enters(daemon, &name, namespace).await?;
        Ok(name)
    }

    /// Whether there are holders on this machine's architecture.
    pub(crate) const fn has_program() -> bool {
        !CODE.is_empty()
    }

    /// Makes the image, unless the engine has it.
    pub(crate) async fn make_image(&self, daemon: &Daemon) -> Result<(), DaemonError> {
        let _one_at_a_time = self.image.lock().await;
        if daemon.has_image(REFERENCE).await? {
            return Ok(());
        }
        let (name, tag) = REFERENCE.split_once(':').expect("it has a tag");
        daemon.import(name, tag, tar(PROGRAM, &program())).await
    }
}

/// Waits until a holder has entered a namespace.
async fn enters(daemon: &Daemon, name: &str, namespace: &Path) -> Result<(), DaemonError> {
    let wanted = fs::metadata(namespace).map_err(|e| rejected(format!("{}: {e}", namespace.display())))?;
    let mut retries = Retries::default();
    loop {
        let process = daemon.state(name).await?.process;
        let process = process.ok_or_else(|| {
            rejected("the engine keeps a container from the namespace of its node".to_owned())
        })?;
        let its = fs::metadata(format!("/proc/{process}/ns/net"));
        if its.is_ok_and(|its| (its.dev(), its.ino()) == (wanted.dev(), wanted.ino())) {
            return Ok(());
        }
        retries.wait().await;
    }
}

fn rejected(message: String) -> DaemonError {
    DaemonError::Rejected { status: 500, message }
}

fn container(node: &NodeId, namespace: &Path, run: &str) -> Container {
    let host_config = HostConfig {
        // It leaves this network at once. A network of its own would take Docker as long as all the rest.
        network_mode: "host".to_owned(),
        mounts: vec![Mount::bind(namespace, Path::new("/ns"), true)],
        cap_drop: vec!["ALL".to_owned()],
        // To enter the namespace. Nothing of others runs in it.
        cap_add: vec!["SYS_ADMIN".to_owned()],
        limits: None,
    };
    Container {
        image: REFERENCE.to_owned(),
        entrypoint: Some(vec![format!("/{PROGRAM}")]),
        hostname: Some(node.to_string()),
        labels: labels(run, "", node),
        host_config,
        ..Container::default()
    }
}

/// Returns the program as an ELF file with one segment: the whole file, which can be read and executed.
fn program() -> Vec<u8> {
    let size = HEADERS + CODE.len() as u64;
    let mut file = b"\x7fELF\x02\x01\x01\0\0\0\0\0\0\0\0\0".to_vec();
    let short = |file: &mut Vec<u8>, values: &[u16]| values.iter().for_each(|v| file.extend(v.to_le_bytes()));
    let word = |file: &mut Vec<u8>, values: &[u32]| values.iter().for_each(|v| file.extend(v.to_le_bytes()));
    let long = |file: &mut Vec<u8>, values: &[u64]| values.iter().for_each(|v| file.extend(v.to_le_bytes()));
    // An executable; version 1; entry, segments, no sections.
    short(&mut file, &[2, MACHINE]);
    word(&mut file, &[1]);
    long(&mut file, &[BASE + HEADERS, 64, 0]);
    word(&mut file, &[0]);
    short(&mut file, &[64, 56, 1, 64, 0, 0]);
    // Loaded, readable and executable; offset, addresses, sizes, alignment.
    word(&mut file, &[1, 5]);
    long(&mut file, &[0, BASE, BASE, size, size, 0x1000]);
    file.extend(CODE);
    file
}

/// Returns a tar archive (POSIX ustar) with one executable file.
fn tar(name: &str, content: &[u8]) -> Vec<u8> {
    const BLOCK: usize = 512;
    let mut header = [0; BLOCK];
    let mut put = |at: usize, text: &str| header[at..at + text.len()].copy_from_slice(text.as_bytes());
    put(0, name);
    put(100, "0000755\0");
    put(108, "0000000\0");
    put(116, "0000000\0");
    put(124, &format!("{:011o}\0", content.len()));
    put(136, "00000000000\0");
    put(148, "        ");
    put(156, "0");
    put(257, "ustar\x0000");
    let sum: u32 = header.iter().map(|byte| u32::from(*byte)).sum();
    header[148..156].copy_from_slice(format!("{sum:06o}\0 ").as_bytes());
    let mut archive = header.to_vec();
    archive.extend(content);
    archive.resize(archive.len().next_multiple_of(BLOCK) + 2 * BLOCK, 0);
    archive
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use super::*;

    #[test]
    fn a_holder_without_a_namespace_exits_with_status_1() {
        let folder = tempfile::tempdir().unwrap();
        let archive = folder.path().join("holder.tar");
        fs::write(&archive, tar(PROGRAM, &program())).unwrap();
        let unpacked =
            Command::new("tar").arg("-xf").arg(&archive).arg("-C").arg(folder.path()).status().unwrap();
        assert!(unpacked.success());
        // There is no `/ns` here.
        let ended = Command::new(folder.path().join(PROGRAM)).status().unwrap();
        assert_eq!(ended.code(), Some(1));
    }
}
