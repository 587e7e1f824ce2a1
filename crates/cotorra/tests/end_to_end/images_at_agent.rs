//! Images at the agent of a real server, with the real podman.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{fs, os::unix::process::CommandExt as _, process::Command};

use cotorra_graph::EngineKind;
use cotorra_testing::containers::Containers;
use tempfile::TempDir;

use crate::harness::{agent_program, cotorra, stderr, stdout};

/// A server whose machine is at the far end of the wire `va`. Its agent runs an image.
const AT_AN_AGENT: &str = r#"
name: real-image
wireless: { lab: {} }
nodes:
  robot: { kind: robot, position: [0, 0] }
  R1: { kind: radio_unit, position: [0, 2], channel: 1 }
  near: { kind: server, tier: fog, cpus: 1, memory: 1 GB }
  lan: { kind: switch }
  edge: { kind: server, tier: edge, cpus: 1, memory: 1 GB, agent: edge1, interface: va, address: 10.9.0.2 }
links:
  - { ends: [lan, [R1, near]], delay: 1 ms }
  - { ends: [lan, edge], delay: 2 ms }
services:
  web:
    robot: robot
    kpis: { service_time: 100 ms }
    vnfs:
      web:
        image: localhost/busybox:cotorra
        pull: never
        command: [sh, -c, 'echo "hello from $COTORRA_NODE" | tee /tmp/page; exec httpd -f -p 8080 -h /tmp']
        ports: [8080]
        node: edge
"#;

#[test]
fn an_image_runs_at_the_agent_of_a_real_server() {
    let Some(engine) = Containers::start(EngineKind::Podman) else { return };
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("testbed.yaml"), AT_AN_AGENT).unwrap();
    let script = r#"
        # A process that outlives the script would keep its output open, and the test waiting.
        trap 'trap "" TERM; kill 0' EXIT
        here=$(readlink /proc/self/ns/net)
        unshare --net sleep 600 & machine=$!
        until [ "$(readlink /proc/$machine/ns/net)" != "$here" ]; do :; done
        at_machine() { nsenter --net=/proc/$machine/ns/net "$@"; }
        ip link set lo up
        ip link add va type veth peer name eth0 netns $machine
        ip address add 10.9.0.1/24 dev va
        ip link set va up
        at_machine sh -ec 'ip link set lo up; ip address add 10.9.0.2/24 dev eth0
            ip link set eth0 up; ip route add 10.77.0.0/16 dev eth0'
        $COTORRA agent enrol edge1 --core 10.9.0.1:7448 --authority authority >enrolled.txt
        nsenter --net=/proc/$machine/ns/net $AGENT run edge1.agent --state state --images podman >agent.txt 2>&1 & agent=$!
        $COTORRA run testbed.yaml --headless --api 127.0.0.1:7799 --until 600s --authority authority >run.txt 2>&1 & run=$!
        vnfs() { $COTORRA history events $(ls -d runs/*) --kinds vnf --json; }
        until vnfs 2>history.txt | grep '"vnf":"web"' | grep -q '"state":"started"'; do
            kill -0 $run && kill -0 $agent || { cat run.txt agent.txt; exit 1; }
            sleep 0.2
        done
        $COTORRA exec near --run 127.0.0.1:7799 -- busybox wget -qO- http://edge:8080/page
        sed 1d state/runs/*/logs/vnfs/web.log
        podman ps -q | wc -l
        kill -INT $run; wait $run || true
        kill -INT $agent; wait $agent
        cat agent.txt >&2
        ls cotorra-containers
        pgrep -f "$PWD/cotorra-containers" || true
    "#;
    let mut command = Command::new("unshare");
    command.args(["--net", "sh", "-ec", script]).current_dir(folder.path()).process_group(0);
    // Served by the agent's own guard, as without a podman service.
    command.envs(engine.settings()).env_remove(engine.variable().0).env("XDG_RUNTIME_DIR", folder.path());
    command.env("COTORRA", cotorra::<&str>([]).get_program()).env("AGENT", agent_program());
    let done = command.env("TMPDIR", folder.path()).env("NO_COLOR", "1").output().unwrap();
    assert!(done.status.success(), "{}{}", stdout(&done), stderr(&done));
    assert_eq!(stdout(&done), "hello from edge\nhello from edge\n1\n", "{}", stderr(&done));
    assert_eq!(engine.names(), Vec::<String>::new());
}
