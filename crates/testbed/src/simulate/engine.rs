//! What runs VNFs in virtual time: the navigation VNF as a part of the simulation.

use std::{
    cell::RefCell,
    collections::{BTreeMap, VecDeque},
    rc::Rc,
};

use cotorra_brain::NavigationVnf;
use cotorra_graph::{NodeId, Program, Testbed, Vnf, VnfId};
use cotorra_network_control::vim::{Engine, EngineEvent, InstanceId, Outcome};

/// The navigation VNFs that serve on each node.
#[derive(Clone, Default)]
pub(super) struct Navigation(Rc<RefCell<Serving>>);

impl Navigation {
    /// Writes what the VNF on a node answers to a datagram; false if none does.
    pub(super) fn answer(&self, node: &NodeId, datagram: &[u8], answer: &mut Vec<u8>) -> bool {
        self.0.borrow_mut().get_mut(node).is_some_and(|instances| {
            instances.iter_mut().any(|(_, vnf)| vnf.answer(datagram, answer).is_ok())
        })
    }
}

/// By node, in the order in which they were started.
type Serving = BTreeMap<NodeId, Vec<(InstanceId, NavigationVnf)>>;

/// Runs the navigation VNF as a part of the simulation; an instance is ready at once.
pub(super) struct VirtualEngine {
    /// What an instance begins as, by VNF.
    planned: BTreeMap<VnfId, NavigationVnf>,
    serving: Navigation,
    running: BTreeMap<InstanceId, NodeId>,
    happened: VecDeque<EngineEvent>,
}

impl VirtualEngine {
    /// Plans all walks.
    pub(super) fn new(testbed: &Testbed, serving: Navigation) -> Self {
        let by_robot = NavigationVnf::of_all(testbed);
        let planned = testbed.services.iter().flat_map(|service| {
            let planned = by_robot.get(&service.robot);
            service.vnfs.iter().filter_map(move |vnf| Some((vnf.id.clone(), planned?.clone())))
        });
        Self { planned: planned.collect(), serving, running: BTreeMap::new(), happened: VecDeque::new() }
    }
}

impl Engine for VirtualEngine {
    fn start(&mut self, instance: InstanceId, vnf: &Vnf, node: &NodeId) -> Result<(), String> {
        if vnf.program != Program::Navigation {
            return Err("only the bundled navigation VNF runs in virtual time".to_owned());
        }
        let navigation = self.planned.get(&vnf.id).ok_or("its robot has no walk")?.clone();
        self.serving.0.borrow_mut().entry(node.clone()).or_default().push((instance, navigation));
        self.running.insert(instance, node.clone());
        self.happened.push_back(EngineEvent { instance, outcome: Outcome::Ready });
        Ok(())
    }

    fn stop(&mut self, instance: InstanceId) {
        if let Some(node) = self.running.remove(&instance)
            && let Some(instances) = self.serving.0.borrow_mut().get_mut(&node)
        {
            instances.retain(|(id, _)| *id != instance);
        }
    }

    fn poll(&mut self) -> Option<EngineEvent> {
        self.happened.pop_front()
    }

    fn shut_down(&mut self) {
        self.running.clear();
        self.serving.0.borrow_mut().clear();
    }
}
