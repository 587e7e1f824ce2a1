//! Actions in the page, with real packets: what they do, refusals, tokens of domains, and the question before a real
//! interface is touched.

use std::{
    fs,
    io::{BufRead, BufReader},
    process::{Child, Command, Stdio},
};

use cotorra_testing::browser::Browser;
use serde_json::{Value, json};

use super::{ENTER, TIMELINE, assert_accessible, assert_fits};
use crate::{
    harness::{Run, path_with_cotorra, project_file, wait_until},
    netem_links::has_namespaces,
};

const TESTBED: &str = "
name: steered
domains: [one, two]
wireless: { lab: { delay: 1 ms } }
nodes:
  robot: { kind: robot, domain: one }
  near: { kind: radio_unit, domain: one, position: [2, 1], channel: 1 }
  far: { kind: radio_unit, domain: one, position: [8, 1], channel: 6 }
  lan: { kind: switch, domain: one }
  fog: { kind: server, domain: one, tier: fog, cpus: 1, memory: 1 GB }
  edge: { kind: server, domain: one, tier: edge, cpus: 1, memory: 1 GB }
  other-robot: { kind: robot, domain: two, position: [0, 6] }
  other-unit: { kind: radio_unit, domain: two, position: [2, 6], channel: 11 }
  other-lan: { kind: switch, domain: two }
links:
  - { ends: [lan, [near, far, fog]], delay: 1 ms, rate: 100 Mbit/s }
  - { ends: [lan, edge], delay: 5 ms, rate: 20 Mbit/s }
  - { ends: [other-lan, [lan, other-unit]], delay: 1 ms }
services:
  navigation:
    robot: robot
    kpis: { service_time: 50 ms }
    vnfs:
      driver: { program: robot_driver, pinned_to: robot }
      navigation: { program: navigation, node: edge }
    virtual_links: [{ from: driver, to: navigation, rate: 100 kbit/s }]
walks:
  robot: { waypoints: [[0, 0], [10, 0]], and_back: true }
";

/// Escape, in WebDriver's keys.
const ESCAPE: &str = "\u{e00c}";

const OPERATOR: &str = "token-of-the-operator";
const TWO: &str = "token-of-domain-two";

/// The panel of actions in a browser.
struct Panel<'a>(&'a Browser);

impl Panel<'_> {
    /// Opens the page with a token, and the panel in it.
    fn open(&self, run: &Run, token: &str) {
        self.0.open(&run.api);
        self.0.wait_for("document.getElementById('sign-in').open");
        self.0.press(token);
        self.0.press(ENTER);
        self.show();
    }

    fn show(&self) {
        self.0.wait_for("document.getElementById('act').offsetParent");
        self.0.evaluate("document.getElementById('act').click();");
        self.0.wait_for("document.activeElement.matches('#action-kinds [aria-pressed=true]')");
    }

    /// Chooses a kind of action, and fills its form in.
    fn fill(&self, kind: &str, fields: &Value) {
        self.0.evaluate(&format!(
            "document.querySelector('#action-kinds [value={kind}]').click();
             for (const [name, value] of Object.entries({fields})) {{
                 const field = document.getElementById('action-form').elements[name];
                 field.value = value;
                 if (field.value !== value) throw new Error(`no ${{value}} among ${{name}}`);
                 field.dispatchEvent(new Event('input', {{ bubbles: true }}));
             }}"
        ));
    }

    /// Presses a button of the form.
    fn press(&self, button: &str) {
        self.0.evaluate(&format!("document.querySelector('#action-form [value={button}]').click();"));
    }

    /// Does an action, and waits until the page says that it is done.
    fn act(&self, kind: &str, fields: &Value, button: &str, done: &str) {
        self.fill(kind, fields);
        self.press(button);
        self.0.wait_for(&format!("document.getElementById('action-done').innerText.includes('{done}')"));
    }

    /// Returns the reason of a refusal.
    fn refused(&self) -> String {
        self.0.wait_for("document.getElementById('action-refused').innerText");
        self.0
            .evaluate("return document.getElementById('action-refused').innerText;")
            .as_str()
            .unwrap()
            .to_owned()
    }

    /// Returns the choices of a field.
    fn choices(&self, kind: &str, name: &str) -> Value {
        self.fill(kind, &json!({}));
        let choices = format!(
            "return [...document.getElementById('action-form').elements.{name}.options].map((o) => o.value);"
        );
        self.0.evaluate(&choices)
    }

    /// Returns the shown call in a language.
    fn call(&self, language: usize) -> String {
        self.0.evaluate(&format!("document.querySelectorAll('#languages button')[{language}].click();"));
        self.0.evaluate("return document.getElementById('call').textContent;").as_str().unwrap().to_owned()
    }
}

