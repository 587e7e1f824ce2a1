//! Compares the start-up of a confined program with a bare fork and exec, run alternately: time until it runs and
//! until it has ended.
//!
//! Run with `cargo bench -p cotorra-datapath --bench start`.
#![allow(clippy::disallowed_types, clippy::disallowed_methods, reason = "measures real time")]
#![allow(clippy::unwrap_used, reason = "a benchmark may panic")]

use std::{
    env, fs,
    process::{self, Command, Stdio},
    time::Instant,
};

use cotorra_datapath::{Confinement, HostsFile, Namespace, SpawnOptions, enter_user_namespace_if_needed};

const ROUNDS: usize = 500;

fn main() {
    let privilege = enter_user_namespace_if_needed().unwrap();
    let root = env::temp_dir().join(format!("cotorra-start-{}", process::id()));
    let [home, testbed] = ["run/vnfs/one", "testbed"].map(|folder| root.join(folder));
    fs::create_dir_all(&home).unwrap();
    fs::create_dir_all(&testbed).unwrap();
    let confinement = Confinement {
        home,
        readable: vec![testbed],
        hidden: vec![root.join("run")],
        capabilities: Vec::new(),
        processes: 4096,
        memory_bytes: 256 << 20,
    };
    let namespace = Namespace::new().unwrap();
    let hosts = HostsFile::new("127.0.0.1 localhost\n").unwrap();
    let command = || {
        let mut command = Command::new("/bin/true");
        command.stdin(Stdio::null()).stdout(Stdio::null());
        command
    };
    let in_node = |confinement: Option<&Confinement>| {
        let options = SpawnOptions {
            hosts: Some(&hosts),
            hostname: Some("node"),
            confinement,
            ..SpawnOptions::default()
        };
        let begin = Instant::now();
        let mut child = namespace.spawn(command(), options).unwrap();
        let started = begin.elapsed();
        assert!(child.wait().unwrap().success());
        [started, begin.elapsed()].map(|took| took.as_secs_f64() * 1e3)
    };
    let bare = || {
        let begin = Instant::now();
        let mut child = command().spawn().unwrap();
        let started = begin.elapsed();
        assert!(child.wait().unwrap().success());
        [started, begin.elapsed()].map(|took| took.as_secs_f64() * 1e3)
    };
    let mut all = [const { Vec::new() }; 3];
    for _ in 0..ROUNDS {
        all[0].push(bare());
        all[1].push(in_node(None));
        all[2].push(in_node(Some(&confinement)));
    }
    println!("{privilege:?}, {ROUNDS} starts each, ms       started: median     p99   ended: median     p99");
    for (name, took) in ["bare fork and exec", "in a node, trusted", "in a node, confined"].iter().zip(&all) {
        let figure = |which: usize, share: f64| {
            let mut sorted: Vec<f64> = took.iter().map(|both| both[which]).collect();
            sorted.sort_by(f64::total_cmp);
            sorted[((sorted.len() - 1) as f64 * share) as usize]
        };
        let [a, b, c, d] = [figure(0, 0.5), figure(0, 0.99), figure(1, 0.5), figure(1, 0.99)];
        println!("{name:<36} {a:>17.2} {b:>7.2} {c:>15.2} {d:>7.2}");
    }
    fs::remove_dir_all(root).unwrap();
}
