//! The dashboard in a real browser: a run with real packets, finished and replayed runs, and pages of other sites.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

mod actions;
mod virtual_time;

use std::{
    fs,
    io::{BufRead, BufReader, Read, Write},
    net::{TcpListener, TcpStream},
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    thread,
};

use cotorra_testing::{axe, browser::Browser};
use tempfile::TempDir;

use crate::harness::{Run, corridor, corridor_ending_in, cotorra, output, stderr, stdout, wait_until};

/// Text of all entries of the timeline.
const TIMELINE: &str = "document.getElementById('timeline').innerText";
/// The map in words, for people who do not see it.
const MAP: &str = "document.querySelector('#map canvas').getAttribute('aria-label')";
/// The first chart in words.
const CHART: &str = "document.querySelector('#charts canvas').getAttribute('aria-label')";
const STATE: &str = "document.getElementById('connection').dataset.state";
/// Enter, End and arrow left, in WebDriver's keys.
pub const ENTER: &str = "\u{e007}";
const END: &str = "\u{e010}";
const LEFT: &str = "\u{e012}";

/// A `cotorra replay` or `cotorra view`, killed on drop.
struct Shown {
    child: Child,
    /// The address of the page.
    dashboard: String,
    /// The same with a code that signs the page in.
    signed_in: String,
}

impl Shown {
    fn start(arguments: &[&str], change: impl FnOnce(&mut Command)) -> Self {
        let mut command = cotorra(arguments);
        command.args(["--api", "127.0.0.1:0"]).stdout(Stdio::null()).stderr(Stdio::piped());
        change(&mut command);
        let mut child = command.spawn().unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map_while(Result::ok);
        let address = lines.find_map(|line| {
            line.strip_prefix("Dashboard on ").map(|rest| rest.split(',').next().unwrap().to_owned())
        });
        let dashboard = address.expect("the address of the dashboard is printed");
        thread::spawn(move || lines.for_each(drop));
        let api = dashboard.split('?').next().unwrap();
        let printed = stdout(&output(["open", "--print", "--run", api]));
        let code = printed.trim().strip_prefix(api).unwrap_or_default();
        let signed_in = format!("{dashboard}{code}");
        Self { child, dashboard, signed_in }
    }
}

