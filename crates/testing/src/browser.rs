//! Chromium, driven by WebDriver (W3C): what a person sees of the dashboard, and what the browser complains about.

use std::{
    io::{BufRead, BufReader},
    process::{Child, Command, Stdio},
    time::Duration,
};

use serde_json::{Value, json};

use crate::{found, process::PATIENCE, program};

const LOOK: Duration = Duration::from_millis(50);

/// A browser without a screen; ends when it is dropped.
pub struct Browser {
    driver: Child,
    agent: ureq::Agent,
    session: String,
}

impl Browser {
    /// Starts Chromium with a window of this size in pixels; `None` if it is not installed.
    pub fn start(width: u32, height: u32) -> Option<Self> {
        let [driver, chromium] = ["chromedriver", "chromium"].map(program);
        let is_there = driver.is_some() && chromium.is_some();
        found(is_there, "chromium", "install the packages chromium and chromium-driver");
        let (driver, chromium) = (driver?, chromium?);
        let mut driver = Command::new(driver)
            .arg("--port=0")
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let lines = BufReader::new(driver.stdout.take().unwrap()).lines().map_while(Result::ok);
        let mut lines = lines.filter_map(|line| {
            let (_, port) = line.split_once("successfully on port ")?;
            port.trim_end_matches('.').parse::<u16>().ok()
        });
        let port = lines.next().expect("chromedriver says on which port it serves");
        let agent = ureq::Agent::config_builder().http_status_as_error(false).proxy(None).build().new_agent();
        let arguments = [
            "--headless=new".to_owned(),
            "--disable-gpu".to_owned(),
            "--disable-dev-shm-usage".to_owned(),
            // Its sandbox needs what containers often lack. It only opens our own pages.
            "--no-sandbox".to_owned(),
            format!("--window-size={width},{height}"),
        ];
        let capabilities = json!({ "capabilities": { "alwaysMatch": {
            "goog:loggingPrefs": { "browser": "ALL", "performance": "ALL" },
            "goog:chromeOptions": { "binary": chromium, "args": arguments },
        } } });
        let mut browser = Self { driver, agent, session: format!("http://127.0.0.1:{port}/session") };
        let session = browser.post("", &capabilities);
        browser.session += &format!("/{}", session["sessionId"].as_str().unwrap());
        Some(browser)
    }

    fn post(&self, path: &str, body: &Value) -> Value {
        let url = format!("{}{path}", self.session);
        let mut answer = self.agent.post(url).send_json(body).unwrap();
        let mut value: Value = answer.body_mut().read_json().unwrap();
        assert_eq!(answer.status(), 200, "{path}: {body}: {value}");
        value["value"].take()
    }

    /// Opens an address.
    pub fn open(&self, url: &str) {
        self.post("/url", &json!({ "url": url }));
    }

    /// Returns the result of a script in the page, which can use `await`.
    pub fn evaluate(&self, script: &str) -> Value {
        let wrapped = format!(
            "const done = arguments[arguments.length - 1]; (async () => {{ {script} }})().then(done, (e) => done(`error: ${{e}}`));"
        );
        let value = self.post("/execute/async", &json!({ "script": wrapped, "args": [] }));
        let error = value.as_str().is_some_and(|text| text.starts_with("error: "));
        assert!(!error, "{script}: {value}");
        value
    }

    /// Waits until an expression in the page is true, or like it.
    ///
    /// # Panics
    ///
    /// If it does not hold within [`PATIENCE`], with the text of the page.
    pub fn wait_for(&self, expression: &str) {
        let began = std::time::Instant::now();
        while self.evaluate(&format!("return Boolean({expression});")) != Value::Bool(true) {
            let log = || self.complaints().join("\n");
            assert!(
                began.elapsed() < PATIENCE,
                "not true: {expression}\n{}\n{}",
                self.evaluate("return document.body.innerText;"),
                log()
            );
            std::thread::sleep(LOOK);
        }
    }

    /// Presses keys on the element with the focus.
    pub fn press(&self, keys: &str) {
        let press = keys
            .chars()
            .flat_map(|key| ["keyDown", "keyUp"].map(|kind| json!({ "type": kind, "value": key })));
        let keyboard = json!({ "type": "key", "id": "keyboard", "actions": press.collect::<Vec<_>>() });
        self.post("/actions", &json!({ "actions": [keyboard] }));
    }

    /// Returns the errors and warnings on the console since the last call.
    pub fn complaints(&self) -> Vec<String> {
        let log = self.post("/se/log", &json!({ "type": "browser" }));
        let serious = |entry: &&Value| matches!(entry["level"].as_str(), Some("SEVERE" | "WARNING"));
        log.as_array().unwrap().iter().filter(serious).map(|entry| entry["message"].to_string()).collect()
    }

    /// Returns the addresses that the browser requested since the last call.
    pub fn requests(&self) -> Vec<String> {
        let log = self.post("/se/log", &json!({ "type": "performance" }));
        let messages = log.as_array().unwrap().iter().map(|entry| {
            serde_json::from_str::<Value>(entry["message"].as_str().unwrap()).unwrap()["message"].take()
        });
        let sent = messages.filter(|message| message["method"] == "Network.requestWillBeSent");
        sent.map(|message| message["params"]["request"]["url"].as_str().unwrap().to_owned()).collect()
    }

    /// Gives the page another size, as on a screen of that size.
    pub fn resize(&self, width: u32, height: u32) {
        let size = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": false });
        let command = json!({ "cmd": "Emulation.setDeviceMetricsOverride", "params": size });
        self.post("/goog/cdp/execute", &command);
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.agent.delete(&self.session).call();
        let _ = self.driver.kill();
        let _ = self.driver.wait();
    }
}
