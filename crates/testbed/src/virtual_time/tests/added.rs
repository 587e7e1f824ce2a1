//! VNFs that come and go during a run in virtual time.

use std::path::Path;

use cotorra_graph::{Image, Nodes, Rights, Vnf, VnfEvent, VnfId, VnfState};
use cotorra_graph_testing as base;

use crate::events::live::Live;
use crate::virtual_time::*;

const START: Duration = Duration::from_millis(500);

/// The corridor without plug-ins.
fn corridor() -> Arc<Testbed> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testbeds/corridor.yaml");
    let mut testbed = cotorra_testbed_file::load(file).unwrap();
    testbed.plugins.clear();
    Arc::new(testbed)
}

fn vnf(node: &str) -> Vnf {
    let image = Image { reference: "detector:1".to_owned(), start: START, ..Image::default() };
    Vnf {
        id: detector(),
        program: Program::Command(Vec::new()),
        cpus: 0.1,
        memory_bytes: 1_000_000,
        node: node.parse::<NodeId>().unwrap().into(),
        image: Some(Box::new(image)),
        ..base::vnf("vnf", "server")
    }
}

fn detector() -> VnfId {
    "detector".parse().unwrap()
}

/// A simulation, its state, and what happened.
struct Run {
    simulation: Simulation,
    live: Live,
    events: Vec<Stamped>,
}

impl Run {
    fn new() -> Self {
        let simulation = Simulation::new(corridor(), 1).unwrap();
        Self { simulation, live: Live::default(), events: Vec::new() }
    }

    fn until(&mut self, seconds: f64) -> &mut Self {
        let until = Timestamp::from_secs_f64(seconds);
        self.simulation.set_alarm(Some(until));
        while self.simulation.now() < until {
            self.simulation.step();
            while let Some(event) = self.simulation.poll_event() {
                self.live.absorb(&event);
                self.events.push(event);
            }
        }
        self
    }

    fn instruct(&mut self, instruction: Instruction) -> Result<(), String> {
        let done = self.simulation.instruct(Given::new("test".parse().unwrap(), instruction));
        done.map_err(|refused| refused.0)
    }

    fn add(&mut self, vnf: Vnf) -> Result<(), String> {
        self.instruct(Instruction::AddVnf { vnf: Box::new(vnf) })
    }

    /// Returns the states of the detector, and when it had them.
    fn life(&self) -> Vec<(f64, VnfState, String)> {
        let of_detector = |stamped: &Stamped| match &stamped.event {
            Event::Vnf(VnfEvent { vnf, state, node, .. }) if *vnf == detector() => {
                Some((stamped.at.as_secs_f64(), *state, node.to_string()))
            }
            _ => None,
        };
        self.events.iter().filter_map(of_detector).collect()
    }
}

#[test]
fn an_added_vnf_is_ready_after_the_start_of_its_image_and_drains_when_it_is_removed() {
    let mut run = Run::new();
    run.until(2.0).add(vnf("edge")).unwrap();
    run.until(2.4);
    assert_eq!(run.life(), []);
    assert!(
        run.live.read(|now| now.added.contains_key(&detector()) && !now.placements.contains_key(&detector()))
    );
    run.until(4.0);
    assert_eq!(run.life(), [(2.5, VnfState::Started, "edge".to_owned())]);
    assert!(run.live.read(|now| now.placements.contains_key(&detector())));
    let message = "VNF detector does not run: in virtual time no program of others does";
    assert!(run.events.iter().any(|e| matches!(&e.event, Event::Notice { message: is } if is == message)));

    // It moves like others.
    let place =
        Instruction::Place { vnf: detector(), node: Nodes::new(vec!["fog".parse().unwrap()]).unwrap() };
    run.instruct(place).unwrap();
    run.until(6.0).instruct(Instruction::RemoveVnf { vnf: detector() }).unwrap();
    run.until(6.5);
    let moved = [(4.5, VnfState::Started, "fog".to_owned()), (5.5, VnfState::Stopped, "edge".to_owned())];
    assert_eq!(run.life()[1..], moved);
    assert_eq!(
        run.simulation.managed().filter(|managed| managed.vnf.id == detector()).count(),
        1,
        "it drains"
    );
    run.until(8.0);
    assert_eq!(run.life()[3..], [(7.0, VnfState::Stopped, "fog".to_owned())]);
    assert!(run.live.read(|now| {
        let [added, placed, known] = [
            now.added.contains_key(&detector()),
            now.placements.contains_key(&detector()),
            now.vnfs.contains_key(&detector()),
        ];
        !added && !placed && !known
    }));
    assert!(run.simulation.managed().all(|managed| managed.vnf.id != detector()));
}

#[test]
fn a_rejected_vnf_changes_nothing_and_its_decision_says_why() {
    let mut run = Run::new();
    run.until(1.0);
    let before = run.simulation.managed().count();
    let trusted = Vnf { rights: Rights::Trusted, ..vnf("edge") };
    let refused = run.add(trusted).unwrap_err();
    assert!(refused.starts_with("VNF `detector` cannot be added: it asks for `trusted`"), "{refused}");
    let large = Vnf { cpus: 1e6, ..vnf("edge") };
    let refused = run.add(large).unwrap_err();
    assert!(refused.contains("needs 1000000 CPUs of `edge`"), "{refused}");
    let navigation: VnfId = "navigation".parse().unwrap();
    let refused = run.instruct(Instruction::RemoveVnf { vnf: navigation }).unwrap_err();
    assert!(refused.contains("is of the testbed file"), "{refused}");
    run.until(2.0);
    assert_eq!(run.simulation.managed().count(), before);
    let refusals =
        run.events.iter().filter(|e| matches!(&e.event, Event::Decision(d) if d.refused.is_some()));
    assert_eq!(refusals.count(), 3);
    assert!(run.live.read(|now| now.added.is_empty()));
}
