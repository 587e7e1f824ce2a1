use cotorra_testing::turtlebot::Kobuki;
use proptest::{collection::vec, prelude::*};

use super::*;

fn at(ms: u64) -> Timestamp {
    Timestamp::from_nanos(ms * 1_000_000)
}

/// A driver and a base in virtual time. `line` changes the bytes of the base on their way.
struct Bench<L: FnMut(u64, Vec<u8>) -> Vec<u8>> {
    base: Base,
    kobuki: Kobuki,
    line: L,
    ms: u64,
}

impl<L: FnMut(u64, Vec<u8>) -> Vec<u8>> Bench<L> {
    fn new(line: L) -> Self {
        let mut base = Base::default();
        base.connected(at(0));
        Self { base, kobuki: Kobuki::default(), line, ms: 0 }
    }

    /// Runs until then, a millisecond at a time, with a command every `interval` milliseconds.
    fn run(&mut self, until: u64, command: Option<(Velocity, u64)>) {
        while self.ms < until {
            self.ms += 1;
            let now = Duration::from_millis(self.ms);
            self.kobuki.advance(now);
            let bytes = (self.line)(self.ms, self.kobuki.take_output());
            self.base.receive(at(self.ms), &bytes);
            if let Some((velocity, interval)) = command
                && self.ms.is_multiple_of(interval)
            {
                let _ = self.base.drive(at(self.ms), velocity);
            }
            while let Some(bytes) = self.base.poll_transmit(at(self.ms)) {
                self.kobuki.receive(now, &bytes);
            }
        }
    }

    /// Time of the last base control that moves, and of the first that stops after it, milliseconds.
    fn end(&self) -> (u64, u64) {
        let controls: Vec<_> =
            self.kobuki.controls.iter().map(|(at, speed, _)| (at.as_millis() as u64, *speed)).collect();
        let last = controls.iter().rposition(|(_, speed)| *speed != 0).unwrap();
        (controls[last].0, controls[last + 1].0)
    }
}

fn whole(_: u64, bytes: Vec<u8>) -> Vec<u8> {
    bytes
}

#[test]
fn a_velocity_counts_from_the_time_at_which_it_was_given_and_one_that_is_too_old_changes_nothing() {
    let mut bench = Bench::new(whole);
    bench.run(1000, None);
    bench.base.follow(at(1000), at(700), Velocity::planar(0.2, 0.0)).unwrap();
    bench.run(1100, None);
    bench.base.follow(at(1100), at(500), Velocity::planar(0.4, 0.0)).unwrap();
    bench.run(1299, None);
    assert_eq!(bench.kobuki.velocity(), (0.2, 0.0));
    bench.run(1500, None);
    assert_eq!(bench.end().1, 1300);
    bench.base.follow(at(1500), at(900), Velocity::planar(0.2, 0.0)).unwrap();
    bench.run(1600, None);
    assert_eq!(bench.end().1, 1300);
}

#[test]
fn a_driven_base_gets_twenty_commands_a_second_and_moves_as_commanded() {
    let mut bench = Bench::new(whole);
    bench.run(100, None);
    assert_eq!(bench.base.faults(), []);
    assert_eq!(bench.base.firmware().unwrap().to_string(), "1.2.0");
    let before = bench.kobuki.controls.len();
    bench.run(1100, Some((Velocity::planar(0.2, 0.0), 200)));
    let sent = bench.kobuki.controls.len() - before;
    // Each of the five commands goes out at once, and then every 50 ms.
    assert!((18..=24).contains(&sent), "{sent}");
    let x = bench.base.odometry().position.0;
    assert!((x - bench.kobuki.place.x).abs() < 0.005 && x > 0.17, "{x}");
    assert!((bench.base.odometry().velocity.linear - 0.2).abs() < 0.005);
    bench.run(1900, Some((Velocity::planar(0.1, -0.8), 200)));
    let (turned, place) = (bench.base.odometry().heading, bench.kobuki.place);
    assert!((turned - place.heading).abs() < 0.02 && turned < -0.5, "{turned} of {place:?}");
    let [_, _, rate] = bench.base.angular_velocity().unwrap().1;
    assert!((rate + 0.8).abs() < 0.01, "{rate}");
    assert!((bench.base.odometry().position.1 - place.y).abs() < 0.005);
}

