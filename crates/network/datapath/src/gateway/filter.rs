//! The filter of a gateway's socket, in classic BPF: the kernel drops the other traffic of the interface before it wakes
//! the fabric's thread. It is coarse; [`Gate`](super::gate::Gate) has the whole rule.

use std::net::Ipv4Addr;

use cotorra_graph::HostAddress;
use libc::{
    BPF_ABS, BPF_B, BPF_H, BPF_JEQ, BPF_JGT, BPF_JMP, BPF_JSET, BPF_K, BPF_LD, BPF_LEN, BPF_RET, BPF_W,
    c_uint, sock_filter,
};

use super::gate::{ARP, GROUP, IPV4};
use crate::port::LARGEST;

/// Tells whether the frame had a VLAN tag, which the kernel has taken off (`SKF_AD_OFF + SKF_AD_VLAN_TAG_PRESENT`).
const VLAN_PRESENT: c_uint = -0x1000_i32 as c_uint + 48;
/// Bytes of an accepted frame to keep: all of them.
const ALL: c_uint = 0x4_0000;

fn statement(code: c_uint, k: c_uint) -> sock_filter {
    sock_filter { code: code as u16, jt: 0, jf: 0, k }
}

fn load(size: c_uint, offset: c_uint) -> sock_filter {
    statement(BPF_LD | size | BPF_ABS, offset)
}

/// Skips so many instructions if the comparison with `k` holds, or if it does not.
fn skip(comparison: c_uint, k: c_uint, [holds, fails]: [u8; 2]) -> sock_filter {
    sock_filter { code: (BPF_JMP | comparison | BPF_K) as u16, jt: holds, jf: fails, k }
}

const DROP: sock_filter = sock_filter { code: (BPF_RET | BPF_K) as u16, jt: 0, jf: 0, k: 0 };
const ACCEPT: sock_filter = sock_filter { code: (BPF_RET | BPF_K) as u16, jt: 0, jf: 0, k: ALL };

/// Accepts a frame whose loaded word is one of the addresses.
fn is_one_of(machines: &[Ipv4Addr]) -> impl Iterator<Item = sock_filter> {
    let compare = |address: &Ipv4Addr| [skip(BPF_JEQ, u32::from(*address), [0, 1]), ACCEPT];
    machines.iter().flat_map(compare).chain([DROP])
}

/// Returns the filter of frames of ARP and IPv4 from these machines to hosts or groups, without VLAN tags and of a length
/// that can be read.
pub(super) fn filter(machines: &[Ipv4Addr]) -> Vec<sock_filter> {
    let first = HostAddress::of(0);
    let [a, b, c, d, ..] = first.mac;
    let mac = u32::from_be_bytes([a, b, c, d]);
    let [high, low, ..] = first.ipv4.octets();
    let network = u32::from(u16::from_be_bytes([high, low]));
    let mut program = vec![
        load(BPF_W, VLAN_PRESENT),
        skip(BPF_JEQ, 0, [1, 0]),
        DROP,
        statement(BPF_LD | BPF_W | BPF_LEN, 0),
        skip(BPF_JGT, LARGEST as u32, [0, 1]),
        DROP,
        load(BPF_B, 0),
        skip(BPF_JSET, GROUP.into(), [3, 0]),
        load(BPF_W, 0),
        skip(BPF_JEQ, mac, [1, 0]),
        DROP,
    ];
    let mut arp = vec![load(BPF_H, 38), skip(BPF_JEQ, network, [1, 0]), DROP, load(BPF_W, 28)];
    arp.extend(is_one_of(machines));
    program.extend([load(BPF_H, 12), skip(BPF_JEQ, ARP.into(), [0, arp.len() as u8])]);
    program.extend(arp);
    program.extend([skip(BPF_JEQ, IPV4.into(), [1, 0]), DROP, load(BPF_W, 26)]);
    program.extend(is_one_of(machines));
    program
}

#[cfg(test)]
pub(super) mod tests {
    use cotorra_graph::Gateway;

    use super::*;

    /// Runs a program over a frame as the kernel does, and returns whether it accepts the frame.
    pub(crate) fn accepts(program: &[sock_filter], frame: &[u8], has_vlan_tag: bool) -> bool {
        let (mut at, mut a) = (0, 0);
        loop {
            let sock_filter { code, jt, jf, k } = program[at];
            at += 1;
            let code = c_uint::from(code);
            let mut jump = |holds| at += usize::from(if holds { jt } else { jf });
            match code & 0x07 {
                BPF_LD if code & 0xe0 == BPF_LEN => a = frame.len() as u32,
                BPF_LD if k == VLAN_PRESENT => a = has_vlan_tag.into(),
                BPF_LD => {
                    let size = match code & 0x18 {
                        BPF_W => 4,
                        BPF_H => 2,
                        _ => 1,
                    };
                    let Some(bytes) = frame.get(k as usize..k as usize + size) else { return false };
                    a = bytes.iter().fold(0, |a, byte| a << 8 | u32::from(*byte));
                }
                BPF_JMP => match code & 0xf0 {
                    BPF_JEQ => jump(a == k),
                    BPF_JGT => jump(a > k),
                    BPF_JSET => jump(a & k != 0),
                    other => panic!("comparison {other:x}"),
                },
                BPF_RET => return k != 0,
                other => panic!("instruction {other:x}"),
            }
        }
    }

    #[test]
    fn the_filter_of_the_most_machines_reaches_its_last() {
        let machines: Vec<_> =
            (1..=Gateway::MAX_MACHINES as u8).map(|n| Ipv4Addr::new(192, 168, 1, n)).collect();
        let program = filter(&machines);
        let mut frame = HostAddress::of(0).mac.to_vec();
        frame.extend([2, 0, 0, 0, 0, 9, 0x08, 0x00]);
        frame.resize(60, 0);
        frame[26..30].copy_from_slice(&machines.last().unwrap().octets());
        assert!(accepts(&program, &frame, false));
        assert!(!accepts(&program, &frame, true), "a frame of a VLAN");
        frame[29] += 1;
        assert!(!accepts(&program, &frame, false), "a machine that is not listed");
        frame.truncate(28);
        assert!(!accepts(&program, &frame, false), "a frame without an address");
        frame.resize(LARGEST + 1, 0);
        frame[26..30].copy_from_slice(&machines[0].octets());
        assert!(!accepts(&program, &frame, false), "a frame longer than can be read");
    }
}
