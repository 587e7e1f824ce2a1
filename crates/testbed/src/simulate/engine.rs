//! What runs VNFs in virtual time: the bundled ones, as parts of the simulation.

use std::{
    collections::{BTreeMap, VecDeque},
    sync::Arc,
};

use cotorra_brain::NavigationVnf;
use cotorra_graph::{NodeId, Program, Testbed, Vnf, VnfId};
use cotorra_network_control::vim::{Engine, EngineEvent, InstanceId, Outcome};
use cotorra_plugin::wire;
use cotorra_robot_middleware::LocalizationVnf;
use parking_lot::Mutex;

/// An instance of a bundled VNF.
#[derive(Clone)]
enum Bundled {
    Navigation(NavigationVnf),
    Localization(Box<LocalizationVnf>),
}

impl Bundled {
    /// Writes the answer to a datagram; false if there is none.
    fn answer(&mut self, datagram: &[u8], answer: &mut Vec<u8>) -> bool {
        match self {
            Self::Navigation(vnf) => vnf.answer(datagram, answer).is_ok(),
            Self::Localization(vnf) => vnf.answer(datagram, answer).is_ok(),
        }
    }
}

/// By node, in the order in which they were started, each with its port.
type Instances = BTreeMap<NodeId, Vec<(InstanceId, u16, Bundled)>>;

/// The VNFs that serve on each node.
#[derive(Clone, Default)]
pub(crate) struct Serving(Arc<Mutex<Instances>>);

impl Serving {
    /// Writes what the VNFs on a node answer to a datagram that came to that port; false if none does.
    pub(super) fn answer(&self, node: &NodeId, port: u16, datagram: &[u8], answer: &mut Vec<u8>) -> bool {
        let mut all = self.0.lock();
        let mut here = all.get_mut(node).into_iter().flatten().filter(|(_, at, _)| *at == port);
        here.any(|(_, _, vnf)| vnf.answer(datagram, answer))
    }
}

/// Runs the bundled VNFs as parts of the simulation; an instance is ready at once.
pub(crate) struct VirtualEngine {
    /// What an instance begins as, and its port, by VNF.
    planned: BTreeMap<VnfId, (u16, Bundled)>,
    serving: Serving,
    running: BTreeMap<InstanceId, NodeId>,
    happened: VecDeque<EngineEvent>,
}

impl VirtualEngine {
    /// Plans all walks, and prepares the map.
    pub(crate) fn new(testbed: &Testbed, seed: u64, serving: Serving) -> Self {
        let navigations = NavigationVnf::of_all(testbed);
        let localizations = LocalizationVnf::of_all(testbed, seed);
        let planned = testbed.services.iter().flat_map(|service| {
            let (navigations, localizations) = (&navigations, &localizations);
            service.vnfs.iter().filter_map(move |vnf| {
                let bundled = match vnf.program {
                    Program::Navigation => Bundled::Navigation(navigations.get(&service.robot)?.clone()),
                    Program::Localization => {
                        Bundled::Localization(Box::new(localizations.get(&service.robot)?.clone()))
                    }
                    Program::RobotDriver | Program::Command(_) => return None,
                };
                Some((vnf.id.clone(), (wire::port(testbed, &vnf.id)?, bundled)))
            })
        });
        Self { planned: planned.collect(), serving, running: BTreeMap::new(), happened: VecDeque::new() }
    }
}

impl Engine for VirtualEngine {
    fn start(&mut self, instance: InstanceId, vnf: &Vnf, node: &NodeId) -> Result<(), String> {
        if !matches!(vnf.program, Program::Navigation | Program::Localization) {
            return Err("only the bundled VNFs run in virtual time".to_owned());
        }
        let (port, bundled) = self.planned.get(&vnf.id).ok_or("its robot has no walk, or no map")?.clone();
        self.serving.0.lock().entry(node.clone()).or_default().push((instance, port, bundled));
        self.running.insert(instance, node.clone());
        self.happened.push_back(EngineEvent { instance, outcome: Outcome::Ready });
        Ok(())
    }

    fn stop(&mut self, instance: InstanceId) {
        if let Some(node) = self.running.remove(&instance)
            && let Some(instances) = self.serving.0.lock().get_mut(&node)
        {
            instances.retain(|(id, ..)| *id != instance);
        }
    }

    fn poll(&mut self) -> Option<EngineEvent> {
        self.happened.pop_front()
    }

    fn shut_down(&mut self) {
        self.running.clear();
        self.serving.0.lock().clear();
    }
}