/// Starts the testbed with tokens.
fn start(folder: &tempfile::TempDir) -> Run {
    let file = folder.path().join("steered.yaml");
    fs::write(&file, TESTBED).unwrap();
    Run::start_beside_with(&file, &["--until", "30min"], |command| {
        command.env("COTORRA_TOKEN", OPERATOR).env("COTORRA_DOMAIN_TOKENS", format!("two={TWO}"));
    })
}

fn get(run: &Run, path: &str) -> Value {
    let (status, body) = run.ask(path, Some(OPERATOR));
    assert_eq!(status, 200, "{path}: {body}");
    body
}

/// Returns one direction of a link; null before its first context.
fn link(run: &Run, id: &str, direction: &str) -> Value {
    let links = get(run, "/api/v1/network/links");
    let mut all = links.as_array().unwrap().iter();
    all.find(|link| link["link"] == id && link["direction"] == direction).cloned().unwrap_or_default()
}

/// Waits until the robot is attached to a radio unit.
fn wait_for_attachment(run: &Run, unit: &str) {
    wait_until(|| {
        let (status, robot) = run.ask("/api/v1/robots/robot", Some(OPERATOR));
        let attachments = robot["attachments"].as_array().cloned().unwrap_or_default();
        status == 200 && attachments.iter().any(|one| one["radio_unit"] == unit && one["attached"] == true)
    });
}

fn speed(run: &Run) -> f64 {
    get(run, "/api/v1/robots/robot")["sensors"]["velocity"]["linear"].as_f64().unwrap()
}

