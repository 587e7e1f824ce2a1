//! Packet sockets (packet(7)), and the interfaces that they are bound to.

use std::{
    ffi::CStr,
    io, mem,
    net::{Ipv4Addr, SocketAddrV4},
    os::fd::{AsRawFd, BorrowedFd, OwnedFd},
    time::Duration,
};

use libc::c_int;

use super::{check, check_len, fill_frame, own, set_option};

const PACKET_IGNORE_OUTGOING: c_int = 23;

/// An interface as the kernel has it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Interface {
    pub(crate) index: u32,
    pub(crate) is_up: bool,
    /// Whether its frames have an Ethernet header, and are those of a network.
    pub(crate) is_ethernet: bool,
    /// Largest payload of a frame, bytes.
    pub(crate) mtu: u32,
}

/// Returns an interface of the network namespace in which `socket` was opened.
pub(crate) fn interface(socket: BorrowedFd<'_>, name: &CStr) -> io::Result<Interface> {
    let ask = |request: libc::c_ulong| {
        // SAFETY: an ifreq is integers and bytes, for which zero is a value.
        let mut message: libc::ifreq = unsafe { mem::zeroed() };
        // The last byte stays zero: names have at most 15 bytes.
        for (to, from) in message.ifr_name[..15].iter_mut().zip(name.to_bytes()) {
            *to = *from as libc::c_char;
        }
        // SAFETY: these requests read the name, and fill in the rest of a live ifreq.
        check(unsafe { libc::ioctl(socket.as_raw_fd(), request as _, &mut message) })?;
        Ok::<_, io::Error>(message.ifr_ifru)
    };
    // SAFETY: the request fills in this member, in all four cases.
    let index = unsafe { ask(libc::SIOCGIFINDEX)?.ifru_ifindex };
    // SAFETY: as above.
    let flags = c_int::from(unsafe { ask(libc::SIOCGIFFLAGS)?.ifru_flags });
    // SAFETY: as above.
    let mtu = unsafe { ask(libc::SIOCGIFMTU)?.ifru_mtu };
    // SAFETY: as above.
    let kind = unsafe { ask(libc::SIOCGIFHWADDR)?.ifru_hwaddr.sa_family };
    Ok(Interface {
        index: index.unsigned_abs(),
        is_up: flags & libc::IFF_UP != 0,
        is_ethernet: kind == libc::ARPHRD_ETHER && flags & libc::IFF_LOOPBACK == 0,
        mtu: mtu.unsigned_abs(),
    })
}

/// Opens a packet socket on an interface of the calling thread's network namespace. It receives incoming frames only,
/// each behind its `virtio_net_hdr`. [`read_frame_with_age`] returns the age of frames.
pub(crate) fn packet_socket(interface: u32, buffer_bytes: c_int) -> io::Result<OwnedFd> {
    let socket = unbound_packet_socket(buffer_bytes)?;
    let on: c_int = 1;
    set_option(&socket, libc::SOL_PACKET, libc::PACKET_VNET_HDR, &on)?;
    set_option(&socket, libc::SOL_PACKET, PACKET_IGNORE_OUTGOING, &on)?;
    set_option(&socket, libc::SOL_PACKET, libc::PACKET_QDISC_BYPASS, &on)?;
    set_option(&socket, libc::SOL_SOCKET, libc::SO_TIMESTAMPNS, &on)?;
    bind_packet_socket(&socket, interface, libc::ETH_P_ALL as u16)?;
    Ok(socket)
}

/// Binds a packet socket to an interface of its network namespace. It receives the incoming frames that a program of classic
/// BPF accepts, each behind its `virtio_net_hdr`. Its own frames take the way of all others through the interface's queueing
/// discipline. [`read_frame_with_age`] returns the age of frames.
///
/// The interface also receives frames to `addresses`, promiscuously if it cannot distinguish them, and all multicast,
/// until the socket is closed.
pub(crate) fn bind_filtered(
    socket: &OwnedFd,
    interface: u32,
    filter: &[libc::sock_filter],
    addresses: impl ExactSizeIterator<Item = [u8; 6]>,
) -> io::Result<()> {
    /// Network cards distinguish few addresses.
    const MOST_ADDRESSES: usize = 64;
    let on: c_int = 1;
    set_option(socket, libc::SOL_PACKET, libc::PACKET_VNET_HDR, &on)?;
    set_option(socket, libc::SOL_PACKET, PACKET_IGNORE_OUTGOING, &on)?;
    set_option(socket, libc::SOL_SOCKET, libc::SO_TIMESTAMPNS, &on)?;
    let length = u16::try_from(filter.len()).map_err(|_| io::ErrorKind::InvalidInput)?;
    // The kernel copies the program, and changes nothing.
    let program = libc::sock_fprog { len: length, filter: filter.as_ptr().cast_mut() };
    set_option(socket, libc::SOL_SOCKET, libc::SO_ATTACH_FILTER, &program)?;
    let join = |kind: c_int, address: [u8; 6]| {
        // SAFETY: a packet_mreq is integers and bytes, for which zero is a value.
        let mut membership: libc::packet_mreq = unsafe { mem::zeroed() };
        membership.mr_ifindex = interface as c_int;
        membership.mr_type = kind as u16;
        membership.mr_alen = address.len() as u16;
        membership.mr_address[..address.len()].copy_from_slice(&address);
        set_option(socket, libc::SOL_PACKET, libc::PACKET_ADD_MEMBERSHIP, &membership)
    };
    join(libc::PACKET_MR_ALLMULTI, [0; 6])?;
    if addresses.len() > MOST_ADDRESSES {
        join(libc::PACKET_MR_PROMISC, [0; 6])?;
    } else {
        addresses.into_iter().try_for_each(|address| join(libc::PACKET_MR_UNICAST, address))?;
    }
    bind_packet_socket(socket, interface, libc::ETH_P_ALL as u16)
}

