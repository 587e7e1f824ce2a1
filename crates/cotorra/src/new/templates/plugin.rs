//! A plug-in of cotorra: moves navigation to the next dearer server when six answers in a row are late.
//!
//! A run starts it. It talks to the HTTP API, so that it needs no part of cotorra's source code.

use std::{
    collections::BTreeMap,
    env,
    error::Error,
    io::{BufRead, BufReader},
};

use serde_json::{Value, json};
use ureq::Agent;

/// The API of the run that started this program.
struct Api {
    address: String,
    token: String,
    agent: Agent,
}

impl Api {
    fn from_environment() -> Result<Self, Box<dyn Error>> {
        let address = env::var("COTORRA_API")
            .map_err(|_| "COTORRA_API is not set: `cotorra run` starts this program")?;
        // The API is on this machine, behind no proxy. A refused instruction is an answer, not an error.
        let agent = Agent::config_builder()
            .proxy(None)
            .http_status_as_error(false)
            .build()
            .new_agent();
        Ok(Self {
            address,
            token: env::var("COTORRA_TOKEN").unwrap_or_default(),
            agent,
        })
    }

    /// Gets a path of the API.
    fn get(&self, path: &str) -> Result<ureq::Body, Box<dyn Error>> {
        let request = self.agent.get(format!("{}/api/v1/{path}", self.address));
        Ok(request
            .header("Authorization", format!("Bearer {}", self.token))
            .call()?
            .into_body())
    }

    /// Posts a body to a path of the API. Returns the answer.
    fn post(&self, path: &str, body: &Value) -> Result<String, Box<dyn Error>> {
        let request = self.agent.post(format!("{}/api/v1/{path}", self.address));
        let request = request.header("Authorization", format!("Bearer {}", self.token));
        Ok(request.send_json(body)?.body_mut().read_to_string()?)
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let api = Api::from_environment()?;
    let settings: Value =
        serde_json::from_str(&env::var("COTORRA_SETTINGS").unwrap_or_default()).unwrap_or_default();
    let patience = settings["patience"].as_u64().unwrap_or(6);

    let testbed: Value = api.get("testbed")?.read_json()?;
    let list = |value: &Value| value.as_array().cloned().unwrap_or_default();
    let mut servers = list(&testbed["graph"]["nodes"]);
    servers.retain(|node| node["kind"] == "server");
    servers.sort_by(|a, b| {
        a["cost"]
            .as_f64()
            .unwrap_or(0.0)
            .total_cmp(&b["cost"].as_f64().unwrap_or(0.0))
    });
    let services = list(&testbed["services"]);
    let mut late: BTreeMap<String, u64> = BTreeMap::new();

    // The stream of server-sent events ends with the run.
    let stream = BufReader::new(api.get("events?kinds=service_time")?.into_reader());
    for line in stream.lines().map_while(Result::ok) {
        if let Some(mark) = line.strip_prefix("id: ") {
            // Virtual time waits until all events so far are handled. It has no marks when the run has ended.
            if api.post(&format!("marks/{mark}"), &json!({})).is_err() {
                break;
            }
        }
        let Some(event) = line.strip_prefix("data: {") else {
            continue;
        };
        let event: Value = serde_json::from_str(&format!("{{{event}"))?;
        let Some(service) = services
            .iter()
            .find(|service| service["id"] == event["service"])
        else {
            continue;
        };
        let target_ms = service["kpis"]["service_time_target_ms"]
            .as_f64()
            .unwrap_or(f64::INFINITY);
        let is_late = event["service_time_ms"]
            .as_f64()
            .is_none_or(|took_ms| took_ms > target_ms);
        let count = late.entry(service["id"].to_string()).or_default();
        *count = if is_late { *count + 1 } else { 0 };
        let here = servers
            .iter()
            .position(|server| server["id"] == event["server"]);
        let dearer = here.and_then(|here| servers.get(here + 1));
        if *count == patience
            && let Some(server) = dearer
        {
            *count = 0;
            let vnf = list(&service["vnfs"])
                .into_iter()
                .find(|vnf| vnf["pinned_to"].is_null())
                .unwrap_or_default();
            let place = json!({ "instruction": "place", "vnf": vnf["id"], "node": server["id"] });
            let reason = format!("{patience} answers in a row were late");
            let answer = api.post(
                "instructions",
                &json!({ "instruction": place, "reason": reason }),
            )?;
            println!("{place}: {reason}: {answer}");
        }
    }
    Ok(())
}
