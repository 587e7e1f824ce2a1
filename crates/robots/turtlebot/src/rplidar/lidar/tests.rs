use cotorra_testing::turtlebot::{Place, Rplidar, room};
use proptest::{collection::vec, prelude::*};

use super::*;

fn at(ms: u64) -> Timestamp {
    Timestamp::from_nanos(ms * 1_000_000)
}

/// A driver and a lidar in virtual time. `line` changes the bytes of the lidar on their way.
struct Bench<L: FnMut(u64, Vec<u8>) -> Vec<u8>> {
    lidar: Lidar,
    rplidar: Rplidar,
    line: L,
    ms: u64,
}

impl<L: FnMut(u64, Vec<u8>) -> Vec<u8>> Bench<L> {
    fn new(rplidar: Rplidar, line: L) -> Self {
        let mut lidar = Lidar::new(LidarSettings::default());
        lidar.connected(at(0));
        Self { lidar, rplidar, line, ms: 0 }
    }

    fn run(&mut self, until: u64) {
        while self.ms < until {
            self.ms += 1;
            let now = Duration::from_millis(self.ms);
            self.rplidar.advance(now);
            let bytes = (self.line)(self.ms, self.rplidar.take_output());
            self.lidar.receive(at(self.ms), &bytes);
            while let Some(bytes) = self.lidar.poll_transmit(at(self.ms)) {
                self.rplidar.receive(now, &bytes);
            }
        }
    }
}

/// A lidar 1 m from the wall ahead, 2 m from the left one, 3 m from the back one and 4 m from the right one.
fn placed() -> Rplidar {
    Rplidar::new(room((-3.0, -4.0), (1.0, 2.0)), Place::default())
}

fn whole(_: u64, bytes: Vec<u8>) -> Vec<u8> {
    bytes
}

/// Returns the range in this direction, degrees clockwise.
fn range(turn: &Turn, degrees: f64) -> f32 {
    let off = |sample: &&Sample| (sample.angle.to_degrees() - degrees).abs();
    let nearest = turn.samples.iter().min_by(|a, b| off(a).total_cmp(&off(b))).unwrap();
    assert!(off(&nearest) < 2.0, "{nearest:?}");
    nearest.range.unwrap()
}

#[test]
fn express_and_standard_scans_see_the_room() {
    for (is_old, samples) in [(false, 400), (true, 200)] {
        let mut bench = Bench::new(placed(), whole);
        bench.rplidar.is_old = is_old;
        bench.run(2000);
        assert_eq!(bench.lidar.info(), Some((0x28, (1, 0x1D))));
        assert_eq!((bench.lidar.health(), bench.lidar.rejected()), (Some(Health::Good), 0));
        let turn = bench.lidar.turn().unwrap();
        assert!(turn.samples.len().abs_diff(samples) <= 2, "{}", turn.samples.len());
        assert!(turn.period.as_millis().abs_diff(100) <= 3, "{:?}", turn.period);
        for (degrees, metres) in [(0.6, 1.0), (90.0, 4.0), (180.0, 3.0), (270.0, 2.0)] {
            let found = range(turn, degrees);
            assert!((found - metres).abs() < 0.02, "{degrees}°: {found} m");
        }
        let age = at(2000).since(turn.at);
        assert!(age < Duration::from_millis(230), "{age:?}");
    }
}

#[test]
fn lidar_with_an_error_is_restarted() {
    let mut bench = Bench::new(placed(), whole);
    bench.rplidar.error = 0x8001;
    bench.run(3000);
    assert_eq!(bench.rplidar.commands[..4], [0x25, 0x50, 0x52, 0x40]);
    assert_eq!(bench.lidar.health(), Some(Health::Good));
    assert!(bench.lidar.turn().is_some());
}

#[test]
fn silent_lidar_is_started_again_and_keeps_its_last_turn() {
    let mut bench = Bench::new(placed(), whole);
    bench.run(2000);
    bench.rplidar.is_silent = true;
    let turn = bench.lidar.turn().cloned();
    bench.run(6000);
    assert_eq!(bench.lidar.turn().map(|turn| turn.at), turn.map(|turn| turn.at));
    let heard = bench.lidar.heard().unwrap();
    assert!(heard >= at(1990) && heard < at(2010), "{heard}");
    bench.rplidar.is_silent = false;
    bench.run(8000);
    assert!(bench.lidar.turn().unwrap().at > at(7000));
    assert_eq!(bench.lidar.farewell(), [0xA5, 0x25, 0xA5, 0xF0, 2, 0, 0, 0x57]);
}

#[test]
fn torn_and_corrupt_bytes_cost_samples_but_no_turns() {
    let line = |ms: u64, mut bytes: Vec<u8>| {
        match bytes.len() {
            length @ 1.. if ms.is_multiple_of(97) => bytes[length / 2] ^= 0x5A,
            20.. if ms.is_multiple_of(61) => drop(bytes.drain(5..9)),
            _ => {}
        }
        bytes
    };
    let mut bench = Bench::new(placed(), line);
    let (mut turns, mut last) = (0, None);
    for ms in 1..=40 {
        bench.run(ms * 100);
        let turn = bench.lidar.turn();
        if turn.map(|turn| turn.at) != last {
            (turns, last) = (turns + 1, turn.map(|turn| turn.at));
            let turn = turn.unwrap();
            assert!(turn.samples.iter().filter_map(|sample| sample.range).all(|range| range < 5.1));
        }
    }
    assert!(bench.lidar.rejected() > 3, "{}", bench.lidar.rejected());
    assert!(turns > 30, "{turns}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Whatever the line adds and takes away, angles and ranges are possible, and memory is bounded.
    #[test]
    fn broken_line_never_spoils_a_turn(
        noise in vec((0..3000_u64, vec(any::<u8>(), 0..200)), 0..30),
        cut in 0..90_usize,
    ) {
        let line = |ms: u64, mut bytes: Vec<u8>| {
            for (_, noise) in noise.iter().filter(|(at, _)| *at == ms) {
                bytes.extend(noise);
            }
            if ms.is_multiple_of(11) {
                bytes.drain(..cut.min(bytes.len()));
            }
            bytes
        };
        let mut bench = Bench::new(placed(), line);
        bench.run(3000);
        for sample in bench.lidar.turn().map_or(&[][..], |turn| &turn.samples) {
            prop_assert!((0.0..=std::f64::consts::TAU).contains(&sample.angle), "{sample:?}");
            prop_assert!(sample.range.is_none_or(|range| range > 0.0 && range < 17.0), "{sample:?}");
        }
    }
}
