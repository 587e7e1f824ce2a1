//! Tries of frames to one radio: how many are lost, and what the kernel knows of them.

use std::{fs, net::UdpSocket, time::Duration};

use cotorra_datapath::Namespace;
use cotorra_fabric::PhyRate;
use cotorra_hwsim::{Phys, TryCounts};

use crate::rig::{Air, PATH_LOSS, ROBOT, is_installed};

/// Frames of a robot's, by the medium and by its kernel.
#[derive(Debug)]
struct Counts {
    medium: TryCounts,
    /// `tx packets`, `tx retries` and `tx failed` of `iw station dump`.
    kernel: [u64; 3],
}

/// A robot in an open network, with its namespace.
struct Floor {
    air: Air,
    namespace: Namespace,
    /// The robot's socket, and that of the access point.
    sockets: [UdpSocket; 2],
}

impl Floor {
    /// Brings up a network of 802.11g, or of 802.11n.
    fn up(has_802_11n: bool) -> Option<Self> {
        if !is_installed("hostapd") {
            eprintln!("there is no hostapd: nothing is tested");
            return None;
        }
        let mut air = Air::new(&[(0.0, 1)])?;
        let namespace = Namespace::new().unwrap();
        let mut phys = Phys::new();
        phys.move_to("robot", &namespace).unwrap();
        namespace.run(|| Phys::new().add_station("robot", "robot")).unwrap();
        phys.add_station("ap0", "ap0").unwrap();
        let configuration = format!(
            "interface=ap0\ndriver=nl80211\nssid=lab\nhw_mode=g\nchannel=1\nwmm_enabled=1\nieee80211n={}\n",
            u8::from(has_802_11n)
        );
        fs::write("/run/ap0.conf", configuration).unwrap();
        air.sh(None, "hostapd -B -P /run/ap0.pid /run/ap0.conf >/dev/null; ip addr add 10.99.0.1/24 dev ap0");
        let ways =
            "ip link set robot up; ip addr add 10.99.0.2/24 dev robot; iw dev robot connect -w lab 2412";
        air.sh(Some(&namespace), ways);
        let sockets =
            [namespace.udp_socket("10.99.0.2:7000").unwrap(), UdpSocket::bind("10.99.0.1:7000").unwrap()];
        sockets.iter().for_each(|socket| socket.set_nonblocking(true).unwrap());
        assert!(air.reaches(&sockets[0], &sockets[1], Duration::from_secs(10)));
        Some(Self { air, namespace, sockets })
    }

    fn robot(&mut self, command: &str) -> String {
        self.air.sh(Some(&self.namespace), command)
    }

    /// Sends datagrams from the robot, one each interval. Returns how many arrived.
    fn send(&mut self, count: u32, payload: usize, interval: Duration) -> u32 {
        let [robot, there] = &self.sockets;
        let mut received = 0;
        for _ in 0..count {
            _ = robot.send_to(&vec![0; payload], there.local_addr().unwrap());
            self.air.run_until(interval, || false);
            while there.recv(&mut [0; 2000]).is_ok() {
                received += 1;
            }
        }
        received
    }

    /// Returns the successes and the attempts at all rates that the robot's rate control has seen.
    fn rate_control(&mut self) -> [u64; 2] {
        let statistics = self.robot(
            "cd /sys/kernel/debug; [ -d ieee80211 ] || mount -t debugfs debugfs .; \
             cat /sys/kernel/debug/ieee80211/*/netdev:robot/stations/*/rc_stats_csv",
        );
        let mut sums = [0; 2];
        for line in statistics.lines() {
            // Behind these two are two counts of all rates, and the mean length of A-MPDUs.
            let [.., successes, attempts, _, _, _] = line.split(',').collect::<Vec<_>>()[..] else {
                continue;
            };
            sums[0] += successes.parse::<u64>().unwrap();
            sums[1] += attempts.parse::<u64>().unwrap();
        }
        sums
    }

    /// Returns the counts so far, once nothing is under way.
    fn counts(&mut self) -> Counts {
        self.air.run_until(Duration::from_millis(200), || false);
        let dump = self.robot("iw dev robot station dump");
        let kernel = ["tx packets:", "tx retries:", "tx failed:"].map(|name| {
            let value = dump.lines().find_map(|line| line.trim().strip_prefix(name));
            value.unwrap().trim().parse().unwrap()
        });
        Counts { medium: self.air.exchange.counts(ROBOT).unwrap(), kernel }
    }
}

