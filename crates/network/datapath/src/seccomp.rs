//! The system calls that a confined program is denied: those that change the machine, reach other processes, make
//! namespaces, or are large and new. Everything else is allowed, within the program's capabilities.
//!
//! A filter is a program of the kernel's classic packet filter (seccomp(2)), made before the fork.

use libc::{c_long, sock_filter};

#[cfg(target_arch = "x86_64")]
const ARCHITECTURE: u32 = 0xc000_003e;
#[cfg(target_arch = "aarch64")]
const ARCHITECTURE: u32 = 0xc000_00b7;
#[cfg(target_arch = "riscv64")]
const ARCHITECTURE: u32 = 0xc000_00f3;

const ALLOW: u32 = libc::SECCOMP_RET_ALLOW;
const DENY: u32 = libc::SECCOMP_RET_ERRNO | libc::EPERM as u32;
/// Error of a kernel without the call, so that libraries fall back to an older one.
const MISSING: u32 = libc::SECCOMP_RET_ERRNO | libc::ENOSYS as u32;
const NO_FAMILY: u32 = libc::SECCOMP_RET_ERRNO | libc::EAFNOSUPPORT as u32;

/// Offsets in `struct seccomp_data`; of arguments the lower half.
const NUMBER: u32 = 0;
const ARCHITECTURE_AT: u32 = 4;
const fn argument(index: u32) -> u32 {
    16 + 8 * index
}

const DENIED: &[c_long] = &[
    // Mounts and roots.
    libc::SYS_mount,
    libc::SYS_umount2,
    libc::SYS_pivot_root,
    libc::SYS_chroot,
    libc::SYS_open_tree,
    libc::SYS_move_mount,
    libc::SYS_fsopen,
    libc::SYS_fsconfig,
    libc::SYS_fsmount,
    libc::SYS_fspick,
    libc::SYS_mount_setattr,
    libc::SYS_open_by_handle_at,
    libc::SYS_name_to_handle_at,
    // Namespaces.
    libc::SYS_unshare,
    libc::SYS_setns,
    // Other processes.
    libc::SYS_ptrace,
    libc::SYS_process_vm_readv,
    libc::SYS_process_vm_writev,
    libc::SYS_kcmp,
    libc::SYS_pidfd_getfd,
    libc::SYS_process_madvise,
    // The machine.
    libc::SYS_reboot,
    libc::SYS_kexec_load,
    libc::SYS_init_module,
    libc::SYS_finit_module,
    libc::SYS_delete_module,
    libc::SYS_swapon,
    libc::SYS_swapoff,
    libc::SYS_settimeofday,
    libc::SYS_clock_settime,
    libc::SYS_clock_adjtime,
    libc::SYS_adjtimex,
    libc::SYS_acct,
    libc::SYS_quotactl,
    libc::SYS_syslog,
    libc::SYS_vhangup,
    libc::SYS_fanotify_init,
    // Keys of the user who started the run.
    libc::SYS_add_key,
    libc::SYS_request_key,
    libc::SYS_keyctl,
    // Large parts of the kernel that few programs need.
    libc::SYS_bpf,
    libc::SYS_perf_event_open,
    libc::SYS_userfaultfd,
    libc::SYS_io_uring_setup,
    libc::SYS_io_uring_enter,
    libc::SYS_io_uring_register,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_kexec_file_load,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_iopl,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_ioperm,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_modify_ldt,
];

/// Calls that give a file its mode, with the argument that has it.
const MODES: &[(c_long, u32)] = &[
    #[cfg(target_arch = "x86_64")]
    (libc::SYS_open, 2),
    (libc::SYS_openat, 3),
    #[cfg(target_arch = "x86_64")]
    (libc::SYS_creat, 1),
    #[cfg(target_arch = "x86_64")]
    (libc::SYS_chmod, 1),
    (libc::SYS_fchmod, 1),
    (libc::SYS_fchmodat, 2),
    (libc::SYS_fchmodat2, 2),
    #[cfg(target_arch = "x86_64")]
    (libc::SYS_mknod, 1),
    (libc::SYS_mknodat, 2),
];

/// Bits of a program that runs as its owner or its group, whoever starts it.
const AS_OWNER: u32 = libc::S_ISUID | libc::S_ISGID;

