//! Both ends with bare Zenoh: the same TLS, one subscription, and nothing else.

use std::{
    collections::BTreeSet,
    fs,
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
        mpsc,
    },
    thread,
    time::Instant,
};

use cotorra_agent_protocol::{LEASE, MachineReading};
use parking_lot::Mutex;
use serde_json::{Value, json};
use zenoh::{Config, Session, Wait, qos::CongestionControl, sample::Sample};

use crate::{
    lab::Lab,
    load::{COUNTED, Schedule, serve_agents, serve_core},
};

pub fn core(folder: &Path) {
    let lab = Lab::open(folder);
    let core = lab.core();
    let tls = json!({
        "root_ca_certificate": file(&lab, "core-ca", &core.authority_pem),
        "listen_certificate": file(&lab, "core-certificate", &core.certificate_pem),
        "listen_private_key": file(&lab, "core-key", &core.key_pem),
    });
    let session =
        open("router", json!({ "listen": { "endpoints": [format!("tls/{}", lab.address())] } }), tls);
    let (join, joined) = mpsc::channel();
    let (counted, known) = (Arc::new(AtomicU64::new(0)), Mutex::new(BTreeSet::new()));
    let counts = Arc::clone(&counted);
    let receive = move |sample: Sample| {
        if sample.key_expr().ends_with(COUNTED) {
            counts.fetch_add(1, Ordering::Relaxed);
        } else if known.lock().insert(sample.key_expr().to_string()) {
            join.send(()).unwrap();
        }
    };
    session.declare_subscriber("bench/*/*").callback(receive).background().wait().unwrap();
    serve_core(&joined, &counted);
}

pub fn agents(folder: &Path) {
    serve_agents(&Arc::new(Lab::open(folder)), agent);
}

fn agent(lab: &Lab, number: usize, mut schedule: Schedule) {
    let name = &lab.agents[number];
    let bundle = lab.bundle(name);
    let tls = json!({
        "verify_name_on_connect": true,
        "root_ca_certificate": file(lab, &format!("{name}-ca"), bundle.authority_pem()),
        "connect_certificate": file(lab, &format!("{name}-certificate"), bundle.certificate_pem()),
        "connect_private_key": file(lab, &format!("{name}-key"), bundle.key_pem()),
    });
    let core = format!("tls/{}", bundle.core());
    let session = open("client", json!({ "connect": { "endpoints": [core], "timeout_ms": -1 } }), tls);
    let began = Instant::now();
    loop {
        thread::sleep(schedule.next().saturating_duration_since(Instant::now()));
        if let Some(context) = schedule.poll() {
            let key = format!("bench/{name}/{}", context.node);
            let read_ns = began.elapsed().as_nanos() as u64;
            let reading = MachineReading {
                boot: number as u64 + 1,
                read_ns,
                context,
                links: Default::default(),
                heard: Default::default(),
                addresses: Default::default(),
            };
            let put = session.put(key, reading.encode()).congestion_control(CongestionControl::Drop);
            put.express(true).wait().unwrap();
        }
    }
}

/// Opens a session with the lease of agents.
fn open(mode: &str, mut settings: Value, mut tls: Value) -> Session {
    tls["enable_mtls"] = true.into();
    settings["mode"] = mode.into();
    settings["scouting"] = json!({ "multicast": { "enabled": false }, "gossip": { "enabled": false } });
    let tx = json!({ "lease": LEASE.as_millis() as u64, "keep_alive": 4 });
    settings["transport"] =
        json!({ "link": { "tx": tx, "tls": tls }, "shared_memory": { "enabled": false } });
    zenoh::open(Config::from_json5(&settings.to_string()).unwrap()).wait().unwrap()
}

/// Writes a file of credentials, and returns its path.
fn file(lab: &Lab, name: &str, pem: &str) -> String {
    let path = lab.folder.join(format!("{name}.pem"));
    fs::write(&path, pem).unwrap();
    path.to_str().unwrap().to_owned()
}
