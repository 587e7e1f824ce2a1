use cotorra_graph::BitRate;
use proptest::prelude::*;

use super::*;

fn at(time: Duration) -> Timestamp {
    Timestamp::ZERO + time
}

fn s(seconds: f64) -> Duration {
    Duration::from_secs_f64(seconds)
}

/// Of so many bytes, of which so many change in a second.
fn pre_copy(bytes: u64, changes: u64, downtime: Duration, rounds: u32) -> StateTransfer {
    let dirty_rate = BitRate::from_bits_per_second(8 * changes).unwrap();
    StateTransfer { bytes, method: TransferMethod::PreCopy(PreCopy { dirty_rate, downtime, rounds }) }
}

/// Copies at a rate, bytes/s, to an instance that starts after a time. Returns the bytes of each copy, and the figures.
fn run(transfer: StateTransfer, rate: f64, start: Duration) -> (Vec<u64>, MigrationFigures) {
    let (mut now, mut migration) = (Duration::ZERO, Migration::new(Timestamp::ZERO, transfer));
    let mut copies = Vec::new();
    while let Some(bytes) = migration.poll() {
        copies.push(bytes);
        let end = now + s(bytes as f64 / rate);
        if !migration.has_started() && start <= end {
            migration.started(at(start));
        }
        now = end;
        migration.copied(at(now));
        if migration.next.is_none() && !migration.has_started() {
            now = start;
            migration.started(at(now));
        }
    }
    assert!(migration.is_done());
    (copies, migration.figures(at(now)))
}

#[test]
fn stop_and_copy_is_down_while_all_is_copied_and_until_the_new_one_has_started() {
    let transfer = StateTransfer { bytes: 10_000_000, method: TransferMethod::StopAndCopy };
    for (start, down) in [(0.0, 0.8), (0.5, 0.8), (2.0, 2.0)] {
        let (copies, figures) = run(transfer, 12.5e6, s(start));
        assert_eq!(copies, [10_000_000]);
        assert_eq!(figures, MigrationFigures { rounds: 0, duration: s(down), downtime: s(down) });
    }
}

#[test]
fn pre_copy_serves_until_the_rest_is_short() {
    // 200 MB over 100 Mbit/s, of which 40 Mbit/s change: each round copies 0.4 times the one before.
    let transfer = pre_copy(200_000_000, 5_000_000, s(0.3), 30);
    let (copies, figures) = run(transfer, 12.5e6, Duration::ZERO);
    assert_eq!(copies, [200_000_000, 80_000_000, 32_000_000, 12_800_000, 5_120_000, 2_048_000]);
    assert_eq!(figures.rounds, 5);
    assert_eq!((figures.downtime, figures.duration), (s(0.16384), s(26.557_44)));
}

#[test]
fn a_state_that_changes_faster_than_it_is_copied_stops_after_its_rounds() {
    let (copies, figures) = run(pre_copy(1_000_000, 20_000_000, s(0.01), 4), 10e6, Duration::ZERO);
    // Never more than there is.
    assert_eq!((copies, figures.rounds), (vec![1_000_000; 5], 4));
    assert_eq!(figures.downtime, s(0.1));
}

#[test]
fn the_last_round_waits_for_the_start_of_the_new_instance() {
    let transfer = pre_copy(1_000_000, 1_000_000, s(0.05), 30);
    // A round takes 0.1 s, in which 0.1 MB change, which would take 0.01 s. Until 0.3 s, 0.3 MB change.
    let (copies, figures) = run(transfer, 10e6, s(0.3));
    assert_eq!((copies, figures.rounds), (vec![1_000_000, 300_000], 1));
    assert_eq!(figures.downtime, s(0.03));
    // Until 0.9 s, 0.9 MB change, which takes too long: another round.
    let (copies, figures) = run(transfer, 10e6, s(0.9));
    assert_eq!((copies, figures.rounds), (vec![1_000_000, 900_000, 90_000], 2));
    assert_eq!(figures.downtime, s(0.009));
}