impl Drop for Shown {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Simulates the first 100 s of the corridor, with its first two handovers. Returns the run's folder.
fn recorded(out: &TempDir) -> PathBuf {
    let mut arguments =
        ["run", "--simulate", "--headless", "--until", "100s", "--out"].map(PathBuf::from).to_vec();
    arguments.extend([out.path().to_owned(), corridor()]);
    let run = output(&arguments);
    assert!(run.status.success(), "{}", stderr(&run));
    fs::read_dir(out.path()).unwrap().next().unwrap().unwrap().path()
}

/// Fails if the browser complained, or asked another server than this one.
pub fn assert_clean(browser: &Browser, address: &str) {
    assert_eq!(browser.complaints(), Vec::<String>::new());
    // A page is signed in from a file.
    let own = [address, "blob:", "data:", "file:"];
    let others = |url: &String| !own.iter().any(|own| url.starts_with(own));
    let others: Vec<_> = browser.requests().into_iter().filter(others).collect();
    assert_eq!(others, Vec::<String>::new());
}

/// Fails if something sticks out of the page on a screen.
pub fn assert_fits(browser: &Browser) {
    for width in [375, 768, 1440, 2560] {
        browser.resize(width, 900);
        browser.wait_for(&format!("innerWidth === {width}"));
        let wide = browser
            .evaluate("return document.documentElement.scrollWidth - document.documentElement.clientWidth;");
        assert_eq!(wide, 0, "nothing sticks out at {width} pixels");
    }
}

/// Fails if axe-core finds something serious in either theme.
pub fn assert_accessible(browser: &Browser) {
    let Some(axe) = axe() else { return };
    browser.evaluate(&fs::read_to_string(axe).unwrap());
    for theme in ["light", "dark"] {
        browser.evaluate(&format!("document.documentElement.dataset.theme = '{theme}';"));
        let serious = "const { violations } = await globalThis.axe.run();
            const bad = violations.filter(({ impact }) => ['serious', 'critical'].includes(impact));
            return bad.map(({ id, nodes }) => `${id}: ${nodes.map((node) => node.html).join(' ').slice(0, 400)}`);";
        assert_eq!(browser.evaluate(serious), serde_json::json!([]), "{theme}");
    }
}

#[test]
fn a_run_is_shown_live_with_its_handovers() {
    let folder = tempfile::tempdir().unwrap();
    let file = corridor_ending_in("", folder.path());
    let Some(browser) = Browser::start(1440, 900) else { return };
    let run = Run::start_beside(&file, &["--set", "nodes.robot.sensors={ front: { kind: lidar } }"]);
    run.wait_for_service();
    wait_until(|| run.get("/api/v1/robots/robot/sensors")[0]["last"].is_object());
    browser.open(&run.api);
    browser.wait_for(&format!("{STATE} === 'live'"));
    let split =
        "[...document.querySelectorAll('#charts figure:not([hidden])')].map((chart) => chart.innerText)";
    browser.wait_for(&format!("{split}.some((text) => /Split of service time[^]*air[^]*VNF/.test(text))"));
    let scan =
        "[...document.querySelectorAll('#map-tools button')].find((one) => one.textContent === 'Scan')";
    browser.evaluate(&format!("({scan}).click();"));
    browser.wait_for(&format!("/the lidar of robot sees \\d+ points/.test({MAP})"));
    browser.evaluate(&format!("({scan}).click();"));
    browser.wait_for(&format!("!{MAP}.includes('lidar')"));
    browser.wait_for(&format!("/^Map: robot at -?\\d+, -?\\d+, R1/.test({MAP})"));
    browser.wait_for(&format!("/attached to R1: navigation [\\d.]+ ms/.test({CHART})"));
    browser.evaluate(
        "const list = document.getElementById('timeline');
         globalThis.changes = 0;
         new MutationObserver(() => (globalThis.changes += 1)).observe(list, { childList: true });",
    );
    let attach = r#"{"instruction": {"instruction": "attach", "robot": "robot", "radio_unit": "R3"}, "reason": "a test"}"#;
    assert_eq!(run.post("/api/v1/instructions", attach).0, 200);
    browser.wait_for(&format!("{TIMELINE}.includes('robot: R1 → R3')"));
    browser.wait_for(&format!("{MAP}.includes(', R3')"));
    browser.wait_for(&format!("{CHART}.includes('attached to R1, R3')"));
    browser.wait_for("document.getElementById('robots').innerText.includes('R3')");
    browser.wait_for(&format!("/api: attach robot to R3\\s+a test/.test({TIMELINE})"));
    browser.wait_for("globalThis.changes > 0");
    browser.evaluate("document.querySelector('#views button:last-child').click();");
    let topology = "document.querySelector('#topology canvas').getAttribute('aria-label')";
    browser.wait_for(&format!("/cloud: navigation.* over robot~R3, R3-cloud/.test({topology})"));
    // Values come on, and the clock with them.
    let clock = "document.getElementById('clock').textContent";
    let before = browser.evaluate(&format!("return {clock};"));
    browser.wait_for(&format!("{clock} !== {before}"));
    assert_clean(&browser, &run.api);
    drop(run);
    browser.wait_for(&format!("{STATE} === 'waiting'"));
}

#[test]
fn a_replay_is_shown_as_it_plays() {
    let out = tempfile::tempdir().unwrap();
    let folder = recorded(&out);
    let Some(browser) = Browser::start(1440, 900) else { return };
    let shown = Shown::start(&["replay", folder.to_str().unwrap(), "--speed", "10x"], |_| {});
    browser.open(&shown.signed_in);
    browser.wait_for(&format!("{TIMELINE}.includes('robot: R1 → R3')"));
    browser.wait_for(&format!("{CHART}.includes('R3')"));
    browser.wait_for(&format!("{MAP}.includes(', R3')"));
    assert_clean(&browser, &shown.dashboard);
}

#[test]
fn a_finished_run_is_shown_whole_on_every_screen() {
    let out = tempfile::tempdir().unwrap();
    let folder = recorded(&out);
    let Some(browser) = Browser::start(1440, 900) else { return };
    let shown = Shown::start(&["view", folder.to_str().unwrap()], |_| {});
    browser.open(&shown.signed_in);
    browser.wait_for(&format!("{TIMELINE}.includes('robot: R3 → R2')"));
    browser.wait_for(&format!("{MAP}.includes(', R2')"));
    assert_eq!(
        browser.evaluate("return document.getElementById('act').hidden;"),
        true,
        "it cannot be steered"
    );
    assert_eq!(browser.evaluate("return document.getElementById('clock').textContent;"), "1:40");
    let summary = fs::read_to_string(folder.join("summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&summary).unwrap();
    let verdict = browser.evaluate("return document.getElementById('verdict').textContent;");
    let (verdict, reason) = (verdict.as_str().unwrap(), summary["fidelity"]["reason"].as_str().unwrap());
    assert!(verdict.starts_with("Exact by construction") && verdict.contains(reason), "{verdict}");
    browser.evaluate("document.querySelector('[data-span=all]').click();");
    browser.wait_for(&format!("{CHART}.includes('0:00 to 1:40, attached to R1, R3, R2')"));

    // An entry of the timeline brings the charts to its time; the keyboard moves them on, and back to the present.
    browser.evaluate("document.querySelector('#timeline li:last-child button').focus();");
    browser.press(ENTER);
    browser.wait_for(&format!("!{CHART}.includes('0:00 to 1:40')"));
    let window = |of: &str| browser.evaluate(&format!("return {of}.split(', attached')[0];"));
    let before = window(CHART);
    browser.evaluate("document.querySelector('#charts canvas').focus();");
    browser.press("+");
    browser.wait_for(&format!("!{CHART}.startsWith({before})"));
    browser.evaluate("[...document.querySelectorAll('#spans button')].at(-1).click();");
    browser.wait_for(&format!("{CHART}.includes(' to 1:40')"));

    // Dragging the slider shows the whole graph at another time, and the keyboard moves it on.
    let past = "document.getElementById('past')";
    assert_eq!(browser.evaluate(&format!("return {past}.hidden;")), true);
    for at in [90, 70, 55, 40] {
        let drag = "const slider = document.getElementById('moment'); slider.focus();";
        browser.evaluate(&format!("{drag} slider.value = {at}; slider.dispatchEvent(new Event('input'));"));
    }
    let robots = "document.getElementById('robots').innerText";
    browser.wait_for(&format!("{past}.innerText.includes('at 0:40.0') && {MAP}.includes(', R1')"));
    browser.wait_for(&format!("{robots}.includes('R1') && !{robots}.includes('R2')"));
    browser.evaluate("document.querySelector('#views button:last-child').click();");
    let topology = "document.querySelector('#topology canvas').getAttribute('aria-label')";
    browser.wait_for(&format!("/over robot~R1, R1-cloud/.test({topology})"));
    browser.press(LEFT);
    browser.wait_for(&format!("{past}.innerText.includes('at 0:39.5')"));
    browser.press(END);
    browser.wait_for(&format!("{past}.hidden && {robots}.includes('R2')"));
    browser.wait_for(&format!("/over robot~R2, R2-/.test({topology})"));
    browser.evaluate("document.querySelector('#views button').click();");

    let coverage =
        "[...document.querySelectorAll('#map-tools button')].find((one) => one.textContent === 'Coverage')";
    for shows in [true, false] {
        browser.evaluate(&format!("({coverage}).click();"));
        browser.wait_for(&format!("{MAP}.includes('coverage of R1, R2, R3, R4, R5, R6') === {shows}"));
    }

    // Filtered rows are gone, and come back.
    browser.evaluate("document.querySelector('#timeline-tools [data-group=handover]').click();");
    browser.wait_for(&format!("!{TIMELINE}.includes('robot: R3 → R2')"));
    browser.evaluate("document.querySelector('#timeline-tools [data-group=handover]').click();");
    browser.wait_for(&format!("{TIMELINE}.includes('robot: R3 → R2')"));

    assert_fits(&browser);
    assert_accessible(&browser);
    assert_clean(&browser, &shown.dashboard);
}

#[test]
fn two_runs_are_compared_on_one_time_axis() {
    let (out, others) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (folder, other) = (recorded(&out), recorded(&others));
    let Some(browser) = Browser::start(1440, 900) else { return };
    let shown =
        Shown::start(&["view", folder.to_str().unwrap(), "--compare", other.to_str().unwrap()], |_| {});
    browser.open(&shown.signed_in);
    browser.wait_for("document.body.dataset.ready !== undefined");
    browser.evaluate("document.querySelector('[data-span=all]').click();");
    browser.wait_for(&format!("{CHART}.includes('0:00 to 1:40')"));
    let value = |line: &str| browser.evaluate(&format!("return /{line} ([\\d.]+) ms/.exec({CHART})?.[1];"));
    browser.wait_for(&format!("/navigation, other run [\\d.]+ ms/.test({CHART})"));
    // The same seed leaves the same times.
    assert_eq!(value("navigation"), value("navigation, other run"));
    assert_clean(&browser, shown.dashboard.split('?').next().unwrap());
}

#[test]
fn a_run_with_a_token_asks_for_it() {
    let out = tempfile::tempdir().unwrap();
    let folder = recorded(&out);
    let Some(browser) = Browser::start(1440, 900) else { return };
    let token = "0123456789abcdef";
    let shown = Shown::start(&["view", folder.to_str().unwrap()], |command| {
        command.env("COTORRA_TOKEN", token);
    });
    browser.open(&shown.dashboard);
    for (token, opens) in [("0000000000000000", false), (token, true)] {
        browser.wait_for("document.getElementById('sign-in').open");
        browser.press(token);
        browser.press(ENTER);
        if opens {
            browser.wait_for(&format!("{TIMELINE}.includes('robot: R3 → R2')"));
        } else {
            browser.wait_for("document.getElementById('sign-in-error').innerText !== ''");
        }
    }
    // The page keeps it only for this tab.
    assert_eq!(browser.evaluate("return JSON.stringify(localStorage).includes('0123456789abcdef');"), false);
}

/// Serves one page to everyone, and returns its port.
fn serve_page(html: String) -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    thread::spawn(move || {
        for stream in listener.incoming().map_while(Result::ok) {
            let html = html.clone();
            // A browser also opens connections on which it asks for nothing, and keeps them for a minute.
            thread::spawn(move || {
                let mut request = BufReader::new(&stream).lines().map_while(Result::ok);
                request.by_ref().take_while(|line| !line.is_empty()).for_each(drop);
                let head = "HTTP/1.1 200 OK\r\nContent-Type: text/html\r\nConnection: close\r\n";
                let _ = write!(&stream, "{head}Content-Length: {}\r\n\r\n{html}", html.len());
            });
        }
    });
    port
}

/// Sends a request, and returns the answer.
fn ask(address: &str, request: &str) -> String {
    let mut stream = TcpStream::connect(address).unwrap();
    write!(stream, "{request}\r\nConnection: close\r\n\r\n").unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

#[test]
fn pages_of_other_sites_can_neither_read_nor_steer() {
    let out = tempfile::tempdir().unwrap();
    let folder = recorded(&out);
    let Some(browser) = Browser::start(800, 600) else { return };
    let shown = Shown::start(&["view", folder.to_str().unwrap(), "--no-token"], |_| {});
    let address = shown.dashboard.strip_prefix("http://").unwrap().trim_end_matches('/').to_owned();

    let page = ask(&address, &format!("GET / HTTP/1.1\r\nHost: {address}"));
    for header in [
        "content-security-policy: default-src 'none'; script-src 'self'",
        "frame-ancestors 'none'",
        "x-content-type-options: nosniff",
    ] {
        assert!(page.contains(header), "{header}: {page}");
    }
    assert!(!page.contains("'unsafe-"), "{page}");
    let etag = page.lines().find_map(|line| line.strip_prefix("etag: ")).unwrap();
    let again = ask(&address, &format!("GET / HTTP/1.1\r\nHost: {address}\r\nIf-None-Match: {etag}"));
    assert!(again.starts_with("HTTP/1.1 304"), "{again}");

    // Headers that browsers send for a page of another origin, or of a name that leads here.
    let robots = |headers: &str| ask(&address, &format!("GET /api/v1/robots HTTP/1.1\r\n{headers}"));
    let own = format!("Host: {address}\r\nOrigin: http://{address}\r\nSec-Fetch-Site: same-origin");
    assert!(robots(&own).starts_with("HTTP/1.1 200"));
    for others in [
        format!("Host: {address}\r\nOrigin: http://example.org"),
        format!("Host: {address}\r\nSec-Fetch-Site: cross-site"),
        format!("Host: {address}\r\nSec-Fetch-Site: same-site"),
        "Host: example.org".to_owned(),
        "Host: example.org\r\nOrigin: http://example.org\r\nSec-Fetch-Site: same-origin".to_owned(),
    ] {
        assert!(robots(&others).starts_with("HTTP/1.1 403"), "{others}");
    }

    // And in a browser, from another port and from another name.
    let port = serve_page(format!("<title>other</title><iframe src='{}'></iframe>", shown.dashboard));
    for name in ["127.0.0.1", "localhost"] {
        browser.open(&format!("http://{name}:{port}/"));
        browser.wait_for("document.title === 'other'");
        for request in [
            "{}",
            "{ mode: 'no-cors' }",
            "{ method: 'POST', headers: { 'Content-Type': 'application/json' }, body: '{}' }",
            "{ headers: { Authorization: 'Bearer 0123456789abcdef' } }",
        ] {
            let read = browser.evaluate(&format!(
                "return fetch('http://{address}/api/v1/robots', {request}).then((a) => a.text()).catch(() => '');"
            ));
            assert_eq!(read, "", "{name}: {request}");
        }
        // The browser says that it shows the dashboard in no frame.
        let mut said = String::new();
        wait_until(|| {
            said += &browser.complaints().join("\n");
            said.contains("frame-ancestors")
        });
    }
}

#[test]
fn the_browser_is_opened_on_request() {
    let out = tempfile::tempdir().unwrap();
    let folder = recorded(&out);
    let programs = tempfile::tempdir().unwrap();
    let opened = programs.path().join("opened");
    let opener = programs.path().join("xdg-open");
    fs::write(&opener, format!("#!/bin/sh\necho \"$@\" >{0}.new && mv {0}.new {0}\n", opened.display()))
        .unwrap();
    fs::set_permissions(&opener, fs::Permissions::from_mode(0o755)).unwrap();
    let path = |folder: &Path| format!("{}:/usr/bin:/bin", folder.display());
    let shown = Shown::start(&["view", folder.to_str().unwrap(), "--open"], |command| {
        command.env("PATH", path(programs.path()));
    });
    wait_until(|| opened.exists());
    // Other users see only the file's place in the browser's arguments.
    let arguments = fs::read_to_string(opened).unwrap();
    let file = Path::new(arguments.trim());
    assert_eq!(fs::metadata(file).unwrap().permissions().mode() & 0o777, 0o600);
    let text = fs::read_to_string(file).unwrap();
    let (_, code) = text.split_once(&format!("url={}#", shown.dashboard)).unwrap();
    assert!(!arguments.contains(code.split('"').next().unwrap()), "{arguments}");
    let Some(browser) = Browser::start(1440, 900) else { return };
    browser.open(&format!("file://{}", file.display()));
    browser.wait_for(&format!("{TIMELINE}.includes('robot: R3 → R2')"));
    assert!(!file.exists(), "the code was used up");
    drop(browser);
    fs::remove_file(opener).unwrap();
    let mut without = cotorra(["view", folder.to_str().unwrap(), "--open"]);
    let without = without.env("PATH", programs.path()).output().unwrap();
    assert!(!without.status.success() && stderr(&without).contains("xdg-utils"), "{}", stderr(&without));
}
