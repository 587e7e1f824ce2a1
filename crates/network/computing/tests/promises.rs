//! Promises of a server at random: work is conserved, nobody gets more than its limit, and no request is lost unseen.
#![allow(clippy::unwrap_used, reason = "tests may panic")]

use std::{collections::BTreeSet, time::Duration};

use cotorra_computing::{Finished, Limits, Load, Refused, Server};
use cotorra_graph::{Scheduling, Timestamp};
use proptest::{collection::vec, prelude::*};

#[derive(Debug, Clone)]
enum Step {
    Arrive { instance: u64, demand_us: u64 },
    Stop { instance: u64 },
    Start { instance: u64 },
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        20 => (0..4_u64, 0..9000_u64).prop_map(|(instance, demand_us)| Step::Arrive { instance, demand_us }),
        1 => (0..4_u64).prop_map(|instance| Step::Stop { instance }),
        2 => (0..4_u64).prop_map(|instance| Step::Start { instance }),
    ]
}

fn limits() -> impl Strategy<Value = Limits> {
    let scheduling =
        prop_oneof![Just(Scheduling::Shared), (1..4_u32).prop_map(|workers| Scheduling::Fifo { workers })];
    (0.05..3.0_f64, scheduling, 1..12_u32).prop_map(|(cpus, scheduling, backlog)| Limits {
        cpus,
        scheduling,
        backlog,
    })
}

/// What became of all requests.
#[derive(Default)]
struct Seen {
    finished: Vec<Finished<usize>>,
    lost: Vec<usize>,
    dropped: u64,
    load: Load,
}

fn run(cpus: f64, speed: f64, all_limits: &[Limits], steps: &[(u64, Step)]) -> (Seen, Timestamp) {
    let mut server = Server::new(cpus, speed);
    (0..4).for_each(|key| server.start(Timestamp::ZERO, key, all_limits[key as usize]));
    let (mut now, mut seen) = (Timestamp::ZERO, Seen::default());
    for (number, (after_us, step)) in steps.iter().enumerate() {
        now = now + Duration::from_micros(*after_us);
        seen.finished.extend(std::iter::from_fn(|| server.poll(now)));
        match step {
            Step::Arrive { instance, demand_us } => {
                match server.arrive(now, *instance, Duration::from_micros(*demand_us), number) {
                    Ok(()) => {}
                    Err(Refused::Full) => seen.dropped += 1,
                    Err(Refused::NoInstance) => assert!(server.load(*instance).is_none()),
                }
            }
            Step::Stop { instance } => {
                if let Some((load, lost)) = server.stop(now, *instance) {
                    seen.load.add(&load);
                    seen.lost.extend(lost);
                }
            }
            Step::Start { instance } => {
                if server.load(*instance).is_none() {
                    server.start(now, *instance, all_limits[*instance as usize]);
                }
            }
        }
        // One that was finished at this moment is not lost by the step.
        seen.finished.extend(std::iter::from_fn(|| server.poll(now)));
    }
    while let Some(deadline) = server.deadline() {
        now = deadline.max(now);
        seen.finished.extend(std::iter::from_fn(|| server.poll(now)));
    }
    for key in server.instances().collect::<Vec<_>>() {
        let (load, lost) = server.stop(now, key).unwrap();
        assert!(lost.is_empty(), "all is served in the end");
        seen.load.add(&load);
    }
    (seen, now)
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn every_request_is_finished_dropped_or_lost_and_work_is_conserved(
        cpus in 0.1..4.0_f64,
        speed in 0.2..3.0_f64,
        all_limits in vec(limits(), 4),
        steps in vec((0..5000_u64, step()), 1..120),
    ) {
        let (seen, end) = run(cpus, speed, &all_limits, &steps);
        let tokens: BTreeSet<_> = seen.finished.iter().map(|its| its.token).chain(seen.lost.iter().copied()).collect();
        prop_assert_eq!(tokens.len(), seen.finished.len() + seen.lost.len());
        let Load { arrived, served, dropped, .. } = seen.load;
        prop_assert_eq!((served, dropped), (seen.finished.len() as u64, seen.dropped));
        prop_assert_eq!(arrived, served + dropped + seen.lost.len() as u64);
        prop_assert!(seen.finished.is_sorted_by_key(|its| its.at));
        // Never more than the CPUs, nor than the limits.
        let elapsed = end.since(Timestamp::ZERO).as_secs_f64();
        let limit = all_limits.iter().map(|its| its.cpus).sum::<f64>().min(cpus);
        prop_assert!(seen.load.cpu_time().as_secs_f64() <= elapsed * limit + 1e-8);
        if seen.lost.is_empty() {
            // The work is that of the demands, but for a nanosecond of all CPUs for each request, and rounding of speeds.
            let (used, needed) = (seen.load.cpu_time().as_secs_f64() * speed, seen.load.served_demand.as_secs_f64());
            let allowed = 1e-9 * (1.0 + cpus * speed) * (served + 1) as f64 + 1e-6 * needed;
            prop_assert!((used - needed).abs() <= allowed, "{used} {needed}");
        }
        // None is faster than on a CPU of its own.
        prop_assert!(seen.finished.iter().all(|its| its.at.since(its.arrived) >= its.computing.saturating_sub(Duration::from_nanos(1))));
    }

    #[test]
    fn one_worker_serves_in_the_order_of_arrival(
        all_limits in vec(limits(), 4),
        steps in vec((0..5000_u64, step()), 1..120),
    ) {
        let all_limits: Vec<_> =
            all_limits.into_iter().map(|its| Limits { scheduling: Scheduling::default(), ..its }).collect();
        let (seen, _) = run(1.0, 1.0, &all_limits, &steps);
        for key in 0..4 {
            let order = || seen.finished.iter().filter(|its| its.instance == key).map(|its| its.token);
            prop_assert!(order().is_sorted());
        }
    }

    /// An idle moment with requests left would let the last one finish later than all work takes on one CPU.
    #[test]
    fn a_cpu_is_never_idle_while_a_request_wants_it(
        schedulings in vec(prop_oneof![Just(Scheduling::Shared), Just(Scheduling::default())], 4),
        arrivals in vec((0..3000_u64, 0..4_u64, 1..4000_u64), 1..150),
    ) {
        let mut server = Server::new(1.0, 1.0);
        for (key, scheduling) in schedulings.into_iter().enumerate() {
            server.start(Timestamp::ZERO, key as u64, Limits { cpus: 1.0, scheduling, backlog: 1000 });
        }
        let (mut now, mut busy_until) = (Timestamp::ZERO, Timestamp::ZERO);
        for (after, instance, us) in &arrivals {
            now = now + Duration::from_micros(*after);
            let demand = Duration::from_micros(*us);
            busy_until = busy_until.max(now) + demand;
            server.arrive(now, *instance, demand, ()).unwrap();
        }
        let mut last = Timestamp::ZERO;
        while let Some(deadline) = server.deadline() {
            last = server.poll(deadline).unwrap().at;
        }
        let late = last.as_nanos() as i128 - busy_until.as_nanos() as i128;
        prop_assert!((0..=2 * arrivals.len() as i128).contains(&late), "{late} ns");
    }
}