#[test]
fn an_empty_state_takes_no_copy() {
    for transfer in [
        StateTransfer { bytes: 0, method: TransferMethod::StopAndCopy },
        pre_copy(0, 1_000_000, Duration::ZERO, 3),
    ] {
        let mut migration = Migration::new(Timestamp::ZERO, transfer);
        assert!(migration.poll().is_none() && !migration.is_done());
        migration.started(at(s(1.0)));
        assert!(migration.is_done());
    }
}

proptest! {
    /// Round i copies V·(d/r)^i: n rounds and the rest are V·(1-(d/r)^(n+1))/(1-d/r), and the rest takes V·(d/r)^n/r.
    #[test]
    fn rounds_bytes_and_downtime_have_their_closed_form(
        bytes in 1_000_000_u64..1_000_000_000,
        changes in 1000_u64..100_000_000,
        rate in 1e5_f64..1e9,
        goal_ms in 1_u64..1000,
        most in 1_u32..40,
    ) {
        let (size, ratio, goal) = (bytes as f64, changes as f64 / rate, goal_ms as f64 / 1e3);
        prop_assume!((ratio - 1.0).abs() > 0.01);
        let copied = |round: i32| size * ratio.powi(round).min(1.0);
        let is_short = |round: &i32| copied(*round) / rate <= goal;
        let rounds = (1..most as i32).find(is_short).unwrap_or(most as i32);
        // At the goal itself, rounding to nanoseconds and bytes decides.
        let is_far = |round: i32| (copied(round) / rate / goal - 1.0).abs() > 1e-3;
        prop_assume!((1..=rounds).all(is_far));
        let transfer = pre_copy(bytes, changes, Duration::from_millis(goal_ms), most);
        let (copies, figures) = run(transfer, rate, Duration::ZERO);
        prop_assert_eq!(figures.rounds, rounds as u32);
        prop_assert_eq!(copies.len() as u32, figures.rounds + 1);
        let total = if ratio < 1.0 {
            size * (1.0 - ratio.powi(rounds + 1)) / (1.0 - ratio)
        } else {
            size * f64::from(rounds + 1)
        };
        let found = copies.iter().sum::<u64>() as f64;
        prop_assert!((found - total).abs() < 1e-6 * total + 2.0 * f64::from(rounds), "{found} {total}");
        let downtime = copied(rounds) / rate;
        let rounding = 1e-6 * downtime + 2.0 / rate + 1e-8;
        prop_assert!((figures.downtime.as_secs_f64() - downtime).abs() < rounding, "{figures:?} {downtime}");
        prop_assert!(rounds == most as i32 || figures.downtime.as_secs_f64() <= goal + rounding);
    }

    /// Whatever the times are: one copy at a time, an end after at most so many rounds and one more, and no time down before
    /// the new instance has started.
    #[test]
    fn every_migration_ends(
        bytes in 0_u64..10_000_000,
        changes in 1_u64..100_000_000,
        goal_ms in 0_u64..100,
        most in 1_u32..6,
        start_ms in 0_u64..5000,
        times_ms in prop::collection::vec(0_u64..2000, 7),
    ) {
        let transfer = pre_copy(bytes, changes, Duration::from_millis(goal_ms), most);
        let mut migration = Migration::new(Timestamp::ZERO, transfer);
        let (mut now, start) = (Duration::ZERO, Duration::from_millis(start_ms));
        let mut times = times_ms.into_iter();
        let mut all = 0;
        loop {
            if migration.has_stopped() {
                prop_assert!(migration.has_started());
            }
            match migration.poll() {
                Some(copy) => {
                    all += 1;
                    prop_assert!(copy <= bytes && migration.poll().is_none());
                    now += Duration::from_millis(times.next().unwrap());
                    if now >= start && !migration.has_started() {
                        migration.started(at(now));
                    }
                    migration.copied(at(now));
                }
                None if migration.has_started() => break,
                None => {
                    now = start.max(now);
                    migration.started(at(now));
                }
            }
        }
        prop_assert!(migration.is_done() && all <= most + 1);
        prop_assert!(migration.figures(at(now)).rounds <= most);
    }
}