/// Types characters into a terminal as if from the keyboard.
const TIOCSTI: u32 = 0x5412;
const TIOCLINUX: u32 = 0x541c;

const NAMESPACES: u32 = (libc::CLONE_NEWNS
    | libc::CLONE_NEWCGROUP
    | libc::CLONE_NEWUTS
    | libc::CLONE_NEWIPC
    | libc::CLONE_NEWUSER
    | libc::CLONE_NEWPID
    | libc::CLONE_NEWNET) as u32;

/// Address families that stay within the network namespace. Others reach beyond it, such as AF_VSOCK to this
/// machine's own host.
const FAMILIES: &[i32] =
    &[libc::AF_UNIX, libc::AF_INET, libc::AF_INET6, libc::AF_NETLINK, libc::AF_PACKET, libc::AF_CAN];

fn statement(code: u32, k: u32) -> sock_filter {
    sock_filter { code: code as u16, jt: 0, jf: 0, k }
}

fn load(offset: u32) -> sock_filter {
    statement(libc::BPF_LD | libc::BPF_W | libc::BPF_ABS, offset)
}

fn answer(verdict: u32) -> sock_filter {
    statement(libc::BPF_RET | libc::BPF_K, verdict)
}

/// Continues with the next instruction if the test holds, else skips `skip` of them.
fn unless_skip(test: u32, k: u32, skip: usize) -> sock_filter {
    let code = (libc::BPF_JMP | test | libc::BPF_K) as u16;
    sock_filter { code, jt: 0, jf: u8::try_from(skip).expect("blocks are short"), k }
}

/// Runs these instructions if the call has this number.
fn at_call(number: c_long, block: Vec<sock_filter>) -> impl Iterator<Item = sock_filter> {
    std::iter::once(unless_skip(libc::BPF_JEQ, number as u32, block.len())).chain(block)
}

/// Returns `verdict` if the loaded value equals `value`.
fn if_equal(value: u32, verdict: u32) -> [sock_filter; 2] {
    [unless_skip(libc::BPF_JEQ, value, 1), answer(verdict)]
}

/// Returns the filter of all confined programs.
pub(crate) fn filter() -> Vec<sock_filter> {
    let mut filter = vec![load(ARCHITECTURE_AT)];
    // Programs of another architecture number their calls differently.
    filter.extend(unless_equal(ARCHITECTURE));
    filter.push(load(NUMBER));
    #[cfg(target_arch = "x86_64")]
    {
        // The calls of x32 have numbers of their own.
        const X32: u32 = 0x4000_0000;
        filter.extend([unless_skip(libc::BPF_JGE, X32, 1), answer(MISSING)]);
    }
    for call in DENIED {
        filter.extend(if_equal(*call as u32, DENY));
    }
    // Their flags are in memory, which a filter cannot read.
    for call in [libc::SYS_clone3, libc::SYS_openat2] {
        filter.extend(if_equal(call as u32, MISSING));
    }
    for (call, mode) in MODES {
        let block = vec![
            load(argument(*mode)),
            unless_skip(libc::BPF_JSET, AS_OWNER, 1),
            answer(DENY),
            answer(ALLOW),
        ];
        filter.extend(at_call(*call, block));
    }
    let clone =
        vec![load(argument(0)), unless_skip(libc::BPF_JSET, NAMESPACES, 1), answer(DENY), answer(ALLOW)];
    filter.extend(at_call(libc::SYS_clone, clone));
    let mut ioctl = vec![load(argument(1))];
    ioctl.extend([TIOCSTI, TIOCLINUX].into_iter().flat_map(|request| if_equal(request, DENY)));
    ioctl.push(answer(ALLOW));
    filter.extend(at_call(libc::SYS_ioctl, ioctl));
    let mut socket = vec![load(argument(0))];
    socket.extend(FAMILIES.iter().flat_map(|family| if_equal(*family as u32, ALLOW)));
    socket.push(answer(NO_FAMILY));
    filter.extend(at_call(libc::SYS_socket, socket));
    filter.push(answer(ALLOW));
    filter
}

/// Returns an error unless the loaded value equals `value`.
fn unless_equal(value: u32) -> [sock_filter; 2] {
    let code = (libc::BPF_JMP | libc::BPF_JEQ | libc::BPF_K) as u16;
    [sock_filter { code, jt: 1, jf: 0, k: value }, answer(MISSING)]
}