#[test]
fn base_stops_0_6_s_after_the_last_command() {
    let mut bench = Bench::new(whole);
    bench.run(1000, Some((Velocity::planar(0.2, 0.0), 250)));
    bench.run(3000, None);
    assert_eq!(bench.end(), (1550, 1600));
    let zeros = bench.kobuki.controls.iter().filter(|(at, ..)| at.as_millis() >= 1600).count();
    assert_eq!(zeros, 5, "and then it is left alone");
}

#[test]
fn base_whose_feedback_stops_is_stopped_and_rejects_commands_until_it_is_back() {
    let mut bench = Bench::new(|ms, bytes| if (2000..4000).contains(&ms) { Vec::new() } else { bytes });
    bench.run(3500, Some((Velocity::planar(0.2, 0.0), 100)));
    assert_eq!(bench.base.faults(), [RobotFault::Silent]);
    assert_eq!(bench.base.drive(at(3500), Velocity::default()), Err(RobotFault::Silent));
    // Feedback came at 1980 ms last.
    assert_eq!(bench.end(), (2950, 2980));
    bench.run(4500, Some((Velocity::planar(0.2, 0.0), 100)));
    assert_eq!(bench.base.faults(), []);
    assert!(bench.kobuki.velocity().0 > 0.19);
}

#[test]
fn cliff_or_dropped_wheel_stops_the_base_with_the_next_feedback() {
    for (cliff, wheel_drop, fault) in [(2, 0, RobotFault::Cliff), (0, 1, RobotFault::WheelDrop)] {
        let mut bench = Bench::new(whole);
        bench.run(1000, Some((Velocity::planar(0.3, 0.0), 100)));
        (bench.kobuki.cliff, bench.kobuki.wheel_drop) = (cliff, wheel_drop);
        bench.run(2000, Some((Velocity::planar(0.3, 0.0), 100)));
        assert_eq!(bench.base.faults(), [fault]);
        let (_, stopped) = bench.end();
        assert_eq!(stopped, 1020);
        (bench.kobuki.cliff, bench.kobuki.wheel_drop) = (0, 0);
        bench.run(2200, Some((Velocity::planar(0.3, 0.0), 100)));
        assert!(bench.kobuki.velocity().0 > 0.0, "it goes on when it is well");
    }
}

#[test]
fn bumper_is_reported_and_stops_nothing() {
    let mut bench = Bench::new(whole);
    bench.kobuki.bumper = 2;
    bench.run(1000, Some((Velocity::planar(-0.1, 0.0), 100)));
    assert_eq!(bench.base.basic().unwrap().1.bumper, 2);
    assert!(bench.kobuki.velocity().0 < 0.0, "it may leave the wall");
}

#[test]
fn reopened_port_gets_a_stop_first() {
    let mut bench = Bench::new(whole);
    bench.run(500, Some((Velocity::planar(0.2, 0.0), 100)));
    bench.base.connected(at(501));
    let first = bench.base.poll_transmit(at(501)).unwrap();
    assert_eq!(first, Command::STOP.encode());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Whatever the line does to the base's bytes, the base is commanded to stop 0.6 s after the last accepted command,
    /// and nothing panics.
    #[test]
    fn broken_line_never_keeps_the_base_moving(
        noise in vec((0..3000_u64, vec(any::<u8>(), 0..40)), 0..20),
        cut in 1..60_usize,
        stalls in vec(0..3000_u64, 0..4),
    ) {
        let mut bench = Bench::new(|ms, mut bytes| {
            for (at, noise) in &noise {
                if *at == ms {
                    bytes.extend(noise);
                }
            }
            if ms.is_multiple_of(7) {
                bytes.truncate(bytes.len().saturating_sub(cut));
            }
            if stalls.iter().any(|at| (*at..*at + 300).contains(&ms)) { Vec::new() } else { bytes }
        });
        bench.run(2000, Some((Velocity::planar(0.2, 0.3), 130)));
        bench.run(3000, None);
        let zeros = bench.kobuki.controls.last().unwrap();
        prop_assert_eq!((zeros.1, zeros.2), (0, 0));
        let moving = bench.kobuki.controls.iter().filter(|(_, speed, _)| *speed != 0);
        prop_assert!(moving.map(|(at, ..)| at.as_millis()).max().unwrap_or(0) < 1950 + 600);
        let (x, y) = bench.base.odometry().position;
        prop_assert!(x.is_finite() && y.is_finite() && x.hypot(y) < 100.0);
    }
}
