use std::{cell::RefCell, path::Path};

use cotorra_fabric::Fabric;
use cotorra_graph::{HardwareGraph, Timestamp, VnfId};

use super::*;
use cotorra_engine::InMemoryEngine;

use crate::testing::Here;

const TESTBED: &str = "
name: off
wireless: { lab: {} }
nodes:
  on: { kind: radio_unit, position: [0, 0], channel: 1 }
  off: { kind: radio_unit, position: [9, 0], channel: 6, serving: false, deployment: 300 ms }
  small: { kind: radio_unit, position: [9, 9], channel: 6, serving: false, cpus: 0.4 }
links:
  - { ends: [on, [off, small]] }
";

fn world() -> (HardwareGraph, Here, Vim<InMemoryEngine>, AccessPoints) {
    let testbed =
        cotorra_testbed_file::parse("test", TESTBED, Path::new("")).unwrap_or_else(|e| panic!("{e:?}"));
    let graph = testbed.graph;
    let network = Here::new(&graph);
    let vim = Vim::new(graph.clone(), &[], InMemoryEngine::default());
    let access_points = AccessPoints::new(&graph);
    (graph, network, vim, access_points)
}

fn id(name: &str) -> NodeId {
    NodeId::new(name).unwrap()
}

fn at(ms: u64) -> Timestamp {
    Timestamp::ZERO + Duration::from_millis(ms)
}

fn lab() -> AccessPoint {
    AccessPoint { ssid: "lab".into(), mobility_domain: 1, key: None, core: None }
}

#[test]
fn a_vap_serves_once_its_deployment_is_done() {
    let (_, network, mut vim, mut access_points) = world();
    access_points.deploy(at(100), &id("off"), lab(), &network, &mut vim).unwrap();
    assert_eq!(access_points.next_deadline(), Some(at(400)));
    assert_eq!(access_points.poll(at(399), &network, &mut vim).unwrap(), []);
    let started = life(&id("off"), VnfState::Started, None);
    assert_eq!(access_points.poll(at(400), &network, &mut vim).unwrap(), [started]);
    assert_eq!(access_points.next_deadline(), None);
    let stopped = life(&id("off"), VnfState::Stopped, None);
    assert_eq!(access_points.remove(&id("off"), &network, &mut vim).unwrap(), [stopped]);
    let rejected = access_points.remove(&id("off"), &network, &mut vim).unwrap_err();
    assert!(rejected.0.contains("`off` is off"), "{rejected}");
}

#[test]
fn a_deployment_can_be_cancelled() {
    let (_, network, mut vim, mut access_points) = world();
    access_points.deploy(at(0), &id("off"), lab(), &network, &mut vim).unwrap();
    access_points.remove(&id("off"), &network, &mut vim).unwrap();
    assert_eq!(access_points.poll(at(1000), &network, &mut vim).unwrap(), []);
    access_points.deploy(at(1000), &id("off"), lab(), &network, &mut vim).unwrap();
}

#[test]
fn impossible_deployments_are_rejected_at_once() {
    let (_, network, mut vim, mut access_points) = world();
    let mut rejected = |unit: &str, access_point: AccessPoint| {
        access_points.deploy(at(0), &id(unit), access_point, &network, &mut vim).unwrap_err().0
    };
    assert!(rejected("on", lab()).contains("deployed on `on` already"));
    assert!(rejected("nowhere", lab()).contains("no radio unit `nowhere`"));
    assert!(rejected("small", lab()).contains("needs 0.5 CPUs of `small`"));
    let other = AccessPoint { ssid: "other".into(), ..lab() };
    assert!(rejected("off", other).contains("made for the network `lab`"));
    access_points.deploy(at(0), &id("off"), lab(), &network, &mut vim).unwrap();
    let again = access_points.deploy(at(0), &id("off"), lab(), &network, &mut vim).unwrap_err();
    assert!(again.0.contains("is being deployed on `off` already"), "{again}");
}

#[test]
fn a_vap_takes_room_from_the_start_of_its_deployment_to_its_removal() {
    let (graph, network, ..) = world();
    let vnf = VnfId::new("other").unwrap();
    let mut vim = Vim::new(graph.clone(), &[], InMemoryEngine::default());
    let mut access_points = AccessPoints::new(&graph);
    // A radio unit has one CPU.
    let other = |vim: &mut Vim<InMemoryEngine>| {
        let fits = vim.reserve(vnf.clone(), 0.6, 1, &id("off")).is_ok();
        vim.release(&vnf);
        fits
    };
    assert!(other(&mut vim));
    access_points.deploy(at(0), &id("off"), lab(), &network, &mut vim).unwrap();
    assert!(!other(&mut vim));
    access_points.poll(at(300), &network, &mut vim).unwrap();
    assert!(!other(&mut vim));
    access_points.remove(&id("off"), &network, &mut vim).unwrap();
    assert!(other(&mut vim));
}

/// A network whose vAPs are real programs.
struct Real {
    fabric: Here,
    /// Radio units whose program was started.
    started: RefCell<Vec<NodeId>>,
    /// Whether programs start.
    works: bool,
}

impl Network for Real {
    fn with<R: Send + 'static>(
        &self,
        action: impl FnOnce(&mut Fabric, Timestamp) -> R + Send + 'static,
    ) -> Result<R, NetworkGone> {
        self.fabric.with(action)
    }

    fn check_switch_on(&self, _: &NodeId, _: &AccessPoint) -> Result<Deployment, InstructionError> {
        Ok(Deployment::Real)
    }

    fn switch_on(&self, unit: &NodeId, _: AccessPoint) -> Result<Result<(), InstructionError>, NetworkGone> {
        if !self.works {
            return Ok(Err(InstructionError("no such program".to_owned())));
        }
        self.started.borrow_mut().push(unit.clone());
        Ok(Ok(()))
    }
}

#[test]
fn a_real_vap_is_switched_on_at_once_and_reports_itself() {
    let (graph, ..) = world();
    let mut vim = Vim::new(graph.clone(), &[], InMemoryEngine::default());
    let mut access_points = AccessPoints::new(&graph);
    let started = RefCell::default();
    let mut network = Real { fabric: Here::new(&graph), started, works: false };
    let vnf = VnfId::new("other").unwrap();
    let failed = access_points.deploy(at(0), &id("off"), lab(), &network, &mut vim).unwrap_err();
    assert_eq!(failed.0, "no such program");
    // Its room is free again.
    vim.reserve(vnf.clone(), 0.6, 1, &id("off")).unwrap();
    vim.release(&vnf);
    network.works = true;
    access_points.deploy(at(0), &id("off"), lab(), &network, &mut vim).unwrap();
    assert_eq!(*network.started.borrow(), [id("off")]);
    assert_eq!(access_points.next_deadline(), None);
    assert_eq!(access_points.poll(at(1000), &network, &mut vim).unwrap(), []);
    assert!(vim.reserve(vnf, 0.6, 1, &id("off")).is_err());
}
