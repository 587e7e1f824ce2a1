//! Two radios in two namespaces.

use std::{net::UdpSocket, time::Duration};

use cotorra_datapath::Namespace;
use cotorra_fabric::PhyRate;
use cotorra_hwsim::{Error, MacAddress, MediumSocket, Phys, Radios};

use crate::rig::{Air, PATH_LOSS, names, radio};

/// Joins both radios to an ad-hoc network. Returns a socket of each; the robot's radio is in the namespace.
fn join(air: &mut Air, namespace: &Namespace) -> [UdpSocket; 2] {
    Phys::new().add_station("ap0", "ap0").unwrap();
    namespace.run(|| Phys::new().add_station("robot", "robot")).unwrap();
    let join = |interface: &str, address: &str| {
        format!(
            "iw dev {interface} set type ibss; ip link set {interface} up; ip addr add {address}/24 dev {interface}; \
             iw dev {interface} ibss join air 2412 fixed-freq 02:11:22:33:44:55"
        )
    };
    air.sh(None, &join("ap0", "10.99.0.1"));
    air.sh(Some(namespace), &join("robot", "10.99.0.2"));
    let here = UdpSocket::bind("10.99.0.1:7000").unwrap();
    let there = namespace.udp_socket("10.99.0.2:7000").unwrap();
    here.set_nonblocking(true).unwrap();
    there.set_nonblocking(true).unwrap();
    [here, there]
}

#[test]
fn radios_of_two_namespaces_talk_over_the_fabrics_air() {
    let Some(mut air) = Air::new(&[(0.0, 1)]) else { return };
    assert!(matches!(MediumSocket::register(), Err(Error::Taken)));
    let third = MacAddress([2, 0, 0, 0xc0, 0, 3]);
    assert!(
        matches!(air.radios.create(&radio("robot", third)), Err(Error::NameTaken(name)) if name == "robot")
    );
    assert_eq!(names(&mut air.radios), ["ap0", "robot"]);

    let listed = air.radios.list().unwrap();
    let robot = listed.iter().find_map(|radio| radio.id.filter(|_| radio.name.as_deref() == Some("robot")));
    let robot = robot.unwrap();

    // Moved by a descriptor, the second one is seen in its namespace alone.
    let namespace = Namespace::new().unwrap();
    let mut phys = Phys::new();
    phys.move_to("robot", &namespace).unwrap();
    assert!(matches!(phys.move_to("robot", &namespace), Err(Error::NoPhy(_))));
    assert_eq!(names(&mut air.radios), ["ap0"]);
    assert!(air.radios.delete(robot).is_err(), "its phy is elsewhere");
    assert_eq!(namespace.run(|| names(&mut Radios::new())), ["robot"]);

    let [here, there] = join(&mut air, &namespace);
    assert!(air.reaches(&there, &here, Duration::from_secs(10)));
    assert!(air.reaches(&here, &there, Duration::from_secs(10)));

    // The signal is the model's, in both directions: 15 dBm and 20 dBm less the loss over 10 m.
    let loss = PATH_LOSS.loss_db(10.0, 2412);
    let stations = air.sh(None, "iw dev ap0 station dump");
    let theirs = air.sh(Some(&namespace), "iw dev robot station dump");
    for (dump, power) in [(stations, 15.0), (theirs, 20.0)] {
        let signal = dump.lines().find_map(|line| line.trim().strip_prefix("signal:").map(str::trim));
        let signal: f64 = signal.unwrap().split_whitespace().next().unwrap().parse().unwrap();
        assert!((signal - (power - loss)).abs() <= 0.5, "{signal} dBm, not {}", power - loss);
    }

    // Out of reach, nothing arrives or is acknowledged.
    air.walk_to(10_000.0);
    // Frames that were on their way still arrive.
    air.run_until(Duration::from_secs(1), || false);
    assert!(!air.reaches(&there, &here, Duration::from_secs(3)));
    air.walk_to(10.0);
    assert!(air.reaches(&there, &here, Duration::from_secs(10)));

    // Radios go with the socket that created them, wherever their phys are.
    drop(std::mem::take(&mut air.radios));
    assert!(air.run_until(Duration::from_secs(5), || names(&mut Radios::new()).is_empty()));
    assert!(namespace.run(|| names(&mut Radios::new())).is_empty());
    let Air { exchange, turn, .. } = air;
    drop(exchange);
    MediumSocket::register().unwrap();
    drop(turn);
}

#[test]
fn broadcasts_are_lost_as_often_as_the_model_says() {
    const FRAMES: u32 = 1000;
    const PAYLOAD: usize = 500;
    let Some(mut air) = Air::new(&[(0.0, 1)]) else { return };
    let namespace = Namespace::new().unwrap();
    Phys::new().move_to("robot", &namespace).unwrap();
    let [here, there] = join(&mut air, &namespace);
    assert!(air.reaches(&there, &here, Duration::from_secs(10)));

    // A place from which about a third of them is lost at 1 Mbit/s. A frame has a header of 24 bytes, LLC and SNAP, IP, UDP and a
    // check sequence.
    let rate = PhyRate::legacy(10, false).unwrap();
    let bytes = 24 + 8 + 20 + 8 + PAYLOAD as u64 + 4;
    let lost = |m: f64| rate.error_rate(15.0 - PATH_LOSS.loss_db(m, 2412) + 95.0, bytes);
    let place = (10..10_000).map(f64::from).find(|m| lost(*m) > 1.0 / 3.0).unwrap();
    air.walk_to(place);
    let all = UdpSocket::bind("0.0.0.0:7001").unwrap();
    all.set_nonblocking(true).unwrap();
    there.set_broadcast(true).unwrap();
    let mut received = 0;
    for _ in 0..FRAMES {
        there.send_to(&[0; PAYLOAD], "10.99.0.255:7001").unwrap();
        air.run_until(Duration::from_millis(20), || false);
        while all.recv(&mut [0; PAYLOAD]).is_ok() {
            received += 1;
        }
    }
    // The 99.9 % interval of the binomial distribution.
    let (n, p) = (f64::from(FRAMES), 1.0 - lost(place));
    let deviation = 3.29 * (n * p * (1.0 - p)).sqrt();
    eprintln!(
        "{received} of {FRAMES} broadcasts from {place} m, where the model says {:.0} ± {deviation:.0}",
        n * p
    );
    assert!((f64::from(received) - n * p).abs() < deviation);
}