/// Returns how many frames a packet socket had no room for since the last call.
pub(crate) fn overflows(socket: BorrowedFd<'_>) -> io::Result<u64> {
    // SAFETY: a tpacket_stats is integers, for which zero is a value.
    let mut counted: libc::tpacket_stats = unsafe { mem::zeroed() };
    let mut length = mem::size_of_val(&counted) as libc::socklen_t;
    let to = (&raw mut counted).cast();
    // SAFETY: the kernel writes at most `length` bytes, which is the size of `counted`.
    check(unsafe {
        libc::getsockopt(socket.as_raw_fd(), libc::SOL_PACKET, libc::PACKET_STATISTICS, to, &mut length)
    })?;
    Ok(counted.tp_drops.into())
}

/// Opens a packet socket that sends through an interface's queueing discipline and receives frames of one EtherType.
/// [`read_with_age`] returns their age.
pub(crate) fn stamped_packet_socket(
    interface: u32,
    ethertype: u16,
    buffer_bytes: c_int,
) -> io::Result<OwnedFd> {
    let socket = unbound_packet_socket(buffer_bytes)?;
    let on: c_int = 1;
    set_option(&socket, libc::SOL_SOCKET, libc::SO_TIMESTAMPNS, &on)?;
    bind_packet_socket(&socket, interface, ethertype)?;
    Ok(socket)
}

/// Opens a packet socket in the calling thread's network namespace, which receives nothing until it is bound.
pub(crate) fn unbound_packet_socket(buffer_bytes: c_int) -> io::Result<OwnedFd> {
    // With any other protocol it would get frames of all interfaces.
    // SAFETY: takes no pointer and makes a descriptor.
    let socket = unsafe {
        own(libc::socket(libc::AF_PACKET, libc::SOCK_RAW | libc::SOCK_NONBLOCK | libc::SOCK_CLOEXEC, 0))?
    };
    // Only root may exceed the system's limit. An ordinary user gets as much as it allows.
    for (force, plain) in [(libc::SO_RCVBUFFORCE, libc::SO_RCVBUF), (libc::SO_SNDBUFFORCE, libc::SO_SNDBUF)] {
        set_option(&socket, libc::SOL_SOCKET, force, &buffer_bytes)
            .or_else(|_| set_option(&socket, libc::SOL_SOCKET, plain, &buffer_bytes))?;
    }
    Ok(socket)
}

fn bind_packet_socket(socket: &OwnedFd, interface: u32, ethertype: u16) -> io::Result<()> {
    // SAFETY: a sockaddr_ll is integers and bytes, for which zero is a value.
    let mut address: libc::sockaddr_ll = unsafe { mem::zeroed() };
    address.sll_family = libc::AF_PACKET as u16;
    address.sll_protocol = ethertype.to_be();
    address.sll_ifindex = interface as c_int;
    // SAFETY: the pointer is to a live sockaddr_ll of the size given.
    check(unsafe {
        libc::bind(
            socket.as_raw_fd(),
            (&raw const address).cast(),
            mem::size_of::<libc::sockaddr_ll>() as libc::socklen_t,
        )
    })
    .map(drop)
}

/// Reads one frame of a [`stamped_packet_socket`], truncated to the buffer, and returns its length and its age since
/// the kernel received it.
pub(crate) fn read_with_age(fd: BorrowedFd<'_>, buffer: &mut [u8]) -> io::Result<(usize, Duration)> {
    let mut parts = [libc::iovec { iov_base: buffer.as_mut_ptr().cast(), iov_len: buffer.len() }];
    // SAFETY: the part is live memory of ours, of the length stated.
    unsafe { receive_with_age(fd, &mut parts, None) }
}

