//! The engine's daemon dies and comes back.

use cotorra_engine::{Engine, EngineEvent, InstanceId, Outcome, contract::Subject as _};
use cotorra_graph::{EngineKind, Image, NodeId, Program, Vnf};
use cotorra_graph_testing as base;

use crate::lab::Lab;

pub(crate) fn vnf(lab: &Lab, script: &str) -> Vnf {
    let [node, _] = lab.nodes();
    Vnf {
        program: Program::Command(["sh", "-c", script].map(str::to_owned).to_vec()),
        node: node.into(),
        image: lab.image().map(Box::<Image>::new),
        ..base::vnf("service", "server")
    }
}

pub(crate) fn next(lab: &Lab, engine: &mut impl Engine) -> EngineEvent {
    loop {
        if let Some(event) = engine.poll() {
            return event;
        }
        lab.wait();
    }
}

fn start(lab: &Lab, engine: &mut impl Engine, number: u64, script: &str) -> Outcome {
    let node: NodeId = lab.nodes()[0].clone();
    engine.start(InstanceId(number), &vnf(lab, script), 0, &node).unwrap();
    let EngineEvent { instance, outcome } = next(lab, engine);
    assert_eq!(instance, InstanceId(number));
    outcome
}

fn process_of(lab: &Lab) -> String {
    let name = lab.containers.names().into_iter().find(|name| name.ends_with("-1")).unwrap();
    let found =
        lab.containers.client().args(["inspect", "--format", "{{.State.Pid}}", &name]).output().unwrap();
    String::from_utf8(found.stdout).unwrap().trim().to_owned()
}

fn end(process: &str) {
    let killed = std::process::Command::new("kill").args(["-KILL", process]).status().unwrap();
    assert!(killed.success());
}

#[test]
fn an_engine_that_has_settled_has_no_stopped_containers() {
    let Some(lab) = Lab::of(EngineKind::Podman) else { return };
    let mut engine = lab.engine();
    for number in 1..=2 {
        assert_eq!(start(&lab, &mut engine, number, "while true; do sleep 1; done"), Outcome::Ready);
    }
    engine.stop(InstanceId(1));
    engine.settle();
    assert_eq!(lab.containers.names().len(), 1, "the other one goes on");
    engine.shut_down();
    engine.settle();
}

#[test]
fn a_container_goes_on_while_podman_serves_nobody_and_is_watched_again() {
    let Some(lab) = Lab::of(EngineKind::Podman) else { return };
    let mut engine = lab.engine();
    assert_eq!(start(&lab, &mut engine, 1, "while true; do sleep 1; done"), Outcome::Ready);
    let process = process_of(&lab);
    lab.containers.kill();
    let lost = start(&lab, &mut engine, 2, "true");
    assert!(matches!(&lost, Outcome::Failed(reason) if reason.contains("does not answer")), "{lost:?}");
    lab.containers.resume();
    assert_eq!(process_of(&lab), process, "it is still the same");
    end(&process);
    let died = next(&lab, &mut engine);
    assert_eq!(died.outcome, Outcome::Died("exited with status 137".to_owned()));
    engine.shut_down();
    assert_eq!(lab.containers.names(), Vec::<String>::new());
}

#[test]
fn a_container_that_ends_while_the_engine_is_away_is_reported() {
    let Some(lab) = Lab::of(EngineKind::Podman) else { return };
    let mut engine = lab.engine();
    assert_eq!(start(&lab, &mut engine, 1, "while true; do sleep 1; done"), Outcome::Ready);
    let process = process_of(&lab);
    lab.containers.kill();
    end(&process);
    assert!(matches!(next(&lab, &mut engine).outcome, Outcome::Died(_)));
    lab.containers.resume();
    assert_eq!(start(&lab, &mut engine, 2, "while true; do sleep 1; done"), Outcome::Ready);
    engine.shut_down();
    assert_eq!(lab.containers.names(), Vec::<String>::new());
}

#[test]
fn vnfs_run_again_once_docker_is_back() {
    let Some(lab) = Lab::of(EngineKind::Docker) else { return };
    let mut engine = lab.engine();
    assert_eq!(start(&lab, &mut engine, 1, "while true; do sleep 1; done"), Outcome::Ready);
    lab.containers.kill();
    lab.containers.resume();
    // Docker ends the containers of a killed daemon when it starts again, unless it is set to keep them.
    assert!(matches!(next(&lab, &mut engine).outcome, Outcome::Died(_)));
    assert_eq!(start(&lab, &mut engine, 2, "while true; do sleep 1; done"), Outcome::Ready);
    engine.shut_down();
    assert_eq!(lab.containers.names(), Vec::<String>::new());
}

#[test]
fn a_run_ends_while_the_engine_is_away_and_its_containers_are_cleaned_up_later() {
    let Some(lab) = Lab::of(EngineKind::Podman) else { return };
    let mut engine = lab.engine();
    assert_eq!(start(&lab, &mut engine, 1, "while true; do sleep 1; done"), Outcome::Ready);
    lab.containers.kill();
    engine.shut_down();
    lab.containers.resume();
    assert_ne!(lab.containers.names(), Vec::<String>::new());
    cotorra_containers::clean();
    assert_eq!(lab.containers.names(), Vec::<String>::new());
}
