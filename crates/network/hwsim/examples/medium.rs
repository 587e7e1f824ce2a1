//! Makes the air of a testbed file the medium of this kernel's simulated radios, until it is killed.
//!
//!     medium TESTBED NODE=ADDRESS...
//!
//! Each radio has the antenna of a robot or a radio unit. `ADDRESS` is the radio's hardware address: 42:00:00:00:00:00 for the
//! first radio that mac80211_hwsim makes by itself, 42:00:00:00:01:00 for the second.
#![allow(clippy::disallowed_types, reason = "the kernel's radios run by the machine's clock")]

use std::{env, error::Error, fs, path::Path, time::Instant};

use cotorra_datapath::be_punctual;
use cotorra_fabric::Fabric;
use cotorra_graph::Timestamp;
use cotorra_hwsim::{Exchange, MacAddress, MediumSocket};
use rustix::event::{PollFd, PollFlags, Timespec, poll};

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = env::args().skip(1);
    let file = arguments.next().ok_or("usage: medium TESTBED NODE=ADDRESS...")?;
    let graph = cotorra_testbed_file::parse(&file, &fs::read_to_string(&file)?, Path::new(&file))?.graph;
    let mut fabric = Fabric::new(&graph, 1)?;
    let mut exchange = Exchange::new(MediumSocket::register()?);
    for argument in arguments {
        let (node, address) = argument.split_once('=').ok_or("an antenna is NODE=ADDRESS")?;
        exchange.join(Timestamp::ZERO, &mut fabric, &node.parse()?, address_of(address)?)?;
    }
    let began = Instant::now();
    let now = || Timestamp::ZERO + began.elapsed();
    be_punctual();
    let mut woke = now();
    let mut deadline = fabric.poll(woke, &mut |_, _| {});
    loop {
        let wait = deadline.map(|deadline| {
            let wait = deadline.since(woke);
            Timespec { tv_sec: wait.as_secs() as i64, tv_nsec: wait.subsec_nanos().into() }
        });
        let readable = poll(&mut [PollFd::new(&exchange, PollFlags::IN)], wait.as_ref())?;
        woke = now();
        if readable == 0 {
            exchange.nothing_waits();
        } else {
            exchange.receive(woke, &mut fabric)?;
        }
        fabric.poll(woke, &mut |_, _| {});
        exchange.deliver(woke, &mut fabric)?;
        // Refusals may have changed it.
        deadline = fabric.poll(woke, &mut |_, _| {});
    }
}

fn address_of(text: &str) -> Result<MacAddress, Box<dyn Error>> {
    let bytes = text.split(':').map(|byte| u8::from_str_radix(byte, 16)).collect::<Result<Vec<_>, _>>()?;
    Ok(MacAddress(bytes.try_into().map_err(|_| format!("{text} is no hardware address"))?))
}
