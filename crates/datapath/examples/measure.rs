//! Prints what the datapath reaches on this machine.

use std::time::Duration;

use cotorra_datapath::{
    PortKind,
    bench::{Setting, bring_up, packet_rate, rate_error, round_trip, tcp_throughput},
};
use cotorra_graph::{BitRate, Conditions, Jitter, JitterDistribution, Loss, Probability};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let privilege = cotorra_datapath::enter_user_namespace_if_needed()?;
    println!("{privilege:?}");
    for capability in cotorra_datapath::probe() {
        println!("{:30} {:?}", capability.name, capability.state);
    }
    let only = std::env::args().nth(1);
    let wants = |name: &str| only.as_deref().is_none_or(|o| o == name);
    for port in [PortKind::Tap, PortKind::PacketSocket] {
        if let Err(e) = measure(port, &wants) {
            println!("{port:?}: {e}");
        }
    }
    Ok(())
}

fn measure(port: PortKind, wants: &dyn Fn(&str) -> bool) -> Result<(), Box<dyn std::error::Error>> {
    let setting = Setting { port, ..Setting::default() };
    let none = Conditions::default();
    let seconds = Duration::from_secs(3);
    println!("{port:?}");
    if wants("rtt") {
        println!("  round trip, 2 x 0 ms: {:?}", round_trip(setting, Duration::ZERO, 5000)?);
        println!("  round trip, 2 x 1 ms: {:?}", round_trip(setting, Duration::from_millis(1), 1500)?);
    }
    if wants("tcp") {
        println!("  TCP, 1 link: {:.1} Gbit/s", tcp_throughput(setting, &none, 1, seconds)? / 1e9);
        println!("  TCP, 3 links: {:.1} Gbit/s", tcp_throughput(setting, &none, 3, seconds)? / 1e9);
    }
    if wants("loss") {
        let rate = Probability::new(0.001).ok_or("a probability")?;
        let loss = Conditions { loss: Loss::Independent { rate }, ..none.clone() };
        println!("  TCP, loss of 0.1 %: {:.1} Gbit/s", tcp_throughput(setting, &loss, 1, seconds)? / 1e9);
        let jitter =
            Jitter { deviation: Duration::from_micros(20), distribution: JitterDistribution::Normal };
        let jitter = Conditions { delay: Duration::from_micros(100), jitter: Some(jitter), ..none.clone() };
        println!("  TCP, jitter: {:.1} Gbit/s", tcp_throughput(setting, &jitter, 1, seconds)? / 1e9);
    }
    if wants("packets") {
        println!("  small packets: {:?}", packet_rate(setting, seconds)?);
    }
    if wants("rate") {
        let rate = BitRate::from_mbps(100.0).ok_or("a rate")?;
        println!("  rate error at 100 Mbit/s: {:.3} %", rate_error(setting, rate, seconds)? * 100.0);
    }
    if wants("up") {
        println!("  50 hosts: {:?}", bring_up(setting, 50)?);
        println!("  1000 hosts: {:?}", bring_up(setting, 1000)?);
    }
    Ok(())
}