#[test]
fn every_action_is_done_from_the_page() {
    let folder = tempfile::tempdir().unwrap();
    let Some(browser) = Browser::start(1440, 900) else { return };
    let run = start(&folder);
    let panel = Panel(&browser);

    // A domain's token: its own nodes are offered. Others are refused, with the reason beside the form.
    panel.open(&run, TWO);
    assert_eq!(panel.choices("attach", "robot"), json!(["other-robot"]));
    assert_eq!(panel.choices("attach", "radio_unit"), json!(["other-unit"]));
    assert_eq!(panel.choices("test", "link"), json!(["other-lan-other-unit"]));
    assert_eq!(
        browser.evaluate("return document.querySelector('#action-kinds [value=place]');"),
        Value::Null
    );
    panel.act("condition", &json!({ "link": "other-lan-other-unit", "delay_ms": "7" }), "condition", "Done");
    wait_until(|| link(&run, "other-lan-other-unit", "backward")["asked"]["delay_ms"] == 7.0);
    panel.fill("halt", &json!({}));
    browser.evaluate("document.getElementById('action-form').elements.robot.options[0].value = 'robot';");
    panel.press("halt");
    let reason = panel.refused();
    assert!(reason.contains("`robot` is not of the domain `two`"), "{reason}");

    browser.evaluate("sessionStorage.clear();");
    panel.open(&run, OPERATOR);
    browser.wait_for("document.getElementById('robots').innerText.includes('near')");
    panel.act(
        "attach",
        &json!({ "robot": "robot", "radio_unit": "far" }),
        "attach",
        "Done: attach robot to far",
    );
    wait_for_attachment(&run, "far");
    browser.wait_for(&format!("/api: attach robot to far\\s+by hand/.test({TIMELINE})"));

    panel.act("place", &json!({ "vnf": "navigation", "node": "fog" }), "place", "Done");
    wait_until(|| {
        let placements = get(&run, "/api/v1/network/placements");
        placements.as_array().unwrap().iter().any(|one| one["vnf"] == "navigation" && one["node"] == "fog")
    });

    let slower = json!({ "link": "lan-fog", "direction": "", "delay_ms": "15", "loss_percent": "0.5", "rate_mbps": "8" });
    panel.act("condition", &slower, "condition", "Done: change lan-fog: delay 15 ms");
    wait_until(|| {
        let asked = link(&run, "lan-fog", "forward")["asked"].take();
        asked["loss"] == json!({ "kind": "independent", "share": 0.005 })
            && asked["rate"] == json!({ "kind": "fixed", "rate_bps": 8_000_000 })
    });
    // Packets of the navigation take that long.
    wait_until(|| link(&run, "lan-fog", "forward")["delay_ms"].as_f64().is_some_and(|delay| delay >= 15.0));

    let test = json!({ "link": "lan-fog", "direction": "forward", "seconds": "0.2" });
    panel.act("test", &test, "test", "arrived");
    let tested = link(&run, "lan-fog", "forward")["tested"]["throughput_bps"].as_f64().unwrap();
    assert!((4e6..=8e6).contains(&tested), "{tested} bit/s");

    panel.act("halt", &json!({ "robot": "robot" }), "halt", "Done");
    wait_until(|| speed(&run) == 0.0);
    panel.press("go");
    wait_until(|| speed(&run) > 0.1);
    let limit = |mps: &str| json!({ "robot": "robot", "speed_limit_mps": mps });
    let limited = || get(&run, "/api/v1/robots/robot")["speed_limit_mps"].take();
    panel.act("halt", &limit("0.1"), "limit", "Done: limit robot to 0.1 m/s");
    wait_until(|| limited() == 0.1);
    panel.act("halt", &limit(""), "limit", "Done: lift the speed limit of robot");
    wait_until(|| limited().is_null());

    // Rare changes of a link, and the path over it in the topology as it is now.
    let rare = json!({ "link": "lan-fog", "direction": "forward", "jitter_ms": "1", "delay_scale": "2" });
    panel.act("condition", &rare, "condition", "Done: change lan-fog forward: jitter 1 ms, ψ 2");
    wait_until(|| link(&run, "lan-fog", "forward")["scale"]["delay_scale"] == 2.0);
    assert_eq!(link(&run, "lan-fog", "forward")["asked"]["jitter"]["deviation_ms"], 1.0);
    let path = json!({ "path": r#"{"from":"robot","to":"fog","links":["robot~far","lan-far","lan-fog"]}"# });
    panel.act("map", &path, "map", "Done: map robot → fog over robot~far, lan-far, lan-fog");
    wait_until(|| {
        let mappings = get(&run, "/api/v1/network/virtual-links");
        mappings.as_array().unwrap().iter().any(|one| one["to"] == "navigation" && one["path"] == "mapped")
    });
    panel.act("attach", &json!({ "robot": "robot" }), "scan", "Done: scan robot");

    // A goal by a click on the map.
    panel.fill("send", &json!({ "robot": "robot" }));
    browser.evaluate(
        "const map = document.getElementById('map');
         const { left, top, width, height } = map.getBoundingClientRect();
         const at = { clientX: left + width / 2, clientY: top + height / 2, button: 0, pointerId: 1, bubbles: true };
         map.setPointerCapture = () => {};
         for (const kind of ['pointerdown', 'pointerup']) map.dispatchEvent(new PointerEvent(kind, at));",
    );
    let number = |name: &str| {
        let value = browser
            .evaluate(&format!("return document.getElementById('action-form').elements.{name}.value;"));
        value.as_str().unwrap().parse::<f64>().unwrap()
    };
    let (x, y) = (number("x"), number("y"));
    panel.press("send");
    browser.wait_for("document.getElementById('action-done').innerText.includes('Done: send robot')");
    wait_until(|| {
        let goals = get(&run, "/api/v1/measurements/events?kinds=goal");
        goals["items"][0]["goal"] == json!({ "x": x, "y": y })
    });
    panel.press("return");
    browser.wait_for("document.getElementById('action-done').innerText.includes('back to its walk')");

    // A click on a VNF in the topology opens its form.
    panel.fill("halt", &json!({}));
    browser.evaluate("document.querySelector('#views button:last-child').click();");
    browser.wait_for(
        "document.querySelector('#topology canvas').getAttribute('aria-label').includes('navigation')",
    );
    browser.wait_for(
        "(() => {
            const { left, top, width, height } = document.querySelector('#topology canvas').getBoundingClientRect();
            for (let x = 0; x < width; x += 20) for (let y = 0; y < height; y += 5) {
                const at = { clientX: left + x, clientY: top + y };
                document.querySelector('#topology canvas').dispatchEvent(new MouseEvent('click', at));
                if (document.getElementById('action-form').elements.vnf?.value === 'navigation') return true;
            }
        })()",
    );
    browser.evaluate("document.querySelector('#views button').click();");

    // Rejections, in the testbed's own words.
    let wrong = json!({ "instruction": { "instruction": "condition", "link": "lan-fog", "change": { "delay_ms": -1.0 } } });
    panel.fill("condition", &json!({ "link": "lan-fog", "delay_ms": "-1" }));
    panel.press("condition");
    let reason = panel.refused();
    let said = run.post_as(OPERATOR, "/api/v1/instructions", &wrong.to_string()).1;
    assert_eq!(reason, format!("Refused: {}", said["refused"].as_str().unwrap()));

    // The shown calls do the same, and have no token.
    panel.fill("attach", &json!({ "robot": "robot", "radio_unit": "near" }));
    let python = panel.call(1);
    let done = Command::new("python3")
        .args(["-c", &python])
        .env("PYTHONPATH", project_file("clients/python"))
        .env("COTORRA_TOKEN", OPERATOR)
        .output()
        .unwrap();
    assert!(done.status.success(), "{python}\n{}", String::from_utf8_lossy(&done.stderr));
    wait_for_attachment(&run, "near");
    panel.fill("attach", &json!({ "robot": "robot", "radio_unit": "far" }));
    let curl = panel.call(0);
    assert!(curl.contains("$COTORRA_TOKEN"), "{curl}");
    if Command::new("curl").arg("--version").output().is_ok() {
        let mut shell = Command::new("sh");
        shell.args(["-c", &curl]).env("COTORRA_TOKEN", OPERATOR).env("PATH", path_with_cotorra());
        let done = shell.output().unwrap();
        assert_eq!(String::from_utf8_lossy(&done.stdout), r#"{"done":true}"#, "{curl}\n{done:?}");
        wait_for_attachment(&run, "far");
    }
    let shown = browser.evaluate("return document.documentElement.outerHTML;").to_string();
    assert!(!shown.contains(OPERATOR), "the token is nowhere in the page");

    assert_fits(&browser);
    assert_accessible(&browser);
    // The requests that were refused are in the console; nothing else is.
    let others = browser.complaints().into_iter().filter(|line| !line.contains("Failed to load resource"));
    assert_eq!(others.collect::<Vec<_>>(), Vec::<String>::new());
    // Escape closes the panel.
    browser.evaluate("document.querySelector('#action-kinds button').focus();");
    browser.press(ESCAPE);
    browser.wait_for("document.getElementById('actions').hidden && document.activeElement.id === 'act'");
}

/// A network namespace with an interface `va`, as long as it lives.
struct Wire(Child);

impl Wire {
    fn new() -> Self {
        let lines =
            "ip link add va type veth peer name vb && ip link set va up && echo ready && exec sleep 600";
        let mut child = Command::new("unshare")
            .args(["--net", "sh", "-c", lines])
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let ready = BufReader::new(child.stdout.take().unwrap()).lines().map_while(Result::ok).next();
        assert_eq!(ready.as_deref(), Some("ready"));
        Self(child)
    }
}

impl Drop for Wire {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn a_real_interface_is_touched_only_after_a_question() {
    if !has_namespaces() {
        return;
    }
    let Some(browser) = Browser::start(1440, 900) else { return };
    let wire = Wire::new();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("steered.yaml");
    let text = format!(
        "
name: real
nodes:
  lan: {{ kind: switch }}
  edge: {{ kind: server, tier: edge, cpus: 1, memory: 1 GB }}
  gate: {{ kind: gateway, interface: va, netns: /proc/{}/ns/net, machines: {{ plc: 10.9.0.2 }} }}
links:
  - {{ ends: [lan, [edge, gate]], delay: 1 ms }}
",
        wire.0.id()
    );
    fs::write(&file, text).unwrap();
    let run = Run::start_beside(&file, &["--until", "30min"]);
    let panel = Panel(&browser);
    browser.open(&run.api);
    panel.show();
    let delay = || {
        let links = run.get("/api/v1/network/links");
        let found = links.as_array().unwrap().iter().find(|link| link["link"] == "lan-gate").cloned();
        found.map(|link| link["asked"]["delay_ms"].clone()).unwrap_or_default()
    };
    wait_until(|| delay() == 1.0);
    for (button, after) in [("no", 1.0), ("yes", 9.0)] {
        panel.fill("condition", &json!({ "link": "lan-gate", "delay_ms": "9" }));
        panel.press("condition");
        browser.wait_for("document.getElementById('confirm').open");
        let asked = browser.evaluate("return document.getElementById('confirm-what').innerText;");
        assert!(asked.as_str().unwrap().starts_with("interface va in namespace /proc/"), "{asked}");
        assert_eq!(delay(), 1.0, "nothing is changed before the answer");
        browser.evaluate(&format!("document.querySelector('#confirm [value={button}]').click();"));
        let said = if button == "no" { "Nothing was done" } else { "Done" };
        browser.wait_for(&format!("document.getElementById('action-done').innerText.includes('{said}')"));
        wait_until(|| delay() == after);
    }
    // An emulated link needs no answer.
    panel.act("condition", &json!({ "link": "lan-edge", "delay_ms": "3" }), "condition", "Done");
}
