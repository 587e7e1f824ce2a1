//! Virtual time that is watched in the page: it stops, goes on by steps and at other speeds, and the results stay the same.

use std::fs;

use cotorra_testing::browser::Browser;
use serde_json::Value;

use super::{MAP, STATE, Shown, TIMELINE, ask, assert_clean, corridor, recorded};
use crate::harness::wait_until;

/// Starts 100 s of the corridor in virtual time, at a speed.
fn watched(speed: &str, out: &tempfile::TempDir) -> Shown {
    let (file, out) = (corridor(), out.path().to_str().unwrap().to_owned());
    let run = ["run", file.to_str().unwrap(), "--simulate", "--headless", "--no-token", "--until", "100s"];
    Shown::start(&[&run[..], &["--speed", speed, "--out", &out]].concat(), |_| {})
}

/// Returns the answer of the API to a question about time.
fn clock(shown: &Shown) -> Value {
    let address = shown.dashboard.strip_prefix("http://").unwrap().trim_end_matches('/').to_owned();
    let answer = ask(&address, &format!("GET /api/v1/clock HTTP/1.1\r\nHost: {address}"));
    serde_json::from_str(answer.split("\r\n\r\n").nth(1).unwrap()).unwrap()
}

#[test]
fn virtual_time_is_watched_stopped_and_stepped_and_gives_the_same_results() {
    let (out, others) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let Some(browser) = Browser::start(1440, 900) else { return };
    let mut shown = watched("1x", &out);
    browser.open(&shown.signed_in);
    browser.wait_for(&format!("{STATE} === 'live' && {MAP}.startsWith('Map: robot at')"));
    let button = |name: &str| {
        browser.wait_for(&format!(
            "[...document.querySelectorAll('#time-control button')].find((one) => one.textContent === '{name}')?.click() ?? true"
        ));
    };
    button("Pause");
    browser.wait_for("document.querySelector('#time-control button').textContent === 'Go on'");
    let stopped = clock(&shown);
    assert_eq!((&stopped["paused"], &stopped["speed"]), (&true.into(), &1.0.into()));
    let at = |clock: &Value| clock["at_ns"].as_u64().unwrap();
    button("Step");
    wait_until(|| at(&clock(&shown)) > at(&stopped));
    // Time has got no further than a step when the next one is wanted.
    assert!(at(&clock(&shown)) <= at(&stopped) + 100_000_000);
    browser.evaluate(
        "const speed = document.querySelector('#time-control select');
         speed.value = '50';
         speed.dispatchEvent(new Event('change'));",
    );
    wait_until(|| clock(&shown)["speed"] == 50.0);
    // While time stands still: a run that has ended does not answer, and the browser says so.
    assert_clean(&browser, &shown.dashboard);
    button("Go on");
    browser.wait_for(&format!("{TIMELINE}.includes('robot: R1 → R3')"));
    assert!(shown.child.wait().unwrap().success());

    let folder = |out: &tempfile::TempDir| fs::read_dir(out.path()).unwrap().next().unwrap().unwrap().path();
    recorded(&others);
    for name in ["service_time.csv", "summary.json"] {
        let [watched, other] = [&out, &others].map(|out| fs::read(folder(out).join(name)).unwrap());
        assert!(watched == other, "{name}");
    }
}

#[test]
fn the_time_of_a_replay_is_stopped_and_that_of_a_view_stands_still() {
    let out = tempfile::tempdir().unwrap();
    let folder = recorded(&out);
    let Some(browser) = Browser::start(1440, 900) else { return };
    let replay = Shown::start(&["replay", folder.to_str().unwrap(), "--no-token", "--from", "40s"], |_| {});
    browser.open(&replay.signed_in);
    browser.wait_for("document.querySelector('#time-control button')?.offsetParent");
    browser.evaluate("document.querySelector('#time-control button').click();");
    browser.wait_for("document.querySelector('#time-control button').textContent === 'Go on'");
    assert_eq!(clock(&replay)["paused"], true);
    assert_clean(&browser, &replay.dashboard);
    drop(replay);
    let view = Shown::start(&["view", folder.to_str().unwrap(), "--no-token"], |_| {});
    browser.open(&view.signed_in);
    browser.wait_for("document.body.dataset.ready !== undefined");
    assert_eq!(browser.evaluate("return document.getElementById('time-control').hidden;"), true);
    assert_eq!(clock(&view)["controllable"], false);
}