#[test]
fn an_over_committed_server_slows_all_and_small_demands_least() {
    let ms = |ms| Timestamp::ZERO + Duration::from_millis(ms);
    let mut server = Server::new(1.0, 2.0);
    let limit = |cpus| Limits { cpus, scheduling: Scheduling::default(), backlog: 10 };
    server.start(Timestamp::ZERO, 1, limit(0.2));
    server.start(Timestamp::ZERO, 2, limit(1.0));
    server.start(Timestamp::ZERO, 3, limit(1.0));
    for (instance, demand) in [(1, 4), (2, 8), (3, 16)] {
        server.arrive(Timestamp::ZERO, instance, Duration::from_millis(demand), ()).unwrap();
    }
    let finished: Vec<_> = std::iter::from_fn(|| {
        let deadline = server.deadline()?;
        server.poll(deadline).map(|its| (its.instance, its.at))
    })
    .collect();
    // Of CPUs of speed 2, they get 0.2, 0.4 and 0.4; from 10 ms on the third gets 0.8.
    let whole = |at: Timestamp| Timestamp::from_nanos(at.as_nanos() / 1000 * 1000);
    let finished: Vec<_> = finished.into_iter().map(|(instance, at)| (instance, whole(at))).collect();
    assert_eq!(finished, [(1, ms(10)), (2, ms(10)), (3, ms(14))]);
}

#[test]
fn a_stopped_instance_loses_its_requests_and_leaves_its_share() {
    let mut server = Server::new(1.0, 1.0);
    let limit = Limits { cpus: 1.0, scheduling: Scheduling::Shared, backlog: 2 };
    let at = |ms| Timestamp::ZERO + Duration::from_millis(ms);
    [1, 2].iter().for_each(|key| server.start(at(0), *key, limit));
    [("a", 1), ("b", 1), ("c", 2)]
        .iter()
        .for_each(|(token, key)| server.arrive(at(0), *key, Duration::from_millis(10), *token).unwrap());
    assert_eq!(server.arrive(at(0), 1, Duration::from_millis(1), "d"), Err(Refused::Full));
    assert_eq!(server.arrive(at(0), 9, Duration::from_millis(1), "e"), Err(Refused::NoInstance));
    let (load, mut lost) = server.stop(at(4), 1).unwrap();
    lost.sort_unstable();
    assert_eq!(lost, ["a", "b"]);
    assert_eq!((load.arrived, load.served, load.dropped, load.most_requests), (3, 0, 1, 2));
    assert_eq!((load.cpu_time(), load.in_system), (Duration::from_millis(2), Duration::from_millis(8)));
    // The other did 2 ms of its 10 ms by then.
    let last = server.poll(at(12)).unwrap();
    assert_eq!(
        (last.at, last.token, last.computing, last.waiting()),
        (at(12), "c", Duration::from_millis(10), Duration::from_millis(2))
    );
    assert_eq!(server.deadline(), None);
}