/// Lets [`read_datagram_with_age`] read the age of a socket's datagrams.
pub(crate) fn stamp_arrivals(socket: BorrowedFd<'_>) -> io::Result<()> {
    let on: c_int = 1;
    set_option(&socket, libc::SOL_SOCKET, libc::SO_TIMESTAMPNS, &on)
}

/// Receives a datagram of an IPv4 socket, truncated to the buffer, and returns its length, its sender and its age since the
/// kernel had it for the socket.
pub(crate) fn read_datagram_with_age(
    fd: BorrowedFd<'_>,
    buffer: &mut [u8],
) -> io::Result<(usize, SocketAddrV4, Duration)> {
    // SAFETY: a sockaddr_in is integers, for which zero is a value.
    let mut from: libc::sockaddr_in = unsafe { mem::zeroed() };
    let mut parts = [libc::iovec { iov_base: buffer.as_mut_ptr().cast(), iov_len: buffer.len() }];
    // SAFETY: the part is live memory of ours, of the length stated.
    let (length, age) = unsafe { receive_with_age(fd, &mut parts, Some(&mut from))? };
    let address = Ipv4Addr::from(u32::from_be(from.sin_addr.s_addr));
    Ok((length, SocketAddrV4::new(address, u16::from_be(from.sin_port)), age))
}

/// Reads one frame as [`read_frame`](super::read_frame) does, and returns its age since the kernel received it, too.
pub(crate) fn read_frame_with_age(
    fd: BorrowedFd<'_>,
    header: &mut [u8],
    buffer: &mut Vec<u8>,
    spill: &mut [u8],
) -> io::Result<(usize, Duration)> {
    let mut age = Duration::ZERO;
    let length = fill_frame(header, buffer, spill, |parts| {
        // SAFETY: the parts are live memory, of the lengths stated.
        let (length, since) = unsafe { receive_with_age(fd, parts, None)? };
        age = since;
        Ok(length)
    })?;
    Ok((length, age))
}

/// Receives a frame or a datagram into the parts, and returns its length and its age. `from` becomes the sender of a datagram.
///
/// # Safety
/// The parts are live memory of the lengths stated, which no other code uses.
unsafe fn receive_with_age(
    fd: BorrowedFd<'_>,
    parts: &mut [libc::iovec],
    from: Option<&mut libc::sockaddr_in>,
) -> io::Result<(usize, Duration)> {
    /// Room for one control message with a timespec, aligned as its header is.
    #[repr(C)]
    struct Control {
        _align: [libc::cmsghdr; 0],
        bytes: [u8; 64],
    }
    let mut control = Control { _align: [], bytes: [0; 64] };
    // SAFETY: a msghdr is integers and pointers, for which zero is a value.
    let mut message: libc::msghdr = unsafe { mem::zeroed() };
    message.msg_iov = parts.as_mut_ptr();
    message.msg_iovlen = parts.len() as _;
    message.msg_control = control.bytes.as_mut_ptr().cast();
    message.msg_controllen = control.bytes.len() as _;
    if let Some(from) = from {
        message.msg_namelen = mem::size_of_val(from) as libc::socklen_t;
        message.msg_name = std::ptr::from_mut(from).cast();
    }
    // SAFETY: the message points to live memory, of the lengths stated.
    let length = check_len(unsafe { libc::recvmsg(fd.as_raw_fd(), &mut message, 0) })?;
    let now = realtime()?;
    // SAFETY: the kernel filled the message in, whose control buffer is live and aligned.
    let first = unsafe { libc::CMSG_FIRSTHDR(&message) };
    // SAFETY: it is null, or points to a header in that buffer.
    let header = unsafe { first.as_ref() };
    let got = header.filter(|h| h.cmsg_level == libc::SOL_SOCKET && h.cmsg_type == libc::SCM_TIMESTAMPNS);
    let age = got.map_or(Duration::ZERO, |_| {
        // SAFETY: the data of such a message is a timespec, which need not be aligned. The pointer to the header
        // points into the whole buffer: a reference to the header alone does not reach what follows it.
        let at = unsafe { libc::CMSG_DATA(first).cast::<libc::timespec>().read_unaligned() };
        now.saturating_sub(since_1970(at))
    });
    Ok((length, age))
}

/// Returns the kernel's wall clock, by which it timestamps packets.
fn realtime() -> io::Result<Duration> {
    // SAFETY: a timespec is integers, for which zero is a value.
    let mut now: libc::timespec = unsafe { mem::zeroed() };
    // SAFETY: the pointer is to a live timespec.
    check(unsafe { libc::clock_gettime(libc::CLOCK_REALTIME, &mut now) })?;
    Ok(since_1970(now))
}

fn since_1970(at: libc::timespec) -> Duration {
    Duration::new(at.tv_sec.max(0) as u64, at.tv_nsec.clamp(0, 999_999_999) as u32)
}
