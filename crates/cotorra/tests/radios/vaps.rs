//! Access points that are deployed and removed while the run goes on, and the WLAN Access Information Service over them.
#![allow(clippy::disallowed_types, clippy::disallowed_methods, reason = "the run's clock is the kernel's")]

use std::time::{Duration, SystemTime};

use serde_json::{Value, json};

use crate::{
    air::Air,
    rig::{FLOOR, Rig},
};

/// The access point of a deployment with a key, which robots of other networks have not.
fn with_key() -> Value {
    json!({ "ssid": "lab", "mobility_domain": 49266, "key": "a1".repeat(32) })
}

#[test]
fn a_vap_with_a_key_beacons_within_a_second_and_takes_its_holder() {
    let Some(mut rig) = Rig::start(FLOOR) else { return };
    let (air, bssid) = (Air::listen(), rig.mac("C"));
    let began = SystemTime::now();
    rig.instruct(json!({ "instruction": "deploy", "radio_unit": "C", "access_point": with_key() })).unwrap();
    let deployed = air.wait_for_beacon(&bssid).duration_since(began).unwrap();
    println!("from the instruction to the first beacon: {:.1} ms", deployed.as_secs_f64() * 1e3);
    assert!(deployed <= Duration::from_secs(1), "{deployed:?}");
    rig.wait_for(|event| event["event"] == "vnf" && event["node"] == "C" && event["state"] == "started");
    // Only the holder of its key gets in.
    let refused = rig.attach("r1", "C").unwrap_err();
    assert!(refused.contains("`C` does not admit `r1`"), "{refused}");
    let provision =
        json!({ "instruction": "provision", "robot": "r1", "radio_unit": "C", "access_point": with_key() });
    rig.instruct(provision).unwrap();
    rig.attach("r1", "C").unwrap();
    let to_vap = rig.wait_for_handover("r1", "C");
    // Its own access point was off meanwhile, as in a federation.
    let home = json!({ "ssid": "lab", "mobility_domain": 49266 });
    rig.instruct(json!({ "instruction": "remove", "radio_unit": "A" })).unwrap();
    rig.instruct(json!({ "instruction": "deploy", "radio_unit": "A", "access_point": home })).unwrap();
    rig.wait_for(|event| event["event"] == "vnf" && event["node"] == "A" && event["state"] == "started");
    rig.attach("r1", "A").unwrap();
    let back = rig.wait_for_handover("r1", "A");
    println!("gaps of roams to the vAP and back: {} ms, {} ms", to_vap["gap_ms"], back["gap_ms"]);
    for roam in [&to_vap, &back] {
        assert!(roam["fast"] == false && roam["gap_ms"].as_f64().unwrap() <= 60.0, "{roam}");
    }
    // It is removed under a robot, which finds back by itself.
    rig.attach("r1", "C").unwrap();
    rig.wait_for_handover("r1", "C");
    rig.instruct(json!({ "instruction": "remove", "radio_unit": "C" })).unwrap();
    let back = rig.wait_for(|event| event["event"] == "handover" && event["robot"] == "r1");
    assert!(back["to"] == "A" || back["to"] == "B", "{back}");
    assert_eq!(rig.end().summary["fidelity"]["valid"], true);
}

#[test]
fn the_wlan_access_information_service_answers_from_real_stations() {
    let Some(mut rig) = Rig::start(FLOOR) else { return };
    let station = rig.mac("r1");
    for unit in ["B", "A"] {
        rig.attach("r1", unit).unwrap();
        rig.wait_for_handover("r1", unit);
        // Signals and rates follow once a second.
        rig.wait(Duration::from_secs(2));
        let bssid = rig.mac(unit);
        let stations = rig.run.get("/wai/v2/queries/sta/sta_information");
        let [of_service] = &stations.as_array().unwrap()[..] else { panic!("{stations}") };
        assert_eq!(of_service["staId"]["macId"], station.as_str(), "{stations}");
        assert_eq!(of_service["apAssociated"]["bssid"], bssid.as_str(), "{stations}");
        let access_points = rig.run.get("/wai/v2/queries/ap/ap_information");
        let counts = access_points.as_array().unwrap().iter().map(|point| {
            (
                point["apId"]["bssid"].as_str().unwrap() == bssid,
                point["bssLoad"]["staCount"].as_u64().unwrap(),
            )
        });
        assert!(counts.clone().all(|(is_it, count)| count == u64::from(is_it)), "{access_points}");
        // The same station, as the access point's own kernel sees it.
        let dump = rig.output(unit, "iw dev wlan0 station dump");
        let value = |name: &str| {
            let line =
                dump.lines().find(|line| line.trim().starts_with(name)).unwrap_or_else(|| panic!("{dump}"));
            line.split_whitespace().find_map(|word| word.parse::<f64>().ok()).unwrap()
        };
        let signal = of_service["rssi"]["rssi"].as_f64().unwrap() / 2.0 - 110.0;
        assert!((signal - value("signal:")).abs() <= 1.0, "{signal}: {dump}");
        for way in ["staLastDataDownlinkRate", "staLastDataUplinkRate"] {
            assert!(of_service["staDataRate"][way].as_u64() > Some(0), "{of_service}");
        }
    }
    rig.end();
}