impl Drop for Floor {
    fn drop(&mut self) {
        self.air.sh(None, "kill $(cat /run/ap0.pid)");
    }
}

impl Counts {
    fn since(&self, before: &Self) -> Self {
        let [now, then] = [self.medium, before.medium];
        let medium = TryCounts {
            frames: now.frames - then.frames,
            acknowledged: now.acknowledged - then.acknowledged,
            tries: now.tries - then.tries,
            aggregates: now.aggregates - then.aggregates,
        };
        let kernel = [0, 1, 2].map(|place| self.kernel[place] - before.kernel[place]);
        Self { medium, kernel }
    }

    /// Checks that the kernel has counted what the medium did.
    fn agree(&self) {
        let TryCounts { frames, acknowledged, tries, .. } = self.medium;
        assert_eq!(self.kernel[1..], [tries - frames, frames - acknowledged], "{self:?}");
    }
}

#[test]
fn tries_are_lost_as_often_as_the_model_says() {
    const FRAMES: u32 = 1000;
    const PAYLOAD: usize = 500;
    let Some(mut floor) = Floor::up(false) else { return };
    // A place from which about a third of the tries is lost at 11 Mbit/s. A frame has a header of 26 bytes, LLC and SNAP, IP,
    // UDP and a check sequence.
    let rate = PhyRate::legacy(110, false).unwrap();
    let bytes = 26 + 8 + 20 + 8 + PAYLOAD as u64 + 4;
    let lost = |m: f64| rate.error_rate(15.0 - PATH_LOSS.loss_db(m, 2412) + 95.0, bytes);
    let place = (100..100_000).map(|m| f64::from(m) / 10.0).find(|m| lost(*m) > 1.0 / 3.0).unwrap();
    floor.robot("iw dev robot set bitrates legacy-2.4 11");
    floor.air.walk_to(place);
    let before = floor.counts();
    let received = floor.send(FRAMES, PAYLOAD, Duration::from_millis(10));
    let counts = floor.counts().since(&before);
    eprintln!("{received} arrive from {place} m, of {counts:?}");
    counts.agree();
    let TryCounts { acknowledged, tries, .. } = counts.medium;
    // The 99 % interval of the binomial distribution.
    let (n, p) = (tries as f64, 1.0 - lost(place));
    let deviation = 2.576 * (n * p * (1.0 - p)).sqrt();
    eprintln!("{acknowledged} of {tries} tries succeed, where the model says {:.0} ± {deviation:.0}", n * p);
    assert!((acknowledged as f64 - n * p).abs() < deviation);
}

#[test]
fn the_kernel_counts_all_tries_of_frames_that_may_be_aggregated() {
    const FRAMES: u32 = 1000;
    const PAYLOAD: usize = 1000;
    let Some(mut floor) = Floor::up(true) else { return };
    // Until an agreement is made, and rate control has found the rates for a place where the fastest are lost.
    floor.send(100, PAYLOAD, Duration::from_millis(10));
    if floor.counts().medium.aggregates == 0 {
        return eprintln!("this kernel does not say which frames may be aggregated: nothing is tested");
    }
    floor.air.walk_to(70.0);
    floor.send(2 * FRAMES, PAYLOAD, Duration::from_millis(1));
    let before = floor.counts();
    let received = floor.send(FRAMES, PAYLOAD, Duration::from_millis(1));
    let counts = floor.counts().since(&before);
    eprintln!("{received} of {FRAMES} arrive, of {counts:?}");
    counts.agree();
    let TryCounts { frames, tries, aggregates, .. } = counts.medium;
    assert!(aggregates >= FRAMES.into() && tries > frames + 50, "{counts:?}");
    // Its rate control has learned from them. It adds them up each 50 ms.
    let [successes, attempts] = floor.rate_control();
    let TryCounts { acknowledged, tries, .. } = floor.counts().medium;
    eprintln!("{successes} of {attempts} by rate control, {acknowledged} of {tries} by the medium");
    assert!(successes <= acknowledged && attempts <= tries, "it knows no more than was tried");
    assert!(attempts > tries * 9 / 10 && successes > acknowledged * 9 / 10, "it knows of nearly all");
}
