//! Configuration files, compared with those in `golden`. `COTORRA_BLESS=1` writes those anew.

use std::{env, fs, path::Path};

use cotorra_wifi::{AccessPointDriver, Generation, Security};

use crate::fixture;

const CONTROL: &str = "/run/cotorra/control";

fn compare(name: &str, text: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name);
    if env::var_os("COTORRA_BLESS").is_some() {
        fs::write(&path, text).expect("the golden file can be written");
    }
    let golden = fs::read_to_string(&path).expect("there is a golden file");
    assert_eq!(text, golden, "{name} differs");
}

#[test]
fn each_security_has_its_lines() {
    for (name, security) in fixture::securities() {
        let access_point = fixture::access_point("wlan0", security);
        compare(&format!("{name}.conf"), &access_point.configuration(CONTROL.as_ref()));
    }
}

#[test]
fn radio_and_virtual_access_points_have_their_lines() {
    let mut access_point = fixture::wide_access_point("wlan0");
    access_point.driver = AccessPointDriver::Nl80211;
    access_point.bss.bridge = Some("br0".parse().expect("a name"));
    compare("wide.conf", &access_point.configuration(CONTROL.as_ref()));
}

#[test]
fn radio_without_802_11n_does_not_offer_it() {
    let mut access_point = fixture::access_point("wlan0", Security::Open);
    access_point.radio.generation = Generation::Ofdm;
    compare("ofdm.conf", &access_point.configuration(CONTROL.as_ref()));
}

#[test]
fn station_has_a_block_per_network() {
    compare("station.conf", &fixture::station("wlan0").configuration(CONTROL.as_ref()));
}
