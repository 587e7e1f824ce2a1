//! Wired links keep the reservations of pinned paths.

use cotorra_fabric::{Fabric, PinnedPath, PortId, Reservation};
use cotorra_graph::{BitRate, ConditionChange, Conditions, QueueLimit, Rate, Timestamp};

use crate::common::{A, B, Delivery, Network, delay, frame, ms, number, rate, run};

/// The servers a and b send to c over one link of 10 Mbit/s.
fn funnel(bottleneck: Rate) -> Fabric {
    let narrow = Conditions { rate: bottleneck, queue: QueueLimit::Packets(10_000), ..delay(1) };
    Network::new()
        .servers(&["a", "b", "c"])
        .switches(&["s"])
        .link("a", "s", Conditions::default())
        .link("b", "s", Conditions::default())
        .link("s", "c", narrow)
        .fabric(1)
}

const C: PortId = PortId(2);

/// The path from a server to c, with a reservation of so many Mbit/s.
fn path(from: &str, mbps: Option<f64>, is_limited: bool) -> PinnedPath {
    let links = [format!("{from}-s"), "s-c".to_owned()].map(|link| link.parse().unwrap());
    let reservation = mbps.map(|mbps| Reservation { rate: BitRate::from_mbps(mbps).unwrap(), is_limited });
    PinnedPath { from: from.parse().unwrap(), to: "c".parse().unwrap(), links: links.to_vec(), reservation }
}

/// Sends so many full frames from a and b at time 0, and runs for a second. Returns what arrived.
fn saturate(fabric: &mut Fabric, frames: u32) -> Vec<Delivery> {
    for number in 0..frames {
        for from in [A, B] {
            fabric.push(Timestamp::ZERO, from, frame(from, C, number * 2 + from.0 as u32, 1514));
        }
    }
    run(fabric, Timestamp::ZERO, ms(1001.0))
}

/// Returns the rates of a and b, Mbit/s.
fn rates(deliveries: &[Delivery]) -> [f64; 2] {
    [0, 1].map(|from| {
        let of_one = deliveries.iter().filter(|delivery| number(&delivery.frame) % 2 == from);
        of_one.map(|delivery| delivery.frame.bytes().len() as f64 * 8.0 / 1e6).sum()
    })
}

fn assert_rates(deliveries: &[Delivery], expected: [f64; 2]) {
    let rates = rates(deliveries);
    assert!(rates.iter().zip(expected).all(|(rate, expected)| (rate - expected).abs() < 0.06), "{rates:?}");
}

#[test]
fn two_hosts_get_what_is_reserved_for_them() {
    let mut fabric = funnel(rate(10.0));
    fabric.pin(Timestamp::ZERO, &[path("a", Some(7.5), false), path("b", Some(2.5), false)]).unwrap();
    assert_rates(&saturate(&mut fabric, 900), [7.5, 2.5]);
}

#[test]
fn a_host_without_a_reservation_gets_the_rest() {
    let mut fabric = funnel(rate(10.0));
    fabric.pin(Timestamp::ZERO, &[path("a", Some(8.0), false), path("b", None, false)]).unwrap();
    assert_rates(&saturate(&mut fabric, 900), [8.0, 2.0]);
}

#[test]
fn a_limited_path_has_its_rate_at_most_also_on_a_link_without_a_rate() {
    for bottleneck in [rate(10.0), Rate::Unlimited] {
        let mut fabric = funnel(bottleneck);
        fabric.pin(Timestamp::ZERO, &[path("a", Some(2.0), true)]).unwrap();
        let arrived = saturate(&mut fabric, 600);
        let [limited, other] = rates(&arrived);
        assert!((limited - 2.0).abs() < 0.03 && other > 7.2, "{limited} and {other}");
    }
}

#[test]
fn without_its_reservation_a_limited_path_goes_on_at_full_rate_in_order() {
    let mut fabric = funnel(rate(10.0));
    fabric.pin(Timestamp::ZERO, &[path("a", Some(0.1), true)]).unwrap();
    (0..300).for_each(|i| fabric.push(Timestamp::ZERO, A, frame(A, C, i, 1514)));
    let mut arrived = run(&mut fabric, Timestamp::ZERO, ms(500.0));
    assert!(arrived.len() < 10, "{} frames", arrived.len());
    fabric.pin(ms(500.0), &[path("a", None, false)]).unwrap();
    arrived.extend(run(&mut fabric, ms(500.0), ms(1000.0)));
    assert!(arrived.iter().map(|delivery| number(&delivery.frame)).eq(0..300));
    assert_eq!(fabric.in_flight(), 0);
}

#[test]
fn a_reservation_follows_the_links_rate() {
    let mut fabric = funnel(rate(10.0));
    fabric.pin(Timestamp::ZERO, &[path("a", Some(4.0), false)]).unwrap();
    let change = ConditionChange { rate: Some(rate(5.0)), ..ConditionChange::default() };
    fabric.change(Timestamp::ZERO, &"s-c".parse().unwrap(), None, &change).unwrap();
    assert_rates(&saturate(&mut fabric, 500), [4.0, 1.0]);
}

#[test]
fn a_pinned_path_without_a_reservation_changes_no_delivery() {
    let deliveries = |paths: &[PinnedPath]| {
        let mut fabric = funnel(rate(10.0));
        fabric.pin(Timestamp::ZERO, paths).unwrap();
        saturate(&mut fabric, 300)
    };
    assert_eq!(deliveries(&[]), deliveries(&[path("a", None, false), path("b", None, false)]));
}
