//! Packets per second that the fabric forwards on one core. Run with `cargo bench -p cotorra-fabric`.
//!
//! Each iteration pushes a batch of frames and polls until all are delivered. Buffers come from the fabric and go back, as
//! in a data plane; `alloc` shows that nothing is allocated on the way.

use std::time::Duration;

use cotorra_fabric::{Checksum, Fabric, Frame, Offload, PortId, Segmentation, SegmentationKind};
use cotorra_graph::{BitRate, Conditions, HostAddress, Jitter, Loss, NodeKind, Probability, Rate, Timestamp};
use cotorra_graph_testing as base;
use divan::{
    AllocProfiler, Bencher,
    counter::{BytesCount, ItemsCount},
};

#[global_allocator]
static ALLOCATIONS: AllocProfiler = AllocProfiler::system();

fn main() {
    divan::main();
}

const BATCH: usize = 64;
const HOPS: [usize; 3] = [1, 3, 10];

fn name(i: usize) -> String {
    format!("n{i}")
}

/// Two servers with `hops` equal links between them.
fn chain(hops: usize, conditions: &Conditions) -> Fabric {
    let node = |i| {
        let kind = if i == 0 || i == hops { NodeKind::Server(base::server()) } else { NodeKind::Switch };
        base::node(&name(i), kind)
    };
    let link = |i: usize| base::link(&name(i), &name(i + 1), conditions.clone());
    let graph = base::graph((0..=hops).map(node).collect(), (0..hops).map(link).collect());
    Fabric::new(&graph, 1).expect("the chain is a sound graph")
}

fn small_packet(mut buffer: Vec<u8>) -> Frame {
    buffer.resize(60, 0);
    buffer[..6].copy_from_slice(&HostAddress::of(1).mac);
    buffer[6..12].copy_from_slice(&HostAddress::of(0).mac);
    buffer[12..14].copy_from_slice(&[0x88, 0xb5]);
    Frame::new(buffer)
}

/// 64 KiB of TCP over IPv4.
fn super_packet(mut buffer: Vec<u8>) -> Frame {
    const PAYLOAD: usize = 64_000;
    buffer.resize(14 + 20 + 20 + PAYLOAD, 0);
    buffer[..6].copy_from_slice(&HostAddress::of(1).mac);
    buffer[6..12].copy_from_slice(&HostAddress::of(0).mac);
    buffer[12..15].copy_from_slice(&[0x08, 0x00, 0x45]);
    buffer[16..18].copy_from_slice(&(40 + PAYLOAD as u16).to_be_bytes());
    buffer[23] = 6;
    buffer[26..30].copy_from_slice(&HostAddress::of(0).ipv4.octets());
    buffer[46] = 0x50;
    Frame::with_offload(
        buffer,
        Offload {
            checksum: Some(Checksum { start: 34, offset: 16 }),
            segmentation: Some(Segmentation { kind: SegmentationKind::Tcp4, size: 1448, header_len: 54 }),
        },
    )
}

/// Pushes a batch and polls until it is delivered, in virtual time, for as many rounds as divan wants.
fn through(bencher: Bencher, fabric: &mut Fabric, batch: usize, length: usize, make: fn(Vec<u8>) -> Frame) {
    let mut delivered = Vec::with_capacity(batch * 64);
    let mut now = Timestamp::ZERO;
    let mut round = || {
        for _ in 0..batch {
            let frame = make(fabric.buffer(length));
            fabric.push(now, PortId(0), frame);
        }
        while let Some(next) = fabric.poll(now, &mut |_, frame| delivered.push(frame)) {
            now = next;
        }
        delivered.drain(..).for_each(|frame| fabric.recycle(frame));
        now = now + Duration::from_micros(100);
    };
    // All buffers and queues grow to their final size.
    (0..10).for_each(|_| round());
    bencher.bench_local(round);
}

fn packets(bencher: Bencher, hops: usize, conditions: &Conditions) {
    let bencher = bencher.counter(ItemsCount::new(BATCH));
    through(bencher, &mut chain(hops, conditions), BATCH, 60, small_packet);
}

#[divan::bench(args = HOPS)]
fn unimpaired(bencher: Bencher, hops: usize) {
    packets(bencher, hops, &Conditions::default());
}

#[divan::bench(args = HOPS)]
fn delay(bencher: Bencher, hops: usize) {
    packets(bencher, hops, &Conditions { delay: Duration::from_millis(1), ..Conditions::default() });
}

#[divan::bench(args = HOPS)]
fn delay_and_rate(bencher: Bencher, hops: usize) {
    let bits_per_second = BitRate::from_bits_per_second(10_000_000_000).expect("the rate is above 0");
    let rate = Rate::Fixed { bits_per_second };
    packets(bencher, hops, &Conditions { delay: Duration::from_millis(1), rate, ..Conditions::default() });
}

fn lossy() -> Conditions {
    let jitter = Some(Jitter { deviation: Duration::from_micros(100), ..Jitter::default() });
    let loss = Loss::Independent { rate: Probability::new(0.01).expect("0.01 is a probability") };
    Conditions { delay: Duration::from_millis(1), jitter, loss, ..Conditions::default() }
}

#[divan::bench(args = HOPS)]
fn jitter_and_loss(bencher: Bencher, hops: usize) {
    packets(bencher, hops, &lossy());
}

#[divan::bench]
fn super_packets_whole(bencher: Bencher) {
    let conditions = Conditions { delay: Duration::from_millis(1), ..Conditions::default() };
    through(
        bencher.counter(BytesCount::new(64_000usize)),
        &mut chain(1, &conditions),
        1,
        64_054,
        super_packet,
    );
}

#[divan::bench]
fn super_packets_cut(bencher: Bencher) {
    through(bencher.counter(BytesCount::new(64_000usize)), &mut chain(1, &lossy()), 1, 64_054, super_packet);
}
